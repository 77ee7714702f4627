"""The loop of cycles, and its requested run state: paused or not, the speed, and the requested steps.

The loop runs one cycle after the other on request. It knows simulated time only; the caller sets the pace.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import TYPE_CHECKING, Any, Protocol

from slidectl.errors import Refused, SlidectlError
from slidectl.physics import Diverged, EngineError, World
from slidectl.simulation.compiled.engine import Engine
from slidectl.simulation.cycle import CHECK_EVERY, CycleFailed, PlainRunner, Runner, is_sane
from slidectl.simulation.graph import WORLD_NODE, Graph
from slidectl.simulation.history import History
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.simulation.spawned_robots import SpawnedRobot

LEAST_TABLE_CYCLES = 16
"""With fewer cycles than this, when not driven, copying the state into the tables and back costs more than it saves."""


FAILED = "a control cycle failed"
"""The driver's message when a cycle fails for a reason that is not the user's; it then holds the world."""
SHORTEST_S = 1e-6
LONGEST_S = 1.0
"""Bounds of a time step, as at the daemon's start. With longer steps the clock soon exceeds the range of a message."""


def check_timestep(seconds: float, name: str = "timestep") -> None:
    """Raise Refused when `seconds` is not a valid time step."""
    if not isinstance(seconds, Real) or not SHORTEST_S <= seconds <= LONGEST_S:
        raise Refused(f"{name} is between {SHORTEST_S:g} s and {LONGEST_S:g} s, not {seconds!r}")


def whole_cycles(duration_ns: int, step_ns: int, start_ns: int = 0) -> int:
    """The number of cycles in `duration_ns`. Raises Refused when it is not whole, with the nearest possible times.

    With a clock time in `start_ns` the times in the message are clock times too.
    """
    cycles = round(duration_ns / step_ns)
    # A time step such as 1/240 s is rounded to nanoseconds: the sum of n steps is up to n ns off.
    if abs(cycles * step_ns - duration_ns) > cycles:
        below = duration_ns // step_ns
        near = [f"{(start_ns + count * step_ns) * 1e-9:.9g}s" for count in (below, below + 1) if count]
        after = f" after {start_ns * 1e-9:.9g} s" if start_ns else ""
        text = f"{(start_ns + duration_ns) * 1e-9:.9g} s is not a whole number of cycles of {step_ns * 1e-9:g} s{after}"
        raise Refused(text, f"possible: {' or '.join(near)}")
    return cycles


@dataclass(eq=False)
class StepRequest:
    """Cycles that a client requested and waits for. With a `reader`, they end early when news arrives for that node."""

    cycles: int
    pending: Pending
    reader: str
    remaining: int
    has_news: bool = False


class Awaited(Protocol):
    """A client for which the world waits."""

    timeout_s: float
    """Wall time after which the driver does not wait for it any longer."""


class Gate(Protocol):
    """Limits how far the world may run."""

    def allowed(self, most: int) -> int:
        """The number of cycles, at most `most`, that may run before the world must wait."""

    def awaited(self) -> Sequence[Awaited]:
        """The clients for which the world waits now."""

    def let_go(self, member: Any) -> None:
        """Do not wait any longer for one of `awaited`."""


