"""Calls of foreign nodes: what the master has to tell them. One call of a node at a time, the newest of each kind."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from slidectl.errors import SlidectlError
from slidectl.gateways.ros1 import xmlrpc
from slidectl.gateways.tasks import Tasks

_log = logging.getLogger(__name__)

_MOST_AT_ONCE = 50
"""Nodes that are being called at the same time: each call is a descriptor."""


class NodeCalls:
    """What waits, by node. A call that fails is not made again, as with rosmaster."""

    def __init__(self) -> None:
        self._waiting: dict[str, dict[tuple[str, str], tuple[tuple[Any, ...], Callable[[Any], None] | None]]] = {}
        self._tasks = Tasks()
        self._limit = asyncio.Semaphore(_MOST_AT_ONCE)

    def send(self, uri: str, method: str, *arguments: Any, take: Callable[[Any], None] | None = None) -> None:
        """Call `method` of the node at this address, with the master as caller; `take` gets what it answers.

        Of what waits with the same method and first argument (a topic, a parameter) only the newest is sent.
        """
        key = (method, str(arguments[0]))
        waiting = self._waiting.get(uri)
        if waiting is not None:
            waiting.pop(key, None)
            waiting[key] = (arguments, take)
            return
        self._waiting[uri] = {key: (arguments, take)}
        self._tasks.begin(self._send_all(uri))

    def close(self) -> None:
        self._tasks.cancel()

    async def _send_all(self, uri: str) -> None:
        waiting = self._waiting[uri]
        try:
            while waiting:
                key = next(iter(waiting))
                arguments, take = waiting.pop(key)
                async with self._limit:
                    try:
                        answer = await xmlrpc.call(uri, key[0], "/master", *arguments)
                    except SlidectlError as error:
                        _log.info("%s", error)
                        continue
                if take is not None:
                    take(answer)
        finally:
            del self._waiting[uri]
