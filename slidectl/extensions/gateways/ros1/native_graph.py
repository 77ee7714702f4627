"""The part of the daemon's graph that ROS sees: all nodes except the gateway and those that represent foreign nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

OWN_NODE = "/ros1_gateway"
"""The node name of the gateway's own connections."""


class NativeGraph:
    """The newest answer of /slidectl/graph. `uri_of` gives the address of the slave API of a node."""

    def __init__(self, uri_of: Callable[[str], str]) -> None:
        self.uri_of = uri_of
        self.types: dict[str, str] = {}
        self.publishers: dict[str, list[str]] = {}
        self.subscribers: dict[str, list[str]] = {}
        self.services: dict[str, str] = {}
        """Service -> its node."""
        self.nodes: set[str] = set()
        self.service_uri = ""
        """The rosrpc address of all services."""

    def take(self, state: dict[str, Any], is_hidden: Callable[[str], bool]) -> dict[str, Any]:
        """Store this state without the hidden nodes. Returns the remaining state."""
        topics = []
        for topic in state["topics"]:
            publishers = [node for node in topic["publishers"] if not is_hidden(node)]
            subscribers = [node for node in topic["subscribers"] if not is_hidden(node)]
            if publishers or subscribers:
                topics.append({**topic, "publishers": publishers, "subscribers": subscribers})
        services = [service for service in state["services"] if not is_hidden(service["node"])]
        self.types = {topic["name"]: topic["type"] for topic in topics}
        self.publishers = {topic["name"]: topic["publishers"] for topic in topics if topic["publishers"]}
        self.subscribers = {topic["name"]: topic["subscribers"] for topic in topics if topic["subscribers"]}
        self.services = {service["name"]: service["node"] for service in services}
        lists = (*self.publishers.values(), *self.subscribers.values(), self.services.values())
        self.nodes = {node for nodes in lists for node in nodes}
        return {"topics": topics, "services": services}

    def published_by(self, node: str) -> list[list[str]]:
        """Topics that a node publishes, with their types."""
        return [[topic, self.types[topic]] for topic, nodes in self.publishers.items() if node in nodes]

    def subscribed_by(self, node: str) -> list[list[str]]:
        """Topics that a node subscribes, with their types."""
        return [[topic, self.types[topic]] for topic, nodes in self.subscribers.items() if node in nodes]
