"""The fields of message types, and the primitive types with their ranges.

Plain records and tables: nothing here reads a definition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from struct import calcsize
from typing import Any, NamedTuple

SCALAR = -1


class Field(NamedTuple):
    """One field. `array` is -1 for a single value, 0 for a list of any length, n for a list of exactly n."""

    name: str
    type: str
    array: int = SCALAR

    @property
    def type_text(self) -> str:
        """The type as a definition writes it: `float64`, `float64[]`, `float64[9]`."""
        return self.type + ("" if self.array == SCALAR else f"[{self.array or ''}]")


CODES = {
    "bool": "?", "int8": "b", "byte": "b", "uint8": "B", "char": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
"""ROS 1's number types -> their codes in `struct`. In ROS 1 `byte` is an int8 and `char` an uint8."""
TIMES = {
    "time": (Field("secs", "uint32"), Field("nsecs", "uint32")),
    "duration": (Field("secs", "int32"), Field("nsecs", "int32")),
}
"""The parts of a time and of a duration."""


def nanoseconds(time: Mapping[str, int]) -> int:
    """A time or duration of a message in nanoseconds."""
    return time["secs"] * 10**9 + time["nsecs"]


def _range(code: str) -> tuple[int, int]:
    count = 1 << 8 * calcsize(f"<{code}")
    return (0, count - 1) if code.isupper() else (-count // 2, count // 2 - 1)


FLOATS = frozenset(kind for kind, code in CODES.items() if code in "fd")
INTEGER_RANGES = {kind: _range(code) for kind, code in CODES.items() if code not in "fd?"}
"""ROS 1's integer types -> lowest and highest value."""
BYTES = frozenset(kind for kind, code in CODES.items() if code == "B")
"""Arrays of these types are base64 text in a message, as in the protocol."""
PRIMITIVES = frozenset({*CODES, *TIMES, "string"})


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
