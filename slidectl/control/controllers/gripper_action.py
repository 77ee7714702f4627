"""Closes and opens a gripper of one joint by an action, after ros_controllers' gripper_action_controller.

A goal is a position and the largest effort. It succeeds near the position, and is aborted when the joint stands still
elsewhere for a while. Action `gripper_cmd`, without feedback; no other topics.
"""

from __future__ import annotations

from math import isfinite
from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.controller_interface import Compiled, Parts, State
from slidectl.control.duration import to_seconds
from slidectl.control.goals import MONITOR_RATE, ActionController, MonitoredGoal, period_of
from slidectl.control.hardware_interface import EffortJointInterface, JointCommandInterface, PositionJointInterface
from slidectl.control.joint_controller import warn_of_other_joints
from slidectl.control.laws import LEAVE, Columns, LawTables, law
from slidectl.control.node_handle import GoalHandle, GoalStatus, Message, NodeHandle
from slidectl.control.params import JOINT, NUMBER, Parameter, within
from slidectl.control.pid import GAINS, Pid, ReconfigurablePid, next_command_from
from slidectl.control.registry import controller
from slidectl.control.robot_description import joint_of_model

UNDECIDED, REACHED, STALLED = range(3)
"""Verdicts on a goal."""


@law
def judged(gripper: Any, joint: Any, error: float, time_ns: int) -> int:
    """The verdict on the goal: position reached, or joint stalled. Called until the tick that sends the result."""
    if abs(error) < gripper.tolerance:
        return REACHED
    if abs(joint.velocity) > gripper.stall_velocity:
        gripper.moved_ns = time_ns
        return UNDECIDED
    return STALLED if to_seconds(time_ns - gripper.moved_ns) > gripper.stall_timeout_s else UNDECIDED


@law
def grip_by_position(gripper: Any, tables: LawTables, time_ns: int, period_s: float) -> int:
    """The update of a position joint on rows."""
    joint = tables.joints[gripper.joint]
    if gripper.is_judged and judged(gripper, joint, gripper.position - joint.position, time_ns) != UNDECIDED:
        return LEAVE
    joint.command = gripper.position
    gripper.command = gripper.max_effort
    return 0


@law
def grip_by_effort(gripper: Any, tables: LawTables, time_ns: int, period_s: float) -> int:
    """The update of an effort joint on rows."""
    joint = tables.joints[gripper.joint]
    error = gripper.position - joint.position
    if gripper.is_judged and judged(gripper, joint, error, time_ns) != UNDECIDED:
        return LEAVE
    wanted = next_command_from(tables.pids[gripper.pid], error, -joint.velocity, period_s)
    gripper.command = joint.command = clamp_effort(wanted, gripper.max_effort)
    return 0


@law
def clamp_effort(wanted: float, max_effort: float) -> float:
    """min(most, max(-most, wanted)), where most = |max_effort|."""
    most = abs(max_effort)
    least = wanted if wanted > -most else -most
    return least if least < most else most


GRIPPER = Columns(
    changing="command moved_ns",
    fixed="position max_effort tolerance stall_velocity stall_timeout_s is_judged",
    whole="moved_ns is_judged",
)


TOLERANCE = Parameter("goal_tolerance", NUMBER, "a goal succeeds nearer than this", "m or rad", default=0.01)
MAX_EFFORT = Parameter("max_effort", NUMBER, "largest effort while there is no goal", "N or N·m", default=0.0)
STALL_VELOCITY = Parameter(
    "stall_velocity_threshold", NUMBER, "a slower joint stands still", "m/s or rad/s", default=0.001
)
STALL_TIMEOUT = Parameter("stall_timeout", NUMBER, "a joint that stands still longer aborts the goal", "s", default=1.0)


