"""Simulated time: the clock, its topic, and timers (deadlines, sleeps, periodic publishing).

Times are integer nanoseconds; wall time is not used here. The cycle compares one integer (`Timers.next_ns`) and
calls `fire` only when something is due, at the end of that cycle.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from slidectl.control.duration import NANOSECONDS, to_stamp
from slidectl.control.node_handle import Publisher

SECOND = NANOSECONDS
NEVER = 1 << 62
EACH_STEP_NS = 1
"""A period that ends with each cycle."""
_FEW = 64


@dataclass(slots=True, eq=False)
class Clock:
    """The time of the last cycle begun, and the number of cycles."""

    time_ns: int = 0
    cycles: int = 0

    def now_ns(self) -> int:
        """Time in nanoseconds."""
        return self.time_ns

    def stamp(self) -> dict[str, int]:
        """Time as a message stamp."""
        return to_stamp(self.time_ns)

    @property
    def seconds(self) -> float:
        """Time in seconds, correctly rounded."""
        return self.time_ns / SECOND


class ClockTopic:
    """Publishes `/clock`: at every cycle, or at a frequency if that is above 0 (gazebo_ros' pub_clock_frequency)."""

    __slots__ = ("_period_ns", "publisher")

    def __init__(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self._period_ns = 0

    def set_frequency(self, frequency_hz: Any) -> None:
        """Set the frequency, in Hz. Anything but a positive number means every cycle."""
        number = frequency_hz if isinstance(frequency_hz, int | float) and not isinstance(frequency_hz, bool) else 0
        self._period_ns = period_ns_of(number) if number > 0 else 0

    def tick(self, time_ns: int, step_ns: int) -> None:
        """Publish if due, as a cycle begins. Times are multiples of the period, independent of subscribers."""
        period = self._period_ns
        if not period or time_ns // period != (time_ns - step_ns) // period:
            self.publish(time_ns)

    def publish(self, time_ns: int) -> None:
        """Publish this time: also after the clock was set, so that subscribers need not wait for the next cycle."""
        if self.publisher.wanted:
            self.publisher.publish({"clock": to_stamp(time_ns)})


@dataclass(slots=True, eq=False)
class Timer:
    """One entry. `period_ns` 0 is a single shot; a periodic timer fires at multiples of its period.

    An `absolute` timer keeps its due time when the clock is set.
    """

    due_ns: int
    callback: Callable[[], None]
    period_ns: int = 0
    absolute: bool = False
    active: bool = True
    number: int = 0
    """Orders timers that are due at the same time: the lower number fires first. 0: the timer was never set."""

    def cancel(self) -> None:
        """Cancel the timer: it does not fire again. No effect when it has fired."""
        self.active = False


class Timers:
    """Timers in the order of their due times; timers of the same time fire in the order in which they were set."""

    saved_attributes: ClassVar[None] = None

    __slots__ = ("_heap", "_made", "_most", "next_ns", "now_ns")

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.now_ns = now_ns
        self.next_ns = NEVER
        self._heap: list[tuple[int, int, Timer]] = []
        self._made = 0
        self._most = _FEW

    def at(self, due_ns: int, callback: Callable[[], None], absolute: bool = False) -> Timer:
        """Call once, at the end of the first cycle whose time is `due_ns` or later.

        When the clock is set the due time moves with it, unless it is `absolute`.
        """
        return self._push(Timer(due_ns, callback, absolute=absolute))

    def after(self, duration_ns: int, callback: Callable[[], None]) -> Timer:
        """Call once, `duration_ns` from now."""
        return self.at(self.now_ns() + duration_ns, callback)

    def soon(self, callback: Callable[[], None]) -> Timer:
        """Call once, at the end of the present cycle."""
        return self.at(self.now_ns(), callback)

    def every(self, period_ns: int, callback: Callable[[], None]) -> Timer:
        """Call at each multiple of the period, counted from time 0, after now."""
        if period_ns <= 0:
            raise ValueError(f"a period is above 0 ns, not {period_ns}")
        return self._push(Timer(_next_multiple(self.now_ns(), period_ns), callback, period_ns))

    def arm(self, timer: Timer, due_ns: int) -> None:
        """Set a timer again, whether it has fired, was cancelled, or is still set for another time."""
        timer.active, timer.due_ns = True, due_ns
        self._push(timer)

    def fire(self) -> None:
        """Call what is due now, and what becomes due by these calls, except a period's next multiple."""
        now = self.now_ns()
        while self._heap and self._heap[0][0] <= now:
            entry = heapq.heappop(self._heap)
            if not _counts(entry):
                continue
            timer = entry[2]
            if timer.period_ns:
                timer.due_ns = _next_multiple(now, timer.period_ns)
                self._push(timer)
            else:
                timer.active = False
            timer.callback()
        self._update_next()

    def rebase(self, old_ns: int, new_ns: int) -> None:
        """Follow a clock that was set from `old_ns` to `new_ns`: running durations keep their remaining time."""
        timers = [entry[2] for entry in sorted(self._heap) if _counts(entry)]
        self._heap.clear()
        for timer in timers:
            if timer.period_ns:
                timer.due_ns = _next_multiple(new_ns, timer.period_ns)
            elif not timer.absolute:
                timer.due_ns += new_ns - old_ns
            self._push(timer)
        self._update_next()

    def _push(self, timer: Timer) -> Timer:
        self._made += 1
        timer.number = self._made
        heapq.heappush(self._heap, (timer.due_ns, timer.number, timer))
        if len(self._heap) > self._most:  # drop cancelled timers: in a paused world nothing else removes them
            self._heap = [entry for entry in self._heap if _counts(entry)]
            heapq.heapify(self._heap)
            self._most = 2 * len(self._heap) + _FEW
        self._update_next()
        return timer

    def _update_next(self) -> None:
        while self._heap and not _counts(self._heap[0]):
            heapq.heappop(self._heap)
        self.next_ns = self._heap[0][0] if self._heap else NEVER


def period_ns_of(rate_hz: float, least_ns: int = EACH_STEP_NS) -> int:
    """The period of a rate, in ns: at least `least_ns` (also for a rate that is not above 0), at most NEVER."""
    return max(least_ns, round(min(SECOND / rate_hz, float(NEVER)))) if 0.0 < rate_hz < SECOND else least_ns


def _counts(entry: tuple[int, int, Timer]) -> bool:
    """False for an entry whose timer was cancelled, or set to another time since."""
    return entry[2].active and entry[2].number == entry[1]


def _next_multiple(now_ns: int, period_ns: int) -> int:
    return (now_ns // period_ns + 1) * period_ns


class RepeatedCall:
    """Calls back once in each period from now on, at the end of the first cycle at or after that time."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("_timer",)

    def __init__(
        self, timers: Timers, period_ns: int, callback: Callable[[], None], running: list[RepeatedCall]
    ) -> None:
        """`running` is the list of all calls of one node handle; this call is in it until it is cancelled."""
        if period_ns <= 0:
            raise ValueError(f"a period is above 0 ns, not {period_ns}")
        self._timers = timers
        self._period_ns = period_ns
        self._callback = callback
        self._running = running
        self._timer = Timer(0, self._call)
        self.restart()

    def restart(self) -> None:
        """Begin again: the first call comes one period from now."""
        self._timers.arm(self._timer, self._timers.now_ns() + self._period_ns)
        self.resume()

    def resume(self) -> None:
        """Add this call, whose timer is set, to the running ones."""
        if self not in self._running:
            self._running.append(self)

    def cancel(self) -> None:
        """Stop calling back."""
        self._timer.cancel()
        if self in self._running:
            self._running.remove(self)

    def _call(self) -> None:
        # Count from the timer's due time, since that moves when the clock is set. Missed periods are skipped.
        due_ns = self._timer.due_ns
        missed = (self._timers.now_ns() - due_ns) // self._period_ns
        self._timers.arm(self._timer, due_ns + (missed + 1) * self._period_ns)
        self._callback()
