"""The ROS master: registrations of foreign nodes together with the daemon's graph, under ROS's Master API.

The answer texts are rosmaster's. A registration ends when its node unregisters. As with rosmaster, a killed node stays
registered until `rosnode cleanup`, or until a node with the same name registers.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable, Iterable
from typing import Any

from slidectl.errors import Refused, SlidectlError, cut
from slidectl.extensions.gateways.ros1 import api_calls, xmlrpc
from slidectl.extensions.gateways.ros1.api_calls import ANY_TYPE, Answered, Api
from slidectl.extensions.gateways.ros1.data_plane import DataPlane
from slidectl.extensions.gateways.ros1.native_graph import OWN_NODE, NativeGraph
from slidectl.extensions.gateways.tasks import Tasks

_log = logging.getLogger(__name__)

MOST_NODES = 300
"""Limit of foreign nodes: each may need a connection to the daemon, which accepts 512."""
MOST_REGISTRATIONS = 20_000
_MOST_TYPES = 20_000
PARAMETERS = "parameters"
_COMMANDS = "/slidectl_"
"""Name prefix of connections without a node name of their own."""
_PUBLISHERS, _SUBSCRIBERS, _SERVICES = "publishers", "subscribers", "services"
_MOST_AT_ONCE = 50
"""Nodes called at the same time: each call needs a file descriptor."""


class Registrations:
    """The registrations of foreign nodes.

    `addresses` is node -> address of its slave API. `kinds` is kind -> key (a topic, service or parameter) -> node ->
    address (for a service, the service's address).
    """

    def __init__(self) -> None:
        self.addresses: dict[str, str] = {}
        self.kinds: dict[str, dict[str, dict[str, str]]] = {
            kind: {} for kind in (_PUBLISHERS, _SUBSCRIBERS, _SERVICES, PARAMETERS)
        }
        self._held: dict[str, set[tuple[str, str]]] = {}
        self._count = 0

    def add(self, kind: str, key: str, node: str, address: str, uri: str = "") -> None:
        """Register a key for a node. Raises Refused: too many registrations."""
        is_too_many = len(self.addresses) >= MOST_NODES and node not in self.addresses
        if is_too_many or self._count >= MOST_REGISTRATIONS:
            what = f"{MOST_NODES} nodes are" if is_too_many else f"{MOST_REGISTRATIONS} registrations are"
            raise Refused(f"{what} registered, the maximum", "rosnode cleanup takes away those that are dead")
        self.addresses[node] = address
        self.kinds[kind].setdefault(key, {})[node] = uri or address
        held = self._held.setdefault(node, set())
        self._count += (kind, key) not in held
        held.add((kind, key))

    def remove(self, kind: str, key: str, node: str) -> None:
        holders = self.kinds[kind].get(key, {})
        if node in holders:
            del holders[node]
            if not holders:
                del self.kinds[kind][key]
            self._held[node].discard((kind, key))
            self._count -= 1
            if not self._held[node]:
                del self._held[node], self.addresses[node]

    def remove_node(self, node: str) -> list[tuple[str, str]]:
        """Remove all registrations of a node. Returns their kinds and keys."""
        held = list(self._held.get(node, ()))
        for kind, key in held:
            self.remove(kind, key, node)
        return held


class NodeCalls:
    """Calls to foreign nodes: one at a time per node, the newest per method and first argument.

    A failed call is not repeated, as with rosmaster.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, dict[tuple[str, str], tuple[tuple[Any, ...], Callable[[Any], None] | None]]] = {}
        self._tasks = Tasks()
        self._limit = asyncio.Semaphore(_MOST_AT_ONCE)

    def send(self, uri: str, method: str, *arguments: Any, take: Callable[[Any], None] | None = None) -> None:
        """Call `method` of the node at this address, with the master as caller; `take` gets the answer.

        Of waiting calls with the same method and first argument (a topic, a parameter) only the newest is sent.
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
        """Cancel all calls."""
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


class Master:
    """The master for foreign nodes. `uri` is its own address."""

    def __init__(self, natives: NativeGraph, calls: NodeCalls, data: DataPlane) -> None:
        self.uri = ""
        self.registrations = Registrations()
        self._natives = natives
        self._calls = calls
        self._data = data
        self._types: dict[str, str] = {}
        self._shown: dict[str, str] = {}
        """Topic -> the native node that its foreign subscribers were given as publisher."""
        kinds = self.registrations.kinds
        self._publishers, self._subscribers = kinds[_PUBLISHERS], kinds[_SUBSCRIBERS]
        self._services = kinds[_SERVICES]

    def add_methods(self, api: Api) -> None:
        """Add the methods of the Master API and those common to all nodes."""
        topic, topic_type, address = api_calls.name("topic"), api_calls.type_name, api_calls.uri("caller_api")
        service, service_address = api_calls.name("service"), api_calls.uri("service_api")
        api.add(self.registerService, 0, service, service_address, address)
        api.add(self.unregisterService, 0, service, service_address)
        api.add(self.registerSubscriber, [], topic, topic_type, address)
        api.add(self.unregisterSubscriber, 0, topic, address)
        api.add(self.registerPublisher, [], topic, topic_type, address)
        api.add(self.unregisterPublisher, 0, topic, address)
        api.add(self.lookupNode, "", api_calls.name("node", may_be_root=True))
        api.add(self.lookupService, "", service)
        api.add(self.getPublishedTopics, 0, api_calls.subgraph)
        api.add(self.getTopicTypes, [])
        api.add(self.getSystemState, [[], [], []])
        api.add(self.getUri, "")
        api.add(self.getPid, -1)
        api.add(self.shutdown, 0, api_calls.anything)

    # --- registering --------------------------------------------------------------------------------------------

    def registerService(self, caller: str, service: str, service_api: str, caller_api: str) -> Answered:  # noqa: N802
        self.admit(caller, caller_api)
        for node in list(self._services.get(service, ())):
            if node != caller:
                self.registrations.remove(_SERVICES, service, node)
        self.registrations.add(_SERVICES, service, caller, caller_api, service_api)
        self.tell_services()
        return 1, f"Registered [{caller}] as provider of [{service}]", 1

    def unregisterService(self, caller: str, service: str, service_api: str) -> Answered:  # noqa: N802
        if caller not in self.registrations.addresses:
            return 1, f"[{caller}] is not a registered node", 0
        if self._services.get(service, {}).get(caller) != service_api:
            return 1, f"[{service_api}] is no longer the current service api handle for [{service}]", 0
        self.registrations.remove(_SERVICES, service, caller)
        self.tell_services()
        self._tell_if_gone(caller)
        return 1, f"Unregistered [{caller}] as provider of [{service}]", 1

    def registerSubscriber(self, caller: str, topic: str, topic_type: str, caller_api: str) -> Answered:  # noqa: N802
        self.admit(caller, caller_api)
        self.registrations.add(_SUBSCRIBERS, topic, caller, caller_api)
        if topic not in self._types and topic_type != ANY_TYPE:
            self._set_type(topic, topic_type)
        self.tell_topic(topic)
        if len(self._subscribers[topic]) == 1:
            self._shown.pop(topic, None)
        return 1, f"Subscribed to [{topic}]", self._publisher_uris(topic)

    def unregisterSubscriber(self, caller: str, topic: str, caller_api: str) -> Answered:  # noqa: N802
        return self._unregister(_SUBSCRIBERS, caller, topic, caller_api)

    def registerPublisher(self, caller: str, topic: str, topic_type: str, caller_api: str) -> Answered:  # noqa: N802
        self.admit(caller, caller_api)
        self.registrations.add(_PUBLISHERS, topic, caller, caller_api)
        if topic not in self._types or topic_type != ANY_TYPE:
            self._set_type(topic, topic_type)
        self.tell_topic(topic)
        self.notify_subscribers(topic)
        natives = map(self._natives.uri_of, self._natives.subscribers.get(topic, ()))
        subscribers = [*self._subscribers.get(topic, {}).values(), *natives]
        return 1, f"Registered [{caller}] as publisher of [{topic}]", subscribers

    def unregisterPublisher(self, caller: str, topic: str, caller_api: str) -> Answered:  # noqa: N802
        answer = self._unregister(_PUBLISHERS, caller, topic, caller_api)
        if answer[2]:
            self.notify_subscribers(topic)
        return answer

    def _unregister(self, kind: str, caller: str, topic: str, caller_api: str) -> Answered:
        if caller not in self.registrations.addresses:
            return 1, f"[{caller}] is not a registered node", 0
        if self.registrations.kinds[kind].get(topic, {}).get(caller) != caller_api:
            return 1, f"[{caller}] is not a known provider of [{topic}]", 0
        self.registrations.remove(kind, topic, caller)
        self.tell_topic(topic)
        self._tell_if_gone(caller)
        return 1, f"Unregistered [{caller}] as provider of [{topic}]", 1

    def admit(self, node: str, address: str) -> None:
        """Accept a node that registers something. Raises Refused: slidectl has a node of this name; the new one is shut
        down.

        A foreign node with the same name at another address is shut down, as in ROS.
        """
        if node in self._natives.nodes:
            self._calls.send(address, "shutdown", f"[{node}] Reason: slidectl has a node of this name")
            raise Refused(f"slidectl has a node [{node}]; give yours another name")
        before = self.registrations.addresses.get(node)
        if before is not None and before != address:
            self._calls.send(before, "shutdown", f"[{node}] Reason: new node registered with same name")
            self._forget(node)

    def _forget(self, node: str) -> None:
        taken = self.registrations.remove_node(node)
        self._data.node_gone(node)
        for kind, key in taken:
            if kind in (_PUBLISHERS, _SUBSCRIBERS):
                self.tell_topic(key)
            if kind == _PUBLISHERS:
                self.notify_subscribers(key)
        self.tell_services()

    def _tell_if_gone(self, node: str) -> None:
        if node not in self.registrations.addresses:
            self._data.node_gone(node)

    def _set_type(self, topic: str, topic_type: str) -> None:
        self._types[topic] = topic_type
        if len(self._types) > _MOST_TYPES:
            del self._types[next(iter(self._types))]

    # --- telling ------------------------------------------------------------------------------------------------

    def tell_topic(self, topic: str) -> None:
        """Pass the foreign publishers and subscribers of a topic to the data plane."""
        kind = self._types.get(topic, ANY_TYPE)
        publishers, subscribers = dict(self._publishers.get(topic, {})), set(self._subscribers.get(topic, {}))
        self._data.set_foreign_topic(topic, kind, publishers, subscribers)

    def tell_services(self) -> None:
        """Pass the foreign services to the data plane."""
        provided = {service: next(iter(nodes.items())) for service, nodes in self._services.items()}
        self._data.set_foreign_services(provided)

    def notify_subscribers(self, topic: str) -> None:
        """Send the list of publishers to the foreign subscribers of a topic."""
        uris = self._publisher_uris(topic)
        for address in set(self._subscribers.get(topic, {}).values()):
            self._calls.send(address, "publisherUpdate", topic, uris)

    def natives_changed(self) -> None:
        """Notify the foreign subscribers of topics whose native publisher has changed."""
        for topic in self._subscribers:
            before = self._shown.get(topic, "")
            if self._native_publisher(topic) != before:
                self.notify_subscribers(topic)

    def _native_publisher(self, topic: str) -> str:
        """The node that represents all native publishers of a topic; empty when the topic is not served.

        Without a publisher it is the gateway's own node, so that messages of a short-lived command are received. The
        node is kept as long as possible: foreign subscribers keep their connection, and no message is lost.
        """
        if not self._data.serves(topic):
            self._shown.pop(topic, None)
            return ""
        publishers = self._natives.publishers.get(topic, ())
        shown = self._shown.get(topic, "")
        if shown not in (OWN_NODE, *publishers):
            shown = next((node for node in publishers if not node.startswith(_COMMANDS)), OWN_NODE)
            self._shown[topic] = shown
        return shown

    def _publisher_uris(self, topic: str) -> list[str]:
        native = self._native_publisher(topic)
        natives = [self._natives.uri_of(native)] if native else []
        return [*natives, *self._publishers.get(topic, {}).values()]

    # --- asking -------------------------------------------------------------------------------------------------

    def lookupNode(self, _: str, node: str) -> Answered:  # noqa: N802
        if (address := self.registrations.addresses.get(node)) is not None:
            return 1, "node api", address
        if node in self._natives.nodes:
            return 1, "node api", self._natives.uri_of(node)
        return -1, f"unknown node [{node}]", ""

    def lookupService(self, _: str, service: str) -> Answered:  # noqa: N802
        for uri in self._services.get(service, {}).values():
            return 1, f"rosrpc URI: [{uri}]", uri
        if service in self._natives.services:
            uri = self._natives.service_uri
            return 1, f"rosrpc URI: [{uri}]", uri
        return -1, "no provider", ""

    def getPublishedTopics(self, _: str, subgraph: str) -> Answered:  # noqa: N802
        below = f"{subgraph.rstrip('/')}/" if subgraph else ""
        types = self._all_types()
        topics = dict.fromkeys((*self._natives.publishers, *self._publishers))
        return 1, "current topics", [[t, types.get(t, ANY_TYPE)] for t in topics if t.startswith(below)]

    def getTopicTypes(self, _: str) -> Answered:  # noqa: N802
        return 1, "current system state", [[topic, kind] for topic, kind in self._all_types().items()]

    def getSystemState(self, _: str) -> Answered:  # noqa: N802
        natives = self._natives
        services = {service: [node] for service, node in natives.services.items()}
        state = [
            _joined(natives.publishers, self._publishers),
            _joined(natives.subscribers, self._subscribers),
            _joined(services, self._services, is_single=True),
        ]
        return 1, "current system state", state

    def getUri(self, _: str) -> Answered:  # noqa: N802
        return 1, "", self.uri

    def getPid(self, _: str) -> Answered:  # noqa: N802
        return 1, "", os.getpid()

    def shutdown(self, caller: str, _: Any) -> Answered:
        """Refuse: the master ends with its process. Any node could call this and cut the simulation off."""
        _log.info("%s asks the master to shut down: refused", cut(caller, 120))
        return -1, "the gateway ends with: slidectl gateway ros1 stop", 0

    def _all_types(self) -> dict[str, str]:
        return self._types | self._natives.types


def _joined(
    natives: dict[str, list[str]], foreign: dict[str, dict[str, str]], is_single: bool = False
) -> list[list[Any]]:
    """Key -> nodes, native and foreign. With `is_single` a foreign node replaces the native one."""
    keys: Iterable[str] = dict.fromkeys((*natives, *foreign))
    return [
        [key, [*(() if is_single and key in foreign else natives.get(key, ())), *foreign.get(key, ())]] for key in keys
    ]
