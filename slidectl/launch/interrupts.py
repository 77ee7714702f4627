"""Signals that end a launch: the first is raised at once, or when what must not be torn apart is done.

Later ones are only noted. Main thread only, as signals are. What is done about a signal is the session's affair.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

_MOMENT_S = 0.001
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(BaseException):
    """A signal asked for the end."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class Interrupts:
    """The handlers, from entering to leaving. `fileno` is readable when a signal came."""

    def __init__(self) -> None:
        self.received: list[int] = []
        self._held = 0
        self._raised = False
        self._previous: dict[int, Any] = {}
        self._read, self._write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._previous_wakeup = -1
        self._previous_hook: Any = None

    def __enter__(self) -> Interrupts:
        self._previous_wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        self._previous_hook, sys.unraisablehook = sys.unraisablehook, self._unheard
        self._previous = {number: signal.signal(number, self._take) for number in SIGNALS if not _is_unwanted(number)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        sys.unraisablehook = self._previous_hook
        signal.set_wakeup_fd(self._previous_wakeup)
        os.close(self._read)
        os.close(self._write)

    def fileno(self) -> int:
        return self._read

    def clear(self) -> None:
        """Make `fileno` unreadable again."""
        with suppress(BlockingIOError):
            os.read(self._read, 4096)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Inside, signals are only noted; at the end of the outermost block one that came is raised."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
        self.check()

    def check(self) -> None:
        """Raise Interrupted if a signal came and has not been raised yet."""
        if self.received and not self._held and not self._raised:
            self._raised = True
            raise Interrupted(self.received[0])

    def hold_for_good(self) -> None:
        """From now on signals are only noted."""
        self._held += 1_000_000

    def ignore(self) -> None:
        """For a process that is about to leave: signals mean nothing any more, after `__exit__` too."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        self._previous.clear()

    def _unheard(self, unraisable: sys.UnraisableHookArgs) -> None:
        """It was raised in a finalizer, where nobody can hear it: raise it again in a moment, elsewhere."""
        if unraisable.exc_type is not Interrupted:
            self._previous_hook(unraisable)
            return
        self._raised = False
        signal.signal(signal.SIGALRM, lambda *_: self.check())
        signal.setitimer(signal.ITIMER_REAL, _MOMENT_S)

    def _take(self, number: int, _frame: FrameType | None) -> None:
        self.received.append(number)
        self.check()


def _is_unwanted(number: int) -> bool:
    """Whether it is the end of the terminal, which `nohup` has us ignore."""
    return number == signal.SIGHUP and signal.getsignal(number) is signal.SIG_IGN
