"""`slidectl daemon clean`: what an instance leaves on a machine, what slidectl leaves, and that nothing of it stays."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from daemon_fixture import Runtime


@pytest.fixture
def home(tmp_path: Path) -> Iterator[tuple[CommandLine, Path, Runtime]]:
    """The command line with a home of its own, its folders, and what runs in it."""
    runtime = Runtime()
    line = CommandLine(runtime.folder)
    places = {"HOME": "home", "XDG_CACHE_HOME": "cache", "XDG_STATE_HOME": "state", "TMPDIR": "tmp"}
    for variable, name in places.items():
        (tmp_path / name).mkdir()
        line.environment[variable] = str(tmp_path / name)
    yield line, tmp_path, runtime
    runtime.remove()


def fill(line: CommandLine, folder: Path) -> None:
    """What compiling, a shell, and daemons of both kinds of runtime folder leave."""
    (folder / "cache" / "slidectl").mkdir(mode=0o700)
    (folder / "cache" / "slidectl" / "cycles.o").write_bytes(bytes(1000))
    (folder / "cache" / "other").mkdir()
    (folder / "state" / "slidectl").mkdir(mode=0o700)
    (folder / "state" / "slidectl" / "history").write_text("robots\n")
    line.ok("-i", "old", "daemon", "start", "--paused")
    line.ok("-i", "old", "daemon", "stop")


def left(line: CommandLine, folder: Path) -> list[str]:
    return sorted(str(path.name) for root in (folder, line.runtime) for path in root.rglob("slidectl*"))


def test_nothing_stays_and_nothing_of_others_goes(home: tuple[CommandLine, Path, Runtime]) -> None:
    line, folder, _ = home
    fill(line, folder)
    before = left(line, folder)
    listed = [json.loads(row) for row in line.ok("daemon", "clean", "--all", "--dry-run", "--json").splitlines()]
    assert left(line, folder) == before
    assert [row["what"] for row in listed] == ["compiled code", "history of the shell", "instance old"]
    assert not any(row["removed"] for row in listed)
    assert line.ok("daemon", "clean", "--all").count("removed ") == 3
    assert left(line, folder) == []
    assert (folder / "cache" / "other").is_dir()
    assert line("daemon", "clean", "--all").stderr == "nothing of slidectl is left\n"


@pytest.mark.parametrize("environment", [{}, {"SLIDECTL_INSTANCE": "old"}, {"SLIDECTL_SOCKET": "socket of old"}])
def test_only_the_instance_asked_for_goes(home: tuple[CommandLine, Path, Runtime], environment: dict[str, str]) -> None:
    line, folder, runtime = home
    fill(line, folder)
    line.ok("-i", "kept", "daemon", "start", "--paused")
    line.ok("-i", "kept", "daemon", "stop")
    instances = runtime.folder / "slidectl"
    if "SLIDECTL_SOCKET" in environment:
        environment = {"SLIDECTL_SOCKET": str(instances / "old" / "socket")}
    chosen = () if environment else ("-i", "old")
    assert line("daemon", "clean").stderr == "nothing of instance default is left\n"
    listed = line.ok(*chosen, "daemon", "clean", "--dry-run", "--json", **environment)
    assert [json.loads(row)["path"] for row in listed.splitlines()] == [str(instances / "old")]
    assert line.ok(*chosen, "daemon", "clean", **environment).startswith(f"removed {instances / 'old'}: instance old,")
    assert [path.name for path in instances.iterdir()] == ["kept"]
    assert (folder / "cache" / "slidectl" / "cycles.o").exists()
    assert (folder / "state" / "slidectl" / "history").exists()


def test_a_running_daemon_of_another_instance_is_no_reason_to_refuse(home: tuple[CommandLine, Path, Runtime]) -> None:
    line, folder, _ = home
    fill(line, folder)
    line.ok("daemon", "start", "--paused")
    assert line.ok("-i", "old", "daemon", "clean").count("removed ") == 1
    assert line.ok("robots", "--json") == ""
    done = line("daemon", "clean")
    assert done.returncode == 1
    assert "stop it first: slidectl daemon stop" in done.stderr
    line.ok("daemon", "stop")


def test_a_socket_whose_name_begins_another_keeps_the_others_files(home: tuple[CommandLine, Path, Runtime]) -> None:
    line, _, runtime = home
    own = runtime.folder / "own"
    own.mkdir(mode=0o700)
    line.ok("--socket", str(own / "s.x"), "daemon", "start", "--paused")
    line.ok("--socket", str(own / "s"), "daemon", "start", "--paused")
    line.ok("--socket", str(own / "s"), "daemon", "stop")
    assert "s.log" in line.ok("--socket", str(own / "s"), "daemon", "clean")
    assert {"s.x", "s.x.lock", "s.x.log"} <= {path.name for path in own.iterdir()}
    line.ok("--socket", str(own / "s.x"), "daemon", "stop")


def test_files_of_a_running_daemon_stay(home: tuple[CommandLine, Path, Runtime]) -> None:
    line, folder, _ = home
    fill(line, folder)
    line.ok("daemon", "start", "--paused")
    done = line("daemon", "clean", "--all")
    assert done.returncode == 1
    assert "(instance default) stays: process" in done.stderr
    assert "instance old" in done.stdout
    assert line.ok("robots", "--json") == ""
    line.ok("daemon", "stop")
    assert line("daemon", "clean", "--all").returncode == 0
    assert left(line, folder) == []


def test_a_link_is_not_followed(home: tuple[CommandLine, Path, Runtime]) -> None:
    line, folder, _ = home
    (folder / "precious").mkdir()
    (folder / "precious" / "file").write_text("mine")
    (folder / "cache" / "slidectl").symlink_to(folder / "precious")
    assert line("daemon", "clean", "--all").returncode == 0
    assert (folder / "precious" / "file").read_text() == "mine"


def test_the_files_beside_a_named_socket_go_too(home: tuple[CommandLine, Path, Runtime]) -> None:
    line, _, runtime = home
    own = runtime.folder / "own"
    own.mkdir(mode=0o700)
    (own / "notes").write_text("mine")
    line.ok("--socket", str(own / "s"), "daemon", "start", "--paused")
    line.ok("--socket", str(own / "s"), "daemon", "stop")
    assert (own / "s.log").exists()
    (own / "s.gateway-ros1.log").write_text("what a gateway said")
    (own / "s.page.lock").write_text("1\nhttp://localhost:8080/")  # of a page that was killed
    line.ok("--socket", str(own / "s"), "daemon", "clean")
    assert [path.name for path in own.iterdir()] == ["notes"]
