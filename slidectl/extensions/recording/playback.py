"""Merges the messages of several recordings by time, to publish them again."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from slidectl.extensions.recording.recording_files import Recording


class DueMessage(NamedTuple):
    """A message to publish at `at_ns` after the start; `size` is its number of bytes in the recording."""

    at_ns: int
    topic: str
    type: str
    latch: bool
    message: Any
    size: int


def span_ns(recordings: Sequence[Recording]) -> tuple[int, int]:
    """The times of the first and the last message of all recordings; zeros if there are no messages."""
    summaries = [recording.summary() for recording in recordings]
    begin = min((one.begin_ns for one in summaries if one.begin_ns is not None), default=0)
    return begin, max((one.end_ns for one in summaries if one.end_ns is not None), default=begin)


def due_messages(
    recordings: Sequence[Recording], topics: set[str], start_ns: int = 0, end_ns: int | None = None, rate: float = 1.0
) -> Iterator[DueMessage]:
    """The messages from `start_ns` to before `end_ns` after the first message, by time; `rate` divides their times.

    Latched messages from before the start come first: the last one of each topic.
    """
    begin_ns = span_ns(recordings)[0]
    streams = [((record, recording) for record in recording.records(topics)) for recording in recordings]
    latched: dict[str, DueMessage] = {}
    for record, recording in heapq.merge(*streams, key=lambda pair: pair[0].time_ns):
        channel, offset_ns = record.channel, record.time_ns - begin_ns - start_ns
        if end_ns is not None and offset_ns + start_ns >= end_ns:
            break
        if offset_ns < 0 and not channel.latching:
            continue
        at_ns, message = round(max(offset_ns, 0) / rate), recording.message(record)
        due = DueMessage(at_ns, channel.topic, channel.type, channel.latching, message, len(record.raw))
        if offset_ns < 0:
            latched[channel.topic] = due
            continue
        yield from latched.values()
        latched.clear()
        yield due
    yield from latched.values()
