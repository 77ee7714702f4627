"""diff_drive_controller of ROS 2: limits and odometry against numbers of their own, time-outs, frames, refusals."""

from __future__ import annotations

from itertools import pairwise
from math import cos, inf, nan, pi, sin
from typing import Any

import numpy as np
import pytest
from fake_robot import STEP_S, Bench, FakeRobot
from hypothesis import given
from hypothesis import strategies as st

from slidectl import msgs
from slidectl.control.ros2_base import VelocityLimiter
from slidectl.errors import MessageRefused, Refused

NAMESPACE = "/bot/base"
SIDES = {"left_wheel_names": ["left"], "right_wheel_names": ["right"]}
GEOMETRY = {"wheel_separation": 0.5, "wheel_radius": 0.1}


class Base(Bench):
    """A base whose wheels turn as they are commanded."""

    def __init__(self, joints: tuple[str, ...] = ("left", "right"), **parameters: Any) -> None:
        values = {"type": "diff_drive_controller/DiffDriveController", **SIDES, **GEOMETRY, **parameters}
        own = {name: value for name, value in values.items() if value is not None}
        super().__init__(FakeRobot(joints, ("velocity",)), {"base": own})

    def run(self, cycles: int = 1, **more: Any) -> None:
        for _ in range(cycles):
            super().run(**more)
            for joint in self.robot.joints.values():
                joint.velocity = joint.command
                joint.position += joint.command * STEP_S

    def drive(self, linear: float, angular: float = 0.0, stamp_ms: int = 0) -> None:
        stamp = {"secs": stamp_ms // 1000, "nsecs": stamp_ms % 1000 * 1_000_000}
        twist = {"linear": {"x": linear}, "angular": {"z": angular}}
        message = msgs.check("geometry_msgs/TwistStamped", {"header": {"stamp": stamp}, "twist": twist})
        self.graph.send(f"{NAMESPACE}/cmd_vel", message)

    def keep_driving(self, cycles: int, linear: float, angular: float = 0.0) -> None:
        for _ in range(cycles // 100):
            self.drive(linear, angular)
            self.run(100)

    @property
    def controller(self) -> Any:
        return self.manager.get("base")

    @property
    def odom(self) -> dict[str, Any]:
        return self.graph.sent(f"{NAMESPACE}/odom")[-1]

    def pose(self) -> tuple[float, float, float]:
        pose = self.odom["pose"]["pose"]
        return pose["position"]["x"], pose["position"]["y"], 2.0 * np.arctan2(*map(pose["orientation"].get, "zw"))

    def wheels(self) -> tuple[float, float]:
        return self.robot.joints["left"].command, self.robot.joints["right"].command

    def set_odometry(self, **pose: float) -> dict[str, Any]:
        request = msgs.check(msgs.request_type("control_msgs/SetOdometry"), pose)
        return self.graph.call(f"{NAMESPACE}/set_odometry", request)


def started(**parameters: Any) -> Base:
    base = Base(**parameters)
    base.start("base")
    base.run()
    return base


# -- wheels and commands -----------------------------------------------------------------------------------------------


def test_the_wheels_turn_as_the_base_is_to_move() -> None:
    base = started(wheel_separation_multiplier=1.5, left_wheel_radius_multiplier=0.5, right_wheel_radius_multiplier=2.0)
    base.drive(0.3, 0.4)
    base.run()
    assert base.wheels() == pytest.approx(((0.3 - 0.4 * 0.375) / 0.05, (0.3 + 0.4 * 0.375) / 0.2))


def test_all_wheels_of_a_side_get_the_same_command() -> None:
    sides = {"left_wheel_names": ["l1", "l2"], "right_wheel_names": ["r1", "r2"]}
    base = Base(("l1", "l2", "r1", "r2"), **sides)
    base.start("base")
    base.drive(0.3, 0.4)
    base.run()
    assert [joint.command for joint in base.robot.joints.values()] == pytest.approx([2.0, 2.0, 4.0, 4.0])


def test_nothing_is_commanded_or_published_before_the_first_command_or_the_time_out() -> None:
    base = started(cmd_vel_timeout=0.05)
    base.robot.joints["left"].command = 7.0
    base.run(48)  # cycles 3 to 50
    assert base.robot.joints["left"].command == 7.0
    assert base.graph.sent(f"{NAMESPACE}/odom") == []
    base.run()
    assert base.wheels() == (0.0, 0.0)
    assert len(base.graph.sent(f"{NAMESPACE}/odom")) == 1
    assert not base.graph.lines("warn")


def test_without_a_time_out_a_command_is_awaited_and_then_stays() -> None:
    base = started(cmd_vel_timeout=0.0)
    base.run(1000)
    assert base.graph.sent(f"{NAMESPACE}/odom") == []
    base.drive(0.3)
    base.run(3000)
    assert base.wheels() == pytest.approx((3.0, 3.0))


def test_a_command_ends_after_the_time_out_of_its_stamp_and_brakes_within_the_limits() -> None:
    base = started(linear={"x": {"max_acceleration": 1000.0, "max_deceleration": -2.0}})
    base.run(498)
    base.drive(0.5, stamp_ms=400)  # it is 500 ms
    base.run(400)
    assert base.wheels() == pytest.approx((5.0, 5.0))
    base.run(1)
    assert base.wheels() == pytest.approx((4.98, 4.98))  # 2 m/s² over 1 ms
    base.run(300)
    assert base.wheels() == (0.0, 0.0)
    assert base.graph.lines("warn") == f"{NAMESPACE}: the command on cmd_vel is older than 0.5 s: the base stops"


def test_a_command_without_a_stamp_counts_from_its_arrival_which_is_reported_once() -> None:
    base = started(cmd_vel_timeout=0.1)
    base.drive(0.5)
    base.drive(0.5)
    base.run(100)
    assert base.wheels() == pytest.approx((5.0, 5.0))
    assert base.graph.lines("warn") == f"{NAMESPACE}: the command has no stamp, and counts from its arrival"
    base.run()
    assert base.wheels() == (0.0, 0.0)


def test_a_command_that_is_too_old_is_refused() -> None:
    base = started(cmd_vel_timeout=0.1)
    base.run(298)
    base.drive(0.25, stamp_ms=201)
    with pytest.raises(MessageRefused, match=r"its stamp is 0\.1 s old, the time-out 0\.1 s"):
        base.drive(0.5, stamp_ms=200)
    base.run()
    assert base.wheels() == pytest.approx((2.5, 2.5))


def test_a_stamp_of_another_clock_is_reported() -> None:
    base = started()
    base.drive(0.5, stamp_ms=1_000_000)
    assert "s ahead of the simulated time: it does not end before that" in base.graph.lines("warn")


@pytest.mark.parametrize("value", [nan, inf])
def test_a_command_that_is_not_finite_is_refused(value: float) -> None:
    base = started()
    base.drive(0.25)
    with pytest.raises(MessageRefused, match="finite numbers"):
        base.drive(value)
    base.run()
    assert base.wheels() == pytest.approx((2.5, 2.5))


def test_a_stop_brakes_and_forgets_the_command() -> None:
    base = started(linear={"x": {"max_acceleration": 1.0}})
    base.drive(0.5)
    base.run(300)
    assert base.request(stop=["base"])
    base.run()
    assert base.wheels() == (0.0, 0.0)
    with pytest.raises(MessageRefused, match="/bot/base does not run and accepts no commands"):
        base.drive(0.5)
    assert base.request(start=["base"])
    base.run(2)
    base.drive(0.5)
    base.run()
    assert base.wheels() == pytest.approx((0.01, 0.01))  # from rest again


def test_it_runs_at_its_own_rate() -> None:
    base = started(update_rate=100, linear={"x": {"max_acceleration": 1.0}})
    base.drive(0.5)
    base.run(100)
    assert len(base.graph.sent(f"{NAMESPACE}/odom")) == 10
    assert base.wheels() == pytest.approx((1.0, 1.0))  # 10 periods of 10 ms


# -- limits ------------------------------------------------------------------------------------------------------------


def limiter_with(**limits: float) -> VelocityLimiter:
    base = Base(linear={"x": limits})
    base.load("base")
    return base.controller.limiters[0]


def speeds(limiter: VelocityLimiter, wanted: list[float], period_s: float = 0.1) -> list[float]:
    return [limiter.follow(each, period_s) for each in wanted]


def test_the_defaults_of_the_limits_are_each_others_negatives() -> None:
    limiter = limiter_with(max_velocity=1.0, max_acceleration=2.0, max_jerk=3.0)
    assert (limiter.velocity, limiter.jerk) == ((-1.0, 1.0), (-3.0, 3.0))
    assert limiter.acceleration == (2.0, -2.0, -2.0, 2.0)
    assert limiter_with(max_acceleration=2.0, max_acceleration_reverse=-0.5).acceleration == (2.0, -0.5, -0.5, 2.0)
    unset = limiter_with(max_velocity=nan, min_velocity=-1.0, max_deceleration=-1.0, min_jerk=-1.0)
    assert (unset.velocity, unset.acceleration, unset.jerk) == (None, None, None)


def test_each_direction_has_its_acceleration_and_its_braking() -> None:
    limits = {"max_acceleration": 1.0, "max_deceleration": -2.0}
    limiter = limiter_with(**limits, max_acceleration_reverse=-3.0, max_deceleration_reverse=4.0)
    forwards = speeds(limiter, [1.0, 1.0, -1.0, -1.0, -1.0])
    assert forwards == pytest.approx([0.1, 0.2, 0.0, -0.3, -0.6])
    assert speeds(limiter, [1.0, 1.0, 1.0]) == pytest.approx([-0.2, 0.2, 0.3])


def test_velocities_are_clamped_on_both_sides() -> None:
    limiter = limiter_with(max_velocity=0.5, min_velocity=-0.2)
    assert speeds(limiter, [2.0, 0.3, -2.0]) == [0.5, 0.3, -0.2]


def test_the_jerk_is_bounded_while_the_change_grows_only() -> None:
    limiter = limiter_with(max_jerk=1.0)
    # The change may grow by 1 · 0.5² = 0.25 per period. To end it is allowed at once.
    assert speeds(limiter, [9.0, 9.0, 9.0], 0.5) == [0.25, 0.75, 1.5]
    assert speeds(limiter, [1.5, 1.75], 0.5) == [1.5, 1.75]
    # From a change of 0.25 to one of -0.25 is -0.5, which is cut to -0.25: a change of 0.
    assert speeds(limiter, [1.5, 1.5], 0.5) == [1.75, 1.5]


LIMIT = st.floats(0.0, 5.0)


@given(LIMIT, LIMIT, LIMIT, LIMIT, st.lists(st.floats(-4.0, 4.0), max_size=30), st.floats(0.001, 0.2))
def test_no_limit_is_exceeded(
    fastest: float, speeding: float, braking: float, reverse: float, wanted: list[float], period_s: float
) -> None:
    limits = {"max_acceleration": speeding, "max_deceleration": -braking, "max_acceleration_reverse": -reverse}
    found = [0.0, *speeds(limiter_with(max_velocity=fastest, **limits), wanted, period_s)]
    assert np.all(np.abs(found) <= fastest)
    for last, new in pairwise(found):
        least = -braking if last > 0.0 else -reverse
        assert least * period_s - 1e-12 <= new - last <= speeding * period_s + 1e-12 or abs(new) == fastest


def test_limits_of_the_two_velocities_are_apart_and_the_limited_command_is_published() -> None:
    limits = {"linear": {"x": {"max_velocity": 0.2}}, "angular": {"z": {"max_velocity": 0.5}}}
    base = started(publish_limited_velocity=True, **limits)
    base.drive(1.0, -1.0)
    base.run()
    twist = base.graph.sent(f"{NAMESPACE}/cmd_vel_out")[-1]["twist"]
    assert (twist["linear"]["x"], twist["angular"]["z"]) == (0.2, -0.5)


def test_limits_change_while_it_runs_and_can_be_switched_on() -> None:
    base = started()
    base.drive(1.0)
    base.run()
    base.graph.set(f"{NAMESPACE}/linear/x/max_velocity", 0.25)
    base.run()
    assert base.wheels() == pytest.approx((2.5, 2.5))


@pytest.mark.parametrize(
    ("name", "value", "side"),
    [("max_velocity", -1.0, "above"), ("min_velocity", 1.0, "below"), ("max_deceleration", 0.5, "below")],
)
def test_a_limit_of_the_wrong_sign_is_refused(name: str, value: float, side: str) -> None:
    text = f"parameter {NAMESPACE}/angular/z/{name} must be 0 or {side}, not {value:g}"
    base = Base(angular={"z": {name: value}})
    assert not base.manager.load("base")
    assert text in base.graph.lines("error")
    base = started()
    with pytest.raises(Refused, match=text):
        base.graph.set(f"{NAMESPACE}/angular/z/{name}", value)


# -- odometry ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("feedback", [{}, {"position_feedback": False}, {"open_loop": True}])
def test_odometry_follows_a_circle(feedback: dict[str, bool]) -> None:
    base = started(**feedback)
    base.keep_driving(2000, 0.5, 0.5)
    x, y, heading = base.pose()
    travelled = 1.0 if "open_loop" in feedback else 0.9995  # the wheels are measured before their command
    assert heading == pytest.approx(travelled)
    assert (x, y) == pytest.approx((sin(travelled), 1.0 - cos(travelled)))
    twist = base.odom["twist"]["twist"]
    assert (twist["linear"]["x"], twist["angular"]["z"]) == pytest.approx((0.5, 0.5))


def test_odometry_is_the_sum_of_arcs() -> None:
    base = started()
    dice = np.random.default_rng(5)
    pose, wheels = np.zeros(3), []
    for _ in range(50):
        base.drive(*dice.uniform(-1.0, 1.0, 2) * (1.0, dice.choice((0.0, 1.0))))
        base.run()
        wheels.append(base.wheels())
    base.run()
    for left, right in wheels:
        way, turn = 0.1 * STEP_S * (left + right) / 2.0, 0.1 * STEP_S * (right - left) / 0.5
        chord = way if turn == 0.0 else way * sin(turn / 2.0) / (turn / 2.0)
        direction = pose[2] if abs(turn) < 1e-6 else pose[2] + turn / 2.0
        pose += (chord * cos(direction), chord * sin(direction), turn)
    assert base.pose() == pytest.approx(tuple(pose), abs=1e-12)


def test_the_published_velocities_are_means_over_the_window() -> None:
    base = started(velocity_rolling_window_size=4)
    commands = [0.1, 0.5, -0.2, 0.9, 0.3, 0.7]
    found = []
    for command in commands:
        base.drive(command)
        base.run()
        found.append(base.odom["twist"]["twist"]["linear"]["x"])
    measured = [0.0, *commands[:-1]]
    expected = [np.mean(measured[max(0, k - 3) : k + 1]) for k in range(len(measured))]
    assert found == pytest.approx(expected)


def test_set_odometry_places_the_base_and_clears_the_means() -> None:
    base = started()
    base.keep_driving(200, 0.5, 0.2)
    base.drive(0.0)
    base.run(2)
    assert base.set_odometry(x=3.0, y=-1.0, yaw=pi / 2) == {
        "success": True,
        "message": "Odometry set request accepted",
    }
    base.run()
    assert base.pose() == pytest.approx((3.0, -1.0, pi / 2))
    assert base.odom["twist"]["twist"]["linear"]["x"] == 0.0
    base.keep_driving(100, 0.5)
    assert base.pose() == pytest.approx((3.0, -1.0 + 0.0495, pi / 2))


def test_set_odometry_is_refused_when_it_cannot_be_done() -> None:
    base = started()
    assert not base.set_odometry(x=nan)["success"]
    assert base.request(stop=["base"])
    base.run()
    assert base.set_odometry(x=1.0) == {"success": False, "message": "Controller is not active"}


def test_the_pose_outlives_a_stop_and_not_a_reset_of_time() -> None:
    base = started()
    base.keep_driving(200, 0.5)
    assert base.request(stop=["base"])
    base.run()
    assert base.request(start=["base"])
    base.run()
    base.keep_driving(100, 0.0)
    assert base.pose()[0] == pytest.approx(0.1)
    base.graph.time_ns = 0
    for joint in base.robot.joints.values():
        joint.position = 0.0
    base.run(reset_controllers=True)
    base.keep_driving(100, 0.5)
    assert base.pose()[0] == pytest.approx(0.0495)


def test_a_wheel_whose_state_is_not_a_number_aborts_the_controller() -> None:
    base = started()
    base.keep_driving(100, 0.5)
    base.robot.joints["left"].position = nan
    base.run()
    assert base.states() == {"base": "aborted"}
    assert base.wheels() == (0.0, 0.0)


def test_covariances_stand_on_the_diagonals() -> None:
    base = started(pose_covariance_diagonal=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    base.drive(0.5)
    base.run()
    assert np.array_equal(np.reshape(base.odom["pose"]["covariance"], (6, 6)), np.diag([1.0, 2, 3, 4, 5, 6]))
    assert base.odom["twist"]["covariance"] == [0.0] * 36


@pytest.mark.parametrize(
    ("parameters", "frames"),
    [
        ({}, ("bot/odom", "bot/base_link")),
        ({"tf_frame_prefix_enable": False}, ("odom", "base_link")),
        ({"tf_frame_prefix": "/left/"}, ("left/odom", "left/base_link")),
        ({"tf_frame_prefix": "~/a", "odom_frame_id": "map"}, ("bot/a/map", "bot/a/base_link")),
    ],
)
def test_frames_have_their_prefix_on_both_topics(parameters: dict[str, Any], frames: tuple[str, str]) -> None:
    base = started(**parameters)
    base.drive(0.5)
    base.run()
    assert (base.odom["header"]["frame_id"], base.odom["child_frame_id"]) == frames
    transform = base.graph.sent("/tf")[-1]["transforms"][0]
    assert (transform["header"]["frame_id"], transform["child_frame_id"]) == frames
    base.graph.set(f"{NAMESPACE}/enable_odom_tf", False)
    base.run(5)
    assert len(base.graph.sent("/tf")) == 1


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"left_wheel_names": []}, f"parameter {NAMESPACE}/left_wheel_names must name at least one joint"),
        ({"left_wheel_names": ["left", "right"]}, f"{NAMESPACE} has 2 left wheels and 1 right wheels"),
        ({"left_wheel_names": ["lift"]}, "no joint 'lift'"),
        ({"wheel_radius": 0.0}, f"parameter {NAMESPACE}/wheel_radius must be a length above 0, not 0"),
        ({"wheel_separation": None}, f"parameter {NAMESPACE}/wheel_separation is not set"),
        ({"velocity_rolling_window_size": 0}, "must be 1 to 100000, not 0"),
    ],
)
def test_what_makes_no_base_is_not_loaded(parameters: dict[str, Any], text: str) -> None:
    base = Base(**parameters)
    assert not base.manager.load("base")
    assert text in base.graph.lines("error")


def test_the_geometry_is_fixed_when_the_controller_is_loaded() -> None:
    base = started()
    with pytest.raises(Refused, match=f"{NAMESPACE}/wheel_radius is fixed when the controller is loaded"):
        base.graph.set(f"{NAMESPACE}/wheel_radius", 0.2)


def test_a_load_leaves_the_wheels_to_the_controller_that_drives_them() -> None:
    base = Base()
    base.robot.joints["left"].command = 3.0
    base.load("base")
    assert base.robot.joints["left"].command == 3.0
