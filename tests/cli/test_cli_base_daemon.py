"""`slidectl daemon`, with real processes."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from daemon_fixture import Runtime

from slidectl import __version__
from slidectl.daemon.options import DaemonOptions, Start


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    """A folder for daemons; those that a test leaves behind are ended."""
    folder = Runtime()
    yield folder
    folder.remove()


@pytest.fixture
def slidectl(runtime: Runtime) -> CommandLine:
    return CommandLine(runtime.folder)


def test_start_returns_when_the_daemon_answers(slidectl: CommandLine, runtime: Runtime) -> None:
    record = json.loads(slidectl.ok("daemon", "start", "--json"))
    assert record == {
        "instance": "default",
        "pid": runtime.pid,
        "socket": str(runtime.paths.socket),
        "log": str(runtime.paths.log),
        "already": False,
    }
    status = json.loads(slidectl.ok("daemon", "status", "--json"))
    assert (status["running"], status["pid"]) == (True, record["pid"])


def test_starting_a_running_daemon_says_so_and_is_success(slidectl: CommandLine, runtime: Runtime) -> None:
    assert "started, process" in slidectl.ok("daemon", "start", "--paused")
    pid = runtime.pid
    done = slidectl("daemon", "start", "--rtf", "2")
    assert (done.returncode, runtime.pid) == (0, pid)
    assert "runs already" in done.stdout
    assert "--rtf had no effect" in done.stderr
    assert json.loads(slidectl.ok("sim", "status", "--json"))["speed"] == 1.0


def test_start_hands_its_options_to_the_world(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start", "--rtf", "max", "--paused", "--timestep", "0.002", "--gravity", "0", "0", "-1.6")
    status = json.loads(slidectl.ok("sim", "status", "--json"))
    assert (status["speed"], status["paused"], status["timestep"]) == (0.0, True, 0.002)


def test_restart_keeps_the_options_that_are_not_given_anew(slidectl: CommandLine) -> None:
    slidectl.ok(
        "daemon", "start", "--paused", "--timestep", "0.002", "--engine", "plain", "--gravity", "0", "0", "-1e-5"
    )
    slidectl.ok("daemon", "restart", "--rtf", "2")
    slidectl.ok("daemon", "restart", "--timestep", "0.004")
    status = json.loads(slidectl.ok("sim", "status", "--json"))
    assert (status["speed"], status["paused"], status["timestep"], status["engine"]) == (2.0, True, 0.004, "plain")
    slidectl.ok("daemon", "stop")
    slidectl.ok("daemon", "restart")
    assert json.loads(slidectl.ok("sim", "status", "--json"))["timestep"] == 0.001


@pytest.mark.parametrize("command", ["daemon start", "daemon status", "daemon logs", "pub command 1", "daemon run"])
def test_a_file_in_the_place_of_the_folder_is_told(slidectl: CommandLine, runtime: Runtime, command: str) -> None:
    instance = runtime.paths.folder
    instance.parent.mkdir(mode=0o700, exist_ok=True)
    instance.write_text("")
    done = slidectl(*command.split())
    assert done.returncode in (1, 3)
    assert str(instance) in done.stderr
    assert "a bug in slidectl" not in done.stderr
    assert "does not run" in slidectl.ok("daemon", "stop")
    instance.unlink()


def test_the_engine_is_chosen_at_the_start_and_shown(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start", "--engine", "plain")
    assert json.loads(slidectl.ok("sim", "status", "--json"))["engine"] == "plain"
    assert "engine:      plain" in slidectl.ok("sim", "status")
    assert slidectl("daemon", "restart", "--engine", "warp").returncode == 2


def test_two_starts_at_once_make_one_daemon(slidectl: CommandLine) -> None:
    both = [slidectl.start("daemon", "start", "--json") for _ in range(2)]
    records = [json.loads(process.communicate(timeout=60)[0]) for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert records[0]["pid"] == records[1]["pid"]
    assert sorted(record["already"] for record in records) == [False, True]


@pytest.mark.parametrize(
    "options",
    [
        ("--rtf", "0"),
        ("--rtf", "-1"),
        ("--rtf", "fast"),
        ("--timestep", "0"),
        ("--gravity", "1", "2", "nan"),
        ("--warp",),
    ],
    ids=" ".join,
)
def test_options_that_make_no_world_are_wrong_usage(
    slidectl: CommandLine, runtime: Runtime, options: tuple[str, ...]
) -> None:
    done = slidectl("daemon", "start", *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert runtime.pid is None


def test_stop_returns_when_the_process_has_ended(slidectl: CommandLine, runtime: Runtime) -> None:
    slidectl.ok("daemon", "start")
    pid = runtime.pid
    assert f"stopped, it was process {pid}" in slidectl.ok("daemon", "stop")
    assert runtime.pid is None
    assert slidectl("robots").returncode == 3


def test_stopping_what_does_not_run_is_success(slidectl: CommandLine) -> None:
    done = slidectl("daemon", "stop")
    assert (done.returncode, done.stdout) == (0, "daemon default: does not run\n")
    assert json.loads(slidectl.ok("daemon", "stop", "--json"))["pid"] is None


def test_restart_with_a_bad_option_leaves_the_daemon_alone(slidectl: CommandLine, runtime: Runtime) -> None:
    slidectl.ok("daemon", "start")
    pid = runtime.pid
    assert slidectl("daemon", "restart", "--rtf", "0").returncode == 2
    assert runtime.pid == pid


def test_status_without_a_daemon_is_no_daemon(slidectl: CommandLine) -> None:
    done = slidectl("daemon", "status")
    assert (done.returncode, done.stdout) == (3, "")
    done = slidectl("daemon", "status", "--json")
    assert done.returncode == 3
    assert json.loads(done.stdout)["running"] is False


def test_a_daemon_that_was_killed_does_not_hinder_the_next(slidectl: CommandLine, runtime: Runtime) -> None:
    slidectl.ok("daemon", "start")
    pid = runtime.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    assert slidectl("robots").returncode == 3
    slidectl.ok("daemon", "start")
    assert runtime.pid not in (None, pid)


def test_instances_live_side_by_side(slidectl: CommandLine) -> None:
    slidectl.ok("-i", "one", "daemon", "start", "--paused")
    slidectl.ok("daemon", "start", "--paused", SLIDECTL_INSTANCE="two")
    slidectl.ok("-i", "one", "spawn", "slider")
    assert json.loads(slidectl.ok("robots", "--json", "-i", "one"))["name"] == "slider"
    assert slidectl.ok("robots", "--json", SLIDECTL_INSTANCE="two") == ""
    slidectl.ok("daemon", "stop", "-i", "one")
    slidectl.ok("-i", "two", "sim", "status")


def test_a_socket_can_be_anywhere_in_a_private_folder(slidectl: CommandLine, runtime: Runtime) -> None:
    socket = runtime.folder / "mine" / "s"
    slidectl.ok("--socket", str(socket), "daemon", "start")
    assert stat.S_IMODE(socket.parent.stat().st_mode) == 0o700
    assert json.loads(slidectl.ok("daemon", "status", "--json", SLIDECTL_SOCKET=str(socket)))["socket"] == str(socket)
    slidectl.ok("daemon", "stop", "--socket", str(socket))


def test_the_socket_of_an_instance_is_that_instance(slidectl: CommandLine) -> None:
    slidectl.ok("-i", "lab", "daemon", "start")
    status = json.loads(slidectl.ok("-i", "lab", "daemon", "status", "--json"))
    socket = status["socket"]
    assert json.loads(slidectl.ok("--socket", socket, "daemon", "status", "--json"))["log"] == status["log"]
    assert "runs already" in slidectl.ok("--socket", socket, "daemon", "start")
    assert slidectl.ok("daemon", "stop", SLIDECTL_SOCKET=socket).startswith("daemon lab: stopped")
    done = slidectl("--socket", socket, "topic", "list")
    assert done.returncode == 3
    assert "slidectl -i lab daemon start" in done.stderr


def test_a_folder_that_others_may_enter_is_refused(slidectl: CommandLine, runtime: Runtime) -> None:
    open_folder = runtime.folder / "open"
    open_folder.mkdir(mode=0o755)
    done = slidectl("--socket", str(open_folder / "s"), "daemon", "start")
    assert done.returncode == 1
    assert "mkdir -m 700" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_daemon_in_the_foreground_is_stopped_cleanly_by_a_signal(
    slidectl: CommandLine, runtime: Runtime, number: signal.Signals
) -> None:
    process = slidectl.start("daemon", "run", "--paused")
    assert process.stderr is not None
    assert "answers on" in process.stderr.readline()
    slidectl.ok("sim", "status")
    process.send_signal(number)
    process.communicate(timeout=30)
    assert process.returncode == 0
    assert runtime.pid is None


def test_logs_prints_the_last_lines(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start")
    slidectl.ok("daemon", "stop")
    lines = slidectl.ok("daemon", "logs").splitlines()
    assert "answers on" in lines[0]
    assert slidectl.ok("daemon", "logs", "-n", "1").splitlines() == lines[-1:]
    assert json.loads(slidectl.ok("daemon", "logs", "-n", "1", "--json"))["line"] == lines[-1]
    assert slidectl.ok("daemon", "logs", "-n", "0") == ""
    assert slidectl.ok("daemon", "logs", "-o", "csv").splitlines()[0] == "time,level,node,text,line"
    assert len(slidectl.ok("daemon", "logs", "-o", "csv").splitlines()) == 1 + len(lines)
    assert slidectl.ok("daemon", "logs", "-n", "2", "-o", "yaml").count("\n---\n") == 1


def test_logs_goes_on_with_what_is_logged_later_and_after_a_rotation(slidectl: CommandLine, runtime: Runtime) -> None:
    log = private_log(runtime, "first\n")
    process = slidectl.start("daemon", "logs", "-f")
    assert process.stdout is not None
    assert process.stdout.readline() == "first\n"
    with log.open("a") as file:
        file.write("second\nhalf")
        file.flush()
        assert process.stdout.readline() == "second\n"
        file.write(" and half\n")
    assert process.stdout.readline() == "half and half\n"
    log.rename(log.with_name("log.1"))
    log.write_text("third\n")
    assert process.stdout.readline() == "third\n"
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=30) == ("", "")
    assert process.returncode == 130


def private_log(runtime: Runtime, text: str) -> Path:
    runtime.paths.folder.mkdir(mode=0o700, parents=True)
    runtime.paths.log.write_text(text)
    return runtime.paths.log


def test_without_a_log_there_is_nothing_to_print(slidectl: CommandLine) -> None:
    done = slidectl("daemon", "logs")
    assert done.returncode == 1
    assert "no daemon of this instance has run" in done.stderr


def test_a_daemon_of_another_version_is_told_once_with_what_helps(slidectl: CommandLine) -> None:
    script = "import slidectl\nslidectl.__version__ = '0.0.9'\nimport sys\nfrom slidectl.daemon.__main__ import main\n"
    script += "sys.exit(main(sys.argv[1]))"
    start = Start(DaemonOptions(paused=True), str(slidectl.runtime / "slidectl/default/socket"), foreground=True)
    words = [sys.executable, "-c", script, start.text()]
    with subprocess.Popen(words, env=slidectl.environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert "answers on" in process.stderr.readline()
        said = f"warning: the daemon is of version 0.0.9, this command of {__version__}; to have one: "
        said += "slidectl daemon restart\n"
        for command in ("robots", "sim status", "topic list"):
            done = slidectl(*command.split())
            assert said in done.stderr
        assert slidectl("shell", stdin="robots\ntopic list\nsim status\n").stderr.count(said) == 1
        assert said not in slidectl("-q", "sim", "status").stderr
        process.terminate()
        process.wait(30)
    slidectl.ok("daemon", "start", "--paused")
    assert slidectl("sim", "status").stderr == ""


@pytest.mark.parametrize("words", [("--ros1", "--websocket", "0"), ("--websocket", "0", "--ros1", "0")], ids=" ".join)
def test_an_option_without_its_value_may_stand_before_another_one(words: tuple[str, ...]) -> None:
    """Only the words are read here: the port of a gateway that is given none may be taken on this machine."""
    import click

    from slidectl.cli.daemon import start

    read = start.make_context("start", list(words), parent=click.Context(click.Group("daemon"))).params
    assert (read["ros1"], read["websocket"]) == (11311 if words[0] == "--ros1" else 0, 0)


def test_the_log_as_json_has_time_level_node_and_text(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start", "--paused")
    slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml")
    slidectl.ok("controller", "load", "joint1_position_controller")
    first, *others = map(json.loads, slidectl.ok("daemon", "logs", "--json").splitlines())
    assert (first["level"], first["node"]) == ("info", "")
    assert first["text"].startswith(f"slidectl {__version__} answers on ")
    assert first["line"] == f"{first['time']} info  {first['text']}"
    warning = next(one for one in others if one["level"] == "warn")
    assert warning["node"] == "/gazebo"
    assert warning["text"].startswith("/slider/joint1_position_controller/pid: i = 0.01 has no effect")
