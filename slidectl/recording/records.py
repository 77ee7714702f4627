"""What a recording is made of: topics and messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple


@dataclass(frozen=True)
class RecordedTopic:
    """One topic of a recording. Two are the same when they were written by the same publisher."""

    number: int
    topic: str
    type: str
    definition: str = field(repr=False)
    md5: str
    latching: bool = False
    callerid: str = ""
    """The node that published, where the recording says so."""


class Record(NamedTuple):
    """One message of a recording: its bytes, and the time in ns at which it was recorded."""

    channel: RecordedTopic
    time_ns: int
    raw: bytes
