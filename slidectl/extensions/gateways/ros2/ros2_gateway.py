"""The ROS 2 gateway: what the daemon has, as nodes of ROS 2, and what nodes of ROS 2 have, in the daemon."""

from __future__ import annotations

import asyncio
import json
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from typing import Any, TypeVar

from slidectl import msgs, names
from slidectl.errors import Refused, SlidectlError, TimedOut
from slidectl.extensions.gateways.daemon_connection import (
    GRAPH_CHANGES,
    PARAMETER_CHANGES,
    DaemonConnection,
    connect_as,
)
from slidectl.extensions.gateways.gateway import Gateway, GatewayOptions, is_offered
from slidectl.extensions.gateways.ros2 import conversion as types
from slidectl.extensions.gateways.ros2.foreign_nodes import ForeignNodes, NodePart
from slidectl.extensions.gateways.ros2.parameter_services import ManagerParameterServices, ParameterServices
from slidectl.extensions.gateways.ros2.participant import Participant
from slidectl.extensions.gateways.ros2.ros2_actions import OfferedAction, actions_of, is_of_action
from slidectl.extensions.gateways.ros2.ros2_graph import EMPTY, UNUSED, GraphReader, Ros2Graph, Ros2Topic
from slidectl.extensions.gateways.ros2.ros2_services import (
    ConfigureOfRos1,
    ForeignServices,
    OfferedService,
    as_in_ros2,
)
from slidectl.extensions.gateways.ros2.ros2_topics import NOTHING, TopicBridge, Wanted
from slidectl.paths import InstancePaths
from slidectl.web_access import check_effects
from slidectl.wire.messages import Message

T = TypeVar("T")
_log = logging.getLogger(__name__)

_OWN_NODE = "/ros2_gateway"
"""The node name of the gateway's own connections to the daemon."""
_LOOK_EVERY_S = 0.2
"""Wall seconds between two looks at ROS 2's graph: rclpy announces no changes of it."""
_GATHER_S = 0.01
_ASK_AGAIN_S = 1.0
_MANAGER = "/controller_manager"
_DESCRIPTION = "/robot_description"
_TRANSFORMS = "tf2_msgs/TFMessage"


@dataclass(frozen=True)
class Ros2Options(GatewayOptions):
    """The domain, and what nodes of ROS 2 may see and do."""

    domain: int | None = None
    """ROS_DOMAIN_ID; by default that of the environment, or 0."""
    any_host: bool = False
    """Let nodes of other hosts take part."""
    read_only: bool = False
    """Nodes of ROS 2 can subscribe, and call services that only read."""
    topics: tuple[str, ...] = ()
    """Patterns (`*`, `?`, `[...]`) of the topics and actions to bridge; all without one."""


