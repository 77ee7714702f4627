"""The parts of a recording: topics and messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple


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
