"""How the world runs: `pause_physics`, `unpause_physics`, the two resets, `get_` and `set_physics_properties`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from slidectl.control.node_handle import Message
from slidectl.errors import Refused
from slidectl.simulation.gazebo.answers import Answer, provide
from slidectl.simulation.gazebo.shapes import vector, vector_message
from slidectl.simulation.graph import WORLD_NODE

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

SHORTEST_S = 1e-6
LONGEST_S = 1.0
"""Bounds of a time step, as at the daemon's start. With longer ones the clock soon leaves what a message can hold."""


def advertise(simulation: Simulation) -> None:
    """Provide them."""
    node = simulation.graph.node(WORLD_NODE)
    for name, action in {
        "pause_physics": simulation.pause,
        "unpause_physics": simulation.resume,
        "reset_simulation": simulation.reset_simulation,
        "reset_world": simulation.reset_world,
    }.items():
        node.advertise_service(name, "std_srvs/Empty", _doing(action))
    provide(node, "get_physics_properties", "GetPhysicsProperties", lambda _: _get(simulation))
    provide(node, "set_physics_properties", "SetPhysicsProperties", lambda request: _set(simulation, request))


def _doing(action: Callable[[], None]) -> Callable[[Message], Message]:
    def handler(_: Message) -> Message:
        action()
        return {}

    return handler


def _get(simulation: Simulation) -> Answer:
    timestep = simulation.timestep_ns * 1e-9
    speed = simulation.run.speed
    fields: dict[str, Any] = {
        "time_step": timestep,
        "pause": simulation.run.paused,
        "max_update_rate": 0.0 if math.isinf(speed) else speed / timestep,
        "gravity": vector_message(simulation.world.gravity),
    }
    return "got the properties of the physics", fields


def _set(simulation: Simulation, request: Message) -> Answer:
    """Time step (s), rate of cycles (1/s; 0 is as fast as possible) and gravity; settings of ODE have no meaning."""
    timestep, rate = request["time_step"], request["max_update_rate"]
    if not SHORTEST_S <= timestep <= LONGEST_S:
        raise Refused(f"time_step is between {SHORTEST_S:g} s and {LONGEST_S:g} s, not {timestep:g}")
    if not (math.isfinite(rate) and rate >= 0):
        raise Refused(f"max_update_rate must be 0 or more, not {rate:g}")
    simulation.loop.between_cycles("set the properties of the physics")  # all or nothing
    simulation.world.set_gravity(vector(request["gravity"]))
    simulation.set_timestep(timestep)
    simulation.set_speed(rate * timestep)
    ignored = any(value for value in request["ode_config"].values())
    return "physics properties set" + ("; ode_config has no effect on MuJoCo" if ignored else ""), {}
