"""What Linux alone offers, each with a portable way beside it. No other module calls anything that only Linux has.

The choice is made once, at import. The environment variable SLIDECTL_PORTABLE forces the portable ways on Linux, which
is how the tests run them; what starts in such a process has it too. Everyday commands import this module: everything
but the basic modules is imported inside of functions.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO, cast

if TYPE_CHECKING:
    from io import FileIO

PORTABLE = "SLIDECTL_PORTABLE"
"""The environment variable that forces the portable ways; empty and 0 do not."""
LINUX = sys.platform == "linux" and os.environ.get(PORTABLE, "") in ("", "0")
"""True when Linux's own ways are taken."""

OPEN_FILES = ("/dev/fd", "/proc/self/fd")
"""Folders of a process's own open files, in which a shell's `<(...)` is. The second one exists on Linux alone."""


# --- events of sockets and pipes --------------------------------------------------------------------------------------

READ = select.POLLIN
WRITE = select.POLLOUT
HANG_UP = select.POLLHUP | select.POLLERR
PEER_CLOSED = 0
"""The other end sends no more. A portable system tells it as READ: there is nothing to read then."""
ONCE = 1 << 31
"""Report each arrival once, not as long as data is there. Only in this mode do events come in order of arrival, where
the system tells the order."""

if LINUX:
    READ, WRITE, HANG_UP = select.EPOLLIN, select.EPOLLOUT, select.EPOLLHUP | select.EPOLLERR
    PEER_CLOSED = select.EPOLLRDHUP
    ONCE = select.EPOLLET | PEER_CLOSED


class PortablePoll:
    """The part of `select.epoll` that the event loop uses, on poll(2) and select(2)."""

    def __init__(self) -> None:
        self._poll = select.poll()
        self._watched: dict[int, int] = {}
        """The events that are wanted of a descriptor, with ONCE."""
        self._armed: dict[int, int] = {}
        """Those that are asked for now: READ is left out after it was reported ONCE."""

    def register(self, fd: int, events: int) -> None:
        """Watch a descriptor."""
        self._watched[fd] = events
        self._arm(fd, events & ~ONCE)

    modify = register

    def unregister(self, fd: int) -> None:
        """Watch a descriptor no more."""
        del self._watched[fd], self._armed[fd]
        self._poll.unregister(fd)

    def read_all(self, fd: int) -> None:
        """Report the next arrival, ONCE: all that had come was read."""
        if not self._armed[fd] & READ:
            self._arm(fd, self._armed[fd] | READ)

    def poll(self, wait_s: float) -> list[tuple[int, int]]:
        """The descriptors with ready events, after a wait of at most that long, rounded up to milliseconds."""
        ready = self._poll.poll(1000.0 * wait_s)
        for fd, events in ready:
            if events & READ and self._watched[fd] & ONCE:
                self._arm(fd, self._armed[fd] & ~READ)
        return ready

    def is_ready(self, wait_s: float) -> bool:
        """True when `poll` has something to report, after a wait of at most that long, to the microsecond."""
        reading = [fd for fd, events in self._armed.items() if events & READ]
        writing = [fd for fd, events in self._armed.items() if events & WRITE]
        try:
            return any(select.select(reading, writing, (), wait_s))
        except ValueError:  # a descriptor beyond those that select(2) can name
            return bool(self._poll.poll(1000.0 * wait_s))

    def close(self) -> None:
        """Watch nothing any more."""
        self._watched.clear()
        self._armed.clear()

    def _arm(self, fd: int, events: int) -> None:
        self._armed[fd] = events
        self._poll.register(fd, events)


def poller() -> tuple[select.epoll | PortablePoll, Callable[[float], object], Callable[[int], None]]:
    """What the event loop watches descriptors with.

    Returns:
        An epoll or its stand-in; whether that has something to report, after a wait in s, to the microsecond; and what
        is called with a descriptor that is watched ONCE, when all that had come was read.
    """
    if not LINUX:
        portable = PortablePoll()
        return portable, portable.is_ready, portable.read_all
    epoll = select.epoll()
    waiting = [epoll.fileno()]  # epoll's own wait is in whole milliseconds
    return epoll, lambda wait_s: select.select(waiting, (), (), wait_s)[0], lambda _: None


# --- the other end of a Unix socket -----------------------------------------------------------------------------------

_SOL_LOCAL, _LOCAL_PEERCRED, _LOCAL_PEERPID = 0, 1, 2
_XUCRED = struct.Struct("=IIh2x16I")
"""struct xucred of macOS and the BSDs: version, uid, number of groups, groups."""


