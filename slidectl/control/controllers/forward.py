"""Controllers that hand a command on as it is, after ros_controllers' forward_command_controller.

Parameter `joint`. No PID, no limits, no state topic.
"""

from __future__ import annotations

from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.controller_interface import Compiled, Parts
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointCommandInterface,
    JointHandle,
    PositionJointInterface,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import ScalarController
from slidectl.control.laws import Columns, law
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import JOINT, Parameter
from slidectl.control.registry import controller


@law
def hand_on(goal: ForwardController, joint: JointHandle) -> None:
    """command = set point."""
    joint.command = goal.set_point


@law
def update_forward(goal: Any, joints: Any, pids: Any, time_ns: int, period_s: float) -> bool:  # noqa: ARG001
    """The update on rows."""
    hand_on(goal, joints[goal.joint])
    return False


class ForwardController(ScalarController):
    """joint command = the last command, 0 until there is one."""

    parameters: ClassVar[tuple[Parameter, ...]] = (JOINT,)
    compiled = Compiled(update_forward, Columns(fixed="set_point", places="joint", whole="joint"))

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: the parameter or the joint is missing."""
        self._joint = interface.get_handle(params.needed_text(node, JOINT.name))
        self.set_point = 0.0
        self._listen(node)

    def starting(self, time_ns: int) -> None:  # noqa: ARG002
        self.set_point = self.first_command()

    def first_command(self) -> float:
        """What to command until somebody says otherwise."""
        return 0.0

    def set_command(self, value: float) -> None:
        """Hand this on from the next update on."""
        self.set_point = value

    def update(self, time_ns: int, period_s: float) -> None:  # noqa: ARG002
        hand_on(self, self._joint)

    def parts(self) -> Parts:
        """What runs compiled besides this controller."""
        return Parts(joint=self._joint)


@controller("effort_controllers/JointEffortController")
class ForwardEffortController(ForwardController):
    """Commands are efforts, N or N·m."""

    interface_type = EffortJointInterface


@controller("velocity_controllers/JointVelocityController")
class ForwardVelocityController(ForwardController):
    """Commands are velocities, m/s or rad/s."""

    interface_type = VelocityJointInterface


@controller("position_controllers/JointPositionController")
class ForwardPositionController(ForwardController):
    """Commands are positions, m or rad. It starts by holding the measured one."""

    interface_type = PositionJointInterface

    def first_command(self) -> float:
        return self._joint.position
