"""The file that messages are recorded into, or one after the other: where each ends, and what is in them."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

from slidectl.recording.codec import Codec
from slidectl.recording.recording_files import RecordingWriter, create

MEGABYTE = 1_000_000
_LOOK_AT_SIZE = 64
"""Messages between two looks at the file's size."""


class SplitFiles:
    """A recording of simulated `length_s` and `size_mb` (10^6 bytes) at most, or with `split` one after the other.

    Each topic is added to a file when its first message comes.

    Args:
        most_files: of a split, how many of the last files are kept; None: all.
        repeat_latched: whether latched messages stand again at the beginning of each file of a split.
        force: write over files that are there.

    Raises:
        UsageError, Refused: as `create` does; of a split, for each of its files.
    """

    def __init__(
        self,
        path: Path,
        compression: str = "none",
        length_s: float | None = None,
        size_mb: float | None = None,
        split: bool = False,
        most_files: int | None = None,
        repeat_latched: bool = False,
        force: bool = False,
    ) -> None:
        self._base = path
        self._compression = compression
        self._length_ns = None if length_s is None else round(length_s * 1e9)
        self._most_bytes = None if size_mb is None else size_mb * MEGABYTE
        self._split = split
        self._most_files = most_files or math.inf
        self._repeat_latched = repeat_latched
        self._force = force
        self._latched: dict[str, tuple[Codec, bytes]] = {}
        self._numbers = 0
        self.files: list[Path] = []
        self.counts: Counter[str] = Counter()
        self.first_ns: int | None = None
        self.last_ns = 0
        self.bytes = 0
        """Of files that are complete."""
        self.is_full = False
        self._writer: RecordingWriter | None = None
        """None after `close`, and after a next file could not be opened."""
        self._open()

    @property
    def path(self) -> Path:
        """The file that is written now."""
        return self.files[-1]

    def _open(self) -> None:
        path = self._base
        if self._split:
            path = path.with_name(f"{path.stem}_{self._numbers}{path.suffix}")
            self._numbers += 1
        self._writer = create(path, self._compression, self._force)
        self.files.append(path)
        self._topics: dict[str, Any] = {}
        self._begin_ns: int | None = None
        if len(self.files) > self._most_files:
            gone = self.files.pop(0)
            self.bytes -= gone.stat().st_size
            gone.unlink()

    def write(self, topic: str, codec: Codec, latching: bool, time_ns: int, raw: bytes) -> None:
        """A message; `latching`: it was published before the subscription. Raises OSError, Refused."""
        if self._ends(time_ns):
            if not self._split:
                self.is_full = True
                return
            self.close()
            self._open()
        if self._begin_ns is None:
            self._begin_ns = time_ns
            if self._repeat_latched:
                for name, (kind, message) in self._latched.items():
                    self._put(name, kind, True, time_ns, message)
        if latching or topic in self._latched:
            self._latched[topic] = codec, raw
        self._put(topic, codec, latching, time_ns, raw)
        self.counts[topic] += 1
        self.first_ns = time_ns if self.first_ns is None else min(self.first_ns, time_ns)
        self.last_ns = max(self.last_ns, time_ns)

    def _put(self, topic: str, codec: Codec, latching: bool, time_ns: int, raw: bytes) -> None:
        assert self._writer is not None
        handle = self._topics.get(topic)
        if handle is None:
            handle = self._topics[topic] = self._writer.add(topic, codec, latching)
        self._writer.write(handle, time_ns, raw)

    def _ends(self, time_ns: int) -> bool:
        if self._length_ns is not None and self._begin_ns is not None and time_ns - self._begin_ns >= self._length_ns:
            return True
        if self._most_bytes is None or self.counts.total() % _LOOK_AT_SIZE:
            return False
        return self._writer is not None and self._writer.size >= self._most_bytes

    def flush(self) -> None:
        """Raises OSError."""
        if self._writer is not None:
            self._writer.flush()

    def close(self) -> None:
        """Complete the file. Harmless when that was done. Raises OSError."""
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            writer.close()
        finally:
            self.bytes += self.path.stat().st_size
