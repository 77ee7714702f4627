"""Run a recorded trajectory through the simulation, with the same commands at the same times, and compare.

Usage: python tests/trajectory.py FILE.csv FILE.urdf FILE.yaml NAMESPACE   Prints the worst deviation of each column.
Exit code: 0 all within 1e-9, 1 a mismatch, 2 a file that cannot be read. Rows are `t,command,position,velocity,effort`
at 1 kHz: state before the step, effort during it; gravity 9.81 m/s², no ground.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isnan
from pathlib import Path
from typing import Any

import yaml

# A checkout runs as it stands, installed or not.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from slidectl.control.hardware_interface import JointStateInterface
from slidectl.errors import SlidectlError
from slidectl.simulation.simulation import Simulation

TIMESTEP = 0.001
GRAVITY = (0.0, 0.0, -9.81)
TOLERANCE = 1e-9
HEADER = ["t", "command", "position", "velocity", "effort"]
COMPARED = HEADER[2:]


class Unreadable(Exception):
    """A file that is missing, broken or of another format."""


@dataclass(frozen=True)
class Row:
    """One recorded cycle. `cycle` counts from 1; units are m, m/s and N, or rad, rad/s and N·m."""

    cycle: int
    command: float
    values: tuple[float, ...]


@dataclass
class Worst:
    """The largest deviation of one column, and where."""

    deviation: float = 0.0
    cycle: int = 0

    def compare(self, cycle: int, recorded: float, computed: float) -> None:
        """Anything that is not a number deviates without bound."""
        deviation = abs(recorded - computed)
        if isnan(deviation):
            deviation = float("inf")
        if deviation > self.deviation:
            self.deviation, self.cycle = deviation, cycle


def read_rows(path: str) -> list[Row]:
    """The rows of the CSV, in the order of time. Raises Unreadable."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
        if not lines or lines[0] != HEADER:
            raise Unreadable(f"{path}:1: the first line must be {','.join(HEADER)}")
        rows = [_row(path, number, line) for number, line in enumerate(lines[1:], start=2) if line]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise Unreadable(f"{path}: {error}") from error
    if not rows or any(after.cycle <= before.cycle for before, after in pairwise(rows)):
        raise Unreadable(f"{path}: there must be rows, and their times must rise")
    return rows


def _row(path: str, number: int, line: list[str]) -> Row:
    try:
        t, command, *values = (float(text) for text in line)
    except ValueError as error:
        raise Unreadable(f"{path}:{number}: {error}") from error
    cycle = round(t / TIMESTEP)
    if len(values) != len(COMPARED) or cycle < 1:
        raise Unreadable(f"{path}:{number}: a row is a time from {TIMESTEP} s on, and {len(HEADER) - 1} numbers")
    return Row(cycle, command, tuple(values))


def read_controllers(path: str, namespace: str) -> dict[str, Any]:
    """The tree of parameters under the namespace. Raises Unreadable."""
    try:
        tree = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        for part in namespace.strip("/").split("/"):
            tree = tree[part]
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise Unreadable(f"{path}: {error}") from error
    except (KeyError, TypeError) as error:
        raise Unreadable(f"{path}: nothing under {namespace}") from error
    if not any(isinstance(entry, dict) and "joint" in entry for entry in tree.values()):
        raise Unreadable(f"{path}: no controller with a `joint` under {namespace}")
    return dict(tree)


class Replay:
    """The robot of the trajectory with its controllers running, at rest at time 0."""

    def __init__(self, urdf: str, controllers: dict[str, Any], namespace: str) -> None:
        space = "/" + namespace.strip("/")
        self.simulation = Simulation(timestep=TIMESTEP, gravity=GRAVITY, ground=False)
        self.simulation.parameters.set(space, controllers)
        self.robot = self.simulation.spawn(urdf, space.rpartition("/")[2], space)
        names = [name for name, entry in controllers.items() if isinstance(entry, dict) and "type" in entry]
        self._start(space, names)
        mover = next(name for name in names if "joint" in controllers[name])
        self.command_topic = f"{space}/{mover}/command"
        self.joint = controllers[mover]["joint"]
        states = self.robot.hardware.get(JointStateInterface)
        assert states is not None
        self.state = states.get_handle(self.joint)

    def _start(self, space: str, names: list[str]) -> None:
        manager = f"{space}/controller_manager"
        for name in names:
            self._ask(f"{manager}/load_controller", {"name": name})
        self._ask(f"{manager}/switch_controller", {"start_controllers": names, "strictness": 2})

    def _ask(self, service: str, request: dict[str, Any]) -> None:
        if not self.simulation.call(service, request)["ok"]:
            raise Unreadable(f"{service} refused {request}")

    def run(self, rows: Sequence[Row]) -> Iterator[tuple[Row, tuple[float, ...]]]:
        """Each row with what comes out here: state before the step of its cycle, effort during it."""
        command = None
        for row in rows:
            self.simulation.step(row.cycle - 1 - self.simulation.cycles)
            if row.command != command:
                command = row.command
                self.simulation.publish(self.command_topic, {"data": command})
            self.simulation.step()
            effort = self.simulation.world.joint_state(self.robot.name, self.joint)[2]
            yield row, (self.state.position, self.state.velocity, effort)


def compare(csv_path: str, urdf_path: str, yaml_path: str, namespace: str) -> dict[str, Worst]:
    """The worst deviation by column. Raises Unreadable."""
    rows = read_rows(csv_path)
    controllers = read_controllers(yaml_path, namespace)
    worst = {column: Worst() for column in COMPARED}
    try:
        replay = Replay(Path(urdf_path).read_text(encoding="utf-8"), controllers, namespace)
    except (OSError, UnicodeDecodeError, SlidectlError) as error:
        raise Unreadable(f"{urdf_path}: {error}") from error
    for row, computed in replay.run(rows):
        for column, recorded, value in zip(COMPARED, row.values, computed, strict=True):
            worst[column].compare(row.cycle, recorded, value)
    return worst


def main(arguments: Sequence[str]) -> int:
    """Compare one trajectory and print; returns the exit code."""
    if len(arguments) != 4:
        print("usage: python tests/trajectory.py FILE.csv FILE.urdf FILE.yaml NAMESPACE", file=sys.stderr)
        return 2
    try:
        worst = compare(*arguments)
    except Unreadable as error:
        print(error, file=sys.stderr)
        return 2
    for column, found in worst.items():
        at = f" at t = {found.cycle * TIMESTEP:.3f}" if found.cycle else ""
        print(f"{column:9} worst deviation {found.deviation:.3g}{at}")
    failed = [column for column, found in worst.items() if found.deviation > TOLERANCE]
    print(f"mismatch in {', '.join(failed)} (more than {TOLERANCE:g})" if failed else f"all within {TOLERANCE:g}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
