"""Signals at every moment of a launch: it ends orderly, and neither a daemon nor a process is left."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from command_line import CommandLine
from launch_runs import Launched, eventually, kill_all, nothing_is_left, processes

MOMENTS_S = [0.0, 0.05, 0.08, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2, 0.23, 0.26, 0.3, 0.34, 0.38, 0.42, 0.46, 0.5, 0.6]


@pytest.fixture(autouse=True)
def clean(slidectl: CommandLine) -> Iterator[None]:
    yield
    kill_all(slidectl.runtime)


@pytest.fixture
def everything(tmp_path: Path) -> str:
    """The slider with programs before and after it."""
    package = tmp_path / "demo"
    (package / "scripts").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>demo</name></package>")
    script = package / "scripts" / "live"
    script.write_text("#!/bin/bash\nsleep 600 &\nwait\n")
    script.chmod(0o755)
    path = package / "all.launch"
    path.write_text(
        '<launch><node pkg="demo" type="live" name="first"/><include file="$(find my_slider)/launch/slider.launch"/>'
        '<node pkg="demo" type="live" name="last" respawn="true"/></launch>'
    )
    return str(path)


@pytest.mark.parametrize("moment_s", MOMENTS_S)
def test_an_interrupt_at_any_moment_leaves_nothing(slidectl: CommandLine, everything: str, moment_s: float) -> None:
    launched = Launched(slidectl, everything)
    with suppress(subprocess.TimeoutExpired):
        launched.process.wait(moment_s)
    code = launched.interrupt()
    if not _came_too_early(launched):
        assert code == 130, launched.text
        assert "Traceback" not in launched.text
    nothing_is_left(slidectl.runtime)


def _came_too_early(launched: Launched) -> bool:
    """Whether the interrupt came while Python itself was starting, before the first function of ours."""
    is_pythons_own = "KeyboardInterrupt" in launched.text and "in entry" not in launched.text
    return launched.process.returncode == -signal.SIGINT or (launched.process.returncode == 1 and is_pythons_own)


@pytest.mark.parametrize("moment_s", MOMENTS_S[3::4])
def test_interrupts_in_a_row_leave_nothing(slidectl: CommandLine, everything: str, moment_s: float) -> None:
    launched = Launched(slidectl, everything)
    with suppress(subprocess.TimeoutExpired):
        launched.process.wait(moment_s)
    for _ in range(5):
        launched.signal()
        with suppress(subprocess.TimeoutExpired):
            launched.process.wait(0.002)
    assert launched.end() == 130 or _came_too_early(launched)
    nothing_is_left(slidectl.runtime)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_polite_end_of_what_runs_is_a_success(slidectl: CommandLine, everything: str, number: int) -> None:
    launched = Launched(slidectl, everything)
    launched.up()
    assert launched.end(number) == 0
    assert "joint1_position_controller, joint_state_controller stopped and unloaded" in launched.text
    nothing_is_left(slidectl.runtime)


def test_nohup_outlives_its_terminal(slidectl: CommandLine, everything: str) -> None:
    previous = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # what nohup does, and programs inherit
    try:
        launched = Launched(slidectl, everything)
    finally:
        signal.signal(signal.SIGHUP, previous)
    launched.up()
    launched.signal(signal.SIGHUP)
    assert "running" in slidectl.ok("controller", "list")
    assert launched.process.poll() is None
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_an_end_before_everything_runs_is_none(slidectl: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "w.launch"
    path.write_text('<launch><node pkg="controller_manager" type="spawner" name="s" args="a"/></launch>')
    launched = Launched(slidectl, str(path))
    launched.until("/s: waits for /controller_manager")
    assert launched.end(signal.SIGTERM) == 1
    assert "ended by SIGTERM before everything ran" in launched.text
    nothing_is_left(slidectl.runtime)


def test_an_interrupt_while_a_command_runs_ends_the_command(slidectl: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "c.launch"
    command = "bash -c 'echo started &gt;&amp;2; sleep 600'"
    path.write_text(f'<launch><param name="x" command="{command}"/></launch>')
    launched = Launched(slidectl, str(path))
    launched.until("started")
    assert launched.interrupt() == 130
    eventually(lambda: not processes(slidectl.runtime), "the command or the daemon is still there")


def test_a_reader_that_goes_away_ends_the_launch_quietly(slidectl: CommandLine) -> None:
    read, write = os.pipe()
    process = subprocess.Popen(
        slidectl.argv("launch", "slider"), stdin=subprocess.DEVNULL, stdout=write, stderr=subprocess.PIPE,
        env=slidectl.environment,
    )  # fmt: skip
    os.close(write)
    os.read(read, 10)
    os.close(read)
    _, errors = process.communicate(timeout=60)
    assert b"Traceback" not in errors
    assert process.returncode == 0
    nothing_is_left(slidectl.runtime)
