"""The interface of a controller to the graph: a namespace with parameters, topics, services and a log.

These are protocols. The simulation implements them on its graph; tests use a small fake. The control package
imports no graph, no socket and no client.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

from slidectl.control.saved_classes import recreated
from slidectl.effects import Effect
from slidectl.errors import Reason

Message = dict[str, Any]
MessageCallback = Callable[[Message], None]
"""Receives a message that was checked against its type. Raises MessageRefused to refuse it."""
ServiceHandler = Callable[[Message], Message]


MISSING: Any = object()
"""Marks a parameter that is not set (None is a legal default)."""


class ParameterChange(NamedTuple):
    """The change that a request makes to a parameter or namespace. MISSING stands for a value that is not set."""

    before: Any
    after: Any
    deletes: bool = False
    """True when the request deletes, False when it sets."""
    known_only: bool = False
    """True when an unknown name is an error, not a warning."""


ParameterJudge = Callable[[ParameterChange], None]
"""Raises SlidectlError to refuse a change. No part of the request is then carried out."""
Reasons = list[Reason]
"""The warnings and errors of one request, as the lines of its answer."""


class Publisher(Protocol):
    """One publisher of one topic. Check `wanted` before building a message."""

    wanted: bool
    """True when the topic has subscribers, or is latched."""
    sequence: int
    """`header.seq` of the next message. A caller that skips an unwanted message increments it, so that the numbers do
    not depend on subscribers."""

    def publish(self, message: Message) -> None:
        """Publish the message. The publisher writes `header.seq`; the dict must not be changed afterwards."""


def publish_if_wanted(publisher: Publisher, make: Callable[[], Message]) -> None:
    """Publish the message that `make` returns, if it is wanted. It is counted in any case."""
    if publisher.wanted:
        publisher.publish(make())
    else:
        publisher.sequence += 1


@recreated
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

    A change of state that actionlib does not allow logs an error and has no effect.
    """

    goal: Message
    """A message of the action's `Goal` type."""

    @property
    def status(self) -> GoalStatus:
        """The present state."""

    def accept(self) -> None:
        """PENDING becomes ACTIVE, RECALLING becomes PREEMPTING."""

    def reject(self, result: Message | None = None) -> None:
        """PENDING and RECALLING become REJECTED. The result is sent, as in the methods below."""

    def cancel(self, result: Message | None = None) -> None:
        """PENDING and RECALLING become RECALLED, ACTIVE and PREEMPTING become PREEMPTED."""

    def abort(self, result: Message | None = None) -> None:
        """ACTIVE and PREEMPTING become ABORTED."""

    def succeed(self, result: Message | None = None) -> None:
        """ACTIVE and PREEMPTING become SUCCEEDED."""

    @property
    def wants_feedback(self) -> bool:
        """True when the feedback has subscribers."""

    def publish_feedback(self, feedback: Message) -> None:
        """Send a message of the action's `Feedback` type."""

    def release(self) -> None:
        """End the work on this goal. It leaves the list of states after some time, in any state."""


GoalCallback = Callable[[GoalHandle], None]


class RepeatingTimer(Protocol):
    """A timer that calls back periodically in simulated time."""

    def cancel(self) -> None:
        """Stop the calls."""

    def restart(self) -> None:
        """Restart: the first call comes one period from now."""


class NodeHandle(Protocol):
    """A namespace of the graph. Relative names are resolved in it; absolute ones stay as they are."""

    namespace: str
    guard: AbstractContextManager[None] | None
    """Context manager around each callback that is later registered through this handle or a child."""

    def child(self, name: str) -> NodeHandle:
        """The node handle of `namespace/name`. `shutdown` of its root also ends its topics and services."""

    def get_param(self, name: str, default: Any = MISSING) -> Any:
        """The parameter as loaded from YAML (a subtree is a dict), else `default`; KeyError when there is none."""

    def has_param(self, name: str) -> bool:
        """True when the parameter or a parameter below it is set."""

    def set_param(self, name: str, value: Any) -> None:
        """Set the parameter. Its watchers are called, also those of this handle."""

    def search_param(self, name: str) -> str | None:
        """The absolute name of `name` found in this namespace or the nearest one above it, else None."""

    def watch_param(self, name: str, callback: Callable[[], None]) -> None:
        """Call back whenever the parameter, or one below it, is set or deleted."""

    def guard_params(self, judge: ParameterJudge) -> None:
        """Call `judge` before each change of this namespace, of a parameter below it, or of a namespace above it."""

    def advertise(self, topic: str, type_name: str, latch: bool = False) -> Publisher:
        """Publish `topic` with messages of `pkg/Type`."""

    def subscribe(self, topic: str, type_name: str, callback: MessageCallback) -> None:
        """Call back for each message on `topic`, between two cycles."""

    def count_publishers(self, topic: str) -> int:
        """How many nodes publish `topic`."""

    def advertise_service(
        self, service: str, type_name: str, handler: ServiceHandler, effect: Effect = Effect.WRITES
    ) -> None:
        """Answer calls of `service`, between two cycles. The handler raises SlidectlError to fail the call.

        `effect` is the most that it does: clients that may only read can call services with Effect.READS alone.
        """

    def advertise_action(self, action: str, type_name: str, on_goal: GoalCallback, on_cancel: GoalCallback) -> None:
        """Serve `action`, whose goals are `pkg/TypeGoal`, by the five topics of actionlib.

        `on_goal` is called with each new goal, which is PENDING; `on_cancel` with a goal that a client cancels.
        """

    def call_every(self, period_ns: int, callback: Callable[[], None], enters: bool = True) -> RepeatingTimer:
        """Call back each period of simulated time, counted from now, at the end of a cycle.

        With `enters`, `enter` is called first. Else the callback must call `enter` before it uses state of cycles.
        """

    def enter(self) -> None:
        """Copy the state that compiled code holds back to the controllers and handles."""

    def log(self, severity: str, text: str) -> None:
        """One line on /rosout; severity is `debug`, `info`, `warn`, `error` or `fatal`.

        From `warn` on, the line is also a reason in the answer to the present request.
        """

    @property
    def reasons(self) -> Reasons | None:
        """The reasons of the present request; None outside of a request. Reasons may be appended."""

    def answering(self, reasons: Reasons | None) -> AbstractContextManager[None]:
        """Context in which log lines belong to the request with these reasons. For work that the request deferred."""

    def now_ns(self) -> int:
        """Simulated time in nanoseconds, that of the last cycle."""

    def shutdown(self) -> None:
        """End all topics, services, subscriptions and watches of this handle and its children."""
