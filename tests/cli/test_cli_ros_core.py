"""`roscore`."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_ros_world import Shell, usage
from command_line import CommandLine

from slidectl.client import Client
from slidectl.errors import NoDaemon


@pytest.fixture
def shell(tmp_path: Path) -> Shell:
    return Shell(CommandLine(tmp_path))


@pytest.fixture
def core(shell: Shell) -> Iterator[subprocess.Popen[str]]:
    """A roscore that is up."""
    process = shell.slidectl.start("ros", "roscore")
    assert process.stdout is not None
    lines = []
    while not lines or not lines[-1].startswith("started core service"):
        lines.append(process.stdout.readline())
        assert lines[-1], process.communicate()
    process.lines = lines  # type: ignore[attr-defined]
    yield process
    process.kill()
    process.communicate(timeout=30)


def test_it_says_where_it_is_and_what_it_sets(shell: Shell, core: subprocess.Popen[str]) -> None:
    text = "".join(core.lines)  # type: ignore[attr-defined]
    assert "... logging to " in text
    assert "\n\nSUMMARY\n========\n\nPARAMETERS\n * /rosdistro: noetic\n * /rosversion: " in text
    assert f"ROS_MASTER_URI=unix://{shell.slidectl.runtime}/slidectl/default/socket\n" in text
    assert shell.run("rosparam get /rosdistro").stdout == "'noetic\n\n  '\n\n"
    assert shell.run("rostopic list | head -1").stdout == "/clock\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_and_the_daemon(shell: Shell, core: subprocess.Popen[str], number: int) -> None:
    core.send_signal(number)
    stdout, stderr = core.communicate(timeout=30)
    assert stdout == (
        "[master] killing on exit\nshutting down processing monitor...\n"
        "... shutting down processing monitor complete\ndone\n"
    )
    assert (stderr, core.returncode) == ("", 0)
    with pytest.raises(NoDaemon):
        Client(socket=f"{shell.slidectl.runtime}/slidectl/default/socket", timeout=0.0)


def test_it_ends_with_the_daemon(shell: Shell, core: subprocess.Popen[str]) -> None:
    shell.slidectl.ok("daemon", "stop")
    assert core.communicate(timeout=30) == ("[master] process has finished cleanly\n", "")
    assert core.returncode == 0


def test_a_daemon_that_is_killed_is_a_failure(shell: Shell, core: subprocess.Popen[str]) -> None:
    import os

    with shell.slidectl.client() as client:
        os.kill(client.daemon_pid, signal.SIGKILL)
    _, stderr = core.communicate(timeout=30)
    assert core.returncode == 1
    assert stderr.startswith("[master] process has died [pid ")


@pytest.mark.usefixtures("core")
def test_a_second_one_is_refused(shell: Shell) -> None:
    done = shell.run("roscore")
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr == (
        "RLException: roscore cannot run as another roscore/master is already running. \n"
        "Please kill other roscore/master processes before relaunching.\n"
        f"The ROS_MASTER_URI is unix://{shell.slidectl.runtime}/slidectl/default/socket\n"
    )


WRONG = {
    "roscore x": "roscore does not take arguments",
    "roscore --sigint-timeout x": "option --sigint-timeout: invalid floating-point value: 'x'",
}


@pytest.mark.parametrize("line", WRONG)
def test_wrong_usage(shell: Shell, line: str) -> None:
    expected = usage(line, "roscore [options]", WRONG[line])
    done = shell.run(expected.line)
    assert (done.stdout, done.stderr, done.returncode) == (expected.stdout, expected.stderr, expected.code)
