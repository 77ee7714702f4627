"""The timing of cycles: at a real-time factor, as fast as possible, or as many as were requested.

Called between two polls of the sockets. It runs a slice of a few ms at most and returns the time until the next.
Wall time is in seconds; the simulation itself never sees it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from slidectl.simulation.loop import Loop

FREE_SLICE_S = 0.0005
CATCH_UP_SLICE_S = 0.002
MOST_BEHIND_S = 0.1
"""A larger delay is not caught up: the schedule is moved, and the reported speed shows it."""
_SHORTEST_WAIT_S = 0.001
_CHUNK_S = 0.00014
"""Wall time of free-running cycles between two polls of the sockets; a poll takes a microsecond."""
_LONGEST_CHUNK = 1024
_RECENT = 8192
"""The number of cycles in the statistics."""
_MARK_EVERY_S, _MARKS = 0.1, 20
"""The reported speed is that of about the last two seconds."""


class Pacer:
    """Runs a simulation along the wall clock.

    Cycles at a real-time factor run in groups of at least 1 ms of wall time, each group when it is due:
    one cycle at the usual 1 kHz. `lateness` is the delay of a group's start, `durations` the wall time of a
    cycle (the mean of a group), `overruns` the number of groups that began later than their own length. Cycles that run
    as fast as possible pause as soon as `clients_wait` returns true.
    """

    def __init__(
        self,
        simulation: Loop,
        clock: Callable[[], float] = time.perf_counter,
        clients_wait: Callable[[], bool] = lambda: False,
    ) -> None:
        self._simulation = simulation
        self._clients_wait = clients_wait
        self._clock = clock
        self._mode: tuple[float, int] | None = None
        self._step_s = 0.0
        self._due_s = 0.0
        self._is_free = False
        self._group = 1
        self._period_s = 0.0
        self._chunk = 1
        self._simulated_s = 0.0
        self._marks: deque[tuple[float, float]] = deque(maxlen=_MARKS)
        """Samples of wall time and simulated time; empty while the world stands still."""
        self._next_mark_s = 0.0
        self._held_since_s = math.inf
        """Wall time since which the world has waited for lock-step members."""
        self.lateness: deque[float] = deque(maxlen=_RECENT)
        self.durations: deque[float] = deque(maxlen=_RECENT)
        self.overruns = 0
        self.given_up_s = 0.0
        """Wall time that was not caught up, in total."""

    def turn(self) -> float | None:
        """Run due cycles. Returns the wall seconds until more are due; None: not before a request."""
        simulation, run = self._simulation, self._simulation.run
        if not run.requested(1):
            self._mode = None
            self._marks.clear()
            return None
        if run.gates and not run.allowed(1):
            return self._wait_for_members()
        self._held_since_s = math.inf
        mode = (math.inf if run.paused or run.holders else run.speed, simulation.step_ns)
        if mode != self._mode:
            self._begin(mode)
        return self._run_freely() if self._is_free else self._run_paced()

    def _wait_for_members(self) -> float:
        """Remove lock-step members that have timed out. Returns the wall seconds until the next may time out."""
        run = self._simulation.run
        now = self._clock()
        self._held_since_s = min(self._held_since_s, now)
        held_s = now - self._held_since_s
        for gate, member in run.awaited():
            if held_s >= member.timeout_s:
                gate.let_go(member)
        return min((member.timeout_s - held_s for _, member in run.awaited()), default=0.0)

    def _begin(self, mode: tuple[float, int]) -> None:
        self._mode = mode
        factor, step_ns = mode
        self._step_s = step_ns * 1e-9
        period_s = self._step_s / factor
        # No machine reaches a million cycles a second: run as fast as possible instead.
        self._is_free = period_s * _LONGEST_CHUNK < _SHORTEST_WAIT_S
        self._simulation.enough = None
        self._group = 1 if self._is_free else max(1, int(_SHORTEST_WAIT_S / period_s))
        self._period_s = period_s
        self._due_s = self._clock()
        self._marks.clear()
        self._mark(self._due_s)
        self.lateness.clear()

    def _mark(self, now_s: float) -> None:
        self._marks.append((now_s, self._simulated_s))
        self._next_mark_s = now_s + _MARK_EVERY_S

    def _run_freely(self) -> float | None:
        run, step, clock = self._simulation.run, self._simulation.step, self._clock
        now = clock()
        end = now + FREE_SLICE_S
        self._simulation.enough = lambda: clock() >= end  # cycles may suddenly take a thousand times as long
        asked = run.allowed(self._chunk)
        while asked:
            done = step(asked)
            began, now = now, clock()
            if not done:
                break
            duration = (now - began) / done
            self.durations.append(duration)
            self._simulated_s += done * self._step_s
            if now >= self._next_mark_s:
                self._mark(now)
            self._chunk = max(1, min(_LONGEST_CHUNK, int(_CHUNK_S / max(duration, 1e-9))))
            asked = run.allowed(self._chunk)
            if now >= end or (asked and self._clients_wait()):
                break
        return 0.0 if asked else self.turn()

    def _run_paced(self) -> float:
        step, clock, group = self._simulation.step, self._clock, self._group
        allowed = self._simulation.run.allowed
        now = clock()
        if now < self._due_s:
            return self._due_s - now
        if now - self._due_s > MOST_BEHIND_S:
            self.given_up_s += now - self._due_s - MOST_BEHIND_S
            self._due_s = now - MOST_BEHIND_S
        end = now + CATCH_UP_SLICE_S
        while self._due_s <= now < end:
            asked = allowed(group)
            if not asked:  # the world waits for lock-step members
                return 0.0
            late = now - self._due_s
            self.lateness.append(late)
            if late > group * self._period_s:
                self.overruns += 1
            done = step(asked)
            began, now = now, clock()
            if not done:
                return 0.0
            self.durations.append((now - began) / done)
            self._simulated_s += done * self._step_s
            if now >= self._next_mark_s:
                self._mark(now)
            self._due_s += done * self._period_s
            if done < asked:
                return 0.0
        return max(0.0, self._due_s - now)

    def report(self) -> dict[str, float]:
        """The figures of /slidectl/status, in wall seconds."""
        mean, _, p99, worst = _summary(self.durations)
        _, late_p50, late_p99, _ = _summary(self.lateness)
        return {
            "speed_reached": self._speed_reached(),
            "cycle_mean": mean,
            "cycle_p99": p99,
            "cycle_worst": worst,
            "lateness_p50": late_p50,
            "lateness_p99": late_p99,
            "overruns": self.overruns,
        }

    def _speed_reached(self) -> float:
        """The real-time factor; 0 while the world stands still."""
        if not self._marks:
            return 0.0
        now_s, (since_s, simulated_s) = self._clock(), self._marks[0]
        return (self._simulated_s - simulated_s) / (now_s - since_s) if now_s > since_s else 0.0


def _summary(recent: deque[float]) -> tuple[float, float, float, float]:
    """Mean, p50, p99 and largest value; zeros without values."""
    if not recent:
        return 0.0, 0.0, 0.0, 0.0
    values = np.array(recent)
    p50, p99 = np.quantile(values, (0.5, 0.99), method="higher")
    return float(values.mean()), float(p50), float(p99), float(values.max())
