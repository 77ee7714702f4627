"""The data connections of the ROS 1 gateway: the foreign nodes' part of the daemon's graph, and TCPROS both ways.

Other modules pass it the daemon's graph and the registrations of foreign nodes.
"""

from __future__ import annotations

import asyncio
import logging
import resource
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from slidectl import msgs
from slidectl.errors import NoDaemon, Refused, SlidectlError, TimedOut
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.extensions.gateways.ros1.service_bridge import ServiceServer, call_service, service_type
from slidectl.extensions.gateways.ros1.tcpros import Fields, TcprosConnection
from slidectl.extensions.gateways.ros1.topic_bridge import ANY_TYPE, Follower, TopicServer
from slidectl.extensions.gateways.strangers import Strangers
from slidectl.extensions.gateways.tasks import Tasks
from slidectl.web_access import in_uri
from slidectl.wire.messages import Message

_log = logging.getLogger(__name__)

OpenConnection = Callable[[str], Awaitable[DaemonConnection]]

MOST_CONNECTIONS = 1000
_LISTED_ONLY_MS = 10**9
"""Throttle of a subscription that only makes a node appear in the graph: after the first message nothing arrives."""
_OF_ACTIONS = ("ActionFeedback", "ActionResult", "actionlib_msgs/GoalStatusArray")
"""Type name endings of action topics, subscribed early: slidectl's client could miss a quick result otherwise."""
_PROBES = 4
_FIRST_PROBE_PAUSE_S = 0.5
_ASK_AGAIN_S = 1.0


class ForeignTopic(NamedTuple):
    """A topic of ROS nodes: its type, which may be `*`, its subscribers, and publisher -> address of the slave API."""

    type: str
    publishers: dict[str, str]
    subscribers: set[str]


_UNUSED = ForeignTopic(ANY_TYPE, {}, set())


