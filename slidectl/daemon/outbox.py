"""What waits for clients: the last lines of each topic, kept once for all who read it, and the answers of each client.

A reader is a place in the lines of a topic. One that stops costs no work and no memory of its own: the lines that were
given up since are counted when it reads again. Knows no socket and no JSON.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import islice
from operator import itemgetter
from typing import Any

MOST_BYTES = 8 * 1024 * 1024
"""Bound of what one topic keeps whatever the queue lengths, for topics of large messages."""
_TIDY_AT = 512
_LOOK_EVERY = 128
_LOOK_BYTES = 1024 * 1024
_PIECE_LINES, _FEWEST_LINES = 256, 16
"""Lines of a piece that are looked at together, and of one topic at least."""

Reader = Any
"""Whoever is to be woken when a topic has a new line: a connection."""
Entry = tuple[int, bytes, "Share | None"]
"""A line that waits, with its number; without a share it is for one client alone."""


class Tally:
    """Numbers all lines of a daemon, so that each client gets what it has waiting in the order of making.

    Counts also the bytes that all channels keep.
    """

    __slots__ = ("kept", "last", "piece")

    def __init__(self) -> None:
        self.kept = 0
        self.last = 0
        self.piece: tuple[Any, bytes, list[int]] = (None, b"", [])
        """The piece that was last made of lines of topics alone: what it begins with, its bytes, the places after it.
        Readers who keep up with the same topics come one after the other, and all get the same."""

    def next(self) -> int:
        """One more."""
        self.last += 1
        return self.last


class Channel:
    """The lines of one topic that its readers may still want, the newest. `first` and `end` count lines since ever."""

    __slots__ = (
        "_base",
        "_lines",
        "_look_at",
        "_look_size",
        "_order",
        "_tally",
        "end",
        "first",
        "readers",
        "size",
        "topic",
    )

    def __init__(self, topic: str, tally: Tally) -> None:
        self.topic = topic
        self.readers: dict[Reader, Share] = {}
        self.first = 0
        """Index of the oldest line that is kept."""
        self.end = 0
        """Index of the next line to come."""
        self.size = 0
        """Bytes that are kept."""
        self._tally = tally
        # Two flat lists, and not tuples or objects for each line: the garbage collector passes them by.
        self._lines: list[bytes] = []
        self._order: list[int] = []
        self._base = 0
        """Index of what stands first in the lists; lines before `first` are empty there."""
        self._look_at = _LOOK_EVERY
        self._look_size = _LOOK_BYTES

    def put(self, line: bytes) -> None:
        """A new line. Those that nobody can get any more make room."""
        self._lines.append(line)
        self._order.append(self._tally.next())
        self.end += 1
        self.size += len(line)
        self._tally.kept += len(line)
        if self.end >= self._look_at or self.size >= self._look_size:
            self.tidy()

    def tidy(self) -> None:
        """Give up what all have read, what is more than any of them may have waiting, and what is too large in all."""
        self._give_up(min((share.wanted for share in self.readers.values()), default=self.end))
        while self.size > MOST_BYTES and self.first < self.end - 1:
            self._give_up(self.first + 1)
        self._look_at = self.end + _LOOK_EVERY
        self._look_size = min(MOST_BYTES, max(_LOOK_BYTES, self.size * 5 // 4))

    def halve(self) -> None:
        """Give up the older half, to make room for others."""
        self._give_up((self.first + self.end + 1) // 2)

    def _give_up(self, until: int) -> None:
        lines, base = self._lines, self._base
        size = self.size
        for position in range(self.first - base, until - base):
            self.size -= len(lines[position])
            lines[position] = b""
        self._tally.kept -= size - self.size
        self.first = max(self.first, until)
        gone = self.first - base
        if gone > _TIDY_AT and gone * 2 > len(lines):
            del lines[:gone]
            del self._order[:gone]
            self._base = self.first

    def lines(self, begin: int, end: int) -> tuple[list[int], list[bytes]]:
        """Numbers and lines from index `begin` to before `end`."""
        place = slice(begin - self._base, end - self._base)
        return self._order[place], self._lines[place]


class Share:
    """One reader's place in a channel. At most `limit` lines wait for it; what is older is lost to it."""

    __slots__ = ("channel", "limit", "next")

    def __init__(self, channel: Channel, limit: int) -> None:
        self.channel = channel
        self.limit = limit
        self.next = channel.end
        """Index of the line that it gets next, if that is still kept."""

    @property
    def waits(self) -> bool:
        """True while there is something to be sent: lines, or the news that they are lost."""
        return self.next < self.channel.end

    @property
    def wanted(self) -> int:
        """Index of the oldest line that it may still get."""
        return max(self.next, self.channel.end - self.limit)

    def skip(self) -> int:
        """Go on to the oldest line that there is for it. Returns how many were lost."""
        oldest = max(self.wanted, self.channel.first)
        lost = oldest - self.next
        self.next = oldest
        return lost


