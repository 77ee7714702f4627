"""The session of one app: its subscriptions, the topics that it publishes, its calls, parameters and files.

Each app has a connection of its own to the daemon, and both are read only while the app reads: the daemon then drops
the oldest messages of each topic and counts them. No queue grows in the gateway.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Awaitable, Callable, Coroutine
from functools import partial
from typing import Any, NamedTuple

from slidectl import msgs, names
from slidectl.client.async_client import AsyncSubscription
from slidectl.errors import BadMessage, NoDaemon, Refused, SlidectlError, quoted
from slidectl.extensions.gateways.bounded_websocket import TRY_LATER
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.foxglove.advertised_graph import AdvertisedGraph, AdvertisedService, AppChannel
from slidectl.extensions.gateways.foxglove.foxglove_frames import (
    ERROR,
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
from slidectl.extensions.gateways.gateway import Tasks
from slidectl.extensions.gateways.ros1.ros1_types import Ros1Type, ros1_type
from slidectl.extensions.gateways.websocket_listener import ListenerConnection
from slidectl.msgs.schema import SCALAR, TIMES, nanoseconds
from slidectl.wire.bounds import HeldBytes
from slidectl.wire.json_lines import encode, numbers_of_json

Message = dict[str, Any]

CALL_LIMIT_S = 60.0
"""The limit of an app's service call, in s."""
ENCODINGS = ("ros1", "json")
"""Accepted encodings from apps; the app uses the first that it supports."""
_QUEUE = 10_000
"""Messages per topic that the daemon queues for an app."""
_MOST_TOPICS, _MOST_NAMES = 1000, 10_000
"""Limits per app: published topics, and names in one frame."""
_MOST_UNREAD = 32 * 1024 * 1024
"""Unread bytes of one app at which it loses its connection. The last frame may exceed it: a file."""
_COPIES = 3
"""How often a frame is in memory while a task works on it: as it came, as values, and as a line to the daemon."""
_MOST_TASKS = 32
"""Limit of the calls and file requests of one app in progress."""


class AppTopic(NamedTuple):
    """A channel on which an app publishes."""

    topic: str
    type: Ros1Type
    encoding: str


