"""The trajectory controller: splines against a linear system, what is refused, goals, tolerances, and its interfaces.

The recorded runs of test_control_conformance.py hold its numbers; these tests are about what a user meets.
"""

from __future__ import annotations

from itertools import product
from math import inf, nan, pi

import numpy as np
import pytest
from fake_robot import STEP_S, Bench, FakeRobot
from hypothesis import given
from hypothesis import strategies as st

from slidectl import msgs
from slidectl.control import segments
from slidectl.control.controllers.joint_trajectory import wraparound_offset
from slidectl.control.node_handle import GoalStatus
from slidectl.errors import MessageRefused, Refused

NAMESPACE = "/bot/arm"
ACTION = f"{NAMESPACE}/follow_joint_trajectory"
INERTIA = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
LIMIT = '<limit lower="-3" upper="3" effort="9" velocity="9"/>'
URDF = f"""<robot name="bot"><link name="world"/><link name="a">{INERTIA}</link><link name="b">{INERTIA}</link>
  <joint name="j1" type="revolute"><parent link="world"/><child link="a"/><axis xyz="0 0 1"/>{LIMIT}</joint>
  <joint name="j2" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>"""
GAINS = {"gains": {"j1": {"p": 1.0}, "j2": {"p": 1.0}}}
VARIANTS = {
    "position": "position_controllers/JointTrajectoryController",
    "velocity": "velocity_controllers/JointTrajectoryController",
    "effort": "effort_controllers/JointTrajectoryController",
    "pos_vel": "pos_vel_controllers/JointTrajectoryController",
    "pos_vel_acc": "pos_vel_acc_controllers/JointTrajectoryController",
}


class Arm(Bench):
    """Two joints that are where they are commanded to be, one cycle late, and the topics as a client sees them."""

    def __init__(self, kind: str = "position", **parameters: object) -> None:
        super().__init__(
            FakeRobot(("j1", "j2"), (kind,)), {"arm": {"type": VARIANTS[kind], "joints": ["j1", "j2"], **parameters}}
        )
        self.graph.set("/bot/robot_description", URDF)
        self.follows = True
        self.sent = 0

    def run(self, cycles: int = 1, **more: object) -> None:
        for _ in range(cycles):
            super().run(**more)
            for joint in self.robot.joints.values() if self.follows else ():
                joint.velocity = (joint.command - joint.position) / STEP_S
                joint.position = joint.command

    def command(self, *points: dict, joints: tuple[str, ...] = ("j1", "j2"), stamp: float = 0.0) -> None:
        message = trajectory(points, joints, stamp)
        self.graph.send(f"{NAMESPACE}/command", msgs.check("trajectory_msgs/JointTrajectory", message))

    def goal(self, *points: dict, joints: tuple[str, ...] = ("j1", "j2"), **more: object) -> str:
        self.sent += 1
        name = f"g{self.sent}"
        goal = {"trajectory": trajectory(points, joints), **more}
        message = msgs.check("control_msgs/FollowJointTrajectoryActionGoal", {"goal_id": {"id": name}, "goal": goal})
        self.graph.send(f"{ACTION}/goal", message)
        return name

    def cancel(self, name: str) -> None:
        self.graph.send(f"{ACTION}/cancel", msgs.check("actionlib_msgs/GoalID", {"id": name}))

    def results(self) -> list[tuple[str, GoalStatus, int, str]]:
        return [
            (
                m["status"]["goal_id"]["id"],
                m["status"]["status"],
                m["result"]["error_code"],
                m["result"]["error_string"],
            )
            for m in self.graph.sent(f"{ACTION}/result")
        ]

    def positions(self) -> tuple[float, float]:
        return self.robot.joints["j1"].position, self.robot.joints["j2"].position


