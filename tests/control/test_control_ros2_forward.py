"""forward_command_controller and the group controllers of ROS 2: what a command does, and which ones are refused."""

from __future__ import annotations

from math import inf, nan

import pytest
from fake_robot import Bench, FakeRobot

from slidectl.errors import MessageRefused

COMMANDS = "/bot/group/commands"
FORWARD = "forward_command_controller/ForwardCommandController"
MULTI = "forward_command_controller/MultiInterfaceForwardCommandController"
KINDS = {
    "position": "position_controllers/JointGroupPositionController",
    "velocity": "velocity_controllers/JointGroupVelocityController",
    "effort": "effort_controllers/JointGroupEffortController",
}


def bench_with(type_name: str, commands: tuple[str, ...], **parameters: object) -> Bench:
    robot = FakeRobot(("j1", "j2"), commands)
    robot.is_of_ros2 = True
    return Bench(robot, {"group": {"type": type_name, "joints": ["j2", "j1"], **parameters}})


def send(bench: Bench, *values: float) -> None:
    bench.graph.send(COMMANDS, {"data": list(values)})


def commands(bench: Bench) -> tuple[float, float]:
    return bench.robot.joints["j2"].command, bench.robot.joints["j1"].command


def stop(bench: Bench) -> None:
    assert bench.request(stop=["group"])
    bench.run()


@pytest.fixture(params=[*KINDS, *(f"forward {name}" for name in KINDS)])
def bench(request: pytest.FixtureRequest) -> Bench:
    name = request.param.rpartition(" ")[2]
    if name == request.param:
        bench = bench_with(KINDS[name], (name,))
    else:
        bench = bench_with(FORWARD, (name,), interface_name=name)
    for joint in bench.robot.joints.values():
        joint.position, joint.command = 0.5, 7.0
    bench.start("group")
    return bench


def test_nothing_is_commanded_before_the_first_message(bench: Bench) -> None:
    bench.run(3)
    assert commands(bench) == (7.0, 7.0)


def test_values_go_to_the_joints_in_the_order_of_the_parameter_in_each_cycle(bench: Bench) -> None:
    send(bench, 0.25, -0.5)
    bench.run()
    assert commands(bench) == (0.25, -0.5)
    bench.robot.joints["j2"].command = 3.0
    bench.run()
    assert commands(bench) == (0.25, -0.5)


def test_an_empty_message_ends_the_commands(bench: Bench) -> None:
    send(bench, 0.25, -0.5)
    send(bench)
    bench.run()
    assert commands(bench) == (7.0, 7.0)
    assert not bench.graph.lines("error")


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_message_that_is_not_finite_is_dropped_with_a_warning_per_second(bench: Bench, value: float) -> None:
    send(bench, 0.25, -0.5)
    for _ in range(3):
        with pytest.raises(MessageRefused, match="it must have finite numbers"):
            send(bench, 1.0, value)
    bench.run()
    assert commands(bench) == (0.25, -0.5)
    assert len(bench.graph.log) == 1


@pytest.mark.parametrize("values", [(1.0,), (1.0, 2.0, 3.0)])
def test_a_message_of_another_size_is_an_error_per_second_until_it_is_replaced(
    bench: Bench, values: tuple[float, ...]
) -> None:
    send(bench, 0.25, -0.5)
    bench.run()
    send(bench, *values)
    bench.robot.joints["j2"].command = 3.0
    bench.run(2500)
    assert commands(bench) == (3.0, -0.5)  # nothing is written
    text = f"/bot/group commands 2 interfaces, and the command has {len(values)} values: none is used"
    assert [line for severity, line in bench.graph.log if severity == "error"] == 3 * [text]
    send(bench, 0.75, 0.0)
    bench.run()
    assert commands(bench) == (0.75, 0.0)
    assert bench.states() == {"group": "active"}


def test_a_stop_and_a_start_forget_the_command(bench: Bench) -> None:
    send(bench, 0.25, -0.5)
    bench.run()
    stop(bench)
    for joint in bench.robot.joints.values():
        joint.command = 9.0
    send(bench, 1.0, 1.0)
    assert "is not running: the command has no effect; start it: slidectl controller start group" in bench.graph.lines()
    assert bench.request(start=["group"])
    bench.run(3)
    assert commands(bench) == (9.0, 9.0)


@pytest.mark.parametrize(("name", "left"), [("position", (0.25, -0.5)), ("velocity", (0, 0)), ("effort", (0, 0))])
def test_a_stop_leaves_positions_and_sets_velocities_and_efforts_to_0(name: str, left: tuple[float, float]) -> None:
    bench = bench_with(KINDS[name], (name,))
    bench.start("group")
    send(bench, 0.25, -0.5)
    bench.run()
    stop(bench)
    assert commands(bench) == left


