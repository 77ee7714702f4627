"""Starts of a daemon that come to nothing: interrupted in the middle, or in a place where no lock can be had."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import CommandLine
from daemon_fixture import Runtime


def with_modules(slidectl: CommandLine, folder: Path) -> dict[str, str]:
    """The environment of a command, and of the daemon that it starts, in which Python finds these modules first."""
    return {"PYTHONPATH": f"{folder}:{slidectl.environment['PYTHONPATH']}"}


def test_a_start_that_is_interrupted_leaves_no_daemon(
    slidectl: CommandLine, write: Callable[[str, str], Path], tmp_path: Path
) -> None:
    runtime = Runtime(slidectl.runtime)
    os.mkfifo(tmp_path / "reached")
    reached = os.open(tmp_path / "reached", os.O_RDONLY | os.O_NONBLOCK)
    write("mujoco.py", f"import signal\nopen({str(tmp_path / 'reached')!r}, 'w').close()\nsignal.pause()\n")
    starter = slidectl.start("daemon", "start", **with_modules(slidectl, tmp_path))
    assert select.select([reached], [], [], 60)[0]  # the daemon has its lock and its socket, and does not answer yet
    os.close(reached)
    assert runtime.pid is not None
    starter.send_signal(signal.SIGINT)
    assert starter.communicate(timeout=60) == ("", "")
    assert starter.returncode == 130
    assert runtime.pid is None
    (tmp_path / "mujoco.py").unlink()
    slidectl.ok("daemon", "start")  # what a killed start has left is in nobody's way
    slidectl.ok("daemon", "stop")


def test_a_broken_mujoco_is_not_told_as_a_setting_of_its_drawing(
    slidectl: CommandLine, write: Callable[[str, str], Path], tmp_path: Path
) -> None:
    write("mujoco.py", "raise ImportError('libmujoco.so: file too short')")
    done = slidectl("daemon", "start", **with_modules(slidectl, tmp_path))
    assert done.returncode == 1
    assert "libmujoco.so: file too short" in done.stderr
    assert "MUJOCO_GL=" not in done.stderr


NO_LOCKS = """
import errno, fcntl, os
def refuse(*_):
    raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))
fcntl.lockf = refuse
"""


@pytest.mark.parametrize("words", ["daemon start", "daemon run", "launch slider"])
def test_where_no_lock_can_be_had_no_daemon_starts_and_the_reason_is_told(
    slidectl: CommandLine, write: Callable[[str, str], Path], tmp_path: Path, words: str
) -> None:
    runtime = Runtime(slidectl.runtime)
    write("sitecustomize.py", NO_LOCKS)
    done = slidectl(*words.split(), **with_modules(slidectl, tmp_path))
    assert done.returncode == 1
    assert f"cannot acquire the lock {runtime.paths.lock}: No locks available\n" in done.stderr
    assert "XDG_RUNTIME_DIR" in done.stderr
    assert "already runs there" not in done.stderr
    assert "Traceback" not in done.stderr