def point(seconds: float, *positions: float, **more: list[float]) -> dict:
    nanoseconds = round(seconds * 1e9)
    time = {"secs": nanoseconds // 10**9, "nsecs": nanoseconds % 10**9}
    return {"positions": list(positions), "time_from_start": time, **more}


def trajectory(points: tuple[dict, ...], joints: tuple[str, ...], stamp: float = 0.0) -> dict:
    nanoseconds = round(stamp * 1e9)
    header = {"stamp": {"secs": nanoseconds // 10**9, "nsecs": nanoseconds % 10**9}}
    return {"header": header, "joint_names": list(joints), "points": list(points)}


BAD = [
    ([point(0.1, 1.0, 1.0), point(0.1, 2.0, 2.0)], ("j1", "j2"), "not strictly increasing in time"),
    ([point(0.2, 1.0, 1.0), point(0.1, 2.0, 2.0)], ("j1", "j2"), "not strictly increasing in time"),
    ([point(0.1, 1.0)], ("j1",), "does not contain the expected joints"),
    ([point(0.1, 1.0, 1.0)], ("j1", "nope"), "does not contain the expected joints"),
    ([point(0.1, 1.0, 1.0, 1.0)], ("j1", "j2", "j2"), "does not contain the expected joints"),
    ([point(0.1, 1.0)], (), "does not contain the expected joints"),
    ([point(0.1, 1.0, 1.0, velocities=[1.0])], ("j1", "j2"), "Size mismatch in trajectory point"),
    ([point(0.1, 1.0, 1.0, accelerations=[1.0])], ("j1", "j2"), "Size mismatch in trajectory point"),
    ([point(0.1)], ("j1", "j2"), "Size mismatch between trajectory point"),
    ([point(0.1, 1.0, 1.0), point(0.2)], ("j1", "j2"), "Start/end points data size mismatch"),
    ([point(0.1, 1.0)], ("j1", "j2"), "has 1 positions for 2 joints"),
    ([point(0.1, nan, 1.0)], ("j1", "j2"), "must have finite numbers"),
    ([point(0.1, 1.0, 1.0, velocities=[inf, 0.0])], ("j1", "j2"), "must have finite numbers"),
    (
        [point(2.0, 1.0, 1.0, velocities=[0.0, 0.0]), point(2.5, 1.0, 1.0, velocities=[0.0, 1e308])],
        ("j1", "j2"),
        "joint 'j2' cannot move to point 2 within 0.5 s: its position on the way is too large",
    ),
    (
        [point(0.2, 1.0, 1.0, velocities=[0.0, 0.0], accelerations=[1e308, 0.0])],
        ("j1", "j2"),
        "joint 'j1' cannot move to point 1 within 0.2 s: its position on the way is too large for a number",
    ),
    (
        [point(0.1, 1e308, 1.0)],
        ("j1", "j2"),
        "joint 'j1' cannot move to point 1 within 0.1 s: its position on the way is too large",
    ),
    ([point(-0.01, 1.0, 1.0)], ("j1", "j2"), "Dropping all 1 trajectory point"),
    ([point(0.0, 1.0, 1.0)], ("j1", "j2"), "Dropping all 1 trajectory point"),
]
"""Points and joints that no trajectory can be made of, and what is said."""


@pytest.fixture
def arm() -> Arm:
    arm = Arm(constraints={"goal_time": 0.05})
    arm.start("arm")
    return arm


finite = st.floats(-10.0, 10.0)


def spline(start: list[float], end: list[float], t: float) -> tuple[float, ...]:
    """The coefficients of one segment."""
    states = ([[value] for value in state] for state in (start, end))
    return tuple(segments.between([0.0], next(states), [t], next(states))[0, segments.C0 : segments.C5 + 1])


class TestSplines:
    @given(st.lists(finite, min_size=6, max_size=6), st.floats(0.01, 10.0), st.sampled_from([2, 4, 6]))
    def test_the_polynomial_of_least_order_meets_both_ends(self, ends: list[float], t: float, terms: int) -> None:
        orders = terms // 2
        rows = []
        for x, order in product((0.0, t), range(orders)):
            derivative = [np.polynomial.Polynomial.basis(k).deriv(order)(x) for k in range(terms)]
            rows.append(derivative)
        given = [ends[0], ends[2], ends[4]][:orders] + [ends[1], ends[3], ends[5]][:orders]
        expected = np.linalg.solve(np.array(rows), np.array(given))
        said = [value if k < terms else nan for k, value in enumerate(ends)]
        found = spline(said[0::2], said[1::2], t)
        scale = np.array([t**k for k in range(terms)])
        assert np.allclose(np.array(found[:terms]) * scale, expected * scale, atol=1e-6)
        assert found[terms:] == (0.0,) * (6 - terms)

    @given(st.lists(finite, min_size=6, max_size=6), finite)
    def test_velocity_and_acceleration_are_the_derivatives(self, coefficients: list[float], x: float) -> None:
        polynomial = np.polynomial.Polynomial(coefficients)
        expected = [polynomial.deriv(order)(x) if order else polynomial(x) for order in range(3)]
        assert segments.evaluate([0.0] * segments.C0 + coefficients, x) == pytest.approx(expected, abs=1e-6)

    @pytest.mark.parametrize(("v1", "a1"), [(nan, 1.0), (nan, nan)])
    def test_an_end_without_velocity_makes_it_a_line(self, v1: float, a1: float) -> None:
        assert spline([1.0, 9.0, 9.0], [3.0, v1, a1], 2.0) == (1.0, 1.0, 0.0, 0.0, 0.0, 0.0)

    def test_outside_of_a_segment_it_rests_at_its_ends_and_at_the_end_it_still_moves(self) -> None:
        rows = segments.between([1.0], [[0.0], [nan], [nan]], [2.0], [[1.0], [nan], [nan]])
        assert segments.sample_at(rows, 0.5) == (0.0, 0.0, 0.0)
        assert segments.sample_at(rows, 2.0) == (1.0, 1.0, 0.0)
        assert segments.sample_at(rows, 2.0000001) == (1.0, 0.0, 0.0)

    def test_no_time_at_all_is_a_step(self) -> None:
        assert spline([1.0, 2.0, 3.0], [5.0, 0.0, 0.0], 0.0) == (1.0, 2.0, 1.5, 0.0, 0.0, 0.0)
        assert spline([1.0, 2.0, 3.0], [5.0, nan, nan], 0.0) == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def test_a_segment_that_ends_before_it_starts_is_refused(self) -> None:
        with pytest.raises(Refused, match="end_time < start_time"):
            segments.between([1.0], [[0.0], [nan], [nan]], [0.5], [[0.0], [nan], [nan]])

    @given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
    def test_a_continuous_joint_goes_no_farther_than_half_a_turn(self, start: float, end: float) -> None:
        moved = end + wraparound_offset(start, end)
        assert abs(moved - start) <= pi + 1e-9
        assert (moved - end) / (2.0 * pi) == pytest.approx(round((moved - end) / (2.0 * pi)), abs=1e-9)


@pytest.mark.parametrize("kind", VARIANTS)
class TestVariants:
    def test_it_claims_its_joints_and_holds_them(self, kind: str) -> None:
        arm = Arm(kind, **GAINS if kind in ("effort", "velocity") else {})
        arm.follows = False
        arm.robot.joints["j1"].position = 0.5
        arm.start("arm")
        arm.run()
        assert arm.manager.list()[0]["claimed_resources"][0]["resources"] == ["j1", "j2"]
        assert [motion.position for motion in arm.manager.get("arm").motions] == [0.5, 0.0]

    def test_it_is_not_loaded_without_its_interface(self, kind: str) -> None:
        arm = Arm(kind)
        arm.robot = FakeRobot(("j1", "j2"), ())
        arm.manager._hw = arm.robot
        assert not arm.manager.load("arm")
        assert "JointInterface, which this robot does not have" in arm.graph.lines("error")


def test_effort_and_velocity_need_gains() -> None:
    for kind in ("effort", "velocity"):
        arm = Arm(kind, gains={"j1": {"p": 1.0}})
        assert not arm.manager.load("arm")
        assert "parameter /bot/arm/gains/j2/p is not set" in arm.graph.lines("error")


def test_feed_forward_adds_to_the_pid() -> None:
    arm = Arm("velocity", velocity_ff={"j1": 0.5}, **GAINS)
    arm.follows = False
    arm.start("arm")
    arm.command(point(1.0, 1.0, 0.0))
    arm.run(2)
    controller = arm.manager.get("arm")
    assert arm.robot.joints["j1"].command == 0.5 * controller.motions[0].velocity + controller.motions[0].position_error


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"joints": []}, "/bot/arm/joints must name at least one joint"),
        ({"joints": "j1"}, "/bot/arm/joints must be a list of strings"),
        ({"joints": ["j1", 7]}, "/bot/arm/joints must be a list of strings"),
        ({"joints": ["j1", "nope"]}, "joint 'nope'"),
        ({"state_publish_rate": 0}, "/bot/arm/state_publish_rate must be a rate above 0, not 0"),
        ({"state_publish_rate": -5.0}, "must be a rate above 0, not -5"),
        ({"state_publish_rate": nan}, "must be a rate above 0, not nan"),
        ({"action_monitor_rate": 0.0}, "/bot/arm/action_monitor_rate must be a rate above 0, not 0"),
        ({"stop_trajectory_duration": -1.0}, "/bot/arm/stop_trajectory_duration must not be below 0"),
    ],
)
def test_it_is_not_loaded_with_parameters_that_it_cannot_follow(parameters: dict, text: str) -> None:
    arm = Arm(**parameters)
    assert not arm.manager.load("arm")
    assert text in arm.graph.lines("error")
    assert not arm.graph.subscribers


