"""The server of an action: goals, cancellations, states, feedback and results on the five topics of actionlib.

It follows actionlib's ActionServer. It keeps the states of goals and publishes them; the owner of a goal's handle
decides whether the goal is accepted and how it ends. It knows topics and simulated time only through its node handle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl import msgs
from slidectl.control.duration import NANOSECONDS, header_of, to_stamp
from slidectl.control.node_handle import GoalCallback, GoalStatus, Message, NodeHandle
from slidectl.control.saved_classes import recreated
from slidectl.msgs.schema import nanoseconds
from slidectl.simulation.feature import Feature

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


STATUS_PERIOD_NS = NANOSECONDS // 5
KEPT_NS = 5 * NANOSECONDS
"""How long a goal that has ended stays in the list of states."""
_RECALLED_BY_TIME = (
    "This goal handle was canceled by the action server because its timestamp is before the timestamp of the last "
    "cancel request"
)


@recreated
class ActionGoal:
    """One goal: its message and its state. control.node_handle.GoalHandle documents the methods."""

    def __init__(self, server: ActionServer, goal_id: Message, goal: Message) -> None:
        self.id: str = goal_id["id"]
        self.stamp_ns = nanoseconds(goal_id["stamp"])
        self.goal = goal
        self.state = GoalStatus.PENDING
        self.text = ""
        self.ended_ns: int | None = None
        """Time of its result, or of its release without one."""
        self._server = server

    @property
    def status(self) -> GoalStatus:
        return self.state

    def accept(self) -> None:
        if self._change({GoalStatus.PENDING: GoalStatus.ACTIVE, GoalStatus.RECALLING: GoalStatus.PREEMPTING}):
            self._server.publish_status()

    def reject(self, result: Message | None = None) -> None:
        self._end(dict.fromkeys((GoalStatus.PENDING, GoalStatus.RECALLING), GoalStatus.REJECTED), result)

    def cancel(self, result: Message | None = None, text: str = "") -> None:
        early = dict.fromkeys((GoalStatus.PENDING, GoalStatus.RECALLING), GoalStatus.RECALLED)
        late = dict.fromkeys((GoalStatus.ACTIVE, GoalStatus.PREEMPTING), GoalStatus.PREEMPTED)
        self._end(early | late, result, text)

    def abort(self, result: Message | None = None) -> None:
        self._end(dict.fromkeys((GoalStatus.ACTIVE, GoalStatus.PREEMPTING), GoalStatus.ABORTED), result)

    def succeed(self, result: Message | None = None) -> None:
        self._end(dict.fromkeys((GoalStatus.ACTIVE, GoalStatus.PREEMPTING), GoalStatus.SUCCEEDED), result)

    @property
    def wants_feedback(self) -> bool:
        return self._server.wants_feedback

    def publish_feedback(self, feedback: Message) -> None:
        self._server.publish_feedback(self, feedback)

    def release(self) -> None:
        if self.ended_ns is None:
            self.ended_ns = self._server.now_ns()

    def request_cancel(self) -> bool:
        """Note a client's request to cancel. True when the goal's owner must be notified."""
        wanted = {GoalStatus.PENDING: GoalStatus.RECALLING, GoalStatus.ACTIVE: GoalStatus.PREEMPTING}
        if self.state not in wanted:
            return False
        self.state = wanted[self.state]
        self._server.publish_status()
        return True

    def message(self) -> Message:
        """The goal as actionlib_msgs/GoalStatus."""
        goal_id = {"stamp": to_stamp(self.stamp_ns), "id": self.id}
        return {"goal_id": goal_id, "status": int(self.state), "text": self.text}

    def _change(self, states: dict[GoalStatus, GoalStatus], text: str = "") -> bool:
        if self.state not in states:
            possible = " or ".join(sorted({state.name for state in states.values()}))
            self._server.node.log("error", f"goal {self.id!r} is {self.state.name} and cannot become {possible}")
            return False
        self.state = states[self.state]
        self.text = text
        return True

    def _end(self, states: dict[GoalStatus, GoalStatus], result: Message | None, text: str = "") -> None:
        if self._change(states, text):
            self.ended_ns = self._server.now_ns()
            self._server.publish_result(self, result)


class Actions(Feature):
    """Serves the actions that are advertised through the node handles of a graph."""

    def attach(self, simulation: Simulation) -> None:
        simulation.graph.serve_actions(ActionServer)


class ActionServer:
    """Serves one action in the namespace of its node: `goal` and `cancel` in, `status`, `feedback` and `result` out."""

    def __init__(self, node: NodeHandle, type_name: str, on_goal: GoalCallback, on_cancel: GoalCallback) -> None:
        """`type_name` is the action's, `pkg/Type`. Raises BadName, TypeConflict, UnknownName (no such type)."""
        self.node = node
        self.now_ns = node.now_ns
        self._type = type_name
        self._on_goal = on_goal
        self._on_cancel = on_cancel
        self._goals: list[ActionGoal] = []
        self._made = 0
        self._last_cancel_ns = 0
        """Goals with a stamp up to this are cancelled on arrival."""
        self._latest_ns = 0
        self._results = node.advertise("result", f"{type_name}ActionResult")
        self._feedback = node.advertise("feedback", f"{type_name}ActionFeedback")
        self._status = node.advertise("status", "actionlib_msgs/GoalStatusArray", latch=True)
        node.subscribe("goal", f"{type_name}ActionGoal", self._receive_goal)
        node.subscribe("cancel", "actionlib_msgs/GoalID", self._receive_cancel)
        self._status_call = node.call_every(STATUS_PERIOD_NS, self.publish_status, enters=False)
        self.publish_status()

    def publish_status(self) -> None:
        """Publish the list of all goals; a goal leaves it KEPT_NS after its end."""
        now_ns = self.now_ns()
        shown = [goal.message() for goal in self._goals]
        self._goals = [goal for goal in self._goals if goal.ended_ns is None or 0 <= now_ns - goal.ended_ns <= KEPT_NS]
        self._status.publish({"header": header_of(now_ns), "status_list": shown})

    def publish_result(self, goal: ActionGoal, result: Message | None) -> None:
        """Publish the result of a goal that has ended, then the list."""
        message = msgs.default(f"{self._type}Result") if result is None else result
        self._results.publish({"header": header_of(self.now_ns()), "status": goal.message(), "result": message})
        self.publish_status()

    @property
    def open_goals(self) -> list[ActionGoal]:
        """Goals without a result that have not been released."""
        return [goal for goal in self._goals if goal.ended_ns is None]

    @property
    def wants_feedback(self) -> bool:
        """True when feedback has a subscriber."""
        return self._feedback.wanted

    def publish_feedback(self, goal: ActionGoal, feedback: Message) -> None:
        """Publish the progress of a goal."""
        self._feedback.publish({"header": header_of(self.now_ns()), "status": goal.message(), "feedback": feedback})

    def _receive_goal(self, message: Message) -> None:
        self._check_clock()
        goal = ActionGoal(self, message["goal_id"], message["goal"])
        now_ns = self.now_ns()
        if not goal.id:
            self._made += 1
            goal.id = f"{self.node.namespace}-{self._made}-{now_ns // NANOSECONDS}.{now_ns % NANOSECONDS}"
            goal.stamp_ns = now_ns
        for known in self._goals:
            if known.id == goal.id:  # sent twice, or cancelled before its arrival
                if known.state is GoalStatus.RECALLING:
                    known.cancel()
                return
        is_stamped = goal.stamp_ns != 0
        goal.stamp_ns = goal.stamp_ns or now_ns
        self._goals.append(goal)
        if is_stamped and goal.stamp_ns <= self._last_cancel_ns:
            goal.cancel(text=_RECALLED_BY_TIME)
        else:
            self._on_goal(goal)

    def _receive_cancel(self, message: Message) -> None:
        """Cancel the goal of this id and all up to this stamp; without both, all. An id may arrive before its goal."""
        self._check_clock()
        wanted, stamp_ns = message["id"], nanoseconds(message["stamp"])
        is_known = False
        for goal in list(self._goals):
            is_known = is_known or goal.id == wanted
            is_meant = goal.id == wanted or (not wanted and not stamp_ns) or (stamp_ns and goal.stamp_ns <= stamp_ns)
            if is_meant and goal.request_cancel():
                self._on_cancel(goal)
        if wanted and not is_known:
            early = ActionGoal(self, message, msgs.default(f"{self._type}Goal"))
            early.state = GoalStatus.RECALLING
            early.release()
            self._goals.append(early)
        self._last_cancel_ns = max(self._last_cancel_ns, stamp_ns)

    def _check_clock(self) -> None:
        """After a reset, discard the last cancellation time: stamps of goals start again, and all would be below it."""
        now_ns = self.now_ns()
        if now_ns < self._latest_ns:
            self._last_cancel_ns = 0
        self._latest_ns = now_ns
