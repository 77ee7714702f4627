"""`/rosapi/*`: the contents of the graph, answered like rosapi of the rosbridge suite.

Lists are sorted, and unknown names give empty answers, as there. An exception is a parameter that is not set: the call
fails, where rosapi answers null. Relative names are resolved in the root. `get_ros_version` is from rosapi of ROS 2.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from slidectl import msgs, names
from slidectl.control.node_handle import MISSING, Message
from slidectl.effects import Effect
from slidectl.errors import BadMessage, Refused, quoted
from slidectl.msgs.schema import TIMES
from slidectl.simulation.feature import Feature
from slidectl.simulation.graph import Graph
from slidectl.simulation.parameters import Parameters

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


NODE = "/rosapi"
_WRITING = ("set_param", "delete_param")
_ACTION = ("cancel", "feedback", "result", "status")
"""The topics of an action, besides its goal."""
ServiceEntry = tuple[str, Callable[[Message], Message]]
"""The service type without its package, and the handler."""

_LONGEST = 8 * 1024 * 1024
"""The most characters of a value. It is encoded as JSON twice, and this must not block the world for long."""
_LEAST = 80
"""The size of a single value: encoding a hundred thousand of them takes as long as a text of that many characters."""
_MOST_VALUES = 100_000


class Rosapi(Feature):
    """All services of rosapi for the graph of a simulation."""

    def attach(self, simulation: Simulation) -> None:
        advertise(simulation.graph)


def advertise(graph: Graph) -> None:
    """Provide all services of rosapi for this graph."""
    node = graph.node(NODE, NODE)
    offers = _graph_services(graph) | _type_services() | _parameter_services(graph.parameters)
    for name, (kind, answer) in offers.items():
        effect = Effect.WRITES if name in _WRITING else Effect.READS
        node.advertise_service(name, f"rosapi/{kind}", answer, effect)


def _graph_services(graph: Graph) -> dict[str, ServiceEntry]:
    topics, services = graph.topics, graph.services

    def listing() -> Message:
        types = topics.types()
        return {"topics": list(types), "types": list(types.values())}

    def listing_with_text() -> Message:
        return {**listing(), "typedefs_full_text": [msgs.full_definition(kind) for kind in topics.types().values()]}

    def action_servers() -> Message:
        """Namespaces with all five topics of an action."""
        known = topics.types()
        ends = sorted(name.removesuffix("/goal") for name in known if name.endswith("/goal"))
        return {"action_servers": [one for one in ends if one and all(f"{one}/{end}" in known for end in _ACTION)]}

    def providers(asked: str) -> list[str]:
        """The providers of a service type, as in rosapi, or of a service by its name."""
        found = [asked] if services.exists(asked) else _having(services.types(), asked)
        return sorted({services.node_of(name) for name in found})

    def node_of(service: str) -> str:
        return services.node_of(service) if services.exists(service) else ""

    def details(node: str) -> Message:
        return {
            "subscribing": topics.subscribed_by(node),
            "publishing": topics.published_by(node),
            "services": [name for name in services.provided_by(node) if name in services.permitted_names()],
        }

    return {
        "get_time": ("GetTime", lambda _: {"time": graph.clock.stamp()}),
        "topics": ("Topics", lambda _: listing()),
        "topics_and_raw_types": ("TopicsAndRawTypes", lambda _: listing_with_text()),
        "action_servers": ("GetActionServers", lambda _: action_servers()),
        "get_ros_version": ("GetROSVersion", lambda _: {"version": 1, "distro": "noetic"}),
        "topic_type": ("TopicType", lambda r: {"type": topics.types().get(r["topic"], "")}),
        "topics_for_type": ("TopicsForType", lambda r: {"topics": _having(topics.types(), r["type"])}),
        "publishers": ("Publishers", lambda r: {"publishers": topics.publishers(r["topic"])}),
        "subscribers": ("Subscribers", lambda r: {"subscribers": topics.subscribers(r["topic"])}),
        "services": ("Services", lambda _: {"services": services.permitted_names()}),
        "service_type": ("ServiceType", lambda r: {"type": services.types().get(r["service"], "")}),
        "services_for_type": ("ServicesForType", lambda r: {"services": _having(services.types(), r["type"])}),
        "service_providers": ("ServiceProviders", lambda r: {"providers": providers(r["service"])}),
        "service_node": ("ServiceNode", lambda r: {"node": node_of(r["service"])}),
        "service_host": ("ServiceHost", lambda r: {"host": "localhost" if node_of(r["service"]) else ""}),
        "nodes": ("Nodes", lambda _: {"nodes": graph.nodes()}),
        "node_details": ("NodeDetails", lambda r: details(r["node"])),
    }


def _having(types: dict[str, str], wanted: str) -> list[str]:
    return [name for name, kind in types.items() if kind == wanted]


# Types: the requested one, then its parts, depth first, each once, as in rosapi


def _type_services() -> dict[str, ServiceEntry]:
    """The services for types. An unknown type fails the call, with similar names."""

    def details(type_name: str) -> Message:
        return {"typedefs": typedefs(type_name)}

    return {
        "message_details": ("MessageDetails", lambda r: details(r["type"])),
        "service_request_details": ("ServiceRequestDetails", lambda r: details(msgs.request_type(r["type"]))),
        "service_response_details": ("ServiceResponseDetails", lambda r: details(msgs.response_type(r["type"]))),
    }


def typedefs(type_name: str) -> list[Message]:
    """The type (rosapi/TypeDef), then the types of its fields. Raises UnknownName."""
    return list(_typedefs(type_name, set()))


def _typedefs(type_name: str, seen: set[str]) -> Iterator[Message]:
    """The type definitions; times are types of their own in rosapi, which says int32 of the parts of both."""
    if type_name in seen:
        return
    seen.add(type_name)
    is_time = type_name in TIMES
    fields = TIMES["duration"] if is_time else msgs.fields(type_name)
    constants = [] if is_time else sorted(msgs.constants(type_name))
    example = msgs.default(type_name)
    yield {
        "type": type_name,
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [field.type for field in fields],
        "fieldarraylen": [field.array for field in fields],
        "examples": [_example(field, example[field.name]) for field in fields],
        "constnames": [constant.name for constant in constants],
        "constvalues": [str(constant.value) for constant in constants],
    }
    for field in fields:
        if "/" in field.type or field.type in TIMES:
            yield from _typedefs(field.type, seen)


def _example(field: msgs.Field, value: Any) -> str:
    """The example as in rosapi: empty brackets for lists and messages, else the default's text."""
    if field.array >= 0:
        return "[]"
    return "{}" if isinstance(value, dict) else str(value)