def peer(connection: socket.socket) -> tuple[int, int | None]:
    """Process id and user id of the process at the other end, from the kernel.

    The process id is 0, and the user id None, where the kernel does not tell: then the permissions of the socket and of
    its folder alone keep other users out.
    """
    if LINUX:
        size = struct.calcsize("3i")
        pid, uid, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
        return pid, uid
    if sys.platform == "linux":
        return 0, None
    uid = pid = None
    with suppress(OSError, struct.error):
        uid = _XUCRED.unpack(connection.getsockopt(_SOL_LOCAL, _LOCAL_PEERCRED, _XUCRED.size))[1]
        if sys.platform == "darwin":
            pid = connection.getsockopt(_SOL_LOCAL, _LOCAL_PEERPID)
    return pid or 0, uid


def keepalive(idle_s: int, interval_s: int, count: int) -> list[tuple[int, int]]:
    """Options of a TCP socket, with their values: probe a silent peer after a time, and give up after some probes."""
    idle = getattr(socket, "TCP_KEEPIDLE" if LINUX else "TCP_KEEPALIVE", None)
    pairs = (
        (idle, idle_s),
        (getattr(socket, "TCP_KEEPINTVL", None), interval_s),
        (getattr(socket, "TCP_KEEPCNT", None), count),
    )
    return [(option, value) for option, value in pairs if option is not None]


# --- processes --------------------------------------------------------------------------------------------------------

_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29
_M_MMAP_THRESHOLD = -3
_LOOK_EVERY_S = 0.1
_LINUX_FLOCK = struct.Struct("hhqqi4x")
"""struct flock of a 64-bit Linux: type, whence, start, length, pid."""
_BSD_FLOCK = struct.Struct("qqihh4x")
"""struct flock of macOS and the BSDs: start, length, pid, type, whence, and an id of a host on some."""


class ProcessEnd:
    """Tells when a process ends: `fileno` is readable then. `code` is for children alone.

    On Linux this is a descriptor of the process, so that an id that is used again does no harm, and a child stays a
    zombie. Elsewhere a thread waits for the process, and a child is reaped.

    Raises:
        ProcessLookupError: there is no such process.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._status: int | None = None
        if LINUX:
            self._descriptor = os.pidfd_open(pid)
            return
        if not is_there(pid):
            raise ProcessLookupError(errno.ESRCH, os.strerror(errno.ESRCH))
        import threading

        self._lock = threading.Lock()
        self._writing: int | None
        self._descriptor, self._writing = os.pipe()
        _start_thread(self._wait)

    def fileno(self) -> int:
        """A descriptor that is readable when the process has ended."""
        return self._descriptor

    def code(self) -> int:
        """The exit code of a child that has ended; the negative number of the signal that ended it."""
        if not LINUX:
            return 0 if self._status is None else os.waitstatus_to_exitcode(self._status)
        result = os.waitid(os.P_PIDFD, self._descriptor, os.WEXITED | os.WNOWAIT)
        assert result is not None
        return result.si_status if result.si_code == os.CLD_EXITED else -result.si_status

    def send_signal(self, number: int) -> None:
        """Send a signal to the process. Raises ProcessLookupError: it has ended."""
        if LINUX:
            import signal

            signal.pidfd_send_signal(self._descriptor, number)
        else:
            os.kill(self.pid, number)

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self._descriptor)
        if not LINUX:
            self._close_pipe()

    def _wait(self) -> None:
        """Wait for the end, and close the pipe's other end."""
        import time

        try:
            self._status = os.waitpid(self.pid, 0)[1]
        except ChildProcessError:  # not a child of ours, or somebody else has waited for it
            while is_there(self.pid) and self._writing is not None:
                time.sleep(_LOOK_EVERY_S)
        self._close_pipe()

    def _close_pipe(self) -> None:
        with self._lock:
            writing, self._writing = self._writing, None
            if writing is not None:
                os.close(writing)