def test_it_is_not_loaded_without_a_robot_description() -> None:
    arm = Arm()
    arm.graph.delete("/bot/robot_description")
    assert not arm.manager.load("arm")
    assert "robot_description" in arm.graph.lines("error")


def test_a_negative_tolerance_is_pointed_out() -> None:
    arm = Arm(constraints={"j1": {"goal": -0.1}})
    arm.load("arm")
    assert "/bot/arm/constraints/j1/goal is below 0: it is not checked" in arm.graph.lines("warn")


def test_a_joint_that_is_named_twice_is_pointed_out() -> None:
    arm = Arm(joints=["j1", "j2", "j1"])
    arm.load("arm")
    assert "/bot/arm/joints names 'j1' twice" in arm.graph.lines("warn")


def test_parameters_of_other_joints_are_pointed_out() -> None:
    gains = {**GAINS["gains"], "j8": {"p": 1.0}}
    arm = Arm("effort", constraints={"j7": {"goal": 0.1}, "goal_time": 1.0}, gains=gains)
    arm.load("arm")
    assert "/bot/arm/constraints/j7 has no effect: 'j7' is not a joint of this controller" in arm.graph.lines("warn")
    assert "/bot/arm/gains/j8 has no effect" in arm.graph.lines("warn")
    assert "goal_time" not in arm.graph.lines("warn")


