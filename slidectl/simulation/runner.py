"""Who runs the cycles of a loop: the interpreter here, machine code in `compiled/`, with the same results to the bit.

A runner may keep the state of robots in memory of its own: before anybody looks at a robot, it gives that robot back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from slidectl.simulation.assembly import SpawnedRobot
    from slidectl.simulation.loop import Loop

CHECK_EVERY = 256
"""Cycles between two looks at whether the physics has diverged; counted from time 0, however stepping is cut."""


_LOOK_MASK = 7
"""The interpreter looks after so many cycles, and one more, whether there is `enough`."""


class Runner(Protocol):
    """Runs cycles: the clock advances, every robot has its part, the physics makes its step, timers fire."""

    def run(self, count: int) -> int:
        """At most `count` cycles, up to and with the first after which a timer is due, the physics is to be checked, or
        the driver says that there is enough.

        Returns how many. Raises EngineError: MuJoCo cannot go on.
        """

    def take_robots(self, robots: Sequence[SpawnedRobot]) -> None:
        """These are the robots now, in this order."""

    def give_back(self, robot: SpawnedRobot) -> None:
        """Somebody is about to look at the robot, or to change it: its objects are to be what they should be."""

    def give_back_all(self) -> None:
        """The same for all robots."""

    def follow_world(self) -> None:
        """The world was rebuilt: robots may have other places in it."""


class PlainRunner:
    """The interpreter. Robots are always as they should be."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._cycles = tuple(robot.parts.cycle.run for robot in loop.robots)

    def take_robots(self, robots: Sequence[SpawnedRobot]) -> None:
        self._cycles = tuple(robot.parts.cycle.run for robot in robots)

    def give_back(self, robot: SpawnedRobot) -> None:
        """Nothing to do."""

    def give_back_all(self) -> None:
        """Nothing to do."""

    def follow_world(self) -> None:
        """Nothing to do."""

    def run(self, count: int) -> int:
        loop, world, robots = self._loop, self._loop.world, self._cycles
        clock, timers, clock_topic, step_ns = loop.graph.clock, loop.graph.timers, loop.graph.clock_topic, loop.step_ns
        clock_publisher, enough = clock_topic.publisher, loop.enough
        time_ns = clock.time_ns
        done = 0
        loop.in_cycle = True
        try:
            for done in range(1, min(count, CHECK_EVERY - clock.cycles % CHECK_EVERY) + 1):
                time_ns += step_ns
                clock.time_ns = time_ns
                if clock_publisher.wanted:
                    clock_topic.tick(time_ns, step_ns)
                for robot in robots:
                    robot(time_ns)
                world.step()
                if time_ns >= timers.next_ns or (enough is not None and not done & _LOOK_MASK and enough()):
                    break
        finally:
            loop.in_cycle = False
            clock.cycles += done
        if time_ns >= timers.next_ns:
            timers.fire()
        return done
