"""Topics on their way to clients: each message turned into a line once, whatever the number of its readers.

A connection subscribes a topic once, however often it was asked for. Those without a throttle share the lines of the
topic; one with a throttle has lines of its own.
"""

from __future__ import annotations

import time
from typing import Any

from slidectl.client.lines import LONGEST_LINE, encode
from slidectl.daemon.connection import Connection
from slidectl.daemon.outbox import Channel, Share, Tally
from slidectl.errors import MessageRefused
from slidectl.simulation.topics import Subscription, Topics

DEFAULT_QUEUE = 1000
MOST_QUEUE = 100_000
MOST_BYTES_IN_ALL = 64 * 1024 * 1024
"""Bound of the lines of all topics together."""


def _line(topic: str, message: dict[str, Any]) -> bytes:
    """Raises MessageRefused: what came in fitted a line, but not all text is as long when it is sent."""
    line = encode({"op": "publish", "topic": topic, "msg": message})
    if len(line) > LONGEST_LINE:
        raise MessageRefused(f"a message of {len(line)} bytes on {topic} does not fit a line of {LONGEST_LINE}")
    return line


class TopicLines(Channel):
    """The lines of a topic for all who read it without a throttle."""

    __slots__ = ("_publications",)

    def __init__(self, topic: str, publications: Publications) -> None:
        super().__init__(topic, publications.tally)
        self._publications = publications

    def take(self, message: dict[str, Any]) -> None:
        """A message was published. The one callback of all subscriptions: the graph calls it once for all of them."""
        self.put(_line(self.topic, message))
        self._publications.note(self)


class ThrottledLines(Channel):
    """The lines of a topic for one reader, with at least `period_s` of wall time between two of them."""

    __slots__ = ("_next_s", "_publications", "period_s")

    def __init__(self, topic: str, publications: Publications, period_s: float) -> None:
        super().__init__(topic, publications.tally)
        self._publications = publications
        self._next_s = 0.0
        self.period_s = period_s

    def take(self, message: dict[str, Any]) -> None:
        """A message was published."""
        now = time.monotonic()
        if now >= self._next_s:
            self._next_s = now + self.period_s
            self.put(self._publications.line_of(self.topic, message))
            self._publications.note(self)


class Publications:
    """The lines of all topics that clients read. `fresh` are those that have new ones since their readers were told."""

    def __init__(self) -> None:
        self.tally = Tally()
        self.fresh: dict[Channel, None] = {}
        self._channels: dict[Channel, None] = {}
        self._shared: dict[str, TopicLines] = {}
        # The last line that was made for readers with a throttle, which come one after the other and all want the same.
        # Keeping the message itself, not its id, makes the comparison safe.
        self._last: tuple[str, dict[str, Any], bytes] = ("", {}, b"")

    def shared(self, topic: str) -> TopicLines:
        """The lines of the topic, for readers without a throttle."""
        channel = self._shared.get(topic)
        if channel is None:
            channel = self._shared[topic] = TopicLines(topic, self)
            self._channels[channel] = None
        return channel

    def throttled(self, topic: str, period_s: float) -> ThrottledLines:
        """Lines of the topic for one reader."""
        channel = ThrottledLines(topic, self, period_s)
        self._channels[channel] = None
        return channel

    def line_of(self, topic: str, message: dict[str, Any]) -> bytes:
        """The line of a message, made when it is first asked for."""
        last_topic, last_message, line = self._last
        if message is not last_message or topic != last_topic:
            line = _line(topic, message)
            self._last = (topic, message, line)
        return line

    def note(self, channel: Channel) -> None:
        """It has a new line."""
        self.fresh[channel] = None
        if self.tally.kept > MOST_BYTES_IN_ALL:
            self._make_room()

    def leave(self, channel: Channel, reader: Connection) -> None:
        """It reads the channel no more."""
        channel.readers.pop(reader, None)
        channel.tidy()
        if not channel.readers:
            self._channels.pop(channel, None)
            self.fresh.pop(channel, None)
            if self._shared.get(channel.topic) is channel:
                del self._shared[channel.topic]

    def tidy(self) -> None:
        """Now and then: give up what all have read."""
        self._last = ("", {}, b"")
        for channel in self._channels:
            channel.tidy()

    def _make_room(self) -> None:
        for channel in self._channels:
            channel.tidy()
        while self.tally.kept > MOST_BYTES_IN_ALL:
            max(self._channels, key=_size).halve()


def _size(channel: Channel) -> int:
    return channel.size


class Feed:
    """What one connection gets of one topic. Asked for more than once, the most generous of the wishes counts."""

    __slots__ = ("_connection", "_publications", "_share", "_subscription", "_wishes", "topic")

    def __init__(self, topic: str, connection: Connection, publications: Publications) -> None:
        self.topic = topic
        self._connection = connection
        self._publications = publications
        self._wishes: dict[str | None, tuple[float, int]] = {}
        self._share: Share | None = None
        self._subscription: Subscription | None = None

    def begin(self, topics: Topics, kind: str | None, node: str) -> None:
        """Subscribe, as was wanted before. Raises as `Topics.subscribe`."""
        channel = self._begin_to_read()
        try:
            self._subscription = topics.subscribe(self.topic, kind, node, channel.take, self._take_latched)
        except BaseException:
            self.close()
            raise

    def want(self, wish_id: str | None, throttle_ms: float, queue_length: int) -> None:
        """Add a wish, or change that of the same id: wall ms between two messages at least, messages that may wait."""
        limit = min(queue_length, MOST_QUEUE) if queue_length > 0 else DEFAULT_QUEUE
        self._wishes[wish_id] = (max(0.0, throttle_ms) / 1000, limit)
        self._update()

    def unwant(self, wish_id: str | None) -> bool:
        """Take a wish back (None: all of them). True when none is left."""
        if wish_id is None:
            self._wishes.clear()
        self._wishes.pop(wish_id, None)
        if self._wishes:
            self._update()
        return not self._wishes

    def _update(self) -> None:
        """The wishes have changed."""
        if self._share is None or self._subscription is None:
            return
        period_s, limit = self._wish()
        channel = self._share.channel
        was_s = channel.period_s if isinstance(channel, ThrottledLines) else 0.0
        if bool(was_s) == bool(period_s):
            self._share.limit = limit
            if isinstance(channel, ThrottledLines):
                channel.period_s = period_s
            return
        self._connection.outbox.retire(self._share)
        self._publications.leave(channel, self._connection)
        self._subscription.redirect(self._begin_to_read().take)

    def _wish(self) -> tuple[float, int]:
        """Wall seconds between two messages, and messages that may wait."""
        wishes = self._wishes.values()
        return min(period_s for period_s, _ in wishes), max(limit for _, limit in wishes)

    def _begin_to_read(self) -> TopicLines | ThrottledLines:
        period_s, limit = self._wish()
        publications = self._publications
        channel = publications.throttled(self.topic, period_s) if period_s else publications.shared(self.topic)
        self._share = channel.readers[self._connection] = Share(channel, limit)
        self._connection.outbox.join(self._share)
        return channel

    def _take_latched(self, message: dict[str, Any]) -> None:
        """What was published before: it is for this connection alone."""
        self._connection.send(self._publications.line_of(self.topic, message))

    def close(self) -> None:
        """End the subscription; what waits is not sent."""
        if self._subscription is not None:
            self._subscription.close()
        if self._share is not None:
            self._connection.outbox.leave(self._share)
            self._publications.leave(self._share.channel, self._connection)
