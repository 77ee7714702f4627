"""`slidectl doctor` on machines that have something to say."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import opengl
from command_line import CommandLine, Done
from daemon_fixture import Runtime

from slidectl import __version__ as slidectl_version


def findings(done: Done) -> dict[str, list[tuple[str, str, str]]]:
    """Check -> state, finding and remedy of each of its lines."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    for record in map(json.loads, done.stdout.splitlines()):
        found.setdefault(record["check"], []).append((record["state"], record["finding"], record["remedy"]))
    return found


def test_a_machine_that_is_well_has_nothing_broken(slidectl: CommandLine) -> None:
    done = slidectl("doctor", "--json")
    assert done.returncode == 0, done.stdout
    found = findings(done)
    assert {state for lines in found.values() for state, _, _ in lines} <= {"ok", "look here"}
    assert " ".join(found) == "python libraries mujoco cameras compiled files timers packages ros sockets daemons disk"
    assert found["daemons"] == [("ok", "default: does not run", "")]
    assert slidectl.ok("doctor").splitlines()[0].startswith("ok         python:     3.")
    assert not list(slidectl.runtime.glob("slidectl/*"))


def test_who_draws_the_pictures_of_cameras_is_told(slidectl: CommandLine, tmp_path: Path) -> None:
    for machine, reason in (
        (opengl.missing, "there is no OpenGL"),
        (opengl.broken, "OpenGL (egl) ends the process that uses it"),
    ):
        ((state, finding, remedy),) = findings(slidectl("doctor", "--json", **machine(tmp_path)))["cameras"]
        assert (state, finding) == ("ok", f"drawn by software: {reason}")
        assert "apt install libegl1" in remedy


def test_a_folder_that_no_socket_can_be_in_is_broken_and_the_machine_is_looked_at(slidectl: CommandLine) -> None:
    done = slidectl("doctor", "--json", XDG_RUNTIME_DIR="/tmp/" + 110 * "x")
    found = findings(done)
    assert (done.returncode, found["sockets"][0][0], "mujoco" in found) == (1, "broken", True)
    assert "set XDG_RUNTIME_DIR to a shorter folder" in found["sockets"][0][2]


def test_daemons_that_run_and_those_that_were_killed_are_told_apart() -> None:
    runtime = Runtime()
    slidectl = CommandLine(runtime.folder)
    try:
        slidectl.ok("daemon", "start", "--paused")
        pid = json.loads(slidectl.ok("-i", "other", "daemon", "start", "--paused", "--json"))["pid"]
        lines = findings(slidectl("doctor", "--json"))["daemons"]
        assert [(state, text.split(",")[0].split(" ")[0]) for state, text, _ in lines] == [
            ("ok", "default:"),
            ("ok", "other:"),
        ]
        assert lines[1][1].startswith(f"other: process {pid}, 0.000 s")
        newer = "import sys, slidectl; slidectl.__version__ = '9.9'; from slidectl.cli import entry; entry()"
        words = [sys.executable, "-c", newer, "doctor", "--json"]
        done = subprocess.run(words, env=runtime.env, capture_output=True, text=True, check=True)
        for name, (state, text, remedy) in zip(("", "-i other "), findings(done)["daemons"], strict=True):
            assert (state, remedy) == ("look here", f"slidectl {name}daemon restart"), text
            assert f"it is of version {slidectl_version}, this command of 9.9" in text
        os.kill(pid, signal.SIGKILL)
        while slidectl("-i", "other", "daemon", "status").returncode != 3:
            pass
        lines = findings(slidectl("doctor", "--json"))["daemons"]
        assert ("look here", "other: was killed, its files are left", "slidectl -i other daemon clean") in lines
    finally:
        slidectl("daemon", "stop")
        runtime.remove()


def test_what_is_broken_is_said_with_its_remedy_and_the_other_checks_go_on(slidectl: CommandLine) -> None:
    folder = slidectl.runtime / "slidectl" / "default"
    folder.mkdir(parents=True, mode=0o700)
    folder.chmod(0o755)
    argv = ["bash", "-c", 'ulimit -n 64; exec "$@"', "bash", *slidectl.argv("doctor", "--json")]
    environment = {**slidectl.environment, "ROS_PACKAGE_PATH": "/nowhere/src", "ROS_DISTRO": "noetic"}
    done = subprocess.run(argv, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 1
    assert json.loads(done.stderr)["error"] == "1 is broken, see above"
    found = findings(done)
    [(state, text, remedy)] = found["sockets"]
    assert (state, f"{folder} is open to other users" in text, f"chmod 700 {folder}" in remedy) == (
        "broken",
        True,
        True,
    )
    assert (
        "look here",
        "at most 64 open files; each connection takes one",
        "raise the hard limit: nofile in /etc/security/limits.conf",
    ) in found["files"]
    assert any(state == "look here" and "/nowhere/src" in text for state, text, _ in found["packages"])
    assert "ROS_DISTRO=noetic" in found["ros"][0][1]


def test_a_library_that_is_missing_is_named(slidectl: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "mcap.py").write_text("raise ImportError('not here')\n")
    (tmp_path / "yourdfpy.py").write_text("raise ImportError('not here')\n")
    path = os.pathsep.join([str(tmp_path), slidectl.environment["PYTHONPATH"]])
    found = findings(slidectl("doctor", "--json", PYTHONPATH=path))
    assert (
        "broken",
        "yourdfpy: not here",
        "in the clone of slidectl: pip install --force-reinstall .",
    ) in found["libraries"]
    assert any("without mcap" in text and "[mcap]'" in remedy for _, text, remedy in found["libraries"])
