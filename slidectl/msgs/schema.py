"""The fields of message types, and the primitive types with their ranges.

Plain records and tables: nothing here reads a definition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

SCALAR = -1

INTEGER_RANGES = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "byte": (-128, 127),
    "char": (0, 255),
}
"""ROS 1's integer types -> lowest and highest value. In ROS 1 `byte` is an int8 and `char` an uint8."""
FLOATS = frozenset({"float32", "float64"})
TIMES = frozenset({"time", "duration"})
BYTES = frozenset({"uint8", "char"})
"""Arrays of these types are base64 text in a message, as in the protocol."""
PRIMITIVES = frozenset(INTEGER_RANGES) | FLOATS | TIMES | {"bool", "string"}


class Field(NamedTuple):
    """One field. `array` is -1 for a single value, 0 for a list of any length, n for a list of exactly n."""

    name: str
    type: str
    array: int = SCALAR

    @property
    def type_text(self) -> str:
        """The type as a definition writes it: `float64`, `float64[]`, `float64[9]`."""
        return self.type + ("" if self.array == SCALAR else f"[{self.array or ''}]")


FieldsOf = Callable[[str], Sequence[Field]]
"""Returns the fields of a non-primitive type."""
Typedefs = list[dict[str, Any]]
"""A rosapi/TypeDef of a type and of every type used in it."""


class Schema:
    """The message type `root` and every type used in it."""

    def __init__(self, root: str, types: Mapping[str, tuple[Field, ...]]) -> None:
        self.root = root
        self.types = types

    def fields(self, type_name: str) -> tuple[Field, ...]:
        """The fields of a type, in order; none for a primitive."""
        return self.types.get(type_name, ())

    def field(self, type_name: str, name: str) -> Field | None:
        """The field of that name, or None."""
        return next((field for field in self.fields(type_name) if field.name == name), None)

    @property
    def has_header(self) -> bool:
        """True when the type has a std_msgs/Header named `header`: the message has a stamp."""
        return self.field(self.root, "header") == Field("header", "std_msgs/Header")


def from_typedefs(typedefs: Iterable[Mapping[str, Any]]) -> Schema:
    """The schema of a `typedefs` list (rosapi/TypeDef); the first entry is the root."""
    types = {
        str(entry["type"]): tuple(map(Field, entry["fieldnames"], entry["fieldtypes"], entry["fieldarraylen"]))
        for entry in typedefs
        if entry["type"] not in TIMES
    }
    return Schema(next(iter(types), ""), types)
