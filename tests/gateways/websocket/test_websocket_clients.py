"""The real clients of rosbridge: roslibjs 2 and 1 in Node, roslibpy. What they offer works; restarts too."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from queue import Queue
from typing import Any
from urllib.parse import urlsplit

import pytest
import roslibpy
from daemon_fixture import Runtime, running_daemon
from rosbridge_client import RosbridgeClient
from roslibpy.core import RosTimeoutError
from roslibpy.ros1.actionlib import ActionClient, Goal
from running_gateway import running_gateway
from waiting import DEADLINE_S, eventually
from websockets.exceptions import ConnectionClosed

sys.path.append(str(Path(__file__).parent.parent))
import node_scripts

roslibpy.set_rosapi_timeout(DEADLINE_S)


def furnish(runtime: Runtime) -> None:
    with runtime.client() as client:
        started = ["joint_state_controller", "joint1_position_controller"]
        client.spawn("slider", controllers="config/slider_control.yaml", start=started)
        started = ["joint_state_controller", "gripper_controller"]
        client.spawn("gripper", at=(1, 0, 0), controllers="config/gripper_control.yaml", start=started)


@pytest.fixture(scope="module")
def world() -> Iterator[Runtime]:
    with running_daemon() as runtime:
        furnish(runtime)
        yield runtime


@pytest.fixture(scope="module")
def url(world: Runtime) -> Iterator[str]:
    with running_gateway(world, "websocket") as address:
        yield address


@pytest.fixture
def ros(url: str) -> Iterator[roslibpy.Ros]:
    one = connected(url)
    yield one
    one.close()


def connected(url: str, **options: Any) -> roslibpy.Ros:
    parts = urlsplit(url)
    one = roslibpy.Ros(parts.hostname, parts.port, **options)
    one.run(timeout=DEADLINE_S)
    return one


def gripper(ros: roslibpy.Ros) -> str:
    """The name of its action."""
    found: Queue[Any] = Queue()
    ros.get_action_servers(found.put)
    names = found.get(timeout=DEADLINE_S)["action_servers"]
    return next(str(name) for name in names if name.endswith("/gripper_cmd"))


@pytest.mark.parametrize("module", ["roslib", "roslib-1"])
def test_roslibjs(url: str, module: str) -> None:
    assert node_scripts.run("roslib_client.js", url, module).splitlines()[-1] == "done"


def test_roslibpy_sees_what_there_is(ros: roslibpy.Ros) -> None:
    assert "/slider/joint_states" in ros.get_topics()
    assert ros.get_topic_type("/slider/joint_states") == "sensor_msgs/JointState"
    assert ros.get_service_type("/slider/controller_manager/list_controllers").endswith("/ListControllers")
    assert "/gazebo" in ros.get_nodes()
    assert gripper(ros)
    assert set(ros.get_time()) == {"secs", "nsecs"}
    ros.set_param("/py/list", [1, "two"])
    assert ros.get_param("/py/list") == [1, "two"]
    ros.delete_param("/py/list")
    assert "/py/list" not in ros.get_params()


def test_roslibpy_moves_the_block(ros: roslibpy.Ros) -> None:
    states: Queue[Any] = Queue()
    topic = roslibpy.Topic(ros, "/slider/joint_states", "sensor_msgs/JointState", throttle_rate=20, queue_length=1)
    topic.subscribe(states.put)
    command = roslibpy.Topic(ros, "/slider/joint1_position_controller/command", "std_msgs/Float64")
    for target in (0.0, 1.0):
        command.publish({"data": target})
        eventually(lambda: abs(states.get(timeout=DEADLINE_S)["position"][0] - target) < 0.05)  # noqa: B023
    topic.unsubscribe()
    command.unadvertise()


def test_roslibpy_calls_serves_and_is_told_of_failures(ros: roslibpy.Ros, url: str) -> None:
    manager = roslibpy.Service(
        ros, "/slider/controller_manager/list_controllers", "controller_manager_msgs/ListControllers"
    )
    assert len(manager.call(roslibpy.ServiceRequest(), timeout=DEADLINE_S)["controller"]) == 2
    with pytest.raises(Exception, match="no_such"):
        roslibpy.Service(ros, "/no_such", "std_srvs/Empty").call(roslibpy.ServiceRequest(), timeout=DEADLINE_S)

    def serve(request: Any, response: Any) -> bool:
        response["success"], response["message"] = request["data"], "from Python"
        return True

    served = roslibpy.Service(ros, "/py_serves", "std_srvs/SetBool")
    served.advertise(serve)
    other = connected(url)
    eventually(lambda: "/py_serves" in other.get_services())
    setting = roslibpy.Service(other, "/py_serves", "std_srvs/SetBool")
    answer = setting.call(roslibpy.ServiceRequest({"data": True}), timeout=DEADLINE_S)
    assert answer["message"] == "from Python"
    silent = roslibpy.Service(other, "/py_silent", "std_srvs/Empty")
    with RosbridgeClient(url) as provider:
        provider.send(op="advertise_service", service="/py_silent", type="std_srvs/Empty")
        assert provider.call("/rosapi/get_time")["result"]
        with pytest.raises(RosTimeoutError):
            silent.call(roslibpy.ServiceRequest(), timeout=0.2)
        failures: Queue[Any] = Queue()
        silent.call(roslibpy.ServiceRequest(), lambda _: None, failures.put)
        for _ in range(2):
            provider.op("call_service", service="/py_silent")
    assert "went away" in str(failures.get(timeout=DEADLINE_S))  # in the middle of the call
    other.close()


def test_roslibpy_sends_goals_by_topics_and_by_ops(ros: roslibpy.Ros) -> None:
    name = gripper(ros)
    client = ActionClient(ros, name, "control_msgs/GripperCommandAction")
    goal = Goal(client, {"command": {"position": 0.04, "max_effort": 20}})
    goal.send()
    assert "reached_goal" in goal.wait(DEADLINE_S)
    client.dispose()

    ends: Queue[Any] = Queue()
    ops = roslibpy.ActionClient(ros, name, "control_msgs/GripperCommand")
    for position in (0.02, "far"):
        ops.send_goal(
            roslibpy.Goal({"command": {"position": position, "max_effort": 20}}), ends.put, lambda _: None, ends.put
        )
    found = [ends.get(timeout=DEADLINE_S) for _ in range(2)]
    assert sorted(str(end["status"]) for end in found) == ["GoalStatus.ABORTED", "GoalStatus.SUCCEEDED"]


def test_clients_come_back_when_the_daemon_does() -> None:
    with running_daemon() as runtime:
        furnish(runtime)
        with running_gateway(runtime, "websocket") as url:
            ros = connected(url)
            ros.factory.set_max_delay(0.5)
            states: Queue[Any] = Queue()
            roslibpy.Topic(ros, "/slider/joint_states", "sensor_msgs/JointState").subscribe(states.put)
            assert states.get(timeout=DEADLINE_S)
            with RosbridgeClient(url) as browser:
                browser.call("/rosapi/get_time")  # one whose connection is still being opened is told to try later
                runtime.stop()
                with pytest.raises(ConnectionClosed) as caught:
                    browser.frame(lambda _: False)
                assert caught.value.rcvd is not None
                assert caught.value.rcvd.code == 1012
            with RosbridgeClient(url) as browser:
                with pytest.raises(ConnectionClosed) as caught:
                    browser.frame(lambda _: False)
                assert caught.value.rcvd is not None
                assert caught.value.rcvd.code == 1013
            runtime.start()
            furnish(runtime)
            while not states.empty():
                states.get()
            assert states.get(timeout=DEADLINE_S)
            ros.close()
