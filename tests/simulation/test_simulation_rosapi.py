"""`/rosapi/*` as clients of rosbridge know it."""

from __future__ import annotations

import json
from typing import Any

import pytest

from slidectl.errors import BadMessage, UnknownName
from slidectl.features import rosapi
from slidectl.simulation.graph import Graph


@pytest.fixture
def ask(graph: Graph) -> Any:
    rosapi.advertise(graph)
    graph.topics.advertise("/slider/joint_states", "sensor_msgs/JointState", "/gazebo")
    graph.topics.subscribe("/slider/command", "std_msgs/Float64", "/gazebo", lambda _: None)
    graph.services.advertise("/slider/load", "controller_manager_msgs/LoadController", "/gazebo", lambda _: {})
    return lambda service, /, **request: graph.services.call(f"/rosapi/{service}", request).result()


def test_topics_and_their_types(ask: Any) -> None:
    answer = ask("topics")
    assert dict(zip(answer["topics"], answer["types"], strict=True)) == {
        "/clock": "rosgraph_msgs/Clock",
        "/rosout": "rosgraph_msgs/Log",
        "/slider/command": "std_msgs/Float64",
        "/slider/joint_states": "sensor_msgs/JointState",
    }
    assert ask("topic_type", topic="/slider/command") == {"type": "std_msgs/Float64"}
    assert ask("topic_type", topic="/nope") == {"type": ""}
    assert ask("topics_for_type", type="sensor_msgs/JointState") == {"topics": ["/slider/joint_states"]}


def test_who_publishes_and_who_subscribes(ask: Any) -> None:
    assert ask("publishers", topic="/slider/joint_states") == {"publishers": ["/gazebo"]}
    assert ask("subscribers", topic="/slider/joint_states") == {"subscribers": []}
    assert ask("subscribers", topic="/slider/command") == {"subscribers": ["/gazebo"]}


def test_raw_types_hold_the_types_in_them(ask: Any) -> None:
    answer = ask("topics_and_raw_types")
    texts = dict(zip(answer["topics"], answer["typedefs_full_text"], strict=True))
    assert texts["/slider/command"] == "float64 data\n"
    first, rule, second = texts["/slider/joint_states"].partition(f"\n{'=' * 80}\nMSG: std_msgs/Header\n")
    assert "float64[] position" in first
    assert rule
    assert "string frame_id" in second


def test_action_servers_have_all_five_topics(ask: Any, graph: Graph) -> None:
    for topic in ("goal", "cancel", "status", "feedback", "result"):
        assert ask("action_servers") == {"action_servers": []}
        graph.topics.advertise(f"/arm/follow/{topic}", "std_msgs/Empty", "/gazebo")
    assert ask("action_servers") == {"action_servers": ["/arm/follow"]}
    assert ask("get_ros_version") == {"version": 1, "distro": "noetic"}


def test_services_their_types_and_providers(ask: Any) -> None:
    kind = "controller_manager_msgs/LoadController"
    assert "/slider/load" in ask("services")["services"]
    assert ask("service_type", service="/slider/load") == {"type": kind}
    assert ask("service_type", service="/nope") == {"type": ""}
    assert ask("services_for_type", type=kind) == {"services": ["/slider/load"]}
    assert ask("service_providers", service=kind) == {"providers": ["/gazebo"]}
    assert ask("service_providers", service="/slider/load") == {"providers": ["/gazebo"]}
    assert ask("service_node", service="/slider/load") == {"node": "/gazebo"}
    assert ask("service_node", service="/nope") == {"node": ""}


def test_nodes_and_what_they_have(ask: Any) -> None:
    assert ask("nodes") == {"nodes": ["/gazebo", "/rosapi"]}
    details = ask("node_details", node="/gazebo")
    assert details["publishing"] == ["/clock", "/rosout", "/slider/joint_states"]
    assert details["subscribing"] == ["/slider/command"]
    assert details["services"] == ["/slider/load"]


