"""The graph: topics, services, parameters, log, timers and their common clock, and node handles on them.

It contains no physics and no control; the simulation connects those to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from typing import Any, ClassVar, ParamSpec, Protocol, TypeVar

from slidectl import names
from slidectl.control.duration import header_of
from slidectl.control.node_handle import (
    MISSING,
    GoalCallback,
    GoalHandle,
    Message,
    MessageCallback,
    NodeHandle,
    ParameterJudge,
    Publisher,
    Reasons,
)
from slidectl.effects import Effect
from slidectl.errors import Reason, Refused, SlidectlError, cut
from slidectl.simulation.clock import Clock, ClockTopic, RepeatedCall, Timers
from slidectl.simulation.parameters import Parameters
from slidectl.simulation.services import Handler, Services
from slidectl.simulation.topics import NodePublisher, Topics

P = ParamSpec("P")
T = TypeVar("T")

WORLD_NODE = "/gazebo"
CLOCK_FREQUENCY = "/gazebo/pub_clock_frequency"
GRAPH_CHANGES = "/slidectl/graph_changes"
"""This topic and the next have no publisher: they exist while they have a subscriber."""
PARAMETER_CHANGES = "/slidectl/parameter_changes"
LEVELS = {"debug": 1, "info": 2, "warn": 4, "error": 8, "fatal": 16}
MOST_REASONS = 100
"""The most reasons in one answer; the log has all of them."""
Sink = Callable[[str, str, str, int], None]
"""Takes severity, node, text, time in ns."""


class ServedAction(Protocol):
    """The server of one action."""

    @property
    def open_goals(self) -> Sequence[GoalHandle]:
        """Goals without a result that have not been released."""


ActionMaker = Callable[[NodeHandle, str, GoalCallback, GoalCallback], ServedAction]
"""Creates the server of an action: takes a node handle in its namespace, its type, and what is called with a new goal
and with one that a client cancels."""


class Graph:
    """All that a client can see or do. `clock_topic` publishes /clock."""

    saved_attributes: ClassVar[None] = None

    def __init__(self) -> None:
        self.clock = Clock()
        self.timers = Timers(self.clock.now_ns)
        self.topics = Topics()
        self.services = Services()
        self.parameters = Parameters()
        self.caller = 0
        """The session id of the process whose request is being handled, 0 when it is unknown or there is none."""
        self.calling_node = ""
        """The node whose request is being handled, empty when there is none."""
        self.on_node_closed: list[Callable[[str], None]] = []
        """Called with the name of a node that was closed."""
        self._claimed_nodes: set[str] = set()
        self._make_action: ActionMaker | None = None
        self.log = Log(self.topics, self.clock.now_ns)
        clock = self.topics.advertise("/clock", "rosgraph_msgs/Clock", WORLD_NODE, kind=NodePublisher)
        self.clock_topic = ClockTopic(clock)
        self.parameters.watch(
            CLOCK_FREQUENCY, lambda: self.clock_topic.set_frequency(self.parameters.get(CLOCK_FREQUENCY, 0))
        )
        for changing in (self.topics, self.services):
            changing.on_change.append(lambda: self.topics.hand_on(GRAPH_CHANGES, {}))
        self.parameters.on_change.append(lambda changed: self.topics.hand_on(PARAMETER_CHANGES, {"names": changed}))

    def serve_actions(self, make: ActionMaker) -> None:
        """Let `make` create the servers of actions. Raises Refused: another feature serves them."""
        if self._make_action is not None:
            raise Refused("the actions of this world are served already")
        self._make_action = make

    def action_server(
        self, node: NodeHandle, type_name: str, on_goal: GoalCallback, on_cancel: GoalCallback
    ) -> ServedAction:
        """Serve an action in the namespace of the node handle. Raises Refused: the world has no feature for it."""
        if self._make_action is None:
            raise Refused(f"{node.namespace} cannot be served: this world has no feature 'actions'")
        return self._make_action(node, type_name, on_goal, on_cancel)

    def node(self, namespace: str = "/", name: str = WORLD_NODE) -> GraphNode:
        """A node handle in `namespace` of the node `name`."""
        return GraphNode(self, namespace, name)

    def nodes(self) -> list[str]:
        """Names of all nodes that publish, subscribe or serve, sorted."""
        return sorted(self.topics.nodes() | self.services.nodes())

    def state(self) -> Message:
        """All topics and services with their types and nodes: the response of slidectl/GraphState."""
        topics, services = self.topics, self.services
        return {
            "topics": [
                {
                    "name": name,
                    "type": kind,
                    "publishers": topics.publishers(name),
                    "subscribers": topics.subscribers(name),
                }
                for name, kind in topics.types().items()
            ],
            "services": [
                {
                    "name": name,
                    "type": kind,
                    "node": services.node_of(name),
                    "effects": [str(effect) for effect in services.effects_of(name)],
                }
                for name, kind in services.types().items()
            ],
        }

    def knows_node(self, name: str) -> bool:
        """True when a node of that name publishes, subscribes or serves, or a client has claimed the name."""
        return name in self._claimed_nodes or name in self.topics.nodes() or name in self.services.nodes()

    def claim_node(self, name: str) -> None:
        """Reserve a node's name for one client, until `close_node`. Raises BadName; Refused: it is in use."""
        if self.knows_node(names.check_absolute(name, "node")):
            raise Refused(f"there is a node {name} already", "give yours another name")
        self._claimed_nodes.add(name)

    def close_node(self, name: str) -> None:
        """Remove all that a node has, after its client has disconnected."""
        self._claimed_nodes.discard(name)
        self.topics.close_node(name)
        self.services.close_node(name)
        for callback in self.on_node_closed:
            callback(name)


