"""A limit of wall time for users' code, which would otherwise block the daemon and all its clients if it did not end.

There is one thread, so no other code can end it: a timer's signal interrupts it, and the signal's handler raises
an exception in it. Code that catches it and goes on is interrupted again. The timer keeps ticking while users' code
runs now and then, because an `update` is entered in each cycle, and setting a timer costs system calls. C code that
does not return to the interpreter cannot be interrupted.
"""

from __future__ import annotations

import signal
from math import inf
from time import monotonic
from types import FrameType
from typing import Any

from slidectl.control import controller_interface, controller_manager, user_classes
from slidectl.control.user_classes import PACKAGE, CodeTimeout
from slidectl.control.user_modules import CodeLimit
from slidectl.simulation import cycle, graph

LIMIT_S = 5.0
_TICK_S = 0.1
_AGAIN_S = 0.005
_MOST_AGAIN = 200
"""The number of signals that may meet slidectl's own code before that is interrupted too."""
_ENTRIES = tuple(
    str(module.__file__) for module in (controller_interface, controller_manager, cycle, graph, user_classes)
)
"""Files whose functions call users' code."""


class TimeLimit(CodeLimit):
    """Raises CodeTimeout inside its context after `most_s`. For the main thread only."""

    def __init__(self) -> None:
        super().__init__()
        self.most_s = LIMIT_S
        self.end_s = inf
        """The time at which the code inside is interrupted; infinite outside."""
        self.has_ended = False
        """True when the code inside was ended."""
        self._depth = 0
        self._outer: TimeLimit | None = None
        """The limit of another world whose code runs this one's."""

    def __enter__(self) -> None:
        self._depth += 1  # contexts nest: a controller publishes, and another one takes the message
        if self._depth == 1:
            self.end_s = monotonic() + self.most_s
            timer = _TIMER
            if timer.limit is not self:
                self._outer, timer.limit = timer.limit, self
            timer.was_entered = True
            if not timer.period_s:
                timer.set(_TICK_S)

    def __exit__(self, *_: Any) -> None:
        self._depth -= 1
        if not self._depth:
            self.end_s = inf
            if self._outer is not None:
                _TIMER.limit = self._outer if self._outer.end_s < inf else self
                self._outer = None
            if self.has_ended:
                self.has_ended = False
                for tell in self.on_end:
                    tell()

    def close(self) -> None:
        """Stop the timer."""
        _TIMER.set(0.0)


class _LimitTimer:
    """The timer of the process and its signal. It serves the limit of the world whose code runs."""

    def __init__(self) -> None:
        self.limit: TimeLimit | None = None
        """The limit that was entered last."""
        self.period_s = 0.0
        """0: it is stopped."""
        self.was_entered = False
        """True when a limit was entered since the last tick."""
        self._spared = 0

    def set(self, period_s: float) -> None:
        """Let it tick with this period, s; 0 stops it."""
        if not self.period_s:  # other code of the process may have used the signal since it last ticked
            signal.signal(signal.SIGALRM, self.tick)
        self.period_s = period_s
        signal.setitimer(signal.ITIMER_REAL, period_s, period_s)

    def tick(self, _number: int, frame: FrameType | None) -> None:
        """Handle the signal."""
        limit = self.limit
        late_s = -inf if limit is None else monotonic() - limit.end_s
        if limit is None or late_s < 0.0:
            self._spared = 0
            if late_s == -inf and not self.was_entered:
                self.set(0.0)
            elif self.period_s != _TICK_S:
                self.set(_TICK_S)
            self.was_entered = False
            return
        if self.period_s != _AGAIN_S:  # tick faster: the code may catch the exception and go on
            self.set(_AGAIN_S)
        # Work of slidectl for the user's code, such as advertising a topic, must be done completely or not at all: the
        # next signals try again until they meet the user's own code.
        self._spared += 1
        if _is_users(frame) or self._spared > _MOST_AGAIN:
            limit.has_ended = True
            raise CodeTimeout(f"the code ran longer than {LIMIT_S:g} s and was ended")


def _is_users(frame: FrameType | None) -> bool:
    """True when a frame's code is a user's, or a library's called by it. slidectl's own frames never are."""
    is_outside = False
    while frame is not None:
        file = frame.f_code.co_filename
        if file.startswith(PACKAGE):
            return is_outside and file in _ENTRIES
        is_outside = True
        frame = frame.f_back
    return False


_TIMER = _LimitTimer()
