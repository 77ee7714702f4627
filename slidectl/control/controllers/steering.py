"""Drives a base by steered wheels, after ackermann_steering_controller and four_wheel_steering_controller.

The wheels take velocities, the steering joints positions. Lengths are in m, angles in rad.

Topics `cmd_vel`, `odom`, `/tf`; of the four-wheel steering also `cmd_four_wheel_steering` and `odom_steer`.
"""

from __future__ import annotations

from math import atan, copysign, cos, isnan, pi, sin, sqrt, tan
from typing import ClassVar, NamedTuple

from slidectl import msgs
from slidectl.control import params
from slidectl.control.controller_interface import MultiInterfaceController
from slidectl.control.duration import header_of, to_seconds
from slidectl.control.hardware_interface import (
    I,
    PositionJointInterface,
    RobotHW,
    VelocityJointInterface,
)
from slidectl.control.mobile_base import (
    ALLOWS_MANY,
    BASE_FRAME,
    COVARIANCES,
    LIMITS,
    LIMITS_WITHOUT_JERK,
    ODOM_FRAME,
    ODOM_TF,
    OF_BASE,
    OPEN_LOOP,
    PUBLISH_RATE,
    SHORTEST_S,
    TIMEOUT,
    WINDOW,
    BaseController,
    CommandTopic,
    LimitedVelocity,
    Odometry,
    OdometryTopics,
    RollingMean,
    check_lengths,
    clamp,
    odometry_is_due,
    travel,
    velocity_commands,
    wheel_radius,
    window_of,
)
from slidectl.control.node_handle import NodeHandle, publish_if_wanted
from slidectl.control.params import NUMBER, TEXT, Kind, Parameter, as_texts
from slidectl.control.registry import controller
from slidectl.control.robot_description import find_joint, robot_of_model
from slidectl.description.robot import Robot
from slidectl.errors import Refused


def _interface(hw: RobotHW, interface_type: type[I]) -> I:
    """The hardware interface of this type. The base class has checked that it exists."""
    interface = hw.get(interface_type)
    assert interface is not None
    return interface


class SteeredOdometry(Odometry):
    """Odometry from the travelled distance of a rear wheel and the angle of the front steering."""

    def __init__(self, window: int) -> None:
        super().__init__(window)
        self._way = 0.0

    def forget(self) -> None:
        super().forget()
        self._way = 0.0

    def update(self, way: float, angle: float, separation: float, time_ns: int) -> None:
        """Update from the wheel's total distance `way`, the steering angle, and the separation of the axles."""
        linear, self._way = way - self._way, way
        travel(self, self.past, linear, tan(angle) * linear / separation, time_ns)


