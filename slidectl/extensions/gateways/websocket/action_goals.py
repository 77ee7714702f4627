"""rosbridge's action operations for browsers, carried out on actionlib topics: ROS 1 has no such operations.

roslib's `Action` and roslibpy's `ActionClient` use them. Their goal states are those of ROS 2.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from itertools import count
from typing import Any, NamedTuple

from slidectl import msgs, names
from slidectl.errors import Refused, SlidectlError, listing
from slidectl.extensions.gateways.daemon_connection import DaemonConnection

Message = dict[str, Any]

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
_REJECTED = 5
_STATES = {2: CANCELED, 3: SUCCEEDED, 4: ABORTED, 8: CANCELED, 9: ABORTED}
"""Final states of actionlib_msgs/GoalStatus -> states of action_msgs/GoalStatus."""
_MOST_GOALS = 1000


class SentGoal(NamedTuple):
    """A goal that has no result yet."""

    reply: Callable[[Message], None]
    """Sends a message to the browser."""
    id: Any
    """The browser's id of the goal."""
    action: str
    """The action's name as the browser gave it; it is repeated in answers."""
    wants_feedback: bool


class ActionGoals:
    """The goals of all browsers, on one connection to the daemon."""

    def __init__(self, daemon: DaemonConnection) -> None:
        self._daemon = daemon
        self._goals: dict[str, dict[str, SentGoal]] = {}
        """Action -> id of the goal in the graph -> the goal."""
        self._serial = count(1)
        self._lock = asyncio.Lock()
        """Held while an action's topics are subscribed, so that no goal is sent before that."""

    async def send(self, message: Message, reply: Callable[[Message], None]) -> None:
        """Carry out `send_action_goal`; an error is sent as the result of the goal."""
        given, goal_id = message.get("action"), message.get("id")
        try:
            async with self._lock:
                await self._send(message, SentGoal(reply, goal_id, str(given), bool(message.get("feedback"))))
        except SlidectlError as error:
            reply(_result(SentGoal(reply, goal_id, str(given)[: names.LONGEST], False), ABORTED, str(error), False))

    async def _send(self, message: Message, goal: SentGoal) -> None:
        if not isinstance(goal.id, str | int | None) or len(str(goal.id)) > names.LONGEST:
            raise Refused(f"the id of a goal is a text or a number of at most {names.LONGEST} characters")
        action = names.join("/", goal.action)
        stem = await self._type_of(action)
        wanted = str(message.get("action_type") or "").replace("/action/", "/").removesuffix("Action")
        if wanted not in ("", stem):
            raise Refused(f"{action} is of type {stem}Action, not {wanted}Action")
        if sum(map(len, self._goals.values())) >= _MOST_GOALS:
            raise Refused(f"{_MOST_GOALS} goals wait for their results")
        content = msgs.check(f"{stem}Goal", message.get("args") or {})
        if action not in self._goals:
            receive = partial(self._receive_feedback, action)
            await self._daemon.subscribe(f"{action}/feedback", f"{stem}ActionFeedback", take=receive)
            receive = partial(self._receive_result, action)
            await self._daemon.subscribe(f"{action}/result", f"{stem}ActionResult", take=receive)
            self._goals[action] = {}
        name = f"{self._daemon.node}-{next(self._serial)}"
        self._goals[action][name] = goal
        self._daemon.publish(f"{action}/goal", {"goal_id": {"id": name}, "goal": content})

    async def _type_of(self, action: str) -> str:
        """The type of an action without its ending `Action`: control_msgs/FollowJointTrajectory. Raises Refused."""
        topic = {"topic": f"{action}/goal"}
        answer = await self._daemon.call("/rosapi/topic_type", topic)
        servers = (await self._daemon.call("/rosapi/subscribers", topic))["subscribers"]
        if not servers or not str(answer["type"]).endswith("ActionGoal"):
            known = await self._daemon.call("/rosapi/action_servers")
            raise Refused(f"no action {action}", f"actions: {listing(known['action_servers'])}")
        return str(answer["type"]).removesuffix("ActionGoal")

    def cancel(self, message: Message, reply: Callable[[Message], None]) -> None:
        """Carry out `cancel_action_goal`; the result arrives when the action ends. Raises Refused: no such goal."""
        action = names.join("/", str(message.get("action")))
        for name, goal in self._goals.get(action, {}).items():
            if goal.id == message.get("id") and goal.reply == reply:
                self._daemon.publish(f"{action}/cancel", {"id": name})
                return
        raise Refused(f"no goal of this connection with that id runs on {action}")

    def forget(self, reply: Callable[[Message], None]) -> None:
        """Discard the goals of a disconnected browser. They go on, as those of an actionlib client that ends."""
        for action, goals in list(self._goals.items()):
            for name in [name for name, goal in goals.items() if goal.reply == reply]:
                self._end(action, name)

    def _receive_feedback(self, action: str, published: Message) -> None:
        message = published["msg"]
        goal = self._goals.get(action, {}).get(message["status"]["goal_id"]["id"])
        if goal is not None and goal.wants_feedback:
            about = {"op": "action_feedback", "id": goal.id, "action": goal.action}
            goal.reply({**about, "values": message["feedback"]})

    def _receive_result(self, action: str, published: Message) -> None:
        message = published["msg"]
        status = message["status"]
        goal = self._end(action, status["goal_id"]["id"])
        if goal is None:
            return
        if status["status"] == _REJECTED:
            goal.reply(_result(goal, ABORTED, f"the goal was rejected: {status['text']}", False))
        else:
            goal.reply(_result(goal, _STATES.get(status["status"], ABORTED), message["result"], True))

    def _end(self, action: str, name: str) -> SentGoal | None:
        """Remove a goal; unsubscribe the action's topics after its last goal. None: the goal is not from here."""
        goals = self._goals.get(action, {})
        goal = goals.pop(name, None)
        if goal is not None and not goals:
            del self._goals[action]
            self._daemon.unsubscribe(f"{action}/feedback")
            self._daemon.unsubscribe(f"{action}/result")
        return goal


def _result(goal: SentGoal, status: int, values: Any, is_result: bool) -> Message:
    about = {"op": "action_result", "id": goal.id, "action": goal.action}
    return {**about, "values": values, "status": status, "result": is_result}
