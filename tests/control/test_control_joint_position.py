"""Position of one joint by a PID: set points, limits, angles, state topic, and a joint that gets where it is sent."""

from math import inf, nan, pi

import pytest
from fake_robot import STEP_S, Bench, FakeRobot

from slidectl import msgs
from slidectl.control.angular_distance import distance_with_large_limits
from slidectl.errors import MessageRefused

COMMAND, STATE = "/bot/arm/command", "/bot/arm/state"


def urdf(kind="prismatic", lower=-1.0, upper=1.0, name="joint1"):
    limit = "" if kind == "continuous" else f'<limit effort="100" velocity="0.1" lower="{lower}" upper="{upper}"/>'
    inertia = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    return (
        f'<robot name="bot"><link name="world"/><link name="tip">{inertia}</link>'
        f'<joint name="{name}" type="{kind}"><parent link="world"/><child link="tip"/>'
        f'<axis xyz="0 0 1"/>{limit}</joint></robot>'
    )


def bench_with(xml, kind="effort", pid=None, commands=("effort",), **parameters):
    values = {
        "type": f"{kind}_controllers/JointPositionController",
        "joint": "joint1",
        "pid": pid or {"p": 100.0, "d": 10.0},
        **parameters,
    }
    bench = Bench(FakeRobot(commands=commands), {"arm": values})
    if xml is not None:
        bench.graph.set("/bot/robot_description", xml)
    return bench


@pytest.fixture
def bench():
    """A started controller of a sliding joint with the ends -1 m and 1 m."""
    bench = bench_with(urdf())
    bench.start("arm")
    return bench


def send(bench, value):
    bench.graph.send(COMMAND, {"data": value})


class TestLoading:
    def test_it_claims_its_joint(self, bench):
        assert bench.manager.list()[0]["claimed_resources"] == [
            {"hardware_interface": "hardware_interface::EffortJointInterface", "resources": ["joint1"]}
        ]

    def test_it_offers_its_topics_and_its_gains(self, bench):
        assert bench.graph.types[COMMAND] == "std_msgs/Float64"
        assert bench.graph.publishers[STATE].type_name == "control_msgs/JointControllerState"
        assert "/bot/arm/pid/set_parameters" in bench.graph.services

    @pytest.mark.parametrize(
        ("changes", "reason"),
        [
            ({"joint": None}, "parameter /bot/arm/joint is not set"),
            ({"joint": 1}, "parameter /bot/arm/joint must be a string"),
            ({"pid": {"i": 1.0}}, "parameter /bot/arm/pid/p is not set"),
            ({"joint": "joint9"}, "no joint 'joint9' in hardware_interface::EffortJointInterface"),
            ({"xml": None}, "no parameter robot_description in /bot/arm or above it"),
            ({"xml": 5}, "parameter /bot/robot_description is not a robot description"),
            ({"xml": "<robot"}, "robot_description"),
            ({"xml": urdf(name="another")}, "no joint 'joint1' in /bot/robot_description"),
        ],
    )
    def test_what_is_missing_is_named_and_nothing_is_left(self, changes, reason):
        bench = bench_with(**{"xml": urdf(), **changes})
        assert not bench.manager.load("arm")
        assert reason in bench.graph.lines("error")
        assert bench.graph.publishers == bench.graph.subscribers == bench.graph.services == {}
        assert bench.graph.watches == []

    def test_the_description_is_searched_upwards(self):
        bench = bench_with(None)
        bench.graph.set("/robot_description", urdf())
        bench.load("arm")

    def test_the_nearest_description_counts(self):
        bench = bench_with(urdf())
        bench.graph.set("/robot_description", urdf(name="another"))
        bench.load("arm")

    def test_it_drives_velocity_joints_too(self):
        bench = bench_with(urdf(), kind="velocity", commands=["velocity"])
        bench.start("arm")
        send(bench, 0.5)
        bench.run()
        assert bench.robot.joints["joint1"].command > 0.0


class TestSetPoint:
    def test_it_starts_where_the_joint_is(self):
        bench = bench_with(urdf())
        bench.robot.joints["joint1"].position = 0.4
        bench.start("arm")
        bench.run()
        assert bench.robot.joints["joint1"].command == 0.0

    def test_it_starts_at_the_nearest_limit_of_a_joint_outside(self):
        bench = bench_with(urdf(), pid={"p": 1.0})
        bench.robot.joints["joint1"].position = 1.5
        bench.start("arm")
        bench.run()
        assert bench.robot.joints["joint1"].command == -0.5

    @pytest.mark.parametrize(("command", "error"), [(0.5, 0.5), (3.0, 1.0), (-3.0, -1.0)])
    def test_commands_are_brought_within_the_limits(self, command, error):
        bench = bench_with(urdf(), pid={"p": 1.0})
        bench.start("arm")
        send(bench, command)
        bench.run()
        assert bench.robot.joints["joint1"].command == error

    def test_a_restart_forgets_command_and_integral(self):
        bench = bench_with(urdf(), pid={"p": 1.0, "i": 1000.0, "i_clamp": 9.0})
        bench.start("arm")
        send(bench, 0.5)
        bench.run(3)
        bench.run(reset_controllers=True)
        assert bench.robot.joints["joint1"].command == 0.0

    def test_a_stop_leaves_the_last_command_in_place(self, bench):
        send(bench, 0.5)
        bench.run()
        bench.request(stop=["arm"])
        bench.run()
        last = bench.robot.joints["joint1"].command
        bench.run(10)
        assert bench.robot.joints["joint1"].command == last != 0.0

    @pytest.mark.parametrize("value", [nan, inf, -inf])
    def test_a_command_that_is_no_number_is_refused_and_the_last_one_stays(self, bench, value):
        send(bench, 0.5)
        with pytest.raises(MessageRefused, match="/bot/arm refuses the command"):
            send(bench, value)
        assert "must be a finite number" in bench.graph.lines("error")
        bench.run(11)
        assert bench.graph.sent(STATE)[-1]["set_point"] == 0.5

    def test_a_command_before_the_start_is_lost_and_says_so_once(self):
        bench = bench_with(urdf())
        bench.load("arm")
        for _ in range(5):
            send(bench, 0.5)
        assert bench.graph.lines("warn") == (
            "/bot/arm is not running: the command has no effect; start it: slidectl controller start arm"
        )
        bench.run(1100)
        send(bench, 0.5)
        assert bench.graph.lines("warn").count("is not running") == 2  # whoever tries again later is told again
        bench.request(["arm"])
        bench.run(2)
        assert bench.robot.joints["joint1"].command == 0.0


