"""Actions of the daemon for clients of the real rclpy: trajectories of the arm, and grippers."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from daemon_fixture import shown
from message_packages import message_packages
from ros2_environment import DISTRIBUTIONS, folder_of
from ros2_node import Ros2Node
from ros2_world import World, running_world
from waiting import eventually

TRAJECTORY = "/arm/arm_controller/follow_joint_trajectory"
KIND = "control_msgs/action/FollowJointTrajectory"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
ARM = ["spawn", "arm", "--at", "0", "4", "0", "--controllers", "config/arm_control.yaml", "--start",
       "joint_state_controller", "arm_controller"]  # fmt: skip


@pytest.fixture(scope="module", params=list(DISTRIBUTIONS))
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    programs = folder_of(request.param)
    with running_world(programs, message_packages(programs)) as one:
        one.run(*ARM)
        yield one


@pytest.fixture(scope="module")
def node(world: World) -> Iterator[Ros2Node]:
    with world.node("/test/planner") as one:
        yield one


def send(node: Ros2Node, joint1: float, seconds: int, **more: Any) -> int:
    """The number of an accepted goal, -1 of one that is rejected."""
    point = {"positions": [joint1], "time_from_start": {"sec": seconds}}
    trajectory = {"joint_names": ["joint1"], "points": [point]}
    number: int = node.send_goal(TRAJECTORY, KIND, {"trajectory": trajectory, **more})
    return number


def angle(world: World) -> float:
    with world.client() as client, client.subscribe("/arm/joint_states", queue_length=1) as states:
        message = states.get(timeout=60)
        return float(message["position"][message["name"].index("joint1")])


def test_the_goal_of_the_page_moves_the_arm_and_tells_how_far_it_is(world: World, node: Ros2Node) -> None:
    [words] = shown("ros2.md", "ros2 action send_goal")
    assert words[:4] == ["ros2", "action", "send_goal", "--feedback"]
    action, kind, goal = words[4:]
    status, result = node.result_of(node.send_goal(action, kind, yaml.safe_load(goal)))
    assert (status, result["error_code"]) == (SUCCEEDED, 0)
    assert angle(world) == pytest.approx(1.0, abs=0.06)
    feedback = node.messages(action)
    assert len(feedback) > 10
    assert feedback[-1]["joint_names"] == [f"joint{number}" for number in range(1, 7)]
    assert math.isclose(feedback[-1]["desired"]["positions"][0], 1.0, abs_tol=0.2)


def test_a_cancelled_goal_ends_where_it_is(world: World, node: Ros2Node) -> None:
    before = angle(world)
    number = send(node, before - 1.0, 60)
    assert node.cancel_goal(number) == 1
    status, _ = node.result_of(number)
    assert status == CANCELED
    assert abs(angle(world) - before) < 0.8
    assert node.cancel_goal(number) == 0  # it has ended


def test_another_goal_replaces_the_first(node: Ros2Node) -> None:
    first = send(node, 0.0, 60)
    second = send(node, 0.1, 1)
    assert node.result_of(first)[0] == ABORTED
    assert node.result_of(second)[0] == SUCCEEDED


def test_a_goal_that_cannot_be_followed_is_rejected_and_the_log_says_why(world: World, node: Ros2Node) -> None:
    trajectory = {"joint_names": ["no_such_joint"], "points": [{"positions": [1.0], "time_from_start": {"sec": 1}}]}
    assert node.send_goal(TRAJECTORY, KIND, {"trajectory": trajectory}) == -1
    assert "rejects a goal of ROS 2: /arm/arm_controller: Joints on incoming goal" in world.log
    assert send(node, math.nan, 1) == -1
    assert "rejects a goal of ROS 2" in world.log


def test_a_goal_in_a_paused_world_waits(world: World, node: Ros2Node) -> None:
    world.run("sim", "pause")
    try:
        number = send(node, 0.3, 1)
        assert number >= 0
        assert not node.has_ended(number)
    finally:
        world.run("sim", "resume")
    assert node.result_of(number)[0] == SUCCEEDED


def test_goals_end_with_their_controller_and_the_action_comes_back(world: World, node: Ros2Node) -> None:
    stopped = send(node, 0.0, 60)
    world.run("controller", "stop", "arm_controller")
    assert node.result_of(stopped)[0] == ABORTED
    assert send(node, 0.0, 1) == -1
    assert "not running" in world.log
    world.run("controller", "unload", "arm_controller")
    eventually(lambda: not node.has_action(TRAJECTORY))
    world.run("controller", "load", "arm_controller")
    world.run("controller", "start", "arm_controller")
    assert node.result_of(send(node, 0.2, 1))[0] == SUCCEEDED


def test_a_reset_world_and_a_deleted_robot_end_their_goals(world: World, node: Ros2Node) -> None:
    number = send(node, 0.5, 60)
    world.run("delete", "arm")
    assert node.result_of(number)[0] == ABORTED
    eventually(lambda: not node.has_action(TRAJECTORY))
    world.run(*ARM)
    number = send(node, 0.5, 60)
    world.run("sim", "reset")
    eventually(lambda: node.has_ended(number))
    assert node.result_of(number)[0] == ABORTED


def test_more_goals_than_can_be_and_a_daemon_that_does_not_answer_are_told(world: World, node: Ros2Node) -> None:
    with world.client() as client:
        daemon = client.daemon_pid
    assert node.result_of(send(node, 0.1, 1))[0] == SUCCEEDED
    goal = {"trajectory": {"joint_names": ["joint1"], "points": [{"positions": [0.9], "time_from_start": {"sec": 60}}]}}
    os.kill(daemon, signal.SIGSTOP)
    try:
        accepted = node.send_goals(TRAJECTORY, KIND, goal, 200)
    finally:
        os.kill(daemon, signal.SIGCONT)
    assert len(accepted) > 100
    assert not any(accepted)
    assert "rejects a goal of ROS 2: 100 goals have no result yet" in world.log
    assert "rejects a goal of ROS 2: the daemon has not taken it within 8 s" in world.log
    assert node.result_of(send(node, 0.2, 1))[0] == SUCCEEDED
    with world.client() as client, client.subscribe(f"{TRAJECTORY}/status", queue_length=1) as lists:
        eventually(lambda: not any(one["status"] < 2 for one in lists.get(timeout=60)["status_list"]))  # none goes on


def test_topics_of_actionlib_are_not_among_those_of_ros2(world: World, node: Ros2Node) -> None:
    assert not {name for name in node.topics() if name.startswith(f"{TRAJECTORY}/") and "/_action/" not in name}
    assert "Action" not in world.status().get("left_out", "")


def test_grippers_of_both_kinds_close(world: World, node: Ros2Node, tmp_path: Path) -> None:
    world.run("spawn", "gripper", "--at", "0", "8", "0", "--controllers", "config/gripper_control.yaml", "--start",
              "gripper_controller")  # fmt: skip
    action = "/gripper/gripper_controller/gripper_cmd"
    goal = {"command": {"position": 0.02, "max_effort": 20.0}}
    status, result = node.result_of(node.send_goal(action, "control_msgs/action/GripperCommand", goal))
    assert (status, result["reached_goal"]) == (SUCCEEDED, True)
    assert result["position"] == pytest.approx(0.02, abs=0.003)
    model = tmp_path / "hand.urdf"
    model.write_text(
        """<robot name="hand"><link name="world"/><link name="finger"><inertial><mass value="0.1"/>
        <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="finger_joint" type="prismatic"><axis xyz="1 0 0"/><parent link="world"/><child link="finger"/>
          <limit lower="0" upper="0.1" effort="50" velocity="1"/></joint>
        <ros2_control name="hand" type="system"><hardware><plugin>mock_components/GenericSystem</plugin></hardware>
          <joint name="finger_joint"><command_interface name="position"/><state_interface name="position"/>
            <state_interface name="velocity"/></joint></ros2_control></robot>"""
    )
    controllers = tmp_path / "hand.yaml"
    controllers.write_text(
        """controller_manager: {ros__parameters: {hand_controller: {type:
             parallel_gripper_action_controller/GripperActionController}}}
hand_controller: {ros__parameters: {joint: finger_joint}}"""
    )
    world.run("spawn", str(model), "--at", "0", "9", "0", "--controllers", str(controllers), "--start",
              "hand_controller")  # fmt: skip
    kind, goal = "control_msgs/action/ParallelGripperCommand", {"command": {"position": [0.05]}}
    status, result = node.result_of(node.send_goal("/hand_controller/gripper_cmd", kind, goal))
    assert (status, result["reached_goal"], result["stalled"]) == (SUCCEEDED, True, False)
    assert result["state"]["position"] == [pytest.approx(0.05, abs=0.011)]


def test_actions_come_back_with_the_gateway(world: World, node: Ros2Node) -> None:
    world.run("gateway", "ros2", "stop")
    eventually(lambda: not node.has_action(TRAJECTORY))
    world.run("gateway", "ros2", "start", "--read-only")
    eventually(lambda: "/arm/controller_manager" in node.nodes())
    assert not node.has_action(TRAJECTORY)
    world.run("gateway", "ros2", "stop")
    world.run("gateway", "ros2", "start")
    eventually(lambda: node.has_action(TRAJECTORY))
    assert node.result_of(send(node, 0.1, 1))[0] == SUCCEEDED
