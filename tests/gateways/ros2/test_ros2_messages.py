"""Nodes of the real rclpy with the message packages that its wheels lack, beside a world of slidectl."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from typing import Any

import pytest
from message_packages import message_packages
from ros2_environment import DISTRIBUTIONS, folder_of
from ros2_node import Ros2Node
from ros2_world import World, running_world, serving
from waiting import eventually

CONTROLLER = "/slider/joint1_position_controller"
MANAGER = "/slider/controller_manager"
TRANSFORMS, STATE = "tf2_msgs/msg/TFMessage", "control_msgs/msg/JointControllerState"


@pytest.fixture(scope="module", params=list(DISTRIBUTIONS))
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    programs = folder_of(request.param)
    with running_world(programs, message_packages(programs)) as one:
        yield one


@pytest.fixture(scope="module")
def node(world: World) -> Iterator[Ros2Node]:
    with world.node("/test/listener") as one:
        yield one


def as_ros2(message: dict[str, Any]) -> list[dict[str, Any]]:
    """The transforms of a message of slidectl as ROS 2 has them."""
    found = []
    for one in message["transforms"]:
        stamp = {"sec": one["header"]["stamp"]["secs"], "nanosec": one["header"]["stamp"]["nsecs"]}
        found.append({**one, "header": {"stamp": stamp, "frame_id": one["header"]["frame_id"]}})
    return found


def test_transforms_are_those_of_the_world(world: World, node: Ros2Node) -> None:
    node.subscribe("/tf", TRANSFORMS)
    node.gets("/tf")
    with world.client() as client, client.subscribe("/tf", "tf2_msgs/TFMessage") as here:
        wanted = [as_ros2(here.get(timeout=60)) for _ in range(5)]
    for transforms in wanted:
        assert transforms[0]["child_frame_id"]
        node.gets("/tf", lambda message, transforms=transforms: message["transforms"] == transforms)


def test_fixed_transforms_reach_who_comes_later(world: World) -> None:
    with world.client() as client, client.subscribe("/tf_static", "tf2_msgs/TFMessage") as here:
        wanted = as_ros2(here.get(timeout=60))
    assert wanted
    with world.node("/late") as late:
        late.subscribe("/tf_static", TRANSFORMS, "transient")
        assert late.gets("/tf_static")["transforms"] == wanted


def test_transforms_of_a_node_are_those_of_the_daemon_too(world: World) -> None:
    pose = {"translation": {"x": 1.5}, "rotation": {"z": 0.6, "w": 0.8}}
    mark = {"header": {"frame_id": "map"}, "child_frame_id": "mark", "transform": pose}
    with world.node("/marker") as marker, world.client() as client:
        marker.advertise("/tf", TRANSFORMS)
        with client.subscribe("/tf", "tf2_msgs/TFMessage") as here:
            eventually(
                lambda: (
                    marker.publish("/tf", {"transforms": [mark]}) is None
                    and (found := here.get(timeout=60)["transforms"][0])["child_frame_id"] == "mark"
                    and (found["header"]["frame_id"], found["transform"]["rotation"]["z"]) == ("map", 0.6)
                )
            )


def test_transforms_that_only_nodes_have_are_the_daemons_too(world: World) -> None:
    with world.node("/other/marker") as marker:
        marker.advertise("/other/tf", TRANSFORMS)
        eventually(lambda: "/other/tf" in world.run("topic", "list").stdout)


def test_fixed_transforms_of_a_node_are_those_of_the_daemon_too(world: World) -> None:
    mark = {"header": {"frame_id": "map"}, "child_frame_id": "fixed", "transform": {"translation": {"x": 1.5}}}
    with world.node("/fixed_marker") as marker:
        marker.advertise("/tf_static", TRANSFORMS, "transient")
        marker.publish("/tf_static", {"transforms": [mark]})
        eventually(lambda: "fixed" in world.run("tf", "list").stdout)
        assert "/fixed_marker" in world.run("topic", "info", "/tf_static").stdout
        assert "1.5" in world.run("tf", "echo", "map", "fixed").stdout
        with world.client() as client, client.subscribe("/tf_static") as kept:
            last = [kept.get(timeout=60)["transforms"][0]["child_frame_id"] for _ in range(2)]  # one of each publisher
        assert sorted(last) == ["base_link", "fixed"]


def test_the_state_of_a_controller_arrives(world: World, node: Ros2Node) -> None:
    node.subscribe(f"{CONTROLLER}/state", STATE)
    with world.client() as client:
        client.publish(f"{CONTROLLER}/command", {"data": 0.4})
    state = node.gets(f"{CONTROLLER}/state", lambda message: message["set_point"] == 0.4)
    assert state["error"] == pytest.approx(0.4 - state["process_value"])
    assert state["header"]["stamp"]["sec"] + state["header"]["stamp"]["nanosec"] > 0


def test_nodes_list_and_switch_controllers(world: World, node: Ros2Node) -> None:
    def listed() -> dict[str, Any]:
        answer = node.call(f"{MANAGER}/list_controllers", "controller_manager_msgs/srv/ListControllers", {})
        return {one["name"]: one for one in answer["controller"]}

    def switch(**request: Any) -> Any:
        return node.call(f"{MANAGER}/switch_controller", "controller_manager_msgs/srv/SwitchController",
                         {"strictness": 2, "timeout": {"sec": 2}, **request})  # fmt: skip

    name, other = "joint1_position_controller", "joint_state_controller"
    before = listed()
    assert before[name]["state"] == before[other]["state"] == "active"
    assert before[name]["type"] == "effort_controllers/JointPositionController"
    assert before[name]["claimed_interfaces"] == before[name]["required_command_interfaces"] == ["joint1/effort"]
    assert before[other]["claimed_interfaces"] == []
    assert switch(deactivate_controllers=[name]) == {"ok": True, "message": ""}
    after = listed()[name]
    assert (after["state"], after["claimed_interfaces"]) == ("inactive", [])
    assert after["required_command_interfaces"] == ["joint1/effort"]
    refused = switch(activate_controllers=["no_such"])
    assert not refused["ok"]
    assert "no_such" in refused["message"]
    assert not node.call(f"{MANAGER}/load_controller", "controller_manager_msgs/srv/LoadController", {"name": "none"})[
        "ok"
    ]
    assert "'none'" in world.log.splitlines()[-1]
    assert switch(activate_controllers=[name], activate_asap=True)["ok"]
    assert listed()[name]["state"] == "active"


def test_controllers_of_a_node_are_listed_in_slidectl(world: World) -> None:
    arm = {"name": "arm", "state": "inactive", "type": "a/B", "required_command_interfaces": ["j1/position", "j2/led"]}
    with world.node("/robot/controller_manager") as manager, world.client() as client:
        service = "/robot/controller_manager/list_controllers"
        manager.offer(service, "controller_manager_msgs/srv/ListControllers", {"controller": [arm]})
        eventually(lambda: service in world.run("service", "list").stdout)
        [found] = client.call(service)["controller"]
    position = {"hardware_interface": "hardware_interface::PositionJointInterface", "resources": ["j1"]}
    claims = [position, {"hardware_interface": "led", "resources": ["j2"]}]
    assert found == {"name": "arm", "state": "stopped", "type": "a/B", "claimed_resources": claims}


def test_a_trajectory_and_its_state_have_the_names_of_ros_2(world: World, node: Ros2Node) -> None:
    topic = "/test/trajectory_state"
    with world.client() as client:
        kind = "control_msgs/JointTrajectoryControllerState"
        client.advertise(topic, kind)
        node.subscribe(topic, "control_msgs/msg/JointTrajectoryControllerState")
        client.advertise_service("/test/query", "control_msgs/QueryTrajectoryState", lambda _: {"name": ["joint1"]})
        message = {"desired": {"positions": [1.0]}, "actual": {"positions": [2.0]}, "error": {"positions": [-1.0]}}
        eventually(lambda: client.publish(topic, message) is None and node.messages(topic))
        with serving(client):
            answer = node.call("/test/query", "control_msgs/srv/QueryTrajectoryState", {})
    state = node.messages(topic)[0]
    assert [state[name]["positions"] for name in ("reference", "feedback", "error")] == [[1.0], [2.0], [-1.0]]
    assert answer["success"]
    assert answer["name"] == ["joint1"]


def test_the_state_of_a_trajectory_controller_of_ros_2_is_the_same_in_both(world: World, node: Ros2Node) -> None:
    topic, service = "/test/arm/controller_state", "/test/arm/query_state"
    node.subscribe(topic, "control_msgs/msg/JointTrajectoryControllerState")
    with world.client() as client:
        client.advertise(topic, "slidectl/JointTrajectoryControllerState")
        answer = {"success": False, "name": ["joint1"]}
        client.advertise_service(service, "slidectl/QueryTrajectoryState", lambda _: answer)
        message = {"reference": {"positions": [1.0]}, "output": {"positions": [2.0]}, "speed_scaling_factor": 0.5}
        eventually(lambda: client.publish(topic, message) is None and node.messages(topic))
        with serving(client):
            found = node.call(service, "control_msgs/srv/QueryTrajectoryState", {})
    state = node.messages(topic)[0]
    assert [state[name]["positions"] for name in ("reference", "output")] == [[1.0], [2.0]]
    assert state["speed_scaling_factor"] == 0.5
    assert (found["success"], found["name"]) == (False, ["joint1"])


def test_the_packages_have_actions_too(world: World) -> None:
    code = """
from control_msgs.action import FollowJointTrajectory
from rclpy.serialization import deserialize_message, serialize_message

goal = FollowJointTrajectory.Goal()
goal.trajectory.joint_names = ["joint1"]
assert deserialize_message(serialize_message(goal), FollowJointTrajectory.Goal) == goal
"""
    subprocess.run([str(world.programs / "python"), "-c", code], env=world.env, check=True, timeout=240)


def test_the_status_names_these_packages_no_longer(world: World, node: Ros2Node) -> None:
    left_out = {name.partition("/")[0] for name in world.status()["left_out"].split(", ")}
    assert not left_out & {"tf2_msgs", "control_msgs", "controller_manager_msgs"}
    assert node.round_trips()["differ"] == []
