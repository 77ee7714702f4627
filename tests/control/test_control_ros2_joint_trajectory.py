"""The trajectory controller of ROS 2: motion between waypoints, what is refused, goals, tolerances, holds, parameters.

Expected numbers are solved with numpy from what a segment must meet at its ends.
"""

from __future__ import annotations

import re
from math import inf, nan, pi
from typing import Any

import numpy as np
import pytest
from fake_robot import STEP_S, Bench, FakeRobot
from test_control_joint_trajectory import INERTIA, point, trajectory

from slidectl import msgs
from slidectl.control.node_handle import GoalStatus
from slidectl.control.ros2_pid import Ros2Gains, Ros2Pid
from slidectl.errors import MessageRefused, Refused

TYPE = "joint_trajectory_controller/JointTrajectoryController"
NAMESPACE = "/bot/arm"
ACTION = f"{NAMESPACE}/follow_joint_trajectory"
LIMIT = '<limit lower="-3" upper="3" effort="9" velocity="{}"/>'
URDF = f"""<robot name="bot"><link name="world"/><link name="a">{INERTIA}</link><link name="b">{INERTIA}</link>
  <joint name="j1" type="revolute"><parent link="world"/><child link="a"/><axis xyz="0 0 1"/>{LIMIT.format(2)}</joint>
  <joint name="j2" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit effort="9" velocity="4"/></joint></robot>"""
INTERFACES = {
    "position": ["position"],
    "velocity": ["velocity"],
    "effort": ["effort"],
    "pos_vel": ["position", "velocity"],
    "pos_vel_acc": ["position", "velocity", "acceleration"],
}
REST = {"velocities": [0.0, 0.0]}


class Arm(Bench):
    """Two joints that are where they are commanded to be, one cycle late, if they take positions."""

    def __init__(self, kind: str = "position", start: bool = True, urdf: str = URDF, **parameters: Any) -> None:
        own = {
            "type": TYPE,
            "joints": ["j1", "j2"],
            "command_interfaces": INTERFACES[kind],
            "state_interfaces": ["position", "velocity"],
            **parameters,
        }
        super().__init__(FakeRobot(("j1", "j2"), (kind,)), {"arm": own})
        if urdf:
            self.graph.set("/bot/robot_description", urdf)
        self.follows = INTERFACES[kind][0] == "position"
        self.sent = 0
        self.j1, self.j2 = self.robot.joints.values()
        if start:
            self.start("arm")

    def run(self, cycles: int = 1, **more: Any) -> None:
        for _ in range(cycles):
            super().run(**more)
            for joint in self.robot.joints.values() if self.follows else ():
                joint.velocity = (joint.command - joint.position) / STEP_S
                joint.position = joint.command

    def set(self, name: str, value: Any) -> None:
        self.graph.set(f"{NAMESPACE}/{name}", value)

    def put(self, *positions: float, velocities: tuple[float, float] = (0.0, 0.0)) -> None:
        """Joints that stay there, whatever is commanded."""
        self.follows = False
        for joint, position, velocity in zip((self.j1, self.j2), positions, velocities, strict=True):
            joint.position, joint.velocity = position, velocity

    def send(self, *points: dict, joints: tuple[str, ...] = ("j1", "j2"), stamp: float = 0.0) -> None:
        message = msgs.check("trajectory_msgs/JointTrajectory", trajectory(points, joints, stamp))
        self.graph.send(f"{NAMESPACE}/joint_trajectory", message)

    def goal(self, *points: dict, joints: tuple[str, ...] = ("j1", "j2"), **more: Any) -> str:
        self.sent += 1
        goal = {"trajectory": trajectory(points, joints), **more}
        message = {"goal_id": {"id": f"g{self.sent}"}, "goal": goal}
        self.graph.send(f"{ACTION}/goal", msgs.check("control_msgs/FollowJointTrajectoryActionGoal", message))
        return f"g{self.sent}"

    def cancel(self, name: str) -> None:
        self.graph.send(f"{ACTION}/cancel", msgs.check("actionlib_msgs/GoalID", {"id": name}))

    def scale(self, factor: float) -> None:
        message = msgs.check("control_msgs/SpeedScalingFactor", {"factor": factor})
        self.graph.send(f"{NAMESPACE}/speed_scaling_input", message)

    def query(self, seconds: float) -> dict[str, Any]:
        request = {"time": {"secs": int(seconds), "nsecs": round(seconds % 1 * 1e9)}}
        return msgs.check("slidectl/QueryTrajectoryStateResponse", self.graph.call(f"{NAMESPACE}/query_state", request))

    def states(self) -> list[dict[str, Any]]:
        return self.graph.sent(f"{NAMESPACE}/controller_state")

    @property
    def state(self) -> dict[str, Any]:
        return self.states()[-1]

    def results(self) -> list[tuple[str, GoalStatus, int, str]]:
        found = []
        for message in self.graph.sent(f"{ACTION}/result"):
            status, result = message["status"], message["result"]
            found.append((status["goal_id"]["id"], status["status"], result["error_code"], result["error_string"]))
        return found

    def commands(self, cycles: int, joint: str = "j1", attribute: str = "command") -> list[float]:
        """The command after each of the next cycles."""
        found = []
        for _ in range(cycles):
            self.run()
            found.append(getattr(self.robot.joints[joint], attribute))
        return found


def polynomial(duration: float, start: list[float], end: list[float]) -> np.polynomial.Polynomial:
    """The polynomial of least degree with these derivatives, from order 0 on, at 0 and after `duration`."""
    terms = 2 * len(start)
    basis = [np.polynomial.Polynomial.basis(k) for k in range(terms)]
    rows = [[one.deriv(order)(x) for one in basis] for x in (0.0, duration) for order in range(len(start))]
    return np.polynomial.Polynomial(np.linalg.solve(np.array(rows), np.array([*start, *end])))


