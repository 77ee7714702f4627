"""Common parts of the controllers of mobile bases of ROS 2: stamped commands, velocity limits, frames, set_odometry.

After ros2_controllers' diff_drive_controller, and the rate limiter of control_toolbox. Lengths are in m, angles in rad.
This module commands no joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite, isnan
from typing import Any

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import ControllerBase, State
from slidectl.control.duration import NANOSECONDS, to_seconds
from slidectl.control.mobile_base import BASE_FRAME, COVARIANCES, DIAGONAL, ODOM_FRAME, clamp
from slidectl.control.node_handle import Message, NodeHandle
from slidectl.control.params import BOOLEAN, NUMBER, TEXT, Parameter, as_number, within
from slidectl.control.ros2_controller import LogThrottle, fixed
from slidectl.description.parameter_trees import leaves
from slidectl.errors import MessageRefused, Refused

# -- parameters --------------------------------------------------------------------------------------------------------

TF_PREFIX_ENABLE, TF_PREFIX, ODOMETRY_FRAME, FRAME_OF_BASE = fixed(
    Parameter("tf_frame_prefix_enable", BOOLEAN, "the frames get a prefix", default=True),
    Parameter("tf_frame_prefix", TEXT, "the prefix; by default the robot's namespace, which ~ stands for", default=""),
    ODOM_FRAME,
    BASE_FRAME,
)
FRAMES = (TF_PREFIX_ENABLE, TF_PREFIX, ODOMETRY_FRAME, FRAME_OF_BASE)
DIAGONALS = fixed(*(Parameter(each.name, DIAGONAL, each.meaning, default=[0.0] * 6) for each in COVARIANCES))
_SPEED, _RATE, _JERK = "m/s or rad/s", "m/s² or rad/s²", "m/s³ or rad/s³"
_LIMITS = {
    "max_velocity": ("largest velocity, 0 or above; without it velocities have no limit", _SPEED),
    "min_velocity": ("least velocity, 0 or below; by default -max_velocity", _SPEED),
    "max_acceleration": ("largest acceleration forwards, 0 or above; without it accelerations have no limit", _RATE),
    "max_deceleration": ("braking while it moves forwards, 0 or below; by default max_acceleration_reverse", _RATE),
    "max_acceleration_reverse": ("acceleration backwards, 0 or below; by default -max_acceleration", _RATE),
    "max_deceleration_reverse": ("braking while it moves backwards, 0 or above; by default max_acceleration", _RATE),
    "max_jerk": ("largest jerk, 0 or above; without it the jerk has no limit", _JERK),
    "min_jerk": ("least jerk, 0 or below; by default -max_jerk", _JERK),
}
_NOT_ABOVE_0 = ("min_velocity", "max_deceleration", "max_acceleration_reverse", "min_jerk")
LIMITS_OF_AXIS = tuple(Parameter(name, NUMBER, *texts, live=True) for name, texts in _LIMITS.items())
"""The limits of one velocity, below a namespace such as `linear/x`. A value of nan counts as not set."""


def frames_of(node: NodeHandle, namespace: str) -> tuple[str, str]:
    """The frames of the odometry and of the base, with their prefix. `namespace` is the robot's."""
    enabled, prefix, *frames = (params.value_of(node, parameter) for parameter in FRAMES)
    prefix = (prefix.replace("~", namespace, 1) if prefix else namespace).removeprefix("/")
    before = f"{prefix.removesuffix('/')}/" if enabled and prefix.strip("/") else ""
    return before + frames[0], before + frames[1]


# -- commands ----------------------------------------------------------------------------------------------------------


class StampedCommands:
    """The last command on a topic of geometry_msgs/TwistStamped, as numbers. nan stands for no command."""

    def __init__(
        self,
        controller: ControllerBase,
        node: NodeHandle,
        topic: str,
        numbers_of: Callable[[Message], tuple[float, ...]],
        timeout_s: float,
    ) -> None:
        """`numbers_of` returns the velocities of a geometry_msgs/Twist. A `timeout_s` of 0 is none."""
        self.timeout_s = timeout_s
        self.numbers: tuple[float, ...] | None = None
        """None: there is no command."""
        self.stamp_ns = node.now_ns()
        """The time from which the time-out counts."""
        self._controller = controller
        self._node = node
        self._numbers_of = numbers_of
        self._has_no_stamp = False
        """True: a command without a stamp was received, which is reported once."""
        self._warnings = LogThrottle(node)
        node.subscribe(topic, "geometry_msgs/TwistStamped", self._receive)

    def forget(self, time_ns: int) -> None:
        """Discard the last command. The time-out counts from this time."""
        self.numbers, self.stamp_ns = None, time_ns

    def has_timed_out(self, time_ns: int) -> bool:
        """True when the last command, or the time without one, is older than the time-out."""
        return self.timeout_s != 0.0 and to_seconds(time_ns - self.stamp_ns) > self.timeout_s

    def _receive(self, message: Message) -> None:
        """Accept or refuse a command. Called between two cycles."""
        name, now_ns = self._node.namespace, self._node.now_ns()
        if self._controller.state is not State.RUNNING:
            self._refuse(f"{name} does not run and accepts no commands")
        numbers = self._numbers_of(message["twist"])
        if not all(map(isfinite, numbers)):
            self._refuse(f"{name} refuses the command: it must have finite numbers, not nan or infinity")
        stamp = message["header"]["stamp"]
        stamp_ns = stamp["secs"] * NANOSECONDS + stamp["nsecs"]
        if not stamp_ns:
            stamp_ns = now_ns
            if not self._has_no_stamp:
                self._has_no_stamp = True
                self._node.log("warn", f"{name}: the command has no stamp, and counts from its arrival")
        age_s = to_seconds(now_ns - stamp_ns)
        if self.timeout_s != 0.0 and age_s >= self.timeout_s:
            self._refuse(f"{name} refuses the command: its stamp is {age_s:g} s old, the time-out {self.timeout_s:g} s")
        if self.timeout_s != 0.0 and -age_s > self.timeout_s:
            text = f"{name}: the stamp of the command is {-age_s:g} s ahead of the simulated time"
            self._warnings.log("warn", f"{text}: it does not end before that")
        self.numbers, self.stamp_ns = numbers, stamp_ns

    def _refuse(self, text: str) -> None:
        self._warnings.log("warn", text)
        raise MessageRefused(text)


