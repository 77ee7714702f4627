"""Frames, transforms between them, and `slidectl tf` at a real daemon."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Iterator
from typing import Any

import pytest
from cli_graph_world import World, slider_world
from command_line import CommandLine
from daemon_fixture import running_daemon
from hypothesis import given
from hypothesis import strategies as st

from slidectl.errors import AmbiguousName, Refused, UnknownName
from slidectl.rotations import Quaternion, multiply, normalized, relative
from slidectl.transform_tree import FramePose, Frames, roll_pitch_yaw

TURN = (0.0, 0.0, math.sin(math.pi / 12), math.cos(math.pi / 12))


def stamped(parent: str, child: str, xyz: tuple[float, float, float], q: Quaternion, secs: int = 0) -> dict[str, Any]:
    return {
        "header": {"seq": 0, "stamp": {"secs": secs, "nsecs": 0}, "frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", xyz, strict=True)),
            "rotation": dict(zip("xyzw", q, strict=True)),
        },
    }


@pytest.fixture
def frames() -> Frames:
    made = Frames()
    made.add({"transforms": [stamped("world", "base", (0, 0, 0.1), (0, 0, 0, 1))]}, is_static=True)
    made.add({"transforms": [stamped("base", "slider", (0.25, 0, 0), TURN, 7)]}, is_static=False)
    made.add({"transforms": [stamped("/elsewhere", "/alone", (1, 0, 0), (0, 0, 0, 0))]}, is_static=True)
    return made


def test_a_pose_is_that_of_the_second_frame_in_the_first(frames: Frames) -> None:
    view = frames.transform("world", "slider")
    assert view.pose.translation == pytest.approx((0.25, 0.0, 0.1))
    assert view.pose.rotation == pytest.approx(TURN)
    assert view.time_ns == 7 * 10**9


def test_static_ways_have_no_time_and_a_frame_is_at_itself(frames: Frames) -> None:
    assert frames.transform("world", "base").time_ns is None
    assert frames.transform("slider", "slider").pose == FramePose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_frames_of_two_trees_are_not_connected(frames: Frames) -> None:
    with pytest.raises(Refused, match="world and alone are not connected"):
        frames.transform("world", "alone")


def test_an_unknown_frame_lists_the_known_ones(frames: Frames) -> None:
    with pytest.raises(UnknownName, match="frames: alone, base, elsewhere, slider, world"):
        frames.transform("world", "nope")


def test_the_end_of_a_frames_name_is_enough_when_it_is_the_only_one(frames: Frames) -> None:
    for robot in ("left", "right"):
        frames.add({"transforms": [stamped("world", f"{robot}/base", (0, 0, 0), TURN)]}, is_static=True)
    frames.add({"transforms": [stamped("left/base", "left/tip", (0, 0, 0), TURN)]}, is_static=True)
    assert (frames.find("base"), frames.find("tip"), frames.find("left/base")) == ("base", "left/tip", "left/base")
    assert (frames.find("tip", "/left"), frames.find("/base"), frames.find("base", "/left")) == (
        "left/tip",
        "base",
        "left/base",
    )
    del frames.edges["base"], frames.edges["slider"]
    assert frames.find("base", "/right") == "right/base"
    with pytest.raises(AmbiguousName, match="left/base, right/base"):
        frames.find("base")
    with pytest.raises(UnknownName, match="Did you mean 'left/tip'"):
        frames.find("top")


def test_a_ring_of_frames_ends(frames: Frames) -> None:
    frames.add({"transforms": [stamped("slider", "world", (0, 0, 0), (0, 0, 0, 1))]}, is_static=True)
    assert not frames.are_connected("world", "alone")


numbers = st.floats(-10, 10, allow_subnormal=False)
poses = st.builds(
    lambda t, q: FramePose(t, normalized(q)),
    st.tuples(numbers, numbers, numbers),
    st.tuples(numbers, numbers, numbers, numbers),
)


@given(poses)
def test_a_pose_in_its_own_frame_is_the_origin(pose: FramePose) -> None:
    translation, (x, y, z, w) = relative(pose, pose)
    assert translation == pytest.approx((0, 0, 0), abs=1e-9)
    assert (x, y, z, abs(w)) == pytest.approx((0, 0, 0, 1), abs=1e-9)


@given(poses)
def test_angles_make_the_same_rotation_again(pose: FramePose) -> None:
    roll, pitch, yaw = (angle / 2 for angle in roll_pitch_yaw(pose.rotation))
    about = [(1, 0, 0, roll), (0, 1, 0, pitch), (0, 0, 1, yaw)]
    turns = [(x * math.sin(h), y * math.sin(h), z * math.sin(h), math.cos(h)) for x, y, z, h in about]
    again = multiply(multiply(turns[2], turns[1]), turns[0])
    assert abs(sum(a * b for a, b in zip(again, pose.rotation, strict=True))) == pytest.approx(1.0, abs=1e-9)


# --- the commands ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with slider_world() as made:
        yield made


def test_echo_prints_the_block_of_tf_echo_once(world: World) -> None:
    lines = world.slidectl.ok("tf", "echo", "world", "base_link").splitlines()
    assert lines[0].startswith("At time ")
    assert lines[1].startswith("- Translation: [0.000, 0.000, ")
    assert lines[2:] == [
        "- Rotation: in Quaternion [0.000, 0.000, 0.000, 1.000]",
        "            in RPY (radian) [0.000, -0.000, 0.000]",
        "            in RPY (degree) [0.000, -0.000, 0.000]",
    ]


def test_echo_follows_the_joint(world: World) -> None:
    record = json.loads(world.slidectl.ok("tf", "echo", "base_link", "link2", "--json"))
    assert set(record) == {"reference", "target", "time", "translation", "rotation", "rpy"}
    assert (record["reference"], record["target"]) == ("base_link", "link2")
    assert record["time"] > 0
    back = json.loads(world.slidectl.ok("tf", "echo", "/link2", "/base_link", "--json"))
    assert back["translation"][:2] == pytest.approx([-x for x in record["translation"][:2]])


def test_echo_follow_goes_on_until_ctrl_c(world: World) -> None:
    with world.running("tf", "echo", "base_link", "link2", "--follow", "--rate", "50", "--json") as process:
        assert process.stdout is not None
        assert all(process.stdout.readline().startswith("{") for _ in range(3))
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert process.returncode == 130


def test_list_and_tree_show_the_frames(world: World) -> None:
    assert world.slidectl.ok("tf", "list") == "base_link\nlink2\nworld\n"
    assert world.slidectl.ok("tf", "tree") == "world\n  base_link (static)\n    link2 (moving)\n"
    rows = {row["frame"]: row for row in map(json.loads, world.slidectl.ok("tf", "list", "--json").splitlines())}
    assert (rows["world"]["parent"], rows["base_link"]["parent"], rows["link2"]["parent"]) == (
        None,
        "world",
        "base_link",
    )
    assert (rows["base_link"]["static"], rows["link2"]["static"]) == (True, False)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["echo", "world", "nope"], 1, "no frame 'nope'.\nframes: base_link, link2, world"),
        (["echo", "wrld", "link2"], 1, "Did you mean 'world'?"),
        (["echo", "world"], 2, "Missing argument"),
        (["echo", "world", "link2", "--rate", "0"], 2, "0 is not above 0"),
        (["echo", "world", "link2", "-n", "0"], 2, "0 is not in the range"),
    ],
)
def test_errors_say_what_is_wrong(world: World, words: list[str], code: int, said: str) -> None:
    done = world.slidectl("tf", *words)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert said in done.stderr


@pytest.fixture(scope="module")
def still() -> Iterator[CommandLine]:
    """A world that has never run, with a slider that was spawned in it."""
    with running_daemon(paused=True) as daemon:
        line = CommandLine(daemon.folder)
        line.ok("spawn", "slider")
        yield line


def test_a_world_that_stands_still_tells_its_frames_right_after_a_spawn(still: CommandLine) -> None:
    assert still.ok("tf", "tree") == "world\n  base_link (static)\n    link2 (moving)\n"
    assert still.ok("tf", "list") == "base_link\nlink2\nworld\n"
    shown = json.loads(still.ok("tf", "echo", "base_link", "link2", "--json"))
    assert shown["time"] == 0.0


def test_a_world_that_came_to_a_stand_tells_where_its_frames_are_now(still: CommandLine) -> None:
    still.ok("sim", "step", "100")
    shown = json.loads(still.ok("tf", "echo", "base_link", "link2", "--json"))
    assert shown["time"] == 0.1
    position = json.loads(still.ok("robots", "slider", "--json"))["joints"][1]["position"]
    before = json.loads(still.ok("tf", "echo", "base_link", "link2", "--json"))["translation"]
    still.ok(
        "service",
        "call",
        "/gazebo/set_model_configuration",
        "{model_name: slider, joint_names: [joint1], joint_positions: [0.4]}",
    )
    after = json.loads(still.ok("tf", "echo", "base_link", "link2", "--json"))["translation"]
    assert sum(after) - sum(before) == pytest.approx(0.4 - position, abs=1e-6)


def test_the_ros_words_find_the_frames_of_a_world_that_stands_still(still: CommandLine) -> None:
    done = still("ros", "rosrun", "tf2_tools", "echo.py", "-l", "1", "world", "link2")
    assert done.returncode == 0, done.stderr
    assert "Translation" in done.stdout


def test_who_listens_already_gets_the_frames_of_a_robot_spawned_in_a_still_world(still: CommandLine) -> None:
    with still.client() as client, client.subscribe("/tf", "tf2_msgs/TFMessage") as heard:
        assert heard.get()["transforms"][0]["child_frame_id"] == "link2"
        still.ok("spawn", "rrbot")
        assert heard.get()["transforms"][0]["header"]["frame_id"] == "rrbot/link1"
        still.ok("delete", "rrbot")


def test_frames_that_are_not_there_are_named_at_once_in_a_still_world(still: CommandLine) -> None:
    done = still("tf", "echo", "world", "link9")
    assert done.returncode == 1
    assert "no frame 'link9'" in done.stderr


def test_static_frames_alone_are_complete_at_once() -> None:
    with running_daemon(paused=True) as daemon, daemon.client() as client:
        world = World(daemon, client)
        world.latch("/tf_static", "tf2_msgs/TFMessage", {"transforms": [stamped("a", "b", (1.0, 0.0, 0.0), TURN)]})
        assert json.loads(world.slidectl.ok("tf", "echo", "a", "b", "--json"))["time"] is None
        assert world.slidectl.ok("tf", "tree") == "a\n  b (static)\n"