class Log:
    """Publishes lines of nodes on `/rosout` and passes them to `sink` (the daemon's log file).

    Warnings and errors also become reasons of the request that is being handled, if any.
    """

    def __init__(self, topics: Topics, now_ns: Callable[[], int]) -> None:
        self.sink: Sink | None = None
        self.reasons: Reasons | None = None
        """Reasons of the request that is being handled. There is one thread, so there is at most one request."""
        self._now_ns = now_ns
        self._publisher = topics.advertise("/rosout", "rosgraph_msgs/Log", WORLD_NODE, kind=NodePublisher)

    def __call__(self, severity: str, node: str, text: str) -> None:
        """Log one line; `severity` is a key of LEVELS."""
        level = LEVELS[severity]
        text = cut(text)  # it may contain text from a client
        if self.reasons is not None and level >= LEVELS["warn"] and len(self.reasons) < MOST_REASONS:
            self.reasons.append(Reason(text, severity))
        now = self._now_ns()
        if self.sink is not None:
            self.sink(severity, node, text, now)
        if not self._publisher.wanted:
            self._publisher.sequence += 1
            return
        line: Message = {"header": header_of(now), "level": level, "name": node, "msg": text}
        self._publisher.publish({**line, "file": "", "function": "", "line": 0, "topics": []})

    @contextmanager
    def answering(self, reasons: Reasons | None) -> Iterator[None]:
        """Inside the context, lines become reasons of that request (None: of no request)."""
        before, self.reasons = self.reasons, reasons
        try:
            yield
        finally:
            self.reasons = before