class GripperActionController(ActionController[JointCommandInterface]):
    """Follows the position of the goal. Subclasses define the command."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        JOINT,
        MONITOR_RATE,
        TOLERANCE,
        MAX_EFFORT,
        STALL_VELOCITY,
        STALL_TIMEOUT,
    )

    _pid: Pid | None = None

    def init(self, interface: JointCommandInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, the joint, or the robot description is missing or wrong."""
        self._node = node
        monitor_period_ns = period_of(node, MONITOR_RATE)
        name = params.value_of(node, JOINT)
        joint_of_model(node, name)
        self._joint = interface.get_handle(name)
        self.tolerance: float = abs(params.value_of(node, TOLERANCE))
        self._default_effort: float = abs(params.value_of(node, MAX_EFFORT))
        self.stall_velocity: float = params.value_of(node, STALL_VELOCITY)
        self.stall_timeout_s: float = params.value_of(node, STALL_TIMEOUT)
        self._get_commands(node)
        self.position = self._joint.position
        """The desired position, m or rad."""
        self.max_effort: float = self._default_effort
        self.command = 0.0
        """The effort of the last update; for position joints, the largest effort of the goal."""
        self.moved_ns = 0
        # One result object for all goals, as upstream: a result has the values at the tick that sends it.
        self._result: Message = {"position": self.position, "effort": 0.0, "stalled": False, "reached_goal": False}
        self._serve(node, "gripper_cmd", "control_msgs/GripperCommand", monitor_period_ns)

    def _get_commands(self, node: NodeHandle) -> None:
        """Read further parameters that the commands need."""

    def _start_commands(self) -> None:
        """Set the first command, at the start."""

    def _command(self, error: float, period_s: float) -> float:
        """Command the joint for this position error. Returns the effort for the results."""
        raise NotImplementedError

    def starting(self, time_ns: int) -> None:
        """Hold the measured position."""
        self._hold()
        self._start_commands()
        self.moved_ns = time_ns

    def update(self, time_ns: int, period_s: float) -> None:
        error = self.position - self._joint.position
        if self._goal is not None and self.is_judged:
            verdict = judged(self, self._joint, error, time_ns)
            if verdict != UNDECIDED:
                self._decide(self._goal, GoalStatus.SUCCEEDED if verdict == REACHED else GoalStatus.ABORTED)
        self.command = self._command(error, period_s)

    @property
    def is_judged(self) -> bool:
        """True while there is an active goal: it is undecided, or its result is not sent yet."""
        return self._goal is not None and self._goal.is_active

    def parts(self) -> Parts:
        """The parts of the compiled form."""
        return Parts(joint=self._joint, pid=self._pid)

    def _decide(self, goal: MonitoredGoal, status: GoalStatus) -> None:
        self._result.update(
            position=self._joint.position,
            effort=self.command,
            stalled=status is GoalStatus.ABORTED,
            reached_goal=status is GoalStatus.SUCCEEDED,
        )
        goal.decide(status, self._result)

    def _receive_goal(self, handle: GoalHandle) -> None:
        command = handle.goal["command"]
        if self.state is not State.RUNNING:
            self._reject(handle, "Can't accept new action goals. Controller is not running.")
        elif not isfinite(command["position"]) or not isfinite(command["max_effort"]):
            self._reject(handle, "a goal must have finite numbers, not nan or infinity")
        else:
            self._follow(MonitoredGoal(handle))
            self.position, self.max_effort = command["position"], command["max_effort"]
            self._result.update(reached_goal=False, stalled=False)
            self.moved_ns = self._node.now_ns()

    def _hold(self) -> None:
        """Hold the measured position, with the default effort."""
        self.position = self._joint.position
        self.max_effort = self._default_effort


@controller("position_controllers/GripperActionController")
class PositionGripperActionController(GripperActionController):
    """The command is the position. The effort of a goal has no effect, and results repeat it."""

    compiled = Compiled(grip_by_position, GRIPPER, instead_of="_command")
    interface_type = PositionJointInterface

    def _command(self, error: float, period_s: float) -> float:
        self._joint.command = self.position
        return self.max_effort


@controller("effort_controllers/GripperActionController")
class EffortGripperActionController(GripperActionController):
    """effort = pid(error), limited by the effort of the goal; a goal without one does not push."""

    interface_type = EffortJointInterface
    compiled = Compiled(grip_by_effort, GRIPPER, instead_of="_command")
    _pid: Pid
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *GripperActionController.parameters,
        *within("gains/<joint>", GAINS),
    )

    def _get_commands(self, node: NodeHandle) -> None:
        warn_of_other_joints(node, "gains", [self._joint.name])
        gains = node.child(f"gains/{self._joint.name}")
        if params.read(gains, "p", NUMBER) is not None:
            self._pid = ReconfigurablePid(gains).pid
        else:  # as upstream, it runs without gains too
            node.log("warn", f"parameter {gains.namespace}/p is not set: the gripper has no effort")
            self._pid = Pid()

    def _start_commands(self) -> None:
        self._pid.reset()
        self._joint.command = 0.0

    def _command(self, error: float, period_s: float) -> float:
        wanted = next_command_from(self._pid, error, -self._joint.velocity, period_s)
        if self._pid.observer is not None:
            self._pid.report(error, period_s)
        self._joint.command = clamp_effort(wanted, self.max_effort)
        return self._joint.command
