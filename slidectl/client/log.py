"""/rosout as a client hears it: collected for whoever listens, while they do.

One subscription for all of them. It ends with the last, unless the connection is to keep it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slidectl.client.subscription import Subscription

if TYPE_CHECKING:
    from slidectl.client.client import Client

TOPIC = "/rosout"
_TYPE = "rosgraph_msgs/Log"

Lines = list[dict[str, Any]]


class Log(Subscription):
    """The subscription. With `keep` it stays, and only the first to listen waits for a round trip."""

    def __init__(self, client: Client, subscription_id: str) -> None:
        super().__init__(client, TOPIC, subscription_id, 0)
        self.keep = False
        self._begun = False
        self._listening: list[tuple[int, Lines]] = []

    def listen(self, level: int) -> Lines:
        """The list that takes the messages of at least `level` from now on. Raises as `Client.subscribe`."""
        lines: Lines = []
        self._listening.append((level, lines))
        if not self._begun:
            try:
                self._client.begin(self, {"type": _TYPE})
            except BaseException:
                self.ignore(lines)
                raise
            self._begun = True
        return lines

    def ignore(self, lines: Lines) -> None:
        """Put nothing more into that list."""
        self._listening = [listener for listener in self._listening if listener[1] is not lines]
        if not self._listening and not self.keep:
            self._begun = False
            self.close()

    def put(self, message: dict[str, Any]) -> None:
        for level, lines in self._listening:
            if message["level"] >= level:
                lines.append(message)


class Listening:
    """A context manager whose value is the list of the messages that come until it is left."""

    __slots__ = ("_level", "_lines", "_log")

    def __init__(self, log: Log, level: int) -> None:
        self._log = log
        self._level = level

    def __enter__(self) -> Lines:
        self._lines = self._log.listen(self._level)
        return self._lines

    def __exit__(self, *_: object) -> None:
        self._log.ignore(self._lines)
