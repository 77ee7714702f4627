"""The differential drive: odometry against closed forms, limits, time-out, frames, parameters that change, refusals.

The recorded runs of test_control_conformance.py hold its numbers; these tests are about what a user meets.
"""

from __future__ import annotations

from itertools import pairwise
from math import cos, inf, nan, pi, sin

import pytest
from fake_robot import STEP_S, Bench, FakeRobot
from hypothesis import given
from hypothesis import strategies as st

from slidectl import msgs
from slidectl.control.controllers.diff_drive import SidesOdometry, roll
from slidectl.control.mobile_base import rolling_mean
from slidectl.errors import MessageRefused, Refused

NAMESPACE = "/bot/base"
COVARIANCE = {"pose_covariance_diagonal": [0.001] * 6, "twist_covariance_diagonal": [0.002] * 6}
GEOMETRY = {"wheel_separation": 0.5, "wheel_radius": 0.1}
INERTIA = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


class Base(Bench):
    """A base whose wheels turn as they are commanded."""

    def __init__(self, joints: tuple[str, ...] = ("left", "right"), **parameters: object) -> None:
        values = {"left_wheel": "left", "right_wheel": "right", **GEOMETRY, **COVARIANCE, **parameters}
        values = {name: value for name, value in values.items() if value is not None}
        super().__init__(
            FakeRobot(joints, ("velocity",)), {"base": {"type": "diff_drive_controller/DiffDriveController", **values}}
        )

    def run(self, cycles: int = 1, **more: object) -> None:
        for _ in range(cycles):
            super().run(**more)
            for joint in self.robot.joints.values():
                joint.velocity = joint.command
                joint.position += joint.command * STEP_S

    def drive(self, linear: float, angular: float = 0.0) -> None:
        message = msgs.check("geometry_msgs/Twist", {"linear": {"x": linear}, "angular": {"z": angular}})
        self.graph.send(f"{NAMESPACE}/cmd_vel", message)

    def reconfigure(self, **values: float | bool) -> None:
        flags = [{"name": name, "value": value} for name, value in values.items() if isinstance(value, bool)]
        doubles = [{"name": name, "value": value} for name, value in values.items() if not isinstance(value, bool)]
        config = {"config": {"bools": flags, "doubles": doubles}}
        self.graph.call(
            f"{NAMESPACE}/set_parameters", msgs.check(msgs.request_type("dynamic_reconfigure/Reconfigure"), config)
        )

    @property
    def controller(self):
        return self.manager.get("base")

    def wheels(self) -> tuple[float, float]:
        return self.robot.joints["left"].command, self.robot.joints["right"].command

    def keep_driving(self, seconds: float, linear: float, angular: float = 0.0) -> None:
        for _ in range(round(seconds / 0.1)):
            self.drive(linear, angular)
            self.run(100)


@pytest.fixture
def base() -> Base:
    base = Base()
    base.start("base")
    base.run()
    return base


def test_the_wheels_turn_as_the_base_is_to_move(base: Base) -> None:
    base.drive(0.3, 0.4)
    base.run()
    assert base.wheels() == pytest.approx(((0.3 - 0.4 * 0.25) / 0.1, (0.3 + 0.4 * 0.25) / 0.1))


def test_odometry_follows_a_circle(base: Base) -> None:
    base.keep_driving(2.0, 0.5, 0.5)
    base.run()  # odometry is of the wheels before this cycle
    odometry = base.controller.odometry
    heading = 0.5 * 2.0
    assert odometry.heading == pytest.approx(heading, abs=1e-3)
    assert odometry.x == pytest.approx(1.0 * sin(heading), abs=2e-3)
    assert odometry.y == pytest.approx(1.0 * (1.0 - cos(heading)), abs=2e-3)
    assert (odometry.linear, odometry.angular) == pytest.approx((0.5, 0.5))


def test_turning_in_place_goes_nowhere(base: Base) -> None:
    base.keep_driving(1.0, 0.0, pi)
    odometry = base.controller.odometry
    assert (odometry.x, odometry.y) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert odometry.heading == pytest.approx(pi, abs=0.01)


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=60), st.integers(1, 12))
def test_the_rolling_mean_is_that_of_the_last_values(values: list[float], size: int) -> None:
    mean, past = 0.0, [0.0] * size
    for count, value in enumerate(values):
        mean = rolling_mean(mean, value, past, 0, size, count)
    last = values[-size:]
    assert mean == pytest.approx(sum(last) / len(last), abs=1e-9)


