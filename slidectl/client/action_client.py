"""The client's side of an action: send a goal, follow it, cancel it, read its result. Goals of trajectories.

An action is five topics below one name, as in actionlib: `goal`, `cancel`, `status`, `feedback`, `result`. The client
starts no thread: messages are read while a call waits.
"""

from __future__ import annotations

import itertools
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl import names
from slidectl.errors import AmbiguousName, Refused, TimedOut, UnknownName

if TYPE_CHECKING:
    from slidectl.client.client import Client

Message = dict[str, Any]

STATES = (
    "pending", "active", "preempted", "succeeded", "aborted", "rejected", "preempting", "recalling", "recalled", "lost",
)  # fmt: skip
"""The states of a goal; the index is the number in actionlib_msgs/GoalStatus."""
SUCCEEDED, LOST = 3, 9
TRAJECTORY_TYPE = "control_msgs/FollowJointTrajectory"
TOLERANCE_CODES = (-4, -5)
"""Error codes of a goal that a tolerance on its path, or at its end, has aborted."""
_SUFFIX = "ActionGoal"
_STATE_OF_ROS2 = "controller_state"
_LOOK_EVERY_S = 1.0
"""Wall seconds between two checks that the action still has a server."""
_NOBODY = "the action has no server any more: its robot or its controller was removed"

_serial = itertools.count(1)


class ActionResult(NamedTuple):
    """How a goal ended: `status` is a number of actionlib_msgs/GoalStatus, `result` the action's own message."""

    status: int
    text: str
    result: Message

    @property
    def state(self) -> str:
        """The status as a word, for example `succeeded`."""
        return STATES[self.status] if 0 <= self.status < len(STATES) else str(self.status)

    @property
    def succeeded(self) -> bool:
        """True when the goal was reached."""
        return self.status == SUCCEEDED


def goal_topics(topics: dict[str, str]) -> dict[str, str]:
    """Name -> type (`control_msgs/FollowJointTrajectory`) of the actions among topics and their types."""
    return {
        topic.removesuffix("/goal"): kind.removesuffix(_SUFFIX)
        for topic, kind in sorted(topics.items())
        if topic.endswith("/goal") and kind.endswith(_SUFFIX)
    }


def resolve_action(name: str, known: Sequence[str], namespace: str = "/") -> str:
    """The full name of an action.

    `name` is the full name, the unique end of it, or the name of a controller that has exactly one action.
    """
    try:
        return names.resolve(name, known, kind="action", namespace=namespace)
    except UnknownName as unknown:
        try:
            owner = names.resolve(name, map(names.parent, known), kind="action", namespace=namespace)
        except UnknownName:
            raise unknown from None
    matches = [full for full in known if names.parent(full) == owner]
    if len(matches) > 1:
        raise AmbiguousName("action", name, matches)
    return matches[0]


def new_goal_id() -> str:
    """A new, unique goal id."""
    return f"slidectl-{os.getpid()}-{next(_serial)}-{time.time_ns()}"


