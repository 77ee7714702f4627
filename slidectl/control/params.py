"""Typed reading of parameters, by the rules of roscpp: a value of the wrong type counts as not set.

Unlike roscpp this says so: a value that is passed over is a warning on the log. Nothing here sets a parameter.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, floor, isfinite
from typing import Any, Generic, NamedTuple, TypeVar

from slidectl import names
from slidectl.control.node import NodeHandle
from slidectl.errors import Refused

T = TypeVar("T")


class BadParameter(Refused):
    """A parameter that is needed is not set, or is of another type."""

    def __init__(self, node: NodeHandle, name: str, wanted: str) -> None:
        where = names.join(node.namespace, name)
        value = node.get_param(name, None)
        if value is None:
            super().__init__(f"parameter {where} is not set; it must be {wanted}", f"slidectl param set {where} VALUE")
        else:
            super().__init__(f"parameter {where} must be {wanted}, not {described(value)}")


def as_number(value: Any) -> float | None:
    """An int or a float as a float. A YAML boolean or a string is no number."""
    return None if isinstance(value, bool) else _as_float(value)


def _as_float(value: Any) -> float | None:
    try:
        return float(value) if isinstance(value, int | float) else None
    except OverflowError:  # an int of hundreds of digits
        return None


def as_integer(value: Any) -> int | None:
    """An int, or a float rounded half up."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if isinstance(value, int):
        return value
    if not isfinite(value):
        return None
    return floor(value) if value - floor(value) < 0.5 else ceil(value)


def as_boolean(value: Any) -> bool | None:
    """Only a true YAML boolean: 1, 0 and "true" are none."""
    return value if isinstance(value, bool) else None


def as_text(value: Any) -> str | None:
    """Only a string."""
    return value if isinstance(value, str) else None


def as_texts(value: Any) -> list[str] | None:
    """A list of nothing but strings."""
    return list(value) if isinstance(value, list) and all(isinstance(item, str) for item in value) else None


def as_numbers(value: Any) -> list[float] | None:
    """A list of numbers; booleans count as 0 and 1 here."""
    if not isinstance(value, list):
        return None
    numbers = [_as_float(item) for item in value]
    return None if None in numbers else [number for number in numbers if number is not None]


class Kind(NamedTuple, Generic[T]):
    """A type of parameters: how messages name it, and what makes a value of it (None when it is none)."""

    words: str
    convert: Callable[[Any], T | None]


NUMBER = Kind("a number", as_number)
INTEGER = Kind("an integer", as_integer)
BOOLEAN = Kind("true or false", as_boolean)
TEXT = Kind("a string", as_text)
TEXTS = Kind("a list of strings", as_texts)
NUMBERS = Kind("a list of numbers", as_numbers)


def number(node: NodeHandle, name: str) -> float | None:
    """The parameter as a number, None when it is not one."""
    return _read(node, name, NUMBER)


def integer(node: NodeHandle, name: str) -> int | None:
    """The parameter as an integer, None when it is not one."""
    return _read(node, name, INTEGER)


def boolean(node: NodeHandle, name: str) -> bool | None:
    """The parameter as a boolean, None when it is not one."""
    return _read(node, name, BOOLEAN)


def text(node: NodeHandle, name: str) -> str | None:
    """The parameter as a string, None when it is not one."""
    return _read(node, name, TEXT)


def texts(node: NodeHandle, name: str) -> list[str] | None:
    """The parameter as a list of strings, None when it is not one."""
    return _read(node, name, TEXTS)


def numbers(node: NodeHandle, name: str) -> list[float] | None:
    """The parameter as a list of numbers, None when it is not one."""
    return _read(node, name, NUMBERS)


def needed_number(node: NodeHandle, name: str) -> float:
    """The parameter as a number. Raises BadParameter when it is not one."""
    return _needed(node, name, NUMBER)


def needed_text(node: NodeHandle, name: str) -> str:
    """The parameter as a string. Raises BadParameter when it is not one."""
    return _needed(node, name, TEXT)


def needed_texts(node: NodeHandle, name: str) -> list[str]:
    """The parameter as a list of strings. Raises BadParameter when it is not one."""
    return _needed(node, name, TEXTS)


def _read(node: NodeHandle, name: str, kind: Kind[T]) -> T | None:
    value = node.get_param(name, None)
    if value is None:
        return None
    converted = kind.convert(value)
    if converted is None:
        where = names.join(node.namespace, name)
        node.log("warn", f"parameter {where} has no effect: it must be {kind.words}, not {described(value)}")
    return converted


def _needed(node: NodeHandle, name: str, kind: Kind[T]) -> T:
    converted = kind.convert(node.get_param(name, None))
    if converted is None:
        raise BadParameter(node, name, kind.words)
    return converted


def described(value: Any) -> str:
    """The value with its type; a number that YAML took for text gets the reason."""
    if not isinstance(value, str):
        return f"{value!r}"
    try:
        float(value)
    except ValueError:
        return f"the string {value!r}"
    if "e" in value.lower():
        return f"the string {value!r} (YAML reads a number with an exponent only with a dot in it, as 1.0e-3)"
    return f"the string {value!r} (a number has no quotes)"
