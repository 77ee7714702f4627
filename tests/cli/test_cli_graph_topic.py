"""`slidectl topic` at a real daemon: list, info, type, find, hz, bw, delay."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_graph_world import COMMAND, JOINT_STATES, World, slider_world
from command_line import CommandLine
from daemon_fixture import running_daemon


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with slider_world() as made:
        made.latch("/once", "std_msgs/Float64", {"data": 1.0})
        yield made


def test_list_prints_sorted_names(world: World) -> None:
    names = world.slidectl.ok("topic", "list").splitlines()
    assert names == sorted(names)
    assert {"/clock", "/rosout", COMMAND, JOINT_STATES} <= set(names)


def test_list_of_a_namespace_takes_whole_components_only(world: World) -> None:
    assert world.slidectl.ok("topic", "list", "/slider/joint_states") == f"{JOINT_STATES}\n"
    assert JOINT_STATES in world.slidectl.ok("topic", "list", "slider").splitlines()
    assert world.slidectl.ok("topic", "list", "/slid") == ""


def test_list_can_be_narrowed_to_one_side(world: World) -> None:
    assert world.slidectl.ok("topic", "list", "-s", "/slider").splitlines() == [COMMAND]
    published = world.slidectl.ok("topic", "list", "-p", "/slider").splitlines()
    assert JOINT_STATES in published
    assert COMMAND not in published


def test_list_v_has_the_two_sections_of_rostopic(world: World) -> None:
    assert world.slidectl.ok("topic", "list", "-v", COMMAND) == (
        f"\nPublished topics:\n\nSubscribed topics:\n * {COMMAND} [std_msgs/Float64] 1 subscriber\n\n"
    )
    assert world.slidectl.ok("topic", "list", "-v", "-p", JOINT_STATES) == (
        f"\nPublished topics:\n * {JOINT_STATES} [sensor_msgs/JointState] 1 publisher\n\n"
    )


def test_info_prints_the_block_of_rostopic(world: World) -> None:
    uri = f"unix://{world.daemon.paths.socket}"
    assert world.slidectl.ok("topic", "info", "joint_states") == (
        f"Type: sensor_msgs/JointState\n\nPublishers: \n * /gazebo ({uri})\n\nSubscribers: None\n\n\n"
    )
    record = json.loads(world.slidectl.ok("topic", "info", "command", "--json"))
    assert record == {"topic": COMMAND, "type": "std_msgs/Float64", "publishers": [], "subscribers": ["/gazebo"]}


@pytest.mark.parametrize(
    ("target", "printed"),
    [
        ("joint_states", "sensor_msgs/JointState"),
        ("command", "std_msgs/Float64"),
        ("joint_states/position", "sensor_msgs/JointState position float64[]"),
        ("joint_states/position[0]", "sensor_msgs/JointState position[0] float64"),
        ("joint_states/header/stamp", "sensor_msgs/JointState header/stamp time"),
    ],
)
def test_type_prints_the_type_of_a_topic_or_field(world: World, target: str, printed: str) -> None:
    assert world.slidectl.ok("topic", "type", target) == printed + "\n"


def test_find_lists_the_topics_of_a_type(world: World) -> None:
    assert world.slidectl.ok("topic", "find", "sensor_msgs/JointState") == f"{JOINT_STATES}\n"
    done = world.slidectl("topic", "find", "std_msgs/Nope")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "no topic has the type std_msgs/Nope\n")


def test_hz_measures_in_simulated_time(world: World) -> None:
    done = world.slidectl("topic", "hz", "joint_states", "--for", "0.5")
    assert done.returncode == 0
    assert done.stderr == f"subscribed to [{JOINT_STATES}]\n"
    rate, spread = done.stdout.splitlines()
    assert rate == "average rate: 50.000"
    assert spread.startswith("\tmin: 0.020000s max: 0.020000s std dev: 0.000000s window: 2")


def test_hz_of_a_message_without_header_takes_the_clock(world: World) -> None:
    record = json.loads(world.slidectl.ok("topic", "hz", "/gazebo/link_states", "--for", "0.2", "--json"))
    # On a machine that is busy a message of the clock may come late, or not.
    assert record["rate"] == pytest.approx(1000.0, rel=0.05)
    assert set(record) == {"topic", "rate", "min", "max", "std_dev", "p50", "p99", "window", "new"}


def test_hz_of_several_topics_is_a_table(world: World) -> None:
    header, first, second, *_ = world.slidectl.ok("topic", "hz", "joint_states", "/clock", "--for", "0.3").splitlines()
    assert header.split() == ["TOPIC", "RATE", "MIN", "MAX", "STD", "DEV", "WINDOW"]
    assert first.split()[:4] == [JOINT_STATES, "50", "0.02", "0.02"]
    assert second.split()[:4] == ["/clock", "1000", "0.001", "0.001"]


def test_hz_counts_only_what_the_filter_lets_through(world: World) -> None:
    words = ["topic", "hz", "joint_states", "--filter", "m.header.seq % 2 == 0", "--for", "0.5", "--json"]
    assert json.loads(world.slidectl.ok(*words))["rate"] == pytest.approx(25.0)


def test_hz_prints_reports_until_the_count_and_flushes_each(world: World) -> None:
    lines = world.slidectl.ok("topic", "hz", "joint_states", "-n", "2", "--wall-time", "-o", "csv").splitlines()
    assert lines[0] == "topic,rate,min,max,std_dev,p50,p99,window,new"
    assert [line.split(",")[0] for line in lines[1:]] == [JOINT_STATES, JOINT_STATES]


def test_hz_ends_on_ctrl_c_with_a_last_report_and_exit_code_130(world: World) -> None:
    with world.running("topic", "hz", "/clock", "--json") as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["rate"] == pytest.approx(1000.0, rel=0.5)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert process.returncode == 130


def test_hz_prints_a_last_report_when_the_daemon_dies_and_exits_3() -> None:
    with slider_world() as world:
        with world.running("topic", "hz", "/clock", "--json") as process:
            assert process.stdout is not None
            process.stdout.readline()
            assert world.daemon.pid is not None
            os.kill(world.daemon.pid, signal.SIGKILL)
            _, errors = process.communicate(timeout=20)
        assert process.returncode == 3
        assert "the daemon went away" in errors


def test_hz_judges_a_rate(world: World) -> None:
    world.slidectl.ok("topic", "hz", "joint_states", "--for", "0.3", "--min", "49", "--max", "51")
    done = world.slidectl("topic", "hz", "joint_states", "--for", "0.3", "--min", "60")
    assert done.returncode == 1
    assert f"{JOINT_STATES} comes at 50.000 Hz; expected at least 60" in done.stderr


def test_bw_counts_the_bytes_of_ros(world: World) -> None:
    record = json.loads(world.slidectl.ok("topic", "bw", "joint_states", "--for", "0.5", "--json"))
    assert (record["mean"], record["min"], record["max"]) == (66.0, 66, 66)
    assert record["rate"] == pytest.approx(66 * 50, rel=0.2)
    text = world.slidectl.ok("topic", "bw", "joint_states", "--for", "0.2")
    assert text.startswith("average: 3.")
    assert "\tmean: 66.00B min: 66.00B max: 66.00B window: " in text


def test_delay_is_measured_from_the_stamp(world: World) -> None:
    record = json.loads(world.slidectl.ok("topic", "delay", "joint_states", "--for", "0.3", "--json"))
    assert abs(record["delay"]) <= 0.001
    assert set(record) == {"topic", "delay", "min", "max", "std_dev", "p50", "p99", "window", "new"}


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["info", "nope"], 1, "no topic 'nope'"),
        (["type", "nope"], 1, "no topic 'nope'"),
        (["type", "joint_states/nope"], 1, "fields: effort, header, name, position, velocity"),
        (["hz", "nope", "--for", "1"], 1, "no topic 'nope'"),
        (["hz", "command", "--for", "1"], 1, "nobody publishes " + COMMAND),
        (["hz", "-w", "1", "joint_states"], 2, "1 is not in the range"),
        (["hz", "joint_states", "--filter", "x"], 2, "no name 'x'"),
        (["hz", "--for", "0", "joint_states"], 2, "0 is not above 0"),
        (["hz"], 2, "Missing argument"),
        (["bw", "nope"], 1, "no topic 'nope'"),
        (["delay", "/clock"], 1, "/clock has no header (rosgraph_msgs/Clock)"),
        (["list", "-p", "-s"], 2, "-p and -s exclude each other"),
        (["find"], 2, "Missing argument"),
        (["bogus"], 2, "no command 'bogus'"),
        (["hz", "/once", "--timeout", "0.3"], 4, "no message came for 0.3 s"),
    ],
)
def test_errors_say_what_is_wrong(world: World, words: list[str], code: int, said: str) -> None:
    done = world.slidectl("topic", *words)
    assert done.returncode == code, done.stderr
    assert said in done.stderr


def test_a_topic_that_says_nothing_while_it_is_measured_is_exit_code_1() -> None:
    with running_daemon() as daemon, daemon.client() as client:
        client.advertise("/silent", "std_msgs/Float64")
        client.flush()
        done = World(daemon, client).slidectl("topic", "hz", "/silent", "--for", "0.1")
    assert done.returncode == 1
    assert "no messages on /silent" in done.stderr


CAMERA = """<robot name="watcher"><link name="base"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <gazebo reference="base"><sensor type="camera" name="eye"><update_rate>1000</update_rate><camera>
  <image><width>320</width><height>240</height></image></camera>
  <plugin name="c" filename="libgazebo_ros_camera.so"/></sensor></gazebo></robot>"""


def test_hz_of_a_camera_that_drawing_does_not_keep_up_with_warns_once_with_the_rate_that_it_reports(
    tmp_path: Path,
) -> None:
    (tmp_path / "watcher.urdf").write_text(CAMERA)
    with running_daemon() as daemon:
        slidectl = CommandLine(daemon.folder)
        slidectl.ok("spawn", str(tmp_path / "watcher.urdf"))
        slidectl.ok("echo", "/watcher/image_raw/width", "-n", "1")  # the rate counts once what draws is there
        done = slidectl("hz", "/watcher/image_raw", "--for", "4", "--json")
    [warning] = [line for line in done.stderr.splitlines() if line.startswith("warning: /watcher/image_raw")]
    reached = re.fullmatch(r"warning: /watcher/image_raw: 1000 Hz asked, ([\d.]+) reached; .*", warning)
    assert reached is not None
    assert float(reached[1]) == pytest.approx(json.loads(done.stdout)["rate"], rel=0.01)
