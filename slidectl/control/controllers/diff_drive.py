"""Drives a base by the wheels of its two sides, after ros_controllers' diff_drive_controller.

Commands are velocities of the base (geometry_msgs/Twist on `cmd_vel`); they are limited, and end after a time-out. The
distance that the wheels have travelled is published as odometry on `odom` and `/tf`. Lengths are in m, angles in rad.

Topics `cmd_vel`, `odom`, `/tf`, and if enabled `cmd_vel_out` and `wheel_joint_controller_state`; service
`set_parameters`.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from math import isfinite, isnan, nan, sqrt
from typing import Any, ClassVar

from slidectl.control import params
from slidectl.control.controller_interface import Compiled, Controller, Member, Parts
from slidectl.control.duration import from_seconds, header_of, to_seconds, to_stamp
from slidectl.control.goals import checked_period
from slidectl.control.hardware_interface import JointHandle, VelocityJointInterface
from slidectl.control.laws import Columns, LawTables, law
from slidectl.control.mobile_base import (
    ALLOWS_MANY,
    COVARIANCES,
    LIMIT_NUMBERS,
    LIMITS,
    ODOM_FRAME,
    ODOM_TF,
    OF_BASE,
    OPEN_LOOP,
    PUBLISH_RATE,
    BaseController,
    LimitedVelocity,
    Odometry,
    OdometryTopics,
    check_lengths,
    follow_velocity,
    odometry_is_due,
    travel,
    twist_of,
    velocity_commands,
    wheel_radius,
    window_of,
)
from slidectl.control.node_handle import NodeHandle, ParameterChange, publish_if_wanted
from slidectl.control.params import BOOLEAN, NUMBER, Kind, Parameter, as_number, as_texts
from slidectl.control.reconfigure import Option, ReconfigureServer, Values
from slidectl.control.registry import controller
from slidectl.control.robot_description import find_joint, robot_of_model
from slidectl.description.robot import Cylinder, Sphere
from slidectl.errors import Refused
from slidectl.rotations import subtract

WHEELS = Kind("a string or a list of strings", lambda value: [value] if isinstance(value, str) else as_texts(value))

MULTIPLIERS = ("left_wheel_radius_multiplier", "right_wheel_radius_multiplier", "wheel_separation_multiplier")
OPTIONS = (
    Option(MULTIPLIERS[0], "Left wheel radius multiplier.", 1.0, 0.5, 1.5),
    Option(MULTIPLIERS[1], "Right wheel radius multiplier.", 1.0, 0.5, 1.5),
    Option(MULTIPLIERS[2], "Wheel separation multiplier.", 1.0, 0.5, 1.5),
    Option("publish_rate", "Publish rate of odom.", 50.0, 0.0, 2000.0),
    Option("enable_odom_tf", "Publish odom frame to tf.", True),
)
"""The values that dynamic_reconfigure changes."""


class SidesOdometry(Odometry):
    """Odometry from the travelled distances of the wheels on the two sides."""

    def __init__(self, window: int) -> None:
        super().__init__(window)
        self.left = self.right = 0.0

    def forget(self) -> None:
        super().forget()
        self.left = self.right = 0.0


@law
def roll(odometry: Any, past: Any, left: float, right: float, separation: float, time_ns: int) -> None:
    """Update from the total travelled distances of the sides, in m. `odometry` is a SidesOdometry, or its row."""
    left_change, right_change = left - odometry.left, right - odometry.right
    odometry.left, odometry.right = left, right
    travel(odometry, past, (right_change + left_change) * 0.5, (right_change - left_change) / separation, time_ns)


@law
def wheel_velocities(base: Any, linear: float, angular: float) -> tuple[float, float]:
    """The velocities of the left and the right wheels, rad/s, at these velocities of the base."""
    left = (linear - angular * base.width / 2.0) / base.left_radius
    return left, (linear + angular * base.width / 2.0) / base.right_radius


@law
def side_positions(tables: LawTables) -> tuple[float, float]:
    """The mean positions of the left and of the right wheels, in rad."""
    count = len(tables.members) // 2
    left = right = 0.0
    for k in range(count):
        left += tables.joints[tables.members[k].joint].position
        right += tables.joints[tables.members[count + k].joint].position
    return left / count, right / count


@law
def drive(base: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
    """The update on rows. The numbers are the limits, followed by the past velocities of the odometry."""
    base.updated_ns = time_ns
    left, right = side_positions(tables)
    if isnan(left) or isnan(right):
        return False
    past = tables.numbers[2 * LIMIT_NUMBERS :]
    roll(base, past, left * base.left_radius, right * base.right_radius, base.width, time_ns)
    linear, angular = base.wanted_linear, base.wanted_angular
    if to_seconds(time_ns - base.received_ns) > base.timeout_s:
        linear = angular = 0.0
    follow_velocity(base, tables.numbers, linear, angular, period_s)
    left, right = wheel_velocities(base, base.last_linear, base.last_angular)
    for k in range(len(tables.members) // 2):
        tables.joints[tables.members[k].joint].command = left
    for k in range(len(tables.members) // 2, len(tables.members)):
        tables.joints[tables.members[k].joint].command = right
    return odometry_is_due(base, time_ns) and base.wanted != 0


DRIVE = Columns(
    changing="updated_ns odometry.x odometry.y odometry.heading odometry.linear odometry.angular odometry.left "
    "odometry.right odometry.measured_ns odometry.count odometry.linear_mean odometry.angular_mean "
    "velocity.last_linear velocity.last_angular velocity.before_linear velocity.before_angular "
    "topics.published_ns topics.messages",
    fixed="odometry.window topics.period_ns commands.received_ns commands.timeout_s wanted_linear wanted_angular "
    "left_radius right_radius width",
    whole="updated_ns odometry.measured_ns odometry.count odometry.window topics.published_ns topics.messages "
    "topics.period_ns commands.received_ns",
)


@controller("diff_drive_controller/DiffDriveController")
class DiffDriveController(BaseController, Controller[VelocityJointInterface]):
    """velocity of a wheel = (linear ∓ angular · separation / 2) / radius."""

    interface_type = VelocityJointInterface
    compiled = Compiled(drive, DRIVE)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("left_wheel", WHEELS, "the joints of the left wheels", required=True, names_joints=True),
        Parameter(
            "right_wheel", WHEELS, "the joints of the right wheels, the same number", required=True, names_joints=True
        ),
        Parameter("wheel_separation", NUMBER, "distance of the sides; by default that in the model", "m"),
        Parameter("wheel_radius", NUMBER, "of all wheels; by default that of the first left one in the model", "m"),
        Parameter("wheel_separation_multiplier", NUMBER, "corrects the separation", default=1.0, live=True),
        Parameter("wheel_radius_multiplier", NUMBER, "corrects both radii; overrides those of the sides"),
        Parameter("left_wheel_radius_multiplier", NUMBER, "corrects the left radius", default=1.0, live=True),
        Parameter("right_wheel_radius_multiplier", NUMBER, "corrects the right radius", default=1.0, live=True),
        replace(PUBLISH_RATE, live=True),
        *OF_BASE,
        replace(ODOM_TF, live=True),
        *LIMITS,
        Parameter("publish_cmd", BOOLEAN, "publishes the limited command on cmd_vel_out", default=False),
        Parameter(
            "publish_wheel_joint_controller_state",
            BOOLEAN,
            "publishes the states of the wheels on wheel_joint_controller_state",
            default=False,
        ),
        *COVARIANCES,
    )

    # Init.

    def init_in_root(self, interface: VelocityJointInterface, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint, or a required part of the description is missing or wrong."""
        self._node = node
        left, right = (params.needed(node, side, WHEELS) for side in ("left_wheel", "right_wheel"))
        for side, wheels in (("left_wheel", left), ("right_wheel", right)):
            if not wheels:
                raise Refused(f"parameter {node.namespace}/{side} must name at least one joint")
        if len(left) != len(right):
            raise Refused(f"{node.namespace} has {len(left)} left wheels and {len(right)} right wheels")
        self._is_open_loop: bool = params.value_of(node, OPEN_LOOP)
        self.odometry = SidesOdometry(window_of(node))
        self.velocity = LimitedVelocity(node)
        self._numbers = array("d", [*self.velocity.limits, *self.odometry.past])
        self.odometry.past = memoryview(self._numbers)[2 * LIMIT_NUMBERS :]
        self._separation, self._radius = self._geometry(root, node, left[0], right[0])
        self.topics = OdometryTopics(node, params.value_of(node, ODOM_FRAME))
        self._left = [interface.get_handle(name) for name in left]
        self._right = [interface.get_handle(name) for name in right]
        self._joints = (*self._left, *self._right)
        self._values = self._first_values(node)
        self._apply_values(self._values)
        self._is_writing = False
        wants_cmd = params.read(node, "publish_cmd", BOOLEAN)
        self._cmd = node.advertise("cmd_vel_out", "geometry_msgs/TwistStamped") if wants_cmd else None
        wants_state = params.read(node, "publish_wheel_joint_controller_state", BOOLEAN)
        self._wheel_state = WheelState(node, self._left, self._right) if wants_state else None
        self._server = ReconfigureServer(node, OPTIONS, lambda: dict(self._values), self._change_values)
        self._change_values(self._values)
        node.guard_params(self._judge)
        node.watch_param(node.namespace, self._parameters_changed)
        self.commands = velocity_commands(self, node, None if params.value_of(node, ALLOWS_MANY) else self._brake)
        self._commands = (self.commands,)

    def _geometry(self, root: NodeHandle, node: NodeHandle, left: str, right: str) -> tuple[float, float]:
        """Separation and radius, m: from the parameters, else from the description in the robot's namespace."""
        separation, radius = params.read(node, "wheel_separation", NUMBER), params.read(node, "wheel_radius", NUMBER)
        if separation is None or radius is None:
            robot = robot_of_model(root)
            one, other = find_joint(robot, left), find_joint(robot, right)
            if separation is None:
                x, y, z = subtract(one.origin.xyz, other.origin.xyz)
                separation = sqrt(x * x + y * y + z * z)
            if radius is None:
                radius = wheel_radius(node, robot, one, (Cylinder, Sphere))
        check_lengths(node, wheel_separation=separation, wheel_radius=radius)
        return separation, radius

    # Values that change while it is loaded.

    def _first_values(self, node: NodeHandle) -> Values:
        declared = {parameter.name: parameter for parameter in self.parameters}
        changing = (*MULTIPLIERS, PUBLISH_RATE.name, ODOM_TF.name)
        values: Values = {name: params.value_of(node, declared[name]) for name in changing}
        both = params.read(node, "wheel_radius_multiplier", NUMBER)
        if both is not None:
            values |= dict.fromkeys(MULTIPLIERS[:2], both)
        self._check_values(values)
        return values

    def _check_values(self, values: Values) -> None:
        """Raises Refused: a multiplier is 0 or not finite, or the rate is not valid."""
        for name in MULTIPLIERS:
            if name in values and (values[name] == 0.0 or not isfinite(values[name])):
                raise Refused(f"{self._node.namespace}/{name} must be a number other than {values[name]:g}")
        checked_period(self._node, PUBLISH_RATE.name, values.get(PUBLISH_RATE.name, 1.0))

    def _apply_values(self, values: Values) -> None:
        """Use these values from the next update on."""
        self.topics.period_ns = from_seconds(1.0 / values["publish_rate"])
        self._values = dict(values)
        left, right, separation = (values[name] for name in MULTIPLIERS)
        self.left_radius, self.right_radius = left * self._radius, right * self._radius
        self.width = separation * self._separation
        self.topics.has_tf = bool(values["enable_odom_tf"])

    def _change_values(self, values: Values) -> None:
        """Use these values, write them to the parameters, and publish them. Raises Refused."""
        self._check_values(values)
        self._apply_values(values)
        self._is_writing = True
        try:
            for name, value in values.items():
                if self._node.get_param(name, None) != value:
                    self._node.set_param(name, value)
        finally:
            self._is_writing = False
        self._server.publish()

    def _judge(self, change: ParameterChange) -> None:
        """Refuse a change of the parameters to values that cannot be used."""
        after = change.after if isinstance(change.after, dict) and not self._is_writing else {}
        given = {name: as_number(after.get(name)) for name in (*MULTIPLIERS, "publish_rate")}
        self._check_values({name: value for name, value in given.items() if value is not None})

    def _parameters_changed(self) -> None:
        """Use the changed parameters. A value whose parameter is missing stays."""
        if self._is_writing:
            return
        numbers = {name: params.read(self._node, name, NUMBER) for name in (*MULTIPLIERS, "publish_rate")}
        given: dict[str, Any] = numbers | {"enable_odom_tf": params.read(self._node, "enable_odom_tf", BOOLEAN)}
        values = self._values | {name: value for name, value in given.items() if value is not None}
        if values != self._values:
            self._change_values(values)

    # The cycle.

    def starting(self, time_ns: int) -> None:
        super().starting(time_ns)
        if self._wheel_state is not None:
            self._wheel_state.time_ns = time_ns

    def update(self, time_ns: int, period_s: float) -> None:
        self.updated_ns = time_ns
        if self._is_open_loop:
            self.odometry.travel_at(self.velocity, time_ns)
        else:
            left, right = _mean_position(self._left), _mean_position(self._right)
            if isnan(left) or isnan(right):
                return
            left, right = left * self.left_radius, right * self.right_radius
            roll(self.odometry, self.odometry.past, left, right, self.width, time_ns)
        linear, angular = self.commands.at(time_ns)
        self.velocity.follow(linear, angular, period_s)
        linear, angular = self.velocity.last_linear, self.velocity.last_angular
        if self._cmd is not None:
            publish_if_wanted(
                self._cmd, lambda: {"header": header_of(time_ns), "twist": twist_of(linear, 0.0, angular)}
            )
        left_velocity, right_velocity = wheel_velocities(self, linear, angular)
        for joint in self._left:
            joint.command = left_velocity
        for joint in self._right:
            joint.command = right_velocity
        if self._wheel_state is not None:
            self._wheel_state.update(time_ns, period_s, left_velocity, right_velocity)
        if odometry_is_due(self.topics, time_ns):
            self.publish(time_ns, period_s)

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the odometry."""
        odometry = self.odometry
        place = odometry.x, odometry.y, odometry.heading
        self.topics.publish(time_ns, place, (odometry.linear, 0.0, odometry.angular))

    @property
    def wanted_linear(self) -> float:
        """The linear velocity of the last command, m/s."""
        return self.commands.numbers[0]

    @property
    def wanted_angular(self) -> float:
        """The angular velocity of the last command, rad/s."""
        return self.commands.numbers[1]

    def parts(self) -> Parts | None:
        """The parts of the compiled form; None when it publishes in each update, or is open loop."""
        if self._is_open_loop or self._cmd is not None or self._wheel_state is not None:
            return None
        wheels = [Member(None, joint) for joint in self._joints]
        return Parts(self.topics.publishers, members=wheels, numbers=self._numbers)

    def check_restored(self) -> None:
        past, window = self.odometry.past, self.odometry.window
        if not window >= 1 or not 2 * window == len(past) == len(self._numbers) - 2 * LIMIT_NUMBERS:
            raise Refused(f"the odometry has a window of {window}, and its past {len(past)} numbers")


class WheelState:
    """Publishes desired and actual states of all wheels in each cycle: the left ones, then the right ones."""

    def __init__(self, node: NodeHandle, left: list[JointHandle], right: list[JointHandle]) -> None:
        self.time_ns = 0
        """Time of the last update, or of the start."""
        self._joints = [*left, *right]
        self._left_count = len(left)
        self._positions = [0.0] * len(self._joints)
        self._velocities = [0.0] * len(self._joints)
        self._desired = (0.0, 0.0)
        self._publisher = node.advertise("wheel_joint_controller_state", "control_msgs/JointTrajectoryControllerState")

    def update(self, time_ns: int, period_s: float, left: float, right: float) -> None:
        """Publish the states. `left` and `right` are the commanded velocities, rad/s."""
        count, joints = self._left_count, self._joints
        velocities = [left] * count + [right] * (len(joints) - count)
        self._positions = [p + v * period_s for p, v in zip(self._positions, velocities, strict=True)]
        # As upstream: the change times the period, instead of divided by it, and for the first wheel of each side only.
        changes = [(new - old) * period_s for new, old in zip((left, right), self._desired, strict=True)]
        self._desired = left, right
        accelerations = [0.0] * len(joints)
        accelerations[0], accelerations[count] = changes
        elapsed_s = to_seconds(time_ns - self.time_ns)
        self.time_ns = time_ns
        actual = {
            "positions": [joint.position for joint in joints],
            "velocities": [joint.velocity for joint in joints],
            "accelerations": [
                (joint.velocity - old) / elapsed_s if elapsed_s else nan
                for joint, old in zip(joints, self._velocities, strict=True)
            ],
            "effort": [joint.effort for joint in joints],
        }
        self._velocities = actual["velocities"]
        desired = {
            "positions": self._positions,
            "velocities": velocities,
            "accelerations": accelerations,
            "effort": [nan] * len(joints),
        }
        error = {
            name: [one - other for one, other in zip(values, actual[name], strict=True)]
            for name, values in desired.items()
        }
        start = {"time_from_start": to_stamp(0)}
        publish_if_wanted(
            self._publisher,
            lambda: {
                "header": header_of(time_ns),
                "joint_names": [joint.name for joint in joints],
                "desired": desired | start,
                "actual": actual | start,
                "error": error | start,
            },
        )


def _mean_position(joints: list[JointHandle]) -> float:
    total = 0.0  # not `sum`: newer versions of Python compensate its rounding
    for joint in joints:
        total += joint.position
    return total / len(joints)
