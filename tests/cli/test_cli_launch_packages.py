"""Packages as they lie on disks, of the kinds that Gazebo and ros_control are used with: they run, or say why not."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from launch_runs import Launched, kill_all, nothing_is_left

PACKAGES = Path(__file__).parent.parent / "data" / "packages"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A catkin workspace's source folder, under a path with blanks and letters of all kinds."""
    folder = tmp_path / "meine Größe" / "src"
    shutil.copytree(PACKAGES, folder)
    for script in folder.glob("*/scripts/*"):
        script.chmod(0o755)
    return folder


@pytest.fixture(autouse=True)
def ros(slidectl: CommandLine, source: Path) -> Iterator[CommandLine]:
    slidectl.environment["ROS_PACKAGE_PATH"] = os.pathsep.join([str(source), "/opt/ros/noetic/share"])
    yield slidectl
    kill_all(slidectl.runtime)


def states(slidectl: CommandLine, manager: str) -> dict[str, str]:
    rows = map(json.loads, slidectl.ok("controller", "list", "--cm", manager, "--json").splitlines())
    return {row["name"]: row["state"] for row in rows}


def test_an_arm_whose_plugin_names_no_namespace_lives_in_that_of_its_spawn_node(ros: CommandLine) -> None:
    """As with spawn_model, which hands its own namespace to such a plugin; the controllers here are in the root."""
    launched = Launched(ros, "arm_gazebo", "arm.launch", "gui:=false", "limited:=true")
    launched.up()
    assert "/spawn_gazebo_model: robot spawned in /, joints: shoulder_lift_joint elbow_joint" in launched.text
    assert states(ros, "/") == {
        "joint_state_controller": "running",
        "arm_controller": "running",
        "shoulder": "running",
    }
    assert "data: True" in ros.ok("echo", "/calibrated", "-n", "1", "--wait")  # rostopic pub stays, as under roslaunch
    ros.ok("pub", "/arm_controller/command", "0.5")
    ros.ok("wait", "/joint_states/position[0]", "--near", "0.5", "--tol", "0.02", "--within", "10")
    assert launched.interrupt() == 130
    nothing_is_left(ros.runtime)


def test_a_robot_on_wheels_with_a_world_of_its_own(ros: CommandLine) -> None:
    launched = Launched(ros, "wheels_gazebo", "wheels_world.launch", "--keep-going")
    text = launched.up()
    assert "wheels.world:6: model 'turtlebot' is not there" in text
    assert "/gazebo: the world: step 0.002 s, as fast as possible" in text
    assert "/gazebo_gui: there are no windows here" in text
    assert "/wheels/controller_spawner: joint_state_controller, leftWheel_effort_controller running in /wheels" in text
    assert ros.ok("param", "get", "/gazebo/enable_ros_network").strip() == "true"
    assert launched.interrupt() == 130


def test_arguments_of_empty_world_reach_the_world(ros: CommandLine) -> None:
    for debug in ("false", "true"):
        launched = Launched(
            ros, "gazebo_ros", "empty_world.launch", "paused:=true", f"debug:={debug}", "physics:=dart", "-v"
        )
        text = launched.up()
        assert "/gazebo: the world: step 0.001 s, paused" in text
        assert "-e dart has no effect: the physics here is MuJoCo" in text
        assert launched.interrupt() == 130


def test_rovers_in_two_namespaces_without_the_nodes_that_there_are_not(ros: CommandLine) -> None:
    done = ros("launch", "rover_gazebo", "rover_empty_world.launch", "--strict")
    assert done.returncode == 2
    assert (
        "node /ekf_localization (robot_localization/ekf_localization_node): no package 'robot_localization'"
        in done.stderr
    )
    assert "also missing:" in done.stderr
    assert "node /joy (joy/joy_node): no package 'joy'" in done.stderr
    launched = Launched(ros, "rover_gazebo", "rover_empty_world.launch")
    launched.until("left out:\n")
    for manager in ("/", "/two"):
        assert states(ros, manager) == {"rover_joint_publisher": "running", "rover_velocity_controller": "running"}
    assert json.loads(ros.ok("robots", "second", "--json"))["pose"][1] == pytest.approx(3.0, abs=0.01)
    assert launched.interrupt() == 130


def test_a_window_that_is_required_does_not_end_the_launch_for_not_being_there(ros: CommandLine, source: Path) -> None:
    path = source / "show.launch"
    path.write_text(
        '<launch><include file="$(find gazebo_ros)/launch/empty_world.launch"><arg name="gui_required" value="true"/>'
        '</include><node pkg="rviz" type="rviz" name="rviz" required="true"/></launch>'
    )
    launched = Launched(ros, str(path))
    launched.up()
    assert json.loads(ros.ok("sim", "status", "--json"))["paused"] is False
    assert launched.interrupt() == 130


def test_a_spawner_in_the_wrong_namespace_is_told_where_robots_are(ros: CommandLine, source: Path) -> None:
    model = next(source.rglob("wheels.world")).parent / "turtlebot"
    model.mkdir()
    (model / "model.sdf").write_text('<sdf version="1.6"><model name="turtlebot"><link name="base"/></model></sdf>')
    path = source / "lost.launch"
    path.write_text(
        '<launch><include file="$(find wheels_gazebo)/launch/wheels_world.launch"/><node name="s" ns="wheel"'
        ' pkg="controller_manager" type="spawner" args="--timeout 0.3 joint_state_controller"/></launch>'
    )
    done = ros("launch", str(path))
    assert done.returncode == 1
    assert "there was no /wheel/controller_manager (no robot is in /wheel yet; wheels is in /wheels)" in done.stderr
    nothing_is_left(ros.runtime)


def test_a_controller_type_that_is_not_here_is_named_with_those_that_are(ros: CommandLine, source: Path) -> None:
    path = source / "unknown.launch"
    path.write_text(
        '<launch><include file="$(find wheels_gazebo)/launch/wheels_world.launch"/><rosparam ns="wheels/odd">'
        '{type: odd_controllers/OddController}</rosparam><node name="s" ns="wheels" pkg="controller_manager"'
        ' type="spawner" args="odd"/></launch>'
    )
    done = ros("launch", str(path), "--strict")
    assert done.returncode == 2
    assert "no controller type 'odd_controllers/OddController'" in done.stderr
    assert "also missing:" in done.stderr
    nothing_is_left(ros.runtime)
