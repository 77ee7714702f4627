"""The parts of a recording: topics and messages. Encodes and decodes messages of one type as ROS 1 bytes."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

from slidectl import msgs
from slidectl.errors import SlidectlError
from slidectl.msgs.definitions import md5_of, parse_message
from slidectl.msgs.schema import Schema
from slidectl.msgs.serialization import packer, unpacker

_SECTION = re.compile(r"^=+\s*\nMSG: *(\S+) *\n", re.MULTILINE)


@dataclass(frozen=True)
class RecordedTopic:
    """One topic of a recording, from one publisher: a topic with two publishers has two entries."""

    number: int
    topic: str
    type: str
    definition: str = field(repr=False)
    md5: str
    latching: bool = False
    callerid: str = ""
    """The publishing node, if the recording has it."""


class Record(NamedTuple):
    """One message of a recording: its bytes, and the time in ns when it was recorded."""

    channel: RecordedTopic
    time_ns: int
    raw: bytes


class BadDefinition(SlidectlError):
    """The text of a message type cannot be understood."""


class Codec:
    """A message type. `definition` is its text, followed by those of nested types, as in recordings.

    An empty `md5` is computed from the definition.

    Raises:
        BadDefinition.
    """

    def __init__(self, type_name: str, definition: str, md5: str) -> None:
        self.type = type_name
        self.definition = definition
        self.texts = definitions(type_name, definition)
        """The text of each type; the first is the type itself."""
        try:
            parsed = {name: parse_message(text, name) for name, text in self.texts.items()}
            types = {name: one.fields for name, one in parsed.items()}
            self.schema = Schema(type_name, types)
            self.encode = packer(type_name, types.__getitem__)
            """Encodes a complete message as bytes."""
            self.decode = unpacker(type_name, types.__getitem__)
            """Decodes a message. Raises struct.error, ValueError: the bytes are not valid."""
            self.md5 = md5 or md5_of(type_name, parsed.__getitem__)
        except KeyError as error:
            raise BadDefinition(f"the definition of {type_name} lacks that of {error.args[0]}") from None
        except (ValueError, RecursionError, SyntaxError) as error:  # the last two are for endlessly nested types
            raise BadDefinition(f"the definition of {type_name} cannot be read: {error}") from None


@cache
def of(type_name: str) -> Codec:
    """The codec of a type that slidectl knows. Raises UnknownName."""
    return Codec(type_name, msgs.full_definition(type_name), msgs.md5(type_name))


def definitions(root: str, text: str) -> dict[str, str]:
    """Split a definition into the text of each type. Nested types follow the root, each after a separator line."""
    first, *rest = _SECTION.split(text)
    return {root: first, **dict(zip(rest[::2], rest[1::2], strict=True))}