def test_message_details_begin_with_the_type_asked_for_and_go_down(ask: Any) -> None:
    typedefs = ask("message_details", type="trajectory_msgs/JointTrajectory")["typedefs"]
    assert [typedef["type"] for typedef in typedefs] == [
        "trajectory_msgs/JointTrajectory",
        "std_msgs/Header",
        "time",
        "trajectory_msgs/JointTrajectoryPoint",
        "duration",
    ]
    top = typedefs[0]
    assert top["fieldnames"] == ["header", "joint_names", "points"]
    assert top["fieldtypes"] == ["std_msgs/Header", "string", "trajectory_msgs/JointTrajectoryPoint"]
    assert top["fieldarraylen"] == [-1, 0, 0]
    assert top["examples"] == ["{}", "[]", "[]"]


def test_constants_and_fixed_arrays_are_told(ask: Any) -> None:
    log = ask("message_details", type="rosgraph_msgs/Log")["typedefs"][0]
    assert dict(zip(log["constnames"], log["constvalues"], strict=True)) == {
        "DEBUG": "1",
        "INFO": "2",
        "WARN": "4",
        "ERROR": "8",
        "FATAL": "16",
    }
    assert log["constnames"] == sorted(log["constnames"])
    imu = ask("message_details", type="sensor_msgs/Imu")["typedefs"][0]
    assert 9 in imu["fieldarraylen"]
    point = ask("message_details", type="geometry_msgs/Point")["typedefs"][0]
    assert point["examples"] == ["0.0", "0.0", "0.0"]


def test_service_details(ask: Any) -> None:
    kind = "controller_manager_msgs/SwitchController"
    request = ask("service_request_details", type=kind)["typedefs"]
    assert [typedef["type"] for typedef in request] == [kind + "Request"]
    assert request[0]["fieldnames"][:2] == ["start_controllers", "stop_controllers"]
    response = ask("service_response_details", type=kind)["typedefs"]
    assert response[0]["fieldnames"] == ["ok"]
    listing = ask("service_response_details", type="controller_manager_msgs/ListControllers")["typedefs"]
    assert [typedef["type"].rpartition("/")[2] for typedef in listing] == [
        "ListControllersResponse",
        "ControllerState",
        "HardwareInterfaceResources",
    ]


def test_an_unknown_type_fails_with_names(ask: Any) -> None:
    with pytest.raises(UnknownName, match="sensor_msgs/JointStat"):
        ask("message_details", type="sensor_msgs/JointStat")
    with pytest.raises(UnknownName, match="std_srvs/Emty"):
        ask("service_request_details", type="std_srvs/Emty")


def test_parameters_travel_as_json(ask: Any, graph: Graph) -> None:
    ask("set_param", name="/slider/pid", value='{"p": 100.0, "names": ["a"]}')
    assert json.loads(ask("get_param", name="/slider/pid")["value"]) == {"p": 100.0, "names": ["a"]}
    assert ask("get_param", name="slider/pid/p") == {"value": "100.0"}
    assert ask("has_param", name="/slider/pid/p") == {"exists": True}
    assert "/slider/pid/p" in ask("get_param_names")["names"]
    assert ask("search_param", name="slider") == {"global_name": "/slider"}
    ask("delete_param", name="/slider")
    assert ask("has_param", name="/slider") == {"exists": False}
    assert graph.parameters.names("/slider") == []


def test_an_unset_parameter_fails_unless_a_default_is_given(ask: Any) -> None:
    with pytest.raises(UnknownName, match="/nope"):
        ask("get_param", name="/nope")
    with pytest.raises(UnknownName, match="/nope"):
        ask("delete_param", name="/nope")
    assert ask("get_param", name="/nope", default="1.5") == {"value": "1.5"}
    assert ask("get_param", name="/nope", default="plain text") == {"value": '"plain text"'}


def test_a_value_that_is_not_json_is_refused(ask: Any) -> None:
    with pytest.raises(BadMessage, match="not JSON"):
        ask("set_param", name="/x", value="{p: 1}")
    with pytest.raises(BadMessage, match="not JSON"):
        ask("set_param", name="/x", value="[" * 100_000)


def test_the_whole_tree_can_be_read(ask: Any, graph: Graph) -> None:
    graph.parameters.set("/a/b", 1)
    assert json.loads(ask("get_param", name="/")["value"]) == {"a": {"b": 1}}


def test_time(ask: Any, graph: Graph) -> None:
    graph.clock.time_ns = 1_500_000_000
    assert ask("get_time") == {"time": {"secs": 1, "nsecs": 500_000_000}}
