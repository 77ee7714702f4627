"""What a launch stands on: the signals that end it, the event loop with its timers, and child processes.

Each child process has a session, and so a process group, of its own: what ends a node reaches all that it started.
One thread, the main one, since signals are heard there. Knows nothing of launch files.
"""

from __future__ import annotations

import math
import os
import sched
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any

from slidectl.event_loop import READ, EventLoop

if TYPE_CHECKING:
    from slidectl.client import Client

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_CHUNK = 65536
"""Bytes of one read: as many as a pipe holds."""
_LONGEST_LINE = 65536
_LOOK_EVERY_S = 0.01
"""Simulated seconds between two looks at descriptors, in a scenario."""

Action = Callable[[], None]


class Interrupted(BaseException):
    """A signal asked for the end."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class Interrupts:
    """The handler of SIGNALS, from entering to leaving: it notes their numbers in `received`, where a loop looks.

    In a `raised` block the first one is raised as Interrupted as well, for work that looks nowhere.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self._raises = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Interrupts:
        # `nohup` has programs ignore SIGHUP, the end of the terminal; so it stays.
        ignored = [signal.SIGHUP] if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else []
        with suppress(ValueError):  # in a thread, which hears none: whoever began it ends it
            for number in SIGNALS:
                if number not in ignored:
                    self._previous[number] = signal.signal(number, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    @contextmanager
    def raised(self, is_raised: bool = True) -> Iterator[None]:
        """Inside, the first signal is raised at once, and one that came before is raised at the beginning."""
        before, self._raises = self._raises, is_raised
        try:
            self.check()
            yield
        finally:
            self._raises = before
        self.check()

    def held(self) -> AbstractContextManager[None]:
        """Inside a `raised` block, for what must be done whole: a signal that comes is raised at the end."""
        return self.raised(False)

    def check(self) -> None:
        """Raise Interrupted where signals are raised and one has come.

        A loop asks at each turn: what is raised in a finalizer does not leave it.
        """
        if self._raises and self.received:
            raise Interrupted(self.received[0])

    def ignore(self) -> None:
        """For a process that is about to leave: signals mean nothing any more, after `__exit__` too."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        self._previous.clear()

    def _take(self, number: int, _frame: FrameType | None) -> None:
        self.received.append(number)
        if len(self.received) == 1:  # what the first one ends is not cut short by a second
            self.check()


class Watch(EventLoop):
    """The event loop of a launch: with timers, and clients to listen to."""

    def __init__(self) -> None:
        super().__init__()
        self._timers = sched.scheduler(time.monotonic)

    def listen(self, client: Client, action: Action) -> None:
        """Do it whenever something has come for the client."""
        self.watch(client.fileno(), READ, lambda _: action())

    def ignore(self, client: Client) -> None:
        """Look no more whether something has come for it."""
        self.forget(client.fileno())

    def later(self, seconds: float, action: Action) -> None:
        """Do it once, after so many seconds."""
        self._timers.enter(seconds, 0, action)

    def turn(self, most_s: float | None = None) -> None:
        """Wait for something, at most so long, and do all that there is to do."""
        due_s = self._timers.run(blocking=False)
        waits = [max(0.0, seconds) for seconds in (most_s, due_s) if seconds is not None]
        self.poll(min(waits, default=None))
        self._timers.run(blocking=False)


class WorldWatch(Watch):
    """The same in a scenario: on the clock of a client whose waits let the world go on, or others have their turn."""

    def __init__(self, client: Client) -> None:
        super().__init__()
        self._timers = sched.scheduler(client.monotonic)
        self._client = client

    def listen(self, client: Client, action: Action) -> None:
        """As a Watch does. A world in this process does it between two cycles, whoever waits."""
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
        self._descriptor = os.pidfd_open(self.pid)
        self._pipes = {
            name: pipe.fileno()
            for name, pipe in (("stdout", self._process.stdout), ("stderr", self._process.stderr))
            if pipe is not None
        }
        for name, descriptor in self._pipes.items():
            os.set_blocking(descriptor, False)
            loop.watch(descriptor, READ, lambda _, name=name: self._take(name))  # type: ignore[misc]
        loop.watch(self._descriptor, READ, lambda _: self._ended())

    def _take(self, name: str, is_last: bool = False) -> None:
        """Read what is there, at most what a pipe holds; with `is_last` a line without an end, too."""
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
        """It has ended. It stays a zombie until `release`, so that no other process gets the id of its group."""
        result = os.waitid(os.P_PIDFD, self._descriptor, os.WEXITED | os.WNOWAIT)
        assert result is not None
        for name in list(self._pipes):  # what it has written; what its own children write later comes by `turn`
            self._take(name, is_last=True)
        # The descriptor is watched up to here, so that the end is noticed later when a signal cuts this short.
        self.code = result.si_status if result.si_code == os.CLD_EXITED else -result.si_status
        self._loop.forget(self._descriptor)
        self._on_end(self.code)

    def signal(self, number: int) -> None:
        """Send a signal to it and to all that it started."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)

    def release(self) -> None:
        """End whatever is left of it, and forget it."""
        self.signal(signal.SIGKILL)
        for descriptor in (self._descriptor, *self._pipes.values()):
            self._loop.forget(descriptor)
        self._pipes.clear()
        with self._process:  # waits for it, and closes its pipes
            os.close(self._descriptor)


def run(arguments: Sequence[str], environment: Mapping[str, str], most_bytes: int) -> tuple[int, bytes]:
    """Run a program to its end. Its exit code and its output; when this is left early, it and all it started end.

    Raises:
        OSError, ValueError: it cannot be started. OverflowError: it prints more than so many bytes.
    """
    with subprocess.Popen(
        arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, env=environment, start_new_session=True
    ) as process:
        assert process.stdout is not None
        try:
            output = process.stdout.read(most_bytes + 1)
            if len(output) > most_bytes:
                raise OverflowError(f"more than {most_bytes >> 20} MiB")
            return process.wait(), output
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