def is_there(pid: int) -> bool:
    """True while a process with this id exists."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def end_with(parent: int, number: int) -> bool:
    """Get this signal when the parent ends. Returns False if it has already ended."""
    if LINUX:
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
    else:
        _start_thread(_follow, parent, number)
    return os.getppid() == parent


def _follow(parent: int, number: int) -> None:
    import time

    while os.getppid() == parent:
        time.sleep(_LOOK_EVERY_S)
    os.kill(os.getpid(), number)


def _start_thread(target: Callable[..., None], *arguments: int) -> None:
    """Start a thread that takes no signals: they shall interrupt the waits of the main thread."""
    import signal
    import threading

    held = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    try:
        threading.Thread(target=target, args=arguments, daemon=True).start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def lock_holder(file: FileIO) -> int | None:
    """The id of the process that holds the record lock of the file; None for no process.

    Raises OSError.
    """
    import fcntl

    if sys.platform == "linux":
        question = _LINUX_FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
        kind, _, _, _, pid = _LINUX_FLOCK.unpack(fcntl.fcntl(file, fcntl.F_GETLK, question))
    else:
        question = _BSD_FLOCK.pack(0, 0, 0, fcntl.F_WRLCK, os.SEEK_SET)
        _, _, pid, kind, _ = _BSD_FLOCK.unpack(fcntl.fcntl(file, fcntl.F_GETLK, question))
    return None if kind == fcntl.F_UNLCK else pid


def command_line(pid: int) -> str:
    """The command line of a process, with a blank between two words; empty when it cannot be read."""
    if LINUX:
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                return os.fsdecode(file.read()).rstrip("\0").replace("\0", " ")
        except OSError:
            return ""
    return _of_ps(pid, "args")


def program_name(pid: int) -> str:
    """The name of the program of a process; empty when it cannot be read."""
    if LINUX:
        try:
            with open(f"/proc/{pid}/comm", encoding="utf-8") as file:
                return file.read().strip()
        except (OSError, UnicodeDecodeError):
            return ""
    return os.path.basename(_of_ps(pid, "comm")).removeprefix("-")  # a login shell's name begins with -


def _of_ps(pid: int, column: str) -> str:
    import subprocess

    command = ["ps", "-ww", "-o", f"{column}=", "-p", str(pid)]
    try:
        return os.fsdecode(subprocess.run(command, capture_output=True, check=True).stdout).strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def usable_cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if LINUX else os.cpu_count() or 1


# --- timers and memory ------------------------------------------------------------------------------------------------


def set_timer_slack(slack_ns: int) -> int:
    """Let the kernel end the waits of this process that much too late, to save power. Returns what it was before.

    0 is what the process began with. Where there is no such setting this does nothing, and returns 0.
    """
    if not LINUX:
        return 0
    import ctypes

    before = 0
    with suppress(OSError), open("/proc/self/timerslack_ns", encoding="ascii") as file:
        before = int(file.read())
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, slack_ns, 0, 0, 0)
    return before


def return_large_blocks() -> None:
    """Let the allocator give blocks of 128 KiB and more back to the system when they are freed.

    glibc keeps such blocks after it has seen some of them freed: a server would keep the most that it ever held. Other
    allocators need no telling.
    """
    if LINUX:
        import ctypes

        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 128 * 1024)


def resident_bytes() -> int:
    """Bytes of memory of this process; elsewhere than on Linux the most that it had."""
    import resource

    if LINUX:
        return _statm(1)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most


def limit_new_memory(most_bytes: int) -> None:
    """Limit the memory that this process may map from now on, within the limit that it has.

    There is no limit where the system does not tell what is mapped.
    """
    if not LINUX:
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    known = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([_statm(0) + most_bytes, *known]), hard))


def _statm(column: int) -> int:
    """A number of /proc/self/statm in bytes: 0 is mapped, 1 is resident."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[column]) * os.sysconf("SC_PAGE_SIZE")


# --- files ------------------------------------------------------------------------------------------------------------


def memory_file(name: str) -> tuple[BinaryIO, str]:
    """A file in memory, or a temporary one, and the path by which a child that inherits its descriptor opens it.

    It is gone when it is closed.
    """
    if LINUX:
        file = open(os.memfd_create(name), "wb")  # noqa: SIM115 - the caller closes it
        return file, f"/proc/self/fd/{file.fileno()}"
    import tempfile

    # /dev/fd/N is no second opening on the BSDs, but the same one: it would share the place in the file.
    kept = tempfile.NamedTemporaryFile(prefix=f"slidectl-{name}-")  # noqa: SIM115 - the caller closes it
    return cast(BinaryIO, kept), kept.name


def reserve_space(descriptor: int, size: int) -> None:
    """Reserve room on the disk for the first `size` bytes of a file. Raises OSError: the disk is full.

    Elsewhere than on Linux the room is only compared with what is free.
    """
    if LINUX:
        try:
            os.posix_fallocate(descriptor, 0, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
                raise
        return
    disk = os.fstatvfs(descriptor)
    if size - os.fstat(descriptor).st_size > disk.f_bavail * disk.f_frsize:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
