"""Nodes of ROS 2 in the daemon's graph: a connection for each, under its name."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from typing import NamedTuple

from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.wire.messages import Message

_log = logging.getLogger(__name__)

_LISTED_ONLY_MS = 10**9
"""Throttle of a subscription that only makes a node appear in the graph: after the first message nothing arrives."""


class NodePart(NamedTuple):
    """What a node has in the daemon's graph: topic or service -> type."""

    published: dict[str, str]
    subscribed: dict[str, str]
    services: dict[str, str]


class ForeignNodes:
    """The connections. `call` carries out a call of a service that a foreign node provides."""

    def __init__(
        self,
        connect: Callable[[str], Awaitable[DaemonConnection]],
        call: Callable[[str, str, Message], Awaitable[Message]],
    ) -> None:
        self._connect = connect
        self._call = call
        self._connections: dict[str, DaemonConnection] = {}
        self._parts: dict[str, NodePart] = {}
        self._refused: dict[tuple[str, str, str], str] = {}
        """(node, topic or service, type) -> why the daemon did not take it, for the log to have each reason once.

        Without a topic: the last message that was refused, since a node may send a thousand of these a second.
        """

    def __len__(self) -> int:
        return len(self._connections)

    def connection(self, node: str) -> DaemonConnection | None:
        """The connection of a node that is in the daemon's graph."""
        return self._connections.get(node)

    def publishes(self, node: str, topic: str) -> bool:
        return node in self._parts and topic in self._parts[node].published

    async def settle(self, wanted: dict[str, NodePart]) -> None:
        """Let the daemon's graph have these nodes, and no others. Raises NoDaemon."""
        for name in self._connections.keys() - wanted.keys():
            self._connections.pop(name).close()
            del self._parts[name]
        for name, part in wanted.items():
            if part != self._parts.get(name):
                try:
                    await self._settle(name, part)
                except NoDaemon:
                    raise
                except (Refused, TimedOut) as error:
                    self._note(name, name, "", error)

    async def _settle(self, name: str, wanted: NodePart) -> None:
        daemon = self._connections.get(name)
        if daemon is None:
            daemon = await self._connect(name)
            daemon.on_refused = lambda text: self._note(name, "", "", Refused(text))
            self._connections[name], self._parts[name] = daemon, NodePart({}, {}, {})
        part = self._parts[name]
        for topic in _gone(part.published, wanted.published):
            daemon.unadvertise(topic)
        for topic in _gone(part.subscribed, wanted.subscribed):
            daemon.unsubscribe(topic)
        for service in _gone(part.services, wanted.services):
            daemon.unadvertise_service(service)
        for topic, kind in _new(part.published, wanted.published):
            daemon.advertise(topic, kind)
            part.published[topic] = kind
        for topic, kind in _new(part.subscribed, wanted.subscribed):
            try:
                await daemon.subscribe(topic, kind, throttle_rate=_LISTED_ONLY_MS, take=lambda _: None)
                part.subscribed[topic] = kind
            except Refused as error:
                self._note(name, topic, kind, error)
        for service, kind in _new(part.services, wanted.services):
            try:
                await self._offer(daemon, service, kind)
                part.services[service] = kind
            except Refused as error:
                self._note(name, service, kind, error)

    async def _offer(self, daemon: DaemonConnection, service: str, kind: str) -> None:
        async def handle(request: Message) -> Message:
            return await self._call(service, kind, request)

        await daemon.advertise_service(service, kind, handle)

    def _note(self, node: str, name: str, kind: str, error: SlidectlError) -> None:
        if self._refused.get((node, name, kind)) != error.message:
            self._refused[node, name, kind] = error.message
            _log.warning("%s: %s", node, error)

    def close(self) -> None:
        """Take all nodes out of the daemon's graph."""
        for connection in self._connections.values():
            connection.close()
        self._connections.clear()
        self._parts.clear()
        self._refused.clear()


def _gone(present: dict[str, str], wanted: dict[str, str]) -> list[str]:
    """Remove from `present` what is not wanted, and return it."""
    names = [name for name, kind in present.items() if wanted.get(name) != kind]
    for name in names:
        del present[name]
    return names


def _new(present: dict[str, str], wanted: dict[str, str]) -> list[tuple[str, str]]:
    return [(name, kind) for name, kind in wanted.items() if name not in present]
