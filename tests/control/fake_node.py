"""A small graph in memory, for controllers under test: parameters, topics, services, a log, a clock set by hand.

Implements control/node_handle.py's protocol. Names are joined, not checked; messages are taken as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

from slidectl import names
from slidectl.control.node_handle import (
    MISSING,
    GoalCallback,
    Message,
    MessageCallback,
    ParameterChange,
    ParameterJudge,
    Reasons,
    ServiceHandler,
)
from slidectl.effects import Effect
from slidectl.features.action_server import ActionServer
from slidectl.simulation.clock import RepeatedCall, Timers


class FakePublisher:
    """Keeps what was published. `wanted` is True unless a test says otherwise."""

    def __init__(self, topic: str, type_name: str, latch: bool) -> None:
        self.topic, self.type_name, self.latch = topic, type_name, latch
        self.wanted = True
        self.sequence = 0
        self.messages: list[Message] = []

    def publish(self, message: Message) -> None:
        self.messages.append(message)


class FakeGraph:
    """What all nodes of a test share."""

    def __init__(self, parameters: dict[str, Any] | None = None) -> None:
        self.time_ns = 0
        self.timers = Timers(lambda: self.time_ns)
        """They fire when a test says so."""
        self.parameters: dict[str, Any] = {}
        self.publishers: dict[str, FakePublisher] = {}
        self.subscribers: dict[str, MessageCallback] = {}
        self.publisher_counts: dict[str, int] = {}
        self.services: dict[str, ServiceHandler] = {}
        self.types: dict[str, str] = {}
        self.effects: dict[str, Effect] = {}
        self.watches: list[tuple[str, Callable[[], None]]] = []
        self.guards: list[tuple[str, ParameterJudge]] = []
        self.reasons: Reasons | None = None
        self.log: list[tuple[str, str]] = []
        for name, value in (parameters or {}).items():
            self.set(name, value)

    def node(self, namespace: str = "/") -> FakeNode:
        return FakeNode(self, namespace)

    def send(self, topic: str, message: Message) -> None:
        self.subscribers[topic](message)

    def call(self, service: str, request: Message) -> Message:
        return self.services[service](request)

    def sent(self, topic: str) -> list[Message]:
        return self.publishers[topic].messages

    def lines(self, *severities: str) -> str:
        """The log's text, of these severities or of all."""
        return "\n".join(text for severity, text in self.log if severity in severities or not severities)

    def get(self, name: str) -> Any:
        value: Any = self.parameters
        for key in _keys(name):
            if not isinstance(value, dict) or key not in value:
                return MISSING
            value = value[key]
        return value

    def set(self, name: str, value: Any) -> None:
        *above, last = _keys(name)

        def change() -> None:
            tree = self.parameters
            for key in above:
                tree = tree.setdefault(key, {})
            tree[last] = value

        self._carry_out(name, change, deletes=False)

    def delete(self, name: str) -> None:
        *above, last = _keys(name)

        def change() -> None:
            tree = self.parameters
            for key in above:
                tree = tree[key]
            del tree[last]

        self._carry_out(name, change, deletes=True)

    def _carry_out(self, name: str, change: Callable[[], None], deletes: bool) -> None:
        """Ask the guards with the tree as it would be, and put the old one back when one of them refuses."""
        old = deepcopy(self.parameters)
        concerned = [guard for guard in self.guards if names.is_under(name, guard[0]) or names.is_under(guard[0], name)]
        change()
        try:
            for place, judge in concerned:
                judge(ParameterChange(_nearest(old, place), _nearest(self.parameters, place), deletes))
        except BaseException:
            self.parameters = old
            raise
        self._tell(name)

    def _tell(self, name: str) -> None:
        for watched, callback in list(self.watches):
            if names.is_under(name, watched) or names.is_under(watched, name):
                callback()


