"""Topics between the daemon and nodes of ROS 1, both ways.

`TopicServer` is the publisher of native topics: each is subscribed once in the daemon and encoded once, and the same
bytes go to all subscribers. `Follower` subscribes one foreign publisher while the topic has a native subscriber.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from typing import Any

from slidectl.errors import BadMessage, Refused, SlidectlError, listing
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros1 import xmlrpc
from slidectl.extensions.gateways.ros1.ros1_types import Ros1Type, ros1_type
from slidectl.extensions.gateways.ros1.tcpros import Fields, OutgoingConnection, TcprosConnection, frame
from slidectl.extensions.gateways.tasks import Tasks
from slidectl.wire.messages import Message

_log = logging.getLogger(__name__)

Row = tuple[int, str, str, str, str, bool, str]
"""A row of getBusInfo: id, destination or source, direction, transport, topic, connected, text."""

ANY_TYPE = "*"
_TRANSPORT = "TCPROS"
_MOST_ECHOES = 1000
_READ_AHEAD = 10_000
"""Messages that the daemon queues for the gateway: ten seconds at 1 kHz, in case the CPU is busy."""
_SETTLE_EVERY = 1024 * 1024
"""Bytes of foreign messages after which the gateway waits until the daemon has taken them."""
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 30.0
"""Pauses between attempts to connect to a publisher; rospy's values."""


class SubscriberLink:
    """One foreign subscriber. Until the latched messages are sent to it, new ones are kept in `pending`."""

    def __init__(self, connection: TcprosConnection, caller: str) -> None:
        self.connection = connection
        self.caller = caller
        self.pending: list[bytes] | None = []

    def send(self, framed: bytes) -> int:
        """Send or keep a message. Returns how many older messages were dropped."""
        if self.pending is None:
            return self.connection.send(framed)
        if len(self.pending) < _MOST_ECHOES:
            self.pending.append(framed)
        return 0

    def begin(self, latched: list[bytes]) -> None:
        """Send the latched messages, and then the pending ones."""
        since, self.pending = self.pending or [], None
        for framed in [*latched, *(one for one in since if one not in latched)]:
            self.connection.send(framed)


class TopicStream:
    """The messages of one topic of the daemon, and its foreign subscribers."""

    def __init__(self, name: str, kind: Ros1Type) -> None:
        self.name = name
        self.type = kind
        self.links: dict[SubscriberLink, None] = {}
        self.dropped = 0
        self.takes_latched = False
        """True while subscribers from before a daemon restart still need the latched messages."""
        self._active: tuple[SubscriberLink, ...] = ()
        self._echoes: deque[int] = deque(maxlen=_MOST_ECHOES)
        """Keys of messages that came from foreign publishers: foreign subscribers receive these directly."""

    def take(self, publish: Message) -> None:
        """Send a message of the daemon to all links. Latched ones are skipped: each link requests these itself."""
        if not self._active or (publish.get("latch") and not self.takes_latched):
            return
        body = self.type.pack(publish["msg"])
        if self._echoes and (key := self.type.key(body)) in self._echoes:
            self._echoes.remove(key)
            return
        framed = frame(body)
        for link in self._active:
            self.dropped += link.send(framed)

    def expect_echo(self, message: Message) -> None:
        """Register a message of a foreign publisher: the daemon will send it back, and it must be dropped then."""
        self._echoes.append(self.type.key(self.type.pack(message)))

    def add(self, link: SubscriberLink) -> None:
        self.links[link] = None
        self._update()

    def remove(self, link: SubscriberLink) -> None:
        self.links.pop(link, None)
        self._update()

    def _update(self) -> None:
        """Send to one link per node: a node may connect to another publisher before it leaves the last one."""
        self._active = tuple({link.caller: link for link in self.links}.values())


