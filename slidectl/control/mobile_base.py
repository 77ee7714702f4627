"""What the controllers of mobile bases share: commands that time out, limits of velocity, and odometry with its topics.

After ros_controllers' diff_drive_controller, from which the steering controllers have it. Lengths are in m, angles in
rad. It knows no joints.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from math import cos, isfinite, sin
from typing import Any, Protocol

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import ControllerBase, State
from slidectl.control.duration import header_of, to_seconds
from slidectl.control.goals import period_of
from slidectl.control.laws import law
from slidectl.control.node_handle import Message, NodeHandle, Publisher
from slidectl.control.params import BOOLEAN, INTEGER, NUMBER, TEXT, Kind, Parameter, within
from slidectl.description.robot import Cylinder, Joint, Robot, Sphere
from slidectl.errors import MessageRefused, Refused

DIAGONAL = Kind(
    "a list of six floats, as 0.001",
    lambda value: value if isinstance(value, list) and [type(item) for item in value] == [float] * 6 else None,
)

TIMEOUT = Parameter("cmd_vel_timeout", NUMBER, "a command counts for so long", "s", default=0.5)
ALLOWS_MANY = Parameter("allow_multiple_cmd_vel_publishers", BOOLEAN, "several nodes may publish cmd_vel", default=True)
OPEN_LOOP = Parameter("open_loop", BOOLEAN, "odometry is made of the commands, not of the wheels", default=False)
WINDOW = Parameter("velocity_rolling_window_size", INTEGER, "updates in the mean of the velocities", default=10)
PUBLISH_RATE = Parameter("publish_rate", NUMBER, "odometry messages per simulated second", "1/s", default=50.0)
BASE_FRAME = Parameter("base_frame_id", TEXT, "the frame that moves", default="base_link")
ODOM_FRAME = Parameter("odom_frame_id", TEXT, "the frame that it moves in", default="odom")
ODOM_TF = Parameter("enable_odom_tf", BOOLEAN, "publishes the frame on /tf too", default=True)
COVARIANCES = (
    Parameter("pose_covariance_diagonal", DIAGONAL, "of the pose on odom", required=True),
    Parameter("twist_covariance_diagonal", DIAGONAL, "of the velocities on odom", required=True),
)
_VELOCITY_LIMITS = (
    Parameter("has_velocity_limits", BOOLEAN, "min_velocity and max_velocity count", default=False),
    Parameter("has_acceleration_limits", BOOLEAN, "min_acceleration and max_acceleration count", default=False),
    Parameter("max_velocity", NUMBER, "largest velocity", "m/s or rad/s", default=0.0),
    Parameter("min_velocity", NUMBER, "least velocity; by default the largest one backwards", "m/s or rad/s"),
    Parameter("max_acceleration", NUMBER, "largest acceleration", "m/s² or rad/s²", default=0.0),
    Parameter("min_acceleration", NUMBER, "least one; by default the largest one backwards", "m/s² or rad/s²"),
)
_JERK_LIMITS = (
    Parameter("has_jerk_limits", BOOLEAN, "min_jerk and max_jerk count", default=False),
    Parameter("max_jerk", NUMBER, "largest jerk", "m/s³ or rad/s³", default=0.0),
    Parameter("min_jerk", NUMBER, "least jerk; by default the largest one backwards", "m/s³ or rad/s³"),
)
LIMITS_WITHOUT_JERK = (*within("linear/x", _VELOCITY_LIMITS), *within("angular/z", _VELOCITY_LIMITS))
LIMITS = (
    *within("linear/x", (*_VELOCITY_LIMITS, *_JERK_LIMITS)),
    *within("angular/z", (*_VELOCITY_LIMITS, *_JERK_LIMITS)),
)


# -- commands ----------------------------------------------------------------------------------------------------------


class CommandTopic:
    """The last command on a topic, as numbers. The controller takes commands while it runs."""

    def __init__(
        self,
        controller: ControllerBase,
        node: NodeHandle,
        topic: str,
        type_name: str,
        numbers_of: Callable[[Message], tuple[float, ...]],
        on_second_publisher: Callable[[], None] | None = None,
    ) -> None:
        """`on_second_publisher` is called when more nodes than one publish; None: they may."""
        self.time_ns = 0
        """When it came."""
        self._numbers: tuple[float, ...] | None = None
        self.timeout_s: float = params.value_of(node, TIMEOUT)
        self._controller = controller
        self._node = node
        self._topic = topic
        self._numbers_of = numbers_of
        self._on_second_publisher = on_second_publisher
        node.subscribe(topic, type_name, self._receive)

    def forget(self) -> None:
        """As if none had come."""
        self.time_ns, self._numbers = 0, None

    def at(self, time_ns: int) -> tuple[float, ...] | None:
        """The numbers; None: there is no command, or it has timed out."""
        return None if to_seconds(time_ns - self.time_ns) > self.timeout_s else self._numbers

    @property
    def first_two(self) -> tuple[float, float]:
        """The first two numbers of the last command; 0 where there is none."""
        return (0.0, 0.0) if self._numbers is None else (self._numbers[0], self._numbers[1])

    def _receive(self, message: Message) -> None:
        """Take a command, between two cycles."""
        name = self._node.namespace
        if self._controller.state is not State.RUNNING:
            self._refuse("error", f"{name}: Can't accept new commands. Controller is not running.")
        publishers = self._node.count_publishers(self._topic)
        if self._on_second_publisher is not None and publishers > 1:
            self._on_second_publisher()
            text = f"{name}: {self._topic} has {publishers} publishers, and 1 is allowed; the wheels brake"
            self._refuse("error", text)
        numbers = self._numbers_of(message)
        if not all(map(isfinite, numbers)):
            self._refuse("warn", f"{name} takes no command of nan or infinity: it must have finite numbers")
        self._numbers = numbers
        self.time_ns = self._node.now_ns()

    def _refuse(self, severity: str, text: str) -> None:
        self._node.log(severity, text)
        raise MessageRefused(text)


def velocity_commands(
    controller: ControllerBase, node: NodeHandle, on_second_publisher: Callable[[], None] | None = None
) -> CommandTopic:
    """Twists on `cmd_vel`: the velocities forwards, in m/s, and to the left, in rad/s."""
    return CommandTopic(
        controller,
        node,
        "cmd_vel",
        "geometry_msgs/Twist",
        lambda message: (message["linear"]["x"], message["angular"]["z"]),
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
    """The velocity that follows `last` and the one `before` it, when this one is wanted; `limits` as a SpeedLimiter
    has them."""
    if limits[0]:
        change, scale = last - before, 2.0 * period_s * period_s
        wanted = last + change + clamp(wanted - last - change, limits[1] * scale, limits[2] * scale)
    if limits[3]:
        wanted = last + clamp(wanted - last, limits[4] * period_s, limits[5] * period_s)
    return clamp(wanted, limits[7], limits[8]) if limits[6] else wanted


LIMIT_NUMBERS = 9


class SpeedLimiter:
    """Bounds a velocity, its change in a period, and the change of that, after speed_limiter.cpp."""

    def __init__(self, node: NodeHandle, where: str, has_jerk: bool) -> None:
        """Read the parameters of the namespace `where`."""
        velocity, acceleration = _bounds(node, where, "velocity"), _bounds(node, where, "acceleration")
        jerk = _bounds(node, where, "jerk") if has_jerk else None
        bounds = (jerk, acceleration, velocity)
        self.numbers = [number for pair in bounds for number in ((1.0, *pair) if pair else (0.0, 0.0, 0.0))]
        """Of jerk, acceleration and velocity: whether it is bounded, the least, and the largest."""


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


@dataclass(slots=True)
class BaseVelocity:
    """Of the base: m/s and rad/s."""

    linear: float = 0.0
    angular: float = 0.0


class LimitedVelocity:
    """The velocity that the base is commanded: what is wanted, within the limits of the two before."""

    def __init__(self, node: NodeHandle, has_jerk: bool = True) -> None:
        self._linear = SpeedLimiter(node, "linear/x", has_jerk)
        self._angular = SpeedLimiter(node, "angular/z", has_jerk)
        self.forget()

    def forget(self) -> None:
        """Go on from standing still."""
        self.last, self.before = BaseVelocity(), BaseVelocity()

    def follow(self, linear: float, angular: float | None, period_s: float) -> BaseVelocity:
        """The velocity of the next period; `angular` is None where nobody turns by it, and the last one stays."""
        last, before = self.last, self.before
        linear = limited(self._linear.numbers, linear, last.linear, before.linear, period_s)
        if angular is None:
            angular = last.angular
        else:
            angular = limited(self._angular.numbers, angular, last.angular, before.angular, period_s)
        self.before, self.last = last, BaseVelocity(linear, angular)
        return self.last

    def numbers(self) -> list[float]:
        """The limits of the velocity forwards, then those of the turning."""
        return [*self._linear.numbers, *self._angular.numbers]


# -- odometry ----------------------------------------------------------------------------------------------------------


LARGEST_WINDOW = 100_000
"""Updates: 100 s at 1 kHz."""


@law
def rolling_mean(mean: float, value: float, past: Any, first: int, window: int, count: int) -> float:
    """The mean with one more value, computed as boost's accumulator does: the same bits. The last values, of which
    there were `count`, are `past` from `first` on; the oldest makes room for the new one."""
    slot = first + count % window
    oldest, past[slot] = past[slot], value
    return mean + ((value - oldest) / window if count >= window else (value - mean) / (count + 1))


class RollingMean:
    """The mean of the last values, so many at most."""

    def __init__(self, size: int) -> None:
        self._past = size * [0.0]
        self._count = 0
        self.mean = 0.0

    def add(self, value: float) -> None:
        """One more value."""
        self.mean = rolling_mean(self.mean, value, self._past, 0, len(self._past), self._count)
        self._count += 1


@law
def moved(x: float, y: float, heading: float, linear: float, angular: float) -> tuple[float, float, float]:
    """The place after a way along a circle, or along a line where that is as good."""
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


class Odometry:
    """Where a base is by what it has moved: x and y in m, heading in rad, velocities in m/s and rad/s."""

    def __init__(self, window: int) -> None:
        self.x = self.y = self.heading = self.linear = self.angular = 0.0
        self.window = window
        self.past: Any = array("d", bytes(2 * 8 * window))
        """The last velocities: the linear ones, then the angular ones."""
        self.start(0)

    def start(self, time_ns: int) -> None:
        """Begin with the velocities anew. The place stays."""
        self.time_ns = time_ns
        self.count = 0
        """Of the velocities so far."""
        self.linear_mean = self.angular_mean = 0.0

    def forget(self) -> None:
        """The base is at the origin, and its wheels have made no way."""
        self.x = self.y = self.heading = 0.0

    def advance(self, linear: float, angular: float, time_ns: int) -> None:
        """The base has moved so far, in m, and turned so far, in rad, since the last time."""
        self._integrate(linear, angular)
        period_s = to_seconds(time_ns - self.time_ns)
        if period_s < SHORTEST_S:
            return
        self.time_ns = time_ns
        past, window, count = self.past, self.window, self.count
        self.linear = rolling_mean(self.linear_mean, linear / period_s, past, 0, window, count)
        self.angular = rolling_mean(self.angular_mean, angular / period_s, past, window, window, count)
        self.linear_mean, self.angular_mean = self.linear, self.angular
        self.count = count + 1

    def advance_by(self, velocity: BaseVelocity, time_ns: int) -> None:
        """The base has had these velocities since the last time."""
        self.linear, self.angular = velocity.linear, velocity.angular
        period_s = to_seconds(time_ns - self.time_ns)
        self.time_ns = time_ns
        self._integrate(velocity.linear * period_s, velocity.angular * period_s)

    def _integrate(self, linear: float, angular: float) -> None:
        self.x, self.y, self.heading = moved(self.x, self.y, self.heading, linear, angular)


SHORTEST_S = 0.0001
"""A shorter period tells no velocity."""


class OdometryTopics:
    """Tells at a rate where a base is, on `odom` and `/tf`."""

    def __init__(self, node: NodeHandle, odom_frame: str) -> None:
        """Raises SlidectlError: a covariance is missing or wrong, or the rate is none."""
        self.period_ns = period_of(node, PUBLISH_RATE)
        self.has_tf: bool = params.value_of(node, ODOM_TF)
        self._odom_frame = odom_frame
        self._base_frame: str = params.value_of(node, BASE_FRAME)
        self._pose_covariance, self._twist_covariance = (
            matrix_of(params.value_of(node, diagonal)) for diagonal in COVARIANCES
        )
        self.published_ns = 0
        self.messages = 0
        """Odometry messages that were due so far, published or not."""
        self._odom = node.advertise("odom", "nav_msgs/Odometry")
        self._tf = node.advertise("/tf", "tf2_msgs/TFMessage")

    def start(self, time_ns: int) -> None:
        """The first message comes a period later."""
        self.published_ns = time_ns

    def are_due(self, time_ns: int) -> bool:
        """Is a message due? Then the next one is due a period later."""
        if self.published_ns + self.period_ns >= time_ns:
            return False
        self.published_ns += self.period_ns
        self.messages += 1
        return True

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """Of the odometry and of the frame."""
        return self._odom, self._tf

    def publish(self, time_ns: int, place: PlaceOfBase, velocity: tuple[float, float, float]) -> None:
        """`velocity` is that forwards and to the left, m/s, and of the turning to the left, rad/s."""
        half = place.heading * 0.5
        orientation = {"x": 0.0, "y": 0.0, "z": sin(half), "w": cos(half)}
        position = {"x": place.x, "y": place.y, "z": 0.0}
        header = header_of(time_ns, self._odom_frame)
        self._odom.sequence = self.messages - 1
        publish(
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


class PlaceOfBase(Protocol):
    """Where a base is in the plane: m and rad."""

    x: float
    y: float
    heading: float


def matrix_of(diagonal: list[float]) -> list[float]:
    """A square matrix of zeros but for its diagonal, row by row."""
    size = len(diagonal)
    return [diagonal[k // size] if k % (size + 1) == 0 else 0.0 for k in range(size * size)]


def twist_of(forwards: float, sideways: float, angular: float) -> Message:
    """geometry_msgs/Twist of a motion in the plane."""
    linear = {"x": forwards, "y": sideways, "z": 0.0}
    return {"linear": linear, "angular": {"x": 0.0, "y": 0.0, "z": angular}}


def publish(publisher: Publisher, message: Callable[[], Message]) -> None:
    """Publish what the function makes, if somebody wants it; it is counted in any case."""
    if publisher.wanted:
        publisher.publish(message())
    else:
        publisher.sequence += 1


class Forgetful(Protocol):
    """What has a past."""

    def forget(self) -> None:
        """Begin anew."""


def forget_if_put_back(time_ns: int, updated_ns: int, *things: Forgetful) -> None:
    """Forget the past of these at a start before the last update: time was put back."""
    if time_ns < updated_ns:
        for thing in things:
            thing.forget()


# -- geometry ----------------------------------------------------------------------------------------------------------


def wheel_radius(node: NodeHandle, robot: Robot, wheel: Joint, shapes: tuple[type, ...] = (Cylinder,)) -> float:
    """The radius of the first collision of a wheel's link. Raises Refused: it is of none of the shapes."""
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
