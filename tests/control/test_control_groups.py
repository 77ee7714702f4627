"""Groups of joints: one command for all of them, its size and its values, and the PIDs of a group."""

from math import inf, nan

import pytest
from fake_robot import Bench, FakeRobot

from slidectl.errors import MessageRefused

COMMAND = "/bot/group/command"
KINDS = {
    "effort": "effort_controllers/JointGroupEffortController",
    "velocity": "velocity_controllers/JointGroupVelocityController",
    "position": "position_controllers/JointGroupPositionController",
}
INERTIA = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
URDF = f"""<robot name="bot"><link name="world"/><link name="a">{INERTIA}</link><link name="b">{INERTIA}</link>
  <joint name="j1" type="prismatic"><parent link="world"/><child link="a"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="j2" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>"""


def bench_with(type_name, command, **parameters):
    values = {"type": type_name, "joints": ["j2", "j1"], **parameters}
    bench = Bench(FakeRobot(("j1", "j2"), (command,)), {"group": values})
    bench.graph.set("/bot/robot_description", URDF)
    return bench


def send(bench, *values):
    bench.graph.send(COMMAND, {"data": list(values)})


@pytest.fixture(params=KINDS)
def bench(request):
    bench = bench_with(KINDS[request.param], request.param)
    bench.start("group")
    return bench


def test_values_go_to_the_joints_in_the_order_of_the_parameter(bench):
    send(bench, 0.25, -0.5)
    bench.run()
    assert (bench.robot.joints["j2"].command, bench.robot.joints["j1"].command) == (0.25, -0.5)


@pytest.mark.parametrize("values", [(), (1.0,), (1.0, 2.0, 3.0)])
def test_a_command_of_another_size_is_refused_and_the_last_one_stays(bench, values):
    send(bench, 0.25, -0.5)
    with pytest.raises(MessageRefused, match=f"drives 2 joints, and the command has {len(values)} values"):
        send(bench, *values)
    bench.run()
    assert bench.robot.joints["j2"].command == 0.25


@pytest.mark.parametrize("value", [nan, inf])
def test_a_command_that_is_not_finite_is_refused_as_a_whole(bench, value):
    send(bench, 0.25, -0.5)
    with pytest.raises(MessageRefused):
        send(bench, 1.0, value)
    bench.run()
    assert bench.robot.joints["j2"].command == 0.25


def test_values_beyond_the_limits_are_named_with_their_joints(bench):
    for joint in bench.robot.joints.values():
        joint.lowest, joint.highest = -1.0, 1.0
    send(bench, 3.0, -2.0)
    expected = (
        "/bot/group: 3 is beyond the upper limit of joint 'j2'; it gets 1, "
        "-2 is beyond the lower limit of joint 'j1'; it gets -1"
    )
    assert bench.graph.lines("warn") == expected


@pytest.mark.parametrize(
    ("joints", "text"),
    [
        (None, "parameter /bot/group/joints is not set; it must be a list of strings"),
        ([], "parameter /bot/group/joints must name at least one joint"),
        ("j1", "parameter /bot/group/joints must be a list of strings"),
        (["j1", 2], "parameter /bot/group/joints must be a list of strings"),
        (["j1", "j3"], "joint 'j3'"),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_it_is_not_loaded_without_joints_that_the_robot_has(kind, joints, text):
    bench = bench_with(KINDS[kind], kind, joints=joints)
    if joints is None:
        bench.graph.delete("/bot/group/joints")
    assert not bench.manager.load("group")
    assert text in bench.graph.lines("error")
    assert not bench.graph.subscribers


def test_a_position_group_starts_by_holding_and_the_others_with_zero():
    for kind, expected in (("position", 0.5), ("velocity", 0.0), ("effort", 0.0)):
        bench = bench_with(KINDS[kind], kind)
        bench.robot.joints["j1"].position = 0.5
        bench.start("group")
        bench.run()
        assert bench.robot.joints["j1"].command == expected


class TestEffortPositions:
    """effort_controllers/JointGroupPositionController."""

    TYPE = "effort_controllers/JointGroupPositionController"
    GAINS = {"j1": {"pid": {"p": 10.0}}, "j2": {"pid": {"p": 100.0}}}

    def test_each_joint_has_its_own_gains_and_its_own_way_to_subtract(self):
        bench = bench_with(self.TYPE, "effort", **self.GAINS)
        bench.start("group")
        send(bench, 6.0, 2.0)  # the continuous joint takes the short way, the other one is cut to its limit
        bench.run()
        assert bench.robot.joints["j2"].command == pytest.approx(100.0 * (6.0 - 6.283185307179586))
        assert bench.robot.joints["j1"].command == pytest.approx(10.0 * 1.0)
        assert "2 is beyond the upper limit of joint 'j1'; it gets 1" in bench.graph.lines("warn")

    def test_it_starts_by_staying_where_the_joints_are(self):
        bench = bench_with(self.TYPE, "effort", **self.GAINS)
        bench.robot.joints["j1"].position = 0.3
        bench.start("group")
        bench.run()
        assert bench.robot.joints["j1"].command == 0.0

    def test_it_is_not_loaded_when_a_joint_has_no_gains(self):
        bench = bench_with(self.TYPE, "effort", j1={"pid": {"p": 10.0}})
        assert not bench.manager.load("group")
        assert "parameter /bot/group/j2/pid/p is not set" in bench.graph.lines("error")

    def test_gains_change_while_it_runs(self):
        bench = bench_with(self.TYPE, "effort", **self.GAINS)
        bench.start("group")
        send(bench, 0.0, 1.0)
        bench.graph.set("/bot/group/j1/pid/p", 20.0)
        bench.run()
        assert bench.robot.joints["j1"].command == 20.0
