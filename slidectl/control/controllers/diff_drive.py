"""Drives a base by the wheels of its two sides, after ros_controllers' diff_drive_controller.

Commands are velocities of the base (geometry_msgs/Twist on `cmd_vel`); they are limited, and end after a time-out. The
way that the wheels have made is told as odometry on `odom` and `/tf`. Lengths are in m, angles in rad.

Topics `cmd_vel`, `odom`, `/tf`, and when asked for `cmd_vel_out` and `wheel_joint_controller_state`; service
`set_parameters`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import cos, inf, isfinite, isnan, nan, sin, sqrt
from typing import Any, ClassVar

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import Controller, State
from slidectl.control.duration import from_seconds, to_seconds, to_stamp
from slidectl.control.goals import period_of
from slidectl.control.hardware_interface import JointHandle, VelocityJointInterface
from slidectl.control.node_handle import Message, NodeHandle, ParameterChange, Publisher
from slidectl.control.params import BOOLEAN, INTEGER, NUMBER, TEXT, Kind, Parameter, as_number, as_texts, within
from slidectl.control.reconfigure import Option, ReconfigureServer, Values
from slidectl.control.registry import controller
from slidectl.control.robot_description import find_joint, robot_on_paper
from slidectl.description.robot import Cylinder, Sphere
from slidectl.errors import MessageRefused, Refused

WHEELS = Kind("a string or a list of strings", lambda value: [value] if isinstance(value, str) else as_texts(value))
DIAGONAL = Kind(
    "a list of six floats, as 0.001",
    lambda value: value if isinstance(value, list) and [type(item) for item in value] == [float] * 6 else None,
)

PUBLISH_RATE = Parameter(
    "publish_rate", NUMBER, "odometry messages per simulated second", "1/s", default=50.0, live=True
)
MULTIPLIERS = ("left_wheel_radius_multiplier", "right_wheel_radius_multiplier", "wheel_separation_multiplier")
OPTIONS = (
    Option(MULTIPLIERS[0], "Left wheel radius multiplier.", 1.0, 0.5, 1.5),
    Option(MULTIPLIERS[1], "Right wheel radius multiplier.", 1.0, 0.5, 1.5),
    Option(MULTIPLIERS[2], "Wheel separation multiplier.", 1.0, 0.5, 1.5),
    Option("publish_rate", "Publish rate of odom.", 50.0, 0.0, 2000.0),
    Option("enable_odom_tf", "Publish odom frame to tf.", True),
)
"""What dynamic_reconfigure changes."""
LIMITS = (
    Parameter("has_velocity_limits", BOOLEAN, "min_velocity and max_velocity count", default=False),
    Parameter("has_acceleration_limits", BOOLEAN, "min_acceleration and max_acceleration count", default=False),
    Parameter("has_jerk_limits", BOOLEAN, "min_jerk and max_jerk count", default=False),
    Parameter("max_velocity", NUMBER, "largest velocity", "m/s or rad/s", default=0.0),
    Parameter("min_velocity", NUMBER, "least velocity; by default the largest one backwards", "m/s or rad/s"),
    Parameter("max_acceleration", NUMBER, "largest acceleration", "m/s² or rad/s²", default=0.0),
    Parameter("min_acceleration", NUMBER, "least one; by default the largest one backwards", "m/s² or rad/s²"),
    Parameter("max_jerk", NUMBER, "largest jerk", "m/s³ or rad/s³", default=0.0),
    Parameter("min_jerk", NUMBER, "least jerk; by default the largest one backwards", "m/s³ or rad/s³"),
)


class SpeedLimiter:
    """Bounds a velocity, its change in a period, and the change of that, after speed_limiter.cpp."""

    def __init__(self, node: NodeHandle, where: str) -> None:
        """Read the parameters of the namespace `where`."""
        self._velocity = _bounds(node, where, "velocity")
        self._acceleration = _bounds(node, where, "acceleration")
        self._jerk = _bounds(node, where, "jerk")

    def limit(self, wanted: float, last: float, before: float, period_s: float) -> float:
        """The velocity that follows `last` and the one `before` it, when this one is wanted."""
        if self._jerk is not None:
            least, most = self._jerk
            change, scale = last - before, 2.0 * period_s * period_s
            wanted = last + change + _clamp(wanted - last - change, least * scale, most * scale)
        if self._acceleration is not None:
            least, most = self._acceleration
            wanted = last + _clamp(wanted - last, least * period_s, most * period_s)
        return wanted if self._velocity is None else _clamp(wanted, *self._velocity)


def _bounds(node: NodeHandle, where: str, what: str) -> tuple[float, float] | None:
    has = params.boolean(node, f"{where}/has_{what}_limits")
    most, least = params.number(node, f"{where}/max_{what}"), params.number(node, f"{where}/min_{what}")
    if not has:
        return None
    if most is None:
        place = names.join(node.namespace, where)
        node.log("warn", f"{place}/has_{what}_limits is true without max_{what}, which is 0 then")
        most = 0.0
    return -most if least is None else least, most


def _clamp(value: float, least: float, most: float) -> float:
    return min(max(least, value), most)


class RollingMean:
    """The mean of the last values, computed as boost's accumulator does: the same bits."""

    def __init__(self, size: int) -> None:
        self._values: deque[float] = deque()
        self._size = size
        self.mean = 0.0

    def add(self, value: float) -> None:
        """One more value; the oldest leaves when there are more than `size`."""
        self._values.append(value)
        if len(self._values) > self._size:
            self.mean += (value - self._values.popleft()) / self._size
        else:
            self.mean += (value - self.mean) / len(self._values)


