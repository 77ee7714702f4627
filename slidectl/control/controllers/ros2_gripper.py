"""Closes and opens a gripper of one joint by an action, after ros2_controllers' parallel_gripper_controller.

A goal of the action `~/gripper_cmd` (control_msgs/ParallelGripperCommand) is one position. It succeeds near that, and
ends when the joint stands still elsewhere for a while. No feedback, no topics.
"""

from __future__ import annotations

from math import isfinite
from typing import ClassVar

from slidectl import msgs, names
from slidectl.control.controller_interface import State
from slidectl.control.controllers.gripper_action import REACHED, UNDECIDED, judged
from slidectl.control.goals import ActionController, MonitoredGoal, checked_period
from slidectl.control.hardware_interface import PositionJointInterface
from slidectl.control.node_handle import GoalHandle, GoalStatus, Message, NodeHandle
from slidectl.control.params import BOOLEAN, JOINT, NUMBER, TEXT, TEXTS, Parameter
from slidectl.control.registry import ros2_controller
from slidectl.control.ros2_controller import MONITOR_RATE, NOT_NEGATIVE, Ros2Controller, checked_value, fixed
from slidectl.errors import Refused, listing

_STATES = ("position", "velocity")
_TYPE = "control_msgs/ParallelGripperCommand"

THE_JOINT, STATES, TOLERANCE, ALLOW_STALLING, STALL_VELOCITY, STALL_TIMEOUT = fixed(
    JOINT,
    Parameter("state_interfaces", TEXTS, "position and velocity, which are both read", default=list(_STATES)),
    Parameter("goal_tolerance", NOT_NEGATIVE, "a goal succeeds nearer than this", "m or rad", default=0.01),
    Parameter("allow_stalling", BOOLEAN, "a goal succeeds when the joint stands still elsewhere", default=False),
    Parameter("stall_velocity_threshold", NUMBER, "a slower joint stands still", "m/s or rad/s", default=0.001),
    Parameter("stall_timeout", NUMBER, "a joint that stands still longer has stalled", "s", default=1.0),
)
_WITHOUT_EFFECT = fixed(
    Parameter("max_effort_interface", TEXT, "no effect: the effort limit of the joint counts", default=""),
    Parameter("max_effort", NOT_NEGATIVE, "no effect, as max_effort_interface", "N or N·m", default=10.0),
    Parameter("max_velocity_interface", TEXT, "no effect: the joint moves as its position demands", default=""),
    Parameter("max_velocity", NOT_NEGATIVE, "no effect, as max_velocity_interface", "m/s or rad/s", default=0.1),
)
"""Interfaces of a gripper's own electronics, and what is written to them."""


@ros2_controller("parallel_gripper_action_controller/GripperActionController")
class ParallelGripperActionController(Ros2Controller, ActionController[PositionJointInterface]):
    """The command is the position of the last goal, from the start on the measured one."""

    interface_type = PositionJointInterface
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *Ros2Controller.parameters,
        THE_JOINT,
        MONITOR_RATE,
        STATES,
        TOLERANCE,
        ALLOW_STALLING,
        STALL_VELOCITY,
        STALL_TIMEOUT,
        *_WITHOUT_EFFECT,
    )

    def init(self, interface: PositionJointInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter or the joint is missing or wrong."""
        states: list[str] = checked_value(node, STATES)
        if missing := [name for name in _STATES if name not in states]:
            where = names.join(node.namespace, STATES.name)
            raise Refused(f"{where} lacks {listing(missing)}", f"use [{', '.join(_STATES)}]")
        self._joint = interface.get_handle(checked_value(node, THE_JOINT))
        self.tolerance: float = checked_value(node, TOLERANCE)
        self.stall_velocity: float = checked_value(node, STALL_VELOCITY)
        self.stall_timeout_s: float = checked_value(node, STALL_TIMEOUT)
        self._allows_stalling: bool = checked_value(node, ALLOW_STALLING)
        for parameter in _WITHOUT_EFFECT:
            value = checked_value(node, parameter)
            if value and parameter.kind is TEXT:
                where = names.join(node.namespace, parameter.name)
                node.log("warn", f"{where} has no effect: the simulated gripper has no interface {value!r}")
        self.position = self._joint.position
        """The desired position, m or rad."""
        self.moved_ns = 0
        """When the joint last moved while it followed a goal."""
        monitor_period_ns = checked_period(node, MONITOR_RATE.name, checked_value(node, MONITOR_RATE))
        self._serve(node, "gripper_cmd", _TYPE, monitor_period_ns)

    def starting(self, time_ns: int) -> None:
        """Hold the measured position."""
        super().starting(time_ns)
        self._hold()

    def cycle(self, time_ns: int, period_s: float) -> None:
        goal = self._goal
        if goal is not None and goal.is_active:
            verdict = judged(self, self._joint, self.position - self._joint.position, time_ns)
            if verdict != UNDECIDED:
                is_good = verdict == REACHED or self._allows_stalling
                status = GoalStatus.SUCCEEDED if is_good else GoalStatus.ABORTED
                goal.decide(status, self._result(reached=verdict == REACHED))
        self._joint.command = self.position

    def _result(self, reached: bool) -> Message:
        """The effort of a state is never set upstream."""
        state = {**msgs.default("sensor_msgs/JointState"), "position": [self._joint.position], "effort": [0.0]}
        return {"state": state, "stalled": not reached, "reached_goal": reached}

    def _receive_goal(self, handle: GoalHandle) -> None:
        positions = handle.goal["command"]["position"]
        if self.state is not State.RUNNING:
            self._reject(handle, "Can't accept new action goals. Controller is not running.")
        elif len(positions) != 1:
            self._reject(handle, f"a goal must have one position, not {len(positions)}")
        elif not isfinite(positions[0]):
            self._reject(handle, "the position of a goal must be a finite number, not nan or infinity")
        else:
            self._follow(MonitoredGoal(handle))
            self.position = positions[0]
            self.moved_ns = self._node.now_ns()

    def _hold(self) -> None:
        self.position = self._joint.position
