"""Controllers that pass commands on unchanged, after ros_controllers' forward_command_controller.

Parameter `joint`, or `joints` for a group. No PID, no limits, no state topic.
"""

from __future__ import annotations

from array import array
from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.controller_interface import Compiled, Member, Parts
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointCommandInterface,
    JointHandle,
    PositionJointInterface,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import GroupController, ScalarController
from slidectl.control.laws import Columns, LawTables, law
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import JOINT, Parameter
from slidectl.control.registry import controller
from slidectl.errors import Refused


@law
def hand_on(goal: ForwardController, joint: JointHandle) -> None:
    """command = set point."""
    joint.command = goal.set_point


@law
def update_forward(goal: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
    """The update on rows."""
    hand_on(goal, tables.joints[goal.joint])
    return False


@law
def update_group(group: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
    """The update of a group on rows; its numbers are the set points."""
    for k in range(len(tables.members)):
        tables.joints[tables.members[k].joint].command = tables.numbers[k]
    return False


def first_command(interface_type: type[JointCommandInterface], joint: JointHandle) -> float:
    """The command until the first message: the measured position for a position interface, else 0."""
    return joint.position if issubclass(interface_type, PositionJointInterface) else 0.0


class ForwardController(ScalarController):
    """joint command = the last command, 0 until there is one."""

    parameters: ClassVar[tuple[Parameter, ...]] = (JOINT,)
    compiled = Compiled(update_forward, Columns(fixed="set_point"))

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: the parameter or the joint is missing."""
        self._joint = interface.get_handle(params.value_of(node, JOINT))
        self.set_point = 0.0
        self._listen(node, "std_msgs/Float64", self._receive)

    def starting(self, time_ns: int) -> None:
        self.set_point = first_command(self.interface_type, self._joint)

    def set_command(self, value: float) -> None:
        """Command this value from the next update on."""
        self.set_point = value

    def update(self, time_ns: int, period_s: float) -> None:
        hand_on(self, self._joint)

    def parts(self) -> Parts:
        """The parts of the compiled form."""
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


class ForwardGroupController(GroupController):
    """command of each joint = its value in the last command, 0 until there is one."""

    compiled = Compiled(update_group)

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: `joints` is missing or empty, or names an unknown joint."""
        self._get_joints(interface, node)
        self.set_points = array("d", [0.0] * len(self._joints))
        self._listen(node, "std_msgs/Float64MultiArray", self._receive)

    def starting(self, time_ns: int) -> None:
        self.set_points = array("d", [first_command(self.interface_type, joint) for joint in self._joints])

    def set_commands(self, values: list[float]) -> None:
        """Command these values from the next update on."""
        self.set_points = array("d", values)

    def parts(self) -> Parts:
        """The parts of the compiled form."""
        return Parts(members=[Member(None, joint) for joint in self._joints], numbers=self.set_points)

    def check_restored(self) -> None:
        if len(self.set_points) != len(self._joints):
            raise Refused(f"there are {len(self.set_points)} set points for {len(self._joints)} joints")

    def update(self, time_ns: int, period_s: float) -> None:
        for joint, value in zip(self._joints, self.set_points, strict=True):
            joint.command = value


@controller("effort_controllers/JointGroupEffortController")
class ForwardGroupEffortController(ForwardGroupController):
    """Commands are efforts, N or N·m."""

    interface_type = EffortJointInterface


@controller("velocity_controllers/JointGroupVelocityController")
class ForwardGroupVelocityController(ForwardGroupController):
    """Commands are velocities, m/s or rad/s."""

    interface_type = VelocityJointInterface


@controller("position_controllers/JointGroupPositionController")
class ForwardGroupPositionController(ForwardGroupController):
    """Commands are positions, m or rad. It starts by holding the measured ones."""

    interface_type = PositionJointInterface
