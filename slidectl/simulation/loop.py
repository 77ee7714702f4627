"""The loop of cycles: the clock advances, every robot has its part, the physics makes its step, timers fire.

One cycle after the other, on demand. It knows simulated time only: how fast it is called is the caller's affair.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from slidectl.errors import Refused, SlidectlError
from slidectl.physics import Diverged, EngineError, World
from slidectl.simulation.compiled.engine import Engine
from slidectl.simulation.graph import WORLD_NODE, Graph
from slidectl.simulation.run_state import RunState
from slidectl.simulation.runner import CHECK_EVERY, PlainRunner, Runner

if TYPE_CHECKING:
    from slidectl.simulation.assembly import SpawnedRobot

FEW = 16
"""Fewer cycles than these are not worth the way into the tables and back, which is made when nobody drives."""


class Loop:
    """Runs cycles, by the interpreter or by machine code: see `engine`."""

    def __init__(self, graph: Graph, world: World, step_ns: int, engine: str) -> None:
        self.graph = graph
        self.world = world
        self.step_ns = step_ns
        self.run = RunState()
        self.driven = False
        """True when somebody else (the daemon) calls `step` as `run` says; else time moves only when asked."""
        self.enough: Callable[[], bool] | None = None
        """Asked now and then between two cycles of a `step`: True ends it, since the driver has other things to do.
        How dear the next cycles are is not known before they have run: a robot may have come, or fallen."""
        self.in_cycle = False
        self.robots: tuple[SpawnedRobot, ...] = ()
        self.plain = PlainRunner(self)
        self._data = world.data
        self.engine = Engine(self, engine)
        world.on_rebuild(self._world_changed)

    def take_robots(self, robots: tuple[SpawnedRobot, ...]) -> None:
        """These are the robots from now on, in this order."""
        self.robots = robots
        for runner in self._runners():
            runner.take_robots(robots)
        for robot in robots:
            robot.watch_entries(partial(self._give_back, robot))

    def _runners(self) -> list[Runner]:
        return [self.plain] if self.engine.compiled is None else [self.plain, self.engine.compiled]

    def _give_back(self, robot: SpawnedRobot) -> None:
        if self.engine.compiled is not None:
            self.engine.compiled.give_back(robot)

    def _world_changed(self) -> None:
        if self.world.data is not self._data:
            self._data = self.world.data
            for runner in self._runners():
                runner.follow_world()

    @property
    def stands_still(self) -> bool:
        """True when no cycle will come by itself."""
        return not self.in_cycle and (not self.driven or self.run.allowed(1) == 0)

    def between_cycles(self, action: str) -> None:
        """Raises Refused inside a cycle, where the action would pull the floor from under others."""
        if self.in_cycle:
            raise Refused(
                f"cannot {action} in the middle of a control cycle", "do it after the cycle: graph.timers.soon(...)"
            )

    def after_cycle(self, callback: Callable[[], None]) -> None:
        """Call back at the end of the running cycle, or at once when none is running."""
        if self.in_cycle:
            self.graph.timers.soon(callback)
        else:
            callback()

    def settle(self) -> None:
        """Somebody is about to look at handles and controllers that he holds: let them be what they should be."""
        for runner in self._runners():
            runner.give_back_all()

    def step(self, cycles: int = 1) -> int:
        """Run so many cycles. Returns how many: fewer when there is `enough`, or the physics diverges and `driven`.

        Raises:
            Diverged: the state of a robot is no longer a number, and nobody drives.
        """
        if self.in_cycle:
            self.between_cycles("step")
        if not self.engine.is_settled:
            self.engine.advance(cycles)
        compiled = self.engine.compiled
        runner = self.plain if compiled is None or not (self.driven or cycles >= FEW) else compiled
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
        except Diverged as trouble:
            return clock.cycles - before, trouble
        except EngineError as trouble:
            return clock.cycles - before, Refused(f"MuJoCo cannot go on: {trouble}")
        return done, None

    def _give_up(self, trouble: SlidectlError) -> None:
        """Hold the world; whoever drives it is told by the log, whoever calls it directly by the error."""
        self.run.hold(trouble.message, "the simulation diverged")
        self.graph.log("fatal", WORLD_NODE, str(trouble))
        if not self.driven:
            raise trouble