# -- limits ------------------------------------------------------------------------------------------------------------


def check_limits(node: NodeHandle, where: str, tree: Mapping[str, Any]) -> None:
    """Check the limits below `where` in a tree of the controller's parameters. Raises Refused: a sign is wrong."""
    for path, value in leaves(tree):
        space, _, name = path.rpartition("/")
        number = as_number(value)
        if space != where or name not in _LIMITS or number is None or isnan(number):
            continue
        if (number > 0.0) if name in _NOT_ABOVE_0 else (number < 0.0):
            side = "below" if name in _NOT_ABOVE_0 else "above"
            raise Refused(f"parameter {names.join(node.namespace, path)} must be 0 or {side}, not {number:g}")


class VelocityLimiter:
    """Limits one velocity of a base by its two previous ones: the jerk, then the acceleration, then the velocity.

    After control_toolbox's RateLimiter.
    """

    def __init__(self, node: NodeHandle, where: str) -> None:
        """`where` is the namespace of the limits, such as `linear/x`. Raises Refused: a sign is wrong."""
        self._node, self._where = node, where
        self.velocity: tuple[float, float] | None = None
        """The least and the largest one; None: there is no limit. `jerk` likewise."""
        self.acceleration: tuple[float, float, float, float] | None = None
        """The largest acceleration and braking, forwards; and the same backwards. None: there is no limit."""
        self.jerk: tuple[float, float] | None = None
        self.forget()
        self.read()

    def forget(self) -> None:
        """Set the previous velocities to 0."""
        self.last = self.before = 0.0

    def read(self) -> None:
        """Read the limits from the parameters. Raises Refused: a sign is wrong."""
        check_limits(self._node, self._where, self._node.get_param(self._node.namespace, {}))
        found = {
            each.name.rpartition("/")[2]: params.read(self._node, each.name, NUMBER)
            for each in within(self._where, LIMITS_OF_AXIS)
        }
        given = {name: value for name, value in found.items() if value is not None and not isnan(value)}
        self.velocity = self.acceleration = self.jerk = None
        if "max_velocity" in given:
            most = given["max_velocity"]
            self.velocity = given.get("min_velocity", -most), most
        if "max_acceleration" in given:
            most = given["max_acceleration"]
            reverse = given.get("max_acceleration_reverse", -most)
            braking = given.get("max_deceleration", reverse)
            self.acceleration = most, braking, reverse, given.get("max_deceleration_reverse", most)
        if "max_jerk" in given:
            most = given["max_jerk"]
            self.jerk = given.get("min_jerk", -most), most

    def follow(self, wanted: float, period_s: float) -> float:
        """The velocity of the next period, for a wanted one."""
        last, velocity = self.last, wanted
        if self.jerk is not None:
            change, last_change = velocity - last, last - self.before
            if (change - last_change) * change > 0.0:
                least, most = (each * period_s * period_s for each in self.jerk)
                velocity = last + last_change + clamp(change - last_change, least, most)
        if self.acceleration is not None:
            forwards, braking, backwards, braking_backwards = self.acceleration
            least = braking if last > 0.0 else backwards
            most = braking_backwards if last < 0.0 else forwards
            velocity = last + clamp(velocity - last, least * period_s, most * period_s)
        if self.velocity is not None:
            velocity = clamp(velocity, *self.velocity)
        self.before, self.last = last, velocity
        return velocity


# -- the pose ----------------------------------------------------------------------------------------------------------


class PoseRequest:
    """Serves `set_odometry`: the pose that the odometry gets in the next update."""

    def __init__(self, controller: ControllerBase, node: NodeHandle) -> None:
        self._controller = controller
        self._pose: tuple[float, float, float] | None = None
        node.advertise_service("set_odometry", "control_msgs/SetOdometry", self._receive)

    def forget(self) -> None:
        """Discard the request."""
        self._pose = None

    def take(self) -> tuple[float, float, float] | None:
        """x, y (m) and yaw (rad) of the last request, once; None: there is none."""
        pose, self._pose = self._pose, None
        return pose

    def _receive(self, request: Message) -> Message:
        if self._controller.state is not State.RUNNING:
            return {"success": False, "message": "Controller is not active"}
        pose = request["x"], request["y"], request["yaw"]
        if not all(map(isfinite, pose)):
            return {"success": False, "message": "x, y and yaw must be finite numbers, not nan or infinity"}
        self._pose = pose
        return {"success": True, "message": "Odometry set request accepted"}