class RunState:
    """The requested run state. It runs nothing itself: a driver (the daemon) reads it between two slices.

    `paused` and `speed` (real-time factor; infinite: as fast as possible) are requests; steps run even when paused.
    """

    def __init__(self) -> None:
        self.paused = False
        self.speed = 1.0
        self.trouble = ""
        """The reason why the world is held, when it was not paused on request."""
        self.on_halt: list[Callable[[], None]] = []
        """Called when the world stops: by `pause`, after the last step, or when the last step request is cancelled."""
        self.requests: deque[StepRequest] = deque()
        """Open step requests, in the order of arrival."""
        self.holders: set[str] = set()
        """Nodes that hold the world: it advances only by their requests."""
        self.news_wanted = False
        """True while a message (`note_message`) may end a step request."""
        self.on_news: list[Callable[[], None]] = []
        """Called when a step request is to end with the running cycle."""
        self.gates: list[Gate] = []
        """What limits the world now: lock-step, while it has members."""

    @property
    def pending_steps(self) -> int:
        """Requested cycles that have not run yet, without those of holders."""
        return sum(request.remaining for request in self.requests if not request.reader)

    def pause(self) -> None:
        """Pause the world and abandon all step requests."""
        self.paused = True
        self.abandon_steps("paused")

    def resume(self) -> None:
        """Let the world go on."""
        self.paused = False
        self.trouble = ""

    def hold(self, trouble: str, reason: str) -> None:
        """Pause because of a failure. Step requests are rejected with the short `reason`."""
        self.paused = True
        self.trouble = trouble
        self.abandon_steps(reason)

    def requested(self, most: int) -> int:
        """The number of cycles, at most `most`, requested now. While there is a holder, only its requests count."""
        if self.holders:
            holder = self._first(of_holder=True)
            most = 0 if holder is None else min(most, holder.remaining)
        return min(most, self.pending_steps) if self.paused else most

    def allowed(self, most: int) -> int:
        """The number of cycles, at most `most`, that may run now."""
        for gate in self.gates:
            most = gate.allowed(most)
        return self.requested(most)

    def awaited(self) -> list[tuple[Gate, Awaited]]:
        """The clients for which the world waits, each with its gate."""
        return [(gate, member) for gate in self.gates for member in gate.awaited()]

    @property
    def stands_still(self) -> bool:
        """True when no cycle will come without a new request. A holder is expected to make one."""
        return self.paused and not self.pending_steps if self.holders else self.allowed(1) == 0

    def set_speed(self, factor: float) -> None:
        """Ask for a real-time factor above 0, or 0 for as fast as possible. Raises Refused for anything else."""
        if not math.isfinite(factor) or factor < 0:
            raise Refused(f"speed is 0 (as fast as possible) or a number above it, not {factor:g}")
        self.speed = factor or math.inf

    def request_steps(self, cycles: int, reader: str = "") -> Pending:
        """Pause and run `cycles` more cycles. Resolved with the number of cycles when they are done.

        With a `reader`, a node that holds the world, the world is not paused, and the request ends with the cycle in
        which `note_message` is called for that node. While paused, only cycles that others request run for it.
        """
        if not reader:
            self.paused = True
        elif self.paused and not self.pending_steps:
            return Pending.of(0)
        request = StepRequest(cycles, Pending(), reader, remaining=cycles)
        request.pending.on_cancel = lambda: self._drop(request)
        self.requests.append(request)
        self.news_wanted = self.news_wanted or bool(reader)
        return request.pending

    def note_message(self, node: str = "") -> None:
        """End the step requests of `node` early, for a message; without a node all, for an answer."""
        for request in self.requests:
            if request.reader and node in ("", request.reader):
                request.has_news = True
                for callback in self.on_news:
                    callback()

    def _first(self, of_holder: bool) -> StepRequest | None:
        return next((request for request in self.requests if bool(request.reader) is of_holder), None)

    def until_answer(self, cycles: int) -> int:
        """`cycles`, reduced to the end of the first request, which is answered in its own cycle."""
        running = self._first(of_holder=False), self._first(of_holder=True)
        return min([cycles, *(request.remaining for request in running if request is not None)])

    def count(self, cycles: int) -> None:
        """Count `cycles` cycles that have run, not more than `until_answer` allowed."""
        for request in (self._first(of_holder=False), self._first(of_holder=True)):  # an answer is news for a holder
            if request is None or request not in self.requests:
                continue
            request.remaining -= cycles
            is_stopped = request.reader and self.paused and not self.pending_steps
            if request.remaining <= 0 or request.has_news or is_stopped:
                self.requests.remove(request)
                self.news_wanted = any(one.reader for one in self.requests)
                request.pending.resolve(request.cycles - request.remaining)
                self._check_halt()

    def abandon_steps(self, reason: str) -> None:
        """Drop all step requests and reject each with the reason."""
        while self.requests:
            request = self.requests.popleft()
            done = request.cycles - request.remaining
            request.pending.reject(Refused(f"{reason} after {done} of {request.cycles} cycles"))
        self._check_halt()

    def _drop(self, request: StepRequest) -> None:
        if request in self.requests:
            self.requests.remove(request)
            self.count(0)  # a holder's request may depend on the dropped cycles: end it
            self._check_halt()

    def _check_halt(self) -> None:
        if self.stands_still:
            for callback in self.on_halt:
                callback()