class TestCommands:
    def test_the_joints_go_from_point_to_point(self, arm: Arm) -> None:
        arm.command(point(0.1, 0.5, -0.5), point(0.2, 1.0, 0.0))
        arm.run(100)
        assert arm.positions() == pytest.approx((0.5, -0.5))
        arm.run(101)
        assert arm.positions() == pytest.approx((1.0, 0.0))

    def test_names_in_another_order_mean_the_same_joints(self, arm: Arm) -> None:
        arm.command(point(0.1, 1.0, 2.0), joints=("j2", "j1"))
        arm.run(120)
        assert arm.positions() == pytest.approx((2.0, 1.0))

    def test_a_new_command_takes_over_in_flight_without_a_jump(self, arm: Arm) -> None:
        arm.command(point(1.0, 1.0, 0.0, velocities=[0.0, 0.0]))
        arm.run(500)
        desired = arm.manager.get("arm").motions[0]
        position, velocity = desired.position, desired.velocity
        arm.command(point(0.5, 0.0, 0.0, velocities=[0.0, 0.0]))
        arm.run()
        assert desired.position == pytest.approx(position, abs=2e-3)
        assert desired.velocity == pytest.approx(velocity, abs=2e-2)

    def test_a_stamp_in_the_future_lets_the_present_motion_go_on_until_then(self, arm: Arm) -> None:
        arm.command(point(0.1, 1.0, 0.0))
        arm.run(2)
        arm.command(point(0.1, 0.0, 0.0), stamp=arm.graph.time_ns * 1e-9 + 0.2)
        arm.run(150)
        assert arm.positions()[0] == 1.0
        arm.run(160)
        assert arm.positions()[0] == 0.0

    def test_a_partial_command_leaves_the_other_joints_alone(self) -> None:
        arm = Arm(allow_partial_joints_goal=True)
        arm.start("arm")
        arm.command(point(0.2, 1.0, 1.0))
        arm.run(50)
        arm.command(point(0.05, 0.0), joints=("j2",))
        arm.run(200)
        assert arm.positions() == pytest.approx((1.0, 0.0))

    def test_an_empty_command_holds_the_measured_positions(self, arm: Arm) -> None:
        arm.command(point(0.2, 1.0, 1.0))
        arm.run(100)
        held = arm.positions()
        arm.command()
        arm.run(200)
        assert arm.positions() == held

    def test_with_a_duration_an_empty_command_brakes_within_it(self) -> None:
        arm = Arm(stop_trajectory_duration=0.1)
        arm.start("arm")
        arm.command(point(0.2, 1.0, 1.0))
        arm.run(100)
        arm.command()
        arm.run(90)
        assert arm.robot.joints["j1"].velocity > 0.01
        arm.run(20)
        assert arm.robot.joints["j1"].velocity == pytest.approx(0.0, abs=1e-12)

    @pytest.mark.parametrize(("points", "joints", "text"), BAD)
    def test_a_command_that_cannot_be_followed_is_refused_and_changes_nothing(
        self, arm: Arm, points: list[dict], joints: tuple[str, ...], text: str
    ) -> None:
        arm.goal(point(0.1, 0.5, 0.5))
        arm.run(20)
        with pytest.raises(MessageRefused, match=text):
            arm.command(*points, joints=joints)
        assert text in arm.graph.lines("error")
        arm.run(200)
        assert arm.positions() == pytest.approx((0.5, 0.5))
        assert [result[1] for result in arm.results()] == [GoalStatus.SUCCEEDED]

    @pytest.mark.parametrize(("stamp", "text"), [(4.1e9, "Duration is out of"), (0.001, "Time is out of")])
    def test_a_stamp_that_ros_cannot_count_from_is_refused(self, arm: Arm, stamp: float, text: str) -> None:
        arm.graph.time_ns += 10**9
        arm.run(2)
        with pytest.raises(MessageRefused, match=text):
            arm.command(point(0.1, 1.0, 1.0), stamp=stamp)

    def test_points_that_are_over_are_dropped_with_a_warning(self, arm: Arm) -> None:
        arm.run(100)
        stamp = arm.graph.time_ns * 1e-9 - 0.05
        arm.command(point(0.02, 9.0, 9.0), point(0.1, 1.0, 1.0), stamp=stamp)
        assert "Dropping first 1 trajectory point(s) out of 2" in arm.graph.lines("warn")
        arm.run(100)
        assert arm.positions() == pytest.approx((1.0, 1.0))

    def test_surplus_positions_are_taken_with_a_warning(self, arm: Arm) -> None:
        arm.command(point(0.1, 1.0, 1.0, 3.0, 4.0))
        arm.run(200)
        assert arm.positions() == pytest.approx((1.0, 1.0))
        text = f"{NAMESPACE}: a point has 4 positions for 2 joints: the surplus ones have no effect"
        assert ("warn", text) in arm.graph.log

    def test_a_position_beyond_a_limit_is_taken_with_a_warning(self, arm: Arm) -> None:
        arm.goal(point(0.1, 1.0, 9.0), point(0.2, -4.5, 9.0))
        arm.command(point(0.1, 3.0, 1.0))
        warnings = [text for severity, text in arm.graph.log if severity == "warn"]
        assert warnings == [f"{NAMESPACE}: j1 is commanded to -4.5, outside its limits -3 to 3"]

    def test_one_to_a_controller_that_is_not_running_is_refused(self) -> None:
        arm = Arm()
        arm.load("arm")
        with pytest.raises(MessageRefused, match="Controller is not running"):
            arm.command(point(0.1, 1.0, 1.0))