class TestActivation:
    @pytest.mark.parametrize("kind", INTERFACES)
    def test_it_claims_its_joints_and_holds_them(self, kind: str) -> None:
        arm = Arm(kind, start=False)
        for joint in (arm.j1, arm.j2):
            joint.position = joint.command = 0.5 if arm.follows else 0.0
        arm.start("arm")
        arm.run(20)
        assert arm.manager.list()[0]["claimed_resources"][0]["resources"] == ["j1", "j2"]
        assert arm.j1.command == arm.j2.command == (0.5 if arm.follows else 0.0)
        assert arm.j1.command_velocity == arm.j1.command_acceleration == 0.0

    @pytest.mark.parametrize(("at_command", "expected"), [(True, 0.3), (False, 0.5)])
    def test_it_starts_at_the_last_commands_or_at_the_measured_positions(
        self, at_command: bool, expected: float
    ) -> None:
        name = "set_last_command_interface_value_as_state_on_activation"
        arm = Arm(start=False, **{name: at_command})
        arm.put(0.5, 0.5)
        arm.j1.command = arm.j2.command = 0.3
        arm.start("arm")
        arm.run()
        assert arm.j1.command == expected

    def test_commands_that_are_not_finite_are_no_state_to_start_at(self) -> None:
        arm = Arm(start=False)
        arm.put(0.5, 0.25)
        arm.j1.command, arm.j2.command = 0.3, nan
        arm.start("arm")
        arm.run()
        assert (arm.j1.command, arm.j2.command) == (0.5, 0.25)

    def test_a_stop_keeps_positions_and_sets_other_commands_to_0(self) -> None:
        arm = Arm("pos_vel_acc")
        arm.send(point(0.1, 1.0, 1.0, velocities=[0.0, 0.0], accelerations=[0.0, 0.0]))
        arm.run(30)
        before = arm.j1.command
        assert arm.j1.command_velocity > 0.0
        assert arm.j1.command_acceleration != 0.0
        arm.request(stop=["arm"])
        arm.run()
        assert arm.j1.command == pytest.approx(before, abs=0.05)
        assert arm.j1.command_velocity == arm.j1.command_acceleration == 0.0
        effort = Arm("effort", gains={"j1": {"p": 5.0}})
        effort.send(point(0.1, 1.0, 1.0))
        effort.run(20)
        assert effort.j1.command != 0.0
        effort.request(stop=["arm"])
        effort.run()
        assert effort.j1.command == 0.0

    def test_a_stop_aborts_the_goal(self) -> None:
        arm = Arm()
        arm.goal(point(1.0, 1.0, 1.0))
        arm.run(10)
        arm.request(stop=["arm"])
        arm.run()
        text = "Current goal cancelled during deactivate transition."
        assert arm.results() == [("g1", GoalStatus.ABORTED, -1, text)]

    def test_while_it_does_not_run_trajectories_are_checked_and_forgotten_and_goals_refused(self) -> None:
        arm = Arm(start=False)
        arm.load("arm")
        arm.send(point(0.01, 1.0, 1.0))
        assert "not running: the trajectory has no effect" in arm.graph.lines("warn")
        with pytest.raises(MessageRefused, match="Empty trajectory received"):
            arm.send()
        arm.goal(point(0.01, 1.0, 1.0))
        assert [status for _, status, *_ in arm.results()] == [GoalStatus.REJECTED]
        assert "Controller is not running" in arm.graph.lines("error")
        arm.request(start=["arm"])
        arm.run(30)
        assert arm.j1.command == 0.0


class TestMotion:
    def test_positions_alone_are_reached_on_a_line_one_update_ahead(self) -> None:
        arm = Arm()
        arm.send(point(0.1, 1.0, -2.0))
        commands = arm.commands(100)
        assert commands == pytest.approx([10.0 * STEP_S * (k + 1) for k in range(100)])
        assert arm.j2.command == pytest.approx(-2.0)
        assert arm.state["reference"]["positions"] == pytest.approx([0.99, -1.98])
        assert arm.state["reference"]["velocities"] == pytest.approx([10.0, -20.0])
        assert arm.state["reference"]["accelerations"] == [0.0, 0.0]

    @pytest.mark.parametrize("orders", [2, 3])
    def test_velocities_and_accelerations_make_cubics_and_quintics(self, orders: int) -> None:
        arm = Arm("pos_vel_acc", allow_nonzero_velocity_at_trajectory_end=True)
        ends = [[0.5, 0.7, -3.0], [1.0, -0.2, 2.0]]
        names = ("positions", "velocities", "accelerations")[:orders]
        times = (0.1, 0.25)
        points = []
        for time, end in zip(times, ends, strict=True):
            values = {name: [value, 2.0 * value] for name, value in zip(names, end, strict=False)}
            points.append({**point(time), **values})
        arm.send(*points)
        first = polynomial(0.1, [0.0] * orders, ends[0][:orders])
        second = polynomial(0.15, ends[0][:orders], ends[1][:orders])
        for k in range(1, 250):
            arm.run()
            motion, time = (first, k * STEP_S) if k < 100 else (second, k * STEP_S - 0.1)
            commands = [arm.j1.command, arm.j1.command_velocity, arm.j1.command_acceleration]
            assert commands == pytest.approx([motion(time), motion.deriv(1)(time), motion.deriv(2)(time)], abs=1e-6)
            assert arm.j2.command == pytest.approx(2.0 * arm.j1.command)
        arm.run(20)
        assert [arm.j1.command, arm.j1.command_velocity] == [1.0, -0.2]
        assert arm.j1.command_acceleration == (2.0 if orders == 3 else 0.0)

    def test_it_begins_at_the_measured_state_with_its_velocity(self) -> None:
        arm = Arm("pos_vel")
        arm.put(0.5, 0.5, velocities=(1.0, 0.0))
        arm.send(point(0.2, 1.0, 1.0, velocities=[0.0, 0.0]))
        motion = polynomial(0.2, [0.5, 1.0], [1.0, 0.0])
        assert arm.commands(50) == pytest.approx([motion((k + 1) * STEP_S) for k in range(50)])

    @pytest.mark.parametrize("name", ["interpolate_from_desired_state", "open_loop_control"])
    def test_it_can_begin_at_the_last_command(self, name: str) -> None:
        arm = Arm(**{name: True}, set_last_command_interface_value_as_state_on_activation=False)
        arm.send(point(0.1, 1.0, 1.0))
        arm.run(50)
        commanded = arm.j1.command
        arm.put(0.0, 0.0)
        arm.set("allow_trajectory_replacement", False)
        arm.send(point(0.1, 0.5 + commanded, 0.0))
        # The last command was given one period ago, from where the new line begins.
        assert arm.commands(1) == pytest.approx([commanded + 0.5 * 2.0 / 101.0])

    def test_none_goes_to_the_next_waypoint_at_once(self) -> None:
        arm = Arm(interpolation_method="none")
        arm.send(point(0.01, 1.0, 1.0), point(0.02, 2.0, 2.0), point(0.03, 3.0, 3.0))
        assert arm.commands(40) == [0.0] * 9 + [2.0] * 10 + [3.0] * 21

    def test_a_stamp_in_the_future_is_the_start_and_the_way_there_is_a_slow_approach(self) -> None:
        arm = Arm()
        now = arm.graph.time_ns * 1e-9
        arm.send(point(0.1, 1.0, 1.0), stamp=now + 0.1 + STEP_S)
        assert arm.commands(200)[99] == pytest.approx(0.5)
        assert arm.j1.command == pytest.approx(1.0)

    def test_a_stamp_in_the_past_skips_what_is_over(self) -> None:
        arm = Arm()
        arm.run(200)
        now = arm.graph.time_ns * 1e-9
        arm.send(point(0.05, 5.0, 5.0), point(0.15, 1.0, 1.0), point(0.25, 2.0, 2.0), stamp=now + STEP_S - 0.1)
        # half way between the first two
        assert arm.commands(1) == pytest.approx([3.0 - 4.0 * STEP_S / 0.1])

    def test_a_continuous_joint_approaches_the_first_waypoint_by_the_shorter_way(self) -> None:
        arm = Arm()
        arm.put(3.0, 3.0)
        arm.send(point(0.1, -3.0, -3.0), point(0.2, -2.9, -2.9))
        arm.run(50)
        assert arm.j1.command == pytest.approx(0.0)
        way = 2.0 * pi - 6.0
        assert arm.j2.command == pytest.approx(-3.0 - way / 2.0)
        assert arm.state["error"]["positions"][1] == pytest.approx(way * 0.49)
        assert arm.state["error"]["positions"][0] == pytest.approx(-6.0 * 0.49)

    def test_without_a_robot_description_no_joint_turns(self) -> None:
        arm = Arm(urdf="")
        arm.put(3.0, 3.0)
        arm.send(point(0.1, -3.0, -3.0))
        arm.run(50)
        assert arm.j2.command == pytest.approx(0.0)

    def test_half_a_turn_has_the_sign_of_the_difference(self) -> None:
        arm = Arm()
        arm.put(0.0, 0.0)
        arm.send(point(0.1, 0.0, -pi))
        arm.run(50)
        assert arm.j2.command == pytest.approx(-pi / 2.0)

    def test_some_of_the_joints_leave_the_others_where_they_are_commanded(self) -> None:
        arm = Arm(allow_partial_joints_goal=True)
        arm.send(point(0.05, 1.0, 2.0))
        arm.run(100)
        arm.send(point(0.05, -1.0, velocities=[0.0]), joints=("j2",))
        arm.run(100)
        assert (arm.j1.command, arm.j2.command) == pytest.approx((1.0, -1.0))

    def test_a_command_that_is_no_number_is_no_position_to_stay_at(self) -> None:
        arm = Arm(allow_partial_joints_goal=True)
        arm.put(0.4, 0.0)
        arm.j1.command = nan
        arm.send(point(0.0, 1.0), joints=("j2",))
        arm.run()
        assert (arm.j1.command, arm.j2.command) == (0.4, 1.0)

    def test_joints_may_come_in_any_order(self) -> None:
        arm = Arm()
        arm.send(point(0.0, 1.0, 2.0), joints=("j2", "j1"))
        arm.run()
        assert (arm.j1.command, arm.j2.command) == (2.0, 1.0)

    def test_commands_of_some_joints_or_of_others(self) -> None:
        arm = Arm(command_joints=["j2"])
        arm.send(point(0.0, 1.0, 2.0))
        arm.run()
        assert (arm.j1.command, arm.j2.command) == (0.0, 2.0)
        arm = Arm(joints=["j1"], command_joints=["j2"])
        arm.send(point(0.0, 1.0), joints=("j1",))
        arm.run()
        assert (arm.j1.command, arm.j2.command) == (0.0, 1.0)


