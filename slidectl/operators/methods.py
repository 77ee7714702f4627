"""Methods of texts, lists and mappings that an expression may call; those that could make much of little are watched.

A method that is not listed here does not exist for expressions, and nor does any other attribute.
"""

from __future__ import annotations

import string
from collections.abc import Callable
from typing import Any

from slidectl.operators.sizes import check_length, check_widths


def find(owner: Any, name: str) -> Callable[..., Any] | None:
    """The method of that name; None when there is none for expressions."""
    if isinstance(owner, str) and name in _WATCHED:
        return _WATCHED[name](owner)
    if owner is str and (name in _WATCHED or name in _METHODS[str]):
        return lambda text, *values: _of_text(text, name)(*values)
    known = next((names for kind, names in _METHODS.items() if isinstance(owner, kind)), frozenset())
    return getattr(owner, name) if name in known else None


def _of_text(text: Any, name: str) -> Callable[..., Any]:
    """`str.upper` for a text. Raises TypeError when it is none."""
    method = find(text, name) if isinstance(text, str) else None
    if method is None:
        raise TypeError(f"str.{name} is for texts")
    return method


def _replace(text: str) -> Callable[..., str]:
    def replace(old: str, new: str, count: int = -1) -> str:
        check_length(text.count(old) * len(new))
        return text.replace(old, new, count)

    return replace


def _join(text: str) -> Callable[[Any], str]:
    def join(parts: Any) -> str:
        parts = list(parts)
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
    """`str.format` without attributes and elements of values: Python would get from any value to anything at all."""

    def fill_in(*values: Any, **named: Any) -> str:
        for _, field, spec, _ in string.Formatter().parse(text):
            if field and not (field.isdecimal() or field.isidentifier()):
                raise ValueError(f"{{{field}}} is not the number or the name of a value")
            check_widths((spec or "").replace("{", "0000"))
        shown = [len(str(value)) for value in (*values, *named.values())]
        check_length(len(text) + text.count("{") * max(shown, default=0))
        return text.format(*values, **named)

    return fill_in


_WATCHED: dict[str, Callable[[str], Callable[..., str]]] = {
    "replace": _replace, "join": _join, "format": _format,
    **{method: _filled(method) for method in ("center", "ljust", "rjust", "zfill")},
}  # fmt: skip
_METHODS: dict[type[Any], frozenset[str]] = {
    str: frozenset({
        "capitalize", "casefold", "count", "endswith", "find", "index", "isalnum", "isalpha", "isascii", "isdecimal",
        "isdigit", "isidentifier", "islower", "isnumeric", "isprintable", "isspace", "istitle", "isupper", "lower",
        "lstrip", "partition", "removeprefix", "removesuffix", "rfind", "rindex", "rpartition", "rsplit", "rstrip",
        "split", "splitlines", "startswith", "strip", "swapcase", "title", "upper",
    }),
    dict: frozenset({"clear", "copy", "get", "items", "keys", "pop", "popitem", "setdefault", "update", "values"}),
    list: frozenset({
        "append", "clear", "copy", "count", "extend", "index", "insert", "pop", "remove", "reverse", "sort",
    }),
    tuple: frozenset({"count", "index"}),
    set: frozenset({
        "add", "clear", "copy", "difference", "discard", "intersection", "isdisjoint", "issubset", "issuperset", "pop",
        "remove", "symmetric_difference", "union", "update",
    }),
    frozenset: frozenset({
        "copy", "difference", "intersection", "isdisjoint", "issubset", "issuperset", "symmetric_difference", "union",
    }),
    float: frozenset({"is_integer"}),
}  # fmt: skip
