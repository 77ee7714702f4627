"""Bags, read by `rostopic echo -b`, `rostopic list -b` and `rosmsg show -b` without any daemon."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from cli_ros_world import Shell
from command_line import CommandLine
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slidectl.extensions.ros_commands.arguments import Failure
from slidectl.extensions.ros_commands.rosbag import open_bag, schemas_of

START_NS = 1795220735364070652
STAMP_NS = 1795220735363786220
HEADER = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.name0,field.name1,field.position0,"
    "field.position1,field.velocity0,field.velocity1,field.effort0,field.effort1\n"
)
STATE = """header: 
  seq: 1
  stamp: 
    secs: 1795220735
    nsecs: 363786220
  frame_id: ''
name: 
  - slide
  - latch
position: [-0.25, 0.25]
velocity: [0.5, 0.0]
effort: [1.5, -2.0]
---
"""  # noqa: W291


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with run.bag: three joint states, three positions, and a type that nobody else knows."""
    folder = tmp_path_factory.mktemp("bags")
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("uint8[] raw\nbool on\ngeometry_msgs/Point[] points\n", "my_pkg/msg/Foo"))
    types = store.types
    state, header = types["sensor_msgs/msg/JointState"], types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"](STAMP_NS // 10**9, STAMP_NS % 10**9)
    with Writer(folder / "run.bag") as bag:
        states = bag.add_connection("/slide/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        positions = bag.add_connection("/slide/position", "std_msgs/msg/Float64", typestore=store)
        foos = bag.add_connection("/foo", "my_pkg/msg/Foo", typestore=store)
        for index in range(3):
            time = START_NS + index * 20_000_000
            message = state(header(index + 1, stamp, ""), ["slide", "latch"], np.array([-0.25, 0.25]),
                            np.array([0.5, 0.0]), np.array([1.5, -2.0]))  # fmt: skip
            bag.write(states, time, store.serialize_ros1(message, "sensor_msgs/msg/JointState"))
            number = types["std_msgs/msg/Float64"](index / 2)
            bag.write(positions, time, store.serialize_ros1(number, "std_msgs/msg/Float64"))
        foo = types["my_pkg/msg/Foo"](np.array([0, 255], np.uint8), True, [types["geometry_msgs/msg/Point"](1, 2, 3)])
        bag.write(foos, START_NS + 10**9, store.serialize_ros1(foo, "my_pkg/msg/Foo"))
        times = bag.add_connection("/late", "std_msgs/msg/Time", typestore=store)
        late = types["std_msgs/msg/Time"](types["builtin_interfaces/msg/Time"](-1, 0))
        bag.write(times, START_NS + 10**9, store.serialize_ros1(late, "std_msgs/msg/Time"))
    (folder / "no.bag").write_text("no bag at all\n")
    (folder / "binary.bag").write_bytes(bytes(range(255, 0, -1)) * 10)
    for compression in Writer.CompressionFormat:
        writer = Writer(folder / f"{compression.name}.bag")
        writer.set_compression(compression)
        with writer as bag:
            texts = bag.add_connection("/text", "std_msgs/msg/String", typestore=store)
            text = types["std_msgs/msg/String"]("packed" * 10)
            bag.write(texts, START_NS, store.serialize_ros1(text, "std_msgs/msg/String"))
    (folder / "cut.bag").write_bytes((folder / "run.bag").read_bytes()[:900])
    return folder


@pytest.fixture
def shell(tmp_path: Path) -> Shell:
    return Shell(CommandLine(tmp_path))


def typed(shell: Shell, folder: Path, line: str) -> str:
    done = shell.run(line, cwd=folder, TZ="UTC")
    assert (done.stderr, done.returncode) == ("", 0)
    return done.stdout


def test_the_topics_of_a_bag(shell: Shell, folder: Path) -> None:
    assert typed(shell, folder, "rostopic list -b run.bag") == "/slide/joint_states\n/slide/position\n/foo\n/late\n"
    assert typed(shell, folder, "rostopic list -b run.bag /slide/position") == (
        "3 message(s) from 21 Nov 2026 00:25:35 to 21 Nov 2026 00:25:35\n"
    )


def test_messages_of_a_bag_are_printed_as_live_ones_are(shell: Shell, folder: Path) -> None:
    assert typed(shell, folder, "rostopic echo -b run.bag -n 1 /slide/joint_states") == STATE
    assert (
        typed(shell, folder, "rostopic echo -b run.bag /slide/position")
        == "data: 0.0\n---\ndata: 0.5\n---\ndata: 1.0\n---\n"
    )
    assert typed(shell, folder, "rostopic echo -b run.bag -n 2 -a") == STATE + "data: 0.0\n---\n"
    assert typed(shell, folder, "rostopic echo -b run.bag -n 1 '/slide/joint_states/position[0]'") == "-0.25\n---\n"
    assert (
        typed(shell, folder, "rostopic echo -b run.bag --filter 'm.data > 0.7' /slide/position") == "data: 1.0\n---\n"
    )


def test_the_time_of_a_csv_line_is_when_the_message_was_recorded(shell: Shell, folder: Path) -> None:
    assert typed(shell, folder, "rostopic echo -b run.bag -n 1 -p /slide/joint_states") == (
        f"{HEADER}{START_NS},1,{STAMP_NS},,slide,latch,-0.25,0.25,0.5,0.0,1.5,-2.0\n"
    )


def test_a_field_of_a_bag_is_printed_in_full_when_it_was_chosen(shell: Shell, folder: Path) -> None:
    line = "rostopic echo -b run.bag -n 1 --noarr --nostr /slide/joint_states"
    assert '\nposition: "<array type: float64, length: 2>"\n' in typed(shell, folder, line)
    assert typed(shell, folder, f"{line}/position") == "[-0.25, 0.25]\n---\n"
    assert typed(shell, folder, f"{line}/name") == "\n- slide\n- latch\n---\n"


def test_times_go_on_until_2106(shell: Shell, folder: Path) -> None:
    assert typed(shell, folder, "rostopic echo -b run.bag /late") == (
        "data: \n  secs: 4294967295\n  nsecs:         0\n---\n"
    )


def test_the_bag_brings_its_types_along(shell: Shell, folder: Path) -> None:
    assert typed(shell, folder, "rostopic echo -b run.bag /foo") == (
        "raw: [0, 255]\non: True\npoints: \n  - \n    x: 1.0\n    y: 2.0\n    z: 3.0\n---\n"
    )
    assert typed(shell, folder, "rosmsg show -b run.bag my_pkg/Foo") == (
        "uint8[] raw\nbool on\ngeometry_msgs/Point[] points\n  float64 x\n  float64 y\n  float64 z\n\n"
    )


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_compressed_bags_are_read_too(shell: Shell, folder: Path, compression: str) -> None:
    text = typed(shell, folder, f"rostopic echo -b {compression}.bag /text")
    assert text == f'data: "{"packed" * 10}"\n---\n'


BROKEN = [
    ("rostopic echo -b nofile.bag /t", "ERROR: bag file [nofile.bag] does not exist\n"),
    ("rostopic echo -b no.bag /t", "ERROR: unable to use bag file: This does not appear to be a bag file\n"),
    (
        "rostopic echo -b binary.bag -a",
        "ERROR: unable to use bag file: This does not appear to be a bag file\n",
    ),
    ("rostopic echo -b . -a", "ERROR: unable to use bag file: is a folder, and only regular files are read\n"),
    ("rosmsg show -b no.bag a/B", "ERROR: unable to use bag file: This does not appear to be a bag file\n"),
    ("rostopic list -b no.bag", "ERROR: unable to use bag file: This does not appear to be a bag file\n"),
    (
        "rostopic echo -b run.bag /nope",
        "ERROR: no topic [/nope] in run.bag; topics: /slide/joint_states, /slide/position, /foo, /late\n",
    ),
]


@pytest.mark.parametrize(("line", "text"), BROKEN, ids=[line for line, _ in BROKEN])
def test_what_cannot_be_read_is_one_error(shell: Shell, folder: Path, line: str, text: str) -> None:
    done = shell.run(line, cwd=folder)
    assert (done.stdout, done.stderr, done.returncode) == ("", text, 1)


def test_a_bag_that_is_cut_off_is_no_fault_of_ours(shell: Shell, folder: Path) -> None:
    for size in (20, 500, 900, 2000, 4000):
        (folder / "cut.bag").write_bytes((folder / "run.bag").read_bytes()[:size])
        done = shell.run("rostopic echo -b cut.bag -a", cwd=folder)
        assert done.returncode == 1
        assert done.stderr.startswith("ERROR: unable to use bag file: ")
        assert len(done.stderr.splitlines()) == 1


def test_a_bag_whose_types_cannot_be_read_is_named(shell: Shell, folder: Path) -> None:
    whole = (folder / "run.bag").read_bytes()
    assert b"float64 data" in whole
    (folder / "types.bag").write_bytes(whole.replace(b"float64 data", b"\0loat64 data"))
    done = shell.run("rostopic echo -b types.bag -a", cwd=folder)
    assert (done.returncode, "the definition of std_msgs/Float64 cannot be read" in done.stderr) == (1, True)


@pytest.mark.parametrize("name", ["run", "BZ2", "LZ4"])
@given(data=st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_bag_is_read_or_refused(folder: Path, tmp_path: Path, name: str, data: st.DataObject) -> None:
    whole = bytearray((folder / f"{name}.bag").read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "damaged.bag").write_bytes(whole)
    with suppress(Failure), open_bag(str(tmp_path / "damaged.bag")) as recording:
        known = schemas_of(recording)
        for record in recording.records(set(known)):
            assert record.channel.topic in known
            assert isinstance(recording.message(record), dict)
