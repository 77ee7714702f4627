"""A namespace of the graph with all that was advertised through it: what controllers get as their node handle.

Implements control.node.NodeHandle on the graph. Holds no state of its own but what it must take back.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from slidectl import names
from slidectl.control.node_handle import MISSING, Message, MessageCallback, ParameterJudge, Publisher, Reasons
from slidectl.simulation.services import Handler
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
        self.before_entry: Callable[[], None] = _nothing
        """Called before every callback that was given to this handle or a child of it."""
        self.caution = ""
        """Of a handle without a parent: a warning for who publishes to it or to a child of it; empty for none."""

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
        enter = self._entering(callback)

        def take(message: Message) -> None:
            before = self._caution()
            enter(message)
            reasons = self.reasons
            if before and self._caution() and reasons is not None and before not in reasons:
                reasons.append(before)  # no line on /rosout: there may be a thousand messages a second

        self._taken.append(self._graph.topics.subscribe(self._absolute(topic), type_name, self.name, take).close)

    def advertise_service(self, service: str, type_name: str, handler: Handler) -> None:
        """Answer calls of `service`, at once or with a Pending. Raises BadName, Refused (taken), UnknownName."""
        provided = self._graph.services.advertise(
            self._absolute(service), type_name, self.name, self._entering(handler)
        )
        self._taken.append(provided.close)

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

    def _caution(self) -> str:
        return self.caution if self._parent is None else self._parent._caution()

    def _entering(self, callback: Callable[P, T]) -> Callable[P, T]:
        def entered(*arguments: P.args, **keywords: P.kwargs) -> T:
            self.enter()
            return callback(*arguments, **keywords)

        return entered

    def _absolute(self, name: str) -> str:
        return names.join(self.namespace, name)


def _nothing() -> None:
    """For a handle of which nobody minds the entries."""
