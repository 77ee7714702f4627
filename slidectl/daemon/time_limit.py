"""A limit of wall time for users' code, which would otherwise block the daemon and all its clients if it did not end.

There is one thread, so no other code can end it: a timer's signal interrupts it, and the signal's handler raises
an exception in it. The timer keeps ticking while users' code runs now and then, because an `update` is entered in each
cycle, and setting a timer costs system calls. C code that does not return to the interpreter cannot be interrupted.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import AbstractContextManager
from math import inf
from time import monotonic
from types import FrameType
from typing import Any

from slidectl.control import controller_interface, controller_manager, user_classes
from slidectl.control.user_classes import PACKAGE, CodeTimeout
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


class TimeLimit(AbstractContextManager[None]):
    """Raises CodeTimeout inside its context after `most_s`. Set as `user_classes.limit`; main thread only."""

    def __init__(self) -> None:
        self.most_s = LIMIT_S
        self.on_end: Callable[[], None] = lambda: None
        """Called after code was ended."""
        self._has_ended = False
        self._depth = 0
        self._end_s = inf
        """The time at which the code inside is interrupted; infinite outside."""
        self._tick_s = 0.0
        """The timer's period; 0: it is stopped."""
        self._was_entered = False
        """True when the context was entered since the last tick."""
        self._spared = 0
        signal.signal(signal.SIGALRM, self._tick)

    def __enter__(self) -> None:
        self._depth += 1  # contexts nest: a controller publishes, and another one takes the message
        if self._depth == 1:
            self._end_s = monotonic() + self.most_s
            self._was_entered = True
            if not self._tick_s:
                self._set_timer(_TICK_S)

    def __exit__(self, *_: Any) -> None:
        self._depth -= 1
        if not self._depth:
            self._end_s = inf
            if self._has_ended:
                self._has_ended = False
                self.on_end()

    def close(self) -> None:
        """Stop the timer."""
        self._set_timer(0.0)

    def _set_timer(self, period_s: float) -> None:
        self._tick_s = period_s
        signal.setitimer(signal.ITIMER_REAL, period_s, period_s)

    def _tick(self, _number: int, frame: FrameType | None) -> None:
        if monotonic() < self._end_s:
            self._spared = 0
            if self._end_s == inf and not self._was_entered:
                self._set_timer(0.0)
            elif self._tick_s != _TICK_S:
                self._set_timer(_TICK_S)
            self._was_entered = False
            return
        if self._tick_s != _AGAIN_S:  # tick faster: the code may catch the exception and go on
            self._set_timer(_AGAIN_S)
        # Work of slidectl for the user's code, such as advertising a topic, must be done completely or not at all: the
        # next signals try again until they meet the user's own code.
        self._spared += 1
        if _is_users(frame) or self._spared > _MOST_AGAIN:
            self._has_ended = True
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
