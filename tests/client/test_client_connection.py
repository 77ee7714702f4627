"""Connecting, and all the ways in which a daemon can fail a client."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import pytest
from daemon_fixture import Runtime, knows_peers

from slidectl.client import Client
from slidectl.errors import NoDaemon, Refused, TimedOut, UsageError


def listen_without_answering(runtime: Runtime) -> socket.socket:
    """A socket where a daemon's would be: connections are queued and nobody accepts them."""
    runtime.paths.folder.mkdir(mode=0o700, parents=True)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(runtime.paths.socket))
    listener.listen(8)
    return listener


def test_without_a_daemon_the_error_says_how_to_start_one(runtime: Runtime) -> None:
    with pytest.raises(NoDaemon, match="daemon start") as failure:
        runtime.client()
    assert str(runtime.paths.socket) in failure.value.message
    assert failure.value.exit_code == 3


def test_the_command_that_helps_names_the_instance_or_the_socket(runtime: Runtime) -> None:
    with runtime.environment():
        with pytest.raises(NoDaemon, match="slidectl -i lab daemon start"):
            Client("lab")
        path = runtime.folder / "robot.sock"
        with pytest.raises(NoDaemon, match=f"slidectl --socket {path} daemon start"):
            Client(socket=str(path))


def test_the_environment_picks_the_daemon(runtime: Runtime) -> None:
    with listen_without_answering(runtime):
        os.rename(runtime.paths.folder, runtime.paths.folder.with_name("lab"))
        for variable, value in (
            ("SLIDECTL_INSTANCE", "lab"),
            ("SLIDECTL_SOCKET", str(runtime.paths.folder.with_name("lab") / "socket")),
        ):
            with runtime.environment(), pytest.MonkeyPatch.context() as patch:
                patch.setenv(variable, value)
                Client().close()


def test_a_name_that_is_no_file_name_is_a_usage_error() -> None:
    with pytest.raises(UsageError):
        Client("../other")


@knows_peers
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_daemon_of_another_user_is_refused(runtime: Runtime) -> None:
    runtime.paths.folder.mkdir(mode=0o700, parents=True)
    ready, done = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(runtime.paths.socket))
        os.seteuid(65534)
        listener.listen(1)  # whoever listens is whom the kernel names as the peer
        os.write(ready[1], b"x")
        os.read(done[0], 1)
        os._exit(0)
    os.read(ready[0], 1)
    with pytest.raises(Refused, match="another user"):
        runtime.client()
    os.write(done[1], b"x")
    os.waitpid(child, 0)
    for fd in (*ready, *done):
        os.close(fd)


def test_a_daemon_that_does_not_answer_times_out(runtime: Runtime) -> None:
    with listen_without_answering(runtime), runtime.client(timeout=0.05) as client:
        with pytest.raises(TimedOut, match="does not answer") as failure:
            client.call("/slidectl/status")
        assert failure.value.exit_code == 4


def test_a_daemon_that_does_not_read_times_out(runtime: Runtime) -> None:
    with listen_without_answering(runtime), runtime.client(timeout=0.05) as client:
        with pytest.raises(TimedOut, match="does not read"):
            client.publish("/x", {"data": "x" * 5_000_000})
        client.close()


def test_a_full_backlog_is_waited_for_and_then_is_no_daemon(runtime: Runtime) -> None:
    with listen_without_answering(runtime) as listener:
        listener.listen(0)
        with runtime.client(), pytest.raises(NoDaemon, match="accepts no connections: it hangs") as caught:
            runtime.client(timeout=0.05)
        assert "daemon start" not in str(caught.value)
        assert "daemon stop" in str(caught.value)


def test_a_daemon_that_dies_is_noticed_by_whoever_waits(runtime: Runtime) -> None:
    runtime.start(paused=True)
    with runtime.client() as client:
        clock = client.subscribe("/clock")
        os.kill(client.daemon_pid, signal.SIGKILL)
        with pytest.raises(NoDaemon, match="the daemon went away"):
            next(clock)
        with pytest.raises(NoDaemon, match=r"start it with: slidectl .*daemon start"):
            client.call("/slidectl/status")
        with pytest.raises(NoDaemon):
            client.publish("/x", {"data": "x" * 1_000_000})
        clock.close()


def test_messages_that_arrived_before_the_daemon_died_are_still_read(runtime: Runtime) -> None:
    runtime.start(paused=True)
    with runtime.client() as client:
        clock = client.subscribe("/clock")
        client.call("/slidectl/step", {"cycles": 3})
        os.kill(client.daemon_pid, signal.SIGKILL)
        assert [clock.get()["clock"]["nsecs"] for _ in range(3)] == [1_000_000, 2_000_000, 3_000_000]
        with pytest.raises(NoDaemon):
            clock.get()


def test_a_daemon_that_is_stopped_says_goodbye(runtime: Runtime) -> None:
    runtime.start()
    with runtime.client() as client, runtime.client() as other:
        other.call("/slidectl/shutdown")
        with pytest.raises(NoDaemon, match="went away: the daemon was asked to stop"):
            list(client.events())


def test_ctrl_c_ends_a_wait_at_once(runtime: Runtime) -> None:
    runtime.start(paused=True)
    script = (
        "from slidectl import Client\n"
        "with Client() as client:\n"
        "    clock = client.subscribe('/clock')\n"
        "    print('waiting', flush=True)\n"
        "    next(clock)\n"
    )
    waiting = subprocess.Popen(
        [sys.executable, "-c", script], env=runtime.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with waiting:
        assert waiting.stdout is not None
        assert waiting.stdout.readline() == "waiting\n"
        waiting.send_signal(signal.SIGINT)
        _, errors = waiting.communicate(timeout=20)
    assert errors.rstrip().endswith("KeyboardInterrupt")


def test_importing_the_client_imports_only_the_standard_library(runtime: Runtime) -> None:
    script = (
        "import sys; before = set(sys.modules); import slidectl.client\n"
        "names = {name.partition('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names)\n"
        "slow = {'asyncio', 'threading', 'subprocess', 'logging', 'argparse'}\n"
        "print(names, slow & set(sys.modules))"
    )
    told = subprocess.run([sys.executable, "-c", script], env=runtime.env, capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "{'slidectl'} set()"
