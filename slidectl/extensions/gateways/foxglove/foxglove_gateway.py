"""The gateway for Foxglove: topics, services, parameters, time, graph and robot files, for any number of apps.

It implements Foxglove's protocol itself, on one event loop. Foxglove's Python SDK holds a lock during its callbacks and
waits for that lock while it holds the interpreter lock. So an app that subscribes parameters or the graph just when
they change would deadlock the whole process.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import struct
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from websockets.typing import Subprotocol

from slidectl import msgs, names
from slidectl.effects import Effect
from slidectl.errors import BadMessage, NoDaemon, Refused, SlidectlError, TimedOut, quoted
from slidectl.extensions.gateways.daemon_connection import GRAPH_CHANGES, PARAMETER_CHANGES, DaemonConnection
from slidectl.extensions.gateways.foxglove.advertised_graph import AdvertisedGraph, AdvertisedService, AppChannel
from slidectl.extensions.gateways.foxglove.app_connection import AppConnection, AppSocket, AppTopic
from slidectl.extensions.gateways.foxglove.foxglove_frames import (
    LONGEST_FRAME,
    SUBPROTOCOLS,
    WARNING,
    AppMessage,
    AppRequest,
    BadFrame,
    Parameter,
    asset_frame,
    field,
    fields,
    message_frame,
    no_asset_frame,
    number,
    parameter,
    read_binary,
    read_json,
    read_text,
    response_frame,
    status_frame,
    text_frame,
    time_frame,
    wanted_parameter,
)
from slidectl.extensions.gateways.foxglove.robot_assets import RobotAssets
from slidectl.extensions.gateways.gateway import Gateway, is_offered
from slidectl.extensions.gateways.ros1.ros1_types import Ros1Type, ros1_type
from slidectl.extensions.gateways.websocket_listener import ListenerOptions, WebSocketListener
from slidectl.msgs.schema import SCALAR, TIMES, nanoseconds
from slidectl.paths import InstancePaths
from slidectl.web_access import check_effects
from slidectl.wire.bounds import HeldBytes
from slidectl.wire.json_lines import encode, numbers_of_json

Message = dict[str, Any]

NODE = "/foxglove_gateway"
CALL_LIMIT_S = 60.0
"""The limit of an app's service call, in s."""
_ENCODINGS = ("ros1", "json")
"""Accepted encodings from apps; the app uses the first that it supports."""
_GATHER_S = 0.05
"""Changes within this time, in s, are sent together."""
_CLOCK_EVERY_MS = 20
_QUEUE = 10_000
"""Messages per topic that the daemon queues while the gateway is busy."""
_MOST_TOPICS, _MOST_NAMES = 1000, 10_000
"""Limits per app: published topics, and names in one frame."""
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

    Options: ClassVar = FoxgloveOptions

    def __init__(self, options: FoxgloveOptions) -> None:
        super().__init__()
        self._options = options
        self._permitted = check_effects(options.read_only, options.allow)
        self._listener = WebSocketListener(options, _APP_ORIGINS)
        self._daemon: DaemonConnection | None = None
        """The connection for requests of apps."""
        self._watch: DaemonConnection | None = None
        """The connection for graph changes, parameter changes and the time."""
        self._paths: InstancePaths | None = None
        self._session = secrets.token_hex(8)
        self._graph = AdvertisedGraph(NODE, self._is_offered)
        self._assets = RobotAssets()
        self._assets_lock = asyncio.Lock()
        self._apps: set[AppConnection] = set()
        self._unread = HeldBytes(_MOST_UNREAD, "unread")
        self._dropped = 0
        """Messages that disconnected apps did not receive."""
        self._publishers: dict[tuple[str, str], int] = {}
        """Topic and type -> number of app channels that publish it."""
        self._graph_changed = asyncio.Event()
        self._parameters_changed: set[str] = set()
        self._changes: asyncio.Task[None] | None = None
        self._has_clock = False
        self._operations: dict[str, Callable[[AppConnection, Message], Awaitable[None]]] = {
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "getParameters": self._get_parameters,
            "setParameters": self._set_parameters,
            "subscribeParameterUpdates": self._subscribe_parameters,
            "unsubscribeParameterUpdates": self._unsubscribe_parameters,
            "subscribeConnectionGraph": self._subscribe_graph,
            "unsubscribeConnectionGraph": self._unsubscribe_graph,
            "fetchAsset": self._fetch_asset,
        }

    # --- the gateway's life -------------------------------------------------------------------------------------

    def _is_offered(self, service: Message) -> bool:
        return is_offered(service, self._permitted)

    async def open(self) -> str:
        return await self._listener.open(
            self._serve_app,
            AppSocket,
            subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS],
            compression=None,
            max_size=LONGEST_FRAME,
            write_limit=256 * 1024,
        )

    async def attach(self, paths: InstancePaths) -> None:
        self._paths = paths
        daemon = self._daemon = await DaemonConnection.open(paths, self._permitted, NODE, self.lost.set)
        watch = self._watch = await DaemonConnection.open(paths, (Effect.READS,), on_lost=self.lost.set)
        daemon.on_refused = self._tell_publishers
        self._session = secrets.token_hex(8)
        for app in self._apps:
            app.send(self._server_info())
            app.send(text_frame("removeStatus", statusIds=[_NO_DAEMON]))
        await watch.subscribe(GRAPH_CHANGES, "std_msgs/Empty", take=lambda _: self._graph_changed.set())
        await watch.subscribe(PARAMETER_CHANGES, "slidectl/ParameterChanges", take=self._take_parameter_changes)
        for topic, kind in self._publishers:
            daemon.advertise(topic, kind)
        await self._update_graph(daemon)
        await self._send_parameters({name for app in self._apps for name in app.parameters})
        if self._apps:
            await self._follow_clock()
        self._changes = asyncio.get_running_loop().create_task(self._tell_changes(daemon))

    async def detach(self) -> None:
        if self._changes is not None:
            self._changes.cancel()
        self._has_clock = False
        for connection in (self._daemon, self._watch):
            if connection is not None:
                connection.close()
        self._daemon = self._watch = None
        self._take_graph({})
        for app in self._apps:
            app.send(self._no_daemon_frame())

    async def close(self) -> None:
        await self._listener.close(1001, "the gateway ends")
        await self.detach()

    def status(self) -> dict[str, Any]:
        channels = self._graph.channels.values()
        return {
            "connections": len(self._apps),
            "refused": self._listener.refused,
            "dropped": self._dropped + sum(app.dropped for app in self._apps),
            "topics": len(channels),
            "subscribed": sum(bool(channel.apps) for channel in channels),
            "published": len(self._publishers),
        }

    def _there(self) -> DaemonConnection:
        """The connection to the daemon. Raises NoDaemon."""
        if self._daemon is None:
            raise NoDaemon("there is no daemon; the gateway waits for it")
        return self._daemon

    # --- what all apps are told ---------------------------------------------------------------------------------

    async def _tell_changes(self, daemon: DaemonConnection) -> None:
        """Send changes of the graph and of parameters to apps until the daemon ends."""
        with suppress(NoDaemon):
            while True:
                await self._graph_changed.wait()
                await asyncio.sleep(_GATHER_S)
                self._graph_changed.clear()
                changed, self._parameters_changed = self._parameters_changed, set()
                try:
                    await self._update_graph(daemon)
                    await self._send_parameters(changed)
                except TimedOut:
                    self._parameters_changed |= changed
                    self._graph_changed.set()
                except Refused as error:  # the values do not fit into a line
                    for app in self._apps:
                        app.fail(str(error))

    async def _update_graph(self, daemon: DaemonConnection) -> None:
        self._take_graph(await daemon.call("/slidectl/graph"))

    def _take_graph(self, state: Message) -> None:
        frames, gone, connections = self._graph.update(state)
        for channel in gone:
            for app in channel.apps:
                app.subscriptions.pop(channel.apps[app], None)
            if channel.apps and self._daemon is not None:
                self._daemon.unsubscribe(channel.topic)
        for app in self._apps:
            for each in frames:
                app.send(each)
            if connections and app.wants_graph:
                app.send(connections)

    def _take_parameter_changes(self, published: Message) -> None:
        self._parameters_changed.update(published["msg"]["names"])
        self._graph_changed.set()

    async def _follow_clock(self) -> None:
        if self._watch is not None and not self._has_clock:
            self._has_clock = True
            with suppress(SlidectlError):
                await self._watch.subscribe("/clock", "rosgraph_msgs/Clock", 1, _CLOCK_EVERY_MS, self._take_clock)

    def _take_clock(self, published: Message) -> None:
        frame = time_frame(nanoseconds(published["msg"]["clock"]))
        for app in self._apps:
            app.send_time(frame)

    def _tell_publishers(self, text: str) -> None:
        """Send a refusal to all apps that publish: the daemon does not say whose message it refused."""
        for app in self._apps:
            if app.topics:
                app.fail(text)

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
            supportedEncodings=list(_ENCODINGS),
            metadata={"ROS_DISTRO": "noetic"},
            sessionId=self._session,
        )

    def _no_daemon_frame(self) -> str:
        return status_frame(WARNING, "the daemon has ended; the gateway waits for it", _NO_DAEMON)

    # --- one app ------------------------------------------------------------------------------------------------

    async def _serve_app(self, socket: AppSocket) -> None:
        app = AppConnection(socket, self._listener.bounds.held, self._unread)
        app.send(self._server_info())
        for told in self._graph.frames():
            app.send(told)
        if self._daemon is None:
            app.send(self._no_daemon_frame())
        self._apps.add(app)
        try:
            await self._greet(app)
            async for frame in socket:
                try:
                    await self._take_frame(app, frame)
                except SlidectlError as error:
                    app.fail(str(error))
                del frame  # it may be long, and the next one may come late
        finally:
            self._forget(app)

    async def _greet(self, app: AppConnection) -> None:
        """Send the present time, which does not advance in a paused world."""
        with suppress(SlidectlError):
            now = await self._there().call("/rosapi/get_time")
            app.send_time(time_frame(nanoseconds(now["time"])))
            await self._follow_clock()

    def _forget(self, app: AppConnection) -> None:
        self._apps.discard(app)
        self._dropped += app.dropped
        app.end()
        for subscription in list(app.subscriptions):
            self._leave(app, subscription)
        for published in app.topics.values():
            self._publish_less(published)
        if not self._apps and self._watch is not None:
            self._watch.unsubscribe("/clock")
            self._has_clock = False

    async def _take_frame(self, app: AppConnection, frame: str | bytes) -> None:
        """Process a frame of an app. Raises SlidectlError, which is sent to the app."""
        app.frame_bytes = len(frame)
        if isinstance(frame, str):
            message = read_text(frame)
            operation = self._operations.get(message["op"])
            if operation is None:
                raise BadFrame(f"no operation {quoted(message['op'])}; there are {', '.join(self._operations)}")
            await operation(app, message)
        else:
            given = read_binary(frame)
            await self._publish(app, given) if isinstance(given, AppMessage) else self._call(app, given)

    # --- topics that apps subscribe -----------------------------------------------------------------------------

    async def _subscribe(self, app: AppConnection, message: Message) -> None:
        for given in fields(message, "subscriptions", dict, _MOST_NAMES):
            subscription, channel_id = number(given, "id"), number(given, "channelId")
            channel = self._graph.channels.get(channel_id)
            if channel is None:
                app.fail(f"there is no channel {channel_id}")
            elif subscription in app.subscriptions or app in channel.apps:
                app.fail(f"{channel.topic} is subscribed already, or another topic with the id {subscription}")
            else:
                await self._join(app, subscription, channel)

    async def _join(self, app: AppConnection, subscription: int, channel: AppChannel) -> None:
        """Subscribe an app. The first app subscribes at the daemon; for later ones the latched message is read."""
        app.subscriptions[subscription] = channel.id
        is_first = not channel.apps
        channel.apps[app] = subscription
        channel.new.add(app)
        daemon = self._there()
        try:
            if is_first:
                await daemon.subscribe(channel.topic, channel.kind, _QUEUE, take=partial(self._take, channel))
            else:
                await self._bring_latched(channel)
        except SlidectlError:
            self._leave(app, subscription)
            raise

    async def _bring_latched(self, channel: AppChannel) -> None:
        assert self._paths is not None
        reader = await DaemonConnection.open(self._paths, (Effect.READS,))
        try:
            await reader.subscribe(channel.topic, channel.kind, take=partial(self._take_latched, channel))
        finally:
            reader.close()

    def _take(self, channel: AppChannel, published: Message) -> None:
        if (payload := self._packed(channel, published["msg"])) is not None:
            time_ns = nanoseconds(published["time"])
            for app, subscription in channel.apps.items():
                app.send_message(message_frame(subscription, time_ns, payload))
            channel.new.clear()

    def _packed(self, channel: AppChannel, message: Message) -> bytes | None:
        try:
            return _pack(channel.type, message)
        except BadMessage as error:
            self._dropped += 1
            if not channel.has_failed:
                channel.has_failed = True
                for app in channel.apps:
                    app.fail(f"{channel.topic}: {error}")
            return None

    def _take_latched(self, channel: AppChannel, published: Message) -> None:
        if published.get("latch") and (payload := self._packed(channel, published["msg"])) is not None:
            time_ns = nanoseconds(published["time"])
            for app in channel.new:
                app.send_message(message_frame(channel.apps[app], time_ns, payload))
            channel.new.clear()

    async def _unsubscribe(self, app: AppConnection, message: Message) -> None:
        for subscription in fields(message, "subscriptionIds", int, _MOST_NAMES):
            self._leave(app, subscription)

    def _leave(self, app: AppConnection, subscription: int) -> None:
        channel = self._graph.channels.get(app.subscriptions.pop(subscription, 0))
        if channel is not None:
            channel.apps.pop(app, None)
            channel.new.discard(app)
            if not channel.apps and self._daemon is not None:
                self._daemon.unsubscribe(channel.topic)

    # --- topics that apps publish -------------------------------------------------------------------------------

    def _check_may_change(self) -> None:
        if self._options.read_only:
            raise Refused("this gateway is read-only", "start it without --read-only")

    async def _advertise(self, app: AppConnection, message: Message) -> None:
        self._check_may_change()
        for given in fields(message, "channels", dict, _MOST_TOPICS):
            channel_id, topic, encoding = number(given, "id"), field(given, "topic", str), field(given, "encoding", str)
            kind = given.get("schemaName") or self._graph.types().get(topic, "")
            if channel_id in app.topics or len(app.topics) >= _MOST_TOPICS:
                raise Refused(f"the channel {channel_id} is advertised already, or {_MOST_TOPICS} others")
            if encoding not in _ENCODINGS:
                raise Refused(f"{quoted(topic)}: no encoding {quoted(encoding)}; there are {', '.join(_ENCODINGS)}")
            names.check_absolute(topic, "topic")
            published = AppTopic(topic, ros1_type(str(kind).replace("/msg/", "/")), encoding)
            others = {other for of, other in self._publishers if of == topic} - {published.type.name}
            if others:
                raise Refused(
                    f"{topic} has the type {others.pop()}, not {published.type.name}: another app publishes it"
                )
            app.topics[channel_id] = published
            key = topic, published.type.name
            self._publishers[key] = self._publishers.get(key, 0) + 1
            if self._publishers[key] == 1 and self._daemon is not None:
                self._daemon.advertise(*key)

    async def _unadvertise(self, app: AppConnection, message: Message) -> None:
        for channel_id in fields(message, "channelIds", int, _MOST_TOPICS):
            if (published := app.topics.pop(channel_id, None)) is not None:
                self._publish_less(published)

    def _publish_less(self, published: AppTopic) -> None:
        key = published.topic, published.type.name
        self._publishers[key] -= 1
        if not self._publishers[key]:
            del self._publishers[key]
            if self._daemon is not None:
                self._daemon.unadvertise(published.topic)

    async def _publish(self, app: AppConnection, given: AppMessage) -> None:
        published = app.topics.get(given.channel)
        if published is None:
            raise Refused(f"this app has advertised no channel {given.channel}")
        daemon = self._there()
        daemon.publish(published.topic, _decoded(given.payload, published.encoding, published.type))
        await daemon.drain()

    # --- services -----------------------------------------------------------------------------------------------

    def _call(self, app: AppConnection, request: AppRequest) -> None:
        def fail(text: str) -> None:
            about = {"serviceId": request.service, "callId": request.call}
            app.send(text_frame("serviceCallFailure", **about, message=text))

        async def call() -> None:
            try:
                service = self._graph.services.get(request.service)
                if service is None:
                    raise Refused(f"there is no service {request.service}")
                answer = await self._answer(service, request)
                await app.room()
                app.send(response_frame(request, answer))
            except SlidectlError as error:
                fail(str(error))

        try:
            app.begin(call())
        except SlidectlError as error:
            fail(str(error))

    async def _answer(self, service: AdvertisedService, request: AppRequest) -> bytes:
        given = _decoded(request.payload, request.encoding, ros1_type(service.request))
        answer = await self._there().call(service.name, given, timeout=CALL_LIMIT_S)
        return _pack(ros1_type(service.response), answer) if request.encoding == "ros1" else encode(answer).rstrip()

    # --- parameters ---------------------------------------------------------------------------------------------

    async def _get_parameters(self, app: AppConnection, message: Message) -> None:
        wanted = fields(message, "parameterNames", str, _MOST_NAMES)
        app.begin(self._answer_parameters(app, wanted, message))

    async def _answer_parameters(self, app: AppConnection, wanted: list[str], message: Message) -> None:
        try:
            found = await self._parameters(wanted)
            await app.room()
            app.send(text_frame("parameterValues", parameters=found, **_same_id(message)))
        except SlidectlError as error:
            app.fail(str(error))

    async def _parameters(self, wanted: list[str]) -> list[Parameter]:
        """Those of the wanted parameters that are set; all without names. Raises as `call`."""
        if not wanted:
            from slidectl.description.parameter_trees import leaves  # the package is slow to import

            tree = json.loads((await self._there().call("/rosapi/get_param", {"name": "/"}))["value"])
            return [parameter(name, value) for name, value in leaves(tree, "/")]
        found = []
        for name in dict.fromkeys(wanted):
            if (await self._there().call("/rosapi/has_param", {"name": name}))["exists"]:
                value = (await self._there().call("/rosapi/get_param", {"name": name}))["value"]
                found.append(parameter(name, json.loads(value)))
        return found

    async def _set_parameters(self, app: AppConnection, message: Message) -> None:
        self._check_may_change()
        app.begin(self._set(app, fields(message, "parameters", dict, _MOST_NAMES), message))

    async def _set(self, app: AppConnection, given: list[Message], message: Message) -> None:
        """Set parameters one by one: a refused one does not prevent the others."""
        wanted = []
        for each in given:
            try:
                name, value = wanted_parameter(each)
                wanted.append(name)
                if value is None:
                    await self._there().call("/rosapi/delete_param", {"name": name})
                else:
                    text = numbers_of_json(json.dumps(value))
                    await self._there().call("/rosapi/set_param", {"name": name, "value": text})
            except SlidectlError as error:
                app.fail(str(error))
        if wanted and "id" in message:
            await self._answer_parameters(app, wanted, message)

    async def _subscribe_parameters(self, app: AppConnection, message: Message) -> None:
        wanted = set(fields(message, "parameterNames", str, _MOST_NAMES))
        if len(app.parameters | wanted) > _MOST_NAMES or any(len(name) > names.LONGEST for name in wanted):
            raise Refused(f"an app subscribes {_MOST_NAMES} parameters at most, of {names.LONGEST} characters each")
        app.parameters |= wanted

    async def _unsubscribe_parameters(self, app: AppConnection, message: Message) -> None:
        app.parameters.difference_update(fields(message, "parameterNames", str, _MOST_NAMES))

    async def _send_parameters(self, changed: set[str]) -> None:
        """Send changed parameters to their subscribers. A deleted one has no value."""
        wanted = {
            app: {name for name in app.parameters if any(_concerns(each, name) for each in changed)}
            for app in self._apps
        }
        if not any(wanted.values()):
            return
        every = sorted(set().union(*wanted.values()))
        values = {each["name"]: each for each in await self._parameters(every)}
        for app, subscribed in wanted.items():
            if subscribed:
                parameters = [values.get(name, {"name": name}) for name in sorted(subscribed)]
                app.send(text_frame("parameterValues", parameters=parameters))

    # --- graph and files ----------------------------------------------------------------------------------------

    async def _subscribe_graph(self, app: AppConnection, _: Message) -> None:
        if not app.wants_graph:
            app.wants_graph = True
            app.send(self._graph.connections())

    async def _unsubscribe_graph(self, app: AppConnection, _: Message) -> None:
        app.wants_graph = False

    async def _fetch_asset(self, app: AppConnection, message: Message) -> None:
        app.begin(self._send_asset(app, field(message, "uri", str), number(message, "requestId")))

    async def _send_asset(self, app: AppConnection, uri: str, request: int) -> None:
        """Send a file. Only one is read at a time, for all apps together."""
        await app.room()
        async with self._assets_lock:
            try:
                await self._assets.update(self._there())
                app.send(asset_frame(request, await asyncio.to_thread(self._assets.read, uri)))
            except SlidectlError as error:
                app.send(no_asset_frame(request, str(error)))