class AppSession:
    """One app. `attach` and `detach` follow the daemon; the app stays connected meanwhile."""

    def __init__(
        self,
        socket: ListenerConnection,
        graph: AdvertisedGraph,
        assets: RobotAssets,
        is_reader: bool,
        held: HeldBytes,
        unread: HeldBytes,
    ) -> None:
        """`is_reader`: the app may change nothing.

        `held` counts what came from apps and is not handled, `unread` what they have not read.
        """
        self.topics: dict[int, AppTopic] = {}
        """The app's id of a channel -> the topic that it publishes."""
        self.parameters: set[str] = set()
        """Names of the parameters that it subscribes."""
        self.wants_graph = False
        self._socket = socket
        self._graph = graph
        self._assets = assets
        self._is_reader = is_reader
        self._daemon: DaemonConnection | None = None
        self._subscriptions: dict[int, tuple[AppChannel, AsyncSubscription | None]] = {}
        """The app's id of a subscription -> the channel, and the subscription at the daemon once it is confirmed."""
        self._subscribed: dict[int, int] = {}
        """Id of a channel -> the app's id of its subscription."""
        self._failed: set[int] = set()
        """Ids of the channels that had a message which ROS 1 cannot hold."""
        self._dropped = 0
        self._frame_bytes = self._task_bytes = 0
        """Bytes of the frame that is being handled, which a task holds until it ends, and of all tasks."""
        self._in_tasks = held.share(partial(socket.end_at_once, TRY_LATER))
        self._unread = unread.share(partial(socket.end_at_once, TRY_LATER))
        self._tasks = Tasks()
        self._time = b""
        """A time that is not sent yet."""
        socket.on_writable = self._send_newest_time
        self._operations: dict[str, Callable[[Message], Awaitable[None]]] = {
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

    # --- the session's life -------------------------------------------------------------------------------------

    async def attach(self, daemon: DaemonConnection) -> None:
        """Use this connection to a daemon. Raises NoDaemon: it has ended again."""
        self._daemon = self._socket.daemon = daemon
        daemon.on_refused = self.fail
        for topic, kind in {(published.topic, published.type.name) for published in self.topics.values()}:
            daemon.advertise(topic, kind)
        now = await daemon.call("/rosapi/get_time")  # it does not advance in a paused world
        self.send_time(now["time"])

    def detach(self) -> None:
        """Handle the end of the daemon."""
        if self._daemon is not None:
            self._daemon.close()
        self._daemon = self._socket.daemon = None

    @property
    def is_attached(self) -> bool:
        """True while the connection to the daemon is open."""
        return self._daemon is not None and self._daemon.is_open

    def end(self, code: int, reason: str) -> None:
        """Close the app's connection."""
        self._socket.end_soon(code, reason)

    def close(self) -> None:
        """Handle the app's disconnection."""
        self._tasks.cancel()
        self._in_tasks.close()
        self._unread.close()
        self.detach()

    @property
    def dropped(self) -> int:
        """Messages that the app did not receive."""
        present = (of_daemon for _, of_daemon in self._subscriptions.values() if of_daemon is not None)
        return self._dropped + sum(of_daemon.dropped for of_daemon in present)

    def subscribed(self) -> set[int]:
        """The ids of the subscribed channels."""
        return set(self._subscribed)

    def _connected(self) -> DaemonConnection:
        """The connection to the daemon. Raises NoDaemon."""
        if self._daemon is None:
            raise NoDaemon("there is no daemon; the gateway waits for it")
        return self._daemon

    # --- frames -------------------------------------------------------------------------------------------------

    def send(self, frame: bytes | str) -> None:
        """Send a frame. An app with too many unread frames loses its connection."""
        transport = self._socket.transport
        if transport.get_write_buffer_size() > _MOST_UNREAD:
            transport.abort()
            return
        self._socket.write(frame if isinstance(frame, bytes) else frame.encode(), isinstance(frame, str))
        self._unread.set(transport.get_write_buffer_size())

    def send_time(self, time: Message) -> None:
        """Send the simulated time; an app that does not read gets the newest when it reads again."""
        self._time = time_frame(nanoseconds(time))
        if self._socket.is_writable:
            self._send_newest_time()

    def _send_newest_time(self) -> None:
        frame, self._time = self._time, b""
        if frame:
            self.send(frame)

    def fail(self, text: str) -> None:
        """Send an error text to the app."""
        self.send(status_frame(ERROR, text))

    async def receive(self, frame: bytes | str) -> None:
        """Process a frame of the app. Errors are sent to it."""
        self._frame_bytes = len(frame)
        try:
            if isinstance(frame, bytes):
                given = read_binary(frame)
                await self._publish(given) if isinstance(given, AppMessage) else self._call(given)
                return
            message = read_text(frame)
            operation = self._operations.get(message["op"])
            if operation is None:
                raise BadFrame(f"no operation {quoted(message['op'])}; there are {', '.join(self._operations)}")
            await operation(message)
        except SlidectlError as error:
            self.fail(str(error))

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a task until the app disconnects. Raises BadFrame: too many tasks run already."""
        if len(self._tasks) >= _MOST_TASKS:
            work.close()
            raise BadFrame(f"{_MOST_TASKS} calls and file requests of this app are in progress")
        frame_bytes = _COPIES * self._frame_bytes

        def ended() -> None:
            self._task_bytes -= frame_bytes
            self._in_tasks.handled()
            self._in_tasks.set(self._task_bytes, self._task_bytes)

        self._tasks.begin(work, ended)
        self._task_bytes += frame_bytes
        self._in_tasks.set(self._task_bytes, self._task_bytes)

    # --- topics that the app subscribes -------------------------------------------------------------------------

    async def _subscribe(self, message: Message) -> None:
        for given in fields(message, "subscriptions", dict, _MOST_NAMES):
            subscription, channel_id = number(given, "id"), number(given, "channelId")
            channel = self._graph.channels.get(channel_id)
            if channel is None:
                self.fail(f"there is no channel {channel_id}")
            elif subscription in self._subscriptions or channel_id in self._subscribed:
                self.fail(f"{channel.topic} is subscribed already, or another topic with the id {subscription}")
            else:
                await self._join(subscription, channel)

    async def _join(self, subscription: int, channel: AppChannel) -> None:
        self._subscriptions[subscription] = channel, None
        self._subscribed[channel.id] = subscription
        receive = partial(self._receive_message, subscription, channel)
        try:
            of_daemon = await self._connected().subscribe(channel.topic, channel.kind, _QUEUE, take=receive)
        except SlidectlError:
            self._leave(subscription)
            raise
        if self._subscribed.get(channel.id) == subscription:
            self._subscriptions[subscription] = channel, of_daemon
        else:  # the channel was removed meanwhile
            of_daemon.close()

    def _receive_message(self, subscription: int, channel: AppChannel, published: Message) -> None:
        try:
            payload = _pack(channel.type, published["msg"])
        except BadMessage as error:
            self._dropped += 1
            if channel.id not in self._failed:
                self._failed.add(channel.id)
                self.fail(f"{channel.topic}: {error}")
        else:
            self.send(message_frame(subscription, nanoseconds(published["time"]), payload))

    async def _unsubscribe(self, message: Message) -> None:
        for subscription in fields(message, "subscriptionIds", int, _MOST_NAMES):
            self._leave(subscription)

    def remove_channel(self, channel: AppChannel) -> None:
        """End the subscription of a channel that was removed."""
        if (subscription := self._subscribed.get(channel.id)) is not None:
            self._leave(subscription)

    def _leave(self, subscription: int) -> None:
        channel, of_daemon = self._subscriptions.pop(subscription, (None, None))
        if channel is not None:
            del self._subscribed[channel.id]
            self._failed.discard(channel.id)
        if of_daemon is not None:
            self._dropped += of_daemon.dropped
            of_daemon.close()

    # --- topics that the app publishes ---------------------------------------------------------------------------

    def _check_may_change(self) -> None:
        if self._is_reader:
            raise Refused("this gateway is read-only", "start it without --read-only")

    async def _advertise(self, message: Message) -> None:
        self._check_may_change()
        for given in fields(message, "channels", dict, _MOST_TOPICS):
            channel_id, topic, encoding = number(given, "id"), field(given, "topic", str), field(given, "encoding", str)
            kind = given.get("schemaName") or self._graph.types().get(topic, "")
            if channel_id in self.topics or len(self.topics) >= _MOST_TOPICS:
                raise Refused(f"the channel {channel_id} is advertised already, or {_MOST_TOPICS} others")
            if encoding not in ENCODINGS:
                raise Refused(f"{quoted(topic)}: no encoding {quoted(encoding)}; there are {', '.join(ENCODINGS)}")
            names.check_absolute(topic, "topic")
            published = self.topics[channel_id] = AppTopic(topic, ros1_type(str(kind).replace("/msg/", "/")), encoding)
            if self._daemon is not None:
                self._daemon.advertise(topic, published.type.name)

    async def _unadvertise(self, message: Message) -> None:
        for channel_id in fields(message, "channelIds", int, _MOST_TOPICS):
            published = self.topics.pop(channel_id, None)
            is_last = published is not None and all(one.topic != published.topic for one in self.topics.values())
            if published is not None and is_last and self._daemon is not None:
                self._daemon.unadvertise(published.topic)

    async def _publish(self, given: AppMessage) -> None:
        published = self.topics.get(given.channel)
        if published is None:
            raise Refused(f"this app has advertised no channel {given.channel}")
        daemon = self._connected()
        daemon.publish(published.topic, _decoded(given.payload, published.encoding, published.type))
        await daemon.drain()

    # --- services -----------------------------------------------------------------------------------------------

    def _call(self, request: AppRequest) -> None:
        def fail(text: str) -> None:
            about = {"serviceId": request.service, "callId": request.call}
            self.send(text_frame("serviceCallFailure", **about, message=text))

        async def call() -> None:
            try:
                service = self._graph.services.get(request.service)
                if service is None:
                    raise Refused(f"there is no service {request.service}")
                answer = await self._answer(service, request)
                await self._socket.writable()
                self.send(response_frame(request, answer))
            except SlidectlError as error:
                fail(str(error))

        try:
            self._begin(call())
        except SlidectlError as error:
            fail(str(error))

    async def _answer(self, service: AdvertisedService, request: AppRequest) -> bytes:
        given = _decoded(request.payload, request.encoding, ros1_type(service.request))
        answer = await self._connected().call(service.name, given, timeout=CALL_LIMIT_S)
        return _pack(ros1_type(service.response), answer) if request.encoding == "ros1" else encode(answer).rstrip()

    # --- parameters ---------------------------------------------------------------------------------------------

    async def _get_parameters(self, message: Message) -> None:
        self._begin(self._send_values(fields(message, "parameterNames", str, _MOST_NAMES), message))

    async def _send_values(self, wanted: list[str], message: Message) -> None:
        """Answer a request with the values of parameters."""
        try:
            found = await read_parameters(self._connected(), wanted)
            await self._socket.writable()
            self.send(text_frame("parameterValues", parameters=found, **_same_id(message)))
        except SlidectlError as error:
            self.fail(str(error))

    async def _set_parameters(self, message: Message) -> None:
        self._check_may_change()
        self._begin(self._set(fields(message, "parameters", dict, _MOST_NAMES), message))

    async def _set(self, given: list[Message], message: Message) -> None:
        """Set parameters one by one: a refused one does not prevent the others."""
        wanted = []
        for each in given:
            try:
                name, value = wanted_parameter(each)
                wanted.append(name)
                if value is None:
                    await self._connected().call("/rosapi/delete_param", {"name": name})
                else:
                    text = numbers_of_json(json.dumps(value))
                    await self._connected().call("/rosapi/set_param", {"name": name, "value": text})
            except SlidectlError as error:
                self.fail(str(error))
        if wanted and "id" in message:
            await self._send_values(wanted, message)

    async def _subscribe_parameters(self, message: Message) -> None:
        wanted = set(fields(message, "parameterNames", str, _MOST_NAMES))
        if len(self.parameters | wanted) > _MOST_NAMES or any(len(name) > names.LONGEST for name in wanted):
            raise Refused(f"an app subscribes {_MOST_NAMES} parameters at most, of {names.LONGEST} characters each")
        self.parameters |= wanted

    async def _unsubscribe_parameters(self, message: Message) -> None:
        self.parameters.difference_update(fields(message, "parameterNames", str, _MOST_NAMES))

    # --- graph and files ----------------------------------------------------------------------------------------

    async def _subscribe_graph(self, _: Message) -> None:
        if not self.wants_graph:
            self.wants_graph = True
            self.send(self._graph.connections())

    async def _unsubscribe_graph(self, _: Message) -> None:
        self.wants_graph = False

    async def _fetch_asset(self, message: Message) -> None:
        self._begin(self._send_asset(field(message, "uri", str), number(message, "requestId")))

    async def _send_asset(self, uri: str, request: int) -> None:
        await self._socket.writable()
        try:
            self.send(asset_frame(request, await self._assets.read(self._connected(), uri)))
        except SlidectlError as error:
            self.send(no_asset_frame(request, str(error)))


async def read_parameters(daemon: DaemonConnection, wanted: list[str]) -> list[Parameter]:
    """Those of the wanted parameters that are set; all without names. Raises as `call`."""
    if not wanted:
        from slidectl.description.parameter_trees import leaves  # the package is slow to import

        tree = json.loads((await daemon.call("/rosapi/get_param", {"name": "/"}))["value"])
        return [parameter(name, value) for name, value in leaves(tree, "/")]
    found = []
    for name in dict.fromkeys(wanted):
        if (await daemon.call("/rosapi/has_param", {"name": name}))["exists"]:
            value = (await daemon.call("/rosapi/get_param", {"name": name}))["value"]
            found.append(parameter(name, json.loads(value)))
    return found


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
        raise BadFrame(f"no encoding {quoted(encoding)}; there are {', '.join(ENCODINGS)}")
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
