"""ROS 1 message types with what TCPROS connections need: md5 sum, definition, serialization."""

from __future__ import annotations

import struct
from functools import cache

from slidectl import msgs
from slidectl.errors import BadMessage
from slidectl.msgs import Field, Message
from slidectl.msgs.serialization import packer, unpacker

_MOST_ELEMENTS = 100_000
"""Limit of the elements of all lists of a received message; the daemon accepts no more values."""


class Ros1Type:
    """A message type: its md5 sum, its text for connection headers, and its serialization. Raises UnknownName."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.md5 = msgs.md5(name)
        self.definition = msgs.full_definition(name)
        first = msgs.fields(name)[:1]
        self.has_header = first == (Field("header", "std_msgs/Header"),)
        self.pack = packer(name, msgs.fields)
        """Serialize a complete message."""
        self._unpack = unpacker(name, msgs.fields, _MOST_ELEMENTS)

    def unpack(self, data: bytes) -> Message:
        """Deserialize a message. Raises BadMessage."""
        try:
            return self._unpack(data)
        except (struct.error, ValueError) as error:
            raise BadMessage(f"{len(data)} bytes that are not {self.name}: {error}") from None

    def key(self, data: bytes) -> int:
        """A key that is equal for messages that differ only in `header.seq`."""
        return hash(data[4:] if self.has_header else data)


@cache
def ros1_type(name: str) -> Ros1Type:
    """The type of that name; those of services are `pkg/TypeRequest` and `pkg/TypeResponse`. Raises UnknownName."""
    return Ros1Type(name)
