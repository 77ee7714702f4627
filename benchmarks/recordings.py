"""Recordings: messages a second into and out of files beside the bare libraries, and what a recorder costs."""

from __future__ import annotations

import json
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from benchmarks.cycles import STATES, hinge
from benchmarks.harness import RRBOT_CONTROLLERS, SLIDECTL, Daemon, Row, daemon
from slidectl.extensions.recording import codec
from slidectl.extensions.recording.recording_files import create, opened

MESSAGES = 20_000
SECONDS = 5.0
TOPICS = (10, 30, 100)
TYPE = "sensor_msgs/JointState"
MESSAGE: dict[str, Any] = {
    "header": {"seq": 1, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": ""},
    "name": [f"joint{k}" for k in range(6)],
    **{field: [0.1 * k for k in range(6)] for field in ("position", "velocity", "effort")},
}


def measure() -> list[Row]:
    """Rows of this module."""
    with tempfile.TemporaryDirectory(prefix="slidectl-bench-", dir="/tmp") as folder:
        rows = [row for suffix in (".bag", ".mcap") for row in _files(Path(folder), suffix)]
        return rows + _recorder(Path(folder))


def _files(folder: Path, suffix: str) -> list[Row]:
    """Writing and reading, ours and the library's in turns."""
    ours, bare, read = [], [], []
    for turn in range(3):
        path = folder / f"ours{turn}{suffix}"
        ours.append(_rate(lambda path=path: _write(path)))  # type: ignore[misc]
        bare.append(_rate(lambda turn=turn: _write_bare(folder / f"bare{turn}{suffix}")))  # type: ignore[misc]
        read.append(_rate(lambda path=path: _read(path)))  # type: ignore[misc]
    note = f"of six joints; the bare library {max(bare):.0f}/s"
    return [
        Row(f"messages written into a {suffix} file", max(ours), "1/s", None, "higher", note),
        Row(f"messages read from a {suffix} file", max(read), "1/s", None, "higher", "in the shape of the wire"),
    ]


def _rate(action: Callable[[], None]) -> float:
    began = time.perf_counter()
    action()
    return MESSAGES / (time.perf_counter() - began)


def _write(path: Path) -> None:
    writer, kind = create(path), codec.of(TYPE)
    topic = writer.add("/joint_states", kind, latching=False)
    for number in range(MESSAGES):
        writer.write(topic, number, kind.encode(MESSAGE))
    writer.close()


def _write_bare(path: Path) -> None:
    """With the library's own objects and serialization, as its documentation shows."""
    kind = codec.of(TYPE)
    store = get_typestore(Stores.ROS1_NOETIC)
    name = TYPE.replace("/", "/msg/")
    message = store.deserialize_ros1(kind.encode(MESSAGE), name)
    if path.suffix == ".bag":
        with BagWriter(path) as bag:
            topic = bag.add_connection("/joint_states", name, typestore=store)
            for number in range(MESSAGES):
                bag.write(topic, number + 1, store.serialize_ros1(message, name))
        return
    with path.open("wb") as file:
        mcap = McapWriter(file, compression=CompressionType.NONE)
        mcap.start("ros1", "bench")
        schema = mcap.register_schema(TYPE, "ros1msg", kind.definition.encode())
        channel = mcap.register_channel("/joint_states", "ros1", schema)
        for number in range(MESSAGES):
            mcap.add_message(channel, number, bytes(store.serialize_ros1(message, name)), number)
        mcap.finish()  # type: ignore[no-untyped-call]


def _read(path: Path) -> None:
    with opened(path) as recording:
        for record in recording.records():
            recording.message(record)


def _recorder(folder: Path) -> list[Row]:
    """All topics of RRBot at real time, `/clock` and two topics at 1 kHz among them; then topics of many robots."""
    with daemon() as instance:
        instance.run("spawn", "rrbot", "--controllers", "config/rrbot_control.yaml", "--start", *RRBOT_CONTROLLERS)
        factor, count, lost = _record(instance, ["-a", "-x", ".*image.*"], folder / "run.bag")
    note = f"{count / SECONDS:.0f} messages a second{f', {lost} lost' if lost else ', none lost'}"
    title = "real-time factor while all topics of RRBot are recorded"
    return [Row(title, factor, "", 0.99, "higher", note), *_many_topics(folder)]


def _many_topics(folder: Path) -> list[Row]:
    """Joint states of robots of one joint, each at 1 kHz, of which ever more are recorded."""
    rows = []
    with daemon() as instance, instance.client() as client:
        for number in range(max(TOPICS)):
            name = f"robot{number}"
            xml = f"<robot name='{name}'><link name='world'/>{hinge('joint')}</robot>"
            model = {"model_name": name, "model_xml": xml, "initial_pose": {"position": {"x": float(number)}}}
            assert client.call("/gazebo/spawn_urdf_model", model)["success"]
            client.params.set_all({f"/{name}/states": {"type": STATES, "publish_rate": 1000}})
            client.controllers(f"/{name}").bring_up(["states"])
        for count in TOPICS:
            topics = [f"/robot{number}/joint_states" for number in range(count)]
            factor, written, lost = _record(instance, topics, folder / f"many{count}.mcap")
            what, is_goal = f"{count} topics at 1 kHz recorded", count == max(TOPICS)
            note = f"{written / SECONDS:.0f} messages a second written"
            rows += [
                Row(f"{what}: lost", lost, "", 0.0 if is_goal else None, note=note),
                Row(f"{what}: real-time factor", factor, "", 0.99 if is_goal else None, "higher"),
            ]
    return rows


def _record(instance: Daemon, what: list[str], path: Path) -> tuple[float, int, int]:
    """The real-time factor while a recorder runs, and how many messages it has written and lost."""
    words = [SLIDECTL, "record", *what, "-O", str(path), "--json"]
    recorder = subprocess.Popen(
        words, env=instance.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert recorder.stderr is not None
    while "recording" not in recorder.stderr.readline():
        pass
    with instance.client() as client:
        began, before = time.perf_counter(), client.call("/rosapi/get_time")["time"]
        time.sleep(SECONDS)
        after, wall_s = client.call("/rosapi/get_time")["time"], time.perf_counter() - began
    recorder.send_signal(signal.SIGTERM)
    done = json.loads(recorder.communicate()[0])
    simulated_s = after["secs"] - before["secs"] + 1e-9 * (after["nsecs"] - before["nsecs"])
    return simulated_s / wall_s, done["messages"], done["dropped"]
