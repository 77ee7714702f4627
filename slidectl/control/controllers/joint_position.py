"""Position of one joint by a PID, on efforts or on velocities, after ros_controllers' JointPositionController.

Parameters `joint`, `pid/*`; limits and type of the joint from `robot_description`. The hardware bounds the
command, not this law.
"""

from __future__ import annotations

from math import inf

from slidectl.control import params
from slidectl.control.angles import distance_with_large_limits, shortest_angular_distance
from slidectl.control.interfaces import EffortJointInterface, JointCommandInterface, VelocityJointInterface
from slidectl.control.node import NodeHandle
from slidectl.control.parameters import JOINT
from slidectl.control.pid_controller import UPDATES_PER_STATE, PidController
from slidectl.control.registry import controller
from slidectl.control.robot_description import joint_on_paper
from slidectl.description.robot import Joint


class JointPositionController(PidController):
    """command = pid(set point - position), the difference taken on the circle for a joint that turns."""

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, the joint, or the robot description is missing."""
        name = params.needed_text(node, JOINT.name)
        self._offer_pid(node)
        self._offer_state(node)
        self._listen(node)
        self._joint = interface.get_handle(name)
        self._take_limits(joint_on_paper(node, name))
        self._set_point = 0.0
        self._set_velocity: float | None = None

    def _take_limits(self, joint: Joint) -> None:
        limit = joint.limit if joint.type in ("revolute", "prismatic") else None
        self._lower = -inf if limit is None else limit.lower
        self._upper = inf if limit is None else limit.upper
        self._is_revolute = joint.type == "revolute"
        self._is_continuous = joint.type == "continuous"

    def starting(self, time_ns: int) -> None:  # noqa: ARG002
        """Stay where the joint is."""
        self.set_command(self._joint.position)
        self._pid.reset()

    def set_command(self, value: float, velocity: float | None = None) -> None:
        """Go to this position (m or rad), brought within the limits; with this velocity when one is given."""
        self._set_point = self._upper if value > self._upper else self._lower if value < self._lower else value
        self._set_velocity = velocity

    def update(self, time_ns: int, period_s: float) -> None:
        joint = self._joint
        position = joint.position
        set_point = self._set_point
        if self._is_revolute:
            error = distance_with_large_limits(position, set_point, self._lower, self._upper)
        elif self._is_continuous:
            error = shortest_angular_distance(position, set_point)
        else:
            error = set_point - position
        if self._set_velocity is None:
            joint.command = self._pid.compute_command(error, period_s)
        else:
            error_dot = self._set_velocity - joint.velocity
            joint.command = self._pid.compute_command_from(error, error_dot, period_s)
        self._updates_to_state -= 1
        if not self._updates_to_state:
            self._publish(time_ns, period_s, error)

    def _publish(self, time_ns: int, period_s: float, error: float) -> None:
        self._updates_to_state = UPDATES_PER_STATE
        if self._state.wanted:
            joint = self._joint
            self._state.publish(
                self._state_message(
                    time_ns,
                    period_s,
                    set_point=self._set_point,
                    value=joint.position,
                    value_dot=joint.velocity,
                    error=error,
                )
            )


@controller("effort_controllers/JointPositionController")
class EffortJointPositionController(JointPositionController):
    """The command is an effort."""

    interface_type = EffortJointInterface


@controller("velocity_controllers/JointPositionController")
class VelocityJointPositionController(JointPositionController):
    """The command is a velocity."""

    interface_type = VelocityJointInterface
