"""`/slidectl/resolve`: the full name that a short one means, with the type and the nodes. Not in ROS.

The one place that applies the rule of `names.resolve` to what exists. It changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from slidectl import msgs, names
from slidectl.control.node_handle import Message
from slidectl.errors import UnknownName, Unused, UsageError, closest, listing
from slidectl.simulation.rosapi_types import typedefs
from slidectl.simulation.topics import Topics

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

PUBLISHERS = "publishers"
SUBSCRIBERS = "subscribers"
_KINDS = ("topic", "service", "parameter", "node", "robot")
_MOST_COMPARED = 8
"""Ways to cut a name from a field that are compared with known names for a suggestion, which takes milliseconds."""


def answer(simulation: Simulation, request: Message) -> Message:
    """The response of the service.

    Raises:
        UnknownName: nothing fits. AmbiguousName: several do. Unused: the topic has nobody in the role.
    """
    kind, name = request["kind"], request["name"]
    if kind not in _KINDS:
        raise UsageError(f"unknown kind {kind!r}", f"kinds: {', '.join(_KINDS)}")
    if len(name) > names.LONGEST:
        raise names.TooLong(name)
    graph, namespace = simulation.graph, request["namespace"] or "/"
    if kind == "topic":
        return _topic(graph.topics, name, namespace, request["role"], request["with_field"])
    if kind == "service":
        services = graph.services
        full = names.resolve(name, services.names(), kind=kind, namespace=namespace)
        type_name = services.type_of(full)
        return {
            "name": full,
            "type": type_name,
            "typedefs": typedefs(msgs.request_type(type_name)),
            "response_typedefs": typedefs(msgs.response_type(type_name)),
            "nodes": [services.node_of(full)],
        }
    if kind == "parameter":
        return {"name": _parameter(simulation.parameters.names(), name, namespace)}
    if kind == "robot":
        by_place = {robot.namespace: robot.name for robot in simulation.robots}
        return {"name": by_place.get(name) or simulation.robots.get(name).name}
    return {"name": names.resolve(name, graph.nodes(), kind=kind, namespace=namespace)}


def _topic(topics: Topics, text: str, namespace: str, role: str, with_field: bool) -> Message:
    types = topics.types()
    users = {PUBLISHERS: topics.publishers, SUBSCRIBERS: topics.subscribers}
    if role and role not in users:
        raise UsageError(f"unknown role {role!r}", f"roles: {', '.join(users)}")

    def having(known: list[str]) -> list[str]:
        return [topic for topic in known if not role or users[role](topic)]

    cuts = list(names.cut_from_field(text)) if with_field else [(text, "")]
    for name, field in cuts:
        near = _fitting(name, types, namespace)
        if near:
            used = having(near)
            if not used:
                raise Unused(role, " or ".join(near), having(list(types)))
            full = names.resolve(name, used, kind="topic", namespace=namespace)
            nodes = users[role](full) if role else []
            return {
                "name": full, "field": field, "type": types[full], "typedefs": typedefs(types[full]), "nodes": nodes
            }  # fmt: skip
    used = having(list(types))
    suggested = (name for name, _ in cuts[:_MOST_COMPARED] if closest(name, used))
    raise UnknownName("topic", next(suggested, text), used)


def _fitting(name: str, known: dict[str, str], namespace: str) -> list[str]:
    """The known names that `name` may stand for: the exact one, and for a relative name all that end with it."""
    exact, relative, ending = names.join(namespace, name), not name.startswith("/"), "/" + name
    return [each for each in known if each == exact or (relative and each.endswith(ending))]


def _parameter(known: list[str], name: str, namespace: str) -> str:
    """The parameter, or the namespace of parameters."""
    if name == "/":
        return name
    spaces = {space for each in known for space in _above(each)}
    try:
        return names.resolve(name.rstrip("/"), {*known, *spaces}, kind="parameter", namespace=namespace)
    except UnknownName as error:
        error.hint = f"parameters: {listing(known)}"
        raise


def _above(name: str) -> Iterator[str]:
    """The namespaces that hold a name, without the root."""
    while (name := names.parent(name)) != "/":
        yield name
