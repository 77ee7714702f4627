"""Actions of the daemon, which are topics as in actionlib, for clients of ROS 2.

rclpy's action server keeps the states of the goals there, and answers for cancellations and results. A goal of ROS 2
becomes one of the daemon's action, which decides whether it is accepted and how it ends.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count
from typing import Any

from slidectl.client.action_client import LOST, STATES, SUCCEEDED, goal_topics
from slidectl.client.async_client import AsyncSubscription
from slidectl.errors import SlidectlError
from slidectl.extensions.gateways.daemon_connection import DaemonConnection
from slidectl.extensions.gateways.ros2.conversion import ActionConversion, Conversion
from slidectl.extensions.gateways.ros2.participant import AwaitedValue, Participant
from slidectl.wire.messages import Message

_log = logging.getLogger(__name__)

_GOAL, _TYPES = "ActionGoal", ("ActionGoal", "ActionFeedback", "ActionResult")
_PENDING, _REJECTED = STATES.index("pending"), STATES.index("rejected")
_CANCELLED = (STATES.index("preempted"), STATES.index("recalled"))
_SENT_WITHIN_S = 8.0
"""Wall seconds in which the daemon has to take a goal: less than a connection waits for an answer."""
_DECIDES_WITHIN_S = 5.0
"""Wall seconds in which an action decides about a goal. One that does not is asked no more: the goal is accepted."""
_NOT_SERVED = "the action has no server any more: its robot or its controller was removed, or the daemon has ended"
_MOST_OPEN = 100
"""Goals of an action that have no result yet; others are rejected."""
_TEXT = "error_string"
"""The field in which a result can say why a goal ended."""

_serial = count(1)


def is_of_action(topic: dict[str, Any]) -> bool:
    """True for a topic of an action, given as in /slidectl/graph: ROS 2 has actions of its own instead."""
    return bool(topic["type"].endswith(_TYPES))


def actions_of(topics: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The actions that have a server among topics as in /slidectl/graph: name -> name, type, and node of the server."""
    served = {topic["name"]: topic for topic in topics if topic["subscribers"]}
    return {
        name: {"name": name, "type": kind, "node": served[f"{name}/goal"]["subscribers"][0]}
        for name, kind in goal_topics({name: topic["type"] for name, topic in served.items()}).items()
    }


class _Goal:
    """A goal of ROS 2, and what is known of it in the daemon."""

    def __init__(self) -> None:
        self.id = f"ros2-{os.getpid()}-{next(_serial)}"
        """Its id in the daemon."""
        self.handle: Any = None
        """Of rclpy, once the goal is accepted; only in rclpy's thread."""
        self.accepted = AwaitedValue()
        """True or False."""
        self.ended = AwaitedValue()
        """A number of actionlib_msgs/GoalStatus, and the result."""
        self.is_decided = asyncio.Event()
        self.rejection: str | None = None
        """What the result says of it, if it was rejected."""
        self.is_listed = False