class Loop:
    """Runs cycles, by the interpreter or by machine code; see `engine`."""

    def __init__(self, graph: Graph, world: World, step_ns: int, engine: str) -> None:
        self.graph = graph
        self.world = world
        self.step_ns = step_ns
        self.run = RunState()
        self.run.on_news.append(self.end_burst)
        self.strict = True
        """Stop the world when a robot diverges; else the robot is frozen, and the others go on."""
        self.driven = False
        """True when a driver (the daemon) calls `step` as `run` says; else time moves only on request."""
        self.enough: Callable[[], bool] | None = None
        """Called now and then between two cycles of a `step`: True ends it, since the driver has other work.
        The duration of the next cycles is not known in advance: a robot may have been spawned, or have fallen."""
        self.in_cycle = False
        self.robots: tuple[SpawnedRobot, ...] = ()
        self.before_cycle: tuple[Callable[[int], None], ...] = ()
        """Called at the beginning of each cycle with its time in ns, in this order; see `add_before_cycle`."""
        self.history = History(world)
        self.plain = PlainRunner(self)
        self.runner: Runner = self.plain
        """The runner of steps that are longer than a few cycles."""
        self._memory = world.data, world.views
        self.engine = Engine(self, engine)
        world.on_rebuild(self._world_changed)

    def add_before_cycle(self, hook: Callable[[int], None]) -> None:
        """Call `hook` at the beginning of each cycle, before the robots, with the cycle's time in ns."""
        self.before_cycle = (*self.before_cycle, hook)
        self.set_robots(self.robots)

    def set_robots(self, robots: tuple[SpawnedRobot, ...]) -> None:
        """Replace the robots, in this order."""
        self.robots = robots
        for runner in (self.plain, self.runner):
            runner.set_robots(robots)
        for robot in robots:
            robot.node.before_entry = partial(self.runner.give_back, robot)

    def _world_changed(self) -> None:
        data, views = self._memory
        if self.world.data is not data:
            self.history.begin()
        if self.world.data is not data or self.world.views is not views:  # the arrays have moved
            self._memory = self.world.data, self.world.views
            self.runner.follow_world()

    @property
    def stands_still(self) -> bool:
        """True when no cycle will come without a request."""
        return not self.in_cycle and (not self.driven or self.run.stands_still)

    def between_cycles(self, action: str) -> None:
        """Raise Refused inside a cycle, while other code works on what the action would change."""
        if self.in_cycle:
            raise Refused(
                f"cannot {action} in the middle of a control cycle", "do it after the cycle: graph.timers.soon(...)"
            )

    def end_burst(self) -> None:
        """Let the runner stop after the running cycle, as it does when a timer is due."""
        if self.in_cycle:
            self.graph.timers.soon(lambda: None)

    def after_cycle(self, callback: Callable[[], None]) -> None:
        """Call `callback` at the end of the running cycle, or at once outside of a cycle."""
        if self.in_cycle:
            self.graph.timers.soon(callback)
        else:
            callback()

    def settle(self) -> None:
        """Bring handles and controllers up to date, before user code reads those that it holds."""
        self.runner.give_back_all()

    def step(self, cycles: int = 1) -> int:
        """Run `cycles` cycles. Returns the number run: fewer on `enough`, or if the physics diverges and `driven`.

        Raises Diverged: the state of a robot is no longer a number, and not `driven`.
        """
        if self.in_cycle:
            self.between_cycles("step")
        if not self.engine.is_settled:
            self.engine.advance(cycles)
        runner = self.runner if self.driven or cycles >= LEAST_TABLE_CYCLES else self.plain
        left, run = cycles, self.run
        try:
            while left > 0:
                done, trouble = self._burst(run.until_answer(left) if run.requests else left, runner)
                left -= done
                if run.requests:
                    run.count(done)
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
        """Run at most `count` cycles. Returns the number run, and the error of the physics check when it failed."""
        clock = self.graph.clock
        before = clock.cycles
        try:
            done = runner.run(count)
            if clock.cycles % CHECK_EVERY == 0 or not is_sane(self.world.views.qvel):
                self._check()
        except (Diverged, CycleFailed) as trouble:
            return clock.cycles - before, trouble
        except EngineError as trouble:
            return clock.cycles - before, Refused(f"MuJoCo cannot go on: {trouble}")
        return done, None

    def _check(self) -> None:
        """Freeze the robots that have diverged. Raises Diverged when `strict`."""
        if self.strict:
            self.world.check()
            return
        for name in self.world.diverged():
            self.world.freeze(name, self.history.last_positions())
            self.graph.log("fatal", WORLD_NODE, f"{Diverged(name).message}; it is frozen, and the others go on")
        # What the last steps computed with the robot is replaced by the next step.

    def _give_up(self, trouble: SlidectlError) -> None:
        """Hold the world and log the trouble; raise it too when not `driven`."""
        what = "the world cannot go on" if isinstance(trouble, CycleFailed) else "the simulation diverged"
        self.run.hold(trouble.message, what)
        self.graph.log("fatal", WORLD_NODE, str(trouble))
        if not self.driven:
            raise trouble
