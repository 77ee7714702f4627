"""A namespace of the graph with all that was advertised through it: what controllers get as their node handle.

Implements control.node.NodeHandle on the graph. Holds no state of its own but what it must take back.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from slidectl import names
from slidectl.control.node_handle import (
    MISSING,
    GoalCallback,
    MessageCallback,
    ParameterJudge,
    Publisher,
    Reasons,
)
from slidectl.simulation.actions import ActionServer
from slidectl.simulation.services import Handler
from slidectl.simulation.timers import Timers
from slidectl.simulation.topics import NodePublisher

if TYPE_CHECKING:
    from slidectl.simulation.graph import Graph


P = ParamSpec("P")
T = TypeVar("T")


class GraphNode:
    """A node handle: `namespace` resolves relative names, `name` is the node that stands in listings and in the log."""

    def __init__(self, graph: Graph, namespace: str, name: str) -> None:
        self.namespace = names.check(namespace)
        self.name = name
        self._graph = graph
        self._parent: GraphNode | None = None
        self._children: list[GraphNode] = []
        self._taken: list[Callable[[], None]] = []
        self._calls: set[RepeatedCall] = set()
        self.before_entry: Callable[[], None] = _nothing
        """Called before every callback that was given to this handle or a child of it."""

    def child(self, name: str) -> GraphNode:
        """The node handle of `namespace/name`. What it advertises ends with this one's `shutdown`."""
        node = GraphNode(self._graph, self._absolute(name), self.name)
        node._parent = self
        self._children.append(node)
        return node

    def get_param(self, name: str, default: Any = MISSING) -> Any:
        """The parameter (a subtree is a dict), else `default`; UnknownParameter, a KeyError, when there is none."""
        return self._graph.parameters.get(self._absolute(name), default)

    def has_param(self, name: str) -> bool:
        """True when the parameter or a parameter below it is set."""
        return self._graph.parameters.has(self._absolute(name))

    def set_param(self, name: str, value: Any) -> None:
        """Set the parameter; watchers of it are told, this handle's own too."""
        self._graph.parameters.set(self._absolute(name), value)

    def search_param(self, name: str) -> str | None:
        """The absolute name of `name` found in this namespace or the nearest one above it, else None."""
        return self._graph.parameters.search(self.namespace, name)

    def watch_param(self, name: str, callback: Callable[[], None]) -> None:
        """Call back whenever the parameter, or one below it, is set or deleted by anybody."""
        self._taken.append(self._graph.parameters.watch(self._absolute(name), self._entering(callback)).close)

    def guard_params(self, judge: ParameterJudge) -> None:
        """Ask `judge` before anybody sets or deletes something in this namespace, below it or above it."""
        self._taken.append(self._graph.parameters.guard(self.namespace, judge).close)

    def advertise(self, topic: str, type_name: str, latch: bool = False) -> Publisher:
        """Publish `topic`. Raises BadName, TypeConflict, UnknownName (no such type)."""
        publisher = self._graph.topics.advertise(self._absolute(topic), type_name, self.name, latch, NodePublisher)
        self._taken.append(publisher.close)
        return publisher

    def subscribe(self, topic: str, type_name: str, callback: MessageCallback) -> None:
        """Call back for each message on `topic`. Raises BadName, TypeConflict, UnknownName (no such type)."""
        subscription = self._graph.topics.subscribe(
            self._absolute(topic), type_name, self.name, self._entering(callback)
        )
        self._taken.append(subscription.close)

    def count_publishers(self, topic: str) -> int:
        """How many nodes publish `topic`."""
        return len(self._graph.topics.publishers(self._absolute(topic)))

    def advertise_service(self, service: str, type_name: str, handler: Handler) -> None:
        """Answer calls of `service`, at once or with a Pending. Raises BadName, Refused (taken), UnknownName."""
        provided = self._graph.services.advertise(
            self._absolute(service), type_name, self.name, self._entering(handler)
        )
        self._taken.append(provided.close)

    def advertise_action(self, action: str, type_name: str, on_goal: GoalCallback, on_cancel: GoalCallback) -> None:
        """Serve `action`. Raises BadName, TypeConflict, UnknownName (no such type)."""
        ActionServer(self.child(action), type_name, on_goal, on_cancel)

    def call_every(self, period_ns: int, callback: Callable[[], None]) -> RepeatedCall:
        """Call back each period of simulated time, counted from now, at the end of a cycle."""
        call = RepeatedCall(self._graph.timers, period_ns, callback, self._calls)
        self._calls.add(call)
        return call

    def log(self, severity: str, text: str) -> None:
        """One line on /rosout, and from `warn` on a reason in the answer to the request under way.

        `severity` is `debug`, `info`, `warn`, `error` or `fatal`.
        """
        self._graph.log(severity, self.name, text)

    @property
    def reasons(self) -> Reasons | None:
        """The reasons of the request that is being carried out; None outside of any."""
        return self._graph.log.reasons

    def answering(self, reasons: Reasons | None) -> AbstractContextManager[None]:
        """Inside, what is logged belongs to the request with these reasons."""
        return self._graph.log.answering(reasons)

    def now_ns(self) -> int:
        """Simulated time in nanoseconds, that of the last cycle begun."""
        return self._graph.clock.time_ns

    def shutdown(self) -> None:
        """Take back all that was advertised, subscribed and watched through this handle and its children.

        All of it, even if somebody who is told of it fails; the last such error is raised then.
        """
        if self._parent is not None and self in self._parent._children:
            self._parent._children.remove(self)
        for call in tuple(self._calls):
            call.cancel()
        taken, self._taken = self._taken, []
        with ExitStack() as closing:  # the last is the first
            for close in taken:
                closing.callback(close)
            for child in reversed(self._children):
                closing.callback(child.shutdown)

    def enter(self) -> None:
        """Somebody is about to call into what stands behind this handle."""
        node: GraphNode | None = self
        while node is not None:
            node.before_entry()
            node = node._parent

    def _entering(self, callback: Callable[P, T]) -> Callable[P, T]:
        def entered(*arguments: P.args, **keywords: P.kwargs) -> T:
            self.enter()
            return callback(*arguments, **keywords)

        return entered

    def _absolute(self, name: str) -> str:
        return names.join(self.namespace, name)


class RepeatedCall:
    """Calls back each period from now on, at the end of the first cycle whose time is that or later."""

    def __init__(
        self, timers: Timers, period_ns: int, callback: Callable[[], None], running: set[RepeatedCall]
    ) -> None:
        """`running` are all calls of one node handle; this one leaves them when it is cancelled."""
        if period_ns <= 0:
            raise ValueError(f"a period is above 0 ns, not {period_ns}")
        self._timers = timers
        self._period_ns = period_ns
        self._callback = callback
        self._running = running
        self._timer = timers.after(period_ns, self._call)

    def cancel(self) -> None:
        """It is not called any more."""
        self._timer.cancel()
        self._running.discard(self)

    def _call(self) -> None:
        # The timer's own due time counts: it moves with the clock when that is set. Missed periods are left out.
        due_ns = self._timer.due_ns
        missed = (self._timers.now_ns() - due_ns) // self._period_ns
        self._timer = self._timers.at(due_ns + (missed + 1) * self._period_ns, self._call)
        self._callback()


def _nothing() -> None:
    """For a handle of which nobody minds the entries."""
