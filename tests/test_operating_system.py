"""What Linux alone has, and the portable ways beside it: both do the same where both can."""

from __future__ import annotations

import errno
import fcntl
import importlib.util
import os
import resource
import select
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from waiting import eventually

from slidectl import operating_system

PORTABLE = "portable"


@pytest.fixture(params=["of Linux", PORTABLE])
def ways(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module, as a process imports it whose environment has the variable or has not."""
    monkeypatch.setenv(operating_system.PORTABLE, "1" if request.param == PORTABLE else "")
    spec = importlib.util.spec_from_file_location("ways", operating_system.__file__)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert (sys.platform == "linux" and request.param != PORTABLE) == module.LINUX
    return module


def test_an_arrival_is_reported_once_until_all_was_read(ways: ModuleType) -> None:
    poll, is_ready, read_all = ways.poller()
    here, there = socket.socketpair()
    with here, there:
        here.setblocking(False)
        fd = here.fileno()
        poll.register(fd, ways.READ | ways.ONCE)
        assert not is_ready(0.0)
        assert list(poll.poll(0.0)) == []
        there.send(b"one")
        assert is_ready(10.0)
        [(ready, events)] = poll.poll(10.0)
        assert (ready, events & ways.READ) == (fd, ways.READ)
        assert list(poll.poll(0.0)) == []
        assert here.recv(100) == b"one"
        there.send(b"two")  # between the last read and the word that all was read
        read_all(fd)
        assert [ready for ready, _ in poll.poll(10.0)] == [fd]
        poll.modify(fd, ways.READ | ways.WRITE | ways.ONCE)
        [(_, events)] = poll.poll(10.0)
        assert events & ways.WRITE
        poll.unregister(fd)
        assert not is_ready(0.0)
    poll.close()


def test_the_end_of_the_other_side_is_reported(ways: ModuleType) -> None:
    poll, _, _ = ways.poller()
    here, there = socket.socketpair()
    with here:
        poll.register(here.fileno(), ways.READ | ways.ONCE)
        there.shutdown(socket.SHUT_WR)
        [(_, events)] = poll.poll(10.0)
        assert events & (ways.READ | ways.PEER_CLOSED)
        assert not events & ways.HANG_UP  # it still reads
        there.close()
        [(_, events)] = poll.poll(10.0)
        assert events & ways.HANG_UP
    poll.close()


def test_the_peer_of_a_socket_is_told_or_unknown(ways: ModuleType) -> None:
    here, there = socket.socketpair()
    with here, there:
        assert ways.peer(here) == ((os.getpid(), os.geteuid()) if ways.LINUX else (0, None))


def test_the_end_of_a_child_and_its_code(ways: ModuleType) -> None:
    for text, code in (("raise SystemExit(3)", 3), ("import os; os.kill(os.getpid(), 9)", -9)):
        child = subprocess.Popen([sys.executable, "-c", f"input(); {text}"], stdin=subprocess.PIPE)
        end = ways.ProcessEnd(child.pid)
        assert select.select([end], [], [], 0.0)[0] == []
        assert child.stdin is not None
        child.stdin.write(b"\n")
        child.stdin.close()
        assert select.select([end], [], [], 60.0)[0] == [end]
        assert end.code() == code
        end.close()
        child.wait()


def test_the_end_of_a_process_that_is_no_child(ways: ModuleType) -> None:
    """Here it is a grandchild, whose parent waits for it."""
    waits = "import subprocess, sys; one = subprocess.Popen(['sleep', '600']); print(one.pid, flush=True); one.wait()"
    parent = subprocess.Popen([sys.executable, "-c", waits], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    with parent:
        end = ways.ProcessEnd(pid)
        assert select.select([end], [], [], 0.0)[0] == []
        end.send_signal(signal.SIGTERM)
        assert select.select([end], [], [], 60.0)[0] == [end]
        end.close()
    with pytest.raises(ProcessLookupError):
        ways.ProcessEnd(pid)


def test_a_process_ends_with_its_parent(ways: ModuleType, tmp_path: Path) -> None:
    told = tmp_path / "pid"
    child = (
        "import os, sys, time; from slidectl.operating_system import end_with; assert end_with(os.getppid(), 15); "
        f"open({str(told)!r}, 'w').write(f'{{os.getpid()}}.'); time.sleep(600)"
    )
    parent = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
    environment = {**os.environ, operating_system.PORTABLE: "" if ways.LINUX else "1"}
    process = subprocess.Popen([sys.executable, "-c", parent], env=environment)
    eventually(lambda: told.exists() and told.read_text().endswith("."), "the child does not start")
    pid = int(told.read_text()[:-1])
    assert ways.is_there(pid)
    process.kill()
    process.wait()
    eventually(lambda: _is_gone(pid), "the child stays")


def _is_gone(pid: int) -> bool:
    """True for a zombie too: whoever takes orphans over may be slow to wait for them."""
    try:
        return "Z" in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return True


def test_the_words_and_the_name_of_a_process(ways: ModuleType) -> None:
    if not ways.LINUX and shutil.which("ps") is None:
        pytest.skip("ps is not installed")
    child = subprocess.Popen(["sleep", "600"])
    try:
        eventually(lambda: ways.command_line(child.pid) == "sleep 600", "its command line is another")
        assert ways.program_name(child.pid) == "sleep"
    finally:
        child.kill()
        child.wait()
    assert ways.command_line(child.pid) == ways.program_name(child.pid) == ""


def test_who_holds_a_lock(ways: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "lock"
    holds = (
        "import fcntl, os; fd = os.open('lock', os.O_RDWR | os.O_CREAT); fcntl.lockf(fd, fcntl.LOCK_EX); "
        "print(flush=True); input()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", holds], cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with open(path, "rb+", buffering=0) as file:
            assert ways.lock_holder(file) == holder.pid
    with open(path, "rb+", buffering=0) as file:
        assert ways.lock_holder(file) is None
        fcntl.lockf(file, fcntl.LOCK_EX)  # one's own is nobody else's
        assert ways.lock_holder(file) is None


def test_a_file_in_memory_is_opened_by_a_child(ways: ModuleType) -> None:
    file, path = ways.memory_file("test")
    with file:
        file.write(b"content")
        file.flush()
        words = ["cat", path]
        assert subprocess.run(words, pass_fds=[file.fileno()], capture_output=True).stdout == b"content"
    assert not os.path.exists(path)


def test_room_on_the_disk_is_there_or_refused(ways: ModuleType, tmp_path: Path) -> None:
    with open(tmp_path / "file", "wb") as file:
        ways.reserve_space(file.fileno(), 1000)
        with pytest.raises(OSError) as caught:  # noqa: PT011 - the number tells it
            ways.reserve_space(file.fileno(), 1 << 60)
    assert caught.value.errno in (errno.ENOSPC, errno.EFBIG)


def test_memory_is_told_and_bounded_where_it_can_be(ways: ModuleType) -> None:
    assert 1 << 20 < ways.resident_bytes() < 1 << 40
    before = resource.getrlimit(resource.RLIMIT_AS)
    ways.limit_new_memory(1 << 40)
    assert (resource.getrlimit(resource.RLIMIT_AS) == before) == (not ways.LINUX)
    resource.setrlimit(resource.RLIMIT_AS, before)
    assert ways.usable_cores() >= 1
    ways.set_timer_slack(ways.set_timer_slack(1))


def test_a_silent_peer_is_probed(ways: ModuleType) -> None:
    with socket.socket() as one:
        for option, value in ways.keepalive(60, 10, 9):
            one.setsockopt(socket.IPPROTO_TCP, option, value)
            assert one.getsockopt(socket.IPPROTO_TCP, option) == value
