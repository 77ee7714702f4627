"""The loop of cycles: the clock advances, every robot has its part, the physics makes its step, timers fire.

One cycle after the other, on demand. It knows simulated time only: how fast it is called is the caller's affair.
"""

from __future__ import annotations

from collections.abc import Callable

from slidectl.errors import Refused, SlidectlError
from slidectl.physics import Diverged, EngineError, World
from slidectl.simulation.graph import WORLD_NODE, Graph
from slidectl.simulation.run_state import RunState

CHECK_EVERY = 256
"""Cycles between two looks at whether the physics has diverged; counted from time 0, however stepping is cut."""


class Loop:
    """Runs cycles. `cycles` are the robots' parts, in their order."""

    def __init__(self, graph: Graph, world: World, step_ns: int) -> None:
        self.graph = graph
        self.world = world
        self.step_ns = step_ns
        self.run = RunState()
        self.driven = False
        """True when somebody else (the daemon) calls `step` as `run` says; else time moves only when asked."""
        self.in_cycle = False
        self.cycles: tuple[Callable[[int], None], ...] = ()

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

    def step(self, cycles: int = 1) -> int:
        """Run so many cycles. Returns how many: fewer only when the physics diverges and `driven`.

        Raises:
            Diverged: the state of a robot is no longer a number, and nobody drives.
        """
        self.between_cycles("step")
        left = cycles
        while left > 0:
            until_check = CHECK_EVERY - self.graph.clock.cycles % CHECK_EVERY
            done, trouble = self._burst(self.run.until_answer(min(left, until_check)))
            left -= done
            self.run.took(done)
            if trouble is not None:
                self._give_up(trouble)
                break
        return cycles - left

    def _burst(self, count: int) -> tuple[int, SlidectlError | None]:
        """At most `count` cycles: how many, and what is wrong with the physics when that was looked at."""
        clock = self.graph.clock
        before = clock.cycles
        try:
            done = self._run_cycles(count)
            if clock.cycles % CHECK_EVERY == 0:
                self.world.check()
        except Diverged as trouble:
            return done, trouble
        except EngineError as trouble:
            return clock.cycles - before, Refused(f"MuJoCo cannot go on: {trouble}")
        return done, None

    def _give_up(self, trouble: SlidectlError) -> None:
        """Hold the world; whoever drives it is told by the log, whoever calls it directly by the error."""
        self.run.paused = True
        self.run.abandon_steps("the simulation diverged")
        self.graph.log("fatal", WORLD_NODE, str(trouble))
        if not self.driven:
            raise trouble

    def _run_cycles(self, count: int) -> int:
        """At most `count` cycles, up to and with the first after which a timer is due. The innermost loop."""
        graph, world, step_ns, robots = self.graph, self.world, self.step_ns, self.cycles
        clock, timers, clock_topic = graph.clock, graph.timers, graph.clock_topic
        clock_publisher = clock_topic.publisher
        time_ns = clock.time_ns
        done = 0
        self.in_cycle = True
        try:
            for done in range(1, count + 1):  # noqa: B007 - counted for after the loop
                time_ns += step_ns
                clock.time_ns = time_ns
                if clock_publisher.wanted:
                    clock_topic.tick(time_ns, step_ns)
                for robot in robots:
                    robot(time_ns)
                world.step()
                if time_ns >= timers.next_ns:
                    break
        finally:
            self.in_cycle = False
            clock.cycles += done
        if time_ns >= timers.next_ns:
            timers.fire()
        return done
