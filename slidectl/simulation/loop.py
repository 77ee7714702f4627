"""The loop of cycles, and how it is asked to run: paused or not, how fast, and the steps that somebody waits for.

One cycle after the other, on demand. It knows simulated time only; the caller decides how fast it is called.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from numbers import Real
from typing import TYPE_CHECKING

from slidectl.errors import Refused, SlidectlError
from slidectl.physics import Diverged, EngineError, World
from slidectl.simulation.compiled.engine import Engine
from slidectl.simulation.cycle import CHECK_EVERY, HardwareFailed, PlainRunner, Runner
from slidectl.simulation.graph import WORLD_NODE, Graph
from slidectl.simulation.history import History
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.simulation.lockstep import LockStepService
    from slidectl.simulation.spawned_robots import SpawnedRobot

FEW = 16
"""Fewer cycles than these are not worth the way into the tables and back, which is made when nobody drives."""


FAILED = "a control cycle failed"
"""What a driver says of a fault in a cycle that is none of the user's; it holds the world then."""
SHORTEST_S = 1e-6
LONGEST_S = 1.0
"""Bounds of a time step, as at the daemon's start. With longer ones the clock soon leaves what a message can hold."""


def check_timestep(seconds: float, name: str = "timestep") -> None:
    """Raises Refused for what is no time step."""
    if not isinstance(seconds, Real) or not SHORTEST_S <= seconds <= LONGEST_S:
        raise Refused(f"{name} is between {SHORTEST_S:g} s and {LONGEST_S:g} s, not {seconds!r}")


def whole_cycles(asked_ns: int, step_ns: int, start_ns: int = 0) -> int:
    """How many cycles so much time is. Raises Refused for no whole number of them, with the times that would be.

    With a time of the clock in `start_ns` these are times of the clock too.
    """
    cycles = round(asked_ns / step_ns)
    # A time step such as 1/240 s is rounded to nanoseconds, so a second of it is up to one off for each cycle.
    if abs(cycles * step_ns - asked_ns) > cycles:
        below = asked_ns // step_ns
        near = [f"{(start_ns + count * step_ns) * 1e-9:.9g}s" for count in (below, below + 1) if count]
        after = f" after {start_ns * 1e-9:.9g} s" if start_ns else ""
        text = f"{(start_ns + asked_ns) * 1e-9:.9g} s is no whole number of cycles of {step_ns * 1e-9:g} s{after}"
        raise Refused(text, f"possible: {' or '.join(near)}")
    return cycles


class StepRequest:
    """Cycles that somebody asked for and waits for; with a `reader` no more when there is news for that node."""

    __slots__ = ("asked", "has_news", "pending", "reader", "remaining")

    def __init__(self, cycles: int, pending: Pending, reader: str) -> None:
        self.reader = reader
        self.has_news = False
        self.asked = cycles
        self.remaining = cycles
        self.pending = pending


