"""A gripper in memory for its controllers: one finger, goals of an action, and their results."""

from __future__ import annotations

from typing import Any

from fake_robot import STEP_S, Bench, FakeRobot

from slidectl import msgs
from slidectl.control.node_handle import GoalStatus

ACTION = "/bot/hand/gripper_cmd"


class Gripper(Bench):
    """A finger that goes a tenth of the way to its command in each cycle, until something is in the way."""

    def __init__(self, interface: str, action_type: str, parameters: dict[str, Any]) -> None:
        super().__init__(FakeRobot(("finger",), (interface,)), {"hand": {"joint": "finger", **parameters}})
        self.stop_at = 9.0
        self._action_type = action_type
        self._sent = 0

    @property
    def finger(self) -> Any:
        return self.robot.joints["finger"]

    def run(self, cycles: int = 1, **more: Any) -> None:
        for _ in range(cycles):
            super().run(**more)
            before = self.finger.position
            self.finger.position = min(before + 0.1 * (self.finger.command - before), self.stop_at)
            self.finger.velocity = (self.finger.position - before) / STEP_S

    def send(self, command: dict[str, Any]) -> str:
        """Send a goal and return its id."""
        self._sent += 1
        name = f"g{self._sent}"
        content = {"goal_id": {"id": name}, "goal": {"command": command}}
        self.graph.send(f"{ACTION}/goal", msgs.check(f"{self._action_type}ActionGoal", content))
        return name

    def cancel(self, name: str) -> None:
        self.graph.send(f"{ACTION}/cancel", msgs.check("actionlib_msgs/GoalID", {"id": name}))

    def results(self) -> list[tuple[str, GoalStatus, bool, bool]]:
        """Goal, status, reached_goal, stalled."""
        return [
            (m["status"]["goal_id"]["id"], m["status"]["status"], m["result"]["reached_goal"], m["result"]["stalled"])
            for m in self.graph.sent(f"{ACTION}/result")
        ]