@given(st.floats(-3.0, 3.0), st.floats(-1e-5, 1e-5))
def test_a_line_and_a_circle_of_a_large_radius_are_nearly_the_same(length: float, angle: float) -> None:
    odometry = SidesOdometry(10)
    roll(odometry, odometry.past, length - angle / 2.0, length + angle / 2.0, 1.0, 0)
    assert (odometry.x, odometry.heading) == pytest.approx((length, angle), abs=1e-9)
    assert odometry.y == pytest.approx(length * angle / 2.0, abs=1e-9)


def test_a_command_ends_after_the_time_out(base: Base) -> None:
    base.drive(0.5)
    base.run(500)
    assert base.wheels() == (5.0, 5.0)
    base.run(2)
    assert base.wheels() == (0.0, 0.0)


def test_limits_hold_velocity_acceleration_and_jerk() -> None:
    names = ("velocity", "acceleration", "jerk")
    flags = {f"has_{name}_limits": True for name in names}
    limits = {"max_velocity": 0.4, "max_acceleration": 1.0, "max_jerk": 10.0}
    base = Base(linear={"x": flags | limits}, cmd_vel_timeout=9.0)
    base.start("base")
    base.drive(1.0)
    seen = [0.0]
    for _ in range(800):
        base.run()
        seen.append(base.controller.velocity.last_linear)
    accelerations = [(b - a) / STEP_S for a, b in pairwise(seen)]
    jerks = [(b - a) / STEP_S for a, b in pairwise(accelerations)]
    assert max(seen) == pytest.approx(0.4)
    assert max(accelerations) <= 1.0 + 1e-9
    # speed_limiter.cpp bounds the change of the change by 2 jerk dt²: twice the jerk that the name promises
    assert max(jerks[:-500]) <= 2.0 * 10.0 + 1e-6


def test_a_limit_without_its_value_is_zero_and_pointed_out() -> None:
    base = Base(linear={"x": {"has_velocity_limits": True}})
    base.start("base")
    assert "/bot/base/linear/x/has_velocity_limits is true without max_velocity" in base.graph.lines("warn")
    base.drive(1.0)
    base.run()
    assert base.wheels() == (0.0, 0.0)


def test_odometry_is_published_with_its_frames(base: Base) -> None:
    base.drive(1.0)
    base.run(60)
    odom = base.graph.sent(f"{NAMESPACE}/odom")[-1]
    assert (odom["header"]["frame_id"], odom["child_frame_id"]) == ("odom", "base_link")
    assert odom["pose"]["covariance"][::7] == [0.001] * 6
    assert odom["twist"]["covariance"][7] == 0.002
    frame = base.graph.sent("/tf")[-1]["transforms"][0]
    assert frame["transform"]["translation"] == odom["pose"]["pose"]["position"]
    assert msgs.check("nav_msgs/Odometry", odom) == odom
    assert msgs.check("tf2_msgs/TFMessage", {"transforms": [frame]})


def test_the_limited_command_and_the_wheels_are_published_when_asked_for() -> None:
    base = Base(publish_cmd=True, publish_wheel_joint_controller_state=True)
    base.start("base")
    base.drive(0.5)
    base.run(3)
    assert base.graph.sent(f"{NAMESPACE}/cmd_vel_out")[-1]["twist"]["linear"]["x"] == 0.5
    state = base.graph.sent(f"{NAMESPACE}/wheel_joint_controller_state")[-1]
    assert state["joint_names"] == ["left", "right"]
    assert state["actual"]["velocities"] == [5.0, 5.0]
    assert set(base.graph.publishers) >= {f"{NAMESPACE}/cmd_vel_out", f"{NAMESPACE}/wheel_joint_controller_state"}


