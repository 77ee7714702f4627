"""Steered bases: odometry against closed forms, geometry of the model, restarts, refusals.

The recorded runs of test_control_conformance.py hold their numbers; these tests are about what a user meets.
"""

from __future__ import annotations

from math import atan, cos, isfinite, nan, pi, sin, tan

import pytest
from fake_robot import STEP_S, Bench, FakeRobot

from slidectl import msgs
from slidectl.control.hardware_interface import JointHandle, PositionJointInterface, VelocityJointInterface
from slidectl.errors import MessageRefused

COVARIANCE = {"pose_covariance_diagonal": [0.001] * 6, "twist_covariance_diagonal": [0.002] * 6}
ACKERMANN = {"wheel_separation_h": 0.5, "wheel_radius": 0.1}
FOUR = {
    f"{axle}_{what}": [f"{axle}_left_{what}", f"{axle}_right_{what}"]
    for axle in ("front", "rear")
    for what in ("wheel", "steering")
}


def urdf(shape: str = '<cylinder radius="0.1" length="0.05"/>', offset: float = 0.1) -> str:
    """A car of 1 m between the axles and 0.6 m between the wheels, which are so far beside their steering joints."""
    parts = ['<robot name="bot"><link name="base_link"/>']
    for x, axle in ((0.5, "front"), (-0.5, "rear")):
        for y, side in ((1, "left"), (-1, "right")):
            name = f"{axle}_{side}"
            parts.append(
                f'<link name="{name}_hub"/><joint name="{name}_steering" type="revolute"><parent link="base_link"/>'
                f'<child link="{name}_hub"/><origin xyz="{x} {y * (0.3 - offset)} 0"/><axis xyz="0 0 1"/>'
                f'<limit lower="-1.6" upper="1.6" effort="1" velocity="1"/></joint>'
                f'<link name="{name}"><collision><geometry>{shape}</geometry></collision></link>'
                f'<joint name="{name}_wheel" type="continuous"><parent link="{name}_hub"/><child link="{name}"/>'
                f'<origin xyz="0 {y * offset} 0"/><axis xyz="0 1 0"/></joint>'
            )
    return "".join(parts) + "</robot>"


class Car(Bench):
    """A robot whose wheels turn, and whose steering joints stand, as they are commanded."""

    def __init__(self, kind: str, wheels: list[str], steering: list[str], **parameters: object) -> None:
        values = {name: value for name, value in {**COVARIANCE, **parameters}.items() if value is not None}
        robot = FakeRobot((*wheels, *steering), ())
        robot.joints = {name: JointHandle(name) for name in (*wheels, *steering)}
        robot.register_interface(VelocityJointInterface(robot.joints[name] for name in wheels))
        robot.register_interface(PositionJointInterface(robot.joints[name] for name in steering))
        super().__init__(
            robot, {"base": {"type": f"{kind}_controller/{kind.title().replace('_', '')}Controller", **values}}
        )
        self.graph.set("/bot/robot_description", urdf())
        self.wheels, self.steering = wheels, steering

    def run(self, cycles: int = 1, **more: object) -> None:
        for _ in range(cycles):
            super().run(**more)
            for name in self.wheels:
                joint = self.robot.joints[name]
                joint.velocity = joint.command
                joint.position += joint.command * STEP_S
            for name in self.steering:
                self.robot.joints[name].position = self.robot.joints[name].command

    def drive(self, linear: float, angular: float = 0.0) -> None:
        self.graph.send(
            "/bot/base/cmd_vel", msgs.check("geometry_msgs/Twist", {"linear": {"x": linear}, "angular": {"z": angular}})
        )

    def steer(self, speed: float, front: float, rear: float) -> None:
        command = {"speed": speed, "front_steering_angle": front, "rear_steering_angle": rear}
        self.graph.send(
            "/bot/base/cmd_four_wheel_steering", msgs.check("four_wheel_steering_msgs/FourWheelSteering", command)
        )

    def commands(self, names: list[str]) -> list[float]:
        return [self.robot.joints[name].command for name in names]

    @property
    def place(self) -> tuple[float, float, float]:
        odometry = self.manager.get("base").odometry
        return odometry.x, odometry.y, odometry.heading


