"""Velocity of one joint by a PID on efforts, after ros_controllers' JointVelocityController.

Parameters `joint`, `pid/*`. It needs no robot description.
"""

from __future__ import annotations

from slidectl.control import params
from slidectl.control.interfaces import EffortJointInterface, JointCommandInterface
from slidectl.control.node import NodeHandle
from slidectl.control.parameters import JOINT
from slidectl.control.pid_controller import UPDATES_PER_STATE, PidController
from slidectl.control.registry import controller


@controller("effort_controllers/JointVelocityController")
class JointVelocityController(PidController):
    """effort = pid(commanded velocity - velocity)."""

    interface_type = EffortJointInterface

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter or the joint is missing."""
        self._joint = interface.get_handle(params.needed_text(node, JOINT.name))
        self._offer_pid(node)
        self._offer_state(node)
        self._listen(node)
        self._set_point = 0.0

    def starting(self, time_ns: int) -> None:  # noqa: ARG002
        """Stand still."""
        self._set_point = 0.0
        self._pid.reset()

    def set_command(self, value: float) -> None:
        """Move at this velocity (m/s or rad/s)."""
        self._set_point = value

    def update(self, time_ns: int, period_s: float) -> None:
        joint = self._joint
        error = self._set_point - joint.velocity
        joint.command = self._pid.compute_command(error, period_s)
        self._updates_to_state -= 1
        if not self._updates_to_state:
            self._publish(time_ns, period_s, error)

    def _publish(self, time_ns: int, period_s: float, error: float) -> None:
        self._updates_to_state = UPDATES_PER_STATE
        if self._state.wanted:
            message = self._state_message(
                time_ns,
                period_s,
                set_point=self._set_point,
                value=self._joint.velocity,
                # The model never fills this in.
                value_dot=0.0,
                error=error,
            )
            self._state.publish(message)
