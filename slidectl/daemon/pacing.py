"""When cycles run: at a real-time factor, as fast as possible, or as many as somebody asked for.

Called between two looks at the sockets; runs a slice of at most a few ms and says how long there is nothing to do.
Wall time is in seconds; the simulation itself never sees it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Protocol

from slidectl.daemon.statistics import Ring, SpeedMeter

FREE_SLICE_S = 0.0005
CATCH_UP_SLICE_S = 0.002
MOST_BEHIND_S = 0.1
"""What is later than this is not caught up: the schedule is moved instead, and the speed that is reached says so."""
_SHORTEST_WAIT_S = 0.001
_SHORT_S, _LONG_S, _GROWTH = 0.00004, 0.00014, 1.05
"""Free-running cycles between two looks at the sockets: few after a client knocked, then ever more up to many."""
_LONGEST_CHUNK = 1024


class Wishes(Protocol):
    """How the world is asked to run (simulation.loop.RunState)."""

    paused: bool
    speed: float

    def allowed(self, most: int) -> int:
        """How many cycles, at most `most`, may run now."""


class Steppable(Protocol):
    """What is paced (simulation.loop.Loop)."""

    @property
    def run(self) -> Wishes:
        """The wishes."""

    step_ns: int
    """Nanoseconds of one cycle."""

    def step(self, cycles: int = 1) -> int:
        """Run so many cycles; fewer when the physics diverges."""


class Pacer:
    """Runs a simulation along the wall clock.

    Cycles at a real-time factor run in groups of at least 1 ms of wall time, each group when its time has come:
    one cycle at the usual 1 kHz. `lateness` is how much later than that a group began, `durations` the wall time of a
    cycle (the mean of a group), `overruns` the groups that began more than their own length too late. Cycles that run
    as fast as possible make way as soon as `knocked` says that a client wants something. `limit` tells the simulation
    the time at which it is to end a step early (None: never): cycles may suddenly take a thousand times as long.
    """

    def __init__(
        self,
        simulation: Steppable,
        clock: Callable[[], float] = time.perf_counter,
        knocked: Callable[[], bool] = lambda: False,
        limit: Callable[[float | None], None] = lambda _: None,
    ) -> None:
        self._simulation = simulation
        self._knocked = knocked
        self._limit = limit
        self._clock = clock
        self._mode: tuple[float, int] | None = None
        self._step_s = 0.0
        self._due_s = 0.0
        self._is_free = False
        self._group = 1
        self._group_s = 0.0
        self._chunk = 1
        self._chunk_s = _SHORT_S
        self.speed = SpeedMeter()
        self.lateness = Ring()
        self.durations = Ring()
        self.overruns = 0
        self.given_up_s = 0.0
        """Wall time that was not caught up, in all."""

    def turn(self) -> float | None:
        """Run what is due. Returns the wall seconds until more is due; None: not before somebody asks."""
        simulation, run = self._simulation, self._simulation.run
        if run.paused and not run.allowed(1):
            self._mode = None
            self.speed.stop()
            return None
        mode = (math.inf if run.paused else run.speed, simulation.step_ns)
        if mode != self._mode:
            self._begin(mode)
        return self._run_freely() if self._is_free else self._run_paced()

    def _begin(self, mode: tuple[float, int]) -> None:
        self._mode = mode
        factor, step_ns = mode
        self._step_s = step_ns * 1e-9
        period_s = self._step_s / factor
        # A million cycles a second and more are what no machine reaches: as fast as possible comes to the same.
        self._is_free = period_s * _LONGEST_CHUNK < _SHORTEST_WAIT_S
        self._limit(None)
        self._group = 1 if self._is_free else max(1, int(_SHORTEST_WAIT_S / period_s))
        self._group_s = self._group * period_s
        self._due_s = self._clock()
        self.speed.begin(self._due_s)
        self.lateness.clear()

    def _run_freely(self) -> float:
        run, step, clock, speed = self._simulation.run, self._simulation.step, self._clock, self.speed
        now = clock()
        end = now + FREE_SLICE_S
        self._limit(end)
        while now < end and (asked := run.allowed(self._chunk)):
            done = step(asked)
            began, now = now, clock()
            if not done:
                break
            duration = (now - began) / done
            self.durations.add(duration)
            speed.simulated_s += done * self._step_s
            if now >= speed.next_mark_s:
                speed.mark(now)
            knocked = self._knocked()
            self._chunk_s = _SHORT_S if knocked else min(_LONG_S, _GROWTH * self._chunk_s)
            self._chunk = max(1, min(_LONGEST_CHUNK, int(self._chunk_s / max(duration, 1e-9))))
            if knocked:
                break
        return 0.0

    def _run_paced(self) -> float:
        step, clock, speed, group = self._simulation.step, self._clock, self.speed, self._group
        now = clock()
        if now < self._due_s:
            return self._due_s - now
        if now - self._due_s > MOST_BEHIND_S:
            self._give_up_what_is_too_late(now)
        end = now + CATCH_UP_SLICE_S
        while self._due_s <= now < end:
            late = now - self._due_s
            self.lateness.add(late)
            if late > self._group_s:
                self.overruns += 1
            done = step(group)
            began, now = now, clock()
            self.durations.add((now - began) / group)
            speed.simulated_s += done * self._step_s
            if now >= speed.next_mark_s:
                speed.mark(now)
            self._due_s += self._group_s
            if done < group:
                return 0.0
        return max(0.0, self._due_s - now)

    def _give_up_what_is_too_late(self, now: float) -> None:
        self.given_up_s += now - self._due_s - MOST_BEHIND_S
        self._due_s = now - MOST_BEHIND_S

    def report(self) -> dict[str, float]:
        """The figures of /slidectl/status, wall seconds."""
        mean, _, p99, worst = self.durations.summary()
        _, late_p50, late_p99, _ = self.lateness.summary()
        return {
            "speed_reached": self.speed.reached(self._clock()),
            "cycle_mean": mean,
            "cycle_p99": p99,
            "cycle_worst": worst,
            "lateness_p50": late_p50,
            "lateness_p99": late_p99,
            "overruns": self.overruns,
        }