class TestUpdateRate:
    def test_the_look_ahead_is_one_update_and_commands_stay_in_between(self) -> None:
        arm = Arm(update_rate=100)
        arm.run(9)  # the first update was in the first cycle
        arm.send(point(0.1, 1.0, 1.0))
        commands = arm.commands(25)
        assert commands == pytest.approx([0.0] + [0.1] * 10 + [0.2] * 10 + [0.3] * 4)


class TestIntegration:
    def test_velocities_and_accelerations_are_integrated_to_positions(self) -> None:
        arm = Arm(allow_integration_in_goal_trajectories=True, allow_nonzero_velocity_at_trajectory_end=True)
        arm.put(0.5, 0.5)
        one = {**point(0.1), "velocities": [1.0, 2.0]}
        two = {**point(0.3), "accelerations": [-5.0, 0.0]}
        arm.send(one, two)
        arm.run(301)
        first = 0.5 + np.array([1.0, 2.0]) * 0.5 * 0.1
        speed = np.array([1.0, 2.0]) + np.array([-5.0, 0.0]) * 0.5 * 0.2
        second = first + (np.array([1.0, 2.0]) + speed) * 0.5 * 0.2
        assert [arm.j1.command, arm.j2.command] == pytest.approx(second)
        assert arm.state["reference"]["velocities"] == pytest.approx(speed)

    def test_without_the_parameter_positions_are_needed(self) -> None:
        arm = Arm()
        with pytest.raises(MessageRefused, match="allow_integration_in_goal_trajectories"):
            arm.send({**point(0.1), "velocities": [1.0, 2.0]})


