"""Services by name, with provider and type; answers come at once or later.

Requests and responses are checked against the type here, so that handlers receive and return complete messages.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from slidectl import msgs, names
from slidectl.control.node_handle import Message
from slidectl.effects import EVERYTHING, Effect, NotPermitted
from slidectl.errors import Refused, UnknownName
from slidectl.simulation.pending import Pending

Handler = Callable[[Message], Mapping[str, Any] | Pending]
Answer = tuple[str, Message]
"""A text about the result, and the other fields of the response."""


def answering(handler: Callable[[Message], Answer | Pending], text: str) -> Handler:
    """A handler whose responses have `success`, and in the field `text` the result in words, or the error."""

    def respond(done: Pending) -> Message:
        if done.error is not None:
            return {"success": False, text: str(done.error)}
        said, fields = done.result()
        return {**fields, "success": True, text: said}

    return responding(handler, respond)


def responding(handler: Callable[[Message], Any], respond: Callable[[Pending], Mapping[str, Any]]) -> Handler:
    """A handler whose responses `respond` makes from the handler's answer, now or later, or from its error."""

    def answer(request: Message) -> Mapping[str, Any] | Pending:
        answered = Pending.attempt(lambda: handler(request))
        return respond(answered) if answered.done else answered.converted(respond)

    return answer


@dataclass(slots=True, eq=False)
class Service:
    """One service and its provider. Raises UnknownName: no such service type."""

    name: str
    type: str
    node: str
    handler: Handler
    effect: Effect
    file_field: str
    _on_close: Callable[[Service], None]
    request_type: str = ""
    response_type: str = ""
    open: dict[Pending, Pending] = field(default_factory=dict)
    """The Pending of the handler for each unanswered call."""

    def __post_init__(self) -> None:
        self.request_type, self.response_type = msgs.request_type(self.type), msgs.response_type(self.type)

    def close(self) -> None:
        """Remove the service; unanswered calls fail."""
        self._on_close(self)
        calls, self.open = self.open, {}
        for call, answer in calls.items():
            answer.cancel()
            call.reject(Refused(f"{self.name}: the provider {self.node} went away before it answered"))


class Services:
    """All services of the graph."""

    def __init__(self) -> None:
        self._services: dict[str, Service] = {}
        self._by_node: dict[str, dict[Service, None]] = {}
        self.on_change: list[Callable[[], None]] = []
        """Called after a service was added or removed."""
        self.permitted: Collection[Effect] = EVERYTHING
        """What the caller of the request that is being handled may do."""

    def advertise(
        self,
        name: str,
        type_name: str,
        node: str,
        handler: Handler,
        effect: Effect = Effect.WRITES,
        file_field: str = "",
    ) -> Service:
        """Provide a service. The handler raises SlidectlError to fail a call, or returns a Pending to answer later.

        `effect` is the most that it does; with something in the request's field `file_field` it also uses files.

        Raises BadName. Refused: the name is in use. UnknownName: no such service type.
        """
        names.check_absolute(name, "service")
        if name in self._services:
            raise Refused(f"service {name} is already provided by {self._services[name].node}")
        service = self._services[name] = Service(name, type_name, node, handler, effect, file_field, self._forget)
        self._by_node.setdefault(node, {})[service] = None
        self._notify()
        return service

    def call(self, name: str, request: Any = None) -> Pending:
        """Call a service. Errors are in the answer, which is already settled unless it needs simulated time."""

        def ask() -> Message | Pending:
            service = self._known(name)
            self.require(service.effect, name)
            checked = msgs.check(service.request_type, {} if request is None else request)
            if service.file_field and checked[service.file_field]:
                self.require(Effect.FILES, f"{name} with {service.file_field!r}")
            answer = service.handler(checked)
            if isinstance(answer, Pending):
                return _follow(service, answer)
            return msgs.check(service.response_type, answer)

        return Pending.attempt(ask)

    def require(self, effect: Effect, what: str) -> None:
        """Raise NotPermitted unless the present caller may do this; `what` is the subject of the error's sentence."""
        if effect not in self.permitted:
            raise NotPermitted(what, effect, self.permitted)

    def names(self) -> list[str]:
        """Names of all services, sorted."""
        return sorted(self._services)

    def permitted_names(self) -> list[str]:
        """Names of the services that the present caller may call, sorted."""
        return [name for name in self.names() if self._services[name].effect in self.permitted]

    def exists(self, name: str) -> bool:
        """True when the service has a provider."""
        return name in self._services

    def types(self) -> dict[str, str]:
        """Type of each service, in the order of the names."""
        return {name: self._services[name].type for name in self.names()}

    def type_of(self, name: str) -> str:
        """The type of a service. Raises UnknownName when it has no provider."""
        return self._known(name).type

    def effects_of(self, name: str) -> list[Effect]:
        """What a service does, at most and with files. Raises UnknownName when it has no provider."""
        service = self._known(name)
        return [service.effect, *([Effect.FILES] if service.file_field else [])]

    def node_of(self, name: str) -> str:
        """The provider of a service. Raises UnknownName when there is none."""
        return self._known(name).node

    def nodes(self) -> set[str]:
        """Names of all providers."""
        return set(self._by_node)

    def provided_by(self, node: str) -> list[str]:
        """Names of the services of the node, sorted."""
        return sorted(service.name for service in self._by_node.get(node, ()))

    def close_node(self, node: str) -> None:
        """Remove all services of a node."""
        for service in list(self._by_node.get(node, ())):
            service.close()

    def _known(self, name: str) -> Service:
        if name not in self._services:
            raise UnknownName("service", name, self.names())
        return self._services[name]

    def _forget(self, service: Service) -> None:
        if self._services.get(service.name) is service:
            del self._services[service.name]
            of_node = self._by_node[service.node]
            del of_node[service]
            if not of_node:
                del self._by_node[service.node]
            self._notify()

    def _notify(self) -> None:
        for callback in self.on_change:
            callback()


def _follow(service: Service, inner: Pending) -> Pending:
    """The caller's Pending: checked against the type, rejected if the provider goes; cancelling cancels `inner`."""
    outer = Pending()

    def settle(answered: Pending) -> None:
        service.open.pop(outer, None)
        outer.settle(lambda: msgs.check(service.response_type, answered.result()))

    def cancel() -> None:
        service.open.pop(outer, None)
        inner.cancel()

    inner.then(settle)
    if not outer.done:
        service.open[outer] = inner
        outer.on_cancel = cancel
    return outer