class TopicServer:
    """The publisher of all native topics. `callerid` of its headers is the first native publisher of the topic."""

    def __init__(self, node: str) -> None:
        self._node = node
        self.topics: dict[str, tuple[str, list[str]]] = {}
        """Topic -> type and native publishers; the list is empty if foreign subscribers wait for a publisher."""
        self.foreign_latched: Callable[[str], set[int]] = lambda _: set()
        """Returns the keys of a topic's messages latched by foreign publishers, which send these themselves."""
        self._streams: dict[str, TopicStream] = {}
        self._connection: DaemonConnection | None = None
        self._asker: DaemonConnection | None = None
        """The connection that reads latched messages, one topic at a time."""
        self._asking = asyncio.Lock()
        self._tasks = Tasks()
        self._lost = 0

    async def attach(self, connection: DaemonConnection, asker: DaemonConnection) -> None:
        """Subscribe all streams at a new daemon. Raises NoDaemon."""
        self._connection, self._asker = connection, asker
        for stream in list(self._streams.values()):
            stream.takes_latched = True
            try:
                await connection.subscribe(stream.name, stream.type.name, _READ_AHEAD, take=stream.take)
            except Refused as error:  # the topic has another type now
                for link in list(stream.links):
                    link.connection.close()
                _log.warning("%s: %s", stream.name, error)
            stream.takes_latched = False

    def detach(self) -> None:
        """Handle the end of the daemon. Subscribers of topics that are still served stay connected."""
        self._connection = self._asker = None

    @property
    def dropped(self) -> int:
        """The number of messages dropped because subscribers read too slowly."""
        return self._lost + sum(stream.dropped for stream in self._streams.values())

    def set_topics(self, topics: dict[str, tuple[str, list[str]]]) -> None:
        """Set the served topics. Subscribers of other topics are disconnected."""
        self.topics = topics
        for stream in list(self._streams.values()):
            if stream.name not in topics or topics[stream.name][0] != stream.type.name:
                for link in list(stream.links):
                    link.connection.close()

    def stream(self, topic: str) -> TopicStream | None:
        """The stream to foreign subscribers; None without any."""
        return self._streams.get(topic)

    def accept(self, connection: TcprosConnection, header: Fields) -> None:
        """Process a subscriber's header. The refusal texts are rospy's."""
        for required in ("topic", "md5sum", "callerid"):
            if required not in header:
                connection.refuse(f"Missing required '{required}' field")
                return
        name, caller = header["topic"], header["callerid"]
        if name not in self.topics:
            listed = listing(f"{topic} [{kind}]" for topic, (kind, _) in self.topics.items())
            connection.refuse(f"[{self._node}] is not a publisher of [{name}]. Topics are {listed}")
            return
        type_name, publishers = self.topics[name]
        kind = ros1_type(type_name)
        if header["md5sum"] not in (ANY_TYPE, kind.md5):
            asked = header.get("type", kind.name)
            if asked != kind.name:
                connection.refuse(f"topic types do not match: [{asked}] vs. [{kind.name}]")
            else:
                connection.refuse(
                    f"Client [{caller}] wants topic [{name}] to have datatype/md5sum [{asked}/{header['md5sum']}], "
                    f"but our version has [{kind.name}/{kind.md5}] Dropping connection."
                )
            return
        connection.ignore()
        self._tasks.begin(self._begin(connection, name, kind, caller, publishers))

    async def _begin(
        self, connection: TcprosConnection, name: str, kind: Ros1Type, caller: str, publishers: list[str]
    ) -> None:
        link = SubscriberLink(connection, caller)
        stream = self._streams.get(name)
        is_new = stream is None
        if stream is None:
            stream = self._streams[name] = TopicStream(name, kind)
        stream.add(link)
        connection.on_closed = lambda: self._leave(stream, link)
        try:
            if is_new and self._connection is not None:
                await self._connection.subscribe(name, kind.name, _READ_AHEAD, take=stream.take)
            latched = await self._latched(name, kind)
        except SlidectlError as error:
            for one in list(stream.links) if is_new else [link]:
                self._leave(stream, one)
                one.connection.refuse(str(error).replace("\n", "; "))
            return
        connection.send_header(
            {
                "callerid": publishers[0] if publishers else self._node,
                "latching": "1" if latched else "0",
                "md5sum": kind.md5,
                "message_definition": kind.definition,
                "topic": name,
                "type": kind.name,
            }
        )
        link.begin(latched)

    def _leave(self, stream: TopicStream, link: SubscriberLink) -> None:
        stream.remove(link)
        if not stream.links and self._streams.get(stream.name) is stream:
            self._lost += stream.dropped
            del self._streams[stream.name]
            if self._connection is not None:
                self._connection.unsubscribe(stream.name)

    async def _latched(self, name: str, kind: Ros1Type) -> list[bytes]:
        """The framed latched messages for a new subscriber, one of each publisher that latches."""
        found: list[bytes] = []

        def take(publish: Message) -> None:
            if publish.get("latch"):
                body = kind.pack(publish["msg"])
                if kind.key(body) not in self.foreign_latched(name):
                    found.append(frame(body))

        async with self._asking:
            if (asker := self._asker) is not None:
                await asker.subscribe(name, kind.name, take=take)
                asker.unsubscribe(name)
        return found

    def rows(self, node: str) -> list[Row]:
        """getBusInfo of a native node: its subscribers."""
        return [
            (link.connection.id, link.caller, "o", _TRANSPORT, stream.name, True, link.connection.where)
            for stream in self._published_by(node)
            for link in stream.links
        ]

    def statistics(self, node: str) -> list[Any]:
        """getBusStats of a native node as a publisher."""
        rows: list[Any] = []
        for stream in self._published_by(node):
            ends = [link.connection for link in stream.links]
            own = [[end.id, end.sent_bytes, end.sent, True] for end in ends]
            rows.append([stream.name, sum(end.sent_bytes - 4 * end.sent for end in ends), own])
        return rows

    def _published_by(self, node: str) -> list[TopicStream]:
        known = [stream for stream in self._streams.values() if stream.name in self.topics]
        return [stream for stream in known if node in (self.topics[stream.name][1] or [self._node])]