class TestUpsampling:
    def test_positions_get_the_velocities_of_the_spline_with_continuous_accelerations(self) -> None:
        arm = Arm("pos_vel_acc", positions_upsampling={"enable": True})
        times, positions = np.array([0.05, 0.1, 0.2, 0.26]), np.array([0.1, 0.5, 0.2, 1.0])
        arm.send(*(point(time, value, -value) for time, value in zip(times, positions, strict=True)))
        unknown, spans = len(times), np.diff(times)
        rows, sides = np.zeros((unknown, unknown)), np.zeros(unknown)
        rows[0, 0] = rows[-1, -1] = 1.0
        for k in range(1, unknown - 1):  # the second derivatives of both cubics at the point are equal
            one, other = spans[k - 1 : k + 1]
            rows[k, k - 1 : k + 2] = 2.0 / one, 4.0 / one + 4.0 / other, 2.0 / other
            steps = np.diff(positions)
            sides[k] = 6.0 * (steps[k - 1] / one**2 + steps[k] / other**2)
        speeds = np.linalg.solve(rows, sides)
        arm.run(50)
        assert arm.j1.command_velocity == pytest.approx(speeds[0], abs=1e-9)
        arm.run(50)
        assert (arm.j1.command, arm.j1.command_velocity) == pytest.approx((positions[1], speeds[1]))
        assert arm.j2.command_velocity == pytest.approx(-speeds[1])
        arm.run(100)
        assert (arm.j1.command, arm.j1.command_velocity) == pytest.approx((positions[2], speeds[2]))

    def test_points_without_times_get_those_of_the_policy(self) -> None:
        arm = Arm(positions_upsampling={"enable": True, "policy_frequency": 20.0})
        arm.send(point(0.0, 1.0, 0.0), point(0.0, 2.0, 0.0))
        commands = arm.commands(101)
        assert (commands[49], commands[99]) == pytest.approx((1.0, 2.0))
        motion = polynomial(0.05, [1.0, 0.0], [2.0, 0.0])
        assert commands[69] == pytest.approx(motion(0.02))

    def test_goals_and_trajectories_with_velocities_stay_as_they_are(self) -> None:
        arm = Arm(positions_upsampling={"enable": True, "policy_frequency": 20.0})
        arm.goal(point(0.0, 1.0, 0.0), point(0.0, 2.0, 0.0))
        assert [status for _, status, *_ in arm.results()] == [GoalStatus.REJECTED]
        arm.send(point(0.05, 1.0, 0.0, velocities=[2.0, 0.0]), point(0.1, 2.0, 0.0, **REST))
        arm.run(70)
        assert arm.j1.command == pytest.approx(polynomial(0.05, [1.0, 2.0], [2.0, 0.0])(0.02))


class TestPid:
    @pytest.mark.parametrize("kind", ["velocity", "effort"])
    def test_the_command_is_feed_forward_and_pid_with_the_look_ahead_of_the_desired_motion(self, kind: str) -> None:
        gains = {"p": 8.0, "i": 30.0, "d": 0.5, "ff_velocity_scale": 0.7, "i_clamp_max": 0.02, "i_clamp_min": -0.5}
        arm = Arm(kind, gains={"j1": gains, "j2": {}})
        arm.put(0.2, 0.0, velocities=(0.3, 0.0))
        more: dict[str, Any] = {"effort": [4.0, 0.0]} if kind == "effort" else {}
        arm.send(point(0.1, 1.0, 0.0, velocities=[0.0, 0.0], **more))
        motion, integral = polynomial(0.1, [0.2, 0.3], [1.0, 0.0]), 0.0
        for k in range(1, 60):
            time, ahead = (k - 1) * STEP_S, k * STEP_S
            arm.run()
            error, error_dot = motion(time) - 0.2, motion.deriv()(time) - 0.3
            expected = 8.0 * error + integral + 0.5 * error_dot + 0.7 * motion.deriv()(ahead)
            expected += 4.0 * ahead / 0.1 if kind == "effort" else 0.0
            integral = min(integral + 30.0 * error * STEP_S, 0.02)
            assert arm.j1.command == pytest.approx(expected)
        assert arm.state["error"]["velocities"][0] == pytest.approx(error_dot)
        assert arm.j2.command == 0.0

    def test_gains_change_while_it_runs_and_the_integral_stays(self) -> None:
        arm = Arm(
            "effort", gains={"j1": {"p": 1.0, "i": 1.0}}, set_last_command_interface_value_as_state_on_activation=False
        )
        arm.follows = False
        arm.send(point(0.0, 1.0, 0.0))
        arm.run(100)
        integral = 99 * STEP_S
        assert arm.j1.command == pytest.approx(1.0 + integral)
        arm.set("gains/j1/p", 3.0)
        arm.run()
        assert arm.j1.command == pytest.approx(3.0 + integral + STEP_S)

    def test_back_calculation_and_conditional_integration_bound_what_is_wound_up(self) -> None:
        gains = Ros2Gains(p=2.0, i=4.0, u_clamp_max=1.0, u_clamp_min=-1.0)
        plain = Ros2Pid(gains)
        back = Ros2Pid(gains._replace(antiwindup_strategy="back_calculation"))
        conditional = Ros2Pid(gains._replace(antiwindup_strategy="conditional_integration"))
        for _ in range(10):
            assert [pid.step_with_rate(1.0, 0.0, 0.1) for pid in (plain, back, conditional)] == [1.0] * 3
        assert plain.i_term == pytest.approx(4.0)
        assert conditional.i_term == 0.0
        integral = 0.0
        for _ in range(10):  # the time constant is p / i
            integral += 0.1 * (4.0 * 1.0 + (1.0 - (2.0 + integral)) / 0.5)
        assert back.i_term == pytest.approx(integral)
        assert conditional.step_with_rate(-0.25, 0.0, 0.1) == -0.5
        assert conditional.i_term == pytest.approx(-0.1)

    def test_a_deadband_stops_the_integral_and_a_period_of_0_repeats_the_command(self) -> None:
        pid = Ros2Pid(Ros2Gains(p=1.0, i=1.0, error_deadband=0.1))
        assert pid.step_with_rate(0.1, 0.0, 0.5) == 0.1
        assert pid.i_term == 0.0
        assert pid.step_with_rate(9.0, 0.0, 0.0) == 0.1
        assert np.isnan(pid.step_with_rate(inf, 0.0, 0.1))


BAD = [
    ([point(0.1, 1.0, 1.0), point(0.1, 2.0, 2.0)], ("j1", "j2"), "points 0 and 1 is not strictly increasing"),
    ([point(0.1, 1.0)], ("j1",), "don't match the controller joints"),
    ([point(0.1, 1.0, 1.0)], ("j1", "nope"), "Incoming joint nope doesn't match"),
    ([point(0.1, 1.0, 1.0)], ("j1", "j1"), "Incoming joint j1 is named twice"),
    ([point(0.1, 1.0)], (), "Empty joint names"),
    ([], ("j1", "j2"), "Empty trajectory"),
    ([point(0.1, 1.0)], ("j1", "j2"), r"joint_names size \(2\) and positions \(1\) at point #0"),
    ([point(0.1, 1.0, 1.0, velocities=[0.0])], ("j1", "j2"), r"and velocities \(1\)"),
    ([point(0.1, 1.0, 1.0, accelerations=[0.0])], ("j1", "j2"), r"and accelerations \(1\)"),
    ([point(0.1)], ("j1", "j2"), r"and positions \(0\) at point #0"),
    ([point(0.1, 1.0, 1.0, effort=[1.0, 1.0])], ("j1", "j2"), "need a controller with the command interface effort"),
    ([point(0.1, 1.0, 1.0, velocities=[0.0, 1e-6])], ("j1", "j2"), "point of joint j2 is not zero: 1e-06"),
    ([point(0.1, nan, 1.0)], ("j1", "j2"), "must be finite numbers"),
]


