"""`slidectl echo` at a real daemon: forms, fields, filters, ends, and what goes wrong."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator

import pytest
from cli_graph_world import COMMAND, World, slider_world
from command_line import CommandLine
from daemon_fixture import running_daemon
from waiting import eventually

POSES = {
    "header": {"seq": 0, "stamp": {"secs": 1795219421, "nsecs": 932599067}, "frame_id": "base"},
    "poses": [
        {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
        {"position": {"x": 4.0, "y": 5.0, "z": 6.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
    ],
}


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with slider_world() as made:
        made.latch("/shown/text", "std_msgs/String", {"data": 'ok: "moving"'})
        made.latch("/shown/poses", "geometry_msgs/PoseArray", POSES)
        made.latch("/shown/raw", "std_msgs/UInt8MultiArray", {"data": "AEH/"})
        made.latch("/shown/number", "std_msgs/Float64", {"data": 1.25})
        made.latch("/shown/nothing", "std_msgs/Float64", {"data": None})
        yield made


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        (["shown/text"], 'data: "ok: \\"moving\\""\n---\n'),
        (["shown/number"], "data: 1.25\n---\n"),
        (["/shown/nothing"], "data: nan\n---\n"),
        (["poses/poses[:]/position/x"], "[1.0, 4.0]\n---\n"),
        (["shown/text", "--nostr"], 'data: "<string length: 12>"\n---\n'),
        (["shown/number", "-w", "6"], "data: 1.2500\n---\n"),
        (["shown/number", "-c"], "\033[2J\033[;Hdata: 1.25\n---\n"),
        (["shown/poses/poses[:]/position/x", "-p"], "%time,field0,field1\n1795219421932599067,1.0,4.0\n"),
        (["shown/poses/header", "--json"], json.dumps({**POSES["header"], "seq": 1}) + "\n"),
        (["shown/nothing", "--json"], '{"data": null}\n'),
        (["shown/text", "--json", "--nostr"], "{}\n"),
    ],
)
def test_a_latched_message_prints_in_the_form_that_was_asked_for(world: World, words: list[str], printed: str) -> None:
    assert world.slidectl.ok("echo", *words, "-n", "1") == printed


def test_the_topic_is_found_by_the_end_of_its_name_and_printed_as_yaml(world: World) -> None:
    text = world.slidectl.ok("echo", "joint_states", "-n", "1")
    assert text.startswith("header: \n  seq: ")
    assert "name: \n  - joint1\nposition: [" in text
    assert text.endswith("]\n---\n")


def test_a_namespace_makes_the_short_name_exact(world: World) -> None:
    assert world.slidectl.ok("--ns", "/slider", "echo", "joint_states/name[0]", "-n", "1") == '"joint1"\n---\n'


def test_csv_has_one_header_line_and_the_stamp_as_its_time(world: World) -> None:
    header, *rows = world.slidectl.ok("echo", "joint_states", "-p", "-n", "3").splitlines()
    assert header == (
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.name0,field.position0,"
        "field.velocity0,field.effort0"
    )
    assert len(rows) == 3
    assert all(row.split(",")[0] == row.split(",")[2] and row.split(",")[4] == "joint1" for row in rows)


def test_csv_of_a_message_without_header_has_the_simulated_time(world: World) -> None:
    _, row = world.slidectl.ok("echo", "/clock", "-p", "-n", "1").splitlines()
    time, clock = row.split(",")
    assert time == clock


def test_for_ends_after_simulated_seconds(world: World) -> None:
    rows = world.slidectl.ok("echo", "joint_states/header/stamp", "--for", "0.2", "--json").splitlines()
    assert 9 <= len(rows) <= 11


def test_a_filter_lets_only_matching_messages_through(world: World) -> None:
    lines = world.slidectl.ok(
        "echo", "joint_states/header/seq", "--filter", "m.header.seq % 2 == 0", "-n", "3", "--json"
    )
    assert all(int(line) % 2 == 0 for line in lines.splitlines())


def test_offset_prints_times_relative_to_now(world: World) -> None:
    world.latch("/shown/late", "std_msgs/Header", {"stamp": {"secs": 0, "nsecs": 0}})
    assert "secs: -" in world.slidectl.ok("echo", "/shown/late/stamp", "--offset", "-n", "1")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["joint_sates"], 1, "Did you mean '/slider/joint_states'?"),
        (["command"], 1, "nobody publishes " + COMMAND),
        (["joint_states/positon"], 1, "Did you mean 'position'?\nfields: effort, header, name, position, velocity"),
        (["joint_states/position[7]"], 1, "index out of range: position[7], but the message has 1 there"),
        (["joint_states/position[x]"], 2, "an index is a number or a slice"),
        (["joint_states", "--filter", "m.data =="], 2, "not a valid expression"),
        (["joint_states", "--filter", "m.nofield > 0"], 2, "no field 'nofield'"),
        (["joint_states", "--filter", "m.position[3] > 0"], 1, "cannot compute"),
        (["joint_states", "-n", "x"], 2, "'x' is not a valid integer"),
        (["joint_states", "-p", "--json"], 2, "-p and -o json exclude each other"),
    ],
)
def test_what_cannot_be_echoed_is_said_once_and_at_once(world: World, words: list[str], code: int, said: str) -> None:
    done = world.slidectl("echo", *words, "--timeout", "20")
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert done.stderr.startswith(("error: ", '{"error": '))
    assert len(done.stderr.splitlines()) <= 3


def test_silence_for_longer_than_the_timeout_is_exit_code_4(world: World) -> None:
    done = world.slidectl("echo", "shown/number", "--timeout", "0.3")
    assert (done.returncode, done.stdout) == (4, "data: 1.25\n---\n")
    assert "no message came for 0.3 s" in done.stderr


@pytest.mark.parametrize("words", [("echo", "joint_states/name[0]"), ("hz", "joint_states")])
def test_a_world_that_is_paused_meanwhile_is_named_once(words: tuple[str, ...]) -> None:
    with slider_world() as world, world.running(*words) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        world.slidectl.ok("sim", "pause")
        said = next(line for line in process.stderr if "subscribed" not in line)
        assert said == (
            "the simulation is paused; nothing comes until it goes on: slidectl sim resume, or slidectl sim step\n"
        )


def test_every_message_is_flushed_and_ctrl_c_is_exit_code_130(world: World) -> None:
    with world.running("echo", "joint_states/position[0]") as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip().replace(".", "").lstrip("-")[0].isdigit()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (130, "")


def test_a_closed_pipe_ends_quietly(world: World) -> None:
    words = " ".join(world.slidectl.argv("echo", "joint_states/name"))
    done = subprocess.run(
        ["bash", "-c", f"{words} | head -n 2; echo ${{PIPESTATUS[0]}}"],
        env=world.slidectl.environment, capture_output=True, text=True, timeout=30, check=True,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("\n- joint1\n0\n", "")


def test_a_name_that_fits_two_robots_is_exit_code_2_and_lists_both() -> None:
    with slider_world() as world:
        world.spawn("other")
        done = world.slidectl("echo", "joint_states/position[0]", "-n", "1")
        assert done.returncode == 2
        assert "/other/joint_states, /slider/joint_states" in done.stderr
        assert "--ns" in done.stderr
        assert world.slidectl.ok("echo", "other/joint_states/name[0]", "-n", "1") == '"joint1"\n---\n'


def test_when_the_daemon_dies_what_came_before_is_printed_and_the_exit_code_is_3() -> None:
    with slider_world() as world:
        with world.running("echo", "joint_states/position[0]", "--json") as process:
            assert process.stdout is not None
            first = process.stdout.readline()
            assert world.daemon.pid is not None
            os.kill(world.daemon.pid, signal.SIGKILL)
            rest, errors = process.communicate(timeout=20)
        assert process.returncode == 3
        assert all(isinstance(json.loads(line), float) for line in (first + rest).splitlines())
        assert "the daemon went away" in errors


def test_messages_that_came_too_fast_are_counted_on_stderr() -> None:
    cycles = 60_000
    with running_daemon(paused=True) as daemon, daemon.client(timeout=60) as client:
        world = World(daemon, client)
        with world.running("echo", "/clock", "--for", str(cycles / 1000), "--json") as process:
            eventually(lambda: world.has_subscriber("/clock"))
            client.call("/slidectl/step", {"cycles": 1})
            assert process.stdout is not None
            first = process.stdout.readline()
            client.call("/slidectl/step", {"cycles": cycles + 10})
            rest, errors = process.communicate(timeout=60)
        received = len((first + rest).splitlines())
        dropped = re.search(r"warning: (\d+) messages were dropped", errors)
        assert process.returncode == 0
        assert dropped is not None, errors
        assert abs(received + int(dropped[1]) - cycles) <= 20


@pytest.mark.parametrize(
    "words",
    [
        ("echo", "/later/number/data", "--wait", "-n", "3"),
        ("--ns", "/later", "echo", "number/data", "--wait", "-n", "3"),
        ("ros", "rostopic", "echo", "-n", "3", "/later/number/data"),
    ],
    ids=" ".join,
)
def test_a_topic_that_comes_later_is_waited_for_and_no_message_is_missed(words: tuple[str, ...]) -> None:
    with running_daemon(paused=True) as runtime:
        line = CommandLine(runtime.folder)
        waiting = line.start(*words)
        assert waiting.stderr is not None
        assert "number/data" in waiting.stderr.readline()
        with runtime.client() as client:
            eventually(lambda: client.call("/rosapi/subscribers", {"topic": "/later/number"})["subscribers"], "no wait")
            for number in (1.0, 2.0, 3.0):
                client.publish("/later/number", {"data": number}, type="std_msgs/Float64")
        assert waiting.communicate(timeout=60)[0] == "1.0\n---\n2.0\n---\n3.0\n---\n"
        assert waiting.returncode == 0


def test_pub_with_a_type_reaches_who_waits_for_the_topic() -> None:
    with running_daemon(paused=True) as runtime:
        line = CommandLine(runtime.folder)
        waiting = line.start("echo", "/later", "--wait", "-n", "1", "--json")
        line.until_subscribed("/later")
        line.ok("pub", "/later", "std_msgs/Float64", "1.5")
        assert waiting.communicate(timeout=60)[0] == '{"data": 1.5}\n'


def test_a_wait_for_a_topic_ends_with_the_timeout() -> None:
    with running_daemon(paused=True) as runtime:
        done = CommandLine(runtime.folder)("--timeout", "0.2", "echo", "/never", "--wait")
        assert done.returncode == 4
        assert "nobody published /never within 0.2 s" in done.stderr
