"""What a journal costs while the world runs freely, and how fast it is replayed."""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path

from benchmarks.cycles import build, cpu_s
from benchmarks.harness import SLIDER_CONTROLLERS, Row
from slidectl import description
from slidectl.daemon.in_process import InProcessWorld
from slidectl.daemon.options import DaemonOptions
from slidectl.extensions.journal import journal
from slidectl.extensions.journal.journal import Journal
from slidectl.extensions.journal.journal_replay import Replay
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

ROUNDS, SECONDS, CYCLES_A_SECOND = 15, 50, 1000
REPLAYED_S = 100
COST_GOAL = 2.0


def measure() -> list[Row]:
    """Rows of this module."""
    engine = "compiled" if object_file.is_possible() else "plain"
    with tempfile.TemporaryDirectory(prefix="slidectl-bench-", dir="/tmp") as folder:
        return [_cost(Path(folder) / "cost.journal", engine), _replay(Path(folder) / "run.journal", engine)]


def _cost(path: Path, engine: str) -> Row:
    """In one world, in turns with and without: two worlds differ by more than that."""
    simulation = build("slider", SLIDER_CONTROLLERS, engine)
    simulation.driven = True
    cycles = SECONDS * CYCLES_A_SECOND
    simulation.step(cycles)
    ratios, bare = [], 0.0
    for number in range(ROUNDS):
        bare = cpu_s(lambda: simulation.step(cycles))
        notes = Journal(DaemonOptions(journal=f"{path}.{number}"))
        notes.attach(simulation)
        ratios.append(cpu_s(lambda: simulation.step(cycles)) / bare)
        notes.close("measured")
    note = f"slider, {engine}, free-running: {1e6 * bare / SECONDS:.0f} us of processor time a simulated second"
    share = 100.0 * (statistics.median(ratios) - 1.0)
    return Row("what a journal adds to a free-running cycle", share, "%", COST_GOAL, note=note)


def _replay(path: Path, engine: str) -> Row:
    notes = Journal(DaemonOptions(journal=str(path), engine=engine, paused=True))
    simulation = Simulation(engine=engine, host=notes)
    if engine == "compiled":
        simulation.engine.complete()
    simulation.run.paused = True
    with InProcessWorld(simulation).client(timeout=10.0 * REPLAYED_S) as client:
        client.call("/gazebo/spawn_urdf_model", {"model_name": "slider", "model_xml": description.load("slider").xml})
        client.call("/slidectl/step", {"seconds": float(REPLAYED_S)})
    notes.close("measured")
    one = Replay(journal.read(str(path)))
    wall_s = cpu_s(lambda: one.run(print, check=True))
    note = f"{REPLAYED_S} s of the slider alone, {engine}, with --check"
    return Row("replay of a journal", REPLAYED_S / wall_s, "times real time", better="higher", note=note)
