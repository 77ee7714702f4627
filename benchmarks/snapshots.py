"""Snapshots: to save the state of RRBots that run, and to go back to it where the same robots are there.

In processor time, without the garbage collector, as in a daemon.
"""

from __future__ import annotations

import gc
import statistics
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.cycles import build, cpu_s
from benchmarks.harness import RRBOT_CONTROLLERS, Row
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

GOALS_MS = {1: 5.0, 100: 50.0}
ROUNDS = 15


def measure() -> list[Row]:
    """Rows of this module. Between two of them the robots run, as in a daemon."""
    rows = []
    for count, goal_ms in GOALS_MS.items():
        simulation = build("rrbot", RRBOT_CONTROLLERS, "compiled" if object_file.is_possible() else "plain", count)
        simulation.driven = True
        what = "an RRBot" if count == 1 else f"{count} RRBots"
        for verb, action in (("save", simulation.save), ("load", simulation.load)):
            taken = [_timed_in_passing(simulation, partial(action, "here")) for _ in range(ROUNDS)]
            rows.append(Row(f"{verb} a snapshot of {what}", 1e3 * statistics.median(taken), "ms", goal_ms))
    with tempfile.TemporaryDirectory(prefix="slidectl-bench-") as folder:
        file = Path(folder) / "snapshot"
        simulation.call("/slidectl/export_snapshot", {"name": "here", "file": str(file)})
        rows.append(Row(f"size of a file of {count} RRBots", file.stat().st_size / 1024, "KiB"))
    return rows


def _timed_in_passing(simulation: Simulation, action: Callable[[], None]) -> float:
    simulation.step(5)
    gc.collect()
    gc.disable()
    try:
        return cpu_s(action)
    finally:
        gc.enable()