class TestAngles:
    def command_of(self, xml, position, set_point):
        """The effort at p = 1 is the error."""
        bench = bench_with(xml, pid={"p": 1.0})
        bench.robot.joints["joint1"].position = position
        bench.start("arm")
        send(bench, set_point)
        bench.run()
        return bench.robot.joints["joint1"].command

    def test_a_sliding_joint_takes_the_plain_difference(self):
        assert self.command_of(urdf("prismatic", -9.0, 9.0), -4.0, 4.0) == 8.0

    def test_a_wide_revolute_joint_takes_the_short_way_round(self):
        assert self.command_of(urdf("revolute", -6.3, 6.3), 0.0, 6.0) == pytest.approx(6.0 - 2 * pi)

    def test_a_narrow_revolute_joint_takes_the_way_within_its_limits(self):
        assert self.command_of(urdf("revolute", -2.0, 2.0), -1.9, 1.9) == pytest.approx(3.8)

    def test_a_continuous_joint_does_not_count_turns(self):
        assert self.command_of(urdf("continuous"), 0.0, 7.0) == pytest.approx(7.0 - 2 * pi)

    def test_the_limits_of_a_revolute_joint_bound_its_set_point(self):
        assert self.command_of(urdf("revolute", -1.0, 1.0), 0.0, 3.0) == pytest.approx(1.0)


class TestState:
    def test_every_tenth_update_publishes_the_first_one_too(self, bench):
        bench.run(31)
        times = [message["header"]["stamp"]["nsecs"] // 1_000_000 for message in bench.graph.sent(STATE)]
        assert times == [2, 12, 22, 32]

    def test_the_count_goes_on_through_a_restart(self, bench):
        bench.run(5)
        bench.run(reset_controllers=True)
        bench.run(5)
        assert len(bench.graph.sent(STATE)) == 2

    def test_the_state_says_what_the_law_saw_and_did(self):
        bench = bench_with(urdf(), pid={"p": 2.0, "i": 1.0, "d": 3.0, "i_clamp": 4.0, "antiwindup": True})
        bench.start("arm")
        joint = bench.robot.joints["joint1"]
        joint.position, joint.velocity = 0.25, 0.5
        send(bench, 7.0)
        bench.run()
        (state,) = bench.graph.sent(STATE)
        assert state["header"] == {"seq": 0, "stamp": {"secs": 0, "nsecs": 2_000_000}, "frame_id": ""}
        assert (state["set_point"], state["process_value"], state["process_value_dot"]) == (1.0, 0.25, 0.5)
        assert (state["error"], state["time_step"], state["command"]) == (0.75, STEP_S, joint.command)
        assert (state["p"], state["i"], state["d"], state["i_clamp"]) == (2.0, 1.0, 3.0, 4.0)
        assert state["antiwindup"] is True

    def test_the_state_fits_its_type(self, bench):
        bench.run(2)
        (state,) = bench.graph.sent(STATE)
        assert msgs.check("control_msgs/JointControllerState", state) == state

    def test_the_rhythm_is_the_same_whether_anybody_listens(self, bench):
        bench.graph.publishers[STATE].wanted = False
        bench.run(5)
        bench.graph.publishers[STATE].wanted = True
        bench.run(6)
        assert [message["header"]["stamp"]["nsecs"] for message in bench.graph.sent(STATE)] == [12_000_000]


class TestGains:
    def test_a_parameter_takes_effect_at_the_next_cycle(self):
        bench = bench_with(urdf(), pid={"p": 1.0})
        bench.start("arm")
        send(bench, 0.5)
        bench.run()
        bench.graph.set("/bot/arm/pid/p", 8.0)
        bench.run()
        assert bench.robot.joints["joint1"].command == 4.0


def test_a_double_integrator_reaches_one_minus_one_and_zero():
    """A mass of 1 on a wide revolute joint, period 0.01 s, gains 0.25 and 1, 20 s for each."""
    bench = bench_with(urdf("revolute", -6.3, 6.3), pid={"p": 0.25, "d": 1.0})
    bench.start("arm")
    joint, time_ns = bench.robot.joints["joint1"], bench.graph.time_ns
    for target in (1.0, -1.0, 0.0):
        send(bench, target)
        for _ in range(2000):
            time_ns += 10_000_000
            bench.manager.update(time_ns, 0.01)
            joint.velocity += joint.command * 0.01
            joint.position += joint.velocity * 0.01
        assert joint.position == pytest.approx(target, abs=0.05)
    assert distance_with_large_limits(joint.position, 0.0, -6.3, 6.3) == pytest.approx(0.0, abs=0.05)
