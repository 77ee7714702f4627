"""What a connection still has to send: lines in order, with a bound on what each subscription may have waiting.

A full share gives up its oldest line, so the newest is always kept. Knows no socket and no JSON.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

MOST_BYTES = 8 * 1024 * 1024
"""Bound of one share whatever its queue length, for topics of large messages."""
_TIDY_AT = 512


class Line:
    """One line that waits. A line that was given up stays in the order, empty, until it is tidied away."""

    __slots__ = ("data", "share")

    def __init__(self, data: bytes, share: Share | None) -> None:
        self.data = data
        self.share = share


class Share:
    """What one subscription has waiting in an outbox: at most `limit` lines. `dropped` counts since the last report."""

    __slots__ = ("dropped", "limit", "lines", "size", "topic")

    def __init__(self, topic: str, limit: int) -> None:
        self.topic = topic
        self.limit = limit
        self.lines: deque[Line] = deque()
        self.size = 0
        self.dropped = 0


class Outbox:
    """Lines in the order in which they were put. `report` makes the line that tells of dropped messages."""

    def __init__(self, report: Callable[[Share], bytes]) -> None:
        self._report = report
        self._order: deque[Line] = deque()
        self._given_up = 0
        self.unbounded = 0
        """Bytes that wait outside any share (answers, refusals): these are never dropped."""

    def __bool__(self) -> bool:
        return bool(self._order)

    def put(self, data: bytes) -> None:
        """A line that must arrive."""
        self.unbounded += len(data)
        self._order.append(Line(data, None))

    def put_in(self, share: Share, data: bytes) -> None:
        """A line of a subscription; the share's oldest make room for it."""
        size = len(data)
        lines = share.lines
        while lines and (len(lines) >= share.limit or share.size + size > MOST_BYTES):
            share.dropped += 1
            self._give_up(share)
        line = Line(data, share)
        lines.append(line)
        self._order.append(line)
        share.size += size

    def forget(self, share: Share) -> None:
        """Give up all that the share has waiting, unreported."""
        share.dropped = 0
        while share.lines:
            self._give_up(share)

    def clear(self) -> None:
        """Nobody will read any of it."""
        for line in self._order:
            if line.share is not None:
                line.share.lines.clear()
                line.share.size = line.share.dropped = 0
        self._order.clear()
        self._given_up = self.unbounded = 0

    def take(self, most: int) -> bytes:
        """The next lines as one piece of about `most` bytes, with a report before the first line after a gap."""
        taken: list[bytes] = []
        size = 0
        while self._order and size < most:
            line = self._order.popleft()
            if line.share is not None:
                self._leave_share(line, line.share, taken)
            else:
                self.unbounded -= len(line.data)
            taken.append(line.data)
            size += len(line.data)
        return b"".join(taken)

    def _leave_share(self, line: Line, share: Share, taken: list[bytes]) -> None:
        if not line.data:
            self._given_up -= 1
            return
        share.lines.popleft()
        share.size -= len(line.data)
        if share.dropped:
            taken.append(self._report(share))
            share.dropped = 0

    def _give_up(self, share: Share) -> None:
        line = share.lines.popleft()
        share.size -= len(line.data)
        line.data = b""
        self._given_up += 1
        if self._given_up > _TIDY_AT and self._given_up * 2 > len(self._order):
            self._order = deque(line for line in self._order if line.data)
            self._given_up = 0
