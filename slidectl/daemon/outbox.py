"""Outgoing lines: the last lines of each topic, stored once for all readers, and the answers of each client.

A reader is a position in the lines of a topic. A reader that stops costs no work and no memory of its own: dropped
lines are counted when it reads again. A connection subscribes to a topic once, for any number of its requests.
Requests without a throttle share the lines of the topic; one with a throttle has lines of its own. No sockets here.
"""

from __future__ import annotations

import heapq
import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from typing import Any, Protocol

from slidectl.errors import MessageRefused
from slidectl.simulation.loop import RunState
from slidectl.simulation.topics import Topics, TopicSubscription
from slidectl.wire.json_lines import LONGEST_LINE, encode

DEFAULT_QUEUE = 1000
MOST_QUEUE = 100_000
MOST_BYTES = 8 * 1024 * 1024
"""The most bytes of one topic for any queue lengths, for topics of large messages."""
MOST_BYTES_IN_ALL = 64 * 1024 * 1024
"""The most bytes of all topics together."""
_TIDY_EVERY = 128

Message = dict[str, Any]
Stamp = Callable[[], Message]
"""Returns the simulated time as a message stamp."""
Entry = tuple[int, bytes, "ReaderPosition | None"]
"""A waiting line with its number; without a share it is for one client alone."""


class Reader(Protocol):
    """The receiver of lines: a connection."""

    outbox: Outbox
    node: str

    @property
    def unread(self) -> int:
        """Bytes that wait for this reader alone."""

    @property
    def is_overfull(self) -> bool:
        """True while too much waits for it: only answers to it should be added."""

    def send(self, line: bytes) -> None:
        """Send a line to this reader alone; it must arrive."""

    def check_end(self) -> None:
        """Check, between two cycles, whether the connection can end: its session has fewer open requests."""


