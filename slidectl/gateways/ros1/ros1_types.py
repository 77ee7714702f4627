"""The message types of ROS 1 as its connections need them."""

from __future__ import annotations

import struct
from functools import cache

from slidectl import msgs
from slidectl.errors import BadMessage
from slidectl.msgs import Field, Message
from slidectl.msgs.serialization import packer, unpacker

_MOST_ELEMENTS = 100_000
"""Elements of all lists of a message that comes in; the daemon takes no more values."""


class Ros1Type:
    """A message type: its md5 sum, its text as connection headers hold it, and its bytes. Raises UnknownName."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.md5 = msgs.md5(name)
        self.definition = msgs.full_definition(name)
        first = msgs.fields(name)[:1]
        self.has_header = first == (Field("header", "std_msgs/Header"),)
        self.pack = packer(name, msgs.fields)
        """The bytes of a complete message."""
        self._unpack = unpacker(name, msgs.fields, _MOST_ELEMENTS)

    def unpack(self, data: bytes) -> Message:
        """The message. Raises BadMessage: the bytes are none."""
        try:
            return self._unpack(data)
        except (struct.error, ValueError) as error:
            raise BadMessage(f"{len(data)} bytes that are no {self.name}: {error}") from None

    def key(self, data: bytes) -> int:
        """The same for messages that differ in nothing but `header.seq`."""
        return hash(data[4:] if self.has_header else data)


@cache
def ros1_type(name: str) -> Ros1Type:
    """The type of that name; services have `pkg/TypeRequest` and `pkg/TypeResponse`. Raises UnknownName."""
    return Ros1Type(name)
