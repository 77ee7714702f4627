"""Free-running cycles: the whole control cycle beside bare `mj_step` on the same model, taken in turns in one run."""

from __future__ import annotations

import copy
import statistics

import mujoco

from benchmarks.harness import RRBOT_CONTROLLERS, SLIDER_CONTROLLERS, Row, timed
from slidectl.description import load
from slidectl.description.controllers_file import read
from slidectl.paths import share
from slidectl.simulation import Simulation

CYCLES = 50_000
ROUNDS = 7
GOAL_RATIO = 0.15


def measure() -> list[Row]:
    """Cycles per second and the ratio to bare MuJoCo for both tutorials' robots."""
    return _measure("slider", SLIDER_CONTROLLERS, GOAL_RATIO) + _measure("rrbot", RRBOT_CONTROLLERS, None)


def build(model: str, controllers: tuple[str, ...]) -> Simulation:
    """A simulation with one robot of `models/`, its controllers running, moving to a command."""
    simulation = Simulation()
    for key, value in read(share("config") / f"{model}_control.yaml").items():
        simulation.parameters.set(f"/{key}", value)
    simulation.spawn(load(model).xml, model)
    for name in controllers:
        simulation.call(f"/{model}/controller_manager/load_controller", {"name": name})
    request = {"start_controllers": list(controllers), "strictness": 2}
    simulation.call(f"/{model}/controller_manager/switch_controller", request)
    for name in controllers[1:]:
        simulation.publish(f"/{model}/{name}/command", {"data": 0.5})
    return simulation


def _measure(model: str, controllers: tuple[str, ...], goal: float | None) -> list[Row]:
    simulation = build(model, controllers)
    simulation.step(1000)
    bare_model, bare_data = copy.copy(simulation.world.model), copy.copy(simulation.world.data)
    ratios, rates, bare_rates = [], [], []
    for _ in range(ROUNDS):
        ours = timed(lambda: simulation.step(CYCLES))
        bare = timed(lambda: mujoco.mj_step(bare_model, bare_data, nstep=CYCLES))
        ratios.append(bare / ours)
        rates.append(CYCLES / ours)
        bare_rates.append(CYCLES / bare)
    each = f"{1e6 / statistics.median(rates):.2f} us each"
    return [
        Row(f"{model}: bare mj_step", statistics.median(bare_rates) / 1e3, "kHz", note="in C, same model, same run"),
        Row(
            f"{model}: cycles",
            statistics.median(rates) / 1e3,
            "kHz",
            note=each,
        ),
        Row(f"{model}: ratio to bare", statistics.median(ratios), "", goal, better="higher"),
    ]
