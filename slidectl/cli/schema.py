"""The fields of message types, as /rosapi/message_details tells them.

What the printers, field paths and filters must know about a message: names, types and arrays, in order. It reads
an answer of the daemon and knows no message definition itself, so that no command loads a type system.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

FLOATS = frozenset(("float32", "float64"))
INTEGERS = frozenset(("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "byte", "char"))
TIMES = frozenset(("time", "duration"))
PRIMITIVES = FLOATS | INTEGERS | TIMES | {"bool", "string"}
BYTES = frozenset(("uint8", "char"))
"""Arrays of these are base64 text on the wire."""


class Field(NamedTuple):
    """One field: `array` is -1 for none, 0 for any length, n for exactly n elements."""

    name: str
    type: str
    array: int

    @property
    def spelled(self) -> str:
        """The type as a definition writes it: `float64`, `float64[]`, `float64[36]`."""
        return self.type + ("" if self.array < 0 else f"[{self.array or ''}]")


class Schema:
    """The type `root` and every type that it is made of."""

    __slots__ = ("root", "types")

    def __init__(self, root: str, types: Mapping[str, tuple[Field, ...]]) -> None:
        self.root = root
        self.types = types

    def fields(self, type_name: str) -> tuple[Field, ...]:
        """The fields of a type, in order; none for a primitive."""
        return self.types.get(type_name, ())

    def field(self, type_name: str, name: str) -> Field | None:
        """The field of that name, if there is one."""
        return next((field for field in self.fields(type_name) if field.name == name), None)

    @property
    def has_header(self) -> bool:
        """True when the first field is a std_msgs/Header called `header`: the message has a stamp."""
        field = self.field(self.root, "header")
        return field is not None and field.type == "std_msgs/Header" and field.array < 0


def from_typedefs(typedefs: Iterable[Mapping[str, Any]]) -> Schema:
    """The schema of a `typedefs` list (rosapi/TypeDef); the first one is the root."""
    listed = list(typedefs)
    types = {str(entry["type"]): _fields(entry) for entry in listed if entry["type"] not in TIMES}
    return Schema(str(listed[0]["type"]) if listed else "", types)


def _fields(entry: Mapping[str, Any]) -> tuple[Field, ...]:
    return tuple(map(Field, entry["fieldnames"], entry["fieldtypes"], entry["fieldarraylen"]))
