"""Positions and velocities of joints by PIDs.

After ros_controllers' JointPositionController, JointGroupPositionController and JointVelocityController. Parameters
`joint` and `pid/*`, or `joints` and `<joint>/pid/*`. For positions, limits and types of the joints come from
`robot_description`. The hardware bounds the command, not these laws.
"""

from __future__ import annotations

from math import inf, radians, tau
from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.angular_distance import distance_with_large_limits, shortest_angular_distance
from slidectl.control.controller_interface import Compiled, Member, Parts
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointCommandInterface,
    JointHandle,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import GroupController, PidController, state_is_due
from slidectl.control.laws import Columns, LawTables, law
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import JOINT, JOINTS, Parameter, within
from slidectl.control.pid import GAINS, Pid, ReconfigurablePid, next_command
from slidectl.control.registry import controller
from slidectl.control.robot_description import joint_of_model
from slidectl.description.robot import Joint

SLIDES, REVOLVES, TURNS = 0, 1, 2
"""How two positions are subtracted: as lengths, as angles with limits, as angles on the circle."""


_GOAL = "set_point lower upper turns"
"""The columns of a goal that laws do not change."""


class PositionGoal:
    """Set point of one joint of a group, and how its positions are subtracted."""

    __slots__ = ("error", "lower", "set_point", "turns", "upper")

    def __init__(self, joint: Joint) -> None:
        self.lower, self.upper, self.turns = range_of(joint)
        self.set_point = self.error = 0.0


def range_of(joint: Joint) -> tuple[float, float, int]:
    """The lowest and the highest position of a joint, and how its positions are subtracted."""
    limit = joint.limit if joint.type in ("revolute", "prismatic") else None
    lower, upper = (-inf, inf) if limit is None else (limit.lower, limit.upper)
    return lower, upper, {"revolute": REVOLVES, "continuous": TURNS}.get(joint.type, SLIDES)


def within_limits(goal: JointPositionController | PositionGoal, position: float) -> float:
    """The position, clipped to the limits of the joint."""
    return goal.upper if position > goal.upper else goal.lower if position < goal.lower else position


@law
def track_position(goal: JointPositionController | PositionGoal, pid: Pid, joint: JointHandle, period_s: float) -> None:
    """command = pid(set point - position)."""
    if goal.turns == REVOLVES:
        goal.error = distance_with_large_limits(joint.position, goal.set_point, goal.lower, goal.upper)
    elif goal.turns == TURNS:
        goal.error = shortest_angular_distance(joint.position, goal.set_point)
    else:
        goal.error = goal.set_point - joint.position
    joint.command = next_command(pid, goal.error, period_s)


@law
def update_position(goal: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
    """The update on rows."""
    track_position(goal, tables.pids[goal.pid], tables.joints[goal.joint], period_s)
    return state_is_due(goal) and goal.wanted != 0


@law
def update_positions(group: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
    """The update of a group on rows."""
    for k in range(len(tables.members)):
        goal = tables.members[k]
        track_position(goal, tables.pids[goal.pid], tables.joints[goal.joint], period_s)
    return False


class JointPositionController(PidController):
    """command = pid(set point - position). For a continuous joint the difference is taken on the circle."""

    compiled = Compiled(
        update_position,
        Columns(
            changing="error updates_to_state states",
            fixed=_GOAL,
            whole="updates_to_state states turns",
        ),
        instead_of="track",
    )
    track = staticmethod(track_position)

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, the joint, or the robot description is missing."""
        name = params.value_of(node, JOINT)
        self._offer_pid(node)
        self._joint = interface.get_handle(name)
        self.lower, self.upper, self.turns = range_of(joint_of_model(node, name))
        self._listen(node, "std_msgs/Float64", self._receive)

    def starting(self, time_ns: int) -> None:
        """Hold the measured position."""
        self.set_command(self._joint.position)
        self._pid.reset()

    def bounds(self) -> tuple[float, float]:
        """The position limits of the joint. The hardware limits the effort or velocity separately."""
        return self.lower, self.upper

    def remark(self, value: float) -> str:
        """A warning about an angle that looks like degrees: a multiple of 5, from 15 to 720."""
        if self.turns == SLIDES or value % 5 or not 15 <= abs(value) <= 720:
            return ""
        return f"{value:g} rad are {value / tau:.3g} turns: if {value:g} degrees are meant, send {radians(value):.4g}"

    def set_command(self, value: float) -> None:
        """Go to this position (m or rad), clipped to the limits."""
        self.set_point = within_limits(self, value)

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the state after an update."""
        joint = self._joint
        self._publish_state(time_ns, period_s, value=joint.position, value_dot=joint.velocity)


@controller("effort_controllers/JointPositionController")
class EffortJointPositionController(JointPositionController):
    """The command is an effort."""

    interface_type = EffortJointInterface


@controller("velocity_controllers/JointPositionController")
class VelocityJointPositionController(JointPositionController):
    """The command is a velocity."""

    interface_type = VelocityJointInterface


@controller("effort_controllers/JointGroupPositionController")
class EffortJointGroupPositionController(GroupController):
    """effort of each joint = its pid(set point - position), as in JointPositionController. No state topic."""

    interface_type = EffortJointInterface
    parameters: ClassVar[tuple[Parameter, ...]] = (JOINTS, *within("<joint>/pid", GAINS))
    compiled = Compiled(update_positions, members=Columns(changing="error", fixed=_GOAL, whole="turns"))

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint, or the robot description is missing."""
        self._get_joints(interface, node)
        self._goals = [PositionGoal(joint_of_model(node, joint.name)) for joint in self._joints]
        self._pids = [ReconfigurablePid(node.child(f"{joint.name}/pid")).pid for joint in self._joints]
        self._listen(node, "std_msgs/Float64MultiArray", self._receive)

    def starting(self, time_ns: int) -> None:
        """Hold the measured positions."""
        self.set_commands([joint.position for joint in self._joints])
        for pid in self._pids:
            pid.reset()

    def bounds(self) -> list[tuple[float, float]]:
        """The position limits of the joints."""
        return [(goal.lower, goal.upper) for goal in self._goals]

    def set_commands(self, values: list[float]) -> None:
        """Go to these positions (m or rad), clipped to the limits."""
        for goal, value in zip(self._goals, values, strict=True):
            goal.set_point = within_limits(goal, value)

    def parts(self) -> Parts:
        """The parts of the compiled form."""
        return Parts(members=list(map(Member, self._goals, self._joints, self._pids)))

    def update(self, time_ns: int, period_s: float) -> None:
        for goal, pid, joint in zip(self._goals, self._pids, self._joints, strict=True):
            track_position(goal, pid, joint, period_s)
            if pid.observer is not None:
                pid.report(goal.error, period_s)


@law
def track_velocity(goal: JointVelocityController, pid: Pid, joint: JointHandle, period_s: float) -> None:
    """command = pid(set point - velocity)."""
    goal.error = goal.set_point - joint.velocity
    joint.command = next_command(pid, goal.error, period_s)


@law
def update_velocity(goal: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
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
        self._joint = interface.get_handle(params.value_of(node, JOINT))
        self._offer_pid(node)
        self._listen(node, "std_msgs/Float64", self._receive)

    def starting(self, time_ns: int) -> None:
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
        self._publish_state(time_ns, period_s, value=self._joint.velocity, value_dot=0.0)
