"""What other processes have in ROS 2: their topics and services, by node."""

from __future__ import annotations

from typing import Any, NamedTuple

_HIDDEN_TYPES = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
"""Services of each node for its parameters, loggers and types."""
_UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""The name of a node whose process was found a moment ago: its name comes next."""
_NOT_BRIDGED = frozenset({"/parameter_events"})


class Ros2Topic(NamedTuple):
    """A topic of ROS 2 with one of its types, and the nodes of other processes that use it."""

    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    is_best_effort: bool
    """True when a publisher offers no reliable delivery."""
    is_transient: bool
    """True when all publishers keep messages for late subscribers."""
    wants_kept: bool
    """True when a subscriber wants messages from before its subscription."""
    sources: dict[bytes, str]
    """Identity of a publisher -> its node."""


UNUSED = Ros2Topic((), (), False, False, False, {})


class Ros2Graph(NamedTuple):
    """The part of the graph that other processes have."""

    topics: dict[str, dict[str, Ros2Topic]]
    """Topic -> its types, as ROS 2 names them: usually one."""
    services: dict[str, tuple[str, str]]
    """Service -> its type and its node."""
    doubles: frozenset[str]
    """Names of nodes of this process that another process has too: what that one has is not seen."""


EMPTY = Ros2Graph({}, {}, frozenset())


class GraphReader:
    """Reads the graph with a node of ours. All of it works in rclpy's thread."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._known: dict[str, tuple[tuple[int, int], dict[str, Ros2Topic]]] = {}
        self._present: list[str] = []

    def read(self, own: frozenset[str]) -> Ros2Graph:
        """The present graph without the nodes of this process, whose full names are `own`.

        A topic is looked at more closely only when the nodes, or the number of its publishers or subscribers, have
        changed.
        """
        node = self._node
        present = [_full(one, space) for one, space in node.get_node_names_and_namespaces() if one != _UNKNOWN]
        if present != self._present:
            self._present = present
            self._known.clear()
        topics: dict[str, tuple[tuple[int, int], dict[str, Ros2Topic]]] = {}
        unnamed = set()
        for name, _ in node.get_topic_names_and_types():
            if name in _NOT_BRIDGED:
                continue
            counts = (node.count_publishers(name), node.count_subscribers(name))
            known = self._known.get(name)
            if known is None or known[0] != counts:
                by_type, count = self._topic(name, own)
                known = (counts, by_type)
                if count != sum(counts):
                    unnamed.add(name)
            topics[name] = known
        self._known = {name: known for name, known in topics.items() if name not in unnamed}
        services = self._services({name for name in present if name not in own})
        doubles = frozenset(name for name in own if present.count(name) > 1)
        return Ros2Graph({name: topic for name, (_, topic) in topics.items()}, services, doubles)

    def forget(self) -> None:
        """Look at all topics again: which nodes are ours has changed."""
        self._known.clear()

    def _topic(self, name: str, own: frozenset[str]) -> tuple[dict[str, Ros2Topic], int]:
        """The topic by its types, and how many publishers and subscribers it has whose nodes have names by now."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        publishers = _named(self._node.get_publishers_info_by_topic(name))
        subscribers = _named(self._node.get_subscriptions_info_by_topic(name))
        found = {}
        for kind in sorted({end.topic_type for node, end in (*publishers, *subscribers) if node not in own}):
            published = [(node, end) for node, end in publishers if node not in own and end.topic_type == kind]
            subscribed = [(node, end) for node, end in subscribers if node not in own and end.topic_type == kind]
            found[kind] = Ros2Topic(
                tuple(dict.fromkeys(node for node, _ in published)),
                tuple(dict.fromkeys(node for node, _ in subscribed)),
                any(end.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for _, end in published),
                {end.qos_profile.durability for _, end in published} == {DurabilityPolicy.TRANSIENT_LOCAL},
                any(end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for _, end in subscribed),
                {bytes(end.endpoint_gid): node for node, end in published},
            )
        return found, len(publishers) + len(subscribers)

    def _services(self, nodes: set[str]) -> dict[str, tuple[str, str]]:
        from rclpy.node import NodeNameNonExistentError

        found = {}
        for full in sorted(nodes):
            namespace, _, name = full.rpartition("/")
            try:
                offered = self._node.get_service_names_and_types_by_node(name, namespace or "/")
            except NodeNameNonExistentError:  # it has just ended
                continue
            for service, types in offered:
                if types and not types[0].startswith(_HIDDEN_TYPES) and "/_action/" not in service:
                    found[service] = (types[0], full)
        return found


def _named(ends: list[Any]) -> list[tuple[str, Any]]:
    """The ends of a topic with the full names of their nodes."""
    return [(_full(end.node_name, end.node_namespace), end) for end in ends if end.node_name != _UNKNOWN]


def _full(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