class Odometry:
    """Where the base is by its wheels: x and y in m, heading in rad, velocities in m/s and rad/s."""

    def __init__(self, window: int) -> None:
        self.x = self.y = self.heading = self.linear = self.angular = 0.0
        self._window = window
        self._left = self._right = 0.0
        self.start(0)

    def start(self, time_ns: int) -> None:
        """Begin with the velocities anew. The place stays."""
        self._time_ns = time_ns
        self._linear, self._angular = RollingMean(self._window), RollingMean(self._window)

    def update(self, left: float, right: float, separation: float, time_ns: int) -> None:
        """The two sides have made these ways, in m, since the beginning."""
        left_change, right_change = left - self._left, right - self._right
        self._left, self._right = left, right
        linear = (right_change + left_change) * 0.5
        angular = (right_change - left_change) / separation
        self._integrate(linear, angular)
        period_s = to_seconds(time_ns - self._time_ns)
        if period_s < 0.0001:  # too short for a velocity
            return
        self._time_ns = time_ns
        self._linear.add(linear / period_s)
        self._angular.add(angular / period_s)
        self.linear, self.angular = self._linear.mean, self._angular.mean

    def update_open_loop(self, linear: float, angular: float, time_ns: int) -> None:
        """The base has had these velocities since the last time."""
        self.linear, self.angular = linear, angular
        period_s = to_seconds(time_ns - self._time_ns)
        self._time_ns = time_ns
        self._integrate(linear * period_s, angular * period_s)

    def _integrate(self, linear: float, angular: float) -> None:
        """Along a circle, or along a line where that is as good."""
        if abs(angular) < 1e-6:
            direction = self.heading + angular * 0.5
            self.x += linear * cos(direction)
            self.y += linear * sin(direction)
            self.heading += angular
        else:
            old, radius = self.heading, linear / angular
            self.heading += angular
            self.x += radius * (sin(self.heading) - sin(old))
            self.y += -radius * (cos(self.heading) - cos(old))


@dataclass(slots=True)
class BaseVelocity:
    """Of the base: m/s and rad/s."""

    linear: float = 0.0
    angular: float = 0.0