class TestGoals:
    def test_a_goal_is_reached_with_feedback_on_the_way(self, arm: Arm) -> None:
        name = arm.goal(point(0.2, 1.0, 0.5, velocities=[0.0, 0.0]))
        arm.run(260)
        assert arm.results() == [(name, GoalStatus.SUCCEEDED, 0, "")]
        feedback = arm.graph.sent(f"{ACTION}/feedback")
        assert len(feedback) == 5
        assert feedback[1]["feedback"]["joint_names"] == ["j1", "j2"]
        assert feedback[1]["feedback"]["actual"]["positions"][0] == pytest.approx(0.5, abs=0.02)

    def test_a_new_goal_preempts_the_old_one(self, arm: Arm) -> None:
        first = arm.goal(point(0.2, 1.0, 0.5))
        arm.run(50)
        second = arm.goal(point(0.1, 0.0, 0.0))
        arm.run(200)
        assert [result[:2] for result in arm.results()] == [
            (first, GoalStatus.PREEMPTED),
            (second, GoalStatus.SUCCEEDED),
        ]

    def test_a_command_preempts_a_goal(self, arm: Arm) -> None:
        arm.goal(point(0.2, 1.0, 0.5))
        arm.run(50)
        arm.command(point(0.1, 0.0, 0.0))
        assert arm.results()[0][1] == GoalStatus.PREEMPTED

    def test_a_cancelled_goal_holds_the_joints_where_they_are(self, arm: Arm) -> None:
        name = arm.goal(point(0.2, 1.0, 0.5))
        arm.run(100)
        held = arm.positions()
        arm.cancel(name)
        arm.run(200)
        assert arm.positions() == held
        assert arm.results() == [(name, GoalStatus.PREEMPTED, 0, "")]

    def test_a_goal_ends_when_its_controller_stops(self, arm: Arm) -> None:
        arm.goal(point(0.2, 1.0, 0.5))
        arm.request(stop=["arm"])
        arm.run()
        assert arm.results()[0][1] == GoalStatus.PREEMPTED

    def test_a_goal_ends_when_its_controller_fails(self, arm: Arm) -> None:
        arm.goal(point(0.2, 1.0, 0.5))
        arm.manager.get("arm")._command = None
        arm.run()
        assert arm.states() == {"arm": "aborted"}
        assert arm.results()[0][1] == GoalStatus.PREEMPTED

    def test_a_joint_off_its_path_aborts_the_goal_and_the_motion_goes_on(self) -> None:
        arm = Arm(constraints={"j2": {"trajectory": 0.1}})
        arm.start("arm")
        arm.follows = False
        arm.goal(point(0.2, 0.0, 1.0))
        arm.run(200)
        (_, status, code, text) = arm.results()[0]
        assert (status, code) == (GoalStatus.ABORTED, -4)
        assert text.startswith("j2 path error 0.10")
        assert arm.robot.joints["j2"].command == pytest.approx(1.0, abs=0.02)

    def test_a_goal_off_its_path_stops_where_that_is_asked_for(self) -> None:
        arm = Arm(constraints={"j2": {"trajectory": 0.1}}, stop_on_abort=True)
        arm.start("arm")
        arm.follows = False
        arm.goal(point(0.2, 0.0, 1.0))
        arm.run(200)
        assert arm.results()[0][1:3] == (GoalStatus.ABORTED, -4)
        assert arm.robot.joints["j2"].command == arm.robot.joints["j2"].position == 0.0
        arm.follows = True
        arm.goal(point(0.2, 0.0, 1.0))
        arm.run(300)
        assert arm.results()[1][1] == GoalStatus.SUCCEEDED

    def test_a_goal_that_the_first_update_decides_has_no_feedback(self, arm: Arm) -> None:
        name = arm.goal()
        arm.run(200)
        assert arm.results() == [(name, GoalStatus.SUCCEEDED, 0, "")]
        assert arm.graph.sent(f"{ACTION}/feedback") == []

    def test_a_goal_that_is_not_met_in_time_is_aborted(self) -> None:
        arm = Arm(constraints={"goal_time": 0.1, "j1": {"goal": 0.01}})
        arm.start("arm")
        arm.follows = False
        arm.goal(point(0.1, 1.0, 0.0))
        arm.run(190)
        assert arm.results() == []
        arm.run(20)
        assert arm.results()[0][1:] == (GoalStatus.ABORTED, -5, "j1 goal error 1.000000")

    def test_tolerances_of_the_goal_itself_go_before_the_parameters(self, arm: Arm) -> None:
        arm.follows = False
        tolerance = [{"name": "j1", "position": 0.05}, {"name": "other", "position": 1.0}]
        arm.goal(point(0.1, 1.0, 0.0), path_tolerance=tolerance)
        arm.run(50)
        assert arm.results()[0][2] == -4
        assert "no joint 'other': its tolerance is ignored" in arm.graph.lines("warn")

    @pytest.mark.parametrize(("points", "joints", "text"), BAD)
    def test_a_goal_that_cannot_be_followed_is_rejected_with_a_code_and_the_present_one_goes_on(
        self, arm: Arm, points: list[dict], joints: tuple[str, ...], text: str
    ) -> None:
        arm.goal(point(0.1, 0.5, 0.5))
        arm.run(20)
        arm.goal(*points, joints=joints)
        is_of_joints = joints != ("j1", "j2")
        (_, status, code, error) = arm.results()[0]
        assert (status, code) == (GoalStatus.REJECTED, -2 if is_of_joints else -1)
        assert error == "" if is_of_joints else text in error
        assert ("don't match the controller joints" if is_of_joints else text) in arm.graph.lines("error")
        arm.run(200)
        assert arm.positions() == pytest.approx((0.5, 0.5))
        assert arm.results()[1][1:3] == (GoalStatus.SUCCEEDED, 0)

    @given(*(st.tuples(*[st.sampled_from(v)] * 2) for v in ([0.0, 0.2, -0.4], [-1.0, 0.0, 0.1, 0.3], [0.0, 0.1, 0.3])))
    def test_of_joints_that_are_blocked_the_tolerances_decide(self, targets: tuple, path: tuple, goal: tuple) -> None:
        arm = Arm(constraints={"goal_time": 0.05, "stopped_velocity_tolerance": 0.0})
        arm.start("arm")
        arm.follows = False
        tolerances = {
            f"{kind}_tolerance": [{"name": f"j{k}", "position": value} for k, value in enumerate(values, 1)]
            for kind, values in (("path", path), ("goal", goal))
        }
        arm.goal(point(0.1, *targets), **tolerances)
        arm.run(300)
        errors = np.abs(targets)
        path_ends, goal_ends = (bool(np.any((np.array(most) > 0) & (np.array(most) < errors))) for most in (path, goal))
        assert arm.results()[0][2] == (-4 if path_ends else -5 if goal_ends else 0)

    def test_one_to_a_controller_that_is_not_running_is_rejected(self) -> None:
        arm = Arm()
        arm.load("arm")
        arm.goal(point(0.1, 1.0, 1.0))
        assert arm.results()[0][1:] == (GoalStatus.REJECTED, -1, "")

    def test_goals_leave_no_timers_behind(self, arm: Arm) -> None:
        arm.goal(point(0.05, 0.1, 0.1))
        arm.run(200)
        before = len(arm.graph.sent(f"{ACTION}/feedback"))
        arm.run(200)
        assert len(arm.graph.sent(f"{ACTION}/feedback")) == before


