"""rosbag and robot_state_publisher, which are C++ nodes, beside slidectl's own recorder and publisher of frames."""

from __future__ import annotations

import functools
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from daemon_fixture import ROOT, Runtime, running_daemon
from ros1_tools import Ros, gateway, need_ros
from rosbags.rosbag1 import Reader
from waiting import eventually

from slidectl.client import Client
from slidectl.wire.messages import Message

COMMAND = "/slider/joint1_position_controller/command"
STATES = "/slider/joint_states"
GATEWAY = "/ros1_gateway_topics"
"""It subscribes what nodes of ROS subscribe."""
Frames = dict[tuple[Any, ...], list[float]]
RECORDED = (COMMAND, STATES, "/tf", "/slider/joint1_position_controller/state")


@pytest.fixture
def daemon() -> Iterator[Runtime]:
    need_ros()
    with running_daemon(paused=True) as daemon, daemon.client(60.0) as client:
        client.spawn(
            "slider",
            controllers=str(ROOT / "config/slider_control.yaml"),
            start=["joint_state_controller", "joint1_position_controller"],
        )
        yield daemon


@pytest.fixture
def client(daemon: Runtime) -> Iterator[Client]:
    with daemon.client(60.0) as client:
        yield client


@pytest.fixture
def ros(daemon: Runtime) -> Iterator[Ros]:
    with gateway(daemon) as ros:
        yield ros


def has_taken(bag: Path, part: bytes) -> bool:
    """Whether this is in the file of a recorder that runs."""
    return part in Path(f"{bag}.active").read_bytes()


def position(client: Client) -> float:
    answer = client.call("/gazebo/get_joint_properties", {"joint_name": "slider::joint1"})
    return float(answer["position"][0])


def messages(bag: Path) -> dict[str, list[bytes]]:
    """The messages of each topic as they were recorded, those that came more than once."""
    found: dict[str, list[bytes]] = {}
    with Reader(bag) as reader:
        for connection, _, body in reader.messages():
            found.setdefault(connection.topic, []).append(bytes(body))
    return found


def are_heard_by(client: Client, *nodes: str, topics: tuple[str, ...] = RECORDED) -> bool:
    """True when each of the topics has subscribers whose names begin like these."""
    heard = [client.call("/rosapi/subscribers", {"topic": topic})["subscribers"] for topic in topics]
    return all(any(one.startswith(node) for one in subscribers) for subscribers in heard for node in nodes)


