"""A subscription as a script sees it: an iterator of messages, with a bounded queue of its own.

Asks its client to look at the socket; does no input or output itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slidectl.client.client import Client

DEFAULT_QUEUE = 1000


class Subscription:
    """Messages of one topic, in order. Iterating waits for each without a limit; `get` waits with one.

    `dropped` counts the messages that came faster than they were read and were given up, the oldest first, by the
    daemon or here.
    """

    def __init__(self, client: Client, topic: str, subscription_id: str, queue_length: int) -> None:
        self.topic = topic
        self.id = subscription_id
        self.dropped = 0
        self._client = client
        self._queue: deque[dict[str, Any]] = deque(maxlen=queue_length or DEFAULT_QUEUE)

    def put(self, message: dict[str, Any]) -> None:
        """Called by the client for each message that arrives."""
        if len(self._queue) == self._queue.maxlen:
            self.dropped += 1
        self._queue.append(message)

    def get(self, timeout: float | None = None) -> dict[str, Any]:
        """The next message; waits at most `timeout` wall seconds (the client's by default, `inf` for ever).

        Raises:
            TimedOut: none came. NoDaemon: the daemon went away.
        """
        queue = self._queue
        if not queue:
            self._client.wait_until(lambda: bool(queue), timeout, f"no message on {self.topic}")
        return queue.popleft()

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return self

    def __next__(self) -> dict[str, Any]:
        return self.get(math.inf)

    def __len__(self) -> int:
        """Messages that are here already."""
        return len(self._queue)

    def close(self) -> None:
        """Unsubscribe. Messages that are here already can still be read."""
        self._client.unsubscribe(self)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
