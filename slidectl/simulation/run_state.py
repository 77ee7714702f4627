"""How the world is asked to run: paused or not, how fast, and the steps that somebody waits for.

Plain state with its transitions. It runs nothing itself: a driver (the daemon) looks at it between two slices.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from slidectl.errors import Refused
from slidectl.simulation.pending import Pending


class StepRequest:
    """Cycles that somebody asked for and waits for."""

    __slots__ = ("asked", "pending", "remaining")

    def __init__(self, cycles: int, pending: Pending) -> None:
        self.asked = cycles
        self.remaining = cycles
        self.pending = pending


class RunState:
    """`paused` and `speed` (real-time factor; infinite: as fast as possible) are wishes; steps run even when paused."""

    def __init__(self) -> None:
        self.paused = False
        self.speed = 1.0
        self.trouble = ""
        """What holds the world, when nobody asked for that."""
        self.on_halt: Callable[[], None] = _nothing
        """Called when the world comes to a stand: by `pause`, after the last step, or when nobody waits for steps."""
        self.requests: deque[StepRequest] = deque()
        """Who waits for steps, in the order of asking."""

    @property
    def pending_steps(self) -> int:
        """Cycles that were asked for and have not run yet."""
        return sum(request.remaining for request in self.requests)

    def pause(self) -> None:
        """Hold the world; steps that somebody waits for are given up."""
        self.paused = True
        self.abandon_steps("paused")

    def resume(self) -> None:
        """Let the world go on."""
        self.paused = False
        self.trouble = ""

    def hold(self, trouble: str, reason: str) -> None:
        """Something went wrong: pause. Who waits for steps is told the short `reason`."""
        self.paused = True
        self.trouble = trouble
        self.abandon_steps(reason)

    def allowed(self, most: int) -> int:
        """How many cycles, at most `most`, may run now."""
        return min(most, self.pending_steps) if self.paused else most

    def set_speed(self, factor: float) -> None:
        """Ask for a real-time factor above 0, or 0 for as fast as possible. Raises Refused for anything else."""
        if not math.isfinite(factor) or factor < 0:
            raise Refused(f"speed is 0 (as fast as possible) or a number above it, not {factor:g}")
        self.speed = factor or math.inf

    def ask_steps(self, cycles: int) -> Pending:
        """Pause, and run so many cycles more. Resolved with the number of cycles when they are done."""
        self.paused = True
        request = StepRequest(cycles, Pending())
        request.pending.on_cancel = lambda: self._drop(request)
        self.requests.append(request)
        return request.pending

    def until_answer(self, cycles: int) -> int:
        """`cycles`, cut at the end of the first request, so that it is answered in its own cycle."""
        return min(cycles, self.requests[0].remaining) if self.requests else cycles

    def took(self, cycles: int) -> None:
        """So many cycles have run, not more than `until_answer` allowed."""
        if self.requests:
            self.requests[0].remaining -= cycles
            if self.requests[0].remaining <= 0:
                request = self.requests.popleft()
                request.pending.resolve(request.asked)
                self._look_for_halt()

    def abandon_steps(self, reason: str) -> None:
        """Forget the steps; those who wait are told the reason."""
        while self.requests:
            request = self.requests.popleft()
            done = request.asked - request.remaining
            request.pending.reject(Refused(f"{reason} after {done} of {request.asked} cycles"))
        self._look_for_halt()

    def _drop(self, request: StepRequest) -> None:
        if request in self.requests:
            self.requests.remove(request)
            self._look_for_halt()

    def _look_for_halt(self) -> None:
        if self.allowed(1) == 0:
            self.on_halt()


def _nothing() -> None:
    """For a world in which nothing waits for cycles."""
