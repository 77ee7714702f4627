"""The gateway for Foxglove: topics, services, parameters, time, graph and robot files, for any number of apps.

It implements Foxglove's protocol itself: docs/decisions/foxglove-sdk.md says why.
"""

from __future__ import annotations

import asyncio
import secrets
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from typing import Any, ClassVar

from websockets.typing import Subprotocol

from slidectl import names
from slidectl.effects import Effect
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.extensions.gateways.bounded_websocket import TRY_LATER, cut_reason
from slidectl.extensions.gateways.daemon_connection import GRAPH_CHANGES, PARAMETER_CHANGES, DaemonConnection
from slidectl.extensions.gateways.foxglove.advertised_graph import AdvertisedGraph
from slidectl.extensions.gateways.foxglove.app_session import ENCODINGS, AppSession, read_parameters
from slidectl.extensions.gateways.foxglove.foxglove_frames import (
    LONGEST_FRAME,
    SUBPROTOCOLS,
    WARNING,
    status_frame,
    text_frame,
)
from slidectl.extensions.gateways.foxglove.robot_assets import RobotAssets
from slidectl.extensions.gateways.gateway import Gateway, is_offered
from slidectl.extensions.gateways.websocket_listener import ListenerConnection, ListenerOptions, WebSocketListener
from slidectl.paths import InstancePaths
from slidectl.web_access import check_effects
from slidectl.wire.bounds import HeldBytes

Message = dict[str, Any]

NODE = "/foxglove_gateway"
"""Each app has a node of this name, with a number behind it."""
_GATHER_S = 0.05
"""Changes within this time, in s, are sent together."""
_CLOCK_EVERY_MS = 20
_MOST_UNREAD = 256 * 1024 * 1024
"""Limit of the bytes that wait for apps that do not read, over all apps."""
_NO_DAEMON = "no-daemon"
"""The id of the status that reports a missing daemon."""
_APP_ORIGINS = ("https://app.foxglove.dev", "https://studio.foxglove.dev", "file://")
"""Foxglove's web pages, and its desktop app (file://). Web pages never send file://: browsers send null for a file."""


@dataclass(frozen=True)
class FoxgloveOptions(ListenerOptions):
    """Options of the gateway. Foxglove's own pages are allowed too."""

    port: int = 8765
    read_only: bool = False
    """Refuse publishing, setting parameters, and services that change something."""


