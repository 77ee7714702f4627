"""The node handle: relative names, and taking everything back."""

from __future__ import annotations

from typing import Any

import pytest

from slidectl.simulation.graph import Graph


def test_relative_names_are_below_the_namespace_and_absolute_ones_stay(graph: Graph) -> None:
    node = graph.node("/slider").child("joint1_position_controller")
    assert node.namespace == "/slider/joint1_position_controller"
    node.set_param("pid/p", 100.0)
    node.set_param("/top", 1)
    assert graph.parameters.names("/slider") == ["/slider/joint1_position_controller/pid/p"]
    assert node.get_param("/top") == 1
    assert node.get_param("nope", None) is None
    assert node.has_param("pid")
    with pytest.raises(KeyError):
        node.get_param("nope")


def test_a_search_goes_up_from_the_namespace(graph: Graph) -> None:
    graph.parameters.set("/slider/robot_description", "<robot/>")
    assert graph.node("/slider/arm/controller").search_param("robot_description") == "/slider/robot_description"


def test_shutdown_takes_back_all_that_it_and_its_children_had(graph: Graph) -> None:
    before = (graph.topics.types(), graph.services.names())
    told: list[int] = []
    root = graph.node("/slider")
    child = root.child("controller")
    deep = child.child("pid")
    root.advertise("joint_states", "sensor_msgs/JointState")
    child.subscribe("command", "std_msgs/Float64", lambda _: None)
    deep.advertise_service("set_parameters", "dynamic_reconfigure/Reconfigure", lambda _: {})
    deep.watch_param("p", lambda: told.append(1))
    assert "/slider/controller/pid/set_parameters" in graph.services.names()
    root.shutdown()
    assert (graph.topics.types(), graph.services.names()) == before
    graph.parameters.set("/slider/controller/pid/p", 1.0)
    assert told == []


def test_a_child_can_be_shut_down_alone_as_often_as_one_likes(graph: Graph) -> None:
    root = graph.node("/slider")
    root.advertise("joint_states", "sensor_msgs/JointState")
    for _ in range(3):
        child = root.child("controller")
        child.subscribe("command", "std_msgs/Float64", lambda _: None)
        child.shutdown()
    assert "/slider/joint_states" in graph.topics.names()
    assert "/slider/controller/command" not in graph.topics.names()


def test_a_watcher_hears_of_its_own_setting(graph: Graph) -> None:
    told: list[Any] = []
    node = graph.node("/slider")
    node.watch_param("gain", lambda: told.append(node.get_param("gain", None)))
    node.set_param("gain", 1)
    graph.parameters.delete("/slider/gain")
    assert told == [1, None]


def test_the_log_carries_the_node_and_the_time(graph: Graph) -> None:
    heard: list[Any] = []
    graph.topics.subscribe("/rosout", None, "/me", heard.append)
    node = graph.node("/slider", "/gazebo")
    graph.clock.time_ns = 1_000_000
    node.log("info", "hello")
    assert [(m["name"], m["msg"], m["level"]) for m in heard] == [("/gazebo", "hello", 2)]
    assert node.now_ns() == 1_000_000