def ackermann(**parameters: object) -> Car:
    return Car("ackermann_steering", ["rear_wheel_joint"], ["front_steer_joint"], **{**ACKERMANN, **parameters})


def four_wheels(**parameters: object) -> Car:
    names = {**FOUR, **parameters}
    wheels, steering = FOUR["front_wheel"] + FOUR["rear_wheel"], FOUR["front_steering"] + FOUR["rear_steering"]
    return Car("four_wheel_steering", wheels, steering, **names)


def started(car: Car) -> Car:
    car.start("base")
    car.run()
    return car


def test_an_ackermann_base_moves_on_the_circle_of_its_steering_angle() -> None:
    car = started(ackermann(cmd_vel_timeout=9.0))
    car.drive(0.5, 0.4)
    car.run(2001)
    radius, way = 0.5 / tan(0.4), 1.0
    assert car.commands(["rear_wheel_joint", "front_steer_joint"]) == pytest.approx([5.0, 0.4])
    heading = way / radius
    assert car.place == pytest.approx((radius * sin(heading), radius * (1 - cos(heading)), heading), abs=2e-3)


def test_four_steered_wheels_turn_the_base_as_the_twist_says() -> None:
    car = four_wheels(cmd_vel_timeout=9.0)
    # With wheels beside their steering joints upstream's odometry is off: it takes the front ones without the offset.
    car.graph.set("/bot/robot_description", urdf(offset=0.0))
    started(car)
    car.drive(0.5, 0.5)
    car.run(2002)
    # Each wheel stands at right angles to the line from the centre of the turn, 1 m to the left of the middle.
    angle = atan(0.5 / (1.0 - 0.3))
    assert car.commands(FOUR["front_steering"])[0] == pytest.approx(angle)
    assert car.commands(FOUR["rear_steering"])[0] == pytest.approx(-angle)
    assert car.place == pytest.approx((sin(1.0), 1 - cos(1.0), 1.0), abs=2e-3)


def test_with_both_axles_at_one_angle_the_base_goes_sideways() -> None:
    car = started(four_wheels(cmd_vel_timeout=9.0))
    car.steer(0.5, pi / 4, pi / 4)
    car.run(1002)
    assert car.commands(car.steering) == pytest.approx([pi / 4] * 4)
    assert car.place == pytest.approx((0.5 * cos(pi / 4), 0.5 * sin(pi / 4), 0.0), abs=2e-3)
    message = car.graph.sent("/bot/base/odom_steer")[-1]
    assert message["data"]["front_steering_angle"] == pytest.approx(pi / 4)
    assert msgs.check("four_wheel_steering_msgs/FourWheelSteeringStamped", message) == message


def test_the_newer_of_both_kinds_of_command_counts_until_it_times_out() -> None:
    car = started(four_wheels(cmd_vel_timeout=0.2))
    car.steer(0.5, 0.2, 0.0)
    car.run(10)
    car.drive(0.3)
    car.run()
    assert car.commands(car.wheels) == pytest.approx([3.0] * 4)
    assert car.commands(car.steering) == [0.0] * 4
    car.run(201)
    assert car.commands(car.wheels) == [0.0] * 4


def test_the_geometry_of_the_model_stands_in_the_parameters_afterwards() -> None:
    car = started(four_wheels(wheel_base=2.0))
    names = ("track", "wheel_radius", "wheel_base", "wheel_steering_y_offset")
    assert [car.graph.get(f"/bot/base/{name}") for name in names] == pytest.approx([0.6, 0.1, 2.0, 0.1])


def test_an_ackermann_base_takes_the_geometry_of_its_model() -> None:
    car = Car(
        "ackermann_steering", FOUR["rear_wheel"], FOUR["front_steering"], rear_wheel="rear_left_wheel",
        front_steer="front_left_steering", steer_pos_multiplier=2.0, cmd_vel_timeout=9.0,
    )  # fmt: skip
    started(car).drive(0.2, 0.1)
    car.run(1001)
    # The origins of the joints in their own parents, as upstream takes them: 0.5 and 0.
    assert car.place[2] == pytest.approx(0.2 * tan(0.2) / 0.5, rel=5e-3)


