"""Parameters as Foxglove's protocol has them: with a type where JSON does not tell a float from an integer.

JavaScript knows one kind of number, so 1.0 comes back as 1: a type tells it apart.
"""

from __future__ import annotations

from typing import Any

from slidectl import names
from slidectl.gateways.foxglove.foxglove_frames import BadFrame, field

Parameter = dict[str, Any]

_FLOAT, _FLOATS, _BYTES = "float64", "float64_array", "byte_array"


def parameter(name: str, value: Any) -> Parameter:
    """A parameter with its value."""
    found: Parameter = {"name": name, "value": value}
    if isinstance(value, float):
        found["type"] = _FLOAT
    elif isinstance(value, list) and any(isinstance(each, float) for each in value) and all(map(_is_number, value)):
        found["type"] = _FLOATS
    return found


def wanted(given: Parameter) -> tuple[str, Any]:
    """Name and value of a parameter that an app sets; the value is None when it is to be deleted. Raises BadFrame."""
    name, value, kind = field(given, "name", str), given.get("value"), given.get("type")
    if kind == _BYTES:
        raise BadFrame(f"{name}: a parameter of slidectl holds no bytes; give text or a list")
    if kind == _FLOAT and _is_number(value):
        value = _float(value)
    elif kind == _FLOATS and isinstance(value, list):
        value = [_float(each) if _is_number(each) else each for each in value]
    return name, value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        raise BadFrame("a number that is too large") from None


def concerns(changed: str, subscribed: str) -> bool:
    """Whether a change of the one is a change of the other: one is in the other."""
    return names.is_under(subscribed, changed) or names.is_under(changed, subscribed)
