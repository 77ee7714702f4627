"""Confines a forked process that reads a file of somebody else, and runs such processes for a result.

Against: a model or a mesh that was sent, and that fills the memory, never ends, or crashes a library. The kernel
enforces the limits, so no code in the process can avoid them. Standard library only.
"""

from __future__ import annotations

import gc
import importlib
import os
import resource
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO

from slidectl.operating_system import LINUX, end_with, limit_new_memory

_LARGEST_DESCRIPTOR = 2**31 - 1
_PIECE = 1 << 20
_GRACE_S = 1
"""CPU time between the signal that code may handle and the end, s."""
_OF_TERMINALS = (signal.SIGINT, signal.SIGHUP)
_MAY_LIST = ("os.listdir", "os.scandir", "os.walk")
_REFUSED = ("os.", "subprocess.", "socket.", "ctypes.", "shutil.", "pty.")


@dataclass(frozen=True)
class Limits:
    """What a process may use."""

    cpu_s: int
    """CPU time, s."""
    wall_s: int
    """Time with waits, s: a file on a network may not answer."""
    new_bytes: int
    """Memory, in addition to that of the process that forked it."""

    def reason(self, status: int) -> str:
        """The clause that tells why a process ended early, from its wait status."""
        if not os.WIFSIGNALED(status):
            return "the process that read it failed"
        number = os.WTERMSIG(status)
        if number == signal.SIGXCPU:
            return f"it takes more than {self.cpu_s} s"
        if number == signal.SIGALRM:
            return f"it is not done within {self.wall_s} s"
        return f"the process that read it was ended by {signal.Signals(number).name}"


class EndedError(Exception):
    """A process ended without a result. The text is a clause that tells why."""


def _fork() -> int:
    """`os.fork`, without Python's warning of threads: the child may use nothing that another thread holds a lock of."""
    if LINUX:
        importlib.import_module("ctypes")  # once here, and not in each child, where end_with needs it
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _confine(limits: Limits, writing: int, parent: int) -> None:
    """Restrict this process, a fork of `parent`: limits, and no inherited descriptor but `writing` and the first three.

    It ends with its parent, also when that is killed. A terminal sends its signals to both: the parent says how both
    end, which it could not if this process had ended before it.
    """
    signal.set_wakeup_fd(-1)
    for number in _OF_TERMINALS:
        signal.signal(number, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGXCPU, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    if not end_with(parent, signal.SIGKILL):
        os._exit(1)
    # A copy of a client's socket, of a lock or of a pipe must not stay open here after the parent's end.
    os.closerange(3, writing)
    os.closerange(writing + 1, _LARGEST_DESCRIPTOR)
    limit_new_memory(limits.new_bytes)
    _limit(resource.RLIMIT_CPU, limits.cpu_s, limits.cpu_s + _GRACE_S)
    _limit(resource.RLIMIT_CORE, 0)
    signal.alarm(limits.wall_s)


def start(work: Callable[[BinaryIO], object], limits: Limits, only_reads: bool = False) -> tuple[int, int]:
    """Call `work` with a pipe in a forked process. `work` must not raise.

    Args:
        only_reads: the process can only read files, and has the standard streams on /dev/null.

    Returns:
        The process id, and the descriptor of the pipe's other end.

    Raises:
        OSError: no process can be started.
    """
    parent = os.getpid()
    reading, writing = os.pipe()
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_TERMINALS)  # until the process has chosen what they do
    try:
        pid = _fork()
    except OSError:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        os.close(reading)
        os.close(writing)
        raise
    if pid:
        os.close(writing)
        try:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        except BaseException:  # KeyboardInterrupt, from a signal that has waited
            os.kill(pid, signal.SIGKILL)
            os.close(reading)
            os.waitpid(pid, 0)
            raise
        return pid, reading
    code = 1
    try:
        while writing < 3:  # the parent has closed a standard stream, and its number was free
            writing = os.dup(writing)
        _confine(limits, writing, parent)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        gc.freeze()  # a collection that looks at the parent's objects would copy all their memory
        if only_reads:
            nowhere = os.open(os.devnull, os.O_RDWR)
            for stream in range(3):
                os.dup2(nowhere, stream)
            _only_read()
        with open(writing, "wb") as pipe:
            work(pipe)
        code = 0
    finally:
        os._exit(code)  # it never returns into the code of its parent


def run(work: Callable[[], bytes], limits: Limits, most_bytes: int) -> bytes:
    """Call `work` in a forked process that may only read files, and return its result, of at most `most_bytes`.

    `work` must not raise. Before the call it has the standard streams on /dev/null.

    Raises:
        EndedError: the process ended early, by a limit for example. OSError: no process can be started.
    """
    pid, reading = start(lambda pipe: pipe.write(work()), limits, only_reads=True)
    result = bytearray()
    try:
        # Against: code that has taken the process over, and sends without end.
        while len(result) <= most_bytes and (piece := os.read(reading, _PIECE)):
            result += piece
    except BaseException:  # KeyboardInterrupt, for example
        os.kill(pid, signal.SIGKILL)
        raise
    finally:
        os.close(reading)  # who still writes is ended by that
        status = _wait(pid, limits)
    if len(result) > most_bytes:
        raise EndedError(f"its result exceeds {most_bytes >> 20} MiB")
    if status or not result:
        raise EndedError(limits.reason(status))
    return bytes(result)


def _wait(pid: int, limits: Limits) -> int:
    """The wait status of a process. A kill at the end of its CPU time is told as the signal before it, SIGXCPU."""
    try:
        _, status, usage = os.wait4(pid, 0)
    except ChildProcessError:  # this process ignores SIGCHLD
        return 0
    is_killed = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL
    return signal.SIGXCPU if is_killed and usage.ru_utime + usage.ru_stime >= limits.cpu_s else status


def _only_read() -> None:
    """Refuse to write files, to start programs and to connect.

    Against: code that runs here although expressions are guarded. It is a second wall, not a jail: who can write to the
    process's memory is not held by it.
    """
    _limit(resource.RLIMIT_FSIZE, 0)
    with suppress(ValueError, OSError):
        _limit(resource.RLIMIT_NPROC, 0)
    sys.addaudithook(_refuse)


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    """Python calls this before it opens a file, starts a program, and the like."""
    if event == "open":
        _, mode, flags = arguments
        writes = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        if not isinstance(arguments[0], int) and (writes or (isinstance(mode, str) and set(mode) & set("wax+"))):
            raise PermissionError("files may only be read here")
    elif event == "os.kill" and arguments[0] == os.getpid():
        pass  # the portable way to end with the parent
    elif event.startswith(_REFUSED) and event not in _MAY_LIST:
        raise PermissionError(f"{event} is not allowed while a file is read")


def _limit(what: int, soft: int, hard: int | None = None) -> None:
    """Set a resource limit, at most the present hard limit."""
    _, most = resource.getrlimit(what)
    hard = soft if hard is None else hard
    hard = hard if most == resource.RLIM_INFINITY else min(hard, most)
    resource.setrlimit(what, (min(soft, hard), hard))