def test_rosbag_records_what_slidectl_records_and_its_bag_moves_the_slider_again(
    daemon: Runtime, client: Client, ros: Ros, tmp_path: Path
) -> None:
    theirs, ours = tmp_path / "theirs.bag", tmp_path / "ours.bag"
    client.advertise(COMMAND, "std_msgs/Float64")
    client.call("/gazebo/unpause_physics")  # it looks for topics once a second of simulated time
    recorder = ros.start(f"/usr/lib/rosbag/record -a --chunksize=1 -O {theirs}")
    eventually(lambda: are_heard_by(client, "/record_", GATEWAY), "rosbag record does not subscribe")
    client.call("/gazebo/pause_physics")
    words = [sys.executable, "-m", "slidectl", "record", "-O", str(ours), *RECORDED]
    with subprocess.Popen(words, env=daemon.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as own:
        try:
            eventually(lambda: are_heard_by(client, f"/slidectl_{own.pid}_"), "slidectl record does not subscribe")
            with client.subscribe(STATES) as states:
                for target in (0.4, 0.25):
                    client.deliver(COMMAND, {"data": target})
                    for _ in range(24):  # rosbag record drops what comes faster than it takes it: 100 messages may wait
                        client.step(seconds=0.25)
                        first, *_ = [states.get(0.0) for _ in range(len(states))]
                        header = first["header"]
                        begin = struct.pack("<3I", header["seq"], header["stamp"]["secs"], header["stamp"]["nsecs"])
                        eventually(functools.partial(has_taken, theirs, begin), "rosbag record does not write")
            moved = position(client)
        finally:
            own.send_signal(signal.SIGINT)
        assert own.wait(60) in (0, 130)
    client.call("/gazebo/unpause_physics")
    last = messages(ours)[STATES][-1]
    eventually(lambda: has_taken(theirs, last), "rosbag record does not write")
    recorder.interrupt()
    found, expected = messages(theirs), messages(ours)
    assert found[COMMAND] == expected[COMMAND] == [np.float64(0.4).tobytes(), np.float64(0.25).tobytes()]
    for topic in (STATES, "/slider/joint1_position_controller/state"):
        assert len(expected[topic]) > 100
        first = found[topic].index(expected[topic][0])
        assert found[topic][first:][: len(expected[topic])] == expected[topic]
    assert set(found["/tf"]) >= set(expected["/tf"][1:])  # the first is the one that was there before
    assert f"{STATES} " in ros.ok(f"rosbag info {theirs}")

    client.call("/gazebo/pause_physics")
    client.call("/gazebo/reset_world")
    client.deliver(COMMAND, {"data": 0.0})
    client.step(seconds=6.0)
    assert position(client) == pytest.approx(0.0, abs=0.02)
    client.call("/gazebo/unpause_physics")
    played = ros.start(f"/usr/lib/rosbag/play --topics {COMMAND} --bags={theirs}")
    assert played.ends(120) == 0
    client.wait(f"{STATES}/position[0]", near=0.25, tol=0.02)
    assert position(client) == pytest.approx(moved, abs=0.02)


def test_robot_state_publisher_beside_ours_gives_the_same_frames(client: Client, ros: Ros) -> None:
    client.delete("slider")
    config = str(ROOT / "config/arm_control.yaml")
    client.spawn("arm", controllers=config, joints={"joint1": 0.7, "joint2": 0.4, "joint4": -0.3})
    client.params["/arm/joint_state_controller/publish_rate"] = 1000
    manager = client.controllers("/arm")
    for name in ("joint_state_controller", "arm_controller"):
        manager.load(name)
    manager.switch(["joint_state_controller", "arm_controller"], [])
    client.step(seconds=20.0)  # it holds that pose
    node = ros.start(
        "/usr/lib/robot_state_publisher/robot_state_publisher __name:=theirs robot_description:=/arm/robot_description"
        " joint_states:=/arm/joint_states tf:=/their_tf tf_static:=/their_tf_static"
    )
    eventually(lambda: {"/their_tf", "/their_tf_static"} <= client.topics().keys(), "it does not publish")
    eventually(lambda: are_heard_by(client, "/theirs", GATEWAY, topics=("/arm/joint_states",)), "it does not subscribe")
    kinds = {"/tf": "/their_tf", "/tf_static": "/their_tf_static"}
    taken: dict[str, Frames] = {topic: {} for pair in kinds.items() for topic in pair}

    def take(topic: str, published: Message) -> None:
        for one in published["msg"]["transforms"]:
            stamp = one["header"]["stamp"] if "static" not in topic else {}
            key = (one["header"]["frame_id"], one["child_frame_id"], *stamp.values())
            pose = one["transform"]
            taken[topic][key] = [pose[part][axis] for part in ("translation", "rotation") for axis in pose[part]]

    for topic in taken:
        client.subscribe(topic, "tf2_msgs/TFMessage", take=functools.partial(take, topic))

    def are_compared() -> bool:
        client.step(cycles=100)
        return len(taken["/tf"].keys() & taken["/their_tf"].keys()) >= 60 and len(taken["/their_tf_static"]) > 0

    eventually(are_compared, f"no frames of the same time: {node.output}")
    for ours, theirs in kinds.items():
        common = taken[ours].keys() & taken[theirs].keys()
        assert common
        for key in common:
            assert quaternion_up(taken[theirs][key]) == pytest.approx(quaternion_up(taken[ours][key]), abs=1e-9)
    assert {key[:2] for key in taken["/their_tf"]} == {key[:2] for key in taken["/tf"]}


def quaternion_up(pose: list[float]) -> list[float]:
    """The pose with that of the two quaternions of its rotation whose w is positive."""
    return pose if pose[-1] >= 0 else [*pose[:3], *(-one for one in pose[3:])]
