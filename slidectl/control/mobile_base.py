"""Common parts of the controllers of mobile bases: commands that time out, velocity limits, odometry and its topics.

After ros_controllers' diff_drive_controller, which the steering controllers follow too. Lengths are in m, angles in
rad. This module commands no joints, except to brake.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from math import cos, isfinite, sin
from typing import Any

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import ControllerBase, State
from slidectl.control.duration import header_of, to_seconds
from slidectl.control.goals import period_of
from slidectl.control.hardware_interface import JointHandle
from slidectl.control.laws import law
from slidectl.control.node_handle import Message, NodeHandle, Publisher, publish_if_wanted
from slidectl.control.params import BOOLEAN, INTEGER, NUMBER, TEXT, Kind, Parameter, within
from slidectl.control.saved_classes import recreated
from slidectl.description.robot import Cylinder, Joint, Robot, Sphere
from slidectl.errors import MessageRefused, Refused
from slidectl.rotations import Vector

DIAGONAL = Kind(
    "a list of six floats, such as 0.001",
    lambda value: value if isinstance(value, list) and [type(item) for item in value] == [float] * 6 else None,
)

TIMEOUT = Parameter("cmd_vel_timeout", NUMBER, "time after which a command expires", "s", default=0.5)
ALLOWS_MANY = Parameter("allow_multiple_cmd_vel_publishers", BOOLEAN, "several nodes may publish cmd_vel", default=True)
OPEN_LOOP = Parameter(
    "open_loop", BOOLEAN, "compute the odometry from the commands, not from the wheels", default=False
)
WINDOW = Parameter("velocity_rolling_window_size", INTEGER, "updates in the mean of the velocities", default=10)
PUBLISH_RATE = Parameter("publish_rate", NUMBER, "odometry messages per simulated second", "1/s", default=50.0)
BASE_FRAME = Parameter("base_frame_id", TEXT, "the frame of the base", default="base_link")
ODOM_FRAME = Parameter("odom_frame_id", TEXT, "the fixed frame of the odometry", default="odom")
ODOM_TF = Parameter("enable_odom_tf", BOOLEAN, "publishes the frame on /tf too", default=True)
OF_BASE = (OPEN_LOOP, WINDOW, TIMEOUT, ALLOWS_MANY, BASE_FRAME, ODOM_FRAME)
"""The parameters of a base that is commanded by twists only."""
COVARIANCES = (
    Parameter("pose_covariance_diagonal", DIAGONAL, "of the pose on odom", required=True),
    Parameter("twist_covariance_diagonal", DIAGONAL, "of the velocities on odom", required=True),
)
_VELOCITY_LIMITS = (
    Parameter("has_velocity_limits", BOOLEAN, "min_velocity and max_velocity apply", default=False),
    Parameter("has_acceleration_limits", BOOLEAN, "min_acceleration and max_acceleration apply", default=False),
    Parameter("max_velocity", NUMBER, "largest velocity", "m/s or rad/s", default=0.0),
    Parameter("min_velocity", NUMBER, "minimum velocity; by default -max_velocity", "m/s or rad/s"),
    Parameter("max_acceleration", NUMBER, "largest acceleration", "m/s² or rad/s²", default=0.0),
    Parameter("min_acceleration", NUMBER, "minimum acceleration; by default -max_acceleration", "m/s² or rad/s²"),
)
_JERK_LIMITS = (
    Parameter("has_jerk_limits", BOOLEAN, "min_jerk and max_jerk apply", default=False),
    Parameter("max_jerk", NUMBER, "largest jerk", "m/s³ or rad/s³", default=0.0),
    Parameter("min_jerk", NUMBER, "minimum jerk; by default -max_jerk", "m/s³ or rad/s³"),
)
LIMITS_WITHOUT_JERK = (*within("linear/x", _VELOCITY_LIMITS), *within("angular/z", _VELOCITY_LIMITS))
LIMITS = (
    *within("linear/x", (*_VELOCITY_LIMITS, *_JERK_LIMITS)),
    *within("angular/z", (*_VELOCITY_LIMITS, *_JERK_LIMITS)),
)


# -- commands ----------------------------------------------------------------------------------------------------------


class CommandTopic:
    """The last command on a topic, as numbers. Commands are accepted while the controller runs."""

    def __init__(
        self,
        controller: ControllerBase,
        node: NodeHandle,
        topic: str,
        type_name: str,
        numbers_of: Callable[[Message], tuple[float, ...]],
        standing: tuple[float, ...],
        on_second_publisher: Callable[[], None] | None = None,
    ) -> None:
        """`standing` is the command that counts when there is none.

        `on_second_publisher` is called when more than one node publishes the topic; None: this is allowed.
        """
        self._standing = standing
        self.forget()
        self.timeout_s: float = params.value_of(node, TIMEOUT)
        self._controller = controller
        self._node = node
        self._topic = topic
        self._numbers_of = numbers_of
        self._on_second_publisher = on_second_publisher
        node.subscribe(topic, type_name, self._receive)

    def forget(self) -> None:
        """Discard the last command."""
        self.received_ns, self.numbers = 0, self._standing

    def at(self, time_ns: int) -> tuple[float, ...]:
        """The command that counts at this time: the last one, or `standing` when it has timed out or there is none."""
        return self._standing if to_seconds(time_ns - self.received_ns) > self.timeout_s else self.numbers

    def _receive(self, message: Message) -> None:
        """Accept or refuse a command. Called between two cycles."""
        name = self._node.namespace
        if self._controller.state is not State.RUNNING:
            self._refuse("error", f"{name}: Can't accept new commands. Controller is not running.")
        publishers = self._node.count_publishers(self._topic)
        if self._on_second_publisher is not None and publishers > 1:
            self._on_second_publisher()
            text = f"{name}: {self._topic} has {publishers} publishers, but only 1 is allowed; the wheels brake"
            self._refuse("error", text)
        numbers = self._numbers_of(message)
        if not all(map(isfinite, numbers)):
            self._refuse("warn", f"{name} refuses the command: it must have finite numbers, not nan or infinity")
        self.numbers = numbers
        self.received_ns = self._node.now_ns()

    def _refuse(self, severity: str, text: str) -> None:
        self._node.log(severity, text)
        raise MessageRefused(text)


def velocity_commands(
    controller: ControllerBase, node: NodeHandle, on_second_publisher: Callable[[], None] | None = None
) -> CommandTopic:
    """The twists on `cmd_vel`: linear velocity forwards in m/s, angular velocity to the left in rad/s."""
    return CommandTopic(
        controller,
        node,
        "cmd_vel",
        "geometry_msgs/Twist",
        lambda message: (message["linear"]["x"], message["angular"]["z"]),
        (0.0, 0.0),
        on_second_publisher,
    )


# -- limits ------------------------------------------------------------------------------------------------------------


@law
def clamp(value: float, least: float, most: float) -> float:
    """min(max(least, value), most)."""
    if value > least:
        least = value
    return most if most < least else least


@law
def limited(limits: Any, wanted: float, last: float, before: float, period_s: float) -> float:
    """The velocity of the next period for a `wanted` one. `last` and `before` are the two previous ones.

    After speed_limiter.cpp: it bounds the velocity, the acceleration and the jerk by `limits`, see `limits_of`.
    """
    if limits[0]:
        change, scale = last - before, 2.0 * period_s * period_s
        wanted = last + change + clamp(wanted - last - change, limits[1] * scale, limits[2] * scale)
    if limits[3]:
        wanted = last + clamp(wanted - last, limits[4] * period_s, limits[5] * period_s)
    return clamp(wanted, limits[7], limits[8]) if limits[6] else wanted


LIMIT_NUMBERS = 9


def limits_of(node: NodeHandle, where: str, has_jerk: bool) -> list[float]:
    """The limits by the parameters of the namespace `where`: LIMIT_NUMBERS numbers.

    For jerk, acceleration and velocity each: 1.0 if it is bounded, else 0.0; the least value; the largest value.
    """
    velocity, acceleration = _bounds(node, where, "velocity"), _bounds(node, where, "acceleration")
    jerk = _bounds(node, where, "jerk") if has_jerk else None
    bounds = (jerk, acceleration, velocity)
    return [number for pair in bounds for number in ((1.0, *pair) if pair else (0.0, 0.0, 0.0))]


def _bounds(node: NodeHandle, where: str, what: str) -> tuple[float, float] | None:
    has = params.read(node, f"{where}/has_{what}_limits", BOOLEAN)
    most, least = params.read(node, f"{where}/max_{what}", NUMBER), params.read(node, f"{where}/min_{what}", NUMBER)
    if not has:
        return None
    if most is None:
        place = names.join(node.namespace, where)
        node.log("warn", f"{place}/has_{what}_limits is true without max_{what}: 0 is used")
        most = 0.0
    return -most if least is None else least, most


@law
def follow_velocity(velocity: Any, limits: Any, linear: float, angular: float, period_s: float) -> None:
    """Set the velocities of the next period, for the wanted `linear` and `angular` ones.

    `velocity` is a LimitedVelocity, or its row.
    """
    last_linear, last_angular = velocity.last_linear, velocity.last_angular
    velocity.last_linear = limited(limits, linear, last_linear, velocity.before_linear, period_s)
    velocity.last_angular = limited(limits[LIMIT_NUMBERS:], angular, last_angular, velocity.before_angular, period_s)
    velocity.before_linear, velocity.before_angular = last_linear, last_angular


class LimitedVelocity:
    """The commanded velocity of the base, m/s and rad/s: the wanted one, limited by the two previous ones."""

    def __init__(self, node: NodeHandle, has_jerk: bool = True) -> None:
        self.limits = [*limits_of(node, "linear/x", has_jerk), *limits_of(node, "angular/z", has_jerk)]
        """The limits of the linear velocity, then those of the angular velocity."""
        self.forget()

    def forget(self) -> None:
        """Set the previous velocities to 0."""
        self.last_linear = self.last_angular = self.before_linear = self.before_angular = 0.0

    def follow(self, linear: float, angular: float | None, period_s: float) -> None:
        """Set the velocities of the next period. `angular` None: the last angular velocity stays."""
        last_angular = self.last_angular
        follow_velocity(self, self.limits, linear, last_angular if angular is None else angular, period_s)
        if angular is None:
            self.last_angular = last_angular


# -- odometry ----------------------------------------------------------------------------------------------------------


LARGEST_WINDOW = 100_000
"""Updates: 100 s at 1 kHz."""


@law
def rolling_mean(mean: float, value: float, past: Any, first: int, window: int, count: int) -> float:
    """The rolling mean after one more value, equal to boost's accumulator to the bit. The last values are in `past`, in
    the `window` places from `first` on; `count` is the number of values so far. The new value replaces the oldest."""
    slot = first + count % window
    oldest, past[slot] = past[slot], value
    return mean + ((value - oldest) / window if count >= window else (value - mean) / (count + 1))


@recreated
class RollingMean:
    """The mean of the last values, at most `size`."""

    def __init__(self, size: int) -> None:
        self._past = size * [0.0]
        self._count = 0
        self.mean = 0.0

    def add(self, value: float) -> None:
        """Add a value."""
        self.mean = rolling_mean(self.mean, value, self._past, 0, len(self._past), self._count)
        self._count += 1


@law
def moved(x: float, y: float, heading: float, linear: float, angular: float) -> tuple[float, float, float]:
    """x, y and heading after a motion along an arc of length `linear` and angle `angular`, or along a line."""
    if abs(angular) < 1e-6:
        direction = heading + angular * 0.5
        return x + linear * cos(direction), y + linear * sin(direction), heading + angular
    radius, new = linear / angular, heading + angular
    return x + radius * (sin(new) - sin(heading)), y + -radius * (cos(new) - cos(heading)), new


def window_of(node: NodeHandle) -> int:
    """The size of rolling means. Raises Refused: it is not above 0, or too large."""
    size: int = params.value_of(node, WINDOW)
    if not 1 <= size <= LARGEST_WINDOW:
        raise Refused(f"parameter {node.namespace}/{WINDOW.name} must be 1 to {LARGEST_WINDOW}, not {size}")
    return size


@law
def travel(odometry: Any, past: Any, way: float, turn: float, time_ns: int) -> None:
    """Add a motion since the last call: `way` in m, `turn` in rad. `odometry` is an Odometry, or its row."""
    odometry.x, odometry.y, odometry.heading = moved(odometry.x, odometry.y, odometry.heading, way, turn)
    period_s = to_seconds(time_ns - odometry.measured_ns)
    if period_s < SHORTEST_S:
        return
    odometry.measured_ns = time_ns
    window, count = odometry.window, odometry.count
    odometry.linear = rolling_mean(odometry.linear_mean, way / period_s, past, 0, window, count)
    odometry.angular = rolling_mean(odometry.angular_mean, turn / period_s, past, window, window, count)
    odometry.linear_mean, odometry.angular_mean = odometry.linear, odometry.angular
    odometry.count += 1


class Odometry:
    """The pose of a base, integrated from its motion: x and y in m, heading in rad; and velocities in m/s and rad/s."""

    def __init__(self, window: int) -> None:
        self.x = self.y = self.heading = self.linear = self.angular = 0.0
        self.window = window
        self.past: Any = array("d", bytes(2 * 8 * window))
        """The last velocities: the linear ones, then the angular ones."""
        self.start(0)

    def start(self, time_ns: int) -> None:
        """Reset the means of the velocities. The pose stays."""
        self.measured_ns = time_ns
        self.count = 0
        """The number of velocities so far."""
        self.linear_mean = self.angular_mean = 0.0

    def forget(self) -> None:
        """Set the pose to the origin. Subclasses also reset the positions of the wheels."""
        self.x = self.y = self.heading = 0.0

    def travel_at(self, velocity: LimitedVelocity, time_ns: int) -> None:
        """Add a motion with the last of these velocities since the last call (open loop)."""
        self.linear, self.angular = velocity.last_linear, velocity.last_angular
        period_s = to_seconds(time_ns - self.measured_ns)
        self.measured_ns = time_ns
        way, turn = self.linear * period_s, self.angular * period_s
        self.x, self.y, self.heading = moved(self.x, self.y, self.heading, way, turn)


SHORTEST_S = 0.0001
"""The shortest period from which a velocity is computed, s."""


@law
def odometry_is_due(topics: Any, time_ns: int) -> bool:
    """True when a message of OdometryTopics is due. This sets the time of the next one, a period later."""
    if topics.published_ns + topics.period_ns >= time_ns:
        return False
    topics.published_ns += topics.period_ns
    topics.messages += 1
    return True


class OdometryPublisher:
    """Publishes the odometry on `odom` and `/tf`."""

    def __init__(
        self, node: NodeHandle, frames: tuple[str, str], has_tf: bool, covariances: Sequence[list[float]]
    ) -> None:
        """`frames`: that of the odometry and that of the base. `covariances`: the diagonals of pose and velocity."""
        self.has_tf = has_tf
        self._odom_frame, self._base_frame = frames
        self._pose_covariance, self._twist_covariance = map(matrix_of, covariances)
        self.messages = 0
        """Odometry messages that were due so far, published or not."""
        self._odom = node.advertise("odom", "nav_msgs/Odometry")
        self._tf = node.advertise("/tf", "tf2_msgs/TFMessage")

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """The publishers of `odom` and `/tf`."""
        return self._odom, self._tf

    def publish(self, time_ns: int, place: Vector, velocity: Vector) -> None:
        """`place`: x and y in m, heading in rad. `velocity`: forwards and to the left, m/s, turning left, rad/s."""
        x, y, heading = place
        orientation = {"x": 0.0, "y": 0.0, "z": sin(heading * 0.5), "w": cos(heading * 0.5)}
        position = {"x": x, "y": y, "z": 0.0}
        header = header_of(time_ns, self._odom_frame)
        self._odom.sequence = self.messages - 1
        publish_if_wanted(
            self._odom,
            lambda: {
                "header": header,
                "child_frame_id": self._base_frame,
                "pose": {
                    "pose": {"position": position, "orientation": orientation},
                    "covariance": self._pose_covariance,
                },
                "twist": {"twist": twist_of(*velocity), "covariance": self._twist_covariance},
            },
        )
        if self.has_tf and self._tf.wanted:
            transform = {"translation": position, "rotation": orientation}
            frame = {"header": dict(header), "child_frame_id": self._base_frame, "transform": transform}
            self._tf.publish({"transforms": [frame]})


class OdometryTopics(OdometryPublisher):
    """Publishes the odometry at a rate."""

    def __init__(self, node: NodeHandle, odom_frame: str) -> None:
        """Raises SlidectlError: a covariance is missing or wrong, or the rate is not valid."""
        self.period_ns = period_of(node, PUBLISH_RATE)
        has_tf: bool = params.value_of(node, ODOM_TF)
        covariances = [params.value_of(node, diagonal) for diagonal in COVARIANCES]
        super().__init__(node, (odom_frame, params.value_of(node, BASE_FRAME)), has_tf, covariances)
        self.published_ns = 0
        """Time at which the last message was due, or of the start. The first one is due a period after the start."""


def matrix_of(diagonal: list[float]) -> list[float]:
    """A square matrix with this diagonal and zeros elsewhere, row by row."""
    size = len(diagonal)
    return [diagonal[k // size] if k % (size + 1) == 0 else 0.0 for k in range(size * size)]


def twist_of(forwards: float, sideways: float, angular: float) -> Message:
    """geometry_msgs/Twist of a motion in the plane."""
    linear = {"x": forwards, "y": sideways, "z": 0.0}
    return {"linear": linear, "angular": {"x": 0.0, "y": 0.0, "z": angular}}


# -- the controller ----------------------------------------------------------------------------------------------------


class BaseController(ControllerBase):
    """Base of the controllers of mobile bases. It sets all joint commands to 0 at start and stop.

    The init of a subclass sets all of these attributes except `updated_ns`.
    """

    odometry: Any
    velocity: LimitedVelocity
    topics: OdometryTopics
    _commands: tuple[CommandTopic, ...]
    _joints: tuple[JointHandle, ...]
    """The joints that it commands."""
    updated_ns = 0

    def starting(self, time_ns: int) -> None:
        """The pose and the limited velocity continue from before the stop, unless time was reset."""
        if time_ns < self.updated_ns:
            self.odometry.forget()
            self.velocity.forget()
            for commands in self._commands:
                commands.forget()
        self._brake()
        self.updated_ns = self.topics.published_ns = time_ns
        self.odometry.start(time_ns)

    def stopping(self, time_ns: int) -> None:  # noqa: ARG002
        self._brake()

    def _brake(self) -> None:
        for joint in self._joints:
            joint.command = 0.0


# -- geometry ----------------------------------------------------------------------------------------------------------


def wheel_radius(node: NodeHandle, robot: Robot, wheel: Joint, shapes: tuple[type, ...] = (Cylinder,)) -> float:
    """The radius, in m, of the first collision of a wheel's link. Raises Refused: it has none of the shapes."""
    collisions = robot.links[wheel.child].collisions
    shape = collisions[0].geometry if collisions else None
    if isinstance(shape, Cylinder | Sphere) and isinstance(shape, shapes):
        return shape.radius
    words = " or ".join(each.__name__.lower() for each in shapes)
    raise Refused(
        f"link {wheel.child!r} of wheel {wheel.name!r} has no {words} as its collision",
        f"slidectl param set {node.namespace}/wheel_radius VALUE",
    )


def check_lengths(node: NodeHandle, **lengths: float) -> None:
    """Raises Refused: one of them is 0, or no number."""
    for name, value in lengths.items():
        if value == 0.0 or not isfinite(value):
            raise Refused(f"the {name} of {node.namespace} must be a length other than {value:g}")
