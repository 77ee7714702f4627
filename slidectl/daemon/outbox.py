"""What a connection still has to send: lines in order, with a bound on what each subscription may have waiting.

A full share gives up its oldest line, so the newest is always kept. A line may be put as what makes it, and then costs
nothing when it is given up. Knows no socket and no JSON.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

MOST_BYTES = 8 * 1024 * 1024
"""Bound of one share whatever its queue length, for topics of large messages."""
_TIDY_AT = 512
_MEASURED = 16
"""Of so many lines of a share that are not made yet, one is made at once, to know how large they are."""
_UNMADE = 4
"""Bytes of memory that a message takes for each byte of its line."""

Content = bytes | Callable[[], bytes]
"""A line, or what makes it."""


class Line:
    """One line that waits. A line that was given up stays in the order, empty, until it is tidied away."""

    __slots__ = ("content", "share", "size")

    def __init__(self, content: Content, share: Share | None, size: int) -> None:
        self.content = content
        self.share = share
        self.size = size


class Share:
    """What one subscription has waiting in an outbox: at most `limit` lines. `dropped` counts since the last report."""

    __slots__ = ("_length", "_unmeasured", "dropped", "limit", "lines", "size", "topic")

    def __init__(self, topic: str, limit: int) -> None:
        self.topic = topic
        self.limit = limit
        self.lines: deque[Line] = deque()
        self.size = 0
        self.dropped = 0
        self._unmeasured = 0
        self._length = 0

    def line(self, content: Content) -> Line:
        """A line of this share. Its size is known, or that of the last that was measured."""
        if not isinstance(content, bytes):
            self._unmeasured -= 1
            if self._unmeasured >= 0:
                return Line(content, self, _UNMADE * self._length)
            self._unmeasured = _MEASURED - 1
            content = content()
            self._length = len(content)
        return Line(content, self, len(content))


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
        self._order.append(Line(data, None, len(data)))

    def put_in(self, share: Share, content: Content) -> None:
        """A line of a subscription; the share's oldest make room for it."""
        line = share.line(content)
        lines = share.lines
        while lines and (len(lines) >= share.limit or share.size + line.size > MOST_BYTES):
            share.dropped += 1
            self._give_up(share)
        lines.append(line)
        self._order.append(line)
        share.size += line.size

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
                self.unbounded -= line.size
            data = line.content if isinstance(line.content, bytes) else line.content()
            taken.append(data)
            size += len(data)
        return b"".join(taken)

    def _leave_share(self, line: Line, share: Share, taken: list[bytes]) -> None:
        if not line.content:
            self._given_up -= 1
            return
        share.lines.popleft()
        share.size -= line.size
        if share.dropped:
            taken.append(self._report(share))
            share.dropped = 0

    def _give_up(self, share: Share) -> None:
        line = share.lines.popleft()
        share.size -= line.size
        line.content = b""
        self._given_up += 1
        if self._given_up > _TIDY_AT and self._given_up * 2 > len(self._order):
            self._order = deque(line for line in self._order if line.content)
            self._given_up = 0
