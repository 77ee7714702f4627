"""Python's own functions that an expression may call, and methods of texts that need a watch over sizes.

Lists stand for iterators, so that what they hold can be counted; nothing here gets at attributes or makes anything
large from little. Knows nothing of syntax.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Iterable
from typing import Any

MOST_LENGTH = 100_000
"""Letters of a text, items of a list."""
_MOST_DIGITS = 300
_WIDE = re.compile(r"\d{4}")


class TooLargeError(ValueError):
    """What would be made is too large."""


def check_length(count: int) -> None:
    """Raises TooLargeError."""
    if count > MOST_LENGTH:
        raise TooLargeError("has a text or list that is too long")


def formatted(value: Any, spec: str = "") -> str:
    """As `format` does it. Raises TooLargeError, and what `format` raises."""
    if _WIDE.search(spec):
        raise TooLargeError("formats something with a width that is too large")
    return format(value, spec)


def _range(*bounds: int) -> list[int]:
    numbers = range(*bounds)
    check_length(len(numbers))
    return list(numbers)


def _round(number: Any, digits: int | None = None) -> Any:
    if digits is not None and abs(digits) > _MOST_DIGITS:
        raise TooLargeError("rounds to too many digits")
    return round(number, digits)


def _sum(values: Iterable[Any], start: Any = 0) -> Any:
    found = list(values)
    if not all(isinstance(value, int | float) for value in (start, *found)):
        raise TypeError("sum() here adds numbers only")
    return sum(found, start)


FUNCTIONS: dict[str, Any] = {
    "true": True, "false": False, "True": True, "False": False,
    "abs": abs, "all": all, "any": any, "bin": bin, "bool": bool, "chr": chr, "dict": dict, "divmod": divmod,
    "enumerate": lambda values, start=0: list(enumerate(values, start)), "float": float, "format": formatted,
    "hex": hex, "int": int, "isinstance": isinstance, "len": len, "list": list, "map": map, "max": max, "min": min,
    "oct": oct, "ord": ord, "range": _range, "repr": repr, "reversed": lambda values: list(reversed(values)),
    "round": _round, "set": set, "sorted": sorted, "str": str, "sum": _sum, "tuple": tuple,
    "zip": lambda *values: list(zip(*values, strict=False)),
}  # fmt: skip
TAKE_KEYWORDS = [FUNCTIONS[name] for name in ("dict", "enumerate", "int", "max", "min", "round", "sorted", "sum")]


# --- methods of texts ---------------------------------------------------------------------------------------------


def _replace(text: str) -> Callable[[str, str], str]:
    def replace(old: str, new: str) -> str:
        check_length(text.count(old) * len(new))
        return text.replace(old, new)

    return replace


def _join(text: str) -> Callable[[Any], str]:
    def join(parts: Any) -> str:
        check_length(sum(len(part) + len(text) for part in parts))
        return text.join(parts)

    return join


def _filled(method: str) -> Callable[[str], Callable[..., str]]:
    """The method of that name, whose first argument is a width."""

    def of(text: str) -> Callable[..., str]:
        def fill(width: int, *letter: str) -> str:
            check_length(width)
            return str(getattr(text, method)(width, *letter))

        return fill

    return of


def _format(text: str) -> Callable[..., str]:
    def fill_in(*values: Any) -> str:
        for _, field, spec, _ in string.Formatter().parse(text):
            if field and not field.isdecimal():
                raise ValueError(f"{{{field}}} is not the number of a value")
            if spec and ("{" in spec or _WIDE.search(spec)):
                raise TooLargeError("formats something with a width that is too large")
        check_length(len(text) + text.count("{") * max((len(str(value)) for value in values), default=0))
        return text.format(*values)

    return fill_in


WATCHED: dict[str, Callable[[str], Callable[..., str]]] = {
    "replace": _replace, "join": _join, "format": _format,
    **{method: _filled(method) for method in ("center", "ljust", "rjust", "zfill")},
}  # fmt: skip
METHODS = {
    *WATCHED, "capitalize", "casefold", "count", "endswith", "find", "index", "isalnum", "isalpha", "isdecimal",
    "isdigit", "isidentifier", "islower", "isnumeric", "isspace", "isupper", "lower", "lstrip", "partition",
    "removeprefix", "removesuffix", "rfind", "rindex", "rpartition", "rsplit", "rstrip", "split", "splitlines",
    "startswith", "strip", "swapcase", "title", "upper",
}  # fmt: skip