class Action:
    """One action of the graph. Use it as a context manager, or `close` it.

    Args:
        name: the full name, or the unique end of it, as `arm_controller/follow_joint_trajectory`; or the name of a
            controller with one action, as `arm_controller`.
        namespace: relative names begin here; it also decides between several matches.

    Raises:
        UnknownName, AmbiguousName: no such action, or several.
    """

    def __init__(self, client: Client, name: str, namespace: str = "/") -> None:
        known = goal_topics(client.topics())
        self.name = resolve_action(name, list(known), namespace)
        self.type = known[self.name]
        self._client = client
        self._results = client.subscribe(f"{self.name}/result")
        self._feedback = client.subscribe(f"{self.name}/feedback")
        self._lists = client.subscribe(f"{self.name}/status", queue_length=1)
        self._all = (self._results, self._feedback, self._lists)
        self._ended: dict[str, ActionResult | None] = {}
        """The goals that were sent here, with their results."""
        self._listed: set[str] = set()
        """The goals that were in the server's list."""

    def send(self, goal: Message, goal_id: str = "") -> str:
        """Send a goal (the fields of the action's Goal message) and return its id, a new one by default.

        What the server says of it at once, as why it rejects it, is in the client's `reasons`. Raises MessageRefused.
        """
        goal_id = goal_id or new_goal_id()
        self._ended[goal_id] = None
        self._client.deliver(f"{self.name}/goal", {"goal_id": {"id": goal_id}, "goal": goal})
        return goal_id

    def cancel(self, goal_id: str = "") -> None:
        """Cancel a goal; without an id, all goals of the action."""
        self._client.deliver(f"{self.name}/cancel", {"id": goal_id})

    def ended(self, goal_id: str) -> ActionResult | None:
        """The result of a goal that was sent here, if it is here already: a server rejects a goal at once."""
        while len(self._results):
            message = self._results.get()
            status = message["status"]
            if status["goal_id"]["id"] in self._ended:
                self._ended[status["goal_id"]["id"]] = ActionResult(status["status"], status["text"], message["result"])
        return self._ended.get(goal_id)

    def wait(self, goal_id: str, timeout: float = math.inf) -> ActionResult:
        """The result of a goal that was sent here, within `timeout` wall seconds.

        Raises:
            TimedOut: it has not ended; the goal goes on. NoDaemon.
        """
        for event in self.follow(goal_id, timeout):
            if isinstance(event, ActionResult):
                return event
        raise AssertionError("follow ends with a result")

    def follow(self, goal_id: str, timeout: float = math.inf) -> Iterator[Message | ActionResult]:
        """The goal's feedback messages as they come, and its ActionResult as the last. Raises as `wait`.

        A goal that leaves the server's list without a result is lost, and so is one whose server has gone.
        """
        deadline = self._client.monotonic() + timeout
        while True:
            while len(self._feedback):
                message = self._feedback.get()
                if message["status"]["goal_id"]["id"] == goal_id:
                    yield message["feedback"]
            is_gone = self._is_gone(goal_id)
            if (ended := self.ended(goal_id)) is not None:
                yield ended if ended.succeeded or ended.text or self._is_served() else ended._replace(text=_NOBODY)
                return
            if is_gone:
                yield ActionResult(LOST, "the server does not list the goal any more", {})
                return
            left_s = deadline - self._client.monotonic()
            try:
                self._client.wait_until(lambda: any(map(len, self._all)), min(left_s, _LOOK_EVERY_S), "")
            except TimedOut as error:
                if left_s <= _LOOK_EVERY_S:
                    raise TimedOut(f"the goal of {self.name} has not ended within {timeout:g} s", error.hint) from None
                if not self._is_served() and self.ended(goal_id) is None:
                    yield ActionResult(LOST, _NOBODY, {})
                    return

    def _is_served(self) -> bool:
        return bool(self._client.call("/rosapi/subscribers", {"topic": f"{self.name}/goal"})["subscribers"])

    def _is_gone(self, goal_id: str) -> bool:
        """Was the goal in an earlier list of the server, and is not in one that is here?"""
        while len(self._lists):
            if goal_id in (status["goal_id"]["id"] for status in self._lists.get()["status_list"]):
                self._listed.add(goal_id)
            elif goal_id in self._listed:
                return True
        return False

    def goals(self) -> list[Message]:
        """The goals that the server knows (actionlib_msgs/GoalStatus): `goal_id`, `status`, `text`. Raises TimedOut."""
        # Older lists may still be on the way to the other subscription: the newest one counts.
        with self._client.subscribe(f"{self.name}/status", queue_length=1) as lists:
            return list(lists.get()["status_list"])

    def close(self) -> None:
        """Unsubscribe. The goals go on."""
        for subscription in self._all:
            subscription.close()

    def __enter__(self) -> Action:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


# --- goals of joint trajectory controllers ---------------------------------------------------------------------------


def trajectory_controllers(topics: dict[str, str]) -> dict[str, str]:
    """Full name of each trajectory controller -> its action, among topics and their types."""
    return {names.parent(name): name for name, kind in goal_topics(topics).items() if kind == TRAJECTORY_TYPE}


def desired_positions(client: Client, controller: str) -> dict[str, float]:
    """Joint -> its desired position now. Raises Refused: the controller does not run."""
    now = client.call("/rosapi/get_time")["time"]
    answer = client.call(f"{controller}/query_state", {"time": now})
    if not answer["name"]:
        raise Refused(f"{controller}: {answer['message']}")
    return dict(zip(answer["name"], answer["position"], strict=True))


def is_of_ros2(client: Client, controller: str) -> bool:
    """True for a trajectory controller that behaves as in ros2_controllers, and has the topics of these."""
    return f"{controller}/{_STATE_OF_ROS2}" in client.topics()


def state_of(client: Client, controller: str) -> tuple[list[str], Message, Message, Message]:
    """The joints, the desired and the measured state, and the errors. Raises Refused: the controller does not run."""
    desired_positions(client, controller)  # it would publish no state
    for_ros2 = is_of_ros2(client, controller)
    with client.subscribe(f"{controller}/{_STATE_OF_ROS2 if for_ros2 else 'state'}") as states:
        now = states.get()
    desired, actual = ("reference", "feedback") if for_ros2 else ("desired", "actual")
    return now["joint_names"], now[desired], now[actual], now["error"]


def goal_to(positions: Mapping[str, float], duration: float) -> Message:
    """A goal that moves the joints to `positions`, at rest, in `duration` simulated seconds."""
    secs, nsecs = divmod(round(duration * 1e9), 10**9)
    zeros = [0.0] * len(positions)
    point = {
        "positions": list(positions.values()),
        "velocities": zeros,
        "accelerations": zeros,
        "time_from_start": {"secs": secs, "nsecs": nsecs},
    }
    return {"trajectory": {"joint_names": list(positions), "points": [point]}}


def hold(client: Client, controller: str) -> None:
    """Cancel the trajectory in progress and hold the joints in place. Raises Refused: the controller does not run."""
    if not is_of_ros2(client, controller):
        client.deliver(f"{controller}/command", {})
        return
    positions = desired_positions(client, controller)
    client.deliver(f"{trajectory_controllers(client.topics())[controller]}/cancel", {})
    point = {"positions": list(positions.values())}
    client.deliver(f"{controller}/joint_trajectory", {"joint_names": list(positions), "points": [point]})
