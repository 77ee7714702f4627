"""What a connection has found out about the graph, and may go by until the daemon says that something has changed.

For a process that does many things on one connection. The daemon says so before it answers the call that made the
change (see `/slidectl/next_change`), so what is remembered is as good as what would be asked for now.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from slidectl.client.client import Client

Found = TypeVar("Found")


class Picture:
    """Findings by key. Call `refresh` before each piece of work: others change the graph too."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._found: dict[Hashable, Any] = {}
        self._notice = ""

    def refresh(self) -> None:
        """Take in what has come since the last call of the client. Raises NoDaemon.

        Where something has, more may be under way; the answer to a call comes behind it all.
        """
        if self._client.take_in():
            self._client.call("/rosapi/get_time")

    def recall(self, key: Hashable, find: Callable[[], Found]) -> Found:
        """What was found for the key, else what `find` finds now by calls of the client."""
        if not self._notice or self._client.is_answered(self._notice):
            self._begin()
        elif key in self._found:
            return self._found[key]  # type: ignore[no-any-return]
        notice = self._notice
        found = find()
        if notice == self._notice and not self._client.is_answered(notice):
            self._found[key] = found
        return found

    def _begin(self) -> None:
        if self._notice:
            self._client.forget(self._notice)
        self._found.clear()
        self._notice = self._client.call_async("/slidectl/next_change")