class RunState:
    """How the world is asked to run. It runs nothing itself: a driver (the daemon) looks at it between two slices.

    `paused` and `speed` (real-time factor; infinite: as fast as possible) are wishes; steps run even when paused.
    """

    def __init__(self) -> None:
        self.paused = False
        self.speed = 1.0
        self.trouble = ""
        """What holds the world, when nobody asked for that."""
        self.on_halt: Callable[[], None] = lambda: None
        """Called when the world comes to a stand: by `pause`, after the last step, or when nobody waits for steps."""
        self.requests: deque[StepRequest] = deque()
        """Who waits for steps, in the order of asking."""
        self.holders: set[str] = set()
        """Nodes by whose requests alone the world goes on."""
        self.news_wanted = False
        """True while `note_message` may end the steps that somebody asked for."""
        self.on_news: Callable[[], None] = lambda: None
        """Called when they are to end with the cycle that runs."""
        self.lockstep: LockStepService | None = None
        """Those for whom the world waits, while there are any."""

    @property
    def pending_steps(self) -> int:
        """Cycles that were asked for, but by holders, and have not run yet."""
        return sum(request.remaining for request in self.requests if not request.reader)

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

    def asked(self, most: int) -> int:
        """How many cycles, at most `most`, are wanted now: of a held world only those that its holder waits for."""
        if self.holders:
            holder = self._first(of_holder=True)
            most = 0 if holder is None else min(most, holder.remaining)
        return min(most, self.pending_steps) if self.paused else most

    def allowed(self, most: int) -> int:
        """How many cycles, at most `most`, may run now."""
        if self.lockstep is not None:
            most = self.lockstep.allowed(most)
        return self.asked(most)

    @property
    def stands_still(self) -> bool:
        """True when no cycle comes that nobody has asked for. Who holds the world is going to ask."""
        return self.paused and not self.pending_steps if self.holders else self.allowed(1) == 0

    def set_speed(self, factor: float) -> None:
        """Ask for a real-time factor above 0, or 0 for as fast as possible. Raises Refused for anything else."""
        if not math.isfinite(factor) or factor < 0:
            raise Refused(f"speed is 0 (as fast as possible) or a number above it, not {factor:g}")
        self.speed = factor or math.inf

    def ask_steps(self, cycles: int, reader: str = "") -> Pending:
        """Pause, and run so many cycles more. Resolved with the number of cycles when they are done.

        With a `reader`, which holds the world, it is not paused, and they end with the cycle in which `note_message` is
        called for that; where it is paused only those come that others ask for.
        """
        if not reader:
            self.paused = True
        elif self.paused and not self.pending_steps:
            return Pending.of(0)
        request = StepRequest(cycles, Pending(), reader)
        request.pending.on_cancel = lambda: self._drop(request)
        self.requests.append(request)
        self.news_wanted = self.news_wanted or bool(reader)
        return request.pending

    def note_message(self, node: str = "") -> None:
        """There is a message for a node, or an answer for anybody."""
        for request in self.requests:
            if request.reader and node in ("", request.reader):
                request.has_news = True
                self.on_news()

    def _first(self, of_holder: bool) -> StepRequest | None:
        return next((request for request in self.requests if bool(request.reader) is of_holder), None)

    def until_answer(self, cycles: int) -> int:
        """`cycles`, cut where a request ends, so that it is answered in its own cycle."""
        running = self._first(of_holder=False), self._first(of_holder=True)
        return min([cycles, *(request.remaining for request in running if request is not None)])

    def took(self, cycles: int) -> None:
        """So many cycles have run, not more than `until_answer` allowed."""
        for request in (self._first(of_holder=False), self._first(of_holder=True)):  # an answer is news for a holder
            if request is None or request not in self.requests:
                continue
            request.remaining -= cycles
            is_stopped = request.reader and self.paused and not self.pending_steps
            if request.remaining <= 0 or request.has_news or is_stopped:
                self.requests.remove(request)
                self.news_wanted = any(one.reader for one in self.requests)
                request.pending.resolve(request.asked - request.remaining)
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
            self.took(0)  # a holder may wait for cycles that do not come any more
            self._look_for_halt()

    def _look_for_halt(self) -> None:
        if self.stands_still:
            self.on_halt()