class FakeNode:
    """A node handle on a FakeGraph."""

    def __init__(self, graph: FakeGraph, namespace: str) -> None:
        self.graph = graph
        self.namespace = namespace
        self.guard: Any = None
        self._children: list[FakeNode] = []
        self._taken: list[Callable[[], object]] = []

    def child(self, name: str) -> FakeNode:
        self._children.append(FakeNode(self.graph, self._full(name)))
        return self._children[-1]

    def get_param(self, name: str, default: Any = MISSING) -> Any:
        value = self.graph.get(self._full(name))
        if value is MISSING and default is MISSING:
            raise KeyError(self._full(name))
        return default if value is MISSING else value

    def has_param(self, name: str) -> bool:
        return self.graph.get(self._full(name)) is not MISSING

    def set_param(self, name: str, value: Any) -> None:
        self.graph.set(self._full(name), value)

    def search_param(self, name: str) -> str | None:
        namespace = self.namespace
        while True:
            found = names.join(namespace, name)
            if self.graph.get(found) is not MISSING:
                return found
            if namespace == "/":
                return None
            namespace = names.parent(namespace)

    def watch_param(self, name: str, callback: Callable[[], None]) -> None:
        watch = (self._full(name), callback)
        self.graph.watches.append(watch)
        self._taken.append(lambda: self.graph.watches.remove(watch))

    def guard_params(self, judge: ParameterJudge) -> None:
        guard = (self.namespace, judge)
        self.graph.guards.append(guard)
        self._taken.append(lambda: self.graph.guards.remove(guard))

    def advertise(self, topic: str, type_name: str, latch: bool = False) -> FakePublisher:
        full = self._full(topic)
        publisher = self.graph.publishers[full] = FakePublisher(full, type_name, latch)
        self._taken.append(lambda: self.graph.publishers.pop(full))
        return publisher

    def subscribe(self, topic: str, type_name: str, callback: MessageCallback) -> None:
        full = self._full(topic)
        self.graph.subscribers[full] = callback
        self.graph.types[full] = type_name
        self._taken.append(lambda: self.graph.subscribers.pop(full))

    def count_publishers(self, topic: str) -> int:
        return self.graph.publisher_counts.get(self._full(topic), 0)

    def advertise_service(
        self, service: str, type_name: str, handler: ServiceHandler, effect: Effect = Effect.WRITES
    ) -> None:
        full = self._full(service)
        self.graph.services[full] = handler
        self.graph.types[full] = type_name
        self.graph.effects[full] = effect
        self._taken.append(lambda: self.graph.services.pop(full))

    def advertise_action(self, action: str, type_name: str, on_goal: GoalCallback, on_cancel: GoalCallback) -> None:
        ActionServer(self.child(action), type_name, on_goal, on_cancel)

    def enter(self) -> None:
        """Nothing keeps anything elsewhere."""

    def call_every(self, period_ns: int, callback: Callable[[], None], enters: bool = True) -> RepeatedCall:  # noqa: ARG002
        call = RepeatedCall(self.graph.timers, period_ns, callback, [])
        self._taken.append(call.cancel)
        return call

    def log(self, severity: str, text: str) -> None:
        self.graph.log.append((severity, text))

    @property
    def reasons(self) -> Reasons | None:
        return self.graph.reasons

    @contextmanager
    def answering(self, reasons: Reasons | None) -> Iterator[None]:
        before, self.graph.reasons = self.graph.reasons, reasons
        yield
        self.graph.reasons = before

    def now_ns(self) -> int:
        return self.graph.time_ns

    def shutdown(self) -> None:
        for child in self._children:
            child.shutdown()
        while self._taken:
            self._taken.pop()()

    def _full(self, name: str) -> str:
        return names.join(self.namespace, name)


def _nearest(tree: Any, name: str) -> Any:
    """What stands at a name, or the value above it that leaves no room for it."""
    for key in _keys(name):
        if not isinstance(tree, dict):
            return tree
        tree = tree.get(key, MISSING)
    return tree


def _keys(name: str) -> list[str]:
    return [key for key in name.split("/") if key]