class GraphNode:
    """A node handle on the graph, with all that was advertised through it. control.NodeHandle documents the methods.

    `namespace` resolves relative names; `name` is the node's name in listings and in the log.
    """

    saved_attributes: ClassVar[None] = None

    def __init__(self, graph: Graph, namespace: str, name: str) -> None:
        self.namespace = names.check(namespace)
        self.name = name
        self._graph = graph
        self._parent: GraphNode | None = None
        self._children: list[GraphNode] = []
        self._closers: list[Callable[[], None]] = []
        self._calls: list[RepeatedCall] = []
        self._servers: list[ServedAction] = []
        self.before_entry: Callable[[], None] = lambda: None
        """Called before every callback of this handle and its children."""
        self.guard: AbstractContextManager[None] | None = None
        self.command_warning = ""
        """Only in a handle without a parent: a warning for publishers to it or its children; empty for none."""

    def child(self, name: str) -> GraphNode:
        """The node handle of `namespace/name`. What it advertises ends with this one's `shutdown`."""
        node = GraphNode(self._graph, self._absolute(name), self.name)
        node._parent = self
        node.guard = self.guard
        self._children.append(node)
        return node

    def get_param(self, name: str, default: Any = MISSING) -> Any:
        return self._graph.parameters.get(self._absolute(name), default)

    def has_param(self, name: str) -> bool:
        return self._graph.parameters.has(self._absolute(name))

    def set_param(self, name: str, value: Any) -> None:
        self._graph.parameters.set(self._absolute(name), value, derived=True)

    def delete_param(self, name: str) -> None:
        """Delete the parameter, or all parameters below it. Raises UnknownName."""
        self._graph.parameters.delete(self._absolute(name))

    def search_param(self, name: str) -> str | None:
        return self._graph.parameters.search(self.namespace, name)

    def watch_param(self, name: str, callback: Callable[[], None]) -> None:
        self._closers.append(self._graph.parameters.watch(self._absolute(name), self._entering(callback)))

    def guard_params(self, judge: ParameterJudge) -> None:
        self._closers.append(self._graph.parameters.guard(self.namespace, judge))

    def advertise(self, topic: str, type_name: str, latch: bool = False) -> Publisher:
        publisher = self._graph.topics.advertise(self._absolute(topic), type_name, self.name, latch, NodePublisher)
        self._closers.append(publisher.close)
        return publisher

    def subscribe(self, topic: str, type_name: str, callback: MessageCallback) -> None:
        enter = self._entering(callback)

        def receive(message: Message) -> None:
            before = self._current_warning()
            enter(message)
            reasons = self.reasons
            if before and self._current_warning() and reasons is not None and before not in reasons:
                reasons.append(Reason(before, "warn"))  # no line on /rosout: there may be a thousand messages a second

        self._closers.append(self._graph.topics.subscribe(self._absolute(topic), type_name, self.name, receive).close)

    def count_publishers(self, topic: str) -> int:
        return len(self._graph.topics.publishers(self._absolute(topic)))

    def advertise_service(
        self,
        service: str,
        type_name: str,
        handler: Handler,
        effect: Effect = Effect.WRITES,
        file_field: str = "",
    ) -> None:
        name, entering = self._absolute(service), self._entering(handler)
        services = self._graph.services
        self._closers.append(services.advertise(name, type_name, self.name, entering, effect, file_field).close)

    def advertise_action(self, action: str, type_name: str, on_goal: GoalCallback, on_cancel: GoalCallback) -> None:
        self._servers.append(self._graph.action_server(self.child(action), type_name, on_goal, on_cancel))

    def call_every(self, period_ns: int, callback: Callable[[], None], enters: bool = True) -> RepeatedCall:
        enter = self._entering(callback) if enters else callback

        def tick() -> None:
            with suppress(SlidectlError):  # this call has no caller; the guard has logged the error
                enter()

        return RepeatedCall(self._graph.timers, period_ns, tick, self._calls)

    def log(self, severity: str, text: str) -> None:
        self._graph.log(severity, self.name, text)

    @property
    def reasons(self) -> Reasons | None:
        return self._graph.log.reasons

    def answering(self, reasons: Reasons | None) -> AbstractContextManager[None]:
        return self._graph.log.answering(reasons)

    def now_ns(self) -> int:
        return self._graph.clock.time_ns

    def shutdown(self) -> None:
        """End all that was advertised, subscribed and watched through this handle and its children.

        A failing callback does not stop the rest; the last such error is raised at the end.
        """
        if self._parent is not None and self in self._parent._children:
            self._parent._children.remove(self)
        for call in tuple(self._calls):
            call.cancel()
        closers, self._closers = self._closers, []
        with ExitStack() as closing:  # closes in reverse order
            for close in closers:
                closing.callback(close)
            for child in reversed(self._children):
                closing.callback(child.shutdown)

    def calls_below(self) -> list[RepeatedCall]:
        """The running calls of this handle and its children, in the order of creation."""
        return [*self._calls, *(call for child in self._children for call in child.calls_below())]

    def servers_below(self) -> list[ServedAction]:
        """The actions of this handle and its children, in the order of creation."""
        return [*self._servers, *(server for child in self._children for server in child.servers_below())]

    def _current_warning(self) -> str:
        return self.command_warning if self._parent is None else self._parent._current_warning()

    def _entering(self, callback: Callable[P, T]) -> Callable[P, T]:
        """Wrap a callback: before it, `before_entry` of this handle and all its parents is called; its guard holds
        during the call."""
        guard = self.guard

        def entered(*arguments: P.args, **keywords: P.kwargs) -> T:
            self.enter()
            if guard is None:
                return callback(*arguments, **keywords)
            with guard:
                return callback(*arguments, **keywords)

        return entered

    def enter(self) -> None:
        node: GraphNode | None = self
        while node is not None:
            node.before_entry()
            node = node._parent

    def _absolute(self, name: str) -> str:
        return names.join(self.namespace, name)
