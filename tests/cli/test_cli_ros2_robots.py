"""Robots of ROS 2 at the command line: the files that the model names, what has no effect, what the daemon says."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine

from slidectl.errors import Refused

URDF = """<robot name="2dof-lift"><link name="world"/>
<joint name="lift" type="prismatic"><parent link="world"/><child link="box"/><axis xyz="0 0 1"/>
<limit lower="0" upper="2" effort="100" velocity="1"/></joint>
<link name="box"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<ros2_control name="sys" type="system"><hardware><plugin>gz_ros2_control/GazeboSimSystem</plugin></hardware>
<joint name="lift"><command_interface name="position"/><state_interface name="position"/></joint></ros2_control>
<gazebo><plugin name="gz" filename="libgz_ros2_control-system.so">%s</plugin></gazebo></robot>
"""
YAML = """controller_manager:
  ros__parameters:
    update_rate: 50
    states: {type: joint_state_broadcaster/JointStateBroadcaster}
    up: {type: forward_command_controller/ForwardCommandController}
up:
  ros__parameters: {joints: [lift], interface_name: position}
"""


@pytest.fixture
def started(slidectl: CommandLine) -> Iterator[CommandLine]:
    slidectl.ok("daemon", "start", "--paused")
    yield slidectl
    slidectl("daemon", "stop")


def written(folder: Path, *files: str) -> str:
    (folder / "lift.urdf").write_text(URDF % "".join(f"<parameters>{name}</parameters>" for name in files))
    (folder / "lift.yaml").write_text(YAML)
    return str(folder / "lift.urdf")


def test_a_spawn_takes_the_parameters_that_the_model_names(started: CommandLine, tmp_path: Path) -> None:
    done = started.ok("spawn", written(tmp_path, "lift.yaml"), "--start", "states", "up")
    assert "robot_2dof_lift: spawned in / at 0 0 0, joints: lift" in done
    listed = [json.loads(line) for line in started.ok("controller", "list", "--json").splitlines()]
    assert [(one["name"], one["state"]) for one in listed] == [("states", "active"), ("up", "active")]
    assert started.ok("param", "get", "/update_rate").strip() == "50"
    started.ok("pub", "/up/commands", "[0.5]")
    started.ok("sim", "step", "1s")
    position = json.loads(started.ok("robots", "robot_2dof_lift", "--json"))["joints"][0]["position"]
    assert position == pytest.approx(0.5)


def test_files_of_the_user_come_instead(started: CommandLine, tmp_path: Path) -> None:
    robot = written(tmp_path, "lift.yaml")
    own = tmp_path / "own.yaml"
    own.write_text(YAML.replace("update_rate: 50", "update_rate: 200"))
    started.ok("spawn", robot, "--controllers", str(own), "--start", "up")
    assert started.ok("param", "get", "/update_rate").strip() == "200"


def test_a_file_that_is_not_there_is_named(started: CommandLine, tmp_path: Path) -> None:
    done = started("spawn", written(tmp_path, "none.yaml"))
    assert done.returncode == 0
    assert "the model's plugin names the parameters none.yaml, which are not there: --controllers FILE" in done.stderr


def test_a_second_robot_of_ros2_needs_another_namespace(started: CommandLine, tmp_path: Path) -> None:
    robot = written(tmp_path, "lift.yaml")
    started.ok("spawn", robot)
    refused = started("spawn", robot, "-n", "second")
    assert refused.returncode == 1
    assert "the namespace / belongs to robot 'robot_2dof_lift' already" in refused.stderr
    assert "--namespace" in refused.stderr
    with started.client() as client, pytest.raises(Refused, match="the namespace / belongs to robot"):
        client.spawn(robot, "third")
    with started.client() as client:
        assert client.spawn(robot, "third", robot_namespace="right", start=["up"])["namespace"] == "/right"
    assert "second: spawned in /left" in started.ok(
        "spawn", robot, "-n", "second", "--namespace", "left", "--start", "up"
    )


@pytest.mark.parametrize("named", ["../other.yaml", "link.yaml", f"{'x' * 300}.yaml", "pipe.yaml"])
def test_other_files_of_the_user_are_not_taken(started: CommandLine, tmp_path: Path, named: str) -> None:
    """Those elsewhere, also through a link, a name that is too long, and a FIFO."""
    folder = tmp_path / "model"
    folder.mkdir()
    (tmp_path / "other.yaml").write_text("token: secret\n")
    (folder / "link.yaml").symlink_to(tmp_path / "other.yaml")
    os.mkfifo(folder / "pipe.yaml")
    done = started("spawn", written(folder, named))
    assert done.returncode == 0
    assert f"the model's plugin names the parameters {named}, which are " in done.stderr
    assert "token" not in started.ok("param", "list")


LAUNCH = """<launch><param name="robot_description" textfile="$(dirname)/lift.urdf"/>{more}
<node name="spawn" pkg="gazebo_ros" type="spawn_model" args="-urdf -param robot_description -model lift"/>
<node name="spawner" pkg="controller_manager" type="spawner" args="states up"/></launch>
"""


@pytest.mark.parametrize(("more", "rate"), [("", "50"), ('<param name="update_rate" value="200"/>', "200")])
def test_a_launch_loads_the_files_that_the_model_names(
    slidectl: CommandLine, tmp_path: Path, more: str, rate: str
) -> None:
    """What the launch sets itself counts."""
    written(tmp_path, str(tmp_path / "lift.yaml"))
    (tmp_path / "lift.launch").write_text(LAUNCH.format(more=more))
    done = slidectl.ok("launch", str(tmp_path / "lift.launch"), "--detach")
    assert "spawner: states, up running in /" in done
    assert slidectl.ok("param", "get", "/update_rate").strip() == rate
    slidectl.ok("daemon", "stop")


def test_a_scenario_spawns_a_robot_that_names_its_files(slidectl: CommandLine, tmp_path: Path) -> None:
    robot = written(tmp_path, "lift.yaml")
    steps = [
        f"spawn: {robot} --start states up",
        "pub: /up/commands '[0.5]'",
        "wait: /joint_states/position[0] --near 0.5",
    ]
    (tmp_path / "up.yaml").write_text("name: up\nsteps:\n" + "".join(f"- {step}\n" for step in steps))
    assert "no mistakes" in slidectl("test", "--check", str(tmp_path / "up.yaml")).stderr
    assert "1 passed" in slidectl.ok("test", str(tmp_path / "up.yaml"))
