"""Velocity of one joint by a PID, and the controllers that hand a command on as it is."""

from math import nan

import pytest
from fake_robot import Bench, FakeRobot

from slidectl.errors import MessageRefused

FORWARDING = [
    ("effort_controllers/JointEffortController", "effort"),
    ("velocity_controllers/JointVelocityController", "velocity"),
    ("position_controllers/JointPositionController", "position"),
]


def bench_with(type_name, commands=("effort",), **parameters):
    return Bench(FakeRobot(commands=commands), {"arm": {"type": type_name, "joint": "joint1", **parameters}})


def send(bench, value):
    bench.graph.send("/bot/arm/command", {"data": value})


class TestVelocityByPid:
    TYPE = "effort_controllers/JointVelocityController"

    @pytest.fixture
    def bench(self):
        bench = bench_with(self.TYPE, pid={"p": 2.0})
        bench.start("arm")
        return bench

    def test_the_effort_follows_the_velocity_error(self, bench):
        joint = bench.robot.joints["joint1"]
        joint.velocity = 0.5
        bench.run()
        assert joint.command == -1.0
        send(bench, 2.0)
        bench.run()
        assert joint.command == 3.0

    def test_it_starts_by_standing_still(self, bench):
        send(bench, 2.0)
        bench.run(reset_controllers=True)
        assert bench.robot.joints["joint1"].command == 0.0

    def test_it_needs_no_robot_description_but_a_joint_and_a_gain(self):
        assert not bench_with(self.TYPE).manager.load("arm")
        assert not bench_with(self.TYPE, joint="joint9", pid={"p": 1.0}).manager.load("arm")
        assert not bench_with(self.TYPE, joint=None, pid={"p": 1.0}).manager.load("arm")

    def test_the_state_is_of_velocities(self, bench):
        joint = bench.robot.joints["joint1"]
        joint.velocity = 0.5
        send(bench, 2.0)
        bench.run(11)
        states = bench.graph.sent("/bot/arm/state")
        assert len(states) == 2
        assert (states[0]["set_point"], states[0]["process_value"], states[0]["error"]) == (2.0, 0.5, 1.5)
        assert (states[0]["process_value_dot"], states[0]["command"]) == (0.0, 3.0)


@pytest.mark.parametrize(("type_name", "interface"), FORWARDING)
class TestForwarding:
    def test_commands_are_handed_on_as_they_are(self, type_name, interface):
        bench = bench_with(type_name, [interface])
        bench.start("arm")
        send(bench, 1234.5)
        assert bench.robot.joints["joint1"].command == 0.0
        bench.run()
        assert bench.robot.joints["joint1"].command == 1234.5

    def test_it_claims_its_joint_and_has_no_state_topic(self, type_name, interface):
        bench = bench_with(type_name, [interface])
        bench.load("arm")
        assert bench.manager.list()[0]["claimed_resources"][0]["resources"] == ["joint1"]
        assert bench.graph.publishers == {}

    def test_it_starts_with_zero_or_with_the_measured_position(self, type_name, interface):
        bench = bench_with(type_name, [interface])
        bench.robot.joints["joint1"].position = 0.7
        bench.start("arm")
        send(bench, 5.0)
        bench.run(reset_controllers=True)
        assert bench.robot.joints["joint1"].command == (0.7 if interface == "position" else 0.0)

    def test_a_command_that_is_no_number_is_refused(self, type_name, interface):
        bench = bench_with(type_name, [interface])
        bench.start("arm")
        with pytest.raises(MessageRefused):
            send(bench, nan)

    def test_it_needs_its_joint_and_its_interface(self, type_name, interface):
        assert not bench_with(type_name, [interface], joint=None).manager.load("arm")
        assert not bench_with(type_name, [interface], joint="joint9").manager.load("arm")
        assert not bench_with(type_name, ()).manager.load("arm")


@pytest.mark.parametrize(("type_name", "interface"), FORWARDING)
def test_a_command_that_the_hardware_will_cut_is_handed_on_and_said(type_name, interface):
    bench = bench_with(type_name, commands=(interface,))
    joint = bench.robot.joints["joint1"]
    joint.lowest, joint.highest = -2.0, 3.0
    bench.start("arm")
    for value, text in ((100.0, "100 is beyond the upper limit"), (-2.5, "-2.5 is beyond the lower limit")):
        bench.graph.log.clear()
        bench.graph.reasons = []
        send(bench, value)
        send(bench, value)
        bench.run()
        assert joint.command == value
        assert text in bench.graph.lines("warn")
        assert len(bench.graph.log) == 1, "the log has it once a second"
        assert len(bench.graph.reasons) == 1, "and whoever asks again, in the answer"
    bench.graph.log.clear()
    send(bench, 3.0)
    assert bench.graph.log == []
