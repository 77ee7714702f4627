"""What the benchmarks share: a row of results, medians, and a daemon of their own.

Knows no particular measurement.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slidectl import Client

SLIDECTL = str(Path(sys.executable).with_name("slidectl"))
SLIDER_CONTROLLERS = ("joint_state_controller", "joint1_position_controller")
# Without what leads elsewhere, and with compiled modules kept, as an installed package has them.
_UNWANTED = ("SLIDECTL_SOCKET", "SLIDECTL_NAMESPACE", "PYTHONDONTWRITEBYTECODE")
ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in _UNWANTED}
RRBOT_CONTROLLERS = ("joint_state_controller", "joint1_position_controller", "joint2_position_controller")


@dataclass(frozen=True)
class Row:
    """One measured figure beside its goal; `better` says which side of the goal is good."""

    name: str
    value: float
    unit: str
    goal: float | None = None
    better: str = "lower"
    note: str = ""

    @property
    def met(self) -> bool | None:
        if self.goal is None:
            return None
        return self.value <= self.goal if self.better == "lower" else self.value >= self.goal

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "met": self.met}


class Daemon:
    """A daemon in a private folder, with the environment that leads the command line to it."""

    def __init__(self) -> None:
        self.folder = tempfile.mkdtemp(prefix="slidectl-bench-", dir="/tmp")
        self.environment = {**ENVIRONMENT, "XDG_RUNTIME_DIR": self.folder, "SLIDECTL_INSTANCE": "bench"}

    def run(self, *words: str) -> str:
        """One slidectl command; its standard output."""
        done = subprocess.run([SLIDECTL, *words], env=self.environment, check=True, capture_output=True, text=True)
        return done.stdout

    def client(self) -> Client:
        return Client(socket=str(Path(self.folder) / "slidectl" / "bench" / "socket"))

    def status(self) -> dict[str, Any]:
        with self.client() as client:
            return client.call("/slidectl/status")

    def spawn(self, model: str, controllers: Sequence[str], name: str | None = None, at: str = "0 0 0") -> None:
        naming = ["-n", name] if name else []
        config = ["--controllers", f"config/{model}_control.yaml"]
        start = ["--start", *controllers] if controllers else []
        self.run("spawn", model, *naming, "--at", *at.split(), *config, *start)


@contextmanager
def daemon(*options: str, environment: Mapping[str, str] | None = None) -> Iterator[Daemon]:
    """A running daemon, stopped and its folder removed at the end. `environment`: further variables of it."""
    instance = Daemon()
    instance.environment.update(environment or {})
    try:
        instance.run("daemon", "start", *options)
        yield instance
    finally:
        subprocess.run([SLIDECTL, "daemon", "stop"], env=instance.environment, check=False, capture_output=True)
        shutil.rmtree(instance.folder, ignore_errors=True)


def timed(action: Callable[[], object]) -> float:
    """Wall seconds that the action took."""
    began = time.perf_counter()
    action()
    return time.perf_counter() - began


def median_of(action: Callable[[], object], runs: int) -> float:
    """Median wall seconds of several runs, after one that warms up."""
    action()
    return statistics.median(timed(action) for _ in range(runs))


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which `share` of the values lie (0..1)."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def process_cpu_s(pid: int) -> float:
    """Processor time that a process has used, s, by the scheduler's own count (to the nanosecond, not by sampling)."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) * 1e-9
