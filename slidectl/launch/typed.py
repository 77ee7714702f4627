"""Texts of attributes as values: what `<param type=...>` and the conditions make of them.

roslaunch's own rules, down to `1e3` being text and `10` a whole number.
"""

from __future__ import annotations

import math
from typing import Any

TYPES = ("auto", "str", "string", "int", "double", "bool", "boolean", "yaml")
_NUMBERS: dict[str, type[int] | type[float]] = {"int": int, "double": float}
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}


def automatic(text: str) -> Any:
    """With a point a float, else an int, if it is one; then true and false; else the text itself."""
    try:
        if "." in text:
            return float(text)
        if "_" not in text:
            return int(text)
    except ValueError:
        pass
    return {"true": True, "false": False}.get(text.lower(), text)


def boolean(text: str) -> bool:
    """true, false, 1 or 0, as conditions and parameters have it. Raises ValueError."""
    value = _BOOLEANS.get(text.strip().lower())
    if value is None:
        raise ValueError(f"{text!r} is neither true nor false")
    return value


def flag(text: str) -> bool:
    """true or false and nothing else, as all other attributes have it. Raises ValueError."""
    if text.lower() not in ("true", "false"):
        raise ValueError(f"{text!r} is neither true nor false")
    return text.lower() == "true"


def convert(text: str, type_name: str, file: str, angles: bool = False) -> Any:
    """The value of a text as a type of TYPES. `file` is its name in messages about YAML; with `angles` it has deg().

    Raises:
        ValueError: it cannot be one. BadFile: not YAML.
    """
    if type_name == "auto":
        return _finite(automatic(text))
    if type_name in _NUMBERS:
        return _finite(_number(_NUMBERS[type_name], text))
    if type_name in ("bool", "boolean"):
        return boolean(text)
    if type_name == "yaml":
        from slidectl.description.yaml_tree import read_value  # takes as long to import as all of this room

        return read_value(text, file, angles=angles)
    return text


def _number(kind: type[int] | type[float], text: str) -> int | float:
    try:
        return kind(text)
    except ValueError:
        raise ValueError(repr(text)) from None


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is no finite number, and parameters hold no others")
    return value