def test_a_forward_controller_leaves_its_velocities_when_it_stops() -> None:
    bench = bench_with(FORWARD, ("velocity",), interface_name="velocity")
    bench.start("group")
    send(bench, 0.25, -0.5)
    bench.run()
    stop(bench)
    assert commands(bench) == (0.25, -0.5)


def test_it_writes_at_its_own_rate() -> None:
    bench = bench_with(KINDS["effort"], ("effort",), update_rate=100)
    bench.start("group")
    bench.run()  # the first update
    send(bench, 0.25, -0.5)
    bench.run(9)
    assert commands(bench) == (0.0, 0.0)
    bench.run()
    assert commands(bench) == (0.25, -0.5)


def test_values_beyond_the_limits_are_named_with_their_joints() -> None:
    bench = bench_with(KINDS["position"], ("position",))
    for joint in bench.robot.joints.values():
        joint.lowest, joint.highest = -1.0, 1.0
    bench.start("group")
    send(bench, 3.0, 0.0)
    assert bench.graph.lines("warn") == "/bot/group: 3 is beyond the upper limit of joint 'j2'; it gets 1"


def test_only_the_joints_of_its_interface_are_claimed() -> None:
    bench = bench_with(FORWARD, ("position", "velocity"), interface_name="velocity", joints=["j2"])
    bench.load("group")
    claimed = {each["hardware_interface"]: each["resources"] for each in bench.manager.list()[0]["claimed_resources"]}
    assert claimed == {
        "hardware_interface::PositionJointInterface": [],
        "hardware_interface::VelocityJointInterface": ["j2"],
    }


class TestSeveralInterfaces:
    """forward_command_controller/MultiInterfaceForwardCommandController."""

    @pytest.mark.parametrize(
        ("names", "interface", "expected"),
        [
            (["velocity", "position"], "pos_vel", (2.0, 1.0, 0.0)),
            (["position", "velocity", "acceleration"], "pos_vel_acc", (1.0, 2.0, 3.0)),
            (["effort"], "effort", (1.0, 0.0, 0.0)),
        ],
    )
    def test_the_values_are_those_of_the_interfaces(
        self, names: list[str], interface: str, expected: tuple[float, float, float]
    ) -> None:
        bench = bench_with(MULTI, (interface,), joint="j1", interface_names=names)
        bench.start("group")
        send(bench, *[1.0, 2.0, 3.0][: len(names)])
        bench.run()
        joint = bench.robot.joints["j1"]
        assert (joint.command, joint.command_velocity, joint.command_acceleration) == expected
        assert bench.robot.joints["j2"].command == 0.0

    @pytest.mark.parametrize("names", [[], ["position", "effort"], ["position", "position"], ["torque"]])
    def test_interfaces_that_no_joint_has_together_are_refused(self, names: list[str]) -> None:
        bench = bench_with(MULTI, ("effort",), joint="j1", interface_names=names)
        assert not bench.manager.load("group")
        assert f"/bot/group/interface_names is {names}; a joint takes ['effort'] or" in bench.graph.lines("error")

    def test_an_interface_that_the_robot_lacks_is_refused(self) -> None:
        bench = bench_with(MULTI, ("effort",), joint="j1", interface_names=["position", "velocity"])
        assert not bench.manager.load("group")
        assert "needs hardware_interface::PosVelJointInterface" in bench.graph.lines("error")


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"interface_name": "torque"}, "must be effort, position, velocity, not 'torque'"),
        ({"interface_name": "effort"}, "this controller needs hardware_interface::EffortJointInterface"),
        ({"interface_name": None}, "parameter /bot/group/interface_name is not set"),
        ({"joints": []}, "parameter /bot/group/joints must name at least one joint"),
        ({"joints": ["j1", "j1"]}, "parameter /bot/group/joints names a joint twice"),
        ({"joints": ["j3"]}, "no joint 'j3'"),
    ],
)
def test_what_does_not_exist_is_not_loaded(parameters: dict, text: str) -> None:
    bench = bench_with(FORWARD, ("position",), **{"interface_name": "position", **parameters})
    assert not bench.manager.load("group")
    assert text in bench.graph.lines("error")
    assert not bench.graph.subscribers


def test_a_robot_of_ros_1_keeps_the_groups_of_ros_1() -> None:
    bench = bench_with(KINDS["position"], ("position",))
    bench.robot.is_of_ros2 = False
    bench.load("group")
    assert set(bench.graph.subscribers) == {"/bot/group/command"}
