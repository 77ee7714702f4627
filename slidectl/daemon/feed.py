"""One topic on its way to one connection: subscribed once however often it was asked for, throttled and queued.

Also the encoder that turns a publication into a line once, whatever the number of its subscribers.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from slidectl.client.lines import encode
from slidectl.daemon.connection import Connection
from slidectl.daemon.outbox import Share

DEFAULT_QUEUE = 1000
MOST_QUEUE = 100_000


class PublicationEncoder:
    """Remembers the last publication: its subscribers come one after the other and all get the same line.

    Keeping the message itself, not its id, makes the comparison safe.
    """

    __slots__ = ("_line", "_message", "_topic")

    def __init__(self) -> None:
        self._topic = ""
        self._message: dict[str, Any] | None = None
        self._line = b""

    def line(self, topic: str, message: dict[str, Any]) -> bytes:
        """The `publish` line of the message."""
        if message is not self._message or topic != self._topic:
            self._line = encode({"op": "publish", "topic": topic, "msg": message})
            self._topic = topic
            self._message = message
        return self._line


class Feed:
    """What one connection gets of one topic. Asked for more than once, the most generous of the wishes counts."""

    __slots__ = ("_connection", "_encoder", "_next_s", "_period_s", "_wishes", "close", "share", "topic")

    def __init__(self, topic: str, connection: Connection, encoder: PublicationEncoder) -> None:
        self.topic = topic
        self.share = Share(topic, DEFAULT_QUEUE)
        self.close: Callable[[], None] = lambda: None
        self._connection = connection
        self._encoder = encoder
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
        self._connection.post(self.share, self._encoder.line(self.topic, message))