class ForeignNode:
    """A ROS node's part of the daemon's graph, under its own name: what has been advertised and subscribed so far."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.published: dict[str, str] = {}
        """Topic -> type, as `subscribed`. `services` is service -> type."""
        self.subscribed: dict[str, str] = {}
        self.services: dict[str, str] = {}
        self.latched: dict[str, int] = {}
        """Topic -> the key of the newest message that it latched."""
        self.connection: DaemonConnection | None = None


class DataPlane:
    """TCPROS for all native nodes, and the foreign nodes' part of the daemon's graph.

    A foreign subscriber may ask any native node for any topic of `serves`: all native publishers of a topic share one
    stream. It stays connected while native publishers start and end.
    """

    def __init__(self, node: str, host: str, bind: str, any_user: bool) -> None:
        """`node` is the gateway's own node; other hosts connect to `host`; `bind` is the address to listen on.

        `any_user`: connections of other users of this machine are accepted too.
        """
        self.strangers = Strangers(any_user)
        self._node = node
        self._host = host
        self._bind = bind
        self._topics = TopicServer(node)
        self._topics.foreign_latched = self._latched_keys
        self._services = ServiceServer(node)
        self._server: asyncio.Server | None = None
        self._port = 0
        self._connections: dict[TcprosConnection, None] = {}
        """In the order in which they came."""
        self._most_connections = MOST_CONNECTIONS
        self._open_connection: OpenConnection | None = None
        self._own: list[DaemonConnection] = []
        self._natives: dict[str, Message] = {}
        """Topics of the daemon, without foreign nodes."""
        self._foreign_topics: dict[str, ForeignTopic] = {}
        self._offers: dict[str, tuple[str, str]] = {}
        self._service_types: dict[tuple[str, str], str] = {}
        """(service, URI) -> type; empty while the type is unknown, or if slidectl does not have it."""
        self._foreign: dict[str, ForeignNode] = {}
        self._followers: dict[tuple[str, str], Follower] = {}
        self._changed = asyncio.Event()
        self._unsettled: set[str] = set()
        """Foreign nodes whose part of the daemon's graph is out of date."""
        self._tasks = Tasks()

    # --- life ---------------------------------------------------------------------------------------------------

    async def open(self) -> int:
        """Listen for TCPROS. Returns the port. Raises Refused."""
        loop = asyncio.get_running_loop()
        self._most_connections = min(MOST_CONNECTIONS, resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 2)
        try:
            self._server = await loop.create_server(self._accepted, self._bind, 0, backlog=MOST_CONNECTIONS)
        except OSError as error:
            raise Refused(f"cannot listen on {self._bind}: {error.strerror or error}") from None
        self._port = self._server.sockets[0].getsockname()[1]
        self._tasks.begin(self._settle_changes())
        return self._port

    async def attach(self, open_connection: OpenConnection, main: DaemonConnection) -> None:
        """Connect to the daemon. Raises NoDaemon."""
        self._own = [await open_connection(f"{self._node}_{end}") for end in ("topics", "latched")]
        self._open_connection = open_connection
        await self._topics.attach(*self._own)
        self._services.attach(main)
        for topic in self._foreign_topics:
            self._touch(self._users(topic))
        self._touch({node for node, _ in self._offers.values()})

    async def detach(self) -> None:
        """Discard the graph of a daemon that has ended. Foreign subscribers stay connected."""
        self._open_connection = None
        self._natives = {}
        self._update_served()
        self._topics.detach()
        self._services.detach()
        for follower in self._followers.values():
            follower.close()
        self._followers.clear()
        for connection in [*self._own, *(one.connection for one in self._foreign.values() if one.connection)]:
            connection.close()
        self._own = []
        self._foreign.clear()

    async def close(self) -> None:
        """Stop listening and end all connections."""
        if self._server is not None:
            self._server.close()
        await self.detach()
        self._tasks.cancel()
        for connection in list(self._connections):
            connection.close()

    # --- what is told -------------------------------------------------------------------------------------------

    def set_graph(self, state: Message) -> None:
        """Set the newest answer of /slidectl/graph, without this process and foreign nodes."""
        before, self._natives = self._natives, {topic["name"]: topic for topic in state["topics"]}
        self._services.services = {one["name"]: (one["type"], one["node"]) for one in state["services"]}
        self._update_served()
        for topic in {*before, *self._natives}:
            self._update_followers(topic)
            if before.get(topic, {}).get("type") != self._natives.get(topic, {}).get("type"):
                self._touch(self._users(topic))

    def set_foreign_topic(self, topic: str, type: str, publishers: dict[str, str], subscribers: set[str]) -> None:
        """Set a topic's foreign publishers, node -> address of its slave API, and subscribers. The type may be `*`."""
        self._touch(self._users(topic))
        self._foreign_topics[topic] = ForeignTopic(type, publishers, subscribers)
        if not publishers and not subscribers:
            del self._foreign_topics[topic]
        self._touch(self._users(topic))
        self._update_followers(topic)
        self._update_served()

    def set_foreign_services(self, services: dict[str, tuple[str, str]]) -> None:
        """Set all foreign services: service -> node and rosrpc address."""
        self._touch({node for node, _ in self._offers.values()})
        self._offers = dict(services)
        self._touch({node for node, _ in services.values()})
        offered = {(service, uri) for service, (_, uri) in services.items()}
        self._service_types = {key: kind for key, kind in self._service_types.items() if key in offered}
        for service, uri in offered - self._service_types.keys():
            self._service_types[service, uri] = ""
            self._tasks.begin(self._find_type(service, uri))

    def node_gone(self, node: str) -> None:
        """Remove a foreign node that has unregistered or ended."""
        for topic, (kind, publishers, subscribers) in list(self._foreign_topics.items()):
            if node in publishers or node in subscribers:
                others = {other: uri for other, uri in publishers.items() if other != node}
                self.set_foreign_topic(topic, kind, others, subscribers - {node})
        self.set_foreign_services({s: offer for s, offer in self._offers.items() if offer[0] != node})

    # --- what is asked ------------------------------------------------------------------------------------------

    def serves(self, topic: str) -> bool:
        """True for topics that foreign nodes may subscribe here: they have native publishers or foreign subscribers."""
        return topic in self._topics.topics

    def request_topic(self, topic: str, protocols: Any) -> tuple[int, str, Any]:
        """Answer requestTopic of the slave API of a native node."""
        if not self.serves(topic):
            return -1, f"Not a publisher of [{topic}]", []
        if not any(isinstance(one, list) and one[:1] == ["TCPROS"] for one in protocols):
            return 0, "no supported protocol implementations", []
        return 1, f"ready on {self._host}:{self._port}", ["TCPROS", self._host, self._port]

    def service_uri(self) -> str:
        """The rosrpc address of all native services."""
        return f"rosrpc://{in_uri(self._host)}:{self._port}"

    def bus_info(self, node: str) -> list[Any]:
        """getBusInfo of a native node."""
        followed = (one.row() for one in self._followers.values() if self._subscribes(node, one.topic))
        return [*self._topics.rows(node), *filter(None, followed)]

    def bus_stats(self, node: str) -> list[Any]:
        """getBusStats of a native node."""
        followed = [
            [one.topic, one.statistics()] for one in self._followers.values() if self._subscribes(node, one.topic)
        ]
        return [self._topics.statistics(node), followed, []]

    @property
    def connections(self) -> int:
        """The number of TCPROS connections, in both directions."""
        return len(self._connections) + sum(one.connection is not None for one in self._followers.values())

    @property
    def dropped(self) -> int:
        """The number of messages dropped because subscribers read too slowly."""
        return self._topics.dropped

    # --- TCPROS -------------------------------------------------------------------------------------------------

    def _accepted(self) -> TcprosConnection:
        connection = TcprosConnection(self._take_header)
        connection.on_opened = self._opened
        return connection

    def _opened(self, connection: TcprosConnection) -> None:
        if why := connection.stranger(self.strangers):
            connection.refuse(why)
            connection.close()
            self.strangers.gone(connection)
            return
        if len(self._connections) >= self._most_connections:
            unfinished = next((one for one in self._connections if not one.has_header), None)
            if unfinished is None:
                connection.refuse(f"too many connections: {self._most_connections} are open")
                connection.close()
                return
            unfinished.close()
        self._connections[connection] = None
        connection.on_gone = lambda gone: self._connections.pop(gone, None)

    def _take_header(self, connection: TcprosConnection, header: Fields) -> None:
        if "topic" in header:
            self._topics.accept(connection, header)
        elif "service" in header:
            self._services.accept(connection, header)
        else:
            connection.refuse("no topic or service name detected")

    # --- foreign nodes in the daemon's graph --------------------------------------------------------------------

    def _type_of(self, topic: str) -> str:
        """The type of a topic; empty when slidectl does not know it."""
        if topic in self._natives:
            return str(self._natives[topic]["type"])
        kind = self._foreign_topics.get(topic, _UNUSED).type
        return kind if kind != ANY_TYPE and msgs.exists(kind) else ""

    def _users(self, topic: str) -> set[str]:
        """The foreign nodes that publish or subscribe the topic."""
        _, publishers, subscribers = self._foreign_topics.get(topic, _UNUSED)
        return {*publishers, *subscribers}

    def _subscribes(self, node: str, topic: str) -> bool:
        return node in self._natives.get(topic, {}).get("subscribers", ())

    def _publishes(self, node: str, topic: str) -> bool:
        """True when the daemon knows the node as a publisher. Earlier, its first message would be lost."""
        return node in self._foreign and topic in self._foreign[node].published

    def _latched_keys(self, topic: str) -> set[int]:
        return {one.latched[topic] for one in self._foreign.values() if topic in one.latched}

    def _update_served(self) -> None:
        served = {name: (str(one["type"]), one["publishers"]) for name, one in self._natives.items()}
        awaited = {topic for topic, one in self._foreign_topics.items() if one.subscribers and self._type_of(topic)}
        topics = {topic: served.get(topic) or (self._type_of(topic), []) for topic in {*served, *awaited}}
        self._topics.set_topics({name: one for name, one in topics.items() if one[1] or name in awaited})

    def _touch(self, nodes: Iterable[str]) -> None:
        self._unsettled.update(nodes)
        self._changed.set()

    async def _settle_changes(self) -> None:
        """Update the daemon's graph with the foreign nodes' parts, one node after the other."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            while self._unsettled and self._open_connection is not None:
                name = self._unsettled.pop()
                try:
                    await self._settle(name, self._open_connection)
                except (NoDaemon, TimedOut) as error:  # daemon ended or silent, or no descriptors left
                    _log.warning("%s: %s; it is tried again", name, error)
                    await asyncio.sleep(_ASK_AGAIN_S)
                    self._touch({name})
                except SlidectlError as error:
                    _log.warning("%s: %s", name, error)
                except Exception:  # an internal error with one node must not stop the others
                    _log.exception("%s cannot be shown in the daemon's graph", name)

    async def _settle(self, name: str, open_connection: OpenConnection) -> None:
        node = self._foreign.setdefault(name, ForeignNode(name))
        published = {t: self._type_of(t) for t, one in self._foreign_topics.items() if name in one.publishers}
        subscribed = {t: self._type_of(t) for t, one in self._foreign_topics.items() if name in one.subscribers}
        offers = {s: (uri, self._service_types[s, uri]) for s, (n, uri) in self._offers.items() if n == name}
        published, subscribed = ({t: kind for t, kind in some.items() if kind} for some in (published, subscribed))
        services = {service: kind for service, (_, kind) in offers.items() if kind}
        if node.connection is None:
            if not (published or subscribed or services):
                del self._foreign[name]
                return
            node.connection = await open_connection(name)
            node.connection.on_refused = lambda text: _log.warning("%s: %s", name, text)
            if self._foreign.get(name) is not node:  # `detach` came first
                node.connection.close()
                return
        daemon = node.connection
        for topic in [topic for topic, kind in node.published.items() if published.get(topic) != kind]:
            daemon.unadvertise(topic)
            node.latched.pop(topic, None)
            del node.published[topic]
        for topic in [topic for topic, kind in node.subscribed.items() if subscribed.get(topic) != kind]:
            daemon.unsubscribe(topic)
            del node.subscribed[topic]
        for service in [service for service, kind in node.services.items() if services.get(service) != kind]:
            daemon.unadvertise_service(service)
            del node.services[service]
        for topic, kind in published.items():
            if topic not in node.published:
                daemon.advertise(topic, kind)
                node.published[topic] = kind
                self._update_followers(topic)
        for topic, kind in subscribed.items():
            if topic not in node.subscribed:
                with self._told(name):
                    await daemon.subscribe(topic, kind, throttle_rate=_LISTED_ONLY_MS, take=lambda _: None)
                    node.subscribed[topic] = kind
        for service, kind in services.items():
            if service not in node.services:
                with self._told(name):
                    await self._offer(daemon, service, kind)
                    node.services[service] = kind
        if not (node.published or node.subscribed or node.services):
            daemon.close()
            self._foreign.pop(name, None)

    @contextmanager
    def _told(self, name: str) -> Iterator[None]:
        """Log a refusal of the daemon as a warning and continue."""
        try:
            yield
        except Refused as error:
            _log.warning("%s: %s", name, error)

    # --- messages of foreign publishers -------------------------------------------------------------------------

    def _update_followers(self, topic: str) -> None:
        """Update the followers of a topic: it needs them with native subscribers, or as an action topic."""
        subscribers = self._natives.get(topic, {}).get("subscribers", ())
        kind = self._type_of(topic)
        is_wanted = bool(subscribers) or kind.endswith(_OF_ACTIONS)
        publishers = self._foreign_topics.get(topic, _UNUSED).publishers if is_wanted and kind else {}
        publishers = {node: uri for node, uri in publishers.items() if self._publishes(node, topic)}
        for (of, node), follower in list(self._followers.items()):
            if of == topic and (publishers.get(node) != follower.uri or follower.type.name != kind):
                self._followers.pop((of, node)).close()
        for node, uri in publishers.items():
            if (topic, node) not in self._followers:
                take = self._taker(topic, node)
                subscriber = subscribers[0] if subscribers else self._node
                self._followers[topic, node] = Follower(topic, ros1_type(kind), node, uri, subscriber, take)

    def _taker(self, topic: str, node: str) -> Callable[[Message, bool], DaemonConnection | None]:
        def take(message: Message, is_latched: bool) -> DaemonConnection | None:
            foreign = self._foreign.get(node)
            if foreign is None or foreign.connection is None:
                return None
            stream = self._topics.stream(topic)
            if stream is not None:
                stream.expect_echo(message)
            if is_latched:
                kind = ros1_type(self._type_of(topic))
                if topic not in foreign.latched:
                    foreign.connection.advertise(topic, kind.name, latch=True)
                foreign.latched[topic] = kind.key(kind.pack(message))
            foreign.connection.publish(topic, message)
            return foreign.connection

        return take

    # --- foreign services ---------------------------------------------------------------------------------------

    async def _find_type(self, service: str, uri: str) -> None:
        """Ask a service for its type; repeat when it does not answer yet."""
        problem = ""
        for attempt in range(_PROBES):
            try:
                kind, md5 = await service_type(service, uri, self._node)
            except SlidectlError as error:
                problem = str(error)
                await asyncio.sleep(_FIRST_PROBE_PAUSE_S * 2**attempt)
                continue
            if not msgs.service_exists(kind):
                return  # a user-defined type: only foreign clients can call it
            if md5 != msgs.service_md5(kind):
                problem = f"its {kind} has the md5sum {md5}, and slidectl's has {msgs.service_md5(kind)}"
                break
            if (service, uri) in self._service_types:
                self._service_types[service, uri] = kind
                self._touch({self._offers[service][0]})
            return
        _log.warning("the service %s (%s) cannot be called from slidectl: %s", service, uri, problem)

    async def _offer(self, daemon: DaemonConnection, service: str, kind: str) -> None:
        async def handle(request: Message) -> Message:
            if service not in self._offers:
                raise Refused(f"{service} is provided no longer")
            return await call_service(service, self._offers[service][1], kind, request, self._node)

        await daemon.advertise_service(service, kind, handle)
