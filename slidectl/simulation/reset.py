"""Putting the world, and if asked the clock, back to the beginning: between two cycles, at once, all or nothing.

Controllers stay loaded and running; each is stopped and started again, so that PID integrators, set points and
publishers' clocks begin afresh. ros_control leaves these behind.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from slidectl.simulation.assembly import SpawnedRobot

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


def reset_simulation(simulation: Simulation) -> None:
    """Time 0, every robot as it was spawned."""
    simulation.loop.between_cycles("reset")
    _set_clock(simulation, 0)
    _reset_robots(simulation)
    simulation.graph.clock_topic.publish_now(0)


def reset_world(simulation: Simulation) -> None:
    """Every robot as it was spawned; time goes on."""
    simulation.loop.between_cycles("reset")
    _reset_robots(simulation)


def _set_clock(simulation: Simulation, time_ns: int) -> None:
    """Sleeps, waits and deadlines that are running keep what is left of them."""
    clock = simulation.graph.clock
    old_ns, clock.time_ns, clock.cycles = clock.time_ns, time_ns, 0
    simulation.graph.timers.rebase(old_ns, time_ns)


def _reset_robots(simulation: Simulation) -> None:
    simulation.robots.settle_switches()
    simulation.world.reset()
    simulation.run.trouble = ""
    with ExitStack() as restarting:  # all of them, even if one fails; what is put on last comes first
        for robot in reversed(tuple(simulation.robots)):
            restarting.callback(_restart, robot, simulation.time_ns)


def _restart(robot: SpawnedRobot, time_ns: int) -> None:
    """Hardware first, since a controller's set point is what it measures when it starts."""
    robot.hardware.reset()
    robot.cycle.rewind(time_ns)
    robot.look()
    robot.manager.restart_running(time_ns)
