"""Goals for joint trajectory controllers: find the controllers, read desired positions, make goals, hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slidectl import names
from slidectl.client.action_client import goal_topics
from slidectl.client.client import Client

TYPE = "control_msgs/FollowJointTrajectory"
TOLERANCE_CODES = (-4, -5)
"""Error codes of a goal that a tolerance on its path, or at its end, has aborted."""


def trajectory_controllers(topics: dict[str, str]) -> dict[str, str]:
    """Full name of each trajectory controller -> its action, among topics and their types."""
    return {names.parent(name): name for name, kind in goal_topics(topics).items() if kind == TYPE}


def desired_positions(client: Client, controller: str) -> dict[str, float]:
    """Joint -> its desired position now. Raises Refused: the controller does not run."""
    now = client.call("/rosapi/get_time")["time"]
    answer = client.call(f"{controller}/query_state", {"time": now})
    return dict(zip(answer["name"], answer["position"], strict=True))


def goal_to(positions: Mapping[str, float], duration: float) -> dict[str, Any]:
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
    """Cancel the trajectory in progress and hold the joints in place."""
    client.deliver(f"{controller}/command", {})
