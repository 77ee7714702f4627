"""A small loop: descriptors to read, and things to do later. One thread, nothing else.

Knows nothing of nodes and daemons.
"""

from __future__ import annotations

import heapq
import selectors
import time
from collections.abc import Callable
from itertools import count

Action = Callable[[], None]


class Timer:
    """Something to do later, unless it is cancelled."""

    def __init__(self, action: Action) -> None:
        self.action: Action | None = action

    def cancel(self) -> None:
        """It will not be done."""
        self.action = None


class Watch:
    """`turn` waits until something happens and does what belongs to it."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._timers: list[tuple[float, int, Timer]] = []
        self._order = count()

    def add(self, descriptor: int, action: Action) -> None:
        """Do it whenever the descriptor is readable."""
        self._selector.register(descriptor, selectors.EVENT_READ, action)

    def remove(self, descriptor: int) -> None:
        """Look at it no more. One that is not looked at is no error."""
        if descriptor in self._selector.get_map():
            self._selector.unregister(descriptor)

    def later(self, seconds: float, action: Action) -> Timer:
        """Do it once, after so many seconds."""
        timer = Timer(action)
        heapq.heappush(self._timers, (time.monotonic() + seconds, next(self._order), timer))
        return timer

    def turn(self, most_s: float | None = None) -> None:
        """Wait for something, at most so long, and do all that there is to do."""
        for key, _ in self._selector.select(self._patience(most_s)):
            if key.fd in self._selector.get_map():  # an earlier action may have removed it
                key.data()
        now = time.monotonic()
        while self._timers and self._timers[0][0] <= now:
            timer = heapq.heappop(self._timers)[2]
            if timer.action is not None:
                timer.action()

    def _patience(self, most_s: float | None) -> float | None:
        limits = [] if most_s is None else [most_s]
        if self._timers:
            limits.append(self._timers[0][0] - time.monotonic())
        return max(0.0, min(limits)) if limits else None
