"""The fields of message types, and the primitive types with their ranges.

Plain records and tables: nothing here reads a definition.
"""

from __future__ import annotations

from typing import NamedTuple

SCALAR = -1

INTEGER_RANGES = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "byte": (-128, 127),
    "char": (0, 255),
}
"""ROS 1's integers with their lowest and highest value. `byte` is an int8 and `char` an uint8 there."""
FLOATS = frozenset({"float32", "float64"})
TIMES = frozenset({"time", "duration"})
BYTES = frozenset({"uint8", "char"})
"""Arrays of these are base64 text in a message, as on the wire."""
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