class TestRefusals:
    @pytest.mark.parametrize(("points", "joints", "text"), BAD)
    def test_a_bad_trajectory_is_refused_with_the_reason_and_a_goal_is_rejected(
        self, points: list[dict], joints: tuple[str, ...], text: str
    ) -> None:
        arm = Arm()
        with pytest.raises(MessageRefused, match=text):
            arm.send(*points, joints=joints)
        arm.goal(*points, joints=joints)
        [(_, status, code, _)] = arm.results()
        assert (status, code) == (GoalStatus.REJECTED, 0)
        arm.run(200)
        assert (arm.j1.command, arm.j2.command) == (0.0, 0.0)

    def test_a_trajectory_that_is_over_is_refused_and_one_without_a_stamp_never_is(self) -> None:
        arm = Arm()
        arm.run(1000)
        with pytest.raises(
            MessageRefused, match=r"non-zero start time \(0\.500000\) that ends in the past \(0\.600000"
        ):
            arm.send(point(0.1, 1.0, 1.0), stamp=0.5)
        arm.send(point(0.0, 1.0, 1.0))
        arm.run()
        assert arm.j1.command == 1.0

    @pytest.mark.parametrize(
        ("parameters", "text"),
        [
            ({"command_interfaces": ["position", "effort"]}, r"use \['position'\] or .*\['effort'\]"),
            ({"command_interfaces": ["acceleration"]}, "no joint can be commanded by"),
            ({"command_interfaces": []}, "command_interfaces must be a list of some of position, velocity"),
            ({"state_interfaces": ["velocity"]}, "must have position"),
            ({"state_interfaces": ["position", "velocity", "acceleration"]}, "does not measure accelerations"),
            ({"state_interfaces": []}, "state_interfaces must be"),
            ({"joints": []}, "at least one joint"),
            ({"joints": ["j1", "j1"]}, "names a joint twice"),
            ({"joints": ["j1", "j3"]}, "j3"),
            ({"command_joints": ["j1", "j2", "j3"]}, "has 3 joints, and .*joints only 2"),
            ({"command_joints": ["j3"]}, "must be some of"),
            ({"speed_scaling": {"state_interface": "speed/factor"}}, "has no interface 'speed/factor'"),
            ({"interpolation_method": "linear"}, "must be one of splines, none"),
            ({"action_monitor_rate": 0.05}, "must be a number of 0.1 or more"),
            ({"constraints": {"goal_time": -1.0}}, "must be a number of 0 or more"),
            ({"gains": {"j1": {"u_clamp_max": 1.0, "u_clamp_min": 1.0}}}, "gains/j1/u_clamp_min"),
            ({"gains": {"j1": {"antiwindup_strategy": "legacy"}}}, "must be none, back_calculation"),
        ],
    )
    def test_it_is_not_loaded_with_parameters_that_it_cannot_follow(self, parameters: dict, text: str) -> None:
        arm = Arm(start=False, **parameters)
        assert not arm.manager.load("arm")
        assert re.search(text, arm.graph.lines("error"))

    @pytest.mark.parametrize("kind", ["velocity", "effort"])
    def test_a_pid_needs_velocities(self, kind: str) -> None:
        arm = Arm(kind, start=False, state_interfaces=["position"])
        assert not arm.manager.load("arm")
        assert "must have velocity too" in arm.graph.lines("error")


