"""What a controller sees of the graph: a namespace with parameters, topics, services and a log.

Protocols, which the simulation implements on its graph; tests use a small fake. Control itself
knows no graph, no socket and no client.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

from slidectl.errors import Reason

Message = dict[str, Any]
MessageCallback = Callable[[Message], None]
"""Takes a message that was checked against its type. Raises MessageRefused when it will not take it."""
ServiceHandler = Callable[[Message], Message]


class _Missing:
    """Marks a parameter that is not set (None is a legal default)."""

    def __repr__(self) -> str:
        return "MISSING"


MISSING: Any = _Missing()


class ParameterChange(NamedTuple):
    """What a request is about to do to a parameter or namespace. MISSING stands for what is not set."""

    before: Any
    after: Any
    deletes: bool = False
    """True when the request deletes; else it sets."""
    known_only: bool = False
    """True when a name that nobody reads is an error, not a warning."""


ParameterJudge = Callable[[ParameterChange], None]
"""Raises SlidectlError to refuse a change; then nothing of the request is carried out."""
Reasons = list[Reason]
"""The warnings and errors of one request, as the lines of its answer."""


class Publisher(Protocol):
    """One publisher of one topic. Ask `wanted` before building a message: nobody may be listening."""

    wanted: bool
    """True when somebody subscribes, or the topic is latched."""
    sequence: int
    """`header.seq` of the next message. Who builds none since none is wanted counts it here, so that who listens
    changes nothing."""

    def publish(self, message: Message) -> None:
        """Hand the message on. The publisher writes `header.seq`; the dict must not be changed afterwards."""


def publish_if_wanted(publisher: Publisher, make: Callable[[], Message]) -> None:
    """Publish what `make` makes, if somebody wants it; it is counted in any case."""
    if publisher.wanted:
        publisher.publish(make())
    else:
        publisher.sequence += 1


class GoalStatus(IntEnum):
    """The states of a goal, with the numbers of actionlib_msgs/GoalStatus."""

    PENDING = 0
    ACTIVE = 1
    PREEMPTED = 2
    SUCCEEDED = 3
    ABORTED = 4
    REJECTED = 5
    PREEMPTING = 6
    RECALLING = 7
    RECALLED = 8


class GoalHandle(Protocol):
    """One goal of an action server. Results are messages of the action's `Result` type, None for its defaults.

    A change of state that actionlib does not know is an error on the log and changes nothing.
    """

    goal: Message
    """As the action's `Goal` type."""

    @property
    def status(self) -> GoalStatus:
        """The present state."""

    def accept(self) -> None:
        """PENDING becomes ACTIVE, RECALLING becomes PREEMPTING."""

    def reject(self, result: Message | None = None) -> None:
        """PENDING and RECALLING become REJECTED, and the result goes out; so it does below."""

    def cancel(self, result: Message | None = None) -> None:
        """PENDING and RECALLING become RECALLED, ACTIVE and PREEMPTING become PREEMPTED."""

    def abort(self, result: Message | None = None) -> None:
        """ACTIVE and PREEMPTING become ABORTED."""

    def succeed(self, result: Message | None = None) -> None:
        """ACTIVE and PREEMPTING become SUCCEEDED."""

    @property
    def wants_feedback(self) -> bool:
        """Does somebody listen to the feedback?"""

    def publish_feedback(self, feedback: Message) -> None:
        """Send a message of the action's `Feedback` type."""

    def release(self) -> None:
        """Nobody works on this goal any more: it leaves the list of states after a while, whatever its state."""


GoalCallback = Callable[[GoalHandle], None]


class RepeatingTimer(Protocol):
    """A callback at simulated times."""

    def cancel(self) -> None:
        """It is not called any more."""

    def restart(self) -> None:
        """Begin anew: the first call comes a period from now."""


class NodeHandle(Protocol):
    """A namespace of the graph. Relative names are resolved in it; absolute ones stay as they are."""

    namespace: str
    guard: AbstractContextManager[None] | None
    """Surrounds the callbacks that are given to this handle, or to a child of it, from now on."""

    def child(self, name: str) -> NodeHandle:
        """The node handle of `namespace/name`. What it advertises ends with its root's `shutdown`."""

    def get_param(self, name: str, default: Any = MISSING) -> Any:
        """The parameter as loaded from YAML (a subtree is a dict), else `default`; KeyError when there is none."""

    def has_param(self, name: str) -> bool:
        """True when the parameter or a parameter below it is set."""

    def set_param(self, name: str, value: Any) -> None:
        """Set the parameter; watchers of it are told, this handle's own too."""

    def search_param(self, name: str) -> str | None:
        """The absolute name of `name` found in this namespace or the nearest one above it, else None."""

    def watch_param(self, name: str, callback: Callable[[], None]) -> None:
        """Call back whenever the parameter, or one below it, is set or deleted by anybody."""

    def guard_params(self, judge: ParameterJudge) -> None:
        """Ask `judge` before anybody sets or deletes something in this namespace, below it or above it."""

    def advertise(self, topic: str, type_name: str, latch: bool = False) -> Publisher:
        """Publish `topic` with messages of `pkg/Type`."""

    def subscribe(self, topic: str, type_name: str, callback: MessageCallback) -> None:
        """Call back for each message on `topic`, between two cycles."""

    def count_publishers(self, topic: str) -> int:
        """How many nodes publish `topic`."""

    def advertise_service(self, service: str, type_name: str, handler: ServiceHandler) -> None:
        """Answer calls of `service`, between two cycles. The handler raises SlidectlError to fail the call."""

    def advertise_action(self, action: str, type_name: str, on_goal: GoalCallback, on_cancel: GoalCallback) -> None:
        """Serve `action`, whose goals are `pkg/TypeGoal`, by the five topics of actionlib.

        `on_goal` gets each new goal, which is PENDING, and `on_cancel` one that a client wants cancelled.
        """

    def call_every(self, period_ns: int, callback: Callable[[], None], enters: bool = True) -> RepeatingTimer:
        """Call back each period of simulated time, counted from now, at the end of a cycle.

        Without `enters` the callback calls `enter` itself before it looks at what cycles work on, if it does.
        """

    def enter(self) -> None:
        """Let controllers and handles be as they are in the simulation: machine code keeps them elsewhere."""

    def log(self, severity: str, text: str) -> None:
        """One line on /rosout; severity is `debug`, `info`, `warn`, `error` or `fatal`.

        From `warn` on it is also a reason in the answer to the request that is being carried out.
        """

    @property
    def reasons(self) -> Reasons | None:
        """The reasons of the request that is being carried out; None outside of any. A line may be added to them."""

    def answering(self, reasons: Reasons | None) -> AbstractContextManager[None]:
        """Inside, what is logged belongs to the request with these reasons: for work that a request left for later."""

    def now_ns(self) -> int:
        """Simulated time in nanoseconds, that of the last cycle."""

    def shutdown(self) -> None:
        """Take back all that was advertised, subscribed and watched through this handle and its children."""