class Loop:
    """Runs cycles, by the interpreter or by machine code: see `engine`."""

    def __init__(self, graph: Graph, world: World, step_ns: int, engine: str) -> None:
        self.graph = graph
        self.world = world
        self.step_ns = step_ns
        self.run = RunState()
        self.run.on_news = self.end_burst
        self.driven = False
        """True when somebody else (the daemon) calls `step` as `run` says; else time moves only when asked."""
        self.enough: Callable[[], bool] | None = None
        """Asked now and then between two cycles of a `step`: True ends it, since the driver has other things to do.
        How long the next cycles take is not known before they have run: a robot may have come, or fallen."""
        self.in_cycle = False
        self.robots: tuple[SpawnedRobot, ...] = ()
        self.history = History(world)
        self.plain = PlainRunner(self)
        self.runner: Runner = self.plain
        """Who runs cycles where there are more than a few."""
        self._memory = world.data, world.views
        self.engine = Engine(self, engine)
        world.on_rebuild(self._world_changed)

    def take_robots(self, robots: tuple[SpawnedRobot, ...]) -> None:
        """These are the robots from now on, in this order."""
        self.robots = robots
        for runner in (self.plain, self.runner):
            runner.take_robots(robots)
        for robot in robots:
            robot.node.before_entry = partial(self.runner.give_back, robot)

    def _world_changed(self) -> None:
        data, views = self._memory
        if self.world.data is not data:
            self.history.begin()
        if self.world.data is not data or self.world.views is not views:  # arrays lie elsewhere
            self._memory = self.world.data, self.world.views
            self.runner.follow_world()

    @property
    def stands_still(self) -> bool:
        """True when no cycle will come by itself."""
        return not self.in_cycle and (not self.driven or self.run.stands_still)

    def between_cycles(self, action: str) -> None:
        """Raises Refused inside a cycle, where others still work on what the action changes."""
        if self.in_cycle:
            raise Refused(
                f"cannot {action} in the middle of a control cycle", "do it after the cycle: graph.timers.soon(...)"
            )

    def end_burst(self) -> None:
        """Let the runner stop after the running cycle, as after each in which a timer is due."""
        if self.in_cycle:
            self.graph.timers.soon(lambda: None)

    def after_cycle(self, callback: Callable[[], None]) -> None:
        """Call back at the end of the running cycle, or at once when none is running."""
        if self.in_cycle:
            self.graph.timers.soon(callback)
        else:
            callback()

    def settle(self) -> None:
        """Somebody is about to look at handles and controllers that he holds: let them be what they should be."""
        self.runner.give_back_all()

    def step(self, cycles: int = 1) -> int:
        """Run so many cycles. Returns how many: fewer when there is `enough`, or the physics diverges and `driven`.

        Raises:
            Diverged: the state of a robot is no longer a number, and nobody drives.
        """
        if self.in_cycle:
            self.between_cycles("step")
        if not self.engine.is_settled:
            self.engine.advance(cycles)
        runner = self.runner if self.driven or cycles >= FEW else self.plain
        left, run = cycles, self.run
        try:
            while left > 0:
                done, trouble = self._burst(run.until_answer(left) if run.requests else left, runner)
                left -= done
                if run.requests:
                    run.took(done)
                if trouble is not None:
                    self._give_up(trouble)
                    break
                if run.holders and run.allowed(left) < left:  # news has ended a request
                    break
                if self.enough is not None and self.enough():
                    break
        finally:
            if not self.driven:
                runner.give_back_all()
        return cycles - left

    def _burst(self, count: int, runner: Runner) -> tuple[int, SlidectlError | None]:
        """At most `count` cycles: how many, and what is wrong with the physics when that was looked at."""
        clock = self.graph.clock
        before = clock.cycles
        try:
            done = runner.run(count)
            if clock.cycles % CHECK_EVERY == 0:
                self.world.check()
        except (Diverged, HardwareFailed) as trouble:
            return clock.cycles - before, trouble
        except EngineError as trouble:
            return clock.cycles - before, Refused(f"MuJoCo cannot go on: {trouble}")
        return done, None

    def _give_up(self, trouble: SlidectlError) -> None:
        """Hold the world; whoever drives it is told by the log, whoever calls it directly by the error."""
        what = "the world cannot go on" if isinstance(trouble, HardwareFailed) else "the simulation diverged"
        self.run.hold(trouble.message, what)
        self.graph.log("fatal", WORLD_NODE, str(trouble))
        if not self.driven:
            raise trouble
