"""Controllers that serve an action. An update decides the outcome of a goal; a monitor timer sends it to the client.

After realtime_tools' RealtimeServerGoalHandle and the timer with which ros_controllers call it.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf

from slidectl.control import params
from slidectl.control.controller_interface import Controller
from slidectl.control.duration import BadDuration, from_seconds
from slidectl.control.hardware_interface import I
from slidectl.control.node_handle import GoalHandle, GoalStatus, Message, NodeHandle
from slidectl.control.params import NUMBER, Parameter
from slidectl.control.saved_classes import recreated
from slidectl.errors import Refused

MONITOR_RATE = Parameter(
    "action_monitor_rate", NUMBER, "how often the goal's feedback and result are sent", "1/s", default=20.0
)


def period_of(node: NodeHandle, rate: Parameter) -> int:
    """The period, in nanoseconds, of a rate in 1/s that is a parameter with a default.

    Raises:
        Refused: the rate is not above 0, or its period is not a valid duration.
    """
    return checked_period(node, rate.name, params.value_of(node, rate))


def checked_period(node: NodeHandle, name: str, rate: float) -> int:
    """The period, in nanoseconds, of a proposed value of the rate parameter `name`. Raises Refused, as `period_of`."""
    try:
        period_ns = from_seconds(1.0 / rate if rate > 0.0 else inf)
    except BadDuration:
        period_ns = 0
    if period_ns <= 0:
        raise Refused(f"parameter {node.namespace}/{name} must be a rate above 0, not {rate:g}")
    return period_ns


@recreated
class MonitoredGoal:
    """One goal. An update decides its outcome at most once; `tick` sends the outcome."""

    def __init__(self, handle: GoalHandle) -> None:
        self.handle = handle
        self.last_feedback: Message | None = None
        """The feedback of the update before the decision, if there is any."""
        self._decision: GoalStatus | None = None
        self._result: Message = {}

    @property
    def is_active(self) -> bool:
        """True when the goal is accepted, has not ended, and no client asked to cancel it."""
        return self.handle.status is GoalStatus.ACTIVE

    def decide(self, status: GoalStatus, result: Message) -> None:
        """End the goal as SUCCEEDED or ABORTED at the tick, with the result as it is then. The first call counts."""
        if self._decision is None:
            self._decision = status
            self._result = result

    @property
    def uses_state(self) -> bool:
        """True when the next tick reads the controller's state, or changes state that the controller reads."""
        return self._decision is not None or self.handle.wants_feedback

    def tick(self, feedback: Callable[[], Message | None]) -> None:
        """Send the result, if the outcome is decided, and the feedback, if the goal was active before this tick.

        `feedback` returns the feedback of the last update; None before the first update, or when the action has none.
        A decided goal has no newer feedback than that of the update before its decision: none if the first update
        decided.
        """
        was_active = self.is_active
        if self.handle.status in (GoalStatus.ACTIVE, GoalStatus.PREEMPTING):
            if self._decision is GoalStatus.ABORTED:
                self.handle.abort(dict(self._result))
            elif self._decision is GoalStatus.SUCCEEDED:
                self.handle.succeed(dict(self._result))
        if was_active and self.handle.wants_feedback:
            message = feedback() if self._decision is None else self.last_feedback
            if message is not None:
                self.handle.publish_feedback(message)


class ActionController(Controller[I]):
    """Serves one action, and follows the goal that was accepted last. A subclass defines what a goal does.

    Only the goal that was accepted last is ticked. As in ros_controllers, a goal that is decided but not yet ticked
    when the next one is accepted never gets a result.
    """

    def _serve(self, node: NodeHandle, action: str, type_name: str, monitor_period_ns: int) -> None:
        """Advertise the action, as the last step of `init`."""
        self._node = node
        self._goal: MonitoredGoal | None = None
        self._ticked: MonitoredGoal | None = None
        self._timer = node.call_every(monitor_period_ns, self._tick, enters=False)
        self._timer.cancel()
        node.advertise_action(action, type_name, self._receive_goal, self._receive_cancel)

    def _receive_goal(self, handle: GoalHandle) -> None:
        """Reject the goal, or `_follow` it."""
        raise NotImplementedError

    def _hold(self) -> None:
        """Stop the motion, because the goal is cancelled."""
        raise NotImplementedError

    def _feedback(self) -> Message | None:
        """The feedback of the goal's last update; None before its first update."""
        return None

    def stopping(self, time_ns: int) -> None:  # noqa: ARG002
        """Preempt the goal."""
        self._preempt()

    def aborting(self, time_ns: int) -> None:  # noqa: ARG002
        self._preempt()

    def _follow(self, goal: MonitoredGoal) -> None:
        """Accept this goal and preempt the one before."""
        self._preempt()
        goal.handle.accept()
        if self._ticked is not None:
            self._ticked.handle.release()
        self._goal = self._ticked = goal
        self._timer.restart()

    def _tick(self) -> None:
        assert self._ticked is not None
        if self._ticked.uses_state:
            self._node.enter()
        self._ticked.tick(self._feedback)
        if self._ticked.handle.status not in (GoalStatus.ACTIVE, GoalStatus.PREEMPTING):
            self._timer.cancel()

    def _reject(self, handle: GoalHandle, text: str, result: Message | None = None) -> None:
        self._node.log("error", f"{self._node.namespace}: {text}")
        handle.reject(result)

    def _receive_cancel(self, handle: GoalHandle) -> None:
        if self._goal is not None and self._goal.handle is handle:
            self._goal = None
            self._hold()
            handle.cancel()

    def _preempt(self) -> None:
        """Cancel the present goal, because another motion replaces it. A goal that has ended keeps its result."""
        goal, self._goal = self._goal, None
        if goal is not None and goal.is_active:
            goal.handle.cancel()
