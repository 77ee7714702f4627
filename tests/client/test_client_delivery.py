"""Messages that are delivered in one round trip, and lines that are too long."""

from __future__ import annotations

import warnings

import pytest
from daemon_fixture import Runtime

from slidectl.client import Client
from slidectl.errors import MessageRefused, Refused, UsageError
from slidectl.wire.peers import MessagesDropped


def test_a_message_is_delivered_or_refused_in_one_go(daemon: Runtime, client: Client) -> None:
    with daemon.client() as reader, reader.subscribe("/delivered/numbers", "std_msgs/Int32") as numbers:
        client.deliver("/delivered/numbers", {"data": 1})
        client.deliver("/delivered/numbers", {"data": 2}, type="std_msgs/Int32", latch=True)
        with pytest.raises(MessageRefused, match="data"):
            client.deliver("/delivered/numbers", {"data": "three"})
        client.deliver("/delivered/numbers", {"data": 4})
        reader.flush()
        assert [numbers.get()["data"] for _ in range(len(numbers))] == [1, 2, 4]


def test_what_fits_no_line_is_refused_before_it_leaves(client: Client) -> None:
    with pytest.raises(UsageError, match="more than the 16777216 that fit a line"):
        client.call("/rosapi/set_param", {"name": "/long", "value": "x" * 2**24})
    assert client.call("/rosapi/has_param", {"name": "/long"}) == {"exists": False}


def test_what_reached_nobody_is_an_error_when_the_client_is_left(daemon: Runtime) -> None:
    with pytest.raises(MessageRefused, match="nobody subscribes to /deaf: 2 published"), daemon.client() as client:
        [client.publish("/deaf", {"data": number}, type="std_msgs/Int32") for number in range(2)]
    with daemon.client() as client:
        client.publish("/kept", {"data": 1}, type="std_msgs/Int32", latch=True)
        client.publish("/heard", {"data": 1}, type="std_msgs/Int32")
        with client.subscribe("/heard"):
            client.publish("/heard", {"data": 2})


def test_a_short_name_is_resolved_once_for_a_connection(daemon: Runtime, client: Client) -> None:
    with daemon.client() as reader, reader.subscribe("/short/numbers", "std_msgs/Int32") as numbers:
        asked: list[str] = []
        original = client.resolve
        client.resolve = lambda kind, name, **more: (asked.append(name), original(kind, name, **more))[1]  # type: ignore
        for number in range(3):
            client.publish("numbers", {"data": number})
        client.flush()
        reader.flush()
        assert ([numbers.get()["data"] for _ in range(3)], asked) == ([0, 1, 2], ["numbers"])


def test_dropped_messages_are_told_at_the_end_unless_the_newest_alone_were_wanted(daemon: Runtime) -> None:
    with daemon.client() as writer, daemon.client() as reader:
        numbers = reader.subscribe("/many", "std_msgs/Int32")
        newest = reader.subscribe("/many", queue_length=1)
        for number in range(1500):
            writer.publish("/many", {"data": number})
        writer.flush()
        reader.flush()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            newest.close()
        assert newest.dropped >= 1000
        with pytest.warns(MessagesDropped, match=f"{numbers.dropped} messages of /many were dropped: 1000 wait"):
            numbers.close()
        assert numbers.dropped == 500


def test_a_client_that_is_closed_tells_of_its_subscriptions(daemon: Runtime) -> None:
    reader = daemon.client()
    reader.subscribe("/many", "std_msgs/Int32")
    with daemon.client() as writer:
        for number in range(1500):
            writer.publish("/many", {"data": number})
        writer.flush()
    reader.flush()
    with pytest.warns(MessagesDropped, match="500 messages of /many"):
        reader.close()


def test_pause_resume_and_reset_are_those_of_the_command_line(runtime: Runtime) -> None:
    runtime.start(paused=True)
    with runtime.client() as client:
        client.resume()
        client.sleep(0.01)
        client.pause()
        assert client.call("/slidectl/status")["paused"]
        assert client.step() > 0.01
        client.reset()
        assert client.call("/slidectl/status")["time"] > 0.01
        client.reset(time=True)
        assert client.call("/slidectl/status")["time"] == 0.0


def test_the_manager_of_the_only_robot_has_the_verbs(runtime: Runtime) -> None:
    runtime.start(paused=True)
    with runtime.client() as client:
        with pytest.raises(UsageError, match="which controller manager"):
            client.controllers()
        client.spawn("slider", controllers="config/slider_control.yaml")
        manager = client.controllers()
        assert manager.namespace == "/slider"
        client.resume()
        assert manager.spawn("joint_state_controller") == {"joint_state_controller": "running"}
        manager.stop("joint_state_controller")
        assert manager.states() == {"joint_state_controller": "stopped"}
        manager.start(["joint_state_controller"])
        manager.load("joint1_position_controller")
        manager.switch(["joint1_position_controller"], ["joint_state_controller"])
        assert [(one["name"], one["state"]) for one in manager.controllers()] == [
            ("joint_state_controller", "stopped"), ("joint1_position_controller", "running")
        ]  # fmt: skip
        assert "effort_controllers/JointPositionController" in manager.types()["types"]
        manager.unload("joint_state_controller")
        with pytest.raises(Refused, match="joint_state_controller"):
            manager.unload("joint_state_controller")
        manager.unspawn("joint1_position_controller")
        assert (manager.states(), manager.known()) == ({}, manager.configured())


def test_a_name_that_is_no_graph_name_is_taken_with_a_warning(runtime: Runtime) -> None:
    runtime.start(paused=True)
    with runtime.client() as client:
        with pytest.warns(UserWarning, match="'2dof' cannot be a part of a topic's name: the robot is robot_2dof here"):
            robot = client.spawn("slider", name="2dof", controllers="config/slider_control.yaml")
        assert (robot["name"], robot["namespace"]) == ("robot_2dof", "/robot_2dof")
