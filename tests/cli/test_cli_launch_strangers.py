"""Other people's packages: what cannot be had is left out, and names and values that Gazebo takes are taken."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from launch_runs import kill_all, processes
from waiting import eventually

ARM = """<robot name="arm"><link name="world"/><link name="a"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="w" type="revolute"><parent link="world"/><child link="a"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit lower="-2.147" upper="1.047" effort="50" velocity="5"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="w"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
<actuator name="m"><mechanicalReduction>1</mechanicalReduction></actuator></transmission>
<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo></robot>"""
WORLD = '<include file="$(find gazebo_ros)/launch/empty_world.launch"/>'
MODEL = '<param name="robot_description" textfile="$(dirname)/arm.urdf"/>'
SPAWN = '<node name="spawn" pkg="gazebo_ros" type="spawn_model" args="-urdf -param robot_description {}"/>'
CONTROL = """<rosparam ns="/arm">
jsc: {type: joint_state_controller/JointStateController, publish_rate: 50}
hold: {type: effort_controllers/JointPositionController, joint: w, pid: {p: 900, i: 0, d: 40}}
</rosparam><node name="control" pkg="controller_manager" type="spawner" ns="/arm" args="jsc hold"/>"""


@pytest.fixture
def ends(slidectl: CommandLine) -> Iterator[CommandLine]:
    """The command line; the daemon that a detached launch leaves is stopped."""
    yield slidectl
    slidectl("daemon", "stop")
    kill_all(slidectl.runtime)


def written(folder: Path, *content: str, model: str = ARM) -> str:
    """A launch file with this inside `<launch>`, beside the model."""
    (folder / "arm.urdf").write_text(model)
    path = folder / "arm.launch"
    path.write_text(f"<launch>{''.join(content)}</launch>")
    return str(path)


# --- what is not there -----------------------------------------------------------------------------------------------


def test_side_nodes_that_are_not_there_are_left_out_and_listed_twice(ends: CommandLine, tmp_path: Path) -> None:
    launch = written(
        tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), CONTROL,
        '<node name="joy" pkg="joy" type="joy_node"/><node name="ekf" pkg="robot_localization" type="ekf_node"/>',
        '<node name="go_home" pkg="some_arm" type="home.py"/>',
    )  # fmt: skip
    done = ends("launch", launch, "--detach")
    assert done.returncode == 0, done.stderr
    assert "everything runs" not in done.stdout
    assert "runs without 3 things, listed below" in done.stdout
    for listed in (done.stderr, done.stdout.partition("left out:\n")[2]):
        assert "no package 'joy'; the node /joy is left out: no joystick and no keyboard drives the robot" in listed
        assert "the node /ekf is left out: nobody publishes the frame of the map" in listed
        assert "the node /go_home is left out: nobody sends the start pose" in listed
    states = [json.loads(line)["state"] for line in ends.ok("controller", "list", "--json").splitlines()]
    assert states == ["running", "running"]


def test_strict_refuses_what_is_not_there_before_anything_starts(slidectl: CommandLine, tmp_path: Path) -> None:
    launch = written(tmp_path, WORLD, MODEL, '<node name="joy" pkg="joy" type="joy_node"/>')
    done = slidectl("launch", launch, "--strict")
    assert done.returncode == 2
    assert "no package 'joy'" in done.stderr
    assert "without --strict it is left out" in done.stderr
    assert not processes(slidectl.runtime)


def test_a_required_node_that_is_not_there_ends_the_launch_before_it_starts(
    slidectl: CommandLine, tmp_path: Path
) -> None:
    launch = written(tmp_path, WORLD, MODEL, '<node name="joy" pkg="joy" type="joy_node" required="true"/>')
    for words in ((), ("--keep-going",)):
        done = slidectl("launch", launch, *words)
        assert done.returncode == 2
        assert "a launch ends with a required node" in done.stderr
    assert not processes(slidectl.runtime)


def test_a_file_that_is_not_there_is_an_error_unless_the_launch_keeps_going(ends: CommandLine, tmp_path: Path) -> None:
    launch = written(tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), '<rosparam file="$(dirname)/gone.yaml"/>')
    done = ends("launch", launch, "--detach")
    assert done.returncode == 2
    assert "gone.yaml: no such file" in done.stderr
    assert "--keep-going leaves out what is missing" in done.stderr
    done = ends("launch", launch, "--detach", "--keep-going")
    assert done.returncode == 0
    assert "gone.yaml: no such file" in done.stdout.partition("left out:\n")[2]


def test_a_launch_whose_only_node_was_left_out_fails(ends: CommandLine, tmp_path: Path) -> None:
    done = ends("launch", written(tmp_path, '<node name="n" pkg="joy" type="joy_node"/>'))
    assert done.returncode == 1
    assert "everything runs" not in done.stdout
    assert "nothing is left to drive\nleft out:\n" in done.stderr
    eventually(lambda: not processes(ends.runtime), "the daemon is still there")


def test_a_launch_whose_controllers_did_not_come_up_fails(ends: CommandLine, tmp_path: Path) -> None:
    kinds = '<rosparam ns="/arm">{a: {type: my_controllers/Grasp}}</rosparam>'
    spawner = '<node name="c" pkg="controller_manager" type="spawner" ns="/arm" args="a"/>'
    done = ends("launch", written(tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), kinds, spawner))
    assert done.returncode == 1
    assert "no controller of it runs\nleft out:\n" in done.stderr
    assert "no controller type 'my_controllers/Grasp'" in done.stderr


def test_a_launch_that_leaves_the_world_paused_says_how_it_goes_on(ends: CommandLine, tmp_path: Path) -> None:
    paused = WORLD.replace("/>", '><arg name="paused" value="true"/></include>')
    node = '<node name="unpause" pkg="my_arm" type="delayed_unpause.sh"/>'
    done = ends("launch", written(tmp_path, paused, MODEL, SPAWN.format("-model arm"), node), "--detach")
    assert done.returncode == 0, done.stderr
    assert "the node /unpause is left out: nobody resumes the world by itself: slidectl sim resume" in done.stdout
    assert "the world is paused; slidectl sim resume lets it go on" in done.stdout


def test_a_spawner_does_not_wait_for_a_robot_that_was_left_out(ends: CommandLine, tmp_path: Path) -> None:
    spawn = '<node name="s" pkg="gazebo_ros" type="spawn_model" args="-urdf -file $(find my_arm)/a.urdf -model arm"/>'
    done = ends("launch", written(tmp_path, WORLD, spawn, CONTROL))
    assert done.returncode == 1
    assert "/control: there is no /arm/controller_manager" in done.stderr
    assert "within 30 s" not in done.stderr


def test_xacro_in_another_command_leaves_out_what_the_launch_leaves_out(ends: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "arm.xacro").write_text(
        ARM.replace(
            '<robot name="arm">',
            '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
            '<xacro:include filename="$(find my_camera)/camera.xacro"/>',
        )
    )
    for command in ("env $(find xacro)/xacro", "bash -c 'xacro $0'"):
        model = f'<param name="robot_description" command="{command} $(dirname)/arm.xacro"/>'
        launch = written(tmp_path, WORLD, model, SPAWN.format("-model arm"))
        done = ends("launch", launch, "--detach")
        assert done.returncode == 0, done.stderr
        assert "no package 'my_camera'; what it includes is left out" in done.stdout.partition("left out:\n")[2]
        ends.ok("daemon", "stop")
        done = ends("launch", launch, "--strict")
        assert done.returncode == 2
        assert "no package 'my_camera'" in done.stderr


# --- what Gazebo and roslaunch take ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "robot", "namespace"),
    [
        ("scout/", "scout", "/scout"), ("/", "robot", "/"), ("2dof_robot", "robot_2dof_robot", "/robot_2dof_robot"),
        ("schieber_ü", "schieber_u", "/schieber_u"),
    ],
)  # fmt: skip
def test_any_name_of_a_model_is_taken(ends: CommandLine, tmp_path: Path, name: str, robot: str, namespace: str) -> None:
    done = ends("launch", written(tmp_path, WORLD, MODEL, SPAWN.format(f"-model '{name}'")), "--detach")
    assert done.returncode == 0, done.stderr
    assert f"{name!r} cannot be a part of a topic's name: the robot is {robot} here" in done.stderr
    assert json.loads(ends.ok("robots", robot, "--json"))["namespace"] == namespace


def test_the_name_of_a_controller_may_hold_a_slash(ends: CommandLine, tmp_path: Path) -> None:
    control = (
        '<rosparam ns="/arm">{in: {state: {type: joint_state_controller/JointStateController, publish_rate: 20}}}'
        '</rosparam><node name="c" pkg="controller_manager" type="spawner" ns="/arm" args="in/state"/>'
    )
    done = ends("launch", written(tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), control), "--detach")
    assert done.returncode == 0, done.stderr
    assert "/c: in/state running in /arm" in done.stdout


def test_initial_positions_beyond_a_limit_are_held_there_and_those_of_no_joint_are_skipped(
    ends: CommandLine, tmp_path: Path
) -> None:
    spawn = SPAWN.format("-model arm -J w 1.04701 -J other 0.5")
    paused = WORLD.replace("/>", '><arg name="paused" value="true"/></include>')
    done = ends("launch", written(tmp_path, paused, MODEL, spawn), "--detach")
    assert done.returncode == 0, done.stderr
    assert "-J w 1.04701 is beyond its limits, -2.147 to 1.047: it starts at 1.047" in done.stderr
    assert "-J other 0.5 is skipped: no moving joint 'other' on robot 'arm'" in done.stderr
    assert json.loads(ends.ok("robots", "arm", "--json"))["joints"][0]["position"] == pytest.approx(1.047)


def test_an_arm_is_held_where_the_launch_puts_it_until_its_controllers_run(ends: CommandLine, tmp_path: Path) -> None:
    spawn = SPAWN.format("-model arm -J w -1.2 -unpause")
    done = ends("launch", written(tmp_path, WORLD, MODEL, spawn, CONTROL), "--detach")
    assert done.returncode == 0, done.stderr
    ends.ok("wait", "joint_states/velocity[0]", "--near", "0", "--tol", "0.001", "--for", "0.5", "--within", "30")
    [joint] = json.loads(ends.ok("robots", "arm", "--json"))["joints"]
    assert joint["position"] == pytest.approx(-1.2, abs=0.01)
    assert json.loads(ends.ok("sim", "status", "--json"))["paused"] is False


def test_a_world_file_that_gazebo_ros_does_not_have_is_the_empty_world(ends: CommandLine, tmp_path: Path) -> None:
    name = "$(find gazebo_ros)/worlds/empty_world.world"
    world = WORLD.replace("/>", f'><arg name="world_name" value="{name}"/></include>')
    done = ends("launch", written(tmp_path, world, MODEL, SPAWN.format("-model arm")), "--detach", "--strict")
    assert done.returncode == 0, done.stderr
    assert "worlds/empty_world.world: the world is the empty one, as in Gazebo" in done.stderr


def test_a_relay_onto_itself_does_nothing(ends: CommandLine, tmp_path: Path) -> None:
    node = '<node name="r" pkg="topic_tools" type="relay" args="/cmd_vel cmd_vel"/>'
    done = ends("launch", written(tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), node), "--detach")
    assert done.returncode == 0, done.stderr
    assert "passes /cmd_vel on to itself, which has no effect" in done.stderr


def test_a_link_without_an_inertia_gets_one(ends: CommandLine, tmp_path: Path) -> None:
    begin, end = ARM.index("<inertia "), ARM.index("</inertial>")
    launch = written(tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), model=ARM[:begin] + ARM[end:])
    done = ends("launch", launch, "--detach")
    assert done.returncode == 0, done.stderr
    assert "lacks <inertia>: it is read as zeros, which are then corrected" in done.stderr


def test_a_path_may_hold_a_plus(ends: CommandLine, tmp_path: Path) -> None:
    package = tmp_path / "pack+age" / "a+pkg"
    package.mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>a_pkg</name></package>")
    corner = "facet normal 0 0 0 outer loop vertex {} vertex {} vertex {} endloop endfacet"
    points = ("0 0 0", "1 0 0", "0 1 0", "0 0 1")
    faces = [corner.format(*(points[i] for i in face)) for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))]
    (package / "m.stl").write_text(f"solid m {' '.join(faces)} endsolid m")
    shape = '<{0}><geometry><mesh filename="package://a_pkg/m.stl"/></geometry></{0}>'
    model = ARM.replace("</inertial>", f"</inertial>{shape.format('visual')}{shape.format('collision')}")
    param = '<param name="robot_description" textfile="$(find a_pkg)/arm.urdf"/>'
    launch = written(package, WORLD, param, SPAWN.format("-model arm"), model=model)
    done = ends("launch", launch, "--detach", "--strict")
    assert done.returncode == 0, done.stderr
    assert "no such file" not in done.stderr


def test_a_plugin_that_is_derived_from_the_control_plugin_is_taken_for_it(ends: CommandLine, tmp_path: Path) -> None:
    model = ARM.replace("libgazebo_ros_control.so", "libmyarm_gazebo_ros_control.so")
    launch = written(tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), CONTROL, model=model)
    done = ends("launch", launch, "--detach")
    assert done.returncode == 0, done.stderr
    assert "libmyarm_gazebo_ros_control.so is read as libgazebo_ros_control.so" in done.stderr
    assert "/control: jsc, hold running in /arm" in done.stdout


def test_interfaces_of_hardware_that_is_not_there_are_left_out_with_it(ends: CommandLine, tmp_path: Path) -> None:
    begin, end = ARM.index("<transmission"), ARM.index("</transmission>") + len("</transmission>")
    driven, state = ARM[begin:end], "<hardwareInterface>hardware_interface/JointStateInterface</hardwareInterface>"
    both = driven.replace("<hardwareInterface>", f"{state}<hardwareInterface>")
    kept = driven.index("<hardwareInterface>"), driven.index("</joint>")
    only = (driven[: kept[0]] + state + driven[kept[1] :]).replace('name="t"', 'name="seen"')
    plugin = '<plugin name="c" filename="libgazebo_ros_control.so"'
    model = ARM.replace(driven, only + both)
    model = model.replace(f"{plugin}/>", f"{plugin}><robotSimType>their_hw/TheirSim</robotSimType></plugin>")
    launch = written(tmp_path, WORLD, MODEL, SPAWN.format("-model arm"), CONTROL, model=model)
    done = ends("launch", launch, "--detach")
    assert done.returncode == 0, done.stderr
    assert "their_hw/TheirSim' is not simulated hardware" in done.stderr
    assert '<transmission name="seen"> has no interface of the default hardware; left out' in done.stderr
    assert "/control: jsc, hold running in /arm" in done.stdout


# --- hints -----------------------------------------------------------------------------------------------------------


def test_only_programs_are_listed_as_the_programs_of_a_package(slidectl: CommandLine, tmp_path: Path) -> None:
    package = tmp_path / "demo"
    package.mkdir()
    (package / "package.xml").write_text("<package><name>demo</name></package>")
    for name, text in (("CMakeLists.txt", "project(demo)"), ("demo.h", "#pragma once"), ("talk", "#!/bin/sh\n")):
        (package / name).write_text(text)
        (package / name).chmod(0o755)
    (package / "libdemo.so").write_bytes(b"\x7fELF")
    (package / "libdemo.so").chmod(0o755)
    done = slidectl("launch", written(package, '<node name="n" pkg="demo" type="tlak"/>'), "--strict")
    assert "Did you mean 'talk'?" in done.stderr
    assert f"programs in {package}: talk\n" in done.stderr
