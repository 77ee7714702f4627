"""Python's own functions that an expression may call.

Lists stand for iterators, so that what they hold can be counted; nothing here gets at attributes or makes anything
large from little. Knows nothing of syntax.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from slidectl.operators.mathematics import rounded
from slidectl.operators.sizes import check_length, check_widths


def formatted(value: Any, spec: str = "") -> str:
    """As `format` does it. Raises TooLargeError, and what `format` raises."""
    check_widths(spec)
    return format(value, spec)


def _range(*bounds: int) -> list[int]:
    numbers = range(*bounds)
    check_length(len(numbers))
    return list(numbers)


def _sum(values: Iterable[Any], start: Any = 0) -> Any:
    found = list(values)
    if not all(isinstance(value, int | float) for value in (start, *found)):
        raise TypeError("sum() here adds numbers only")
    return sum(found, start)


def _map(function: Callable[..., Any], *values: Iterable[Any]) -> list[Any]:
    return [function(*items) for items in zip(*map(list, values), strict=False)]


def _filter(function: Callable[[Any], Any] | None, values: Iterable[Any]) -> list[Any]:
    return [value for value in list(values) if (value if function is None else function(value))]


FUNCTIONS: dict[str, Any] = {
    "abs": abs, "all": all, "any": any, "bin": bin, "bool": bool, "chr": chr, "dict": dict, "divmod": divmod,
    "enumerate": lambda values, start=0: list(enumerate(values, start)), "filter": _filter, "float": float,
    "format": formatted, "hex": hex, "int": int, "isinstance": isinstance, "len": len, "list": list, "map": _map,
    "max": max, "min": min, "oct": oct, "ord": ord, "range": _range, "repr": repr,
    "reversed": lambda values: list(reversed(values)), "round": rounded, "set": set, "sorted": sorted, "str": str,
    "sum": _sum, "tuple": tuple, "zip": lambda *values: list(zip(*values, strict=False)),
}  # fmt: skip
