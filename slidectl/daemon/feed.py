"""One topic on its way to one connection: subscribed once however often it was asked for, throttled and queued.

Also the publications themselves, each turned into a line once, whatever the number of its subscribers.
"""

from __future__ import annotations

import time
from typing import Any

from slidectl.client.lines import encode
from slidectl.daemon.connection import Connection
from slidectl.daemon.outbox import Share
from slidectl.simulation.topics import Subscription

DEFAULT_QUEUE = 1000
MOST_QUEUE = 100_000


class Publication:
    """A message on its way to clients."""

    __slots__ = ("_line", "message", "topic")

    def __init__(self, topic: str, message: dict[str, Any]) -> None:
        self.topic = topic
        self.message = message
        self._line = b""

    def line(self) -> bytes:
        """The `publish` line, made when first asked for."""
        if not self._line:
            self._line = encode({"op": "publish", "topic": self.topic, "msg": self.message})
        return self._line


class Publications:
    """Remembers the last one: its subscribers come one after the other and all get the same.

    Keeping the message itself, not its id, makes the comparison safe.
    """

    __slots__ = ("_last",)

    def __init__(self) -> None:
        self._last = Publication("", {})

    def of(self, topic: str, message: dict[str, Any]) -> Publication:
        """The publication of the message."""
        if message is not self._last.message or topic != self._last.topic:
            self._last = Publication(topic, message)
        return self._last


class Feed:
    """What one connection gets of one topic. Asked for more than once, the most generous of the wishes counts."""

    __slots__ = ("_connection", "_next_s", "_period_s", "_publications", "_wishes", "share", "subscription", "topic")

    def __init__(self, topic: str, connection: Connection, publications: Publications) -> None:
        self.topic = topic
        self.share = Share(topic, DEFAULT_QUEUE)
        self.subscription: Subscription | None = None
        self._connection = connection
        self._publications = publications
        self._wishes: dict[str | None, tuple[float, int]] = {}
        self._period_s = 0.0
        self._next_s = 0.0

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
        self._period_s = min(period for period, _ in self._wishes.values())
        self.share.limit = max(limit for _, limit in self._wishes.values())

    def take(self, message: dict[str, Any]) -> None:
        """A message was published."""
        if self._period_s:
            now = time.monotonic()
            if now < self._next_s:
                return
            self._next_s = now + self._period_s
        publication = self._publications.of(self.topic, message)
        if self._connection.is_blocked and self._is_regular():
            self._connection.post(self.share, publication.line)
        else:
            self._connection.post(self.share, publication.line())

    def _is_regular(self) -> bool:
        """True when only the simulation publishes: its messages are all about as large as the last one."""
        return self.subscription is not None and self.subscription.topic.is_inside

    def close(self) -> None:
        """End the subscription."""
        if self.subscription is not None:
            self.subscription.close()
