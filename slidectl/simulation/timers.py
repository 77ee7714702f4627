"""What is due at a simulated time: deadlines, sleeps, periodic publishing.

The cycle compares one integer (`next_ns`) and calls `fire` only when something is due, at the end of that cycle.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

NEVER = 1 << 62
_FEW = 64


class Timer:
    """One entry. `period_ns` 0 is a single shot; a periodic timer fires at multiples of its period."""

    __slots__ = ("active", "callback", "due_ns", "period_ns")

    def __init__(self, due_ns: int, callback: Callable[[], None], period_ns: int = 0) -> None:
        self.due_ns = due_ns
        self.callback = callback
        self.period_ns = period_ns
        self.active = True

    def cancel(self) -> None:
        """It will not fire (again). Harmless when it has fired."""
        self.active = False


class Timers:
    """Timers in the order of their due times; those of one time fire in the order in which they were made."""

    __slots__ = ("_heap", "_made", "_most", "next_ns", "now_ns")

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.now_ns = now_ns
        self.next_ns = NEVER
        self._heap: list[tuple[int, int, Timer]] = []
        self._made = 0
        self._most = _FEW

    def at(self, due_ns: int, callback: Callable[[], None]) -> Timer:
        """Once, at the end of the first cycle whose time is `due_ns` or later."""
        return self._push(Timer(due_ns, callback))

    def after(self, duration_ns: int, callback: Callable[[], None]) -> Timer:
        """Once, `duration_ns` from now."""
        return self.at(self.now_ns() + duration_ns, callback)

    def soon(self, callback: Callable[[], None]) -> Timer:
        """Once, at the end of the present cycle."""
        return self.at(self.now_ns(), callback)

    def every(self, period_ns: int, callback: Callable[[], None]) -> Timer:
        """At each multiple of the period, counted from time 0, after now."""
        if period_ns <= 0:
            raise ValueError(f"a period is above 0 ns, not {period_ns}")
        return self._push(Timer(_next_multiple(self.now_ns(), period_ns), callback, period_ns))

    def fire(self) -> None:
        """Call what is due now. What becomes due by that is called too, except a period's next multiple."""
        now = self.now_ns()
        while self._heap and self._heap[0][0] <= now:
            timer = heapq.heappop(self._heap)[2]
            if timer.active:
                self._call(timer, now)
        self._update_next()

    def rebase(self, old_ns: int, new_ns: int) -> None:
        """The clock was set from `old_ns` to `new_ns`: durations that are running keep what is left of them."""
        timers = [entry[2] for entry in sorted(self._heap, key=lambda entry: entry[:2]) if entry[2].active]
        self._heap.clear()
        for timer in timers:
            left = timer.due_ns - old_ns
            timer.due_ns = _next_multiple(new_ns, timer.period_ns) if timer.period_ns else new_ns + left
            self._push(timer)
        self._update_next()

    def _call(self, timer: Timer, now: int) -> None:
        if timer.period_ns:
            timer.due_ns = _next_multiple(now, timer.period_ns)
            self._push(timer)
        else:
            timer.active = False
        timer.callback()

    def _push(self, timer: Timer) -> Timer:
        self._made += 1
        heapq.heappush(self._heap, (timer.due_ns, self._made, timer))
        if len(self._heap) > self._most:
            self._sweep()
        self._update_next()
        return timer

    def _sweep(self) -> None:
        """Drop the cancelled ones; in a world that stands still nothing else would."""
        self._heap = [entry for entry in self._heap if entry[2].active]
        heapq.heapify(self._heap)
        self._most = 2 * len(self._heap) + _FEW

    def _update_next(self) -> None:
        while self._heap and not self._heap[0][2].active:
            heapq.heappop(self._heap)
        self.next_ns = self._heap[0][0] if self._heap else NEVER


def _next_multiple(now_ns: int, period_ns: int) -> int:
    return (now_ns // period_ns + 1) * period_ns
