"""A file of controllers as ROS 2 has them, with the shipped arm of two joints: checked, spawned, and moved."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine

FILE = """
controller_manager:
  ros__parameters:
    update_rate: 100
    states:
      type: joint_state_broadcaster/JointStateBroadcaster
    arm:
      type: joint_trajectory_controller/JointTrajectoryController
    steps:
      type: bicycle_steering_controller/BicycleSteeringController
arm:
  ros__parameters:
    joints: [joint1, joint2]
    command_interfaces: [effort]
    state_interfaces: [position, velocity]
    gains.joint1: {p: 400.0, d: 60.0}
    gains.joint2.p: 400.0
    gains.joint2.d: 60.0
    constraints.speed: 0.5
"""
TRAJECTORY = "joint_trajectory_controller/JointTrajectoryController"


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "control.yaml"
    path.write_text(FILE, encoding="utf-8")
    return str(path)


@pytest.fixture(autouse=True)
def _empty_again(world: CommandLine) -> Iterator[None]:
    yield
    if world.ok("robots", "--json"):
        world.ok("delete", "rrbot")


def test_it_runs_and_each_answer_says_what_the_controllers_are_here(world: CommandLine, file: str) -> None:
    done = world("spawn", "rrbot", "--controllers", file, "--start", "states", "arm")
    assert done.returncode == 0, done.stderr
    assert "joint_state_broadcaster/JointStateBroadcaster" in world.ok("controller", "list")
    assert TRAJECTORY in world.ok("controller", "list")
    world.ok("trajectory", "plan", "arm", "--to", "joint1=0.2", "joint2=-0.1", "--duration", "1")
    world.ok("sim", "step", "2000")
    with world.client() as client:
        joint = client.call("/gazebo/get_joint_properties", {"joint_name": "joint1"})
    assert joint["position"][0] == pytest.approx(0.2, abs=0.1)
    world.ok("sim", "resume")
    state = [json.loads(line) for line in world.ok("trajectory", "state", "arm", "--json").splitlines()]
    world.ok("sim", "pause")
    assert [row["desired"] for row in state] == pytest.approx([0.2, -0.1])
    world.ok("trajectory", "hold", "arm")
    world.ok("sim", "step", "10")
    world.ok("controller", "stop", "arm")
    assert "the controller is not running" in world("trajectory", "hold", "arm").stderr
    refused = world("controller", "load", "steps")
    assert refused.returncode == 1
    assert "here: ackermann_steering_controller/AckermannSteeringController has one rear_wheel" in refused.stderr


def test_a_check_says_the_same_with_the_line_of_each_parameter(world: CommandLine, file: str) -> None:
    out = world("check", "rrbot", "--controllers", file).stdout
    lines = {tuple(line.split(None, 2)[:2]): line for line in out.splitlines() if line.startswith(file)}
    assert f"{TRAJECTORY}; on hardware_interface::PositionJointInterface" in lines[f"{file}:8", "used"]
    assert "bicycle_steering_controller" in lines[f"{file}:10", "wrong"]
    assert "/rrbot/arm/command_interfaces: [effort]; what is commanded" in lines[f"{file}:14", "used"]
    assert "/rrbot/arm/gains/joint2/d: 60.0" in lines[f"{file}:18", "used"]
    assert "/rrbot/arm/constraints/speed: is unknown to the controller" in lines[f"{file}:19", "ignored"]


def test_a_launch_with_a_type_that_means_something_else_starts_nothing(world: CommandLine, tmp_path: Path) -> None:
    launch = tmp_path / "car.launch"
    launch.write_text(
        "<launch><rosparam ns='bot'>{states: {type: joint_state_broadcaster/JointStateBroadcaster},"
        " base: {type: tricycle_controller/TricycleController}}</rosparam>"
        "<node name='s' pkg='controller_manager' type='spawner' ns='bot' args='states base'/></launch>",
        encoding="utf-8",
    )
    done = world("launch", str(launch))
    assert done.returncode != 0
    assert "controller /bot/base: slidectl has no tricycle_controller/TricycleController" in done.stderr
    assert "JointStateBroadcaster" not in done.stderr
    assert not world.ok("robots", "--json")
