"""Processes that read a file of somebody else: their limits, their end, and what they cannot do."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from waiting import eventually

from slidectl.confined import EndedError, Limits, run
from slidectl.operating_system import LINUX

LIMITS = Limits(cpu_s=1, wall_s=120, new_bytes=1 << 26)


def test_the_result_comes_back() -> None:
    assert run(lambda: b"x" * 3_000_000, LIMITS, 1 << 22) == b"x" * 3_000_000


def wait() -> bytes:
    signal.pause()
    return b"never"


def compute() -> bytes:
    while True:
        pass


def die() -> bytes:
    os.abort()


def fail() -> bytes:
    raise ZeroDivisionError


@pytest.mark.parametrize(
    ("work", "reason"),
    [
        (compute, "it takes more than 1 s"),
        (lambda: bytes(sum(range(10**12))), "it takes more than 1 s"),
        (wait, "it is not done within 1 s"),
        (die, "the process that read it was ended by SIGABRT"),
        (fail, "the process that read it failed"),
        (lambda: b"", "the process that read it failed"),
        (lambda: b"x" * (3 << 20), "its result exceeds 1 MiB"),
        pytest.param(
            lambda: bytes(1 << 32),  # more than a worker of tests can have free
            "the process that read it failed",
            marks=pytest.mark.skipif(not LINUX, reason="the memory of a process is not bounded here"),
        ),
    ],
)
def test_a_process_without_a_result_is_told_with_its_reason(
    work: Callable[[], bytes], reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(EndedError, match=f"^{reason}$"):
        run(work, Limits(1, 1 if work is wait else 120, 1 << 28), 1 << 20)
    assert capfd.readouterr() == ("", "")


def test_it_reads_files_and_does_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "there").write_text("content")

    def attempt() -> bytes:
        attempts: list[Callable[[], object]] = [
            lambda: (tmp_path / "new").write_text("x"),
            lambda: (tmp_path / "there").open("a"),
            lambda: os.open(tmp_path / "new", os.O_CREAT | os.O_WRONLY),
            lambda: os.unlink(tmp_path / "there"),
            lambda: os.rename(tmp_path / "there", tmp_path / "new"),
            lambda: os.system("true"),
            lambda: subprocess.run(["true"], check=False),
            lambda: os.execv("/bin/true", ["true"]),
            lambda: os.kill(os.getppid(), signal.SIGTERM),
            lambda: socket.create_connection(("127.0.0.1", 1)),
            lambda: ctypes.CDLL(None),
        ]
        done = [number for number, one in enumerate(attempts) if not is_refused(one)]
        read = (tmp_path / "there").read_text() + " ".join(os.listdir(tmp_path)) + os.read(0, 9).decode()
        return f"{done} {read}".encode()

    assert run(attempt, LIMITS, 1 << 20) == b"[] contentthere"


def is_refused(attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except PermissionError:
        return True
    return False


def test_it_has_no_open_files_of_its_parent(tmp_path: Path) -> None:
    with open(tmp_path / "file", "w") as file:
        number = file.fileno()

        def look() -> bytes:
            try:
                os.fstat(number)
            except OSError:
                return b"closed"
            return b"open"

        # The pipe of the result may have taken the number of a file that the parent had closed.
        assert run(look, LIMITS, 100) == b"closed"


def test_a_process_without_standard_streams_has_its_result_too(tmp_path: Path) -> None:
    program = """
import os
os.closerange(0, 3)
from slidectl.confined import Limits, run
with open("result", "wb") as file:
    file.write(run(lambda: b"done", Limits(50, 50, 1 << 30), 9))
"""
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    assert (tmp_path / "result").read_bytes() == b"done"


def test_an_exception_that_is_being_handled_changes_nothing_and_a_thread_may_run_it() -> None:
    results = []

    def work() -> None:
        try:
            raise ZeroDivisionError
        except ZeroDivisionError:
            results.append(run(lambda: b"done", LIMITS, 100))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    work()
    assert results == [b"done", b"done"]


def test_a_signal_of_the_terminal_is_for_its_parent() -> None:
    def work() -> bytes:
        for number in (signal.SIGINT, signal.SIGHUP):
            os.kill(os.getpid(), number)
        return b"done"

    assert run(work, LIMITS, 100) == b"done"


@pytest.mark.skipif(shutil.which("ps") is None, reason="ps is not installed")
def test_it_ends_with_its_parent_and_does_not_hold_its_output(tmp_path: Path) -> None:
    program = """
import signal
from slidectl.confined import Limits, run
run(lambda: signal.pause() or b"", Limits(50, 50, 1 << 30), 1)
"""
    started = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, cwd=tmp_path)
    try:
        children: list[str] = []
        end = time.monotonic() + 20
        while not children and time.monotonic() < end:
            found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(started.pid)], capture_output=True, text=True)
            children = found.stdout.split()
        assert children
        started.kill()
        assert started.stdout is not None
        assert started.stdout.read() == b""  # the end of the output, without waiting for the child
        eventually(lambda: not is_running(int(children[0])), "it is still running")
    finally:
        started.kill()
        started.wait()


def is_running(pid: int) -> bool:
    found = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout.strip()
    return bool(found) and not found.startswith("Z")