def test_a_nan_position_leaves_the_wheels_alone(base: Base) -> None:
    base.drive(0.5)
    base.run()
    base.robot.joints["left"].position = nan
    base.drive(0.0)
    base.run()
    assert base.wheels() == (5.0, 5.0)


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_command_that_is_not_finite_is_refused_and_the_last_one_stays(base: Base, value: float) -> None:
    base.drive(0.5)
    with pytest.raises(MessageRefused, match="finite"):
        base.drive(value)
    with pytest.raises(MessageRefused, match="finite"):
        base.drive(0.1, value)
    base.run()
    assert base.wheels() == (5.0, 5.0)


def test_one_to_a_controller_that_is_not_running_is_refused() -> None:
    base = Base()
    base.load("base")
    with pytest.raises(MessageRefused, match="not running"):
        base.drive(0.5)


def test_a_second_publisher_makes_it_brake_where_one_is_allowed() -> None:
    base = Base(allow_multiple_cmd_vel_publishers=False)
    base.start("base")
    base.drive(0.5)
    base.run()
    base.graph.publisher_counts[f"{NAMESPACE}/cmd_vel"] = 2
    with pytest.raises(MessageRefused, match="has 2 publishers, but only 1 is allowed"):
        base.drive(0.7)
    assert base.wheels() == (0.0, 0.0)
    base.run()  # as upstream: the last command counts until it times out
    assert base.wheels() == (5.0, 5.0)


def test_stopping_brakes_and_a_restart_goes_on_with_the_place(base: Base) -> None:
    base.keep_driving(0.5, 0.5)
    base.request(stop=["base"])
    base.run()
    assert base.wheels() == (0.0, 0.0)
    x = base.controller.odometry.x
    base.request(start=["base"])
    base.run(2)
    assert base.controller.odometry.x == pytest.approx(x, abs=1e-3)


def test_when_time_is_put_back_it_starts_from_nothing(base: Base) -> None:
    base.keep_driving(0.5, 0.5)
    base.graph.time_ns = 0
    for joint in base.robot.joints.values():
        joint.position = 0.0
    base.manager.restart_running(0)
    base.run(20)
    assert base.wheels() == (0.0, 0.0)
    assert base.controller.odometry.x == 0.0


class TestGeometry:
    URDF = f"""<robot name="bot"><link name="body">{INERTIA}</link>
      <link name="l">{INERTIA}<collision><geometry>SHAPE</geometry></collision></link>
      <link name="r">{INERTIA}</link>
      <joint name="left" type="continuous"><parent link="body"/><child link="l"/><origin xyz="0 0.3 0"/></joint>
      <joint name="right" type="continuous"><parent link="body"/><child link="r"/><origin xyz="0 -0.1 0"/></joint>
    </robot>"""

    def base(self, shape: str, **parameters: object) -> Base:
        base = Base(**{"wheel_separation": None, "wheel_radius": None} | parameters)
        base.graph.set("/bot/robot_description", self.URDF.replace("SHAPE", shape))
        return base

    @pytest.mark.parametrize("shape", ['<cylinder radius="0.2" length="0.1"/>', '<sphere radius="0.2"/>'])
    def test_it_is_that_of_the_model_unless_the_parameters_say_it(self, shape: str) -> None:
        base = self.base(shape)
        base.start("base")
        base.drive(1.0, 1.0)
        base.run()
        assert base.wheels() == pytest.approx(((1.0 - 0.2) / 0.2, (1.0 + 0.2) / 0.2))

    def test_a_wheel_of_another_shape_is_refused(self) -> None:
        base = self.base('<box size="1 1 1"/>')
        assert not base.manager.load("base")
        assert "link 'l' of wheel 'left' has no cylinder or sphere" in base.graph.lines("error")

    def test_a_description_further_up_is_not_looked_for(self) -> None:
        base = self.base("<sphere radius='1'/>")
        base.graph.set("/robot_description", base.graph.get("/bot/robot_description"))
        base.graph.delete("/bot/robot_description")
        assert not base.manager.load("base")
        assert "parameter /bot/robot_description is not set" in base.graph.lines("error")

    def test_a_wheel_that_the_model_has_not_is_refused(self) -> None:
        base = self.base("<sphere radius='1'/>", left_wheel="other")
        assert not base.manager.load("base")
        assert "no joint 'other' in robot_description" in base.graph.lines("error")


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"left_wheel": None}, "/bot/base/left_wheel is not set; it must be a string or a list of strings"),
        ({"left_wheel": []}, "/bot/base/left_wheel must name at least one joint"),
        ({"left_wheel": 7}, "/bot/base/left_wheel must be a string or a list of strings"),
        ({"left_wheel": ["left", 7]}, "/bot/base/left_wheel must be a string or a list of strings"),
        ({"left_wheel": ["left", "right"]}, "2 left wheels and 1 right wheels"),
        ({"left_wheel": "nope"}, "joint 'nope'"),
        ({"pose_covariance_diagonal": None}, "pose_covariance_diagonal is not set; it must be a list of six floats"),
        ({"pose_covariance_diagonal": [0.1] * 5}, "pose_covariance_diagonal must be a list of six floats"),
        ({"twist_covariance_diagonal": [1] * 6}, "twist_covariance_diagonal must be a list of six floats"),
        ({"publish_rate": 0.0}, "publish_rate must be a rate above 0"),
        ({"velocity_rolling_window_size": 0}, "velocity_rolling_window_size must be 1 to 100000, not 0"),
        ({"velocity_rolling_window_size": 10**9}, "velocity_rolling_window_size must be 1 to 100000, not 1000000000"),
        ({"wheel_radius": 0.0}, "the wheel_radius of /bot/base must be a length other than 0"),
        ({"wheel_separation_multiplier": 0.0}, "wheel_separation_multiplier must be a number other than 0"),
    ],
)
def test_it_is_not_loaded_with_parameters_that_it_cannot_follow(parameters: dict, text: str) -> None:
    base = Base(**parameters)
    assert not base.manager.load("base")
    assert text in base.graph.lines("error")
    assert not base.graph.subscribers


