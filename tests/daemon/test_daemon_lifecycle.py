"""Start, stop, restart after a crash, two at once, several side by side: with real processes."""

from __future__ import annotations

import ast
import json
import os
import resource
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from unittest import mock

import pytest
from daemon_fixture import Runtime, knows_peers
from rosbridge_wire import Wire

from slidectl import description, paths
from slidectl.client import Client
from slidectl.daemon import lifecycle
from slidectl.daemon.options import DaemonOptions, Start
from slidectl.errors import NoDaemon, Refused, TimedOut, UsageError

LIMIT_S = 20.0


def wait_for_end(pid: int) -> None:
    """Until the process has ended."""
    process = os.pidfd_open(pid)
    try:
        assert select.select([process], [], [], LIMIT_S)[0], f"process {pid} is still there"
    finally:
        os.close(process)


def start_text(runtime: Runtime, ready_fd: int | None = None) -> str:
    """How a daemon in the foreground is started, as the argument of its process."""
    return Start.at(runtime.paths, DaemonOptions(), foreground=True, ready_fd=ready_fd).text()


@pytest.fixture
def foreground(runtime: Runtime) -> Iterator[subprocess.Popen[str]]:
    """A daemon as `daemon run` makes it, ready."""
    read_end, write_end = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", "slidectl.daemon", start_text(runtime, ready_fd=write_end)],
        env=runtime.env,
        pass_fds=[write_end],
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(write_end)
    with process, os.fdopen(read_end) as ready:
        assert "ready" in ready.readline()
        yield process
        process.kill()


def test_a_started_daemon_answers_at_once(runtime: Runtime) -> None:
    pid, ran_already = runtime.start(timestep=0.002, rtf=2.0)
    assert not ran_already
    with runtime.client() as client:
        status = client.call("/slidectl/status")
    assert (status["pid"], status["timestep"], status["speed"], status["instance"]) == (pid, 0.002, 2.0, "default")
    assert (runtime.pid, status["log"]) == (pid, str(runtime.paths.log))


def test_starting_a_running_daemon_gives_the_one_that_runs(runtime: Runtime) -> None:
    pid, _ = runtime.start()
    assert runtime.start(paused=True) == (pid, True)


def test_stop_ends_the_process_and_leaves_only_the_log(runtime: Runtime) -> None:
    pid, _ = runtime.start()
    assert runtime.stop() == pid
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert [file.name for file in runtime.paths.folder.iterdir()] == ["log"]
    assert runtime.pid is None


def test_two_starts_at_once_give_one_daemon(runtime: Runtime) -> None:
    script = (
        "from slidectl import paths; from slidectl.daemon import lifecycle; print(lifecycle.start(paths.instance()))"
    )

    def start() -> str:
        return subprocess.run([sys.executable, "-c", script], env=runtime.env, capture_output=True, text=True).stdout

    with ThreadPoolExecutor(4) as pool:
        results = [ast.literal_eval(future.result()) for future in [pool.submit(start) for _ in range(4)]]
    assert {pid for pid, _ in results} == {runtime.pid}
    assert sorted(ran_already for _, ran_already in results) == [False, True, True, True]


def test_after_kill_9_the_next_start_cleans_up_and_runs(runtime: Runtime) -> None:
    pid, _ = runtime.start()
    os.kill(pid, signal.SIGKILL)
    wait_for_end(pid)
    assert runtime.paths.socket.exists()
    assert runtime.pid is None
    with pytest.raises(NoDaemon):
        runtime.client()
    second, ran_already = runtime.start()
    assert (second != pid, ran_already) == (True, False)
    runtime.client().close()


def test_instances_live_side_by_side(runtime: Runtime) -> None:
    other = Runtime(runtime.folder, "other")
    first, _ = runtime.start(paused=True)
    second, _ = other.start(paused=True)
    assert first != second
    with runtime.client() as client, other.client() as other_client:
        client.call("/slidectl/step", {"cycles": 5})
        assert client.call("/slidectl/status")["cycles"] == 5
        assert other_client.call("/slidectl/status")["cycles"] == 0
    other.stop()
    assert runtime.pid == first


