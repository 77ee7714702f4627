"""Follows trajectories of joints by a topic and by an action, after ros2_controllers' joint_trajectory_controller.

Topics `joint_trajectory` and `speed_scaling_input` (for position commands) in, `controller_state` in each update out;
action `follow_joint_trajectory`; service `query_state`. Between waypoints the joints move on lines, or on cubic or
quintic polynomials where both waypoints have velocities, or also accelerations. The commands are those of the time one
update ahead. Commands of velocity or effort alone come from a PID for each joint.

What differs from the controllers of ros_controllers above: one type serves all interfaces (`command_interfaces`). A
violated tolerance stops the motion, a `goal_time` of 0 waits for ever, and a goal that is replaced is aborted. A new
trajectory on the topic leaves the goal active. An empty one is refused. It blends into the running one, unless that is
a hold. The errors of joints that are not continuous are plain differences.

`goal_time_tolerance` and the tolerances of a goal: above 0 they count, 0 means the parameter, -1 no check; with any
other value all are those of the parameters. They stay in force for later trajectories on the topic. When `cmd_timeout`
holds the joints while a goal waits for its tolerances, that goal succeeds, as upstream.

The types of the joints and their velocity limits come from `robot_description`, if there is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import inf, isfinite
from typing import Any, ClassVar

from slidectl import names
from slidectl.control.angular_distance import shortest_angular_distance
from slidectl.control.controller_interface import MissingInterface, State
from slidectl.control.controllers.joint_trajectory import (
    GOAL_TOLERANCE_VIOLATED,
    INVALID_GOAL,
    PATH_TOLERANCE_VIOLATED,
    SUCCESSFUL,
)
from slidectl.control.duration import header_of, nearest_ns, to_seconds, to_stamp
from slidectl.control.goals import ActionController, MonitoredGoal, checked_period
from slidectl.control.hardware_interface import (
    AnyInterface,
    ClaimedResources,
    EffortJointInterface,
    JointHandle,
    JointStateHandle,
    JointStateInterface,
    PositionJointInterface,
    PosVelAccJointInterface,
    PosVelJointInterface,
    RobotHW,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import warn_of_other_joints
from slidectl.control.node_handle import GoalHandle, GoalStatus, Message, NodeHandle, ParameterChange, publish_if_wanted
from slidectl.control.params import BOOLEAN, JOINTS, NUMBER, TEXTS, Kind, Parameter, as_number
from slidectl.control.registry import ros2_controller
from slidectl.control.robot_description import PARAMETER, robot_of_model
from slidectl.control.ros2_controller import MONITOR_RATE, NOT_NEGATIVE, Ros2Controller, checked_value
from slidectl.control.ros2_pid import STRATEGY, Ros2Gains, Ros2Pid
from slidectl.control.ros2_trajectory import (
    FIELDS,
    Trajectory,
    Waypoint,
    completed,
    decelerating,
    give_times,
    give_velocities,
    replaced,
)
from slidectl.description.parameter_trees import leaves
from slidectl.description.robot import Joint
from slidectl.effects import Effect
from slidectl.errors import MessageRefused, Refused, listing
from slidectl.msgs.schema import nanoseconds

POSITION, VELOCITY, ACCELERATION, EFFORT = QUANTITIES = ("position", "velocity", "acceleration", "effort")
_FIELD = dict(zip(QUANTITIES, FIELDS, strict=True))
"""The field of a waypoint with each quantity."""
_INTERFACES: dict[tuple[str, ...], type[AnyInterface]] = {
    (POSITION,): PositionJointInterface,
    (VELOCITY,): VelocityJointInterface,
    (EFFORT,): EffortJointInterface,
    (POSITION, VELOCITY): PosVelJointInterface,
    (POSITION, VELOCITY, ACCELERATION): PosVelAccJointInterface,
}
"""The interface for each set of commands; the first one is the attribute `command` of its joints."""
_ROUNDING = 1.1920929e-07
"""Sizes up to this count as 0: the epsilon of a float."""


def _number_to(most: float) -> Kind[float]:
    def convert(value: Any) -> float | None:
        number = as_number(value)
        return number if number is not None and number <= most else None

    return Kind(f"a number of {most:g} or less", convert)


def _one_of(words: Sequence[str]) -> Kind[str]:
    return Kind(f"one of {', '.join(words)}", lambda value: value if value in words else None)


def _some_of(words: Sequence[str]) -> Kind[list[str]]:
    def convert(value: Any) -> list[str] | None:
        is_some = isinstance(value, list) and value and all(value.count(one) == 1 and one in words for one in value)
        return list(value) if is_some else None

    return Kind(f"a list of some of {', '.join(words)}", convert)


NOT_POSITIVE = _number_to(0.0)
COMMANDS = _some_of(QUANTITIES)
STATES = _some_of(QUANTITIES[:3])
METHOD = _one_of(("splines", "none"))
LOWEST = Kind("a number below u_clamp_max", as_number)
INTERFACE_NAME = Kind("the full name of an interface", lambda value: value if isinstance(value, str) else None)

COMMAND_JOINTS = Parameter(
    "command_joints",
    TEXTS,
    "the joints that take the commands, if they are not those of joints: as many, in the same order, or some of them",
    names_joints=True,
    fixed=True,
)
COMMAND_INTERFACES = Parameter(
    "command_interfaces",
    COMMANDS,
    "what is commanded: position, velocity or effort; or position and velocity, also with acceleration",
    required=True,
    fixed=True,
)
STATE_INTERFACES = Parameter(
    "state_interfaces",
    STATES,
    "what is measured: position, or position and velocity. Accelerations are not measured",
    required=True,
    fixed=True,
)
INITIAL_SCALING = Parameter(
    "speed_scaling/initial_scaling_factor",
    NOT_NEGATIVE,
    "the speed of trajectories until speed_scaling_input changes it; for position commands alone",
    default=1.0,
    fixed=True,
)
SCALING_STATE, SCALING_COMMAND = (
    Parameter(
        f"speed_scaling/{kind}_interface",
        INTERFACE_NAME,
        f"the {kind} interface of the speed. Simulated robots have none: it must be empty",
        default="",
        fixed=True,
    )
    for kind in ("state", "command")
)
PARTIAL = Parameter(
    "allow_partial_joints_goal", BOOLEAN, "accepts trajectories of some of the joints", default=False, live=True
)
REPLACEMENT = Parameter(
    "allow_trajectory_replacement",
    BOOLEAN,
    "a new trajectory blends into the running one, which goes on until the stamp of the new one; else it starts at once"
    " from the measured state",
    default=True,
    live=True,
)
FROM_DESIRED = Parameter(
    "interpolate_from_desired_state",
    BOOLEAN,
    "a trajectory begins at the last command, not at the measured state",
    default=False,
    fixed=True,
)
OPEN_LOOP = Parameter(
    "open_loop_control", BOOLEAN, "older name of interpolate_from_desired_state", default=False, fixed=True
)
INTEGRATION = Parameter(
    "allow_integration_in_goal_trajectories",
    BOOLEAN,
    "accepts waypoints without positions, or without velocities too: they are integrated",
    default=False,
    live=True,
)
LAST_COMMAND = Parameter(
    "set_last_command_interface_value_as_state_on_activation",
    BOOLEAN,
    "it starts by holding the last commands of the joints, not their measured positions",
    default=True,
    live=True,
)
INTERPOLATION = Parameter(
    "interpolation_method",
    METHOD,
    "splines: polynomials between waypoints; none: the next waypoint at once",
    default="splines",
    fixed=True,
)
UPSAMPLING = Parameter(
    "positions_upsampling/enable",
    BOOLEAN,
    "gives a trajectory of positions alone, on the topic, the velocities of the spline through them",
    default=False,
    fixed=True,
)
POLICY_FREQUENCY = Parameter(
    "positions_upsampling/policy_frequency",
    NOT_NEGATIVE,
    "waypoints per second, for trajectories without times; 0: times are needed",
    "1/s",
    default=0.0,
    fixed=True,
)
NONZERO_END = Parameter(
    "allow_nonzero_velocity_at_trajectory_end",
    BOOLEAN,
    "accepts trajectories whose last waypoint has a velocity",
    default=False,
    live=True,
)
TIMEOUT = Parameter(
    "cmd_timeout",
    NUMBER,
    "time after the end of a trajectory at which the measured positions are held; 0: never. It must be above"
    " constraints/goal_time, and is read at the start",
    "s",
    default=0.0,
    live=True,
)
STOPPED_VELOCITY = Parameter(
    "constraints/stopped_velocity_tolerance",
    NUMBER,
    "largest velocity error at the end, where velocities are measured and velocity or effort is commanded; 0: any",
    "m/s or rad/s",
    default=0.01,
    live=True,
)
GOAL_TIME = Parameter(
    "constraints/goal_time",
    NOT_NEGATIVE,
    "time after the end to meet the goal tolerances in; 0: no limit",
    "s",
    default=0.0,
    live=True,
)
DECELERATES = Parameter(
    "constraints/decelerate_on_cancel",
    BOOLEAN,
    "a cancelled goal comes to rest with max_deceleration_on_cancel of each joint; else it stops at once",
    default=False,
    fixed=True,
)
PATH_TOLERANCE = Parameter(
    "constraints/<joint>/trajectory", NUMBER, "largest position error on the way; 0: any", "m or rad", 0.0, live=True
)
GOAL_TOLERANCE = Parameter(
    "constraints/<joint>/goal", NUMBER, "largest position error at the end; 0: any", "m or rad", 0.0, live=True
)
DECELERATION = Parameter(
    "constraints/<joint>/max_deceleration_on_cancel",
    NOT_NEGATIVE,
    "deceleration for decelerate_on_cancel",
    "m/s² or rad/s²",
    default=0.0,
    fixed=True,
)
_GAINS = {
    Parameter("p", NUMBER, "proportional gain", default=0.0, live=True): "p",
    Parameter("i", NUMBER, "integral gain", default=0.0, live=True): "i",
    Parameter("d", NUMBER, "derivative gain", default=0.0, live=True): "d",
    Parameter("u_clamp_max", NUMBER, "upper bound of the PID's command", default=inf, live=True): "u_clamp_max",
    Parameter("u_clamp_min", LOWEST, "lower bound of the PID's command", default=-inf, live=True): "u_clamp_min",
    Parameter("i_clamp_max", NOT_NEGATIVE, "upper bound of the integral term", default=inf, live=True): "i_clamp_max",
    Parameter("i_clamp_min", NOT_POSITIVE, "lower bound of the integral term", default=-inf, live=True): "i_clamp_min",
    Parameter(
        "tracking_time_constant",
        NOT_NEGATIVE,
        "time constant of back_calculation; 0: it follows from the gains",
        "s",
        default=0.0,
        live=True,
    ): "tracking_time_constant",
    Parameter(
        "error_deadband",
        NUMBER,
        "errors up to this size do not change the integral",
        "m or rad",
        default=0.0,
        live=True,
    ): "error_deadband",
    Parameter(
        "antiwindup_strategy", STRATEGY, "the integral while the command is at its bound", default="none", live=True
    ): "antiwindup_strategy",
}
"""The parameters of a PID, with the field of `Ros2Gains`."""
GAINS = {replace(one, name=f"gains/<joint>/{one.name}"): field for one, field in _GAINS.items()}
FEED_FORWARD = Parameter(
    "gains/<joint>/ff_velocity_scale", NUMBER, "command per desired velocity, without any error", default=0.0, live=True
)
_JOINTS = replace(JOINTS, fixed=True)

_PREEMPTED = "Current goal preempted by new incoming action."
_DEACTIVATED = "Current goal cancelled during deactivate transition."
_DEFAULT, _UNCHECKED = 0.0, -1.0
"""Tolerances of a goal with a meaning of their own."""


class _WrongTolerance(Exception):
    """A tolerance of a goal has no meaning."""


@ros2_controller("joint_trajectory_controller/JointTrajectoryController")
class Ros2JointTrajectoryController(Ros2Controller, ActionController[Any]):
    """The commands are those of `command_interfaces`."""

    interface_types: ClassVar[tuple[type[AnyInterface], ...]] = (*_INTERFACES.values(), JointStateInterface)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *Ros2Controller.parameters,
        _JOINTS,
        COMMAND_JOINTS,
        COMMAND_INTERFACES,
        STATE_INTERFACES,
        PARTIAL,
        REPLACEMENT,
        FROM_DESIRED,
        OPEN_LOOP,
        INTEGRATION,
        LAST_COMMAND,
        MONITOR_RATE,
        INTERPOLATION,
        UPSAMPLING,
        POLICY_FREQUENCY,
        NONZERO_END,
        TIMEOUT,
        INITIAL_SCALING,
        SCALING_STATE,
        SCALING_COMMAND,
        GOAL_TIME,
        STOPPED_VELOCITY,
        DECELERATES,
        PATH_TOLERANCE,
        GOAL_TOLERANCE,
        DECELERATION,
        *GAINS,
        FEED_FORWARD,
    )

    # Init.

    def _claim(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> tuple[ClaimedResources, ...]:
        quantities = tuple(one for one in QUANTITIES if one in checked_value(node, COMMAND_INTERFACES))
        kind = _INTERFACES.get(quantities)
        if kind is None:
            where = names.join(node.namespace, COMMAND_INTERFACES.name)
            sets = " or ".join(str(list(each)) for each in _INTERFACES)
            raise Refused(f"{where}: no joint can be commanded by {listing(quantities)} together", f"use {sets}")
        states = hw.get(JointStateInterface)
        if states is None:
            raise MissingInterface(JointStateInterface.type_name, hw)
        self._joint_states = states
        self._quantities = quantities
        self._attributes = [(one, "command" if one == quantities[0] else f"command_{one}") for one in quantities]
        """Each commanded quantity, and the attribute of a joint for its command."""
        self.interface_type = kind
        return super()._claim(hw, root, node)

    def init(self, interface: AnyInterface, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint or the robot description is missing or wrong."""
        self._node = node
        self._names: list[str] = checked_value(node, _JOINTS)
        commanded: list[str] = checked_value(node, COMMAND_JOINTS) or self._names
        self._check_names(commanded)
        self._check_states(checked_value(node, STATE_INTERFACES))
        self._check_scaling()
        self._joints: tuple[JointStateHandle, ...] = tuple(self._joint_states.get_handle(name) for name in self._names)
        self._commanded: tuple[JointHandle, ...] = tuple(interface.get_handle(name) for name in commanded)
        is_smaller = len(commanded) < len(self._names)
        self._places = [self._names.index(name) if is_smaller else k for k, name in enumerate(commanded)]
        """The index in `joints` of each commanded joint."""
        self._commands_all = commanded == self._names
        self._uses_pid = self._quantities in ((VELOCITY,), (EFFORT,))
        self._from_desired: bool = checked_value(node, FROM_DESIRED)
        if checked_value(node, OPEN_LOOP):
            text = f"{node.namespace}/{OPEN_LOOP.name} is of older versions: it means {FROM_DESIRED.name} here"
            node.log("warn", text)
            self._from_desired = True
        self._interpolates = checked_value(node, INTERPOLATION) == "splines"
        self._upsamples = checked_value(node, UPSAMPLING) and self._interpolates
        self._policy_frequency: float = checked_value(node, POLICY_FREQUENCY)
        joints = self._described_joints()
        self._turns = [joint is not None and joint.type == "continuous" for joint in joints]
        self._fastest = [joint.limit.velocity if joint is not None and joint.limit else 0.0 for joint in joints]
        self._decelerations: list[float] = [checked_value(node, DECELERATION, name) for name in self._names]
        self._decelerates = checked_value(node, DECELERATES) and self._can_decelerate()
        known = [*self._names, *(one.name.rpartition("/")[2] for one in (GOAL_TIME, STOPPED_VELOCITY, DECELERATES))]
        warn_of_other_joints(node, "constraints", known)
        warn_of_other_joints(node, "gains", self._names)
        if not self._uses_pid and node.has_param("gains"):
            node.log("warn", f"{node.namespace}/gains has no effect: only velocity or effort alone has a PID")
        self._check_gains(dict(leaves(node.get_param("gains", {}), "gains/")))
        self._pids = [Ros2Pid() for _ in self._places]
        self._feed_forward = [0.0 for _ in self._places]
        self._read_live()
        self._scaling = self._initial_scaling()
        self.time_ns = self.trajectory_ns = self._period_ns = self._timeout_ns = 0
        self.is_holding = True
        """True while the trajectory is a hold, or repeats the end of a goal: no tolerances are checked."""
        self._trajectory: Trajectory | None = None
        self._pending: Trajectory | None = None
        """The trajectory that the next update begins."""
        self._tolerances, self._goal_time_s = list(self._default_tolerances), self._default_goal_time_s
        """The tolerances in force."""
        self._has_feedback = False
        self._measured = self._measure()
        self._desired = self._last_command = self._measured
        self._last_command_ns = 0
        self._error = Waypoint(0, [0.0] * len(self._names), self._zeros_if(self._has_velocities))
        self._output = self._commands()
        self._state = node.advertise("controller_state", "slidectl/JointTrajectoryControllerState")
        node.advertise_service("query_state", "slidectl/QueryTrajectoryState", self._query_state, Effect.READS)
        monitor_period_ns = checked_period(node, MONITOR_RATE.name, checked_value(node, MONITOR_RATE))
        self._serve(node, "follow_joint_trajectory", "control_msgs/FollowJointTrajectory", monitor_period_ns)
        node.guard_params(self._judge)
        node.watch_param(node.namespace, self._read_live)
        if self._is_of_positions:
            node.subscribe("speed_scaling_input", "control_msgs/SpeedScalingFactor", self._receive_scaling)
        node.subscribe("joint_trajectory", "trajectory_msgs/JointTrajectory", self._receive_trajectory)

    @property
    def _is_of_positions(self) -> bool:
        return self._quantities == (POSITION,)

    def _check_names(self, commanded: list[str]) -> None:
        where = names.join(self._node.namespace, _JOINTS.name)
        if not self._names:
            raise Refused(f"parameter {where} must name at least one joint")
        for parameter, listed in ((_JOINTS, self._names), (COMMAND_JOINTS, commanded)):
            if len(set(listed)) < len(listed):
                full = names.join(self._node.namespace, parameter.name)
                raise Refused(f"parameter {full} names a joint twice: {listing(listed)}")
        place = names.join(self._node.namespace, COMMAND_JOINTS.name)
        if len(commanded) > len(self._names):
            raise Refused(f"{place} has {len(commanded)} joints, and {where} only {len(self._names)}")
        if len(commanded) < len(self._names) and not set(commanded) <= set(self._names):
            raise Refused(f"{place} must be some of {listing(self._names)}, or as many as these")

    def _check_states(self, states: list[str]) -> None:
        where = names.join(self._node.namespace, STATE_INTERFACES.name)
        if ACCELERATION in states:
            raise Refused(f"{where}: this robot does not measure accelerations", "use [position, velocity]")
        if POSITION not in states:
            raise Refused(f"{where} must have position", "use [position] or [position, velocity]")
        self._has_velocities = VELOCITY in states
        if not self._has_velocities and POSITION not in self._quantities:
            text = f"{where} must have velocity too: commands of {listing(self._quantities)} come from a PID"
            raise Refused(text, "use [position, velocity]")

    def _check_scaling(self) -> None:
        for parameter in (SCALING_STATE, SCALING_COMMAND):
            if value := checked_value(self._node, parameter):
                where = names.join(self._node.namespace, parameter.name)
                raise Refused(
                    f"{where}: this robot has no interface {value!r}", "publish on speed_scaling_input instead"
                )

    def _initial_scaling(self) -> float:
        factor: float = checked_value(self._node, INITIAL_SCALING)
        if self._is_of_positions:
            return factor
        if factor != 1.0:
            where = names.join(self._node.namespace, INITIAL_SCALING.name)
            self._node.log("warn", f"{where} has no effect: only trajectories of positions alone are scaled")
        return 1.0

    def _described_joints(self) -> list[Joint | None]:
        """The joints in the robot description; None for those that it lacks. Raises Refused, BadFile: it is wrong."""
        where = self._node.search_param(PARAMETER)
        joints = {} if where is None else robot_of_model(self._node, where).joints
        return [joints.get(name) for name in self._names]

    def _can_decelerate(self) -> bool:
        """False, with an error in the log, when something is missing for it."""
        missing = []
        for name, deceleration, fastest in zip(self._names, self._decelerations, self._fastest, strict=True):
            missing += [] if deceleration > 0.0 else [DECELERATION.name.replace("<joint>", name)]
            missing += [] if fastest > 0.0 else [f"a velocity limit of {name} in {PARAMETER}"]
        missing += [] if self._has_velocities else ["velocity in state_interfaces"]
        if missing:
            text = f"{self._node.namespace}/{DECELERATES.name} has no effect without {listing(missing)}"
            self._node.log("error", text)
        return not missing

    # Parameters that change.

    def _judge(self, change: ParameterChange) -> None:
        """Refuse gains that the PID cannot use."""
        if not change.deletes and isinstance(change.after, dict):
            self._check_gains(dict(leaves(change.after)))

    def _check_gains(self, values: dict[str, Any]) -> None:
        """Raise Refused when the gains of a joint, by the names of their parameters, do not fit together."""
        for name in self._names:
            try:
                _gains_of(values, name).checked()
            except Refused as error:
                raise Refused(f"{self._node.namespace}/gains/{name}/{error.message}") from None

    def _read_live(self) -> None:
        """Use the present values of the parameters that may change. Tolerances count from the next goal on."""
        node = self._node
        self._allows_partial: bool = checked_value(node, PARTIAL)
        self._replaces: bool = checked_value(node, REPLACEMENT)
        self._integrates: bool = checked_value(node, INTEGRATION)
        self._starts_at_command: bool = checked_value(node, LAST_COMMAND)
        self._allows_moving_end: bool = checked_value(node, NONZERO_END)
        self._wanted_timeout_s: float = checked_value(node, TIMEOUT)
        self._default_goal_time_s: float = checked_value(node, GOAL_TIME)
        stopped: float = checked_value(node, STOPPED_VELOCITY)
        self._default_tolerances = [
            (checked_value(node, PATH_TOLERANCE, name), 0.0, checked_value(node, GOAL_TOLERANCE, name), stopped)
            for name in self._names
        ]
        """Of each joint the largest errors of position and velocity on the way, and those at the end; 0: any."""
        for k, place in enumerate(self._places):
            name = self._names[place]
            values = {one.name.replace("<joint>", name): checked_value(node, one, name) for one in GAINS}
            self._pids[k].set_gains(_gains_of(values, name))
            self._feed_forward[k] = checked_value(node, FEED_FORWARD, name)

    # The cycle.

    def starting(self, time_ns: int) -> None:
        """Hold the positions: those commanded last, or the measured ones."""
        super().starting(time_ns)
        self.time_ns = time_ns
        self._measured = self._measure()
        current = self._measured.copy()
        if self._starts_at_command and self._commands_all:
            last = self._commands()
            for quantity in self._quantities:
                values = getattr(last, _FIELD[quantity])
                if all(map(isfinite, values)):
                    setattr(current, _FIELD[quantity], values)
        self._desired, self._last_command, self._last_command_ns = current.completed(), current, 0
        for pid in self._pids:
            pid.reset()
        self._tolerances, self._goal_time_s = list(self._default_tolerances), self._default_goal_time_s
        self._trajectory = None
        self._hold_at(current.positions)
        timeout_s = self._wanted_timeout_s
        if timeout_s > self._default_goal_time_s:
            self._timeout_ns = nearest_ns(min(timeout_s, 1e9))
        else:
            self._timeout_ns = 0
            if timeout_s != 0.0:
                text = f"{TIMEOUT.name} has no effect: it must be above {GOAL_TIME.name}, {self._default_goal_time_s:g}"
                self._node.log("warn", f"{self._node.namespace}: {text}")

    def stopping(self, time_ns: int) -> None:
        """Abort the goal and command rest: the positions that are commanded, and 0 for the others."""
        self._end()
        for joint in self._commanded:
            for quantity, attribute in self._attributes:
                if quantity != POSITION:
                    setattr(joint, attribute, 0.0)

    def aborting(self, time_ns: int) -> None:
        self._end()

    def _end(self) -> None:
        self._preempt(_DEACTIVATED)
        self._trajectory = self._pending = None

    def cycle(self, time_ns: int, period_s: float) -> None:
        self.time_ns, self._period_ns = time_ns, nearest_ns(period_s)
        if self._pending is not None:
            self._trajectory, self._pending = self._installed(self._pending), None
        self._measured = self._measure()
        if self._trajectory is not None:
            self._move(self._trajectory, period_s)
        publish_if_wanted(self._state, self._message)

    def _installed(self, new: Trajectory) -> Trajectory:
        """The trajectory for all joints, blended with the running one if it may be."""
        old = self._trajectory
        positions = self._held_positions()
        is_filled = len(new.joints) == len(self._names) or bool(new.points[-1].positions)
        if not (self._replaces and is_filled and not new.is_hold and old and len(old.points) > 1 and not old.is_hold):
            return completed(new, positions)
        ahead_s = to_seconds(max(new.start_ns - self.time_ns, 0)) if new.start_ns else 0.0
        now_ns = self.trajectory_ns
        begin_ns = now_ns + nearest_ns(self._scaling * ahead_s)
        return replaced(old, new, now_ns, begin_ns, positions, self._interpolates)

    def _held_positions(self) -> list[float]:
        """The positions of joints that a trajectory omits: the commanded ones, else the measured ones."""
        positions = [joint.position for joint in self._joints]
        if POSITION in self._quantities:
            for place, joint in zip(self._places, self._commanded, strict=True):
                if isfinite(joint.command):
                    positions[place] = joint.command
        return positions

    def _move(self, trajectory: Trajectory, period_s: float) -> None:
        is_first = not trajectory.is_begun
        if is_first:
            before, before_ns = self._measured, self.time_ns
            if self._from_desired:
                before, before_ns = self._last_command, self._last_command_ns or self.time_ns
            trajectory.begin(self.time_ns, before, before_ns, self._turns)
            self.trajectory_ns = self.time_ns
        else:
            self.trajectory_ns += nearest_ns(self._scaling * period_s)
        desired = trajectory.sample(self.trajectory_ns, self._interpolates)
        if desired is not None:
            self._desired = desired.state
            trajectory.advance(desired)
        ahead = trajectory.sample(self.trajectory_ns + self._period_ns, self._interpolates)
        if ahead is None:
            return
        is_at_end = ahead.next == len(trajectory.points)
        since_ns = self.trajectory_ns - trajectory.start_ns - trajectory.points[ahead.segment].time_ns
        self._error = self._errors()
        if is_at_end and not self.is_holding and 0 < self._timeout_ns < since_ns:
            self._node.log("warn", f"{self._node.namespace}: Aborted due to command timeout")
            self._hold_at(self._measured.positions)
        is_off_path = not self.is_holding and (not is_at_end or is_first) and self._is_outside(0, "path")
        is_late = is_at_end and 0.0 < self._goal_time_s < to_seconds(since_ns)
        is_off_goal = not self.is_holding and is_at_end and self._is_outside(2, "goal" if is_late else "")
        if not is_off_path and not (is_off_goal and is_late):
            self._command(ahead.state, period_s)
        self._judge_goal(is_off_path, is_at_end, is_off_goal, is_late, to_seconds(since_ns))

    def _judge_goal(self, is_off_path: bool, is_at_end: bool, is_off_goal: bool, is_late: bool, since_s: float) -> None:
        """End the goal, and hold, by the verdicts of this update."""
        assert self._trajectory is not None
        goal = self._goal
        if goal is not None:
            self._has_feedback = True
        name = self._node.namespace
        if is_off_path:
            if goal is not None:
                self._node.log("warn", f"{name}: Aborted due to state tolerance violation")
                text = "Aborted due to path tolerance violation"
                self._decide(goal, GoalStatus.ABORTED, PATH_TOLERANCE_VIOLATED, text)
            else:
                self._node.log("error", f"{name}: Holding position due to state tolerance violation")
            self._hold_at(self._measured.positions)
        elif is_off_goal and is_late:
            if goal is not None:
                text = f"Aborted due to goal_time_tolerance exceeding by {since_s:f} seconds"
                self._node.log("warn", f"{name}: {text}")
                self._decide(goal, GoalStatus.ABORTED, GOAL_TOLERANCE_VIOLATED, text)
            else:
                self._node.log("error", f"{name}: Exceeded goal_time_tolerance: holding position...")
            self._hold_at(self._measured.positions)
        elif goal is not None and is_at_end and not is_off_goal:
            self._decide(goal, GoalStatus.SUCCEEDED, SUCCESSFUL, "Goal successfully reached!")
            self._hold([self._trajectory.points[-1].copy()])

    def _decide(self, goal: MonitoredGoal, status: GoalStatus, code: int, text: str) -> None:
        goal.decide(status, _result(code, text))
        self._goal = None

    def _measure(self) -> Waypoint:
        velocities = [joint.velocity for joint in self._joints] if self._has_velocities else []
        return Waypoint(0, [joint.position for joint in self._joints], velocities)

    def _errors(self) -> Waypoint:
        """Desired minus measured state. Velocities have an error only where they are commanded or an effort is."""
        desired, measured = self._desired, self._measured
        positions = []
        for turn, wanted, found in zip(self._turns, desired.positions, measured.positions, strict=True):
            positions.append(shortest_angular_distance(found, wanted) if turn else wanted - found)
        velocities = self._zeros_if(self._has_velocities)
        if velocities and self._quantities != (POSITION,):
            velocities = [a - b for a, b in zip(desired.velocities, measured.velocities, strict=True)]
        return Waypoint(0, positions, velocities)

    def _is_outside(self, first: int, what: str) -> bool:
        """True when an error is above its tolerance, from column `first` on. `what`: the tolerance, for the log."""
        found = []
        vectors = {POSITION: self._error.positions, VELOCITY: self._error.velocities}
        for column, (quantity, errors) in enumerate(vectors.items(), start=first):
            for name, error, row in zip(self._names, errors, self._tolerances, strict=False):
                if 0.0 < row[column] < abs(error):
                    found.append(f"{name} has a {quantity} error of {error:g}, its {what} tolerance is {row[column]:g}")
        if found and what:
            self._node.log("error", f"{self._node.namespace}: {'; '.join(found)}")
        return bool(found)

    def _commands(self) -> Waypoint:
        """The present commands of the commanded joints."""
        found = Waypoint(0, ())
        for quantity, attribute in self._attributes:
            setattr(found, _FIELD[quantity], [getattr(joint, attribute) for joint in self._commanded])
        return found

    def _command(self, state: Waypoint, period_s: float) -> None:
        """Command the joints to this state, that of the next update."""
        for k, (place, joint) in enumerate(zip(self._places, self._commanded, strict=True)):
            if self._uses_pid:
                effort = state.effort[place] if self._quantities == (EFFORT,) else 0.0
                errors = self._error.positions[place], self._error.velocities[place]
                correction = self._pids[k].step_with_rate(*errors, period_s)
                joint.command = state.velocities[place] * self._feed_forward[k] + effort + correction
                continue
            for quantity, attribute in self._attributes:
                setattr(joint, attribute, getattr(state, _FIELD[quantity])[place])
        self._last_command, self._last_command_ns = state, self.time_ns

    def _zeros_if(self, condition: bool) -> list[float]:
        return [0.0] * len(self._names) if condition else []

    # Holding.

    def _hold(self, points: list[Waypoint] | None = None) -> None:
        """Follow these points in the next update, without tolerances; by default those after a cancelled goal."""
        if points is None:
            measured = self._measure()
            if not self._decelerates or self._period_ns == 0:
                return self._hold_at(measured.positions)
            points = decelerating(
                measured.positions, measured.velocities, self._decelerations, self._fastest, self._period_ns
            )
        self._pending = Trajectory(0, points, list(range(len(self._names))), is_hold=True)
        self.is_holding = True
        return None

    def _hold_at(self, positions: list[float]) -> None:
        """Hold these positions from the next update on."""
        rest = [self._zeros_if(quantity in self._quantities) for quantity in QUANTITIES[1:]]
        self._hold([Waypoint(0, positions, *rest)])

    # Messages.

    def _message(self) -> Message:
        """slidectl/JointTrajectoryControllerState of the last update."""
        output = self._commands()
        if all(isfinite(number) for field in FIELDS for number in getattr(output, field)):
            self._output = output
        return {
            **self._states("reference", "feedback"),
            "output": _point(self._output),
            "speed_scaling_factor": self._scaling,
        }

    def _feedback(self) -> Message | None:
        return self._states("desired", "actual") if self._has_feedback else None

    def _states(self, desired: str, actual: str) -> Message:
        """The states of the last update, the fields of the desired and the measured one being called so.

        The time of the desired state is scaled, that of the measured one is not.
        """
        start_ns = self.trajectory_ns if self._trajectory is None else self._trajectory.start_ns
        wanted = _point(self._desired, self.trajectory_ns - start_ns)
        if EFFORT not in self._quantities:
            wanted["effort"] = []
        return {
            "header": header_of(self.time_ns),
            "joint_names": self._names,
            desired: wanted,
            actual: _point(self._measured, 0 if self._trajectory is None else self.time_ns - start_ns),
            "error": _point(self._error),
        }

    # Requests of clients, between two cycles.

    def _receive_trajectory(self, message: Message) -> None:
        name = self._node.namespace
        try:
            new = self._checked(message, upsamples=self._upsamples)
        except Refused as refusal:
            self._node.log("error", f"{name}: {refusal.message}")
            raise MessageRefused(refusal.message) from None
        if self.state is not State.RUNNING:
            start = f"start it: slidectl controller start {name.rpartition('/')[2]}"
            self._node.log("warn", f"{name} is not running: the trajectory has no effect; {start}")
            return
        self._pending, self.is_holding = new, False

    def _receive_scaling(self, message: Message) -> None:
        factor: float = message["factor"]
        if not 0.0 <= factor < inf:
            text = f"{self._node.namespace}: the speed scaling factor must be 0 or above, not {factor:g}: it is ignored"
            self._node.log("warn", text)
            raise MessageRefused(text)
        self._scaling = factor

    def _receive_goal(self, handle: GoalHandle) -> None:
        if self.state is not State.RUNNING:
            self._reject(handle, "Can't accept new action goals. Controller is not running.")
            return
        try:
            new = self._checked(handle.goal["trajectory"], upsamples=False)
        except Refused as refusal:
            self._reject(handle, refusal.message)
            return
        if self._ticked is not None:
            self._ticked.tick(lambda: None)  # its result, if it has ended since the last tick
        self._follow(MonitoredGoal(handle))
        self._pending, self.is_holding, self._has_feedback = new, False, False
        self._tolerances, self._goal_time_s = self._tolerances_of(handle.goal)

    def _preempt(self, text: str = _PREEMPTED) -> None:
        goal, self._goal = self._goal, None
        if goal is not None and goal.is_active:
            goal.handle.abort(_result(INVALID_GOAL, text))

    def _query_state(self, request: Message) -> Message:
        if self.state is not State.RUNNING:
            return {"success": False, "message": "the controller is not running"}
        trajectory, state, text = self._trajectory, self._measured, ""
        found = None
        if trajectory is not None and nanoseconds(request["time"]) >= trajectory.start_ns:
            found = trajectory.sample(nanoseconds(request["time"]), self._interpolates)
        if trajectory is None or found is None:
            text = "the time is before the start of the trajectory"
        else:
            state = found.state
            text = "the time is after the end of the trajectory" if found.next == len(trajectory.points) else ""
        return {
            "success": not text,
            "message": text,
            "name": self._names,
            "position": state.positions,
            "velocity": state.velocities,
            "acceleration": state.accelerations,
        }

    def _tolerances_of(self, goal: Message) -> tuple[list[tuple[float, float, float, float]], float]:
        """The tolerances for a goal, and its time after the end in s. With a wrong one all are those by default."""
        rows = {name: list(row) for name, row in zip(self._names, self._default_tolerances, strict=True)}
        try:
            for place, first in (("path_tolerance", 0), ("goal_tolerance", 2)):
                for message in goal[place]:
                    name = message["name"]
                    if name not in rows:
                        raise _WrongTolerance(f"{place} names the unknown joint {name!r}")
                    for column, quantity in enumerate((POSITION, VELOCITY), start=first):
                        what = f"{place} of {name}: {quantity}"
                        rows[name][column] = _tolerance(message[quantity], rows[name][column], what)
                    _tolerance(message[ACCELERATION], 0.0, f"{place} of {name}: {ACCELERATION}")
            asked_s = to_seconds(nanoseconds(goal["goal_time_tolerance"]))
            goal_time_s = _tolerance(asked_s, self._default_goal_time_s, "goal_time_tolerance")
        except _WrongTolerance as error:
            text = f"{error}: the tolerances of the goal have no effect, those of the parameters count"
            self._node.log("error", f"{self._node.namespace}: {text}")
            return list(self._default_tolerances), self._default_goal_time_s
        return [(row[0], row[1], row[2], row[3]) for row in rows.values()], goal_time_s

    def _checked(self, message: Message, upsamples: bool) -> Trajectory:
        """The trajectory of a trajectory_msgs/JointTrajectory.

        `upsamples`: it gets the times and velocities of `positions_upsampling`. Raises Refused, with the reason.
        """
        asked: list[str] = message["joint_names"]
        if not asked:
            raise Refused("Empty joint names on incoming trajectory.")
        if len(asked) != len(self._names) and not self._allows_partial:
            raise Refused("Joints on incoming trajectory don't match the controller joints.")
        if not message["points"]:
            raise Refused("Empty trajectory received.")
        for name in asked:
            if name not in self._names:
                text = f"Incoming joint {name} doesn't match the controller's joints: {listing(self._names)}."
                raise Refused(text)
            if asked.count(name) > 1:
                raise Refused(f"Incoming joint {name} is named twice.")
        points = [self._waypoint(one, k, len(asked)) for k, one in enumerate(message["points"])]
        if upsamples:
            give_times(points, self._policy_frequency)
        for k, (one, other) in enumerate(pairwise(points)):
            if one.time_ns >= other.time_ns:
                seconds = f"{to_seconds(one.time_ns):f} and {to_seconds(other.time_ns):f}"
                raise Refused(f"Time between points {k} and {k + 1} is not strictly increasing, it is {seconds} s.")
        self._check_end(message, asked, points[-1])
        if upsamples:
            give_velocities(points)
        stamp_ns = nanoseconds(message["header"]["stamp"])
        return Trajectory(stamp_ns, points, [self._names.index(name) for name in asked])

    def _waypoint(self, point: Message, k: int, joints: int) -> Waypoint:
        """The waypoint of point `k`. Raises Refused: it lacks numbers, or has wrong ones."""
        given = [field for field in FIELDS if point[field]]
        for field in given:
            if len(point[field]) != joints:
                sizes = f"joint_names size ({joints}) and {field} ({len(point[field])})"
                raise Refused(f"Mismatch between {sizes} at point #{k}.")
            if not all(map(isfinite, point[field])):
                raise Refused(f"The {field} at point #{k} must be finite numbers, not nan or infinity.")
        if "positions" not in given and not self._integrates:
            hint = f"{INTEGRATION.name} lets the controller integrate velocities"
            raise Refused(f"Mismatch between joint_names size ({joints}) and positions (0) at point #{k}; {hint}.")
        if not set(given) & set(FIELDS[:3]):
            raise Refused(f"Point #{k} has no positions, no velocities and no accelerations.")
        if "effort" in given and EFFORT not in self._quantities:
            raise Refused("Trajectories with effort need a controller with the command interface effort.")
        return Waypoint(nanoseconds(point["time_from_start"]), *(point[field] for field in FIELDS))

    def _check_end(self, message: Message, asked: list[str], last: Waypoint) -> None:
        """Raise Refused when the trajectory ends in motion, or has ended already."""
        for name, velocity in zip(asked, last.velocities, strict=False):
            if abs(velocity) > _ROUNDING and not self._allows_moving_end:
                hint = f"{NONZERO_END.name} accepts that"
                raise Refused(f"Velocity of last trajectory point of joint {name} is not zero: {velocity:g}; {hint}.")
        stamp_ns = nanoseconds(message["header"]["stamp"])
        if stamp_ns and stamp_ns + last.time_ns < self._node.now_ns():
            times = (
                f"start time ({to_seconds(stamp_ns):f}) that ends in the past ({to_seconds(stamp_ns + last.time_ns):f})"
            )
            raise Refused(f"Received trajectory with non-zero {times}.")


def _gains_of(values: dict[str, Any], name: str) -> Ros2Gains:
    """The gains of a joint, by the names of their parameters. One of a wrong type counts as not set."""
    found: dict[str, Any] = {}
    for parameter, field in GAINS.items():
        value = parameter.kind.convert(values.get(parameter.name.replace("<joint>", name)))
        found[field] = parameter.default if value is None else value
    return Ros2Gains(**found)


def _tolerance(asked: float, default: float, what: str) -> float:
    """The tolerance that a goal asks for; 0 checks nothing. Raises _WrongTolerance."""
    if asked > 0.0:
        return asked
    if asked == _DEFAULT:
        return default
    if abs(asked - _UNCHECKED) <= _ROUNDING:
        return 0.0
    raise _WrongTolerance(f"{what} is {asked:g}, and must be above 0, 0 or -1")


def _point(state: Waypoint, time_ns: int = 0) -> Message:
    """trajectory_msgs/JointTrajectoryPoint of a state."""
    return {**{field: getattr(state, field) for field in FIELDS}, "time_from_start": to_stamp(time_ns)}


def _result(code: int, text: str) -> Message:
    """control_msgs/FollowJointTrajectoryResult."""
    return {"error_code": code, "error_string": text}