def test_wheels_in_the_centre_of_their_turn_tell_nothing_and_the_base_drives_on() -> None:
    car = started(four_wheels(cmd_vel_timeout=9.0))
    car.drive(0.5)
    car.run(100)
    before = car.place
    for name, angle in zip(car.steering, (0.3, -0.3, 0.0, 0.0), strict=True):
        car.robot.joints[name].position = angle
    Bench.run(car)
    assert car.place == before
    car.run(100)
    assert car.place[0] == pytest.approx(before[0] + 0.05, abs=1e-3)


@pytest.mark.parametrize("make", [ackermann, four_wheels])
class TestBoth:
    def test_a_restart_stands_still_and_keeps_the_place_but_when_time_was_put_back(self, make) -> None:
        car = started(make())
        car.drive(0.5, 0.2)
        car.run(300)
        car.request(stop=["base"])
        car.run()
        assert car.commands([*car.wheels, *car.steering]) == [0.0] * len(car.robot.joints)
        place = car.place
        car.request(start=["base"])
        car.run()
        assert car.place == place
        car.graph.time_ns = 0
        for joint in car.robot.joints.values():
            joint.position = joint.velocity = 0.0
        car.manager.restart_running(0)
        car.run(2)
        assert car.place == (0.0, 0.0, 0.0)
        assert car.commands(car.wheels) == [0.0] * len(car.wheels)

    def test_commands_of_nan_and_to_a_stopped_controller_are_refused(self, make) -> None:
        car = make()
        car.load("base")
        with pytest.raises(MessageRefused, match="not running"):
            car.drive(0.5)
        car.request(start=["base"])
        car.run(2)
        with pytest.raises(MessageRefused, match="finite"):
            car.drive(nan)
        car.drive(0.5)
        for joint in car.robot.joints.values():
            joint.position = joint.velocity = nan
        car.run()
        assert all(map(isfinite, car.place))

    @pytest.mark.parametrize(
        ("parameters", "text"),
        [
            (
                {"pose_covariance_diagonal": None},
                "pose_covariance_diagonal is not set; it must be a list of six floats",
            ),
            ({"twist_covariance_diagonal": [1] * 6}, "twist_covariance_diagonal must be a list of six floats"),
            ({"publish_rate": 0.0}, "publish_rate must be a rate above 0"),
            ({"velocity_rolling_window_size": 0}, "velocity_rolling_window_size must be 1 to 100000, not 0"),
            ({"wheel_radius": 0.0}, "the wheel_radius of /bot/base must be a length other than 0"),
        ],
    )
    def test_it_is_not_loaded_with_parameters_that_it_cannot_follow(self, make, parameters: dict, text: str) -> None:
        refused(make(**parameters), text)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"front_wheel": None}, "/bot/base/front_wheel is not set; it must be a list of two strings, left and right"),
        ({"rear_wheel": ["rear_left_wheel"]}, "/bot/base/rear_wheel must be a list of two strings, left and right"),
        ({"front_steering": "front_left_steering"}, "must be a list of two strings, left and right"),
        ({"rear_wheel": ["rear_left_wheel", "rear_left_steering"]}, "no joint 'rear_left_steering'"),
        ({"rear_steering": ["nope", "front_left_steering"]}, "no joint 'nope'"),
        ({"base_frame_id": "chassis"}, "is not below the link 'chassis', which base_frame_id names"),
    ],
)
def test_four_wheel_steering_needs_its_joints_and_its_frame(parameters: dict, text: str) -> None:
    refused(four_wheels(**parameters), text)


def test_what_the_model_does_not_say_is_refused() -> None:
    car = four_wheels()
    car.graph.set("/bot/robot_description", urdf('<sphere radius="0.1"/>'))
    refused(car, "link 'front_left' of wheel 'front_left_wheel' has no cylinder as its collision")
    car = ackermann(wheel_radius=None)
    refused(car, "no joint 'rear_wheel_joint' in robot_description")
    car = four_wheels()
    car.graph.delete("/bot/robot_description")
    refused(car, "parameter /bot/robot_description is not set")


def refused(car: Car, text: str) -> None:
    assert not car.manager.load("base")
    assert text in car.graph.lines("error")
    assert not car.graph.subscribers
