"""Figures about the recent past: durations in a ring, and the speed that was really reached.

Adding is cheap (it happens in every cycle), asking is not free but rare. Wall seconds throughout.
"""

from __future__ import annotations

from array import array
from collections import deque

import numpy as np

_RECENT = 8192
_MARK_EVERY_S = 0.1
_MARKS = 20


class Ring:
    """The last 8192 values."""

    __slots__ = ("_count", "_next", "_values")

    def __init__(self) -> None:
        self._values = array("d", bytes(8 * _RECENT))
        self._next = 0
        self._count = 0

    def add(self, value: float) -> None:
        """One more; the oldest goes."""
        index = self._next
        self._values[index] = value
        self._next = index + 1 if index + 1 < _RECENT else 0
        if self._count < _RECENT:
            self._count += 1

    def clear(self) -> None:
        """Forget all."""
        self._next = self._count = 0

    def summary(self) -> tuple[float, float, float, float]:
        """Mean, p50, p99 and largest value; zeros when there is none."""
        if not self._count:
            return 0.0, 0.0, 0.0, 0.0
        values = np.frombuffer(self._values, count=self._count)
        middle, high = self._count // 2, min(self._count - 1, int(self._count * 0.99))
        ordered = np.partition(values, (middle, high))
        return float(values.mean()), float(ordered[middle]), float(ordered[high]), float(values.max())


class SpeedMeter:
    """Simulated seconds per wall second over about the last two seconds in which the world was asked to run."""

    __slots__ = ("_marks", "next_mark_s", "simulated_s")

    def __init__(self) -> None:
        self.simulated_s = 0.0
        """Add to it what was simulated."""
        self._marks: deque[tuple[float, float]] = deque(maxlen=_MARKS)
        self.next_mark_s = 0.0
        """When `mark` is due."""

    def begin(self, now_s: float) -> None:
        """The world was asked to run, or to run otherwise, from now on."""
        self._marks.clear()
        self.mark(now_s)

    def stop(self) -> None:
        """The world stands still."""
        self._marks.clear()

    def reached(self, now_s: float) -> float:
        """The real-time factor; 0 when the world stands still."""
        if not self._marks:
            return 0.0
        since_s, simulated_s = self._marks[0]
        return (self.simulated_s - simulated_s) / (now_s - since_s) if now_s > since_s else 0.0

    def mark(self, now_s: float) -> None:
        """So far it is at that time."""
        self._marks.append((now_s, self.simulated_s))
        self.next_mark_s = now_s + _MARK_EVERY_S