class FoxgloveGateway(Gateway):
    """Makes the daemon's graph available to Foxglove apps."""

    kind = "foxglove"
    Options: ClassVar = FoxgloveOptions

    def __init__(self, options: FoxgloveOptions) -> None:
        super().__init__()
        self._options = options
        self._permitted = check_effects(options.read_only, options.allow)
        self._listener = WebSocketListener(options, _APP_ORIGINS)
        self._watch: DaemonConnection | None = None
        """The connection for changes of the graph and of parameters."""
        self._paths: InstancePaths | None = None
        self._session = secrets.token_hex(8)
        self._graph = AdvertisedGraph(NODE, lambda service: is_offered(service, self._permitted))
        self._assets = RobotAssets()
        self._apps: set[AppSession] = set()
        self._serial = count(1)
        self._unread = HeldBytes(_MOST_UNREAD, "unread")
        self._dropped = 0
        """Messages that disconnected apps did not receive."""
        self._has_changed = asyncio.Event()
        self._parameters_changed: set[str] = set()
        self._changes: asyncio.Task[None] | None = None

    # --- Gateway ------------------------------------------------------------------------------------------------

    async def open(self) -> str:
        return await self._listener.open(
            self._serve_app,
            subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS],
            compression=None,
            max_size=LONGEST_FRAME,
        )

    async def attach(self, paths: InstancePaths) -> None:
        watch = self._watch = await DaemonConnection.open(paths, (Effect.READS,), on_lost=self.lost.set)
        self._session = secrets.token_hex(8)
        for app in self._apps:
            app.send(self._server_info())
            app.send(text_frame("removeStatus", statusIds=[_NO_DAEMON]))
        await watch.subscribe(GRAPH_CHANGES, "std_msgs/Empty", take=lambda _: self._has_changed.set())
        await watch.subscribe(PARAMETER_CHANGES, "slidectl/ParameterChanges", take=self._receive_parameter_changes)
        await watch.subscribe("/clock", "rosgraph_msgs/Clock", 1, _CLOCK_EVERY_MS, take=self._receive_clock)
        self._set_graph(await watch.call("/slidectl/graph"))
        self._paths = paths
        for app in list(self._apps):
            await self._attach_app(app, paths)
        await self._send_parameters(watch, {name for app in self._apps for name in app.parameters})
        self._changes = asyncio.get_running_loop().create_task(self._send_changes(watch))

    async def detach(self) -> None:
        self._paths = None
        if self._changes is not None:
            self._changes.cancel()
        if self._watch is not None:
            self._watch.close()
        self._watch = None
        self._set_graph({})
        for app in self._apps:
            app.detach()
            app.send(self._no_daemon_frame())

    async def close(self) -> None:
        await self._listener.close(1001, "the gateway ends")
        await self.detach()

    def status(self) -> dict[str, Any]:
        return {
            "connections": len(self._apps),
            "refused": self._listener.refused,
            "dropped": self._dropped + sum(app.dropped for app in self._apps),
            "topics": len(self._graph.channels),
            "subscribed": len(set().union(*(app.subscribed() for app in self._apps))),
            "published": len({(one.topic, one.type.name) for app in self._apps for one in app.topics.values()}),
        }

    # --- changes ------------------------------------------------------------------------------------------------

    async def _send_changes(self, watch: DaemonConnection) -> None:
        """Send changes of the graph and of parameters to apps until the daemon ends."""
        with suppress(NoDaemon):
            while True:
                await self._has_changed.wait()
                await asyncio.sleep(_GATHER_S)
                self._has_changed.clear()
                changed, self._parameters_changed = self._parameters_changed, set()
                try:
                    self._set_graph(await watch.call("/slidectl/graph"))
                    await self._send_parameters(watch, changed)
                except TimedOut:
                    self._parameters_changed |= changed
                    self._has_changed.set()
                except Refused as error:  # the values do not fit into a line
                    for app in self._apps:
                        app.fail(str(error))

    def _set_graph(self, state: Message) -> None:
        frames, removed, connections = self._graph.update(state)
        for app in self._apps:
            for channel in removed:
                app.remove_channel(channel)
            for each in frames:
                app.send(each)
            if connections and app.wants_graph:
                app.send(connections)

    def _receive_parameter_changes(self, published: Message) -> None:
        self._parameters_changed.update(published["msg"]["names"])
        self._has_changed.set()

    def _receive_clock(self, published: Message) -> None:
        for app in self._apps:
            app.send_time(published["msg"]["clock"])

    async def _send_parameters(self, watch: DaemonConnection, changed: set[str]) -> None:
        """Send changed parameters to their subscribers. A deleted one has no value."""
        wanted = {
            app: {name for name in app.parameters if any(_concerns(each, name) for each in changed)}
            for app in self._apps
        }
        if not any(wanted.values()):
            return
        every = sorted(set().union(*wanted.values()))
        values = {each["name"]: each for each in await read_parameters(watch, every)}
        for app, subscribed in wanted.items():
            if subscribed:
                parameters = [values.get(name, {"name": name}) for name in sorted(subscribed)]
                app.send(text_frame("parameterValues", parameters=parameters))

    # --- apps ---------------------------------------------------------------------------------------------------

    async def _serve_app(self, socket: ListenerConnection) -> None:
        """Serve one app from its handshake to its end."""
        options, held = self._options, self._listener.bounds.held
        app = AppSession(socket, self._graph, self._assets, options.read_only, held, self._unread)
        self._apps.add(app)
        try:
            app.send(self._server_info())
            for each in self._graph.frames():
                app.send(each)
            if self._paths is None:
                app.send(self._no_daemon_frame())
            else:
                with suppress(NoDaemon):  # `attach` comes again
                    await self._attach_app(app, self._paths)
            while True:
                await socket.writable()
                await app.receive(await socket.recv())
        finally:
            self._apps.discard(app)
            self._dropped += app.dropped
            app.close()

    async def _attach_app(self, app: AppSession, paths: InstancePaths) -> None:
        """Connect an app to the daemon; end its connection when the daemon refuses that. Raises NoDaemon."""

        def lost() -> None:
            asyncio.get_running_loop().call_later(_GATHER_S, self._end_lost, app)

        try:
            node = f"{NODE}_{next(self._serial)}"
            daemon = await DaemonConnection.open(paths, self._permitted, node, lost)
            if self._paths is None or app.is_attached or app not in self._apps:  # things have changed meanwhile
                daemon.close()
            else:
                await app.attach(daemon)
        except NoDaemon:
            raise
        except SlidectlError as error:
            app.end(TRY_LATER, cut_reason(error.message))

    def _end_lost(self, app: AppSession) -> None:
        """End an app whose connection alone was ended by the daemon: it holds too much there."""
        if self._paths is not None and not app.is_attached:
            app.end(TRY_LATER, "the daemon has ended the connection of this app")

    def _server_info(self) -> str:
        changing = () if self._options.read_only else ("clientPublish",)
        return text_frame(
            "serverInfo",
            name="slidectl",
            capabilities=[
                *changing,
                "services",
                "parameters",
                "parametersSubscribe",
                "time",
                "connectionGraph",
                "assets",
            ],
            supportedEncodings=list(ENCODINGS),
            metadata={"ROS_DISTRO": "noetic"},
            sessionId=self._session,
        )

    def _no_daemon_frame(self) -> str:
        return status_frame(WARNING, "the daemon has ended; the gateway waits for it", _NO_DAEMON)


def _concerns(changed: str, subscribed: str) -> bool:
    """True when a change of one parameter changes the other: one contains the other."""
    return names.is_under(subscribed, changed) or names.is_under(changed, subscribed)