@controller("diff_drive_controller/DiffDriveController")
class DiffDriveController(Controller[VelocityJointInterface]):
    """velocity of a wheel = (linear ∓ angular · separation / 2) / radius."""

    interface_type = VelocityJointInterface
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("left_wheel", WHEELS, "the joints of the left wheels", required=True, names_joints=True),
        Parameter("right_wheel", WHEELS, "the joints of the right wheels, as many", required=True, names_joints=True),
        Parameter("wheel_separation", NUMBER, "distance of the sides; by default that in the model", "m"),
        Parameter("wheel_radius", NUMBER, "of all wheels; by default that of the first left one in the model", "m"),
        Parameter("wheel_separation_multiplier", NUMBER, "corrects the separation", default=1.0, live=True),
        Parameter("wheel_radius_multiplier", NUMBER, "corrects the radii; goes before those of the sides"),
        Parameter("left_wheel_radius_multiplier", NUMBER, "corrects the left radius", default=1.0, live=True),
        Parameter("right_wheel_radius_multiplier", NUMBER, "corrects the right radius", default=1.0, live=True),
        PUBLISH_RATE,
        Parameter("open_loop", BOOLEAN, "odometry is made of the commands, not of the wheels", default=False),
        Parameter("velocity_rolling_window_size", INTEGER, "updates in the mean of the velocities", default=10),
        Parameter("cmd_vel_timeout", NUMBER, "a command counts for so long", "s", default=0.5),
        Parameter("allow_multiple_cmd_vel_publishers", BOOLEAN, "several nodes may publish cmd_vel", default=True),
        Parameter("base_frame_id", TEXT, "the frame that moves", default="base_link"),
        Parameter("odom_frame_id", TEXT, "the frame that it moves in", default="odom"),
        Parameter("enable_odom_tf", BOOLEAN, "publishes the frame on /tf too", default=True, live=True),
        *within("linear/x", LIMITS),
        *within("angular/z", LIMITS),
        Parameter("publish_cmd", BOOLEAN, "publishes the limited command on cmd_vel_out", default=False),
        Parameter(
            "publish_wheel_joint_controller_state",
            BOOLEAN,
            "publishes what the wheels do on wheel_joint_controller_state",
            default=False,
        ),
        Parameter("pose_covariance_diagonal", DIAGONAL, "of the pose on odom", required=True),
        Parameter("twist_covariance_diagonal", DIAGONAL, "of the velocities on odom", required=True),
    )

    # Init.

    def init_in_root(self, interface: VelocityJointInterface, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint, or what the description is asked for is missing or wrong."""
        self._node = node
        left, right = (params.needed(node, side, WHEELS) for side in ("left_wheel", "right_wheel"))
        for side, wheels in (("left_wheel", left), ("right_wheel", right)):
            if not wheels:
                raise Refused(f"parameter {node.namespace}/{side} must name at least one joint")
        if len(left) != len(right):
            raise Refused(f"{node.namespace} has {len(left)} left wheels and {len(right)} right wheels")
        window = _or(params.integer(node, "velocity_rolling_window_size"), 10)
        if window < 1:
            raise Refused(f"parameter {node.namespace}/velocity_rolling_window_size must be at least 1, not {window}")
        self._is_open_loop = bool(params.boolean(node, "open_loop"))
        self._timeout_s = _or(params.number(node, "cmd_vel_timeout"), 0.5)
        self._allows_many = _or(params.boolean(node, "allow_multiple_cmd_vel_publishers"), True)
        self._base_frame = _or(params.text(node, "base_frame_id"), "base_link")
        self._odom_frame = _or(params.text(node, "odom_frame_id"), "odom")
        self._linear_limiter, self._angular_limiter = SpeedLimiter(node, "linear/x"), SpeedLimiter(node, "angular/z")
        self._separation, self._radius = self._geometry(root, node, left[0], right[0])
        self._pose_covariance = _matrix(params.needed(node, "pose_covariance_diagonal", DIAGONAL))
        self._twist_covariance = _matrix(params.needed(node, "twist_covariance_diagonal", DIAGONAL))
        self._left = [interface.get_handle(name) for name in left]
        self._right = [interface.get_handle(name) for name in right]
        self.odometry = Odometry(window)
        self.limited = BaseVelocity()
        """The last command after the limits."""
        self._before = BaseVelocity()
        """The one before it."""
        self._wanted = BaseVelocity()
        self._wanted_ns = self._published_ns = self._updated_ns = 0
        self._values = self._first_values(node)
        self._take_values(self._values)
        self._is_writing = False
        self._odom = node.advertise("odom", "nav_msgs/Odometry")
        self._tf = node.advertise("/tf", "tf2_msgs/TFMessage")
        wants_cmd = params.boolean(node, "publish_cmd")
        self._cmd = node.advertise("cmd_vel_out", "geometry_msgs/TwistStamped") if wants_cmd else None
        wants_state = params.boolean(node, "publish_wheel_joint_controller_state")
        self._wheel_state = WheelState(node, self._left, self._right) if wants_state else None
        self._server = ReconfigureServer(node, OPTIONS, lambda: dict(self._values), self._change_values)
        self._change_values(self._values)
        node.guard_params(self._judge)
        node.watch_param(node.namespace, self._parameters_changed)
        node.subscribe("cmd_vel", "geometry_msgs/Twist", self._receive)

    def _geometry(self, root: NodeHandle, node: NodeHandle, left: str, right: str) -> tuple[float, float]:
        """Separation and radius: by the parameters, else by the description in the robot's own namespace."""
        separation, radius = params.number(node, "wheel_separation"), params.number(node, "wheel_radius")
        if separation is None or radius is None:
            robot = robot_on_paper(root)
            one, other = find_joint(robot, left), find_joint(robot, right)
            if separation is None:
                pairs = zip(one.origin.xyz, other.origin.xyz, strict=True)
                separation = sqrt(sum((a - b) * (a - b) for a, b in pairs))
            if radius is None:
                collisions = robot.links[one.child].collisions
                shape = collisions[0].geometry if collisions else None
                if not isinstance(shape, Cylinder | Sphere):
                    raise Refused(
                        f"link {one.child!r} of wheel {left!r} has no cylinder or sphere as its collision",
                        f"slidectl param set {node.namespace}/wheel_radius VALUE",
                    )
                radius = shape.radius
        for name, value in (("wheel_separation", separation), ("wheel_radius", radius)):
            if value == 0.0 or not isfinite(value):
                raise Refused(f"the {name} of {node.namespace} must be a length other than {value:g}")
        return separation, radius

    # Values that change while it is loaded.

    def _first_values(self, node: NodeHandle) -> Values:
        both = params.number(node, "wheel_radius_multiplier")
        sides = [params.number(node, name) for name in MULTIPLIERS[:2]]
        radii = [_or(both, _or(side, 1.0)) for side in sides]
        separation = _or(params.number(node, MULTIPLIERS[2]), 1.0)
        period_of(node, PUBLISH_RATE)  # refuses what is no rate
        rate = _or(params.number(node, "publish_rate"), 50.0)
        values: Values = dict(zip(MULTIPLIERS, (*radii, separation), strict=True))
        values |= {"publish_rate": rate, "enable_odom_tf": _or(params.boolean(node, "enable_odom_tf"), True)}
        self._check_values(values)
        return values

    def _check_values(self, values: Values) -> None:
        """Raises Refused: no odometry can be made with them."""
        for name in MULTIPLIERS:
            if name in values and (values[name] == 0.0 or not isfinite(values[name])):
                raise Refused(f"{self._node.namespace}/{name} must be a number other than {values[name]:g}")
        if not 0.0 < values.get("publish_rate", 1.0) < inf:
            raise Refused(f"{self._node.namespace}/publish_rate must be a rate above 0")

    def _take_values(self, values: Values) -> None:
        """Use these from the next update on. Raises BadDuration: no clock can count the period; nothing changes."""
        self._period_ns = from_seconds(1.0 / values["publish_rate"])
        self._values = dict(values)
        left, right, separation = (values[name] for name in MULTIPLIERS)
        self._left_radius, self._right_radius = left * self._radius, right * self._radius
        self._width = separation * self._separation
        self._has_tf = values["enable_odom_tf"]

    def _change_values(self, values: Values) -> None:
        """Use these, write them to the parameters, and tell the subscribers. Raises Refused."""
        self._check_values(values)
        self._take_values(values)
        self._is_writing = True
        try:
            for name, value in values.items():
                if self._node.get_param(name, None) != value:
                    self._node.set_param(name, value)
        finally:
            self._is_writing = False
        self._server.publish()

    def _judge(self, change: ParameterChange) -> None:
        """Refuse what could not be followed."""
        after = change.after if isinstance(change.after, dict) and not self._is_writing else {}
        given = {name: as_number(after.get(name)) for name in (*MULTIPLIERS, "publish_rate")}
        self._check_values({name: value for name, value in given.items() if value is not None})

    def _parameters_changed(self) -> None:
        """Somebody set or deleted parameters. What is missing stays as it is."""
        if self._is_writing:
            return
        numbers = {name: params.number(self._node, name) for name in (*MULTIPLIERS, "publish_rate")}
        given: dict[str, Any] = numbers | {"enable_odom_tf": params.boolean(self._node, "enable_odom_tf")}
        values = self._values | {name: value for name, value in given.items() if value is not None}
        if values != self._values:
            self._change_values(values)

    # The cycle.

    def starting(self, time_ns: int) -> None:
        """Stand still. The limits go on from the last command, and so does the place, unless time was put back."""
        if time_ns < self._updated_ns:
            self.odometry.x = self.odometry.y = self.odometry.heading = 0.0
            self.limited, self._before = BaseVelocity(), BaseVelocity()
            self._wanted = BaseVelocity()
        self._brake()
        self._published_ns = self._updated_ns = time_ns
        if self._wheel_state is not None:
            self._wheel_state.time_ns = time_ns
        self.odometry.start(time_ns)

    def stopping(self, time_ns: int) -> None:  # noqa: ARG002
        """Stand still."""
        self._brake()

    def _brake(self) -> None:
        for joint in (*self._left, *self._right):
            joint.command = 0.0

    def update(self, time_ns: int, period_s: float) -> None:
        self._updated_ns = time_ns
        if self._is_open_loop:
            self.odometry.update_open_loop(self.limited.linear, self.limited.angular, time_ns)
        else:
            left, right = _mean_position(self._left), _mean_position(self._right)
            if isnan(left) or isnan(right):
                return
            self.odometry.update(left * self._left_radius, right * self._right_radius, self._width, time_ns)
        if self._published_ns + self._period_ns < time_ns:
            self._published_ns += self._period_ns
            self._publish_odometry(time_ns)
        wanted = self._wanted
        if to_seconds(time_ns - self._wanted_ns) > self._timeout_s:
            wanted = BaseVelocity()
        last, before = self.limited, self._before
        linear = self._linear_limiter.limit(wanted.linear, last.linear, before.linear, period_s)
        angular = self._angular_limiter.limit(wanted.angular, last.angular, before.angular, period_s)
        self._before, self.limited = last, BaseVelocity(linear, angular)
        if self._cmd is not None:
            _publish(self._cmd, lambda: {"header": _header(time_ns), "twist": _twist(linear, angular)})
        left_velocity = (linear - angular * self._width / 2.0) / self._left_radius
        right_velocity = (linear + angular * self._width / 2.0) / self._right_radius
        for joint in self._left:
            joint.command = left_velocity
        for joint in self._right:
            joint.command = right_velocity
        if self._wheel_state is not None:
            self._wheel_state.update(time_ns, period_s, left_velocity, right_velocity)

    def _publish_odometry(self, time_ns: int) -> None:
        """Where the base is, as a message and as a frame."""
        odometry = self.odometry
        half = odometry.heading * 0.5
        orientation = {"x": 0.0, "y": 0.0, "z": sin(half), "w": cos(half)}
        place = {"x": odometry.x, "y": odometry.y, "z": 0.0}
        header = _header(time_ns, self._odom_frame)
        _publish(
            self._odom,
            lambda: {
                "header": header,
                "child_frame_id": self._base_frame,
                "pose": {
                    "pose": {"position": place, "orientation": orientation},
                    "covariance": self._pose_covariance,
                },
                "twist": {
                    "twist": _twist(odometry.linear, odometry.angular),
                    "covariance": self._twist_covariance,
                },
            },
        )
        if self._has_tf and self._tf.wanted:
            transform = {"translation": place, "rotation": orientation}
            frame = {"header": dict(header), "child_frame_id": self._base_frame, "transform": transform}
            self._tf.publish({"transforms": [frame]})

    # Commands.

    def _receive(self, message: Message) -> None:
        """Take a command, between two cycles."""
        name = self._node.namespace
        if self.state is not State.RUNNING:
            self._refuse("error", f"{name}: Can't accept new commands. Controller is not running.")
        publishers = self._node.count_publishers("cmd_vel")
        if not self._allows_many and publishers > 1:
            self._brake()
            self._refuse("error", f"{name}: cmd_vel has {publishers} publishers, and 1 is allowed; the wheels brake")
        linear, angular = message["linear"]["x"], message["angular"]["z"]
        if not isfinite(linear) or not isfinite(angular):
            self._refuse("warn", f"{name} takes no command of nan or infinity: it must have finite numbers")
        self._wanted = BaseVelocity(linear, angular)
        self._wanted_ns = self._node.now_ns()

    def _refuse(self, severity: str, text: str) -> None:
        self._node.log(severity, text)
        raise MessageRefused(text)


class WheelState:
    """Publishes what all wheels are to do and do, in each cycle: those on the left, then those on the right."""

    def __init__(self, node: NodeHandle, left: list[JointHandle], right: list[JointHandle]) -> None:
        self.time_ns = 0
        """Of the last update, or the start."""
        self._joints = [*left, *right]
        self._left_count = len(left)
        self._positions = [0.0] * len(self._joints)
        self._velocities = [0.0] * len(self._joints)
        self._desired = (0.0, 0.0)
        self._publisher = node.advertise("wheel_joint_controller_state", "control_msgs/JointTrajectoryControllerState")

    def update(self, time_ns: int, period_s: float, left: float, right: float) -> None:
        """The wheels are commanded these velocities, in rad/s."""
        count, joints = self._left_count, self._joints
        velocities = [left] * count + [right] * (len(joints) - count)
        self._positions = [p + v * period_s for p, v in zip(self._positions, velocities, strict=True)]
        # As upstream: the change times the period, where it should be divided by it, and of the first wheels only.
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
        _publish(
            self._publisher,
            lambda: {
                "header": _header(time_ns),
                "joint_names": [joint.name for joint in joints],
                "desired": desired | start,
                "actual": actual | start,
                "error": error | start,
            },
        )


def _or(value: Any, default: Any) -> Any:
    return default if value is None else value


def _matrix(diagonal: list[float]) -> list[float]:
    """A square matrix of zeros but for its diagonal, row by row."""
    size = len(diagonal)
    return [diagonal[k // size] if k % (size + 1) == 0 else 0.0 for k in range(size * size)]


def _mean_position(joints: list[JointHandle]) -> float:
    total = 0.0
    for joint in joints:
        total += joint.position
    return total / len(joints)


def _header(time_ns: int, frame: str = "") -> Message:
    return {"seq": 0, "stamp": to_stamp(time_ns), "frame_id": frame}


def _twist(linear: float, angular: float) -> Message:
    return {"linear": {"x": linear, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": angular}}


def _publish(publisher: Publisher, message: Any) -> None:
    """Publish what the function makes, if somebody wants it; it is counted in any case."""
    if publisher.wanted:
        publisher.publish(message())
    else:
        publisher.sequence += 1