class Ros2Gateway(Gateway):
    """One participant of ROS 2 with a node for each node and controller of the daemon."""

    Options = Ros2Options

    def __init__(self, options: Ros2Options) -> None:
        """Raises UsageError: the options contradict each other, or there is no such domain."""
        super().__init__()
        self._options = options
        self._permitted = check_effects(options.read_only, options.allow)
        self._participant = Participant(options.domain, options.any_host)
        self._own_node = f"/_slidectl_{os.getpid()}"
        """Hidden in ROS 2, as names with an underscore are: it reads the graph and calls foreign services."""
        self._paths: InstancePaths | None = None
        self._main: DaemonConnection | None = None
        self._asker: DaemonConnection | None = None
        self._following: asyncio.Task[None] | None = None
        self._graph_changed = asyncio.Event()
        self._described: set[str] | None = None
        """Changed names of parameters that may be descriptions of robots; None before the first look."""
        self._native: dict[str, Any] = {"topics": [], "services": [], "actions": {}}
        self._managed: dict[str, None] = {}
        """Nodes of controllers and of their managers."""
        self._nodes: dict[str, Any] = {}
        """Our nodes in ROS 2, by full name."""
        self._bridges: dict[str, TopicBridge] = {}
        self._offered: dict[str, OfferedService] = {}
        self._actions: dict[str, OfferedAction] = {}
        self._parameters: dict[str, ParameterServices] = {}
        """Node of ours -> the services of its parameters."""
        self._descriptions: dict[str, Any] = {}
        """Topic of a robot's description -> its publisher."""
        self._latched: dict[str, bool] = {}
        self._foreign = EMPTY
        self._left_out: dict[str, str] = {}
        """Package or type that ROS 2 lacks -> why."""
        self._dropped = 0
        self._proxies = ForeignNodes(self._connect_proxy, self._call_foreign)
        self._proxy_names: dict[str, DaemonConnection] = {}
        """Names in the daemon of nodes of ROS 2, and of those that have just ended."""

    # --- Gateway ------------------------------------------------------------------------------------------------

    async def open(self) -> str:
        address = self._participant.open()
        try:
            self._nodes[self._own_node] = node = await self._participant.run(
                lambda: self._participant.node(self._own_node)
            )
        except BaseException:
            self._participant.close()
            raise
        self._reader = GraphReader(node)
        self._services = ForeignServices(self._participant, node)
        return address

    async def attach(self, paths: InstancePaths) -> None:
        self._paths = paths
        self._main = main = await self._connect(_OWN_NODE)
        self._asker = await self._connect(f"{_OWN_NODE}_latched")
        main.on_refused = lambda text: _log.warning("%s", text)
        self._described = None
        await main.subscribe(GRAPH_CHANGES, "std_msgs/Empty", take=lambda _: self._graph_changed.set())
        await main.subscribe(PARAMETER_CHANGES, "slidectl/ParameterChanges", take=self._take_changes)
        self._graph_changed.set()
        await self._settle()
        self._following = asyncio.get_running_loop().create_task(self._follow())

    async def detach(self) -> None:
        if self._following is not None:
            self._following.cancel()
            with suppress(asyncio.CancelledError):
                await self._following
            self._following = None
        if self._main is None:
            return
        self._proxies.close()
        for connection in (self._main, self._asker):
            if connection is not None:
                connection.close()
        self._main = self._asker = None
        self._proxy_names.clear()
        self._dropped += sum(bridge.dropped for bridge in self._bridges.values())
        await self._participant.run(self._end_all)
        for known in (self._bridges, self._offered, self._actions, self._descriptions, self._latched, self._managed):
            known.clear()
        self._left_out = {name: why for name, why in self._left_out.items() if not name.startswith("/")}

    def _end_all(self) -> None:
        """End everything in ROS 2 but the gateway's own node."""
        for bridge in self._bridges.values():
            bridge.set_ends(NOTHING, self._nodes)
        for service in self._offered.values():
            service.close()
        for action in self._actions.values():
            action.close()
        own = self._nodes[self._own_node]
        for publisher in self._descriptions.values():
            own.destroy_publisher(publisher)
        for name in [name for name in self._nodes if name != self._own_node]:
            self._end_node(name)
        self._reader.forget()

    def _end_node(self, name: str) -> None:
        node = self._nodes.pop(name)
        if name in self._parameters:
            self._parameters.pop(name).close(node)
        node.destroy_node()

    async def close(self) -> None:
        await self.detach()
        self._participant.close()

    def status(self) -> dict[str, Any]:
        dropped = self._dropped + sum(bridge.dropped for bridge in self._bridges.values())
        counts: dict[str, Any] = {"connections": len(self._proxies), "dropped": dropped, "nodes": len(self._nodes) - 1}
        if self._left_out:
            counts["left_out"] = ", ".join(sorted(self._left_out))
        return counts

    # --- the daemon ---------------------------------------------------------------------------------------------

    async def _connect(self, node: str) -> DaemonConnection:
        """Connect to the daemon under this node name. Raises Refused: the name is taken; NoDaemon."""
        assert self._paths is not None
        return await DaemonConnection.open(self._paths, self._permitted, node, self.lost.set)

    async def _connect_proxy(self, node: str) -> DaemonConnection:
        """Connect on behalf of a node of ROS 2; under another name when the daemon has a node of this name."""
        return await connect_as(node, "ROS 2", f"{node}_ros2", self._proxy)

    async def _proxy(self, name: str) -> DaemonConnection:
        connection = await self._connect(name)
        self._proxy_names[name] = connection
        return connection

    def _take_changes(self, published: Message) -> None:
        if self._described is not None:
            self._described.update(name for name in published["msg"]["names"] if name.endswith(_DESCRIPTION))
        self._graph_changed.set()

    async def _follow(self) -> None:
        """Follow the changes of both graphs until the daemon ends."""
        while True:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._graph_changed.wait(), _LOOK_EVERY_S)
            try:
                if self._graph_changed.is_set():
                    await asyncio.sleep(_GATHER_S)  # a spawn makes many changes
                await self._settle()
            except SlidectlError as error:
                if self._main is None or not self._main.is_open:
                    return
                _log.warning("the graph: %s; it is asked again", error)
                await self._ask_again()
            except Exception:  # an internal error with one graph must not stop the next
                _log.exception("the graph")
                await self._ask_again()

    async def _ask_again(self) -> None:
        """Let the next look take everything in once more, after a while."""
        self._graph_changed.set()
        await asyncio.sleep(_ASK_AGAIN_S)

    async def _settle(self) -> None:
        """Bring both sides up to date. Raises SlidectlError."""
        assert self._main is not None
        own = frozenset(self._nodes)
        foreign = await self._participant.run(lambda: self._reader.read(own))
        has_changed = self._graph_changed.is_set()
        if foreign == self._foreign and not has_changed:
            return
        if has_changed:
            self._graph_changed.clear()
            await self._read_native(self._main)
        for name in foreign.doubles - self._foreign.doubles:
            _log.warning("ROS 2 has another node %s: slidectl does not see it; start it with another name", name)
        self._foreign = foreign
        await self._proxies.settle(self._parts(foreign))
        await self._set_nodes()
        await self._set_topics()
        await self._set_services()
        await self._set_actions()
        await self._set_descriptions()
        await self._participant.run(lambda: self._services.forget(set(foreign.services)))

    async def _read_native(self, main: DaemonConnection) -> None:
        state = await main.call("/slidectl/graph")
        nodes = {node for topic in state["topics"] for node in (*topic["publishers"], *topic["subscribers"])}
        nodes |= {one["node"] for one in state["services"]}
        self._proxy_names = {name: one for name, one in self._proxy_names.items() if one.is_open or name in nodes}
        hidden = {*self._proxy_names, _OWN_NODE, f"{_OWN_NODE}_latched"}
        own = f"/slidectl_{os.getpid()}_"
        topics = []
        for topic in state["topics"]:
            ends = {
                side: [one for one in topic[side] if one not in hidden and not one.startswith(own)]
                for side in ("publishers", "subscribers")
            }
            if any(ends.values()):
                topics.append({**topic, **ends})
        services = [
            one
            for one in state["services"]
            if one["node"] not in hidden and not one["node"].startswith(own) and is_offered(one, self._permitted)
        ]
        actions = {} if self._options.read_only else actions_of(topics)
        self._native = {
            "topics": [one for one in topics if self._is_bridged(one["name"]) and not is_of_action(one)],
            "services": as_in_ros2(services),
            "actions": {name: one for name, one in actions.items() if self._is_bridged(name)},
        }
        managed: dict[str, None] = {}
        for service in services:
            manager, kind = names.parent(service["name"]), "controller_manager_msgs/ListControllers"
            if service["type"] != kind or not manager.endswith(_MANAGER):
                continue
            managed[manager] = None
            try:
                answer = await main.call(service["name"])
            except (Refused, TimedOut) as error:  # that of some program
                _log.warning("%s: %s", service["name"], error)
                continue
            managed.update((names.join(names.parent(manager), one["name"]), None) for one in answer["controller"])
        self._managed = managed

    def _is_bridged(self, topic: str) -> bool:
        return not self._options.topics or any(fnmatchcase(topic, pattern) for pattern in self._options.topics)

    # --- foreign nodes in the daemon ----------------------------------------------------------------------------

    def _parts(self, foreign: Ros2Graph) -> dict[str, NodePart]:
        """What each node of ROS 2 has that the daemon can have too."""
        parts: dict[str, NodePart] = {}

        def part(node: str) -> NodePart:
            return parts.setdefault(node, NodePart({}, {}, {}))

        natives = {one["name"]: one["type"] for one in self._native["topics"]}
        for name, by_type in foreign.topics.items():
            kind = self._known_type(name, by_type, natives)
            if not kind:
                continue
            topic = by_type[types.ros2_name(kind)]
            for node in topic.publishers:
                if not self._options.read_only:
                    part(node).published[name] = kind
            for node in topic.subscribers:
                part(node).subscribed[name] = kind
        if not self._options.read_only:
            for service, (theirs, node) in foreign.services.items():
                kind = types.ros1_name(theirs)
                if msgs.service_exists(kind) and self._service_conversion(kind) is not None:
                    part(node).services[service] = kind
        return parts

    def _known_type(self, name: str, by_type: dict[str, Ros2Topic], natives: dict[str, str]) -> str:
        """The daemon's name for the type of a topic of ROS 2; empty when it cannot be had here."""
        if not self._is_bridged(name) or not by_type:
            return ""
        known = natives.get(name) or types.ros1_name(next(iter(by_type)))
        for other in [kind for kind in by_type if kind != types.ros2_name(known)]:
            self._leave_out(name, f"it is {types.ros2_name(known)} in slidectl, and {other} of a node of ROS 2")
        is_here = types.ros2_name(known) in by_type and msgs.exists(known)
        return known if is_here and self._conversion(known) is not None else ""

    async def _call_foreign(self, service: str, kind: str, request: Message) -> Message:
        return await self._services.call(service, types.service_conversion(kind), request)

    def _forward(self, bridge: TopicBridge, source: str, message: Message) -> DaemonConnection | None:
        """Publish a message of ROS 2 in the daemon, by the connection of its node if it is there; returns that."""
        proxy = self._proxies.connection(source) if self._proxies.publishes(source, bridge.name) else None
        daemon = proxy or self._main
        if daemon is not None:
            daemon.publish(bridge.name, message, bridge.conversion.name, latch=bridge.foreign.is_transient)
        return daemon

    # --- the daemon's nodes, topics and services in ROS 2 -------------------------------------------------------

    def _owner(self, name: str, native: str) -> str:
        """The node in ROS 2 of a topic or service of the daemon's node `native`: its controller, if it is of one."""
        space = names.parent(name)
        return space if space in self._managed else native

    def _made_owner(self, name: str, native: str) -> str:
        """As `_owner`; the gateway's own node for one whose name ROS 2 does not accept."""
        owner = self._owner(name, native)
        return owner if owner in self._nodes else self._own_node

    async def _set_nodes(self) -> None:
        """Make the nodes that are needed, and end the others."""
        wanted = dict(self._managed)
        for topic in self._native["topics"]:
            for node in (*topic["publishers"][:1], *topic["subscribers"][:1]):
                wanted[self._owner(topic["name"], node)] = None
        for one in (*self._native["services"], *self._native["actions"].values()):
            wanted[self._owner(one["name"], one["node"])] = None
        gone = {name for name in self._nodes if name not in wanted and name != self._own_node}
        for bridge in self._bridges.values():
            if bridge.has.publisher in gone or bridge.has.subscriber in gone:
                await self._participant.run(partial(bridge.set_ends, NOTHING, self._nodes))
        for name in [name for name, one in self._offered.items() if one.node in gone]:
            await self._participant.run(self._offered.pop(name).close)
        for name in [name for name, one in self._actions.items() if one.node in gone]:
            await self._participant.run(self._actions.pop(name).close)
        new = [name for name in wanted if name not in self._nodes]
        if not gone and not new:
            return

        def change() -> None:
            for name in gone:
                self._end_node(name)
            for name in new:
                try:
                    self._nodes[name] = node = self._participant.node(name)
                except ValueError as error:
                    self._leave_out(name, str(error))
                    continue
                if name in self._managed and self._main is not None:
                    places = name, self._participant, self._main
                    is_manager = name.endswith(_MANAGER)
                    services = (
                        ManagerParameterServices(*places, self._permitted) if is_manager else ParameterServices(*places)
                    )
                    self._parameters[name] = services
                    services.open(node)
            self._reader.forget()

        await self._participant.run(change)

    async def _set_topics(self) -> None:
        assert self._main is not None
        topics = self._awaited() | {topic["name"]: topic for topic in self._native["topics"]}
        types_of = {name: topic["type"] for name, topic in topics.items()}
        for name in [name for name, one in self._bridges.items() if one.conversion.name != types_of.get(name)]:
            bridge = self._bridges.pop(name)
            self._dropped += bridge.dropped
            await self._participant.run(partial(bridge.set_ends, NOTHING, self._nodes))
            await bridge.set_stream(self._main)
            self._latched.pop(name, None)
        changes = []
        for name, topic in topics.items():
            known = self._bridges.get(name)
            if known is None:
                conversion = self._conversion(topic["type"])
                if conversion is None:
                    continue
                known = self._bridges[name] = TopicBridge(name, conversion, self._participant, self._forward)
            by_type = self._foreign.topics.get(name, {})
            known.foreign = by_type.get(types.ros2_name(topic["type"]), UNUSED)
            wanted = await self._wanted(topic, known)
            if wanted != known.has:
                changes.append((known, wanted))

        def change() -> None:
            for bridge, wanted in changes:
                try:
                    bridge.set_ends(wanted, self._nodes)
                except Exception as error:  # rclpy refuses a name or a type, each in its own way
                    self._leave_out(bridge.name, str(error))

        if changes:
            await self._participant.run(change)
            self._reader.forget()
        for bridge in self._bridges.values():
            await bridge.set_stream(self._main)

    def _awaited(self) -> dict[str, dict[str, Any]]:
        """Topics that nodes of ROS 2 subscribe, since a program of slidectl may publish only briefly, and those that
        are taken without a subscriber."""
        found = {}
        for name, by_type in self._foreign.topics.items():
            kind = self._known_type(name, by_type, {})
            if not kind or name in self._descriptions:
                continue
            foreign = by_type[types.ros2_name(kind)]
            if foreign.subscribers or _is_taken_always(kind, foreign):
                found[name] = {"name": name, "type": kind, "publishers": [], "subscribers": []}
        return found

    async def _wanted(self, topic: dict[str, Any], bridge: TopicBridge) -> Wanted:
        foreign = bridge.foreign
        name, publishers, subscribers = topic["name"], topic["publishers"], topic["subscribers"]
        publisher = (
            self._made_owner(name, publishers[0]) if publishers else self._own_node if foreign.subscribers else ""
        )
        subscriber = ""
        if not self._options.read_only and _is_taken_always(topic["type"], foreign):
            subscriber = self._own_node
        elif not self._options.read_only and subscribers:
            subscriber = self._made_owner(name, subscribers[0])
        if publishers and name not in self._latched:
            self._latched[name] = await self._is_latched(name, topic["type"])
        return Wanted(
            publisher,
            subscriber,
            self._latched.get(name, False),
            # Not taken back: its subscribers would lose the messages until they have found the next publisher.
            self._latched.get(name, False) or foreign.wants_kept or (bool(publisher) and bridge.has.is_kept),
            foreign.is_best_effort,
            foreign.is_transient,
        )

    async def _is_latched(self, name: str, kind: str) -> bool:
        """True when the daemon keeps a message of the topic for late subscribers."""
        assert self._asker is not None
        found = []
        await self._asker.subscribe(name, kind, take=lambda published: found.append(published.get("latch", False)))
        self._asker.unsubscribe(name)
        return any(found)

    async def _set_services(self) -> None:
        wanted = {one["name"]: one for one in self._native["services"]}
        types_of = {name: service["type"] for name, service in wanted.items()}
        for name in [name for name, one in self._offered.items() if one.type != types_of.get(name)]:
            await self._participant.run(self._offered.pop(name).close)
        assert self._main is not None
        made = []
        for name, service in wanted.items():
            if name in self._offered or (conversion := self._service_conversion(service["type"])) is None:
                continue
            node = self._made_owner(name, service["node"])
            offered_class = OfferedService if service["serves"] else ConfigureOfRos1
            one = offered_class(name, node, conversion, self._participant, self._main, service["serves"])
            self._offered[name] = one
            made.append(one)

        def change() -> None:
            for one in made:
                try:
                    one.open(self._nodes[one.node])
                except Exception as error:  # rclpy refuses a name or a type, each in its own way
                    self._leave_out(one.name, str(error))

        if made:
            await self._participant.run(change)

    async def _set_actions(self) -> None:
        wanted = self._native["actions"]
        for name in [name for name, one in self._actions.items() if one.type != wanted.get(name, {}).get("type")]:
            await self._participant.run(self._actions.pop(name).close)
        assert self._main is not None
        for name, action in wanted.items():
            if name in self._actions or (conversion := self._found(types.action_conversion, action["type"])) is None:
                continue
            node = self._made_owner(name, action["node"])
            one = OfferedAction(name, node, conversion, self._participant, self._main)
            try:
                await self._participant.run(partial(one.open, self._nodes[node]))
            except Exception as error:  # rclpy refuses a name or a type, each in its own way
                self._leave_out(name, str(error))
            self._actions[name] = one

    async def _set_descriptions(self) -> None:
        """Publish the descriptions of robots as robot_state_publisher of ROS 2 does, for RViz."""
        assert self._main is not None
        if self._described is None:
            answer = await self._main.call("/rosapi/get_param_names")
            self._described = {name for name in answer["names"] if name.endswith(_DESCRIPTION)}
        while self._described:
            name = next(iter(self._described))
            answer = await self._main.call("/rosapi/get_param", {"name": name, "default": '""'})
            self._described.discard(name)
            text = json.loads(answer["value"])
            if self._is_bridged(name) and isinstance(text, str):
                try:
                    await self._participant.run(partial(self._describe, name, text))
                except Exception as error:  # rclpy refuses a name, or there is no std_msgs
                    self._leave_out(name, str(error))

    def _describe(self, name: str, text: str) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import String

        publisher = self._descriptions.get(name)
        if not text:
            if publisher is not None:
                self._nodes[self._own_node].destroy_publisher(self._descriptions.pop(name))
            return
        if publisher is None:
            profile = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            publisher = self._nodes[self._own_node].create_publisher(String, name, profile)
            self._descriptions[name] = publisher
        publisher.publish(String(data=text))

    # --- types --------------------------------------------------------------------------------------------------

    def _conversion(self, kind: str) -> types.Conversion | None:
        """The conversion of a message type; None, with a note in the log, when ROS 2 does not have it."""
        return self._found(types.conversion, kind)

    def _service_conversion(self, kind: str) -> types.ServiceConversion | None:
        """As `_conversion`, of a service type."""
        return self._found(types.service_conversion, kind)

    def _found(self, find: Callable[[str], T], kind: str) -> T | None:
        try:
            return find(kind)
        except SlidectlError as error:
            self._leave_out(getattr(error, "package", "") or kind, str(error))
            return None

    def _leave_out(self, what: str, why: str) -> None:
        """Note once what ROS 2 does not get; types of slidectl's own packages, which it never has, are no news."""
        if what not in self._left_out and what.partition("/")[0] not in types.OWN_PACKAGES:
            self._left_out[what] = why
            _log.warning("%s is left out in ROS 2: %s", what, why.replace("\n", "; "))


def _is_taken_always(kind: str, foreign: Ros2Topic) -> bool:
    """True for fixed transforms that nodes of ROS 2 keep: who asks for them in the daemon does not wait for others."""
    return kind == _TRANSFORMS and foreign.is_transient and bool(foreign.publishers)
