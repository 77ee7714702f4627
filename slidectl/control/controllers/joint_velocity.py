"""Velocity of one joint by a PID on efforts, after ros_controllers' JointVelocityController.

Parameters `joint`, `pid/*`. It needs no robot description.
"""

from __future__ import annotations

from math import inf
from typing import Any

from slidectl.control import params
from slidectl.control.controller_interface import Compiled
from slidectl.control.hardware_interface import EffortJointInterface, JointCommandInterface, JointHandle
from slidectl.control.joint_controller import PidController, state_is_due
from slidectl.control.laws import Columns, LawTables, law
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import JOINT
from slidectl.control.pid import Pid, next_command
from slidectl.control.registry import controller


@law
def track_velocity(goal: JointVelocityController, pid: Pid, joint: JointHandle, period_s: float) -> None:
    """command = pid(set point - velocity)."""
    goal.error = goal.set_point - joint.velocity
    joint.command = next_command(pid, goal.error, period_s)


@law
def update_velocity(goal: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:  # noqa: ARG001
    """The update on rows."""
    track_velocity(goal, tables.pids[goal.pid], tables.joints[goal.joint], period_s)
    return state_is_due(goal) and goal.wanted != 0


@controller("effort_controllers/JointVelocityController")
class JointVelocityController(PidController):
    """effort = pid(commanded velocity - velocity)."""

    interface_type = EffortJointInterface
    compiled = Compiled(
        update_velocity,
        Columns(changing="error updates_to_state states", fixed="set_point", whole="updates_to_state states"),
        instead_of="track",
    )
    track = staticmethod(track_velocity)

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter or the joint is missing."""
        self._joint = interface.get_handle(params.needed_text(node, JOINT.name))
        self._offer_pid(node)
        self._listen(node, "std_msgs/Float64", self._receive)

    def starting(self, time_ns: int) -> None:  # noqa: ARG002
        """Set the set point to 0."""
        self.set_point = 0.0
        self._pid.reset()

    def bounds(self) -> tuple[float, float]:
        """No bounds: the hardware bounds the effort, not the set point."""
        return -inf, inf

    def set_command(self, value: float) -> None:
        """Move at this velocity (m/s or rad/s)."""
        self.set_point = value

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the state after an update. As upstream, the derivative of the velocity is always 0."""
        self._tell_state(time_ns, period_s, value=self._joint.velocity, value_dot=0.0)