class TestReconfiguring:
    def test_multipliers_change_by_the_service_and_stand_in_the_parameters(self, base: Base) -> None:
        base.reconfigure(left_wheel_radius_multiplier=1.25)
        base.drive(0.5)
        base.run()
        assert base.wheels() == pytest.approx((4.0, 5.0))
        assert base.graph.get(f"{NAMESPACE}/left_wheel_radius_multiplier") == 1.25
        assert base.graph.sent(f"{NAMESPACE}/parameter_updates")[-1]["doubles"][0]["value"] == 1.25

    def test_values_are_brought_into_their_ranges(self, base: Base) -> None:
        base.reconfigure(left_wheel_radius_multiplier=9.0)
        assert base.graph.get(f"{NAMESPACE}/left_wheel_radius_multiplier") == 1.5

    def test_multipliers_change_by_the_parameters(self, base: Base) -> None:
        base.graph.set(f"{NAMESPACE}/wheel_separation_multiplier", 2.0)
        base.drive(0.0, 1.0)
        base.run()
        assert base.wheels() == pytest.approx((-5.0, 5.0))

    def test_the_frame_can_be_switched_off(self, base: Base) -> None:
        base.reconfigure(enable_odom_tf=False)
        before = len(base.graph.sent("/tf"))
        base.run(100)
        assert len(base.graph.sent("/tf")) == before

    @pytest.mark.parametrize("rate", [0.0, -3.0])
    def test_a_rate_of_nothing_is_refused(self, base: Base, rate: float) -> None:
        with pytest.raises(Refused, match="publish_rate must be a rate above 0"):
            base.reconfigure(publish_rate=rate)
        with pytest.raises(Refused, match="publish_rate must be a rate above 0"):
            base.graph.set(f"{NAMESPACE}/publish_rate", rate)
        assert base.graph.get(f"{NAMESPACE}/publish_rate") == 50.0

    @pytest.mark.parametrize("rate", [1e-12, 1e10])
    def test_a_rate_whose_period_no_clock_can_count_does_not_stand_in_the_parameters(
        self, base: Base, rate: float
    ) -> None:
        with pytest.raises(Refused, match="publish_rate must be a rate above 0"):
            base.graph.set(f"{NAMESPACE}/publish_rate", rate)
        assert base.graph.get(f"{NAMESPACE}/publish_rate") == 50.0