class TestQueries:
    def ask(self, arm: Arm, seconds: float) -> dict:
        nanoseconds = arm.graph.time_ns + round(seconds * 1e9)
        time = {"secs": nanoseconds // 10**9, "nsecs": nanoseconds % 10**9}
        return arm.graph.call(f"{NAMESPACE}/query_state", {"time": time})

    def test_they_tell_where_the_joints_are_to_be(self, arm: Arm) -> None:
        arm.command(point(0.1, 1.0, 0.0))
        answer = self.ask(arm, 0.051)
        assert answer["name"] == ["j1", "j2"]
        assert answer["position"][0] == pytest.approx(0.51, abs=0.02)
        assert self.ask(arm, 9.0)["position"] == [1.0, 0.0]
        assert self.ask(arm, 9.0)["velocity"] == [0.0, 0.0]

    @pytest.mark.parametrize("seconds", [-5.0, -0.0015])
    def test_before_the_trajectory_there_is_no_answer(self, arm: Arm, seconds: float) -> None:
        arm.run(20)
        arm.command()
        with pytest.raises(Refused, match=r"precedes trajectory start|Time is out of"):
            self.ask(arm, seconds)

    def test_nor_while_it_is_not_running(self) -> None:
        arm = Arm()
        arm.load("arm")
        with pytest.raises(Refused, match="Controller is not running"):
            self.ask(arm, 0.0)


def test_the_state_is_published_at_its_rate_and_counted_when_nobody_listens(arm: Arm) -> None:
    publisher = arm.graph.publishers[f"{NAMESPACE}/state"]
    arm.run(100)
    assert [message["header"]["stamp"]["nsecs"] for message in publisher.messages[:2]] == [22_000_000, 42_000_000]
    publisher.wanted = False
    arm.run(100)
    publisher.wanted = True
    arm.run(10)
    assert (len(publisher.messages), publisher.sequence) == (5, 9)