def _pack(kind: Ros1Type, message: Message) -> bytes:
    """Pack a message. Raises BadMessage: ROS 1 cannot hold it, for example text that is not UTF-8."""
    try:
        return kind.pack(message)
    except (struct.error, ValueError, OverflowError) as error:
        raise BadMessage(f"a {kind.name} that ROS 1 cannot hold: {error}") from None


def _same_id(message: Message) -> Message:
    """The id of a request, to be repeated in its answer; empty without one."""
    return {"id": field(message, "id", str)} if "id" in message else {}


def _decoded(payload: bytes, encoding: str, kind: Ros1Type) -> Message:
    """Decode an app's message. Raises BadMessage, BadFrame."""
    if encoding == "ros1":
        return kind.unpack(payload)
    if encoding != "json":
        raise BadFrame(f"no encoding {quoted(encoding)}; there are {', '.join(_ENCODINGS)}")
    message: Message = _with_ros1_times(kind.name, read_json(payload.decode("utf-8", "replace") or "{}"))
    return message


def _with_ros1_times(type_name: str, value: Any) -> Any:
    """Rename the fields sec and nsec, Foxglove's names in times, to secs and nsecs. The rest stays unchecked."""
    if not isinstance(value, dict):
        return value
    if type_name in TIMES:
        return {{"sec": "secs", "nsec": "nsecs"}.get(key, key): part for key, part in value.items()}
    inner = {one.name: one for one in msgs.fields(type_name) if "/" in one.type or one.type in TIMES}
    if not inner:
        return value
    converted = dict(value)
    for name, one in inner.items():
        given = value.get(name)
        if one.array == SCALAR and given is not None:
            converted[name] = _with_ros1_times(one.type, given)
        elif isinstance(given, list):
            converted[name] = [_with_ros1_times(one.type, each) for each in given]
    return converted


def _concerns(changed: str, subscribed: str) -> bool:
    """True when a change of one parameter changes the other: one contains the other."""
    return names.is_under(subscribed, changed) or names.is_under(changed, subscribed)