class Follower:
    """Subscribes one foreign publisher and publishes its messages in the daemon under its name, until closed."""

    def __init__(
        self,
        topic: str,
        kind: Ros1Type,
        node: str,
        uri: str,
        subscriber: str,
        take: Callable[[Message, bool], DaemonConnection | None],
    ) -> None:
        """`take` publishes a message (the flag: it is latched) and returns the daemon connection that it used."""
        self.topic = topic
        self.type = kind
        self.node = node
        self.uri = uri
        self.subscriber = subscriber
        """The native node whose name the publisher sees."""
        self.connection: TcprosConnection | None = None
        self._take = take
        self._is_latched = False
        self._unsettled = 0
        self._settling: asyncio.Task[None] | None = None
        self._warned = ""
        self._task = asyncio.get_running_loop().create_task(self._follow())

    def close(self) -> None:
        """End the subscription."""
        self._task.cancel()
        if self._settling is not None:
            self._settling.cancel()
        if self.connection is not None:
            self.connection.close()

    async def _follow(self) -> None:
        pause_s = _FIRST_PAUSE_S
        while True:
            try:
                outgoing = await self._connected()
                pause_s, self._warned = _FIRST_PAUSE_S, ""
                await outgoing.closed.wait()
            except SlidectlError as error:
                self._tell(str(error))
            self.connection = None
            await asyncio.sleep(pause_s)
            pause_s = min(_LONGEST_PAUSE_S, 2 * pause_s)

    def _tell(self, problem: str) -> None:
        if problem != self._warned:
            self._warned = problem
            _log.warning("%s of %s (%s): %s", self.topic, self.node, self.uri, problem)

    async def _connected(self) -> OutgoingConnection:
        """Connect to the publisher. Raises SlidectlError: not possible now."""
        answer = await xmlrpc.call(self.uri, "requestTopic", self.subscriber, self.topic, [[_TRANSPORT]])
        host, port = _address(answer)
        kind = self.type
        outgoing = await OutgoingConnection.connect(
            host,
            port,
            {
                "callerid": self.subscriber,
                "md5sum": kind.md5,
                "message_definition": kind.definition,
                "tcp_nodelay": "1",
                "topic": self.topic,
                "type": kind.name,
            },
            check=self._take_header,
        )
        self.connection = outgoing.connection
        outgoing.connection.on_message = self._take_message
        outgoing.connection.on_too_long = self._tell
        await outgoing.header()
        return outgoing

    def _take_header(self, header: Fields) -> None:
        kind = self.type
        if header.get("md5sum", ANY_TYPE) not in (ANY_TYPE, kind.md5):
            theirs = f"[{header.get('type', '')}/{header['md5sum']}]"
            raise Refused(f"it has the datatype/md5sum {theirs}, but our version has [{kind.name}/{kind.md5}]")
        self._is_latched = header.get("latching") == "1"

    def _take_message(self, body: bytes, _: bool) -> None:
        try:
            message = self.type.unpack(body)
        except BadMessage as error:
            self._tell(str(error))
            return
        daemon = self._take(message, self._is_latched)
        self._unsettled += len(body)
        if daemon is not None and self._unsettled > _SETTLE_EVERY and self._settling is None:
            self._settling = asyncio.get_running_loop().create_task(self._settle(daemon))

    async def _settle(self, daemon: DaemonConnection) -> None:
        """Stop reading until the daemon has taken the messages."""
        connection = self.connection
        try:
            if connection is not None:
                connection.pause_reading()
                await daemon.drain()
                connection.resume_reading()
        except SlidectlError:
            pass  # the daemon has ended; this follower will be closed
        finally:
            self._settling, self._unsettled = None, 0

    def row(self) -> Row | None:
        """getBusInfo of the native subscribers."""
        end = self.connection
        return (end.id, self.uri, "i", _TRANSPORT, self.topic, True, end.where) if end is not None else None

    def statistics(self) -> list[Any]:
        """One connection of getBusStats."""
        end = self.connection
        return [[end.id, end.received_bytes, end.received, -1, True]] if end is not None else []


def _address(answer: Any) -> tuple[str, int]:
    """Host and port from a publisher's answer. Raises Refused."""
    match answer:
        case [1, _, [str(transport), str(host), int(port)]] if transport == _TRANSPORT and 0 < port < 65536:
            return host, port
        case [int(), str(reason), *_]:
            raise Refused(f"requestTopic was refused: {reason[:500]}")
    raise Refused("requestTopic was answered with nonsense")
