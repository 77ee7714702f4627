"""A child process in a session of its own, with its output line by line and its end noticed; ended with all it started.

It dies with this process, however this one ends. Knows nothing of launch files.
"""

from __future__ import annotations

import fcntl
import os
import signal
import struct
import subprocess
import termios
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress

from slidectl.launch.watch import Watch

_CHUNK = 65536
_LONGEST_LINE = 65536
_PR_SET_PDEATHSIG = 1
_HELD = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

OnLine = Callable[[str, str], None]
OnEnd = Callable[[int], None]


class Child:
    """A running program. Streams are `stdout` and `stderr`; a stdout that goes to a file is not seen here.

    Args:
        on_line: called with the stream and each line of it.
        on_end: called with the exit code, which is negative for a signal.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        watch: Watch,
        on_line: OnLine,
        on_end: OnEnd,
        cwd: str | None = None,
        environment: Mapping[str, str] | None = None,
        stdout: int = subprocess.PIPE,
    ) -> None:
        self._watch = watch
        self._on_line = on_line
        self._on_end = on_end
        self._rest = {"stdout": b"", "stderr": b""}
        self._pipes: dict[str, int] = {}
        self.code: int | None = None
        self._process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=subprocess.PIPE,
            cwd=cwd,
            env=environment,
            start_new_session=True,
            preexec_fn=_ending_with(os.getpid()),
        )
        self.pid = self._process.pid
        self._descriptor = os.pidfd_open(self.pid)
        watch.add(self._descriptor, self._ended)
        for name, pipe in (("stdout", self._process.stdout), ("stderr", self._process.stderr)):
            if pipe is not None:
                self._open(name, pipe.fileno())

    def _open(self, name: str, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._pipes[name] = descriptor
        self._watch.add(descriptor, lambda: self._take(name))

    def _take(self, name: str) -> None:
        self._read(name, _CHUNK)

    def _read(self, name: str, most_bytes: int) -> int:
        """Take some of what has come. The number of bytes; 0 when there is nothing, now or ever."""
        try:
            data = os.read(self._pipes[name], most_bytes)
        except BlockingIOError:
            return 0
        if not data:
            self._watch.remove(self._pipes.pop(name))
            self._flush(name)
            return 0
        *lines, rest = (self._rest[name] + data).split(b"\n")
        self._rest[name] = rest
        for line in lines:
            self._on_line(name, line.decode("utf-8", "replace").rstrip("\r"))
        if len(rest) > _LONGEST_LINE:
            self._flush(name)
        return len(data)

    def _flush(self, name: str) -> None:
        if rest := self._rest[name]:
            self._rest[name] = b""
            self._on_line(name, rest.decode("utf-8", "replace"))

    def _drain(self, name: str) -> None:
        """Take what is in the pipe now. What others who hold its other end write later is for `_take`."""
        left = _bytes_in(self._pipes[name])
        while left > 0 and (taken := self._read(name, min(left, _CHUNK))):
            left -= taken
        self._flush(name)

    def _ended(self) -> None:
        """It has ended. It stays a zombie until `release`, so that nobody else gets the id of its group."""
        result = os.waitid(os.P_PIDFD, self._descriptor, os.WEXITED | os.WNOWAIT)
        assert result is not None
        for name in list(self._pipes):
            self._drain(name)
        # The descriptor is watched up to here, so that the end is noticed later when a signal cuts this short.
        self.code = result.si_status if result.si_code == os.CLD_EXITED else -result.si_status
        self._watch.remove(self._descriptor)
        self._on_end(self.code)

    def signal(self, number: int) -> None:
        """Send a signal to it and to all that it started."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)

    def release(self) -> None:
        """End whatever is left of it, and forget it."""
        self.signal(signal.SIGKILL)
        self._watch.remove(self._descriptor)
        for descriptor in self._pipes.values():
            self._watch.remove(descriptor)
        self._pipes.clear()
        self._process.wait()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        os.close(self._descriptor)


def _bytes_in(descriptor: int) -> int:
    return int(struct.unpack("i", fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)))[0])


def run(arguments: Sequence[str], environment: Mapping[str, str], most_bytes: int) -> tuple[int, bytes]:
    """Run a program to its end, with all that it starts gone when this is left early. Its exit code and its output.

    Raises:
        OSError, ValueError: it cannot be started. OverflowError: it prints more than so many bytes.
    """
    # A signal between the start and the next line would leave a program that nobody knows of.
    held = signal.pthread_sigmask(signal.SIG_BLOCK, _HELD)
    try:
        process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,
            preexec_fn=_ending_with(os.getpid(), held),
        )
    except BaseException:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
        raise
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
        assert process.stdout is not None
        with process.stdout:
            output = process.stdout.read(most_bytes + 1)
        if len(output) > most_bytes:
            raise OverflowError(f"more than {most_bytes >> 20} MiB")
        process.wait()
    except BaseException:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
    return process.returncode, output


def _ending_with(parent: int, mask: Iterable[int] = ()) -> Callable[[], None]:
    """What the child does before it becomes the program: it asks the kernel for a SIGTERM when its parent dies."""
    import ctypes

    prctl = ctypes.CDLL(None).prctl

    def prepare() -> None:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(1)

    return prepare
