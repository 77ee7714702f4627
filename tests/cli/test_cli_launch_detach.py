"""`slidectl launch --detach`: it returns when everything runs, and what ends it before that ends all of it, once."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from launch_runs import Launched, kill_all, nothing_is_left, processes, write_everything
from terminal import Terminal

NEVER = '<node pkg="controller_manager" type="spawner" name="never" ns="/nobody" args="nothing"/>'
"""A step that waits for a robot that does not come."""


@pytest.fixture(autouse=True)
def clean(slidectl: CommandLine) -> Iterator[None]:
    yield
    kill_all(slidectl.runtime)


@pytest.fixture
def everything(tmp_path: Path) -> str:
    return write_everything(tmp_path)


@pytest.fixture
def slow(tmp_path: Path) -> str:
    """A program that takes its time to end: it waits until somebody opens `done`. And a step that waits for ever."""
    os.mkfifo(tmp_path / "done")
    script = tmp_path / "demo" / "slow"
    script.parent.mkdir()
    (script.parent / "package.xml").write_text("<package><name>demo</name></package>")
    trap = f"echo cleaning up; : < '{tmp_path}/done'; echo clean; exit 0"
    script.write_text(f'#!/bin/bash\ntrap "{trap}" INT\necho up\nwhile :; do sleep 0.02; done\n')
    script.chmod(0o755)
    path = script.with_name("slow.launch")
    path.write_text(f'<launch><node pkg="demo" type="slow" name="slow"/>{NEVER}</launch>')
    return str(path)


def test_a_detached_launch_with_programs_is_watched_in_the_background(slidectl: CommandLine, everything: str) -> None:
    launched = Launched(slidectl, everything, "--detach")
    launched.until("everything runs")
    assert launched.end() == 0
    assert "its log is" in launched.text
    [log] = slidectl.runtime.glob("slidectl/default/launch-*.log")
    children = processes(slidectl.runtime)
    assert len(children) >= 4  # the daemon, the launch, two programs
    assert "running" in slidectl.ok("controller", "list")
    slidectl.ok("daemon", "stop")
    assert not processes(slidectl.runtime)
    assert "the daemon went away" in log.read_text()


def test_a_stop_waits_for_the_nodes_of_a_detached_launch(slidectl: CommandLine, slow: str) -> None:
    path = Path(slow)
    path.write_text(path.read_text().replace(NEVER, ""))
    slidectl.ok("launch", slow, "--detach")
    done = slidectl("--timeout", "3", "daemon", "stop")
    assert done.returncode == 4
    assert "waiting for the background process to end" in done.stderr
    assert "what runs in the background has not ended within 3 s" in done.stderr
    stopping = slidectl.start("daemon", "stop")
    assert stopping.stderr is not None
    assert "waiting for the background process" in stopping.stderr.readline()
    (path.parent.parent / "done").open("w").close()
    assert stopping.wait(timeout=30) == 0
    assert not processes(slidectl.runtime)


def test_a_detached_launch_that_fails_says_so_with_its_exit_code(slidectl: CommandLine, everything: str) -> None:
    path = Path(everything)
    path.write_text(path.read_text().replace("</launch>", '<node pkg="controller_manager" type="spawner" name="s"'
                                             ' ns="/slider" args="joint_state_controller"/></launch>'))  # fmt: skip
    done = slidectl("launch", everything, "--detach")
    assert done.returncode == 1
    assert "cannot load joint_state_controller" in done.stderr
    nothing_is_left(slidectl.runtime)


def test_a_detached_launch_can_be_interrupted_while_it_starts(slidectl: CommandLine, everything: str) -> None:
    path = Path(everything)
    path.write_text(path.read_text().replace("</launch>", '<node pkg="controller_manager" type="spawner" name="s"'
                                             ' ns="/nobody" args="nothing"/></launch>'))  # fmt: skip
    launched = Launched(slidectl, everything, "--detach")
    launched.until("/nobody/s: waits for")
    assert launched.interrupt() == 130
    nothing_is_left(slidectl.runtime)


@pytest.mark.parametrize("detach", [(), ("--detach",)], ids=" ".join)
def test_one_interrupt_on_a_terminal_counts_once(
    slidectl: CommandLine, tmp_path: Path, slow: str, detach: tuple[str, ...]
) -> None:
    with Terminal(slidectl, "launch", slow, *detach, TERM="dumb") as terminal:
        terminal.says("/never: waits for", "[slow] up")
        terminal.press("\x03")
        terminal.says("[slow] cleaning up")
        (tmp_path / "done").write_text("")
        assert terminal.ended() == 130
    assert "[slow] clean\r\n" in terminal.output
    assert "does not end" not in terminal.output
    nothing_is_left(slidectl.runtime)


def test_a_second_interrupt_on_a_terminal_waits_for_nobody(slidectl: CommandLine, slow: str) -> None:
    with Terminal(slidectl, "launch", slow, "--detach", TERM="dumb") as terminal:
        terminal.says("/never: waits for", "[slow] up")
        terminal.press("\x03")
        terminal.says("[slow] cleaning up")
        terminal.press("\x03")
        assert terminal.ended() == 130
    assert "/slow: does not end; sending SIGTERM" in terminal.output
    nothing_is_left(slidectl.runtime)


@pytest.mark.parametrize("detach", [(), ("--detach",)], ids=" ".join)
def test_a_terminal_that_closes_before_everything_runs_ends_the_launch(
    slidectl: CommandLine, everything: str, detach: tuple[str, ...]
) -> None:
    path = Path(everything)
    path.write_text(path.read_text().replace("</launch>", f"{NEVER}</launch>"))
    with Terminal(slidectl, "launch", everything, *detach, TERM="dumb") as terminal:
        terminal.says("/never: waits for")
        terminal.close()
        assert terminal.process.wait(60) == 130  # as Ctrl-C
    nothing_is_left(slidectl.runtime)


def test_a_terminal_that_closes_later_does_not_end_a_detached_launch(slidectl: CommandLine, everything: str) -> None:
    with Terminal(slidectl, "launch", everything, "--detach", TERM="dumb") as terminal:
        terminal.says("everything runs")
        assert terminal.ended() == 0
        terminal.close()
    assert "running" in slidectl.ok("controller", "list")
    slidectl.ok("daemon", "stop")
    nothing_is_left(slidectl.runtime)


def test_a_detached_launch_that_is_killed_while_it_starts_says_so(slidectl: CommandLine, slow: str) -> None:
    launched = Launched(slidectl, slow, "--detach")
    launched.until("/never: waits for")
    [child] = Path(f"/proc/{launched.pid}/task/{launched.pid}/children").read_text().split()
    os.kill(int(child), signal.SIGKILL)
    assert launched.end() == 1
    assert "the launch was ended by SIGKILL before everything ran" in launched.text
    assert "slidectl daemon stop" in launched.text
    slidectl.ok("daemon", "stop")