# Parameters: values are JSON text


def _parameter_services(parameters: Parameters) -> dict[str, ServiceEntry]:
    def get(request: Message) -> Message:
        default = _text_or_json(request["default"]) if request["default"] else MISSING
        value = parameters.view(absolute(request["name"]), default)
        check_size(value, request["name"])
        return {"value": json.dumps(value)}

    def set_value(request: Message) -> Message:
        parameters.set(absolute(request["name"]), from_json(request["value"]))
        return {}

    def delete(request: Message) -> Message:
        parameters.delete(absolute(request["name"]))
        return {}

    return {
        "get_param": ("GetParam", get),
        "set_param": ("SetParam", set_value),
        "delete_param": ("DeleteParam", delete),
        "search_param": ("SearchParam", lambda r: {"global_name": parameters.search("/", r["name"]) or ""}),
        "has_param": ("HasParam", lambda r: {"exists": parameters.has(absolute(r["name"]))}),
        "get_param_names": ("GetParamNames", lambda _: {"names": parameters.names()}),
    }


def absolute(name: str) -> str:
    """The name of a request; relative names are resolved in the root."""
    return names.join("/", name.rstrip("/") or "/")


def from_json(text: str) -> Any:
    """The value of a request. Raises BadMessage."""
    if len(text) > _LONGEST:
        raise BadMessage(f"the value has {len(text)} characters; the maximum is {_LONGEST}", "value")
    if text.count(",") + text.count("[") + text.count("{") > _MOST_VALUES:
        raise BadMessage(f"the value has more than {_MOST_VALUES} parts", "value", "set its parts one by one")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = f"the value is not JSON ({error}): {text[:80]!r}"
        raise BadMessage(reason, "value", "text needs quotes of its own") from None


def _text_or_json(text: str) -> Any:
    """Parse a default. As in rosapi, one that is not JSON is taken as text."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def check_size(value: Any, name: str) -> None:
    """Raise Refused for a value that takes too long to encode and does not fit on one line."""
    left, rest = _LONGEST, [value]
    while rest and left > 0:
        here = rest.pop()
        if isinstance(here, dict):
            rest += here.values()
            left -= sum(map(len, here))
        elif isinstance(here, list):
            if len(here) * _LEAST > left:
                left = 0
            rest += here
        left -= len(here) if isinstance(here, str) else _LEAST
    if left <= 0:
        raise Refused(f"the value of {quoted(name)} is too large for an answer", "ask for a part of it")