class Publications:
    """The lines of all topics that clients read. `fresh` are the channels with lines not yet given to readers."""

    def __init__(self, run: RunState | None = None, monotonic: Callable[[], float] = time.monotonic) -> None:
        """`run` is notified of news for readers; `monotonic` is the clock of throttles, in s."""
        self.run = run or RunState()
        self.monotonic = monotonic
        self.fresh: dict[Channel, None] = {}
        self.held: dict[Channel, None] = {}
        """Channels with a message that came sooner than their throttle allows."""
        self._due_s = math.inf
        """The time at which the first of these is due, or earlier, on the clock of throttles."""
        self.kept = 0
        """Bytes of all channels."""
        self.last = 0
        """Number of the daemon's last line: each client gets its waiting lines in the order of creation."""
        self.piece: tuple[Any, bytes, list[int]] = (None, b"", [])
        """The last piece that was made of topic lines alone: its key, its bytes, the positions after it.
        Readers that keep up with the same topics follow each other, and all get the same piece."""
        self._channels: dict[Channel, None] = {}
        self._shared: dict[tuple[str, bool], Channel] = {}

    def channel(self, topic: str, stamp: Stamp | None = None, period_s: float = 0.0) -> Channel:
        """The lines of the topic: the shared ones, or with a period new ones for one reader."""
        key = topic, stamp is not None
        channel = None if period_s else self._shared.get(key)
        if channel is None:
            channel = Channel(topic, self, stamp, period_s)
            self._channels[channel] = None
            if not period_s:
                self._shared[key] = channel
        return channel

    def note(self, channel: Channel) -> None:
        """Note a new line of a channel."""
        self.fresh[channel] = None
        if self.run.news_wanted:
            for reader in channel.readers:
                self.run.note_message(reader.node)
        if self.kept > MOST_BYTES_IN_ALL:
            self.tidy()
            while self.kept > MOST_BYTES_IN_ALL:
                largest = max(self._channels, key=lambda one: one.size)
                largest.give_up((largest.first + largest.end + 1) // 2)

    def hold(self, channel: Channel) -> None:
        """Note that a channel holds a message for later, or that its time is now sooner."""
        self.held[channel] = None
        self._due_s = min(self._due_s, channel.due_s)

    def release(self) -> float:
        """Release the held messages that are due. Returns the s until the next; infinity when none is held."""
        if not self.held:
            return math.inf
        now = self.monotonic()
        if now >= self._due_s:
            self._due_s = math.inf
            for channel in list(self.held):
                if channel.due_s <= now:
                    channel.release()
                else:
                    self._due_s = min(self._due_s, channel.due_s)
        return self._due_s - now

    def leave(self, channel: Channel, reader: Reader) -> None:
        """Remove a reader from a channel."""
        channel.readers.pop(reader, None)
        channel.tidy()
        if not channel.readers:
            self._channels.pop(channel, None)
            self.fresh.pop(channel, None)
            self.held.pop(channel, None)
            key = channel.topic, channel.stamp is not None
            if self._shared.get(key) is channel:
                del self._shared[key]

    def tidy(self) -> None:
        """Drop lines that all readers have read."""
        for channel in self._channels:
            channel.tidy()


class Channel:
    """The newest lines of one topic that its readers may still get. `first` and `end` count all lines ever.

    With `period_s` two lines are at least that many wall seconds apart: the newest message in that time waits for its
    end, so that a reader gets the last one of a topic that stops. `stamp` returns the simulated time for
    each line, None for lines without it.
    """

    def __init__(
        self, topic: str, publications: Publications, stamp: Stamp | None = None, period_s: float = 0.0
    ) -> None:
        self.topic = topic
        self.stamp = stamp
        self.period_s = period_s
        self.readers: dict[Reader, ReaderPosition] = {}
        self.first = 0
        """Index of the oldest stored line."""
        self.end = 0
        """Index of the next line to come."""
        self.size = 0
        """Stored bytes."""
        self.lines: list[tuple[int, bytes]] = []
        """Lines from `first` to before `end`, each with its number."""
        self._publications = publications
        self.due_s = -math.inf
        """The earliest time of the next line, on the clock of throttles."""
        self._held: tuple[Message, Stamp | None] | None = None
        self._tidy_at = _TIDY_EVERY

    def publish(self, message: Message) -> None:
        """Take a published message. All readers of the channel share this callback: the graph calls it once for all.

        Raises:
            MessageRefused: the message came on a line of legal length, but its outgoing line is too long.
        """
        if self.period_s:
            now = self._publications.monotonic()
            if now < self.due_s:
                time = None if self.stamp is None else self.stamp()
                self._held = message, None if time is None else lambda: time
                self._publications.hold(self)
                return
            self.due_s = now + self.period_s
            self._forget_held()
        self.add(_line(self.topic, message, self.stamp))
        self._publications.note(self)

    def release(self) -> None:
        """Add the held message, which is due."""
        if (held := self._held) is not None:
            self._forget_held()
            self.due_s = self._publications.monotonic() + self.period_s
            with suppress(MessageRefused):  # a publisher gets this error when its message is not held
                self.add(_line(self.topic, *held))
                self._publications.note(self)

    def _forget_held(self) -> None:
        self._held = None
        self._publications.held.pop(self, None)

    def add(self, line: bytes) -> None:
        """Add a line. Lines that no reader can get any more are dropped."""
        self._publications.last += 1
        self._publications.kept += len(line)
        self.lines.append((self._publications.last, line))
        self.end += 1
        self.size += len(line)
        if self.end >= self._tidy_at or self.size > MOST_BYTES:
            self.tidy()

    def tidy(self) -> None:
        """Drop lines that all have read, lines beyond all readers' limits, and the oldest above MOST_BYTES."""
        self.give_up(min((share.wanted for share in self.readers.values()), default=self.end))
        size, until = self.size, self.first
        while size > MOST_BYTES and until < self.end - 1:
            size -= len(self.lines[until - self.first][1])
            until += 1
        self.give_up(until)
        self._tidy_at = self.end + _TIDY_EVERY

    def give_up(self, until: int) -> None:
        """Drop the lines before this index."""
        count = max(0, until - self.first)
        size = sum(len(line) for _, line in islice(self.lines, count))
        del self.lines[:count]
        self.first += count
        self.size -= size
        self._publications.kept -= size


class ReaderPosition:
    """One reader's position in a channel. At most `limit` lines wait for it; older ones are lost to it."""

    def __init__(self, channel: Channel, limit: int) -> None:
        self.channel = channel
        self.limit = limit
        self.next = channel.end
        """Index of the line that it gets next, if that is still stored."""

    @property
    def waits(self) -> bool:
        """True while there is something to send: lines, or a report of lost ones."""
        return self.next < self.channel.end

    @property
    def wanted(self) -> int:
        """Index of the oldest line that it may still get."""
        return max(self.next, self.channel.end - self.limit)

    def skip(self) -> int:
        """Move to the oldest line available to it. Returns the number of lost lines."""
        oldest = max(self.wanted, self.channel.first)
        lost = oldest - self.next
        self.next = oldest
        return lost

    def entries(self) -> Iterator[Entry]:
        """The lines from its position on. The position may change meanwhile."""
        lines = self.channel.lines
        for index in range(self.next - self.channel.first, len(lines)):
            yield *lines[index], self


class Outbox:
    """The lines for one client, in order. `report` makes the line about a number of lost lines of a topic."""

    def __init__(self, report: Callable[[str, int], bytes], publications: Publications) -> None:
        self._report = report
        self._publications = publications
        self._own: deque[Entry] = deque()
        self._shares: dict[ReaderPosition, None] = {}
        self.unbounded = 0
        """Bytes of lines for this client alone (answers, refusals), which are never dropped."""

    def __bool__(self) -> bool:
        return bool(self._own) or any(share.waits for share in self._shares)

    def add(self, line: bytes) -> None:
        """Add a line that must arrive."""
        self.unbounded += len(line)
        self._publications.last += 1
        self._own.append((self._publications.last, line, None))
        if self._publications.run.news_wanted:
            self._publications.run.note_message()

    def join(self, share: ReaderPosition) -> None:
        """Send the lines of this share from now on."""
        self._shares[share] = None

    def leave(self, share: ReaderPosition) -> None:
        """Drop the share, with its waiting lines and its losses."""
        self._shares.pop(share, None)

    def retire(self, share: ReaderPosition) -> None:
        """Drop the share, but send its waiting lines first."""
        self.leave(share)
        if lost := share.skip():
            self.add(self._report(share.channel.topic, lost))
        for _, line, _ in share.entries():
            self.add(line)

    def clear(self) -> None:
        """Drop all lines: the client reads no more."""
        self._own.clear()
        self._shares.clear()
        self.unbounded = 0

    def next_piece(self, most: int) -> bytes:
        """The next lines as one piece of about `most` bytes, with a report before the first line after a gap."""
        waiting = [share for share in self._shares if share.waits]
        if not waiting:
            return self._next_answers(most)
        losses = {share: lost for share in waiting if (lost := share.skip())}
        if losses or self._own:
            return self._make_piece(waiting, losses, most)
        key = (self._publications.last, most, [(share.channel, share.next) for share in waiting])
        known, piece, places = self._publications.piece
        if key == known:
            for share, place in zip(waiting, places, strict=True):
                share.next = place
            return piece
        piece = self._make_piece(waiting, losses, most)
        self._publications.piece = (key, piece, [share.next for share in waiting])
        return piece

    def _next_answers(self, most: int) -> bytes:
        """The next answers, when no topic has lines: there is nothing to merge."""
        taken: list[bytes] = []
        size = 0
        while self._own and size < most:
            line = self._own.popleft()[1]
            taken.append(line)
            size += len(line)
        self.unbounded -= size
        return b"".join(taken)

    def _make_piece(self, waiting: list[ReaderPosition], losses: dict[ReaderPosition, int], most: int) -> bytes:
        taken: list[bytes] = []
        size = own = 0
        for _, line, share in heapq.merge(self._own, *(share.entries() for share in waiting)):
            if size >= most:
                break
            if share is None:
                own += 1
                self.unbounded -= len(line)
            else:
                if share in losses:
                    taken.append(self._report(share.channel.topic, losses.pop(share)))
                share.next += 1
            taken.append(line)
            size += len(line)
        for _ in range(own):
            self._own.popleft()
        for share, lost in losses.items():
            if share.waits:
                share.next -= lost  # reported with the first line, in a later piece
            else:
                taken.append(self._report(share.channel.topic, lost))
        return b"".join(taken)


class TopicFeed:
    """One connection's subscription of one topic. Of several requests the most generous values are used."""

    def __init__(self, topic: str, reader: Reader, publications: Publications, now: Stamp) -> None:
        """`now` returns the simulated time, for requests that want it with each message."""
        self.topic = topic
        self._reader = reader
        self._publications = publications
        self._now = now
        self._requests: dict[str | None, tuple[float, int, bool]] = {}
        self._share: ReaderPosition | None = None
        self._subscription: TopicSubscription | None = None

    def begin(self, topics: Topics, kind: str | None, node: str) -> None:
        """Subscribe, after a first `want`. Raises as `Topics.subscribe`."""
        publish = self._begin_to_read().publish
        try:
            self._subscription = topics.subscribe(self.topic, kind, node, publish, self._send_latched)
        except BaseException:
            self.close()
            raise

    def want(self, wish_id: str | None, throttle_ms: float, queue_length: int, stamped: bool = False) -> None:
        """Add a request, or change that of the same id.

        The values: least wall ms between two messages, most waiting messages, and the simulated time with each message.
        """
        limit = min(queue_length, MOST_QUEUE) if queue_length > 0 else DEFAULT_QUEUE
        self._requests[wish_id] = (max(0.0, throttle_ms) / 1000, limit, stamped)
        self._update()

    def unwant(self, wish_id: str | None) -> bool:
        """Remove a request (None: all of them). Returns True when none is left."""
        if wish_id is None:
            self._requests.clear()
        self._requests.pop(wish_id, None)
        if self._requests:
            self._update()
        return not self._requests

    def _wish(self) -> tuple[float, int, Stamp | None]:
        """Least wall seconds between two messages, most waiting messages, and the source of their time."""
        periods, limits, stamped = zip(*self._requests.values(), strict=True)
        return min(periods), max(limits), self._now if any(stamped) else None

    def _update(self) -> None:
        """Apply changed requests."""
        if self._share is None or self._subscription is None:
            return
        period_s, limit, stamp = self._wish()
        channel = self._share.channel
        if bool(channel.period_s) == bool(period_s) and channel.stamp == stamp:
            self._share.limit = limit
            channel.period_s = period_s
            channel.due_s = min(channel.due_s, self._publications.monotonic() + period_s)
            if channel in self._publications.held:
                self._publications.hold(channel)
            return
        channel.release()
        self._reader.outbox.retire(self._share)
        self._publications.leave(channel, self._reader)
        self._subscription.redirect(self._begin_to_read().publish)

    def _begin_to_read(self) -> Channel:
        period_s, limit, stamp = self._wish()
        channel = self._publications.channel(self.topic, stamp, period_s)
        self._share = channel.readers[self._reader] = ReaderPosition(channel, limit)
        self._reader.outbox.join(self._share)
        return channel

    def _send_latched(self, message: Message) -> None:
        """Send a message that was latched before to this reader alone."""
        self._reader.send(_line(self.topic, message, self._wish()[2], latched=True))

    def close(self) -> None:
        """End the subscription; waiting lines are not sent."""
        if self._subscription is not None:
            self._subscription.close()
        if self._share is not None:
            self._reader.outbox.leave(self._share)
            self._publications.leave(self._share.channel, self._reader)


def _line(topic: str, message: Message, stamp: Stamp | None, latched: bool = False) -> bytes:
    """A publish object. With a time it also says whether it was latched, for clients that publish it again."""
    about = {} if stamp is None else {"time": stamp(), **({"latch": True} if latched else {})}
    line = encode({"op": "publish", "topic": topic, **about, "msg": message})
    if len(line) > LONGEST_LINE:
        raise MessageRefused(f"a message of {len(line)} bytes on {topic} does not fit a line of {LONGEST_LINE}")
    return line