class TestGoals:
    def test_a_goal_succeeds_at_its_end_within_its_tolerance_and_the_last_point_is_repeated(self) -> None:
        arm = Arm(constraints={"j1": {"goal": 0.1}})
        arm.goal(point(0.1, 1.0, 1.0))
        arm.run(160)
        assert arm.results() == [("g1", GoalStatus.SUCCEEDED, 0, "Goal successfully reached!")]
        arm.put(0.0, 0.0)
        arm.run(500)
        assert (arm.j1.command, len(arm.results())) == (1.0, 1)

    def test_off_the_path_it_is_aborted_and_the_measured_positions_are_held(self) -> None:
        arm = Arm(constraints={"j1": {"trajectory": 0.3}})
        arm.goal(point(1.0, 1.0, 1.0))
        arm.put(0.05, 0.0)
        arm.run(310)  # 0.05 + 0.95 t
        assert not arm.results()
        arm.run(60)
        assert arm.results() == [("g1", GoalStatus.ABORTED, -4, "Aborted due to path tolerance violation")]
        assert "j1 has a position error of 0.3" in arm.graph.lines("error")
        assert (arm.j1.command, arm.j2.command) == (0.05, 0.0)

    def test_in_the_cycle_of_a_violation_nothing_is_commanded(self) -> None:
        arm = Arm(constraints={"j1": {"trajectory": 0.1}})
        arm.goal(point(1.0, 1.0, 1.0))
        arm.run(50)
        before = arm.j1.command
        arm.put(-0.5, 0.0)
        assert arm.commands(2) == [before, -0.5]

    def test_a_goal_that_is_too_late_is_aborted_with_the_time_since_its_end(self) -> None:
        arm = Arm(constraints={"goal_time": 0.02, "j1": {"goal": 0.1}})
        arm.put(0.0, 0.0)
        arm.goal(point(0.1, 1.0, 1.0))
        arm.run(200)
        text = "Aborted due to goal_time_tolerance exceeding by 0.021000 seconds"
        assert arm.results() == [("g1", GoalStatus.ABORTED, -5, text)]
        assert arm.j1.command == 0.0

    def test_without_a_goal_time_it_waits_for_ever(self) -> None:
        arm = Arm(constraints={"j1": {"goal": 0.1}})
        arm.put(0.0, 0.0)
        arm.goal(point(0.1, 1.0, 1.0))
        arm.run(5000)
        assert not arm.results()
        arm.put(0.95, 0.0)
        arm.run(60)
        assert [status for _, status, *_ in arm.results()] == [GoalStatus.SUCCEEDED]

    def test_the_velocity_at_the_end_counts_only_where_velocities_are_commanded(self) -> None:
        for kind, results in (("position", 1), ("pos_vel", 0)):
            arm = Arm(kind)
            arm.goal(point(0.1, 1.0, 1.0))
            arm.put(1.0, 1.0, velocities=(0.02, 0.0))
            arm.run(200)
            assert len(arm.results()) == results, kind

    def test_a_new_goal_aborts_the_old_one_at_once(self) -> None:
        arm = Arm()
        arm.goal(point(1.0, 1.0, 1.0))
        arm.run(10)
        arm.goal(point(1.0, 2.0, 1.0))
        text = "Current goal preempted by new incoming action."
        assert arm.results() == [("g1", GoalStatus.ABORTED, -1, text)]

    def test_a_goal_that_has_just_ended_gets_its_result_before_the_next_one(self) -> None:
        arm = Arm()
        arm.goal(point(0.002, 1.0, 1.0))
        arm.run(4)
        assert not arm.results()
        arm.goal(point(1.0, 2.0, 1.0))
        assert [status for _, status, *_ in arm.results()] == [GoalStatus.SUCCEEDED]

    def test_a_refused_goal_leaves_the_present_one_alone(self) -> None:
        arm = Arm()
        arm.goal(point(0.1, 1.0, 1.0))
        arm.run(10)
        arm.goal()
        arm.run(200)
        assert [(name, status) for name, status, *_ in arm.results()] == [
            ("g2", GoalStatus.REJECTED),
            ("g1", GoalStatus.SUCCEEDED),
        ]

    def test_a_cancelled_goal_stops_where_it_is_measured(self) -> None:
        arm = Arm()
        name = arm.goal(point(1.0, 1.0, 1.0))
        arm.run(500)
        measured = arm.j1.position
        arm.cancel(name)
        assert arm.results() == [("g1", GoalStatus.PREEMPTED, 0, "")]
        arm.run(100)
        assert arm.j1.command == measured

    def test_a_trajectory_on_the_topic_leaves_the_goal_active(self) -> None:
        arm = Arm()
        arm.goal(point(1.0, 1.0, 1.0))
        arm.run(100)
        arm.send(point(0.1, 0.5, 0.5))
        arm.run(200)
        assert [status for _, status, *_ in arm.results()] == [GoalStatus.SUCCEEDED]
        assert arm.j1.command == 0.5

    def test_tolerances_of_a_goal_replace_keep_or_switch_off_those_of_the_parameters(self) -> None:
        arm = Arm(constraints={"j1": {"trajectory": 0.1}, "j2": {"trajectory": 0.1}})
        tolerances = [{"name": "j1", "position": -1.0}, {"name": "j2", "position": 0.3}]
        arm.put(0.0, 0.0)
        arm.goal(point(1.0, 1.0, 0.5), path_tolerance=tolerances)
        arm.run(500)
        assert not arm.results()
        arm.run(150)
        assert [code for *_, code, _ in arm.results()] == [-4]
        arm.send(point(0.5, 0.0, 0.29))  # they stay in force
        arm.run(600)
        assert arm.j2.command == 0.29

    @pytest.mark.parametrize(
        "more",
        [
            {"path_tolerance": [{"name": "j1", "position": -2.0}, {"name": "j2", "position": 9.0}]},
            {"path_tolerance": [{"name": "nope", "position": 9.0}]},
            {"path_tolerance": [{"name": "j1", "position": 9.0}], "goal_time_tolerance": {"secs": -2, "nsecs": 0}},
            {"path_tolerance": [{"name": "j1", "acceleration": -0.5, "position": 9.0}]},
        ],
    )
    def test_with_a_wrong_tolerance_those_of_the_parameters_count(self, more: dict) -> None:
        arm = Arm(constraints={"j1": {"trajectory": 0.1}, "j2": {"trajectory": 0.1}})
        arm.put(0.0, 0.0)
        arm.goal(point(1.0, 1.0, 1.0), **more)
        arm.run(200)
        assert [code for *_, code, _ in arm.results()] == [-4]
        assert "the tolerances of the goal have no effect" in arm.graph.lines("error")

    def test_feedback_comes_at_the_rate_of_the_monitor_after_the_first_update(self) -> None:
        arm = Arm(action_monitor_rate=100.0)
        arm.goal(point(0.1, 1.0, 1.0))
        arm.run(50)
        sent = [message["feedback"] for message in arm.graph.sent(f"{ACTION}/feedback")]
        assert len(sent) == 5
        assert sent[-1]["desired"]["positions"] == pytest.approx([0.49, 0.49])
        assert sent[-1]["actual"]["positions"] == pytest.approx([0.49, 0.49])
        assert sent[-1]["desired"]["time_from_start"] == {"secs": 0, "nsecs": 49_000_000}
        msgs.check("control_msgs/FollowJointTrajectoryFeedback", sent[-1])

    def test_without_a_goal_a_violation_holds_too(self) -> None:
        arm = Arm(constraints={"j1": {"trajectory": 0.1}})
        arm.put(0.0, 0.0)
        arm.send(point(1.0, 1.0, 1.0))
        arm.run(200)
        assert arm.j1.command == 0.0
        assert "Holding position due to state tolerance violation" in arm.graph.lines("error")
        late = Arm(constraints={"goal_time": 0.02, "j1": {"goal": 0.1}})
        late.put(0.0, 0.0)
        late.send(point(0.1, 1.0, 1.0))
        late.run(200)
        assert late.j1.command == 0.0
        assert "Exceeded goal_time_tolerance: holding position" in late.graph.lines("error")


