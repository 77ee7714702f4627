"""The messages of a recording as the rows of a table."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from slidectl.extensions.recording.recording_files import Recording

_SECOND = 10**9


class Rows:
    """The messages of some topics as flat rows: `time` (s), `topic`, and each field by its path.

    If there are several topics, paths begin with the topic. nan becomes None.
    """

    def __init__(self, recording: Recording, topics: set[str]) -> None:
        self._recording = recording
        self._topics = topics

    def columns(self) -> list[str]:
        """All columns in order of first use. All messages are read for that, as arrays may grow."""
        found: dict[str, None] = {"time": None, "topic": None}
        for row in self:
            found.update(dict.fromkeys(row))
        return list(found)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for record in self._recording.records(self._topics):
            prefix = "" if len(self._topics) == 1 else f"{record.channel.topic}/"
            row: dict[str, Any] = {"time": record.time_ns / _SECOND, "topic": record.channel.topic}
            row.update(_flat(prefix, self._recording.message(record)))
            yield row


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value.keys() == {"secs", "nsecs"}:
        yield name, value["secs"] + value["nsecs"] / _SECOND
    elif isinstance(value, dict):
        for key, below in value.items():
            yield from _flat(f"{name}{'' if not name or name.endswith('/') else '.'}{key}", below)
    elif isinstance(value, list):
        for index, below in enumerate(value):
            yield from _flat(f"{name}[{index}]", below)
    else:
        yield name, None if isinstance(value, float) and math.isnan(value) else value
