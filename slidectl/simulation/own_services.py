"""`/slidectl/status`, `step`, `set_speed`, `set_params`, `sleep`, `list_robots` and `sources`: not in ROS.

`resolve`, `wait` and what stops joints have modules of their own, and `shutdown` is the daemon's.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import slidectl
from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.errors import Refused, SlidectlError, UsageError
from slidectl.simulation import resolve
from slidectl.simulation.pending import Pending
from slidectl.simulation.robot_info import robot_info
from slidectl.simulation.rosapi_parameters import absolute, from_json

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

NODE = "/slidectl"
LONGEST_S = 1e9


def advertise(simulation: Simulation) -> None:
    """Provide them."""
    node = simulation.graph.node(NODE, NODE)
    node.advertise_service("status", "slidectl/Status", lambda _: _status(simulation))
    node.advertise_service("step", "slidectl/Step", lambda request: _step(simulation, request))
    node.advertise_service("set_speed", "slidectl/SetSpeed", lambda request: _set_speed(simulation, request))
    node.advertise_service("set_params", "slidectl/SetParams", lambda request: _set_params(simulation, request))
    node.advertise_service("sleep", "slidectl/Sleep", lambda request: _sleep(simulation, request))
    node.advertise_service("list_robots", "slidectl/ListRobots", lambda request: _list_robots(simulation, request))
    node.advertise_service("sources", "slidectl/Sources", lambda request: _sources(simulation, request))
    node.advertise_service("resolve", "slidectl/Resolve", lambda request: resolve.answer(simulation, request))


def _status(simulation: Simulation) -> Message:
    managers = [robot.parts.manager for robot in simulation.robots]
    return {
        "version": slidectl.__version__,
        "time": simulation.graph.clock.seconds,
        "cycles": simulation.cycles,
        "paused": simulation.run.paused,
        "trouble": simulation.run.trouble,
        "speed": 0.0 if math.isinf(simulation.run.speed) else simulation.run.speed,
        "timestep": simulation.timestep_ns * 1e-9,
        "chosen": sorted(simulation.chosen),
        "engine": str(simulation.engine),
        "robots": simulation.robots.names(),
        "estop": [robot.name for robot in simulation.robots if robot.emergency_stop],
        "controllers": sum(len(manager.names()) for manager in managers),
        "controllers_running": sum(manager.running_count for manager in managers),
        **simulation.monitor(),
    }


def _step(simulation: Simulation, request: Message) -> Pending:
    """Pauses first. Answered when the cycles are done, or when they were given up."""
    answer = Pending()
    steps = _run_steps(simulation, _cycles(simulation, request))
    answer.on_cancel = steps.cancel

    def settle(done: Pending) -> None:
        text = str(done.error) if done.error else f"{done.result()} cycles done"
        clock = simulation.graph.clock
        response = {"success": done.error is None, "message": text, "time": clock.seconds, "cycles": clock.cycles}
        answer.resolve(response)

    steps.then(settle)
    return answer


def _run_steps(simulation: Simulation, cycles: int) -> Pending:
    if not cycles:
        simulation.pause()
        return Pending.of(0)
    if simulation.driven:
        return simulation.run.ask_steps(cycles)
    pending = Pending()
    try:
        pending.resolve(simulation.step(cycles))
    except SlidectlError as error:
        pending.reject(error)
    return pending


def _cycles(simulation: Simulation, request: Message) -> int:
    """Whole cycles: those that were asked for, or as many as make up the time that was asked for.

    Raises Refused for a time that is no whole number of cycles: the world would stop elsewhere than was asked.
    """
    seconds: float = request["seconds"]
    if not 0 <= seconds < LONGEST_S:
        raise Refused(f"seconds must be 0 or more (and less than {LONGEST_S:g}), not {seconds:g}")
    cycles: int = request["cycles"]
    if cycles:
        return cycles
    step_ns, asked_ns = simulation.timestep_ns, from_seconds(seconds)
    cycles = round(asked_ns / step_ns)
    # A time step such as 1/240 s is rounded to nanoseconds, so a second of it is up to one off for each cycle.
    if abs(cycles * step_ns - asked_ns) > cycles:
        near = [
            f"{count * step_ns * 1e-9:.9g}s" for count in range(asked_ns // step_ns, asked_ns // step_ns + 2) if count
        ]
        raise Refused(
            f"{seconds:.9g} s is no whole number of cycles of {step_ns * 1e-9:g} s", f"possible: {' or '.join(near)}"
        )
    return cycles


def _set_speed(simulation: Simulation, request: Message) -> Message:
    try:
        simulation.set_speed(request["speed"])
    except Refused as error:
        return {"success": False, "message": str(error)}
    simulation.chosen.add("speed")
    speed = simulation.run.speed
    return {"success": True, "message": "as fast as possible" if math.isinf(speed) else f"real-time factor {speed:g}"}


def _set_params(simulation: Simulation, request: Message) -> Message:
    given, texts = request["names"], request["values"]
    if len(given) != len(texts):
        raise UsageError(f"{len(given)} names and {len(texts)} values: one value for each name")
    parameters = simulation.parameters
    values = {absolute(name): from_json(text) for name, text in zip(given, texts, strict=True)}
    created = [name for name in values if not parameters.has(name)]
    guarded = [name for name in created if parameters.is_guarded(name)]
    parameters.set_all(values, request["known_only"])
    return {"created": created, "guarded": guarded}


def _sleep(simulation: Simulation, request: Message) -> Pending:
    """Answered when the simulated time has passed; a paused world never gets there."""
    duration: float = request["duration"]
    if not 0 <= duration < LONGEST_S:
        raise Refused(f"a duration is 0 s or more (and less than {LONGEST_S:g} s), not {duration:g}")
    graph = simulation.graph
    pending = Pending()

    def wake() -> None:
        pending.resolve({"success": True, "time": graph.clock.seconds})

    if duration:
        pending.on_cancel = graph.timers.after(from_seconds(duration), wake).cancel
    else:
        wake()
    return pending


def _list_robots(simulation: Simulation, request: Message) -> Message:
    asked: str = request["name"]
    robots = [simulation.robots.get(asked)] if asked else list(simulation.robots)
    return {"robots": [robot_info(robot, simulation.world) for robot in robots]}


def _sources(simulation: Simulation, request: Message) -> Message:
    digest: str = request["digest"]
    if re.fullmatch("[0-9a-f]{64}", digest) is None:
        raise Refused("a digest is SHA-256 in 64 hexadecimal digits")
    sources = simulation.robots.sources
    if request["note"]:
        sources.put(digest, request["note"])
    return {"note": sources.get(digest)}