def test_a_socket_of_any_name_has_its_own_daemon(runtime: Runtime) -> None:
    with runtime.environment():
        named = paths.instance(socket=str(runtime.folder / "robot.sock"))
        lifecycle.start(named)
        with Client(socket=str(named.socket)) as client:
            assert client.call("/slidectl/status")["instance"] == "robot.sock"
        assert lifecycle.stop(named) is not None
    assert sorted(file.name for file in runtime.folder.iterdir()) == ["robot.sock.log"]


def test_a_file_that_is_no_socket_is_left_alone(runtime: Runtime) -> None:
    runtime.paths.folder.mkdir(mode=0o700, parents=True)
    runtime.paths.socket.write_text("precious")
    with pytest.raises(Refused, match="is not a socket"):
        runtime.start()
    assert runtime.paths.socket.read_text() == "precious"
    assert runtime.pid is None


@knows_peers
def test_a_living_socket_is_never_taken_over_even_without_its_lock(runtime: Runtime) -> None:
    pid, _ = runtime.start()
    runtime.paths.lock.unlink()
    with pytest.raises(Refused, match=str(pid)):
        runtime.start()
    with runtime.client() as client:
        assert client.daemon_pid == pid
        client.call("/slidectl/shutdown")
    wait_for_end(pid)


def test_a_stop_that_nobody_answers_falls_back_on_a_signal(runtime: Runtime) -> None:
    pid, _ = runtime.start()
    runtime.paths.socket.unlink()
    assert runtime.stop() == pid
    assert runtime.pid is None


def test_a_daemon_that_hangs_is_named_with_the_way_to_end_it(runtime: Runtime) -> None:
    pid, _ = runtime.start()
    os.kill(pid, signal.SIGSTOP)
    open_before = os.listdir("/proc/self/fd")
    with runtime.environment(), pytest.raises(TimedOut, match=f"kill -KILL {pid}"):
        lifecycle.stop(runtime.paths, timeout=0.2)
    assert os.listdir("/proc/self/fd") == open_before
    os.kill(pid, signal.SIGCONT)  # and now the signal that was sent arrives
    wait_for_end(pid)


def test_a_start_that_fails_tells_why(runtime: Runtime) -> None:
    broken = runtime.folder / "broken" / "mujoco.py"
    broken.parent.mkdir()
    broken.write_text("raise ImportError('libmujoco is gone')")
    runtime.env["PYTHONPATH"] = f"{broken.parent}:{runtime.env['PYTHONPATH']}"
    with pytest.raises(Refused, match="libmujoco is gone"):
        runtime.start()
    assert [file.name for file in runtime.paths.folder.iterdir()] == ["log"]


def test_options_that_make_no_sense_are_usage_errors() -> None:
    for wrong in (
        {"rtf": 0.0},
        {"rtf": -1.0},
        {"rtf": float("nan")},
        {"timestep": 0.0},
        {"gravity": (0, 0, float("nan"))},
    ):
        with pytest.raises(UsageError):
            DaemonOptions(**wrong)  # type: ignore[arg-type]


def test_the_folder_of_the_daemon_is_private(runtime: Runtime) -> None:
    runtime.start()
    assert runtime.paths.folder.stat().st_mode & 0o777 == 0o700
    assert runtime.paths.socket.stat().st_mode & 0o777 == 0o600
    assert runtime.paths.log.stat().st_mode & 0o777 == 0o600


def test_a_folder_that_is_open_to_others_is_refused_by_both_sides(runtime: Runtime) -> None:
    runtime.paths.folder.mkdir(parents=True)
    runtime.paths.folder.chmod(0o755)
    with pytest.raises(Refused, match="chmod 700"):
        runtime.start()
    with pytest.raises(Refused, match="chmod 700"):
        runtime.client()


@pytest.mark.parametrize("mode", [0o755, 0o1777])  # as a home is, or the temporary folder
def test_a_socket_in_a_folder_that_others_can_read_is_refused_without_advice_that_would_close_it(
    runtime: Runtime, mode: int
) -> None:
    runtime.folder.chmod(mode)
    with runtime.environment(), pytest.raises(Refused, match="a folder of your own") as caught:
        lifecycle.start(paths.instance(socket=str(runtime.folder / "robot.sock")))
    assert f"chmod 700 {runtime.folder}" not in str(caught.value)


