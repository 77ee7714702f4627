"""`slidectl daemon list`, with several daemons, and with files in the runtime folder that are none."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine
from daemon_fixture import Runtime


@pytest.fixture
def runtime(tmp_path: Path) -> Iterator[Runtime]:
    folder = Runtime()
    (tmp_path / "tmp").mkdir()
    yield folder
    folder.remove()


@pytest.fixture
def line(runtime: Runtime, tmp_path: Path) -> CommandLine:
    """The command line, with a temporary folder of its own: instances are looked for there too."""
    line = CommandLine(runtime.folder)
    line.environment["TMPDIR"] = str(tmp_path / "tmp")
    return line


def listed(line: CommandLine, *words: str, **environment: str) -> dict[str, Any]:
    rows = [json.loads(row) for row in line.ok(*words, "daemon", "list", "--json", **environment).splitlines()]
    return {row["instance"]: row for row in rows}


def test_all_daemons_are_listed_with_time_robots_and_gateways(line: CommandLine) -> None:
    pids = {}
    for name in ("one", "two"):
        pids[name] = json.loads(line.ok("-i", name, "daemon", "start", "--paused", "--json"))["pid"]
    line.ok("-i", "two", "spawn", "slider")
    line.ok("-i", "two", "sim", "step", "0.5s")
    address = json.loads(line.ok("-i", "two", "gateway", "ros1", "start", "--port", "0", "--json"))["address"]
    rows = listed(line)
    assert {name: row["pid"] for name, row in rows.items()} == pids
    assert (rows["one"]["time"], rows["one"]["robots"], rows["one"]["gateways"]) == (0.0, [], [])
    assert (rows["two"]["time"], rows["two"]["robots"]) == (0.5, ["slider"])
    assert [(one["kind"], one["address"]) for one in rows["two"]["gateways"]] == [("ros1", address)]
    assert all(row["answers"] and row["state"] == "paused" for row in rows.values())
    assert datetime.fromisoformat(rows["one"]["since"]) <= datetime.fromisoformat(rows["two"]["since"])
    header, *text = line.ok("daemon", "list").splitlines()
    assert header.split() == ["INSTANCE", "PID", "TIME", "SINCE", "ROBOTS", "GATEWAYS", "STATE"]
    assert text[1].split()[:3] == ["two", str(pids["two"]), "0.5"]
    assert text[1].split()[5:] == ["slider", "ros1", "paused"]
    assert [row["instance"] for row in csv.DictReader(io.StringIO(line.ok("daemon", "list", "-o", "csv")))] == [
        "one",
        "two",
    ]
    line.ok("-i", "two", "daemon", "stop")
    line.ok("-i", "one", "daemon", "stop")
    assert line("daemon", "list").stderr == "no daemon runs\n"


def test_a_daemon_that_does_not_answer_is_listed_as_such(line: CommandLine) -> None:
    pid = json.loads(line.ok("-i", "silent", "daemon", "start", "--json"))["pid"]
    line.ok("-i", "well", "daemon", "start")
    os.kill(pid, signal.SIGSTOP)
    try:
        rows = listed(line, "--timeout", "0.5")
    finally:
        os.kill(pid, signal.SIGCONT)
    assert (rows["silent"]["answers"], rows["silent"]["time"]) == (False, None)
    assert rows["silent"]["state"].startswith("does not answer: ")
    assert rows["silent"]["pid"] == pid
    assert rows["well"]["answers"]


def test_what_a_killed_daemon_left_is_no_daemon(line: CommandLine, runtime: Runtime) -> None:
    pid = json.loads(line.ok("-i", "dead", "daemon", "start", "--json"))["pid"]
    process = os.pidfd_open(pid)
    os.kill(pid, signal.SIGKILL)
    os.close(process)
    while (runtime.folder / "slidectl" / "dead" / "lock").exists() and listed(line):
        pass  # the kernel releases the lock when the process has gone
    assert (runtime.folder / "slidectl" / "dead" / "socket").exists()
    assert listed(line) == {}


def test_what_others_put_into_the_runtime_folder_is_passed_over(line: CommandLine, runtime: Runtime) -> None:
    line.ok("-i", "real", "daemon", "start", "--paused")
    folder = runtime.folder / "slidectl"
    os.mkfifo(folder / "fifo")
    (folder / "file").write_text("")
    (folder / "link").symlink_to(folder / "real")
    for name in ("fifo-lock", "fifo-gateway", "link-lock", "socket-lock"):
        (folder / name).mkdir(mode=0o700)
    os.mkfifo(folder / "fifo-lock" / "lock")
    os.mkfifo(folder / "real" / "gateway-ros1.lock")
    (folder / "link-lock" / "lock").symlink_to(folder / "real" / "lock")
    (folder / "socket-lock" / "lock").mkdir()
    assert set(listed(line)) == {"real"}
    assert listed(line)["real"]["gateways"] == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")
def test_files_of_another_user_are_no_daemons(line: CommandLine, runtime: Runtime) -> None:
    for name in ("mine", "theirs", "their-lock"):
        line.ok("-i", name, "daemon", "start", "--paused")
    folder = runtime.folder / "slidectl"
    os.chown(folder / "theirs", 65534, 65534)
    os.chown(folder / "their-lock" / "lock", 65534, 65534)
    assert set(listed(line)) == {"mine"}


def test_a_daemon_of_a_shell_without_a_runtime_folder_is_shown_by_its_socket(line: CommandLine) -> None:
    place = json.loads(line.ok("-i", "far", "daemon", "start", "--paused", "--json", XDG_RUNTIME_DIR=""))
    try:
        assert listed(line)["far"]["socket"] == place["socket"]
        assert line.ok("daemon", "list").splitlines()[1].split()[0] == place["socket"]
    finally:
        assert "stopped" in line.ok("--socket", place["socket"], "daemon", "stop")
    assert listed(line) == {}


def test_a_daemon_with_a_socket_elsewhere_is_listed_when_it_is_named(line: CommandLine, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir(mode=0o700)
    socket = str(own / "s")
    line.ok("--socket", socket, "daemon", "start", "--paused")
    try:
        assert listed(line) == {}
        assert listed(line, "--socket", socket)["s"]["socket"] == socket
    finally:
        line.ok("--socket", socket, "daemon", "stop")
