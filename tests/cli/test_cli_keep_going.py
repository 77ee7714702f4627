"""What is not there is named at once, left out and listed, by launches, spawns and checks: --keep-going, --strict."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from launch_runs import kill_all, processes
from waiting import eventually

ROBOT = """<robot name="m" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:include filename="$(find some_camera)/urdf/camera.xacro"/>
<xacro:include filename="hands.xacro"/>
<link name="world"/>
<link name="l"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="package://some_meshes/arm.stl"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="world"/><child link="l"/><axis xyz="0 0 1"/>
<limit effort="10" velocity="10" lower="-1" upper="1"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="j"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
<actuator name="a"><mechanicalReduction>1</mechanicalReduction></actuator></transmission>
<xacro:camera parent="l"><origin/></xacro:camera>
<gazebo><plugin name="c" filename="libgazebo_ros_control.so">
<robotSimType>some_hw/FancyHWSim</robotSimType></plugin></gazebo>
</robot>
"""
LAUNCH = """<launch>
<arg name="world" default="$(find some_worlds)/worlds/hall.world"/>
<include file="$(find some_robot)/launch/bringup.launch"><arg name="x" value="$(find other_robot)/x"/></include>
<include file="$(find gazebo_ros)/launch/empty_world.launch"><arg name="world_name" value="$(arg world)"/></include>
<rosparam file="$(find some_config)/pid.yaml"/>
<rosparam file="$(dirname)/gone.yaml"/>
<param name="robot_description" command="$(find xacro)/xacro $(dirname)/m.xacro"/>
<rosparam ns="/m">
bad: {type: effort_controllers/JointPositonController, joint: j}
jsc: {type: joint_state_controller/JointStateController, publish_rate: 50}
</rosparam>
<node name="spawn" pkg="gazebo_ros" type="spawn_model" args="-urdf -param robot_description -model m"/>
<node name="control" pkg="controller_manager" type="spawner" ns="/m" args="bad jsc unset"/>
<node name="mux" pkg="some_mux" type="mux"/>
<node name="rviz" pkg="rviz" type="rviz" args="-d $(find some_views)/m.rviz"/>
</launch>
"""
MISSING = (
    "no package 'some_worlds'", "no package 'some_robot'", "no package 'other_robot'", "no package 'some_config'",
    "gone.yaml: no such file", "no package 'some_camera'", "hands.xacro", "no package 'some_meshes'",
    "'some_hw/FancyHWSim' is not simulated hardware", "no controller type 'effort_controllers/JointPositonController'",
    "no package 'some_mux'",
)  # fmt: skip


@pytest.fixture
def ends(slidectl: CommandLine) -> Iterator[CommandLine]:
    """The command line; the daemon that a detached launch leaves is stopped."""
    yield slidectl
    slidectl("daemon", "stop")
    kill_all(slidectl.runtime)


@pytest.fixture
def launch(tmp_path: Path) -> str:
    """A launch file in which much is not there."""
    (tmp_path / "m.xacro").write_text(ROBOT)
    path = tmp_path / "m.launch"
    path.write_text(LAUNCH)
    return str(path)


@pytest.mark.parametrize("words", [("launch", "--strict"), ("launch", "--strict", "--dry-run"), ("check",)])
def test_all_that_is_not_there_is_named_in_one_round(slidectl: CommandLine, launch: str, words: tuple[str]) -> None:
    done = slidectl(words[0], launch, *words[1:])
    assert done.returncode == 2
    said = done.stdout + done.stderr
    assert [text for text in MISSING if text not in said] == []
    assert ("--keep-going" if words == ("check",) else "without --strict it is left out") in done.stderr
    assert "no package 'some_views'" not in said, "rviz shows nothing here, so its file is not needed"
    assert not processes(slidectl.runtime)


def test_a_launch_that_keeps_going_drives_what_is_there_and_lists_the_rest_once(ends: CommandLine, launch: str) -> None:
    done = ends("launch", launch, "--keep-going", "--detach")
    assert done.returncode == 0, done.stderr
    listed = done.stdout.partition("left out:\n")[2]
    assert [text for text in (*MISSING, "no macro 'camera'", "no controller 'unset'") if text not in listed] == []
    assert "everything runs" not in done.stdout
    states = json.loads(ends.ok("controller", "list", "--json").splitlines()[0])
    assert (states["name"], states["state"]) == ("jsc", "running")
    robot = json.loads(ends.ok("robots", "m", "--json"))
    assert [joint["name"] for joint in robot["joints"]] == ["j"]


def test_the_list_of_a_dry_run_and_of_a_check_is_the_same(slidectl: CommandLine, launch: str) -> None:
    for words in (("launch", launch, "--dry-run"), ("check", launch)):
        done = slidectl(*words, "--keep-going")
        assert done.returncode == 0, done.stderr
        listed = done.stderr.partition("left out:\n")[2]
        assert [text for text in MISSING if text not in listed] == []


def test_a_launch_of_which_nothing_is_left_fails_and_leaves_nothing(ends: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "nothing.launch"
    path.write_text(
        '<launch><include file="$(find some_robot)/launch/a.launch"/>'
        '<param name="robot_description" textfile="no.urdf"/>'
        '<node name="s" pkg="gazebo_ros" type="spawn_model" args="-urdf -param robot_description -model m"/>'
        '<node name="c" pkg="controller_manager" type="spawner" ns="/m" args="jsc"/></launch>'
    )
    done = ends("launch", str(path), "--keep-going")
    assert done.returncode == 1
    assert "nothing is left to drive\nleft out:\n" in done.stderr
    assert "no package 'some_robot'" in done.stderr
    eventually(lambda: not processes(ends.runtime), "the daemon is still there")


def test_no_robot_state_publisher_waits_for_a_robot_that_was_left_out(ends: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "one.launch"
    state_publisher = '<node name="{0}" pkg="robot_state_publisher" type="robot_state_publisher"/>'
    path.write_text(
        '<launch><param name="here" textfile="$(dirname)/m.urdf"/>'
        '<node name="a" pkg="gazebo_ros" type="spawn_model" args="-urdf -param gone -model a"/>'
        '<node name="b" pkg="gazebo_ros" type="spawn_model" args="-urdf -param here -model b"/>'
        f"{state_publisher.format('frames')}</launch>"
    )
    (tmp_path / "m.urdf").write_text("<robot name='m'><link name='world'/></robot>")
    done = ends("launch", str(path), "--keep-going", "--detach")
    assert done.returncode == 0, done.stderr
    assert "the parameter /gone is not set to a robot's description; the node is left out" in done.stdout
    assert "/frames: the simulation publishes the frames of b" in done.stdout
    assert "listed below (2 nodes, 0 controllers running)" in done.stdout
    assert "waits for" not in done.stdout


def test_a_spawn_that_waits_for_a_robot_that_was_left_out_is_left_out(ends: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "wait.launch"
    path.write_text(
        '<launch><param name="here" textfile="$(dirname)/m.urdf"/>'
        '<node name="a" pkg="gazebo_ros" type="spawn_model" args="-urdf -param gone -model a"/>'
        '<node name="b" pkg="gazebo_ros" type="spawn_model" args="-urdf -param here -model b"/>'
        '<node name="c" pkg="gazebo_ros" type="spawn_model" args="-urdf -param here -model c -wait a"/></launch>'
    )
    (tmp_path / "m.urdf").write_text("<robot name='m'><link name='world'/></robot>")
    done = ends("launch", str(path), "--keep-going", "--detach")
    assert done.returncode == 0, done.stderr
    assert "/c: there is no model a; the node is left out" in done.stdout


def test_a_spawn_that_keeps_going_leaves_out_meshes_macros_hardware_and_controllers(
    ends: CommandLine, launch: str
) -> None:
    ends.ok("daemon", "start", "--paused")
    model = str(Path(launch).with_suffix(".xacro"))
    done = ends("spawn", model)
    assert done.returncode == 2
    for text in ("some_camera", "hands.xacro", "some_meshes", "FancyHWSim", "--keep-going"):
        assert text in done.stderr
    done = ends("spawn", model, "--keep-going", "--start", "nobody")
    assert done.returncode == 1
    assert "no controller 'nobody' in the parameters of /m; the controller nobody is left out" in done.stderr
    assert "nothing is left to drive m" in done.stderr
    ends.ok("delete", "m")
    done = ends("spawn", model, "--keep-going")
    assert done.returncode == 0
    assert "no macro 'camera'; <xacro:camera> is left out" in done.stderr
    assert "the <collision> is left out" in done.stderr


def test_json_of_a_launch_has_the_things_that_were_left_out(ends: CommandLine, launch: str) -> None:
    done = ends("--json", "launch", launch, "--keep-going", "--detach")
    [record] = [one for one in map(json.loads, done.stdout.splitlines()) if one.get("event") == "left_out"]
    assert any("some_mux" in thing for thing in record["things"])


def test_check_with_nothing_left_exits_with_1(slidectl: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "n.launch"
    path.write_text('<launch><include file="$(find some_robot)/launch/a.launch"/></launch>')
    done = slidectl("check", str(path), "--keep-going")
    assert done.returncode == 1
    assert "nothing is left to drive" in done.stderr
