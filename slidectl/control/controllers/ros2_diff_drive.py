"""Drives a base by the wheels of its two sides, after ros2_controllers' diff_drive_controller.

Commands are velocities of the base (geometry_msgs/TwistStamped on `~/cmd_vel`). They are limited, and end after a
time-out, through the limits. Nothing is commanded and published before the first command or the time-out. The distance
that the wheels have travelled is published as odometry, with each update. Lengths are in m, angles in rad.

Topics `~/cmd_vel`, `~/odom`, `/tf`, and if enabled `~/cmd_vel_out`; service `~/set_odometry`.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, isfinite, isnan, nan, sin
from typing import ClassVar

from slidectl.control import params
from slidectl.control.controller_interface import Controller
from slidectl.control.duration import header_of
from slidectl.control.hardware_interface import VelocityJointInterface
from slidectl.control.mobile_base import (
    ODOM_TF,
    OPEN_LOOP,
    TIMEOUT,
    WINDOW,
    OdometryPublisher,
    RollingMean,
    twist_of,
    window_of,
)
from slidectl.control.node_handle import Message, NodeHandle, ParameterChange, publish_if_wanted
from slidectl.control.params import BOOLEAN, NUMBER, TEXTS, Parameter, within
from slidectl.control.registry import ros2_controller
from slidectl.control.ros2_base import (
    DIAGONALS,
    FRAMES,
    LIMITS_OF_AXIS,
    PoseRequest,
    StampedCommands,
    VelocityLimiter,
    check_limits,
    frames_of,
)
from slidectl.control.ros2_controller import UPDATE_RATE, LogThrottle, Ros2Controller, fixed
from slidectl.errors import Refused

AXES = ("linear/x", "angular/z")
LEFT, RIGHT = fixed(
    Parameter("left_wheel_names", TEXTS, "the joints of the left wheels", required=True, names_joints=True),
    Parameter(
        "right_wheel_names", TEXTS, "the joints of the right wheels, the same number", required=True, names_joints=True
    ),
)
LENGTHS = fixed(
    Parameter("wheel_separation", NUMBER, "distance of the sides, above 0", "m", required=True),
    Parameter("wheel_radius", NUMBER, "of all wheels, above 0", "m", required=True),
)
MULTIPLIERS = fixed(
    Parameter("wheel_separation_multiplier", NUMBER, "corrects the separation", default=1.0),
    Parameter("left_wheel_radius_multiplier", NUMBER, "corrects the left radius", default=1.0),
    Parameter("right_wheel_radius_multiplier", NUMBER, "corrects the right radius", default=1.0),
)
IS_OPEN_LOOP, USES_POSITIONS, MEAN_WINDOW = fixed(
    OPEN_LOOP,
    Parameter(
        "position_feedback",
        BOOLEAN,
        "the odometry uses the positions of the wheels, not their velocities",
        default=True,
    ),
    WINDOW,
)
TF_ENABLED = replace(ODOM_TF, live=True)
COMMAND_TIMEOUT = replace(TIMEOUT, meaning="age at which a command ends, from its stamp; 0: never", live=True)
PUBLISHES_LIMITED = Parameter(
    "publish_limited_velocity", BOOLEAN, "publishes the limited command on cmd_vel_out", default=False
)


class WheelOdometry:
    """The pose of a base, integrated from the velocities of its sides: x and y in m, heading in rad."""

    def __init__(self, window: int) -> None:
        """`window` is the size of the rolling means of the velocities."""
        self._window = window
        self.reset()

    def reset(self) -> None:
        """Set the pose to the origin, and the last positions of the wheels to 0."""
        self.left = self.right = 0.0
        """The last mean positions of the sides, rad."""
        self.place(0.0, 0.0, 0.0)

    def place(self, x: float, y: float, heading: float) -> None:
        """Set the pose, and clear the means of the velocities."""
        self.x, self.y, self.heading = x, y, heading
        self.linear = self.angular = 0.0
        """The velocities to publish, m/s and rad/s."""
        self._means = RollingMean(self._window), RollingMean(self._window)

    def travel(self, linear: float, angular: float, period_s: float) -> None:
        """Add a motion with these velocities."""
        way, turn = linear * period_s, angular * period_s
        old, new = self.heading, self.heading + turn
        if abs(turn) < 1e-6:
            self.x += way * cos(old)
            self.y += way * sin(old)
        else:
            self.x += way / turn * (sin(new) - sin(old))
            self.y -= way / turn * (cos(new) - cos(old))
        self.heading = new
        self.linear, self.angular = linear, angular

    def average(self) -> None:
        """Replace the velocities by their means over the last motions."""
        for mean, value in zip(self._means, (self.linear, self.angular), strict=True):
            mean.add(value)
        self.linear, self.angular = (mean.mean for mean in self._means)


@ros2_controller("diff_drive_controller/DiffDriveController")
class Ros2DiffDriveController(Ros2Controller, Controller[VelocityJointInterface]):
    """velocity of a wheel = (linear ∓ angular · separation / 2) / radius."""

    interface_type = VelocityJointInterface
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(UPDATE_RATE, LEFT, RIGHT, *LENGTHS, *MULTIPLIERS, IS_OPEN_LOOP, USES_POSITIONS, MEAN_WINDOW),
        *(COMMAND_TIMEOUT, PUBLISHES_LIMITED, *FRAMES, TF_ENABLED, *DIAGONALS),
        *(limit for axis in AXES for limit in within(axis, LIMITS_OF_AXIS)),
    )

    # Init.

    def init_in_root(self, interface: VelocityJointInterface, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter or a joint is missing or wrong."""
        left, right = (params.value_of(node, side) for side in (LEFT, RIGHT))
        for parameter, wheels in ((LEFT, left), (RIGHT, right)):
            if not wheels:
                raise Refused(f"parameter {node.namespace}/{parameter.name} must name at least one joint")
        if len(left) != len(right):
            raise Refused(f"{node.namespace} has {len(left)} left wheels and {len(right)} right wheels")
        separation, radius = (_length(node, parameter) for parameter in LENGTHS)
        corrections = [_length(node, parameter) for parameter in MULTIPLIERS]
        self._width, self._left_radius, self._right_radius = (
            length * factor for length, factor in zip((separation, radius, radius), corrections, strict=True)
        )
        self._is_open_loop: bool = params.value_of(node, IS_OPEN_LOOP)
        self._uses_positions: bool = params.value_of(node, USES_POSITIONS)
        self.odometry = WheelOdometry(window_of(node))
        self.limiters = [VelocityLimiter(node, axis) for axis in AXES]
        covariances = [params.value_of(node, diagonal) for diagonal in DIAGONALS]
        has_tf: bool = params.value_of(node, TF_ENABLED)
        self._topics = OdometryPublisher(node, frames_of(node, root.namespace), has_tf, covariances)
        publishes_limited = params.value_of(node, PUBLISHES_LIMITED)
        self._limited = node.advertise("cmd_vel_out", "geometry_msgs/TwistStamped") if publishes_limited else None
        self._left, self._right = ([interface.get_handle(name) for name in side] for side in (left, right))
        self.updated_ns = 0
        self._warnings = LogThrottle(node)
        self._pose = PoseRequest(self, node)
        node.guard_params(self._judge)
        node.watch_param(node.namespace, self._parameters_changed)
        self._commands = StampedCommands(self, node, "cmd_vel", _velocities, params.value_of(node, COMMAND_TIMEOUT))
        self._forget_command(node.now_ns())

    def _judge(self, change: ParameterChange) -> None:
        """Refuse limits of a wrong sign."""
        for axis in AXES if isinstance(change.after, dict) else ():
            check_limits(self._node, axis, change.after)

    def _parameters_changed(self) -> None:
        self._commands.timeout_s = params.value_of(self._node, COMMAND_TIMEOUT)
        self._topics.has_tf = params.value_of(self._node, TF_ENABLED)
        for limiter in self.limiters:
            limiter.read()

    # The cycle.

    def starting(self, time_ns: int) -> None:
        """The odometry continues from before the stop, unless time was reset."""
        super().starting(time_ns)
        if time_ns < self.updated_ns:
            self.odometry.reset()
            self._forget_command(time_ns)
        self.updated_ns = time_ns

    def stopping(self, time_ns: int) -> None:
        self._rest(time_ns)

    def aborting(self, time_ns: int) -> None:
        self._rest(time_ns)

    def _rest(self, time_ns: int) -> None:
        self._forget_command(time_ns)
        self._command_wheels(0.0, 0.0)

    def _forget_command(self, time_ns: int) -> None:
        """Forget the command, and the velocities so far. The time-out counts from this time."""
        self.references = [nan, nan]
        """The wanted linear and angular velocity, m/s and rad/s; nan: there is no command yet."""
        self._commands.forget(time_ns)
        self._pose.forget()
        for limiter in self.limiters:
            limiter.forget()

    def cycle(self, time_ns: int, period_s: float) -> None:
        """Raises Refused: the position or velocity of a wheel is not a number."""
        self.updated_ns = time_ns
        self._take_command(time_ns)
        if not all(map(isfinite, self.references)):
            return
        linear, angular = (
            limiter.follow(wanted, period_s) for limiter, wanted in zip(self.limiters, self.references, strict=True)
        )
        pose = self._pose.take()
        if pose is not None:
            self.odometry.place(*pose)
        elif period_s >= 1e-6:
            self._measure(linear, angular, period_s)
        self._publish(time_ns, linear, angular)
        half = angular * self._width / 2.0
        self._command_wheels((linear - half) / self._left_radius, (linear + half) / self._right_radius)

    def _take_command(self, time_ns: int) -> None:
        commands = self._commands
        if commands.has_timed_out(time_ns):
            if commands.numbers is not None and any(self.references):
                text = f"the command on cmd_vel is older than {commands.timeout_s:g} s: the base stops"
                self._warnings.log("warn", f"{self._node.namespace}: {text}")
            self.references = [0.0, 0.0]
        elif commands.numbers is not None:
            self.references = list(commands.numbers)

    def _measure(self, linear: float, angular: float, period_s: float) -> None:
        """Update the odometry: by the wheels, or in open loop by the limited command."""
        odometry = self.odometry
        if self._is_open_loop:
            odometry.travel(linear, angular, period_s)
            return
        sides = self._left, self._right
        if self._uses_positions:
            left, right = (_mean([wheel.position for wheel in side]) for side in sides)
            last_left, last_right, odometry.left, odometry.right = odometry.left, odometry.right, left, right
            left, right = (left - last_left) / period_s, (right - last_right) / period_s
        else:
            left, right = (_mean([wheel.velocity for wheel in side]) for side in sides)
        if isnan(left) or isnan(right):
            raise Refused("the state of a wheel is not a number")
        left, right = left * self._left_radius, right * self._right_radius
        odometry.travel((left + right) / 2.0, (right - left) / self._width, period_s)
        odometry.average()

    def _publish(self, time_ns: int, linear: float, angular: float) -> None:
        odometry = self.odometry
        self._topics.messages += 1
        place = odometry.x, odometry.y, odometry.heading
        self._topics.publish(time_ns, place, (odometry.linear, 0.0, odometry.angular))
        if self._limited is not None:
            publish_if_wanted(
                self._limited, lambda: {"header": header_of(time_ns), "twist": twist_of(linear, 0.0, angular)}
            )

    def _command_wheels(self, left: float, right: float) -> None:
        """Command these velocities, rad/s."""
        for joint in self._left:
            joint.command = left
        for joint in self._right:
            joint.command = right


def _velocities(twist: Message) -> tuple[float, float]:
    return twist["linear"]["x"], twist["angular"]["z"]


def _length(node: NodeHandle, parameter: Parameter) -> float:
    """The value, which must be above 0 for a length and not 0 for a factor. Raises SlidectlError."""
    value: float = params.value_of(node, parameter)
    if not isfinite(value) or value == 0.0 or (parameter in LENGTHS and value < 0.0):
        wanted = "a length above 0" if parameter in LENGTHS else "a number other than 0"
        raise Refused(f"parameter {node.namespace}/{parameter.name} must be {wanted}, not {value:g}")
    return value


def _mean(values: list[float]) -> float:
    total = 0.0  # not `sum`: newer versions of Python compensate its rounding
    for value in values:
        total += value
    return total / len(values)