class Outbox:
    """What one client gets, in order. `report` makes the line that tells of so many lost lines of a topic."""

    def __init__(self, report: Callable[[str, int], bytes], tally: Tally) -> None:
        self._report = report
        self._tally = tally
        self._own: deque[Entry] = deque()
        self._shares: dict[Share, None] = {}
        self.unbounded = 0
        """Bytes of lines that are for this client alone (answers, refusals): these are never given up."""

    def __bool__(self) -> bool:
        return bool(self._own) or any(share.waits for share in self._shares)

    def put(self, data: bytes) -> None:
        """A line that must arrive."""
        self.unbounded += len(data)
        self._own.append((self._tally.next(), data, None))

    def join(self, share: Share) -> None:
        """The lines of this share are to be sent from now on."""
        self._shares[share] = None

    def leave(self, share: Share) -> None:
        """What the share has waiting is not sent, and its losses are not told."""
        self._shares.pop(share, None)

    def retire(self, share: Share) -> None:
        """What the share has waiting is sent, and then nothing more."""
        self.leave(share)
        lost = share.skip()
        entries: list[Entry] = [(number, line, None) for number, line, _ in _window(share, share.channel.end)]
        if lost:
            entries.insert(
                0, (entries[0][0] if entries else self._tally.next(), self._report(share.channel.topic, lost), None)
            )
        self.unbounded += sum(len(line) for _, line, _ in entries)
        self._own = deque(sorted([*self._own, *entries], key=_number))

    def clear(self) -> None:
        """Nobody will read any of it."""
        self._own.clear()
        self._shares.clear()
        self.unbounded = 0

    def take(self, most: int) -> bytes:
        """The next lines as one piece of about `most` bytes, with a report before the first line after a gap."""
        waiting = [share for share in self._shares if share.waits]
        if not waiting:
            return b"".join(self._take_own(most))
        losses = {share: lost for share in waiting if (lost := share.skip())}
        if losses or self._own:
            return self._make_piece(waiting, losses, most)
        key = (self._tally.last, most, [(share.channel, share.next) for share in waiting])
        known, piece, places = self._tally.piece
        if key == known:
            for share, place in zip(waiting, places, strict=True):
                share.next = place
            return piece
        piece = self._make_piece(waiting, losses, most)
        self._tally.piece = (key, piece, [share.next for share in waiting])
        return piece

    def _make_piece(self, waiting: list[Share], losses: dict[Share, int], most: int) -> bytes:
        entries, before = self._next_entries(waiting)
        taken: list[bytes] = []
        size = 0
        for number, line, share in entries:
            if size >= most or number >= before:
                break
            if share is None:
                self._own.popleft()
                self.unbounded -= len(line)
            else:
                if share in losses:
                    taken.append(self._report(share.channel.topic, losses.pop(share)))
                share.next += 1
            taken.append(line)
            size += len(line)
        for share, lost in losses.items():
            if share.waits:
                share.next -= lost  # it is told with the first line, in a later piece
            else:
                taken.append(self._report(share.channel.topic, lost))
        return b"".join(taken)

    def _next_entries(self, waiting: list[Share]) -> tuple[list[Entry], int]:
        """The next lines in order, so many of each kind; and the number before which none is missing."""
        entries: list[Entry] = []
        before = self._tally.last + 1
        most = max(_FEWEST_LINES, _PIECE_LINES // len(waiting))
        for share in waiting:
            end = min(share.channel.end, share.next + most)
            entries += _window(share, end)
            if end < share.channel.end:
                before = min(before, entries[-1][0] + 1)
        if self._own:
            entries += islice(self._own, _PIECE_LINES)
            if len(self._own) > _PIECE_LINES:
                before = min(before, entries[-1][0] + 1)
        if len(waiting) > 1 or self._own:
            entries.sort(key=_number)
        return entries, before

    def _take_own(self, most: int) -> list[bytes]:
        own = self._own
        taken: list[bytes] = []
        size = 0
        while own and size < most:
            line = own.popleft()[1]
            taken.append(line)
            size += len(line)
        self.unbounded -= size
        return taken


def _window(share: Share, end: int) -> list[Entry]:
    order, lines = share.channel.lines(share.next, end)
    return [(number, line, share) for number, line in zip(order, lines, strict=True)]


_number = itemgetter(0)