class TestHolds:
    def test_a_cancelled_goal_can_come_to_rest_with_a_deceleration(self) -> None:
        braking = {"j1": {"max_deceleration_on_cancel": 4.0}, "j2": {"max_deceleration_on_cancel": 10.0}}
        arm = Arm("pos_vel_acc", constraints={"decelerate_on_cancel": True, **braking})
        name = arm.goal(point(1.0, 0.5, 0.0), point(2.0, 1.0, 0.0, velocities=[0.0, 0.0]))
        arm.run(500)
        arm.put(0.25, 0.0, velocities=(0.8, -1.0))
        arm.cancel(name)
        commands = arm.commands(600)
        # The first waypoint is the state at the cancel, at the time of the next update.
        for k in (1, 50, 150, 199):
            time = k * STEP_S
            assert commands[k - 1] == pytest.approx(0.25 + 0.8 * time - 2.0 * time**2, abs=1e-6)
        assert commands[-1] == pytest.approx(0.25 + 0.8**2 / 8.0)
        assert arm.j2.command == pytest.approx(-(1.0**2) / 20.0)
        assert arm.j1.command_velocity == arm.j1.command_acceleration == 0.0

    @pytest.mark.parametrize(
        ("parameters", "text"),
        [
            ({"constraints": {"decelerate_on_cancel": True}}, "constraints/j1/max_deceleration_on_cancel"),
            (
                {
                    "constraints": {
                        "decelerate_on_cancel": True,
                        **{name: {"max_deceleration_on_cancel": 1.0} for name in ("j1", "j2")},
                    },
                    "urdf": "",
                },
                "a velocity limit of j1",
            ),
        ],
    )
    def test_without_what_that_needs_it_stops_at_once_and_says_so(self, parameters: dict, text: str) -> None:
        arm = Arm(**parameters)
        assert text in arm.graph.lines("error")
        name = arm.goal(point(1.0, 1.0, 1.0))
        arm.run(100)
        arm.cancel(name)
        arm.put(0.1, 0.1, velocities=(1.0, 1.0))
        arm.run(50)
        assert arm.j1.command == pytest.approx(0.1, abs=1e-3)

    def test_after_the_timeout_the_measured_positions_are_held(self) -> None:
        arm = Arm(cmd_timeout=0.05)
        arm.send(point(0.1, 1.0, 1.0))
        arm.run(110)
        arm.put(0.9, 0.9)
        arm.run(40)
        assert arm.j1.command == 1.0
        arm.run(10)
        assert arm.j1.command == 0.9
        assert "Aborted due to command timeout" in arm.graph.lines("warn")

    def test_a_goal_outside_its_tolerance_at_the_timeout_succeeds_as_upstream(self) -> None:
        arm = Arm(cmd_timeout=0.05, constraints={"j1": {"goal": 0.01}})
        arm.put(0.0, 0.0)
        arm.goal(point(0.1, 1.0, 1.0))
        arm.run(250)
        assert [status for _, status, *_ in arm.results()] == [GoalStatus.SUCCEEDED]

    def test_a_timeout_within_the_goal_time_has_no_effect(self) -> None:
        arm = Arm(cmd_timeout=0.05, constraints={"goal_time": 0.1})
        assert "cmd_timeout has no effect: it must be above constraints/goal_time" in arm.graph.lines("warn")
        arm.send(point(0.01, 1.0, 1.0))
        arm.run(20)
        arm.put(0.9, 0.9)
        arm.run(200)
        assert arm.j1.command == 1.0


class TestReplacement:
    def running(self, **parameters: Any) -> Arm:
        """Two waypoints, with 100 of 300 cycles done."""
        arm = Arm("pos_vel", **parameters)
        arm.send(point(0.2, 1.0, 0.5, velocities=[2.0, 0.5]), point(0.3, 1.2, 0.6, velocities=[0.0, 0.0]))
        arm.run(100)
        return arm

    def old(self, joint: int = 0) -> np.polynomial.Polynomial:
        return polynomial(0.2, [0.0, 0.0], [(1.0, 2.0), (0.5, 0.5)][joint])

    def test_the_new_trajectory_begins_at_the_running_one_not_at_the_measured_state(self) -> None:
        arm = self.running()
        arm.put(9.0, 9.0)
        arm.send(point(0.1, 0.0, 0.0, velocities=[0.0, 0.0]))
        anchor = [self.old()(0.099), self.old().deriv()(0.099)]
        motion = polynomial(0.1, anchor, [0.0, 0.0])
        commands = arm.commands(100)
        assert commands == pytest.approx([motion((k + 1) * STEP_S) for k in range(100)], abs=1e-6)

    def test_until_its_stamp_the_running_one_goes_on(self) -> None:
        arm = self.running()
        now = arm.graph.time_ns * 1e-9
        arm.send(point(0.1, 0.0, 0.0, velocities=[0.0, 0.0]), stamp=now + STEP_S + 0.15)
        commands = arm.commands(251)
        # At 0.249 s of the running one, which is beyond its first waypoint.
        second = polynomial(0.1, [1.0, 2.0], [1.2, 0.0])
        assert commands[100] == pytest.approx(1.0)
        assert commands[149] == pytest.approx(second(0.049), abs=1e-9)
        motion = polynomial(0.1, [second(0.049), second.deriv()(0.049)], [0.0, 0.0])
        assert commands[199] == pytest.approx(motion(0.05), abs=1e-9)
        assert commands[250] == 0.0

    def test_joints_that_it_omits_follow_the_running_one_to_its_end(self) -> None:
        arm = self.running(allow_partial_joints_goal=True)
        arm.send(point(0.05, 0.3, velocities=[0.0]), joints=("j1",))
        arm.run(50)
        assert arm.j1.command == pytest.approx(0.3)
        assert arm.j2.command == pytest.approx(self.old(1)(0.149), abs=1e-9)
        arm.run(200)
        assert (arm.j1.command, arm.j2.command) == pytest.approx((0.3, 0.6))

    def test_switched_off_it_begins_at_once_from_the_measured_state(self) -> None:
        arm = self.running(allow_trajectory_replacement=False)
        arm.put(0.8, 0.8)
        now = arm.graph.time_ns * 1e-9
        arm.send(point(0.1, 0.0, 0.0), stamp=now + STEP_S + 0.1)
        assert arm.commands(100) == pytest.approx([0.8 * (1.0 - (k + 1) * STEP_S / 0.2) for k in range(100)])

    def test_a_hold_and_a_single_waypoint_are_replaced_at_once(self) -> None:
        arm = Arm()
        arm.send(point(1.0, 1.0, 1.0))
        arm.run(100)
        arm.put(0.0, 0.0)
        arm.send(point(0.1, -1.0, -1.0))
        assert arm.commands(1) == pytest.approx([-0.01])


