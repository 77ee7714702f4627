"""`slidectl sim save`, `load`, `snapshots`, `delete` and `fork` with real daemons."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from daemon_fixture import Runtime, running_daemon

CONTROLLERS = ("joint_state_controller", "joint1_position_controller", "joint2_position_controller")


@pytest.fixture
def runtime(tmp_path: Path) -> Iterator[Runtime]:
    """With a journal, which leads to the same state."""
    journal = str(tmp_path / "run.journal")
    with running_daemon(paused=True, rtf=math.inf, journal=journal) as daemon:
        yield daemon
        daemon.stop()
        assert "same" in CommandLine(daemon.folder).ok("replay", journal, "--check").splitlines()[0]


@pytest.fixture
def rrbot(runtime: Runtime) -> CommandLine:
    """A paused world with an RRBot on its way, and what goes wrong with it."""
    slidectl = CommandLine(runtime.folder)
    slidectl.ok("spawn", "rrbot", "--controllers", "config/rrbot_control.yaml", "--start", *CONTROLLERS)
    slidectl.ok("fault", "add", "joint1", "--kind", "sensor-noise", "--sd", "0.01", "--from", "0.1", "--to", "0.9")
    slidectl.ok("fault", "add", "joint2", "--kind", "joint-stuck", "--from", "0.1", "--to", "0.5")
    slidectl.ok("fault", "add", "joint1_position_controller/command", "--kind", "topic-delay", "--delay", "0.3")
    slidectl.ok("fault", "add", "joint1_position_controller", "--kind", "controller-raise", "--from", "0.8")
    slidectl.ok("pub", "joint1_position_controller/command", "1.0")
    slidectl.ok("sim", "step", "150")
    return slidectl


def future(slidectl: CommandLine, *daemon: str) -> str:
    """Where the robot is a second later, to the last digit, and what faults did."""
    slidectl.ok(*daemon, "sim", "step", "1s")
    return slidectl.ok(*daemon, "robots", "rrbot", "--json") + slidectl.ok(*daemon, "fault", "list", "--json")


def test_a_world_goes_on_from_a_snapshot_here_from_a_file_and_in_a_second_daemon(
    rrbot: CommandLine, tmp_path: Path
) -> None:
    file = str(tmp_path / "here.snapshot")
    assert rrbot.ok("sim", "save", "before", "--to", file) == f"before: saved at 0.150 s to {file}\n"
    then = future(rrbot)
    rrbot.ok("sim", "load", "before")
    assert future(rrbot) == then
    rrbot.ok("delete", "rrbot")
    assert json.loads(rrbot.ok("sim", "load", "before", "--json")) == {"time": 0.15}
    assert future(rrbot) == then
    try:
        forked = json.loads(rrbot.ok("sim", "fork", "before", "-i", "other", "--json"))
        assert (forked["instance"], forked["time"]) == ("other", 0.15)
        assert json.loads(rrbot.ok("-i", "other", "sim", "status", "--json"))["paused"]
        assert future(rrbot, "-i", "other") == then
        rrbot.ok("-i", "other", "sim", "load", "--from", file)
        assert future(rrbot, "-i", "other") == then
        again = rrbot("sim", "fork", "before", "-i", "other")
        assert again.returncode == 1
        assert "a daemon other runs already" in again.stderr
    finally:
        rrbot.ok("-i", "other", "daemon", "stop")


def test_snapshots_are_listed_and_forgotten_and_errors_say_what_there_is(rrbot: CommandLine, tmp_path: Path) -> None:
    rrbot.ok("sim", "save", "one")
    rrbot.ok("sim", "save", "two")
    rrbot.ok("sim", "save", "one")
    listed = [json.loads(line) for line in rrbot.ok("sim", "snapshots", "--json").splitlines()]
    assert [(one["name"], one["time"], one["robots"]) for one in listed] == [
        ("two", 0.15, ["rrbot"]),
        ("one", 0.15, ["rrbot"]),
    ]
    (tmp_path / "text").write_text("slidectl")
    for words, code, text in (
        (("delete", "one", "three"), 1, "no snapshot 'three'"),
        (("load", "three"), 1, "snapshots: one, two"),
        (("load",), 2, "give the name of a snapshot, or --from FILE"),
        (("save", "a/b"), 2, "is not a legal name of a snapshot"),
        (("save", "three", "--to", str(tmp_path / "no" / "folder")), 1, "cannot write the snapshot"),
        (("load", "--from", str(tmp_path / "text")), 2, "it is not a snapshot of slidectl"),
        (("fork", "three", "-i", "other"), 1, "no snapshot 'three'"),
    ):
        done = rrbot("sim", *words)
        assert done.returncode == code, done.stderr
        assert text in done.stderr
    rrbot.ok("sim", "delete", "one", "two")
    assert "no snapshots" in rrbot("sim", "snapshots").stderr
