"""The real rosmaster: the same calls give the same answers, right and wrong ones; and the gateway joins it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from typing import Any
from xmlrpc.client import Fault, ServerProxy

import pytest
from daemon_fixture import running_daemon, shown
from ros1_tools import Program, need_ros, roscore
from running_gateway import running_gateway
from waiting import eventually

A, B = "http://127.0.0.1:1/", "http://127.0.0.1:2/"
RPC, RPC2 = "rosrpc://127.0.0.1:3", "rosrpc://127.0.0.1:4"
FLOAT = "std_msgs/Float64"

CALLS: list[tuple[Any, ...]] = [
    # names
    ("registerPublisher", "/ns/a", "chat", "my_msgs/Word", A),
    ("registerPublisher", "/ns/a", "/ns/chat", "*", A),
    ("registerSubscriber", "/ns/b", "/ns//chat/", "*", B),
    ("registerSubscriber", "/ns/b", "~own", "my_msgs/Word", B),
    ("registerSubscriber", "/ns/b", "/untyped", "*", B),
    ("registerService", "/ns/a", "do", RPC, A),
    ("registerService", "/ns/b", "/ns/do", RPC2, B),
    ("lookupService", "/x", "/ns/do"),
    ("lookupService", "/ns/x", "do"),
    ("lookupService", "/x", "do"),
    ("lookupNode", "/x", "/ns/a"),
    ("lookupNode", "/x", "ns/b"),
    ("lookupNode", "/x", "/c"),
    ("getPublishedTopics", "/x", "/ns"),
    ("getPublishedTopics", "/x", "ns/chat"),
    ("unregisterService", "/ns/a", "do", RPC),
    ("unregisterService", "/ns/b", "do", RPC2),
    ("unregisterService", "/nobody", "do", RPC2),
    ("unregisterSubscriber", "/ns/b", "chat", A),
    ("unregisterSubscriber", "/ns/b", "chat", B),
    ("unregisterSubscriber", "/ns/b", "chat", B),
    ("unregisterSubscriber", "/ns/b", "~own", B),
    ("unregisterSubscriber", "/ns/b", "/untyped", B),
    ("unregisterSubscriber", "/ns/b", "/untyped", B),
    ("unregisterPublisher", "/nobody", "chat", A),
    ("unregisterPublisher", "/ns/a", "chat", A),
    # arguments that cannot be
    ("registerPublisher", "/ns/a", "", FLOAT, A),
    ("registerPublisher", "/ns/a", 7, FLOAT, A),
    ("registerPublisher", "/ns/a", "/", FLOAT, A),
    ("registerPublisher", "/ns/a", "/with blank", FLOAT, A),
    ("registerPublisher", "/ns/a", "http://a", FLOAT, A),
    ("registerPublisher", "/ns/a", "/t", "", A),
    ("registerPublisher", "/ns/a", "/t", "Float64", A),
    ("registerPublisher", "/ns/a", "/t", "a/b/c", A),
    ("registerPublisher", "/ns/a", "/t", FLOAT, ""),
    ("registerPublisher", "/ns/a", "/t", FLOAT, "localhost"),
    ("registerPublisher", "/ns/a", "/t", FLOAT),
    ("registerPublisher",),
    ("registerPublisher", 5, "/t", FLOAT, A),
    ("registerService", "/ns/a", "/s", "do", A),
    ("registerService", "/ns/a", "/s", RPC, 3),
    ("registerService", "/ns/a", "/", RPC, A),
    ("lookupNode", "/x", ""),
    ("lookupNode", "/x", "/"),
    ("getPublishedTopics", "/x", 3),
    ("getPid",),
    ("fly", "/x"),
    # parameters
    ("setParam", "/ns/a", "~gain", 1),
    ("setParam", "/ns/a", "tree", {"x": 1.5, "y": {"z": [1, "two", False]}}),
    ("setParam", "/ns/a", "tree/y/new", "text"),
    ("getParam", "/ns/a", "~gain"),
    ("getParam", "/x", "ns/tree"),
    ("getParam", "/x", "/ns/tree/y/"),
    ("getParam", "/x", "/ns/tree/none"),
    ("getParam", "/x", "/ns/tree/x/below"),
    ("hasParam", "/ns/a", "tree"),
    ("hasParam", "/ns/a", "~none"),
    ("hasParam", "/ns/a", ""),
    ("searchParam", "/ns/tree/deep/node", "y"),
    ("searchParam", "/ns/tree/deep/node", "y/absent"),
    ("searchParam", "/ns/a", "gain"),
    ("searchParam", "/ns/a", "none"),
    ("searchParam", "/ns/a", "/ns/tree"),
    ("searchParam", "/ns/a", "~gain"),
    ("searchParam", "a", "gain"),
    ("subscribeParam", "/ns/b", B, "tree"),
    ("subscribeParam", "/ns/b", B, "none"),
    ("subscribeParam", "/ns/b", "nowhere", "none"),
    ("unsubscribeParam", "/ns/b", B, "tree"),
    ("unsubscribeParam", "/ns/b", B, "none"),
    ("unsubscribeParam", "/ns/b", B, "none"),
    ("lookupNode", "/x", "/ns/b"),
    ("setParam", "/ns/a", "", 1),
    ("setParam", "/ns/a", 4, 1),
    ("setParam", "/ns/a", "/nothing", None),
    ("setParam", "/ns/a", "/nothing"),
    ("deleteParam", "/ns/a", "tree/x"),
    ("deleteParam", "/ns/a", "tree/x"),
    ("deleteParam", "/ns/a", "tree"),
    ("deleteParam", "/ns/a", "~gain"),
    ("deleteParam", "/ns/a", "/"),
    ("deleteParam", "/ns/a", ""),
    ("deleteParam",),
]  # fmt: skip


@pytest.fixture(scope="module")
def ours() -> Iterator[list[Any]]:
    with running_daemon(paused=True) as runtime, running_gateway(runtime, "ros1") as address:
        yield answers(address)


@pytest.fixture(scope="module")
def theirs() -> Iterator[list[Any]]:
    need_ros()
    with roscore() as ros:
        yield answers(ros.env["ROS_MASTER_URI"])


def answers(address: str) -> list[Any]:
    found: list[Any] = []
    with ServerProxy(address, allow_none=True) as master:
        for method, *arguments in CALLS:
            try:
                found.append(getattr(master, method)(*arguments))
            except Fault as fault:
                found.append((fault.faultCode, fault.faultString))
    return found


def test_a_real_roscore_is_joined() -> None:
    need_ros()
    with running_daemon() as runtime, roscore() as ros, closing(runtime.client()) as client:
        spawn = "spawn slider --controllers config/slider_control.yaml --start joint_state_controller"
        words = [sys.executable, "-m", "slidectl", *spawn.split(), "joint1_position_controller"]
        subprocess.run(words, env=runtime.env, check=True, capture_output=True, timeout=60)
        gain = "/slider/joint1_position_controller/pid/p"
        [joining] = shown("ros1.md", "--master")
        assert joining.pop() == "http://other:11311"
        words = [sys.executable, "-m", *joining, ros.env["ROS_MASTER_URI"], "--port", "0"]
        with closing(Program(words, runtime.env, ros.folder / "gateway.txt")):
            eventually(lambda: "/slider/joint_states" in ros.ok("rostopic list"), "nothing is registered")
            assert "- joint1" in ros.ok("rostopic echo -n 1 /slider/joint_states")
            eventually(lambda: ros.run(f"rosparam get {gain}").stdout == "100.0\n", "the parameters are not mirrored")
            assert ros.ok("rosparam get /use_sim_time") == "true\n"

            def asked() -> Any:
                return json.loads(client.call("/rosapi/get_param", {"name": gain})["value"])

            ros.ok(f"rosparam set {gain} 120")
            eventually(lambda: asked() == 120.0, "the gain did not come to the daemon")
            ros.ok(f"rosparam set {gain} soft")
            eventually(lambda: ros.ok(f"rosparam get {gain}") == "120.0\n", "a gain that is refused stays there")
            ros.ok("rosservice call /gazebo/pause_physics {}")
            assert client.call("/slidectl/status")["paused"]
        assert "/slidectl" not in ros.ok("rosnode list")


@pytest.mark.parametrize("index", range(len(CALLS)), ids=lambda index: " ".join(map(str, CALLS[index])))
def test_the_answer_is_that_of_rosmaster(index: int, ours: list[Any], theirs: list[Any]) -> None:
    assert ours[index] == theirs[index]
