"""`/rosapi/*`: what exists in the graph, as rosapi of the rosbridge suite answers it.

Topics, services and nodes here; types and parameters have modules of their own. Lists are sorted, and what does not
exist gives an empty answer, as there.
"""

from __future__ import annotations

from collections.abc import Callable

from slidectl import msgs
from slidectl.control.node_handle import Message
from slidectl.simulation.clock import stamp
from slidectl.simulation.graph import Graph
from slidectl.simulation.rosapi_parameters import parameter_services
from slidectl.simulation.rosapi_types import type_services

NODE = "/rosapi"
Offer = tuple[str, Callable[[Message], Message]]
"""Service type without its package, and what answers."""


def advertise(graph: Graph) -> None:
    """Provide all services of rosapi for this graph."""
    node = graph.node(NODE, NODE)
    offers: dict[str, Offer] = {
        **_topic_services(graph),
        **_service_services(graph),
        **_node_services(graph),
        **type_services(),
        **parameter_services(graph.parameters),
        "get_time": ("GetTime", lambda _: {"time": stamp(graph.clock.time_ns)}),
    }
    for name, (kind, answer) in offers.items():
        node.advertise_service(name, f"rosapi/{kind}", answer)


def _topic_services(graph: Graph) -> dict[str, Offer]:
    topics = graph.topics

    def type_of(topic: str) -> str:
        return topics.type_of(topic) if topics.exists(topic) else ""

    def raw_types() -> list[str]:
        return [msgs.definition(kind) for kind in topics.types().values()]

    def listing() -> Message:
        types = topics.types()
        return {"topics": list(types), "types": list(types.values())}

    return {
        "topics": ("Topics", lambda _: listing()),
        "topics_and_raw_types": ("TopicsAndRawTypes", lambda _: {**listing(), "typedefs_full_text": raw_types()}),
        "topic_type": (
            "TopicType",
            lambda request: {"type": type_of(request["topic"])},
        ),
        "topics_for_type": ("TopicsForType", lambda request: {"topics": _having(topics.types(), request["type"])}),
        "publishers": ("Publishers", lambda request: {"publishers": topics.publishers(request["topic"])}),
        "subscribers": ("Subscribers", lambda request: {"subscribers": topics.subscribers(request["topic"])}),
    }


def _service_services(graph: Graph) -> dict[str, Offer]:
    services = graph.services

    def type_of(service: str) -> str:
        return services.type_of(service) if services.exists(service) else ""

    def providers(asked: str) -> list[str]:
        """rosapi asks by type; a service's own name is understood too."""
        found = [asked] if services.exists(asked) else _having(services.types(), asked)
        return sorted({services.node_of(name) for name in found})

    def node_of(name: str) -> str:
        return services.node_of(name) if services.exists(name) else ""

    return {
        "services": ("Services", lambda _: {"services": services.names()}),
        "service_type": (
            "ServiceType",
            lambda request: {"type": type_of(request["service"])},
        ),
        "services_for_type": (
            "ServicesForType",
            lambda request: {"services": _having(services.types(), request["type"])},
        ),
        "service_providers": ("ServiceProviders", lambda request: {"providers": providers(request["service"])}),
        "service_node": ("ServiceNode", lambda request: {"node": node_of(request["service"])}),
        "service_host": ("ServiceHost", lambda request: {"host": "localhost" if node_of(request["service"]) else ""}),
    }


def _node_services(graph: Graph) -> dict[str, Offer]:
    topics, services = graph.topics, graph.services

    def details(node: str) -> Message:
        return {
            "subscribing": topics.subscribed_by(node),
            "publishing": topics.published_by(node),
            "services": services.provided_by(node),
        }

    return {
        "nodes": ("Nodes", lambda _: {"nodes": graph.nodes()}),
        "node_details": ("NodeDetails", lambda request: details(request["node"])),
    }


def _having(types: dict[str, str], wanted: str) -> list[str]:
    return [name for name, kind in types.items() if kind == wanted]
