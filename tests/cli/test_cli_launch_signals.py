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
from inherited_signals import inherited
from launch_runs import RUNS, Launched, kill_all, nothing_is_left, processes, write_everything
from waiting import eventually

# A moment is so many calls of functions of slidectl. The launch below makes about 12 000 of them until everything runs;
# it sets itself up from the 3040th on, and begins the daemon soon after.
MOMENTS = [1, 2, 40, 400, 2000, *range(3040, 3120, 20), 3500, 5000, 7000, 9000, 11000, 12000]
INTERRUPTING = """
import os, signal, sys
left = int(os.environ.pop("INTERRUPT_AFTER", 0))
is_begun, process = False, os.getpid()
def count(frame, event, _):
    global is_begun, left
    if event == "call" and "/slidectl/" in frame.f_code.co_filename and os.getpid() == process:
        left -= is_begun
        is_begun = is_begun or frame.f_code.co_name == "entry"
        if left == 0:
            sys.setprofile(None)
            os.write(1, b"now\\n")
            os.kill(os.getpid(), signal.SIGINT)
if left:
    sys.setprofile(count)
"""
"""What Python does at its start: it prepares an interrupt after so many calls, in this process alone."""


@pytest.fixture(autouse=True)
def clean(slidectl: CommandLine) -> Iterator[None]:
    yield
    kill_all(slidectl.runtime)


@pytest.fixture
def everything(tmp_path: Path) -> str:
    return write_everything(tmp_path)


@pytest.fixture
def interrupting(slidectl: CommandLine, tmp_path: Path) -> str:
    """A PYTHONPATH with which a launch interrupts itself."""
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook" / "sitecustomize.py").write_text(INTERRUPTING)
    return f"{tmp_path / 'hook'}:{slidectl.environment['PYTHONPATH']}"


@pytest.mark.parametrize("moment", MOMENTS)
def test_an_interrupt_at_any_moment_leaves_nothing(
    slidectl: CommandLine, everything: str, interrupting: str, moment: int
) -> None:
    with inherited(signal.SIGINT, signal.SIG_DFL):
        launched = Launched(slidectl, everything, PYTHONPATH=interrupting, INTERRUPT_AFTER=str(moment))
    launched.until_one_of("now\n", RUNS)
    code = launched.interrupt() if RUNS in launched.text else launched.end()
    assert code == 130, launched.text
    assert "Traceback" not in launched.text
    nothing_is_left(slidectl.runtime)


@pytest.mark.parametrize("moment", MOMENTS[::4])
def test_interrupts_in_a_row_leave_nothing(
    slidectl: CommandLine, everything: str, interrupting: str, moment: int
) -> None:
    with inherited(signal.SIGINT, signal.SIG_DFL):
        launched = Launched(slidectl, everything, PYTHONPATH=interrupting, INTERRUPT_AFTER=str(moment))
    launched.until_one_of("now\n", RUNS)
    for _ in range(5):
        launched.signal()
        with suppress(subprocess.TimeoutExpired):
            launched.process.wait(0.002)
    assert launched.end() == 130, launched.text
    assert "Traceback" not in launched.text
    nothing_is_left(slidectl.runtime)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_polite_end_of_what_runs_is_a_success(slidectl: CommandLine, everything: str, number: signal.Signals) -> None:
    with inherited(number, signal.SIG_DFL):
        launched = Launched(slidectl, everything)
    launched.up()
    assert launched.end(number) == 0
    assert "joint1_position_controller, joint_state_controller stopped and unloaded" in launched.text
    nothing_is_left(slidectl.runtime)


def test_nohup_outlives_its_terminal(slidectl: CommandLine, everything: str) -> None:
    with inherited(signal.SIGHUP, signal.SIG_IGN):
        launched = Launched(slidectl, everything)
    launched.up()
    launched.signal(signal.SIGHUP)
    assert "running" in slidectl.ok("controller", "list")
    assert launched.process.poll() is None
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


def test_an_interrupt_ends_what_a_script_has_in_its_background(slidectl: CommandLine, everything: str) -> None:
    with inherited(signal.SIGINT, signal.SIG_IGN):  # as shells start `slidectl launch FILE &`
        launched = Launched(slidectl, everything)
    launched.up()
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
