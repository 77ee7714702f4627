"""A limit of wall time around users' code, which would hold up the daemon and all its clients if it did not end.

There is one thread, so nobody else can end that code: a timer's signal interrupts it, and the signal's handler raises
an exception in it. This is on only while users' code is imported and in the hooks of a controller's life, never in its
`update`. Code in C that does not return to the interpreter cannot be interrupted.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from slidectl.control import controller_interface, user_classes
from slidectl.control.user_classes import PACKAGE, TookTooLong

LIMIT_S = 5.0
_AGAIN_S = 0.005
_MOST_AGAIN = 200
"""Signals that may meet code of slidectl before that is interrupted too."""
_ENTRIES = (controller_interface.__file__, user_classes.__file__)
"""Files whose functions call users' code and have nothing to lose themselves."""


@contextmanager
def time_limit() -> Iterator[None]:
    """Raise TookTooLong in what runs inside after LIMIT_S. Set as `user_classes.limit`; main thread only."""
    spared = 0

    def interrupt(_number: int, frame: FrameType | None) -> None:
        # What slidectl does for the user's code, such as to advertise a topic, is to be done wholly or not at all: the
        # next signals try again until they meet the user's own code.
        nonlocal spared
        spared += 1
        if _is_ours(frame) and spared < _MOST_AGAIN:
            return
        raise TookTooLong(f"the code ran longer than {LIMIT_S:g} s and was ended")

    before = signal.signal(signal.SIGALRM, interrupt)
    # Again and again: the code may catch the exception and go on.
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S, _AGAIN_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _is_ours(frame: FrameType | None) -> bool:
    """Is the code of a frame slidectl's, or that of a library which slidectl calls?"""
    while frame is not None:
        file = frame.f_code.co_filename
        if file in _ENTRIES:
            return False
        if file.startswith(PACKAGE):
            return True
        frame = frame.f_back
    return False