def test_where_no_named_socket_is_nobody_answers_whatever_the_folder(runtime: Runtime) -> None:
    runtime.folder.chmod(0o755)
    with runtime.environment(), pytest.raises(NoDaemon):
        Client(socket=str(runtime.folder / "robot.sock"))


@pytest.mark.parametrize("base", ["/proc", "/dev/null"])
def test_a_runtime_folder_that_cannot_be_made_is_named_with_the_reason(runtime: Runtime, base: str) -> None:
    runtime.env["XDG_RUNTIME_DIR"] = base
    with runtime.environment(), pytest.raises(Refused, match=f"cannot make the folder {base}/slidectl/default") as it:
        lifecycle.start(paths.instance())
    assert "XDG_RUNTIME_DIR" in str(it.value)


def test_a_runtime_folder_may_be_relative(runtime: Runtime, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(runtime.folder.parent)
    runtime.env["XDG_RUNTIME_DIR"] = runtime.folder.name
    pid, _ = runtime.start(paused=True)
    assert runtime.pid == pid


def test_a_file_in_the_place_of_the_folder_is_refused(runtime: Runtime) -> None:
    runtime.paths.folder.parent.mkdir()
    runtime.paths.folder.touch()
    with pytest.raises(Refused, match="is not a folder"):
        runtime.start()


def test_a_folder_of_instances_that_others_may_write_is_refused(runtime: Runtime) -> None:
    runtime.paths.folder.parent.mkdir()
    runtime.paths.folder.parent.chmod(0o777)
    with pytest.raises(Refused, match="can be written by other users"):
        runtime.start()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_instances_of_another_user_is_refused(runtime: Runtime) -> None:
    runtime.paths.folder.parent.mkdir()
    os.chown(runtime.paths.folder.parent, 65534, 65534)
    with pytest.raises(Refused, match="belongs to another user"):
        runtime.start()


def test_the_daemon_keeps_nothing_of_its_starter(runtime: Runtime) -> None:
    with socket.socket() as inherited:
        inherited.set_inheritable(True)
        pid, _ = runtime.start()
        links = set()
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(FileNotFoundError):  # it has been closed meanwhile
                links.add(os.readlink(entry))
        assert f"socket:[{os.fstat(inherited.fileno()).st_ino}]" not in links
    assert os.readlink(f"/proc/{pid}/cwd") == "/"
    assert os.readlink(f"/proc/{pid}/fd/0") == "/dev/null"
    assert os.readlink(f"/proc/{pid}/fd/2") == str(runtime.paths.log)
    assert os.getsid(pid) == pid


def test_the_end_waits_for_readers_who_read_and_not_for_others(runtime: Runtime) -> None:
    pid, _ = runtime.start(paused=True)
    with Wire(runtime.paths.socket) as reader, Wire(runtime.paths.socket) as sleeper, runtime.client() as client:
        for wire in (reader, sleeper):
            wire.send(op="subscribe", topic="/clock", queue_length=50_000)
            wire.call("/rosapi/get_time")
        client.step(cycles=20_000)
        client.call("/slidectl/shutdown")
        *received, last = reader.rest()
        assert [message["op"] for message in received] == ["publish"] * 20_000
        assert last["msg"] == "the daemon was asked to stop"
        wait_for_end(pid)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_running_daemon_cleanly(
    runtime: Runtime, foreground: subprocess.Popen[str], number: signal.Signals
) -> None:
    with runtime.client() as client:
        foreground.send_signal(number)
        with pytest.raises(NoDaemon, match=f"went away: .*{number.name}"):
            list(client.events())
    _, errors = foreground.communicate(timeout=LIMIT_S)
    assert foreground.returncode == 0
    assert f"stopped by {number.name}" in errors
    assert [file.name for file in runtime.paths.folder.iterdir()] == ["log"]
    assert f"stopped by {number.name}" in runtime.log


def test_sigterm_ends_a_step_of_a_million_cycles(runtime: Runtime, foreground: subprocess.Popen[str]) -> None:
    with runtime.client() as client:
        call = client.call_async("/slidectl/step", {"cycles": 100_000_000})
        client.flush()
        foreground.send_signal(signal.SIGTERM)
        with pytest.raises(NoDaemon, match="SIGTERM"):
            client.answer(call)
    assert foreground.wait(LIMIT_S) == 0


def test_running_in_the_foreground_where_a_daemon_runs_says_so(runtime: Runtime) -> None:
    pid, _ = runtime.start()
    second = subprocess.run(
        [sys.executable, "-m", "slidectl.daemon", start_text(runtime)], env=runtime.env, capture_output=True, text=True
    )
    assert second.returncode == 0
    assert str(pid) in second.stderr
    assert runtime.pid == pid


def test_run_becomes_the_daemon(runtime: Runtime) -> None:
    script = "from slidectl import paths; from slidectl.daemon import lifecycle; lifecycle.run(paths.instance())"
    process = subprocess.Popen([sys.executable, "-c", script], env=runtime.env, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    with process:
        assert "answers on" in process.stderr.readline()
        assert runtime.pid == process.pid
        process.terminate()
        assert process.wait(LIMIT_S) == 0


def test_the_log_has_what_goes_out_on_rosout(runtime: Runtime) -> None:
    runtime.start(paused=True)
    with runtime.client() as client:
        client.call("/gazebo/spawn_urdf_model", {"model_name": "slider", "model_xml": description.load("slider").xml})
        with client.subscribe("/rosout") as lines:
            assert client.call("/slider/controller_manager/load_controller", {"name": "nobody"}) == {"ok": False}
            assert lines.get()["msg"] in runtime.log


def test_a_log_that_cannot_be_written_harms_nobody(runtime: Runtime) -> None:
    runtime.paths.folder.mkdir(mode=0o700, parents=True)
    runtime.paths.log.symlink_to("/dev/full")
    runtime.start(paused=True)
    with runtime.client() as client:
        assert client.call("/slidectl/step", {"cycles": 10})["success"]
    assert runtime.stop() is not None


def wait_until_found(runtime: Runtime, pid: int) -> None:
    """Until the daemon of this process can be found again."""
    end = time.monotonic() + LIMIT_S
    while runtime.pid != pid or not runtime.paths.socket.exists():
        assert time.monotonic() < end, "the daemon does not mend its place"
        select.select([], [], [], 0.02)


@pytest.mark.parametrize("gone", ["lock", "socket", "instance", "slidectl"])
def test_a_daemon_whose_files_are_deleted_makes_them_again_and_says_so(runtime: Runtime, gone: str) -> None:
    pid, _ = runtime.start(paused=True)
    with runtime.client() as before:
        folder = runtime.paths.folder
        if gone in ("lock", "socket"):
            (folder / gone).unlink()
        else:
            shutil.rmtree(folder if gone == "instance" else folder.parent)
        wait_until_found(runtime, pid)
        assert before.call("/slidectl/status")["pid"] == pid
    with runtime.client() as client:
        assert client.call("/slidectl/status")["pid"] == pid
    assert "deleted by another program, created again: its " in runtime.log
    assert runtime.start() == (pid, True)
    assert runtime.stop() == pid
    assert [file.name for file in runtime.paths.folder.iterdir()] == ["log"]


def test_a_daemon_whose_place_another_has_taken_ends_and_leaves_it_its_files(runtime: Runtime) -> None:
    first, _ = runtime.start(paused=True)
    os.kill(first, signal.SIGSTOP)
    runtime.paths.lock.unlink()
    runtime.paths.socket.unlink()
    second, already = runtime.start(paused=True)
    assert not already
    os.kill(first, signal.SIGCONT)
    wait_for_end(first)
    assert f"another daemon (process {second}) has taken this place" in runtime.log
    with runtime.client() as client:
        assert client.call("/slidectl/status")["pid"] == second
    assert runtime.stop() == second


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make another user's link")
def test_a_runtime_folder_that_is_another_users_link_is_not_entered(tmp_path: Path) -> None:
    ours = tmp_path / "ours"
    ours.mkdir(mode=0o700)
    link = tmp_path / f"slidectl-{os.getuid()}"
    link.symlink_to(ours)
    os.lchown(link, 65534, 65534)
    environment = {key: value for key, value in os.environ.items() if key != "XDG_RUNTIME_DIR"}
    with (
        mock.patch.dict(os.environ, environment | {"TMPDIR": str(tmp_path)}, clear=True),
        pytest.raises(Refused, match=r"is a symbolic link of another user \(uid 65534\)"),
    ):
        lifecycle.start(paths.instance())
    assert list(ours.iterdir()) == []


def slidectl(runtime: Runtime, *words: bytes | str, **env: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "slidectl", *words], env=runtime.env | env, capture_output=True, timeout=60, check=False
    )


def test_commands_work_in_a_folder_whose_name_is_no_utf8_and_a_locale_that_knows_ascii() -> None:
    folder = tempfile.mkdtemp(prefix=os.fsdecode(b"slidectl-\xff"), dir="/tmp")
    runtime = Runtime(Path(folder))
    try:
        for env in ({}, {"LC_ALL": "C"}):
            for words in (["daemon", "start"], ["daemon", "status"], ["param", "set", "/x", "é".encode()]):
                done = slidectl(runtime, *words, **env)
                assert done.returncode == 0, (words, env, done)
            status = json.loads(slidectl(runtime, "daemon", "status", "--json", **env).stdout)
            assert os.fsencode(status["socket"]) == os.fsencode(runtime.paths.socket)
            with runtime.client() as client:
                assert client.call("/rosapi/get_param", {"name": "/x"})["value"] == json.dumps("é")
            assert slidectl(runtime, "daemon", "stop", **env).returncode == 0
    finally:
        runtime.remove()


@pytest.mark.parametrize("limit", [6, 12, 20])
def test_a_daemon_that_may_open_few_files_is_not_started_and_says_why(runtime: Runtime, limit: int) -> None:
    script = f"ulimit -n {limit}; exec {sys.executable} -m slidectl daemon start"
    done = subprocess.run(
        ["sh", "-c", script], env=runtime.env, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stdout + done.stderr
    assert "raise it: ulimit -n 1024" in done.stderr
    assert runtime.pid is None


@pytest.mark.parametrize("limit", [7, 12])
def test_a_command_that_may_open_few_files_works_or_says_why(runtime: Runtime, limit: int) -> None:
    runtime.start(paused=True)
    script = f"ulimit -n {limit}; exec {sys.executable} -m slidectl topic list"
    done = subprocess.run(
        ["sh", "-c", script], env=runtime.env, capture_output=True, text=True, timeout=60, check=False
    )
    assert "Traceback" not in done.stderr
    assert done.returncode == 0 or "raise it: ulimit -n 1024" in done.stderr


def test_a_daemon_without_file_descriptors_waits_for_one_and_does_not_spin(runtime: Runtime) -> None:
    pid, _ = runtime.start(paused=True)
    client = runtime.client()
    assert client.call("/rosapi/get_time")  # its files are read
    used = len(os.listdir(f"/proc/{pid}/fd"))
    _, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (used, hard))
    waiting = socket.socket(socket.AF_UNIX)
    with client, waiting:
        waiting.connect(str(runtime.paths.socket))
        assert client.call("/rosapi/get_time")
        before = Path(f"/proc/{pid}/stat").read_text().split()[13:15]
        for _ in range(3):
            select.select([waiting], [], [], 0.1)
        after = Path(f"/proc/{pid}/stat").read_text().split()[13:15]
        assert sum(map(int, after)) - sum(map(int, before)) < 15  # hundredths of a second; a loop that spins takes 30
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (1024, hard))
        waiting.sendall(b'{"op": "call_service", "service": "/rosapi/get_time"}\n')
        waiting.settimeout(LIMIT_S)
        assert b"service_response" in waiting.recv(65536)
    assert runtime.log.count("cannot accept") == 1
