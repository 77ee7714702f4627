"""How many bytes a message has in ROS 1's serialisation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from slidectl.msgs.schema import BYTES, TIMES, Field

_SIZES = {
    "bool": 1, "int8": 1, "uint8": 1, "byte": 1, "char": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
    "float32": 4, "int64": 8, "uint64": 8, "float64": 8, "time": 8, "duration": 8,
}  # fmt: skip

Fields = Callable[[str], Sequence[Field]]
"""Gives the fields of a type."""


def size(fields: Fields, type_name: str, value: Any) -> int:
    """Bytes of a message of the type, or of a primitive value."""
    if type_name in _SIZES:
        return _SIZES[type_name]
    if type_name == "string":
        return 4 + len(value.encode("utf-8", "surrogatepass"))
    return sum(_field_size(fields, field.type, field.array, value[field.name]) for field in fields(type_name))


def _field_size(fields: Fields, type_name: str, array: int, value: Any) -> int:
    if array < 0:
        return size(fields, type_name, value)
    prefix = 4 if array == 0 else 0
    if type_name in BYTES and isinstance(value, str):
        return prefix + len(value.rstrip("=")) * 3 // 4
    if type_name in _SIZES or type_name in TIMES:
        return prefix + _SIZES[type_name] * len(value)
    return prefix + sum(size(fields, type_name, element) for element in value)
