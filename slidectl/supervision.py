"""Support for commands that start others: signal handling, an event loop with timers, and child processes.

Each child process has its own session and process group, so that a signal reaches everything that a node has started.
Everything runs in the main thread, as only that handles signals. This module knows no launch files.
"""

from __future__ import annotations

import math
import os
import sched
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any

from slidectl.event_loop import READ, EventLoop
from slidectl.operating_system import ProcessEnd

if TYPE_CHECKING:
    from slidectl.client import Client

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_CHUNK = 65536
"""Bytes per read: the capacity of a pipe."""
_LONGEST_LINE = 65536
_LOOK_FOR_SIGNALS_S = 0.1
_LOOK_EVERY_S = 0.01
"""In a scenario: simulated seconds between two polls of descriptors."""

Action = Callable[[], None]


class Interrupted(BaseException):
    """A signal has asked the process to end."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class _Wakeup:
    """A pipe that is readable from the moment of a signal.

    A signal that comes between two instructions of the interpreter, just before a system call that waits, is handled
    after that call: it would be lost for as long as the call waits. A wait that watches this pipe as well ends at once.
    """

    def __init__(self) -> None:
        self.descriptor = -1
        """Readable after a signal; -1 outside of the main thread, which alone handles signals."""
        self._write_end = self._previous = -1

    def begin(self) -> None:
        """Raises ValueError: this is not the main thread."""
        read_end, write_end = os.pipe()
        os.set_blocking(read_end, False)
        os.set_blocking(write_end, False)
        try:
            self._previous = signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        except ValueError:
            os.close(read_end)
            os.close(write_end)
            raise
        self.descriptor, self._write_end = read_end, write_end

    def drain(self) -> bytes:
        """The numbers of the signals since the last call."""
        try:
            return os.read(self.descriptor, _CHUNK)
        except BlockingIOError:
            return b""

    def end(self) -> None:
        """Close the pipe. What came in the meantime is readable in the pipe that was there before."""
        if self.descriptor < 0:
            return
        signal.set_wakeup_fd(self._previous, warn_on_full_buffer=False)
        if (numbers := self.drain()) and self._previous >= 0:
            with suppress(OSError):
                os.write(self._previous, numbers)
        os.close(self.descriptor)
        os.close(self._write_end)
        self.descriptor = -1


class Interrupts:
    """Handles SIGNALS while it is entered: their numbers are recorded in `received`, which an event loop checks.

    Inside a `raised` block the first signal also raises Interrupted, for code that does not check `received`.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self._raises = False
        self._previous: dict[int, Any] = {}
        self._wakeup = _Wakeup()

    def __enter__(self) -> Interrupts:
        # `nohup` makes programs ignore SIGHUP; this is kept.
        ignored = [signal.SIGHUP] if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else []
        with suppress(ValueError):  # not in the main thread: signals cannot be handled, the caller ends it
            for number in SIGNALS:
                if number not in ignored:
                    self._previous[number] = signal.signal(number, self._receive)
            self._wakeup.begin()
        return self

    def __exit__(self, *_: object) -> None:
        self._wakeup.end()
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    @contextmanager
    def raised(self, is_raised: bool = True) -> Iterator[None]:
        """Inside, the first signal raises Interrupted at once; an earlier one raises it at the beginning."""
        before, self._raises = self._raises, is_raised
        try:
            self.check()
            yield
        finally:
            self._raises = before
        self.check()

    def held(self) -> AbstractContextManager[None]:
        """For a part of a `raised` block that must not be interrupted: a signal raises Interrupted at its end."""
        return self.raised(False)

    def check(self) -> None:
        """Raise Interrupted inside a `raised` block when a signal was received.

        A loop calls this at each turn, since an exception that is raised in a finalizer is lost.
        """
        if self._raises and self.received:
            raise Interrupted(self.received[0])

    def wake(self, loop: EventLoop) -> None:
        """Let a signal end a wait of the loop, also one that comes after the loop looked and before it waits."""

        def drain(_: int) -> None:
            self._wakeup.drain()

        if self._wakeup.descriptor >= 0:
            loop.watch(self._wakeup.descriptor, READ, drain)

    def ignore(self) -> None:
        """Ignore signals from now on, also after `__exit__`: the process is about to end."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        self._previous.clear()

    def _receive(self, number: int, _frame: FrameType | None) -> None:
        self.received.append(number)
        if len(self.received) == 1:  # what the first one ends is not cut short by a second
            self.check()


class Watch(EventLoop):
    """The event loop of a launch, with timers and clients."""

    def __init__(self) -> None:
        super().__init__()
        self._timers = sched.scheduler(time.monotonic)

    def listen(self, client: Client, action: Action) -> None:
        """Call `action` whenever the client has received something."""
        self.watch(client.fileno(), READ, lambda _: action())

    def ignore(self, client: Client) -> None:
        """Stop watching the client."""
        self.forget(client.fileno())

    def later(self, seconds: float, action: Action) -> None:
        """Call `action` once, after this time."""
        self._timers.enter(seconds, 0, action)

    def turn(self, most_s: float | None = None) -> None:
        """Wait for an event for at most `most_s` seconds, and handle all that are due."""
        due_s = self._timers.run(blocking=False)
        waits = [max(0.0, seconds) for seconds in (most_s, due_s) if seconds is not None]
        self.poll(min(waits, default=None))
        self._timers.run(blocking=False)


class WorldWatch(Watch):
    """A Watch for a scenario. It uses the clock of a client; its waits let the world, or other steps, run."""

    def __init__(self, client: Client) -> None:
        super().__init__()
        self._timers = sched.scheduler(client.monotonic)
        self._client = client

    def listen(self, client: Client, action: Action) -> None:
        """As Watch. A world in this process calls `action` between two cycles."""
        if not client.call_back(action):
            super().listen(client, action)

    def ignore(self, client: Client) -> None:
        if not client.call_back(None):
            super().ignore(client)

    def turn(self, most_s: float | None = None) -> None:
        super().turn(0.0)
        waits = [most_s, self._timers.run(blocking=False), _LOOK_EVERY_S if self._handlers else None]
        next(self._client.events(min((wait_s for wait_s in waits if wait_s is not None), default=math.inf)), None)
        super().turn(0.0)


class Child:
    """A running program. Its streams are `stdout` and `stderr`; a stdout that goes to a file is not read.

    Args:
        on_line: called with the stream and each line of it.
        on_end: called with the exit code, which is negative for a signal.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        loop: EventLoop,
        on_line: Callable[[str, str], None],
        on_end: Callable[[int], None],
        cwd: str | None = None,
        environment: Mapping[str, str] | None = None,
        stdout: int = subprocess.PIPE,
    ) -> None:
        self._loop = loop
        self._on_line = on_line
        self._on_end = on_end
        self._rest = {"stdout": b"", "stderr": b""}
        self.code: int | None = None
        self._process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=subprocess.PIPE,
            cwd=cwd,
            env=environment,
            start_new_session=True,
        )
        self.pid = self._process.pid
        self._end = ProcessEnd(self.pid)
        self._pipes = {
            name: pipe.fileno()
            for name, pipe in (("stdout", self._process.stdout), ("stderr", self._process.stderr))
            if pipe is not None
        }
        for name, descriptor in self._pipes.items():
            os.set_blocking(descriptor, False)
            loop.watch(descriptor, READ, lambda _, name=name: self._read(name))  # type: ignore[misc]
        loop.watch(self._end.fileno(), READ, lambda _: self._ended())

    def _read(self, name: str, is_last: bool = False) -> None:
        """Read one chunk and pass on its lines; with `is_last` also a line without an end."""
        try:
            data: bytes | None = os.read(self._pipes[name], _CHUNK)
        except BlockingIOError:
            data = None
        if data == b"":
            self._loop.forget(self._pipes.pop(name))
        *lines, rest = (self._rest[name] + (data or b"")).split(b"\n")
        if rest and (is_last or data == b"" or len(rest) > _LONGEST_LINE):
            lines, rest = [*lines, rest], b""
        self._rest[name] = rest
        for line in lines:
            self._on_line(name, line.decode("utf-8", "replace").rstrip("\r"))

    def _ended(self) -> None:
        """Handle the end. On Linux the process stays a zombie until `release`, so that its group's id is not reused."""
        code = self._end.code()
        for name in list(self._pipes):  # its own output; output of its children may come later
            self._read(name, is_last=True)
        # The descriptor is watched up to here: if a signal interrupts this method, the end is noticed again.
        self.code = code
        self._loop.forget(self._end.fileno())
        self._on_end(self.code)

    def signal(self, number: int) -> None:
        """Send a signal to the process and everything that it has started."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)

    def release(self) -> None:
        """Kill what is left of the process group, and free all resources."""
        self.signal(signal.SIGKILL)
        for descriptor in (self._end.fileno(), *self._pipes.values()):
            self._loop.forget(descriptor)
        self._pipes.clear()
        with self._process:  # waits for the process, and closes its pipes
            self._end.close()


def run(arguments: Sequence[str], environment: Mapping[str, str], most_bytes: int) -> tuple[int, bytes]:
    """Run a program to its end. Returns its exit code and output. On an exception its whole group is killed.

    Raises:
        OSError, ValueError: it cannot be started. OverflowError: its output has more than `most_bytes`.
    """
    with _woken_by_signals() as wakeup, _signals_deferred() as handle_deferred:
        process = subprocess.Popen(
            arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, env=environment, start_new_session=True
        )
        try:
            handle_deferred()  # not earlier: an exception inside `Popen`, or behind it, would lose the new process
            assert process.stdout is not None
            output = _read(process.stdout.fileno(), most_bytes + 1, wakeup)
            if len(output) > most_bytes:
                raise OverflowError(f"more than {most_bytes >> 20} MiB")
            while True:  # a wait without a limit would not notice a signal that comes just before it
                with suppress(subprocess.TimeoutExpired):
                    return process.wait(_LOOK_FOR_SIGNALS_S), output
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
        finally:
            with process:  # waits for it, and closes its pipes
                pass


def _read(descriptor: int, most_bytes: int, wakeup: _Wakeup) -> bytes:
    """Read up to the end, or this many bytes. A signal is handled at once."""
    output = bytearray()
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)
    if wakeup.descriptor >= 0:
        waiting.register(wakeup.descriptor, select.POLLIN)
    while len(output) < most_bytes:
        ready = [fd for fd, _ in waiting.poll()]
        if wakeup.descriptor in ready:
            wakeup.drain()  # its handler was called when `poll` returned
        if descriptor in ready:
            piece = os.read(descriptor, min(_CHUNK, most_bytes - len(output)))
            if not piece:
                break
            output += piece
    return bytes(output)


@contextmanager
def _woken_by_signals() -> Iterator[_Wakeup]:
    wakeup = _Wakeup()
    with suppress(ValueError):  # not in the main thread, which alone handles signals
        wakeup.begin()
    try:
        yield wakeup
    finally:
        wakeup.end()


@contextmanager
def _signals_deferred() -> Iterator[Action]:
    """Keep signals for later: the function that is yielded, and the end of the block, let their handlers have them."""
    received: list[int] = []
    handlers: dict[int, Any] = {}
    with suppress(ValueError):  # not in the main thread, which alone handles signals
        for handled in [number for number in SIGNALS if callable(signal.getsignal(number))]:
            handlers[handled] = signal.signal(handled, lambda number, _frame: received.append(number))
    deferred = dict(handlers)

    def handle() -> None:
        while deferred:
            signal.signal(*deferred.popitem())
        while received:
            handlers[number := received.pop(0)](number, None)

    try:
        yield handle
    finally:
        handle()
