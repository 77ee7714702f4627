"""The schema of messages that the printers, field paths and filters use: that of `slidectl.msgs`."""

from slidectl.msgs.schema import BYTES, FLOATS, INTEGERS, PRIMITIVES, TIMES, Field, Schema, from_typedefs

__all__ = ["BYTES", "FLOATS", "INTEGERS", "PRIMITIVES", "TIMES", "Field", "Schema", "from_typedefs"]
