"""The client's side of an action: send a goal, follow it, cancel it, take its result.

An action is five topics below one name, as in actionlib: `goal`, `cancel`, `status`, `feedback`, `result`. No thread:
what arrives is taken in while `wait` or `feedback` waits.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl.errors import AmbiguousName, UnknownName

if TYPE_CHECKING:
    from slidectl.client.client import Client

Message = dict[str, Any]

STATES = (
    "pending", "active", "preempted", "succeeded", "aborted", "rejected", "preempting", "recalling", "recalled", "lost",
)  # fmt: skip
"""By the numbers of actionlib_msgs/GoalStatus."""
SUCCEEDED = 3
_SUFFIX = "ActionGoal"

_serial = itertools.count(1)


class ActionResult(NamedTuple):
    """How a goal ended: `status` is a number of actionlib_msgs/GoalStatus, `result` the action's own message."""

    status: int
    text: str
    result: Message

    @property
    def state(self) -> str:
        """The status in a word, as `succeeded`."""
        return STATES[self.status] if 0 <= self.status < len(STATES) else str(self.status)

    @property
    def succeeded(self) -> bool:
        """Whether the goal was reached."""
        return self.status == SUCCEEDED


def goal_topics(topics: dict[str, str]) -> dict[str, str]:
    """Name -> type (`control_msgs/FollowJointTrajectory`) of the actions among topics and their types."""
    return {
        topic.removesuffix("/goal"): kind.removesuffix(_SUFFIX)
        for topic, kind in sorted(topics.items())
        if topic.endswith("/goal") and kind.endswith(_SUFFIX)
    }


class Action:
    """One action of the graph. Use it as a context manager, or `close` it.

    Args:
        name: the full name, or the unique end of it; `arm_controller/follow_joint_trajectory`, or `arm_controller`
            where it has one action.

    Raises:
        UnknownName, AmbiguousName: no such action, or several.
    """

    def __init__(self, client: Client, name: str) -> None:
        known = goal_topics(client.topics())
        fitting = [full for full in known if full == name or full.endswith("/" + name.strip("/"))]
        fitting = fitting or [full for full in known if f"/{name.strip('/')}/" in full + "/"]
        if not fitting:
            raise UnknownName("action", name, list(known))
        if len(fitting) > 1:
            raise AmbiguousName("action", name, fitting)
        (self.name,) = fitting
        self.type = known[self.name]
        self._client = client
        self._results = client.subscribe(f"{self.name}/result")
        self._feedback = client.subscribe(f"{self.name}/feedback")

    def send(self, goal: Message) -> str:
        """Send a goal (the fields of the action's Goal message) and return its id. Raises MessageRefused."""
        goal_id = f"slidectl-{os.getpid()}-{next(_serial)}-{time.time_ns()}"
        self._client.deliver(f"{self.name}/goal", {"goal_id": {"id": goal_id}, "goal": goal})
        return goal_id

    def cancel(self, goal_id: str = "") -> None:
        """Cancel a goal; without an id, all goals of the action."""
        self._client.deliver(f"{self.name}/cancel", {"id": goal_id})

    def wait(self, goal_id: str, timeout: float | None = None) -> ActionResult:
        """The goal's result, within `timeout` wall seconds (the client's by default, `inf` for ever).

        Raises:
            TimedOut: it has not ended; the goal goes on. NoDaemon.
        """
        for event in self.follow(goal_id, timeout):
            if isinstance(event, ActionResult):
                return event
        raise AssertionError("follow ends with a result")

    def follow(self, goal_id: str, timeout: float | None = None) -> Iterator[Message | ActionResult]:
        """The goal's feedback messages as they come, and its ActionResult as the last. Raises as `wait`."""
        deadline = time.monotonic() + (self._client.timeout if timeout is None else timeout)
        while True:
            while len(self._feedback):
                message = self._feedback.get()
                if message["status"]["goal_id"]["id"] == goal_id:
                    yield message["feedback"]
            while len(self._results):
                message = self._results.get()
                if message["status"]["goal_id"]["id"] == goal_id:
                    yield ActionResult(message["status"]["status"], message["status"]["text"], message["result"])
                    return
            left = deadline - time.monotonic()
            failure = f"the goal of {self.name} has not ended"
            self._client.wait_until(lambda: len(self._feedback) > 0 or len(self._results) > 0, left, failure)

    def goals(self) -> list[Message]:
        """The goals that the server knows (actionlib_msgs/GoalStatus): `goal_id`, `status`, `text`."""
        with self._client.subscribe(f"{self.name}/status") as statuses:
            return list(statuses.get()["status_list"])

    def close(self) -> None:
        """Unsubscribe."""
        self._results.close()
        self._feedback.close()

    def __enter__(self) -> Action:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