@controller("ackermann_steering_controller/AckermannSteeringController")
class AckermannSteeringController(BaseController, MultiInterfaceController):
    """velocity of the rear wheel = linear / radius; angle of the front steering = the commanded angular.z."""

    interface_types = (VelocityJointInterface, PositionJointInterface)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("rear_wheel", TEXT, "the joint of the rear wheel", default="rear_wheel_joint", names_joints=True),
        Parameter("front_steer", TEXT, "the steering joint", default="front_steer_joint", names_joints=True),
        Parameter("wheel_separation_h", NUMBER, "distance of the axles; by default that in the model", "m"),
        Parameter("wheel_radius", NUMBER, "of the rear wheel; by default that in the model", "m"),
        Parameter("wheel_separation_h_multiplier", NUMBER, "corrects the separation", default=1.0),
        Parameter("wheel_radius_multiplier", NUMBER, "corrects the radius, in the odometry only", default=1.0),
        Parameter("steer_pos_multiplier", NUMBER, "corrects the measured steering angle", default=1.0),
        PUBLISH_RATE,
        *OF_BASE,
        ODOM_TF,
        *LIMITS,
        *COVARIANCES,
    )

    def init_in_root(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint, or a required part of the description is missing or wrong."""
        rear_wheel, front_steer, separation, radius, separation_scale, radius_scale, self._steer_scale = (
            params.value_of(node, parameter) for parameter in self.parameters[:7]
        )
        if separation is None or radius is None:
            robot = robot_of_model(root)
            wheel = find_joint(robot, rear_wheel)
            if separation is None:
                separation = abs(wheel.origin.xyz[0] - find_joint(robot, front_steer).origin.xyz[0])
            if radius is None:
                radius = wheel_radius(node, robot, wheel)
        check_lengths(node, wheel_separation_h=separation * separation_scale, wheel_radius=radius * radius_scale)
        self._separation, self._radius = separation_scale * separation, radius
        self._odometry_radius = radius_scale * radius
        self._is_open_loop: bool = params.value_of(node, OPEN_LOOP)
        self.odometry: SteeredOdometry = SteeredOdometry(window_of(node))
        self.velocity = LimitedVelocity(node)
        self.topics = OdometryTopics(node, params.value_of(node, ODOM_FRAME))
        self._wheel = _interface(hw, VelocityJointInterface).get_handle(rear_wheel)
        self._steer = _interface(hw, PositionJointInterface).get_handle(front_steer)
        self._joints = (self._wheel, self._steer)
        on_second_publisher = None if params.value_of(node, ALLOWS_MANY) else self._brake
        self._commands = (velocity_commands(self, node, on_second_publisher),)

    def update(self, time_ns: int, period_s: float) -> None:
        self.updated_ns = time_ns
        odometry = self.odometry
        if self._is_open_loop:
            odometry.travel_at(self.velocity, time_ns)
        else:
            position, angle = self._wheel.position, self._steer.position
            if isnan(position) or isnan(angle):
                return
            way = position * self._odometry_radius
            odometry.update(way, angle * self._steer_scale, self._separation, time_ns)
        if odometry_is_due(self.topics, time_ns):
            place = odometry.x, odometry.y, odometry.heading
            self.topics.publish(time_ns, place, (odometry.linear, 0.0, odometry.angular))
        linear, angle = self._commands[0].at(time_ns)
        self.velocity.follow(linear, angle, period_s)
        self._wheel.command = self.velocity.last_linear / self._radius
        self._steer.command = self.velocity.last_angular


# -- four-wheel steering -----------------------------------------------------------------------------------------------

TWO = Kind(
    "a list of two strings, left and right",
    lambda value: names if (names := as_texts(value)) is not None and len(names) == 2 else None,
)
SMALLEST = 0.001
"""m/s or rad: a command or an angle up to this counts as 0."""


class Angles(NamedTuple):
    """Steering angles of the axles, positive to the left."""

    front: float
    rear: float


class FourWheelOdometry:
    """Odometry from the velocities of the wheels and the steering angles of the axles, after odometry.cpp."""

    def __init__(self, window: int, track: float, offset: float, radius: float, base: float) -> None:
        """In m: track of the steering joints, offset of the wheels from them, radius, distance of the axles."""
        self._window = window
        self._track, self._offset, self._radius, self._base = track, offset, radius, base
        self.linear = self.linear_x = self.linear_y = self.angular = 0.0
        """The speed, negative backwards, its components forwards and to the left, m/s, and the rate of turn, rad/s."""
        self.forget()
        self.start(0)

    def start(self, time_ns: int) -> None:
        """Reset the means. The pose stays."""
        self._time_ns = time_ns
        self._acceleration, self._jerk, self._front, self._rear = (RollingMean(self._window) for _ in range(4))

    def forget(self) -> None:
        """Set the pose to the origin, and the last velocities and angles to 0."""
        self.x = self.y = self.heading = 0.0
        self._last_linear = self._last_acceleration = self._last_front = self._last_rear = 0.0

    @property
    def changes(self) -> tuple[float, float, float, float]:
        """Means of the acceleration, the jerk, and the velocities of front and rear steering, each computed as previous
        minus current value, as upstream."""
        return self._acceleration.mean, self._jerk.mean, self._front.mean, self._rear.mean

    def update(self, front: tuple[float, float], rear: tuple[float, float], angles: Angles, time_ns: int) -> None:
        """Update from the velocities of the wheels, (left, right) in rad/s, and the angles of the axles.

        Raises:
            ArithmeticError, ValueError: a wheel is in the centre of the turn; nothing has changed.
        """
        base = self._base
        front_bend, front_left, front_right = self._rolling(angles.front, angles, front)
        rear_bend, rear_left, rear_right = self._rolling(angles.rear, angles, rear)
        # As upstream: the front axle's speed is that of the measured velocities, the rear axle's of the converted ones.
        front_speed = self._speed(front_left + front_right, front, front_bend)
        rear_speed = self._speed(rear_left + rear_right, (rear_left, rear_right), rear_bend)
        self.angular = (front_speed * front_bend + rear_speed * rear_bend) / 2.0
        self.linear_x = (front_speed * cos(angles.front) + rear_speed * cos(angles.rear)) / 2.0
        self.linear_y = (
            front_speed * sin(angles.front)
            - base * self.angular / 2.0
            + rear_speed * sin(angles.rear)
            + base * self.angular / 2.0
        ) / 2.0
        amount = sqrt(self.linear_x * self.linear_x + self.linear_y * self.linear_y)
        self.linear = copysign(1.0, rear_speed) * amount
        period_s = to_seconds(time_ns - self._time_ns)
        if period_s < SHORTEST_S:
            return
        self._time_ns = time_ns
        forwards, sideways = self.linear_x * period_s, self.linear_y * period_s
        self.x += forwards * cos(self.heading) - sideways * sin(self.heading)
        self.y += forwards * sin(self.heading) + sideways * cos(self.heading)
        self.heading += self.angular * period_s
        self._acceleration.add((self._last_linear - self.linear) / period_s)
        self._last_linear = self.linear
        self._jerk.add((self._last_acceleration - self._acceleration.mean) / period_s)
        self._last_acceleration = self._acceleration.mean
        self._front.add((self._last_front - angles.front) / period_s)
        self._last_front = angles.front
        self._rear.add((self._last_rear - angles.rear) / period_s)
        self._last_rear = angles.rear

    def _rolling(self, angle: float, angles: Angles, turning: tuple[float, float]) -> tuple[float, float, float]:
        """The curvature of the path of the axle at this angle, 1/m, and the velocities of its wheels, converted to the
        positions of the steering joints."""
        bend = cos(angle) * (tan(angles.front) - tan(angles.rear)) / self._base
        across, square = self._track * bend * cos(angle), (self._track * bend / 2) * (self._track * bend / 2)
        left, right = bend / sqrt(1 - across + square), bend / sqrt(1 + across + square)
        # The minus for the right wheel is as upstream.
        return bend, turning[0] * (1 / (1 - self._offset * left)), turning[1] * (1 / (1 - self._offset * right))

    def _speed(self, sign: float, turning: tuple[float, float], bend: float) -> float:
        left, right = turning
        way = self._track * bend
        amount = sqrt((left * left + right * right) / (2 + way * way / 2.0))
        return self._radius * copysign(1.0, sign) * amount


class FourWheels(NamedTuple):
    """Commands for the four wheels, or for their steering joints."""

    front_left: float = 0.0
    front_right: float = 0.0
    rear_left: float = 0.0
    rear_right: float = 0.0


@controller("four_wheel_steering_controller/FourWheelSteeringController")
class FourWheelSteeringController(BaseController, MultiInterfaceController):
    """A twist turns the base about a point beside its middle; a 4WS command is a speed and the angles of both axles.

    The newer command of the two counts.
    """

    interface_types = (VelocityJointInterface, PositionJointInterface)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("front_wheel", TWO, "the joints of the front wheels", required=True, names_joints=True),
        Parameter("rear_wheel", TWO, "the joints of the rear wheels", required=True, names_joints=True),
        Parameter("front_steering", TWO, "the joints that steer the front wheels", required=True, names_joints=True),
        Parameter("rear_steering", TWO, "the joints that steer the rear wheels", required=True, names_joints=True),
        Parameter("track", NUMBER, "distance of left and right wheels; by default that in the model", "m"),
        Parameter("wheel_radius", NUMBER, "of all wheels; by default that of the first in the model", "m"),
        Parameter("wheel_base", NUMBER, "distance of the axles; by default that in the model", "m"),
        PUBLISH_RATE,
        WINDOW,
        TIMEOUT,
        BASE_FRAME,
        ODOM_TF,
        *LIMITS_WITHOUT_JERK,
        *COVARIANCES,
    )

    def init_in_root(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> None:
        """Lengths that are taken from the description are written to the parameters, also `wheel_steering_y_offset`.

        Raises:
            SlidectlError: a parameter, a joint, or a required part of the description is missing or wrong.
        """
        front_wheel, rear_wheel, front_steering, rear_steering = (
            params.value_of(node, parameter) for parameter in self.parameters[:4]
        )
        self._find_geometry(root, node, front_wheel, rear_wheel[0], front_steering[0])
        self.velocity = LimitedVelocity(node, has_jerk=False)
        self.odometry: FourWheelOdometry = FourWheelOdometry(
            window_of(node), self._track, self._offset, self._radius, self._base
        )
        self.topics = OdometryTopics(node, "odom")
        self._odom_steer = node.advertise("odom_steer", f"{STEERING}Stamped")
        wheels, steering = _interface(hw, VelocityJointInterface), _interface(hw, PositionJointInterface)
        self._wheels = [wheels.get_handle(name) for name in (*front_wheel, *rear_wheel)]
        self._steering = [steering.get_handle(name) for name in (*front_steering, *rear_steering)]
        self._joints = (*self._wheels, *self._steering)
        self._twists = velocity_commands(self, node)
        self._axles = CommandTopic(
            self,
            node,
            "cmd_four_wheel_steering",
            STEERING,
            lambda message: (message["speed"], message["front_steering_angle"], message["rear_steering_angle"]),
            (0.0, 0.0, 0.0),
        )
        self._commands = (self._twists, self._axles)

    def _find_geometry(
        self, root: NodeHandle, node: NodeHandle, front: list[str], rear_left: str, steering_left: str
    ) -> None:
        robot, frame = robot_of_model(root), params.value_of(node, BASE_FRAME)
        places = {name: _place(robot, name, frame) for name in (*front, rear_left, steering_left)}

        def length(name: str, found: float | None) -> float:
            value = params.read(node, name, NUMBER)
            if value is None:
                value = wheel_radius(node, robot, robot.joints[front[0]]) if found is None else found
                node.set_param(name, value)
            return value

        def distance(one: str, other: str) -> float:
            x, y = places[other][0] - places[one][0], places[other][1] - places[one][1]
            return sqrt(x * x + y * y)

        self._offset = distance(steering_left, front[0])
        node.set_param("wheel_steering_y_offset", self._offset)
        track = length("track", distance(*front))
        self._radius, self._base = length("wheel_radius", None), length("wheel_base", distance(front[0], rear_left))
        check_lengths(node, wheel_radius=self._radius, wheel_base=self._base)
        self._track = track - 2 * self._offset

    def update(self, time_ns: int, period_s: float) -> None:
        self.updated_ns = time_ns
        self._update_odometry(time_ns)
        velocity = self.velocity
        if self._axles.received_ns >= self._twists.received_ns:
            linear, front, rear = self._axles.at(time_ns)
            velocity.follow(linear, None, period_s)
            angles = Angles(clamp(front, -pi / 2, pi / 2), clamp(rear, -pi / 2, pi / 2))
            wheels, steering = self._by_axles(velocity.last_linear, angles)
        else:
            linear, angular = self._twists.at(time_ns)
            velocity.follow(linear, angular, period_s)
            wheels, steering = self._by_twist(velocity.last_linear, velocity.last_angular)
        for joint, command in zip(self._joints, (*wheels, *steering), strict=True):
            joint.command = command

    def _update_odometry(self, time_ns: int) -> None:
        front_left, front_right, rear_left, rear_right = (joint.velocity for joint in self._wheels)
        positions = [joint.position for joint in self._steering]
        if any(map(isnan, (front_left, front_right, rear_left, rear_right, *positions))):
            return
        odometry = self.odometry
        try:
            angles = Angles(_axle_angle(*positions[:2]), _axle_angle(*positions[2:]))
            odometry.update((front_left, front_right), (rear_left, rear_right), angles, time_ns)
        except (ArithmeticError, ValueError):  # the motion of the base cannot be computed
            return
        if not odometry_is_due(self.topics, time_ns):
            return
        place = odometry.x, odometry.y, odometry.heading
        self.topics.publish(time_ns, place, (odometry.linear_x, odometry.linear_y, odometry.angular))
        acceleration, jerk, front_velocity, rear_velocity = odometry.changes
        data = {
            "front_steering_angle": angles.front,
            "rear_steering_angle": angles.rear,
            "front_steering_angle_velocity": front_velocity,
            "rear_steering_angle_velocity": rear_velocity,
            "speed": odometry.linear,
            "acceleration": acceleration,
            "jerk": jerk,
        }
        # `msgs.check` rounds to the 32 bits of the message's fields.
        header = header_of(time_ns, "odom")
        publish_if_wanted(self._odom_steer, lambda: {"header": header, "data": msgs.check(STEERING, data)})

    def _by_twist(self, linear: float, angular: float) -> tuple[FourWheels, FourWheels]:
        """Commands of wheels and steering for the velocities of the base."""
        across, base = angular * self._track, self._base
        wheels, left, right = FourWheels(), 0.0, 0.0
        if abs(linear) > SMALLEST:
            along = base * angular / 2.0
            wheels = self._turning(linear, angular, along, along)
        if abs(2.0 * linear) > abs(across):
            left, right = atan(angular * base / (2.0 * linear - across)), atan(angular * base / (2.0 * linear + across))
        elif abs(linear) > SMALLEST:
            left = right = copysign(pi / 2, angular)
        return wheels, FourWheels(left, right, -left, -right)

    def _by_axles(self, linear: float, angles: Angles) -> tuple[FourWheels, FourWheels]:
        """Commands of wheels and steering for a speed and the angles of the axles."""
        base, front, rear = self._base, tan(angles.front), tan(angles.rear)
        difference = self._track * (front - rear) / 2.0
        steering, wheels = FourWheels(), FourWheels()
        if abs(base - abs(difference)) > SMALLEST:
            inner, outer = base - difference, base + difference
            steering = FourWheels(
                atan(base * front / inner),
                atan(base * front / outer),
                atan(base * rear / inner),
                atan(base * rear / outer),
            )
        if abs(linear) > SMALLEST:
            angular = linear * (front - rear) / base
            front_along = self._to_centre(steering.front_left, steering.front_right) * angular
            rear_along = self._to_centre(steering.rear_left, steering.rear_right) * angular
            wheels = self._turning(linear, angular, front_along, rear_along)
        return wheels, steering

    def _to_centre(self, left: float, right: float) -> float:
        """Distance of the centre of the turn before or behind an axle, m; 0 when its wheels are parallel."""
        left, right = tan(left), tan(right)
        return right * left * self._track / (left - right) if abs(left - right) > 0.01 else 0.0

    def _turning(self, linear: float, angular: float, front: float, rear: float) -> FourWheels:
        """Velocities of the wheels, rad/s. `front` and `rear` are the sideways velocities of the axles, m/s."""
        offset, sign = angular * self._offset / self._radius, copysign(1.0, linear)
        left, right = linear - angular * self._track / 2, linear + angular * self._track / 2
        return FourWheels(
            sign * _hypot(left, front) / self._radius - offset,
            sign * _hypot(right, front) / self._radius + offset,
            sign * _hypot(left, rear) / self._radius - offset,
            sign * _hypot(right, rear) / self._radius + offset,
        )


STEERING = "four_wheel_steering_msgs/FourWheelSteering"


def _hypot(x: float, y: float) -> float:
    """The hypot of the C library, as upstream. math.hypot differs in the last bit."""
    return abs(complex(x, y))


def _axle_angle(left: float, right: float) -> float:
    """The angle of a wheel in the middle of an axle whose wheels are at these angles. Raises ZeroDivisionError."""
    if abs(left) <= SMALLEST and abs(right) <= SMALLEST:
        return 0.0
    return atan(2 * tan(left) * tan(right) / (tan(left) + tan(right)))


def _place(robot: Robot, joint: str, frame: str) -> tuple[float, float]:
    """x and y of a joint in the frame of a link above it. As upstream, origins are added without their rotations."""
    above = {each.child: each for each in robot.joints.values()}
    found = find_joint(robot, joint)
    x, y, _ = found.origin.xyz
    while found.parent != frame:
        if found.parent not in above:
            raise Refused(
                f"joint {joint!r} is not below the link {frame!r}, which base_frame_id names",
                f"the robot's first link is {robot.root!r}",
            )
        found = above[found.parent]
        x, y = x + found.origin.xyz[0], y + found.origin.xyz[1]
    return x, y