class TestSpeedScaling:
    def test_a_trajectory_runs_at_the_factor_with_the_look_ahead_unscaled(self) -> None:
        arm = Arm(speed_scaling={"initial_scaling_factor": 0.5})
        arm.send(point(0.1, 1.0, 1.0))
        arm.run(101)
        assert arm.state["reference"]["positions"][0] == pytest.approx(0.5)
        assert arm.j1.command == pytest.approx(0.5 + STEP_S / 0.1)
        assert arm.state["speed_scaling_factor"] == 0.5
        assert arm.state["reference"]["time_from_start"] == {"secs": 0, "nsecs": 50_000_000}
        assert arm.state["feedback"]["time_from_start"] == {"secs": 0, "nsecs": 100_000_000}
        arm.scale(0.0)
        arm.run(100)
        assert arm.state["reference"]["positions"][0] == pytest.approx(0.5)
        arm.scale(2.0)
        arm.run(24)
        assert arm.state["reference"]["positions"][0] == pytest.approx(0.98)

    @pytest.mark.parametrize("factor", [-0.1, nan, inf])
    def test_a_wrong_factor_is_refused(self, factor: float) -> None:
        arm = Arm()
        with pytest.raises(MessageRefused, match="must be 0 or above"):
            arm.scale(factor)
        arm.run()
        assert arm.state["speed_scaling_factor"] == 1.0

    def test_only_positions_are_scaled(self) -> None:
        arm = Arm("pos_vel", speed_scaling={"initial_scaling_factor": 0.5})
        assert f"{NAMESPACE}/speed_scaling_input" not in arm.graph.subscribers
        assert "initial_scaling_factor has no effect" in arm.graph.lines("warn")
        arm.run()
        assert arm.state["speed_scaling_factor"] == 1.0

    def test_a_replacement_begins_where_the_scaled_time_will_be(self) -> None:
        arm = Arm()
        arm.send(point(1.0, 1.0, 1.0), point(2.0, 2.0, 2.0))
        arm.run(101)
        arm.scale(0.5)
        now = arm.graph.time_ns * 1e-9
        arm.send(point(0.1, 0.0, 0.0), stamp=now + STEP_S + 0.2)
        arm.run(201)
        assert arm.state["reference"]["positions"][0] == pytest.approx(0.2, abs=1e-6)


class TestState:
    def test_each_update_publishes_reference_feedback_error_and_output(self) -> None:
        arm = Arm("pos_vel")
        arm.send(point(0.1, 1.0, 1.0, velocities=[0.0, 0.0]))
        before = len(arm.states())
        arm.run(50)
        assert len(arm.states()) == before + 50
        msgs.check("slidectl/JointTrajectoryControllerState", arm.state)
        motion = polynomial(0.1, [0.0, 0.0], [1.0, 0.0])
        assert arm.state["joint_names"] == ["j1", "j2"]
        assert arm.state["reference"]["positions"][0] == pytest.approx(motion(0.049))
        assert arm.state["output"]["positions"][0] == pytest.approx(motion(0.05))
        assert arm.state["output"]["velocities"][0] == pytest.approx(motion.deriv()(0.05))
        assert arm.state["feedback"]["positions"][0] == pytest.approx(motion(0.049))
        assert arm.state["error"]["positions"][0] == pytest.approx(0.0)
        assert arm.state["output"]["accelerations"] == arm.state["reference"]["effort"] == []

    def test_it_is_counted_when_nobody_listens(self) -> None:
        arm = Arm()
        publisher = arm.graph.publishers[f"{NAMESPACE}/controller_state"]
        publisher.wanted = False
        sent, counted = len(publisher.messages), publisher.sequence
        arm.run(10)
        assert (len(publisher.messages), publisher.sequence) == (sent, counted + 10)

    def test_velocities_that_are_not_asked_for_are_not_there(self) -> None:
        arm = Arm(state_interfaces=["position"])
        arm.put(0.0, 0.0, velocities=(5.0, 5.0))
        arm.send(point(0.1, 1.0, 1.0, velocities=[0.0, 0.0]))
        arm.run(50)
        assert arm.j1.command == pytest.approx(polynomial(0.1, [0.0, 0.0], [1.0, 0.0])(0.05))
        assert arm.state["feedback"]["velocities"] == arm.state["error"]["velocities"] == []

    def test_a_query_tells_the_desired_state_at_any_time_and_moves_nothing(self) -> None:
        arm = Arm()
        arm.send(point(0.1, 1.0, 2.0), point(0.2, 3.0, 4.0))
        arm.run(10)
        start = (arm.graph.time_ns - 9_000_000) * 1e-9
        found = arm.query(start + 0.15)
        assert (found["success"], found["name"]) == (True, ["j1", "j2"])
        assert found["position"] == pytest.approx([2.0, 3.0])
        assert found["velocity"] == pytest.approx([20.0, 20.0])
        assert arm.query(start + 0.05)["position"] == pytest.approx([0.5, 1.0])
        assert arm.commands(1) == pytest.approx([0.11])
        beyond = arm.query(start + 9.0)
        assert (beyond["success"], beyond["position"]) == (False, [3.0, 4.0])
        before = arm.query(0.0)
        assert not before["success"]
        assert before["position"] == pytest.approx([0.1, 0.2])
        arm.run(150)
        assert arm.query(start + 0.05)["position"] == pytest.approx([0.5, 1.0])
        arm.request(stop=["arm"])
        arm.run()
        stopped = arm.query(start + 0.05)
        assert (stopped["success"], stopped["name"], stopped["position"]) == (False, [], [])


class TestParameters:
    @pytest.mark.parametrize(
        ("name", "value"),
        [("joints", ["j1"]), ("interpolation_method", "none"), ("action_monitor_rate", 5.0)],
    )
    def test_what_is_fixed_at_the_load_is_not_changed_later(self, name: str, value: Any) -> None:
        arm = Arm()
        with pytest.raises(Refused, match=f"{NAMESPACE}/{name} is fixed when the controller is loaded"):
            arm.set(name, value)

    @pytest.mark.parametrize(
        ("name", "value", "text"),
        [
            ("constraints/goal_time", -1.0, "must be a number of 0 or more"),
            ("gains/j1/u_clamp_min", 2.0, "gains/j1/u_clamp_min"),
            ("gains/j1/p", inf, "gains/j1/p must be a finite number"),
            ("gains/j1/antiwindup_strategy", "no", "must be none"),
        ],
    )
    def test_a_value_that_it_cannot_use_is_refused(self, name: str, value: Any, text: str) -> None:
        arm = Arm("effort", gains={"j1": {"u_clamp_max": 1.0}})
        with pytest.raises(Refused, match=text):
            arm.set(name, value)

    def test_tolerances_count_from_the_next_goal_on(self) -> None:
        arm = Arm()
        arm.put(0.0, 0.0)
        arm.goal(point(1.0, 1.0, 1.0))
        arm.run(10)
        arm.set("constraints/j1/trajectory", 0.1)
        arm.run(500)
        assert not arm.results()
        arm.goal(point(1.0, 1.0, 1.0))
        arm.run(200)
        assert [code for *_, code, _ in arm.results()] == [-1, -4]

    def test_gains_without_a_pid_and_of_other_joints_are_pointed_out(self) -> None:
        arm = Arm(gains={"j1": {"p": 1.0}, "j9": {"p": 1.0}}, constraints={"j8": {"goal": 1.0}})
        said = arm.graph.lines("warn")
        assert "gains has no effect: only velocity or effort alone has a PID" in said
        assert "gains/j9 has no effect" in said
        assert "constraints/j8 has no effect" in said