class OfferedAction:
    """An action of the daemon to which nodes of ROS 2 can send goals."""

    def __init__(
        self, name: str, node: str, conversion: ActionConversion, participant: Participant, daemon: DaemonConnection
    ) -> None:
        self.name = name
        self.node = node
        """The node of ours that offers it."""
        self.type = conversion.name
        self._conversion = conversion
        self._participant = participant
        self._daemon = daemon
        self._loop = asyncio.get_running_loop()
        self._server: Any = None
        self._of_requests: dict[int, _Goal] = {}
        """Address of an accepted request -> its goal, until rclpy has made its handle."""
        self._goals: dict[str, _Goal] = {}
        """Goals without a result, by their ids in the daemon."""
        self._open: set[_Goal] = set()
        """The same in rclpy's thread, with those that are not decided."""
        self._followed: list[AsyncSubscription] = []
        self._lock = asyncio.Lock()
        """Held while the topics are subscribed, so that no goal is sent before that."""
        self._sending: set[asyncio.Task[None]] = set()

    # --- in rclpy's thread ----------------------------------------------------------------------------------------

    def open(self, node: Any) -> None:
        """Offer it by this node of ours."""
        self._server = self._participant.serve_action(
            node,
            self._conversion.ros2_class,
            self.name,
            execute_callback=self._carry_out,
            goal_callback=self._decide,
            handle_accepted_callback=self._begin,
            cancel_callback=self._cancel,
        )

    def close(self) -> None:
        """Abort the goals, and offer it no longer."""
        if self._server is None:
            return
        for goal in list(self._open):
            goal.accepted.set(False)
            goal.ended.set((LOST, self._result({}, _NOT_SERVED)))
        self._participant.end_action(self._server)
        self._server = None
        self._loop.call_soon_threadsafe(self._forget)

    async def _decide(self, request: Any) -> Any:
        from rclpy.action import GoalResponse

        if len(self._open) >= _MOST_OPEN:
            _log.warning("%s rejects a goal of ROS 2: %s goals have no result yet", self.name, _MOST_OPEN)
            return GoalResponse.REJECT
        try:
            given = self._conversion.goal.from_ros2(request)
        except Exception as error:  # a value that the type does not have here
            _log.warning("%s: a goal of ROS 2 is not taken: %s", self.name, error)
            return GoalResponse.REJECT
        goal = _Goal()
        self._open.add(goal)
        self._loop.call_soon_threadsafe(self._send_soon, goal, given)
        if not await goal.accepted:
            self._open.discard(goal)
            return GoalResponse.REJECT
        self._of_requests[id(request)] = goal
        return GoalResponse.ACCEPT

    def _begin(self, handle: Any) -> None:
        """Carry out an accepted goal."""
        self._of_requests[id(handle.request)].handle = handle
        handle.execute()

    async def _carry_out(self, handle: Any) -> Any:
        goal = self._of_requests.pop(id(handle.request))
        status, result = await goal.ended
        self._open.discard(goal)
        if status == SUCCEEDED:
            handle.succeed()
        elif status in _CANCELLED and handle.is_cancel_requested:
            handle.canceled()
        else:  # one that another goal has replaced is aborted, too
            handle.abort()
        return result

    def _cancel(self, handle: Any) -> Any:
        from rclpy.action import CancelResponse

        goal = next((one for one in self._open if one.handle is handle), None)
        if goal is None:
            return CancelResponse.REJECT
        self._loop.call_soon_threadsafe(self._publish_cancel, goal.id)
        return CancelResponse.ACCEPT

    def _pass_on(self, goal: _Goal, feedback: Any) -> None:
        if goal.handle is not None:
            goal.handle.publish_feedback(feedback)

    # --- in the event loop ----------------------------------------------------------------------------------------

    def _send_soon(self, goal: _Goal, given: Message) -> None:
        task = self._loop.create_task(self._send(goal, given))
        self._sending.add(task)
        task.add_done_callback(self._sending.discard)

    async def _send(self, goal: _Goal, given: Message) -> None:
        """Send the goal to the daemon's action, and wait for its decision."""
        message = {"goal_id": {"id": goal.id}, "goal": given}
        try:
            async with asyncio.timeout(_SENT_WITHIN_S):
                async with self._lock:
                    if not self._followed:
                        await self._follow()
                    self._goals[goal.id] = goal
                await self._daemon.deliver(f"{self.name}/goal", message, f"{self.type}{_GOAL}")
        except TimeoutError:
            self._publish_cancel(goal.id)  # the daemon may still take it
            self._refuse(goal, f"the daemon has not taken it within {_SENT_WITHIN_S:g} s")
            return
        except SlidectlError as error:
            self._refuse(goal, str(error))
            return
        reasons = "\n".join(self._daemon.reasons)
        with suppress(TimeoutError):
            await asyncio.wait_for(goal.is_decided.wait(), _DECIDES_WITHIN_S)
        if goal.rejection is not None:
            self._refuse(goal, goal.rejection or reasons)
        elif not goal.is_decided.is_set():
            self._accept(goal)

    async def _follow(self) -> None:
        """Subscribe to what the daemon says of goals. Raises SlidectlError."""
        made: list[AsyncSubscription] = []
        wanted: dict[str, tuple[str, Callable[[Message], None]]] = {
            "feedback": (f"{self.type}ActionFeedback", self._take_feedback),
            "status": ("actionlib_msgs/GoalStatusArray", self._take_status),
            "result": (f"{self.type}ActionResult", self._take_result),
        }
        try:
            for own, (kind, take) in wanted.items():
                made.append(await self._daemon.subscribe(f"{self.name}/{own}", kind, take=take))
        except BaseException:
            for subscription in made:
                subscription.close()
            raise
        self._followed = made

    def _accept(self, goal: _Goal) -> None:
        goal.is_decided.set()
        self._participant.post(partial(goal.accepted.set, True))

    def _refuse(self, goal: _Goal, reason: str) -> None:
        _log.warning("%s rejects a goal of ROS 2: %s", self.name, reason)
        goal.is_decided.set()
        self._participant.post(partial(goal.accepted.set, False))
        self._remove(goal)

    def _take_status(self, published: Message) -> None:
        states = {one["goal_id"]["id"]: one["status"] for one in published["msg"]["status_list"]}
        for goal in list(self._goals.values()):
            if goal.id in states:
                goal.is_listed = True
                if states[goal.id] not in (_PENDING, _REJECTED) and not goal.is_decided.is_set():
                    self._accept(goal)
            elif goal.is_listed:  # the world was reset
                self._end(goal, LOST, self._result({}, "the action does not know the goal any more"))

    def _take_feedback(self, published: Message) -> None:
        goal = self._goals.get(published["msg"]["status"]["goal_id"]["id"])
        feedback = self._converted(self._conversion.feedback, published["msg"]["feedback"]) if goal else None
        if goal is not None and feedback is not None:
            self._participant.post(partial(self._pass_on, goal, feedback))

    def _take_result(self, published: Message) -> None:
        message = published["msg"]
        status, text = message["status"]["status"], message["status"]["text"]
        goal = self._goals.get(message["status"]["goal_id"]["id"])
        if goal is None:
            return
        if status == _REJECTED and not goal.is_decided.is_set():
            goal.rejection = text or message["result"].get(_TEXT, "")
            goal.is_decided.set()
        else:
            self._end(goal, status, self._result(message["result"], text))

    def _result(self, content: Message, text: str) -> Any:
        """A result in ROS 2, with a text if it can hold one and has none. `content` is empty for one by default."""
        made = self._converted(self._conversion.result, content) if content else None
        made = self._conversion.ros2_class.Result() if made is None else made
        if made.get_fields_and_field_types().get(_TEXT) == "string" and not getattr(made, _TEXT):
            setattr(made, _TEXT, text)
        return made

    def _converted(self, conversion: Conversion, content: Message) -> Any:
        """A message of ROS 2; None, with a note in the log, for what its type cannot hold."""
        try:
            return conversion.to_ros2(content)
        except Exception as error:  # of rclpy, too, which has no class of its own for it
            _log.warning("%s: a message cannot be sent to ROS 2: %s", self.name, error)
            return None

    def _end(self, goal: _Goal, status: int, result: Any) -> None:
        self._accept(goal)
        self._participant.post(partial(goal.ended.set, (status, result)))
        self._remove(goal)

    def _remove(self, goal: _Goal) -> None:
        self._goals.pop(goal.id, None)
        if not self._goals:
            self._forget()

    def _forget(self) -> None:
        """Follow the daemon no longer."""
        followed, self._followed = self._followed, []
        for subscription in followed:
            subscription.close()

    def _publish_cancel(self, goal_id: str) -> None:
        if goal_id in self._goals:
            self._daemon.publish(f"{self.name}/cancel", {"id": goal_id}, "actionlib_msgs/GoalID")
