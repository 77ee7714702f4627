"""How a daemon is started: what can be chosen, as data, and as arguments from the starter to the daemon's process.

Standard library only; shared by both sides of a start.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from slidectl import paths
from slidectl.errors import UsageError

if TYPE_CHECKING:
    import argparse

ENGINES = ("plain", "compiled", "auto")
"""Who runs the cycles: the interpreter, machine code (as soon as it is there), or machine code if it can be."""


@dataclass(frozen=True)
class DaemonOptions:
    """What a daemon is started with.

    `rtf` is the real-time factor asked for (`inf`: as fast as possible), `timestep` in s, `gravity` in m/s² (x y z).
    With `child` it ends when the process that started it ends, however that ends. `engine` is one of ENGINES.
    `chosen` are the names of the options that somebody gave, which no file of a world changes.
    """

    rtf: float = 1.0
    paused: bool = False
    timestep: float = 0.001
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)
    ground: bool = True
    child: bool = False
    engine: str = "auto"
    chosen: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.rtf > 0:
            raise UsageError(f"the real-time factor is above 0 or 'max', not {self.rtf:g}")
        if not 1e-6 <= self.timestep <= 1:
            raise UsageError(f"the time step is between 1e-6 s and 1 s, not {self.timestep:g}")
        if not all(math.isfinite(component) for component in self.gravity):
            raise UsageError("gravity is three finite numbers in m/s²")
        if self.engine not in ENGINES:
            raise UsageError(f"there is no engine {self.engine!r}", f"choose one of: {', '.join(ENGINES)}")

    def arguments(self) -> list[str]:
        """The command line that gives these options again."""
        arguments = [f"--rtf={self.rtf!r}", f"--timestep={self.timestep!r}", f"--engine={self.engine}"]
        arguments += ["--gravity=" + ",".join(map(repr, self.gravity))]  # argparse takes -1e-05 alone for an option
        arguments += ["--paused"] if self.paused else []
        arguments += [] if self.ground else ["--no-ground"]
        arguments += [f"--chosen={','.join(self.chosen)}"] if self.chosen else []
        return arguments + ([f"--parent={os.getpid()}"] if self.child else [])


@dataclass(frozen=True)
class Start:
    """One start of a daemon's process: where, how, and whom to tell when it answers."""

    paths: paths.InstancePaths
    options: DaemonOptions
    ready_fd: int | None
    foreground: bool
    parent: int | None
    """The process whose end ends the daemon."""


def rtf(text: str) -> float:
    """`max` or a number. Raises UsageError."""
    try:
        return math.inf if text == "max" else float(text)
    except ValueError:
        raise UsageError(f"the real-time factor is a number or 'max', not {text!r}") from None


def parse(arguments: Sequence[str]) -> Start:
    """What a daemon's process was asked for. Leaves with a usage text when it makes no sense."""
    given = _parser().parse_args(arguments)
    options = DaemonOptions(
        rtf=given.rtf,
        paused=given.paused,
        timestep=given.timestep,
        gravity=given.gravity,
        ground=not given.no_ground,
        engine=given.engine,
        chosen=tuple(given.chosen.split(",")) if given.chosen else (),
    )
    where = paths.instance(given.instance, str(given.socket) if given.socket else None)
    return Start(where, options, given.ready_fd, given.foreground, given.parent)


def _gravity(text: str) -> tuple[float, float, float]:
    x, y, z = map(float, text.split(","))
    return x, y, z


def _parser() -> argparse.ArgumentParser:
    import argparse  # the starter, which needs only the class above, is in a hurry

    usual = DaemonOptions()
    parser = argparse.ArgumentParser("python -m slidectl.daemon", description="The process of one slidectl daemon.")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--instance", help="name of the instance")
    where.add_argument("--socket", type=Path, help="path of the socket, in a folder of mode 0700")
    parser.add_argument("--rtf", type=rtf, default=usual.rtf, help="real-time factor, or 'max'")
    parser.add_argument("--paused", action="store_true", help="begin paused")
    parser.add_argument("--timestep", type=float, default=usual.timestep, help="length of a cycle, s")
    parser.add_argument("--gravity", type=_gravity, default=usual.gravity, metavar="X,Y,Z", help="m/s²")
    parser.add_argument("--no-ground", action="store_true", help="a world without a floor")
    parser.add_argument("--engine", choices=ENGINES, default=usual.engine, help="who runs the cycles")
    parser.add_argument("--chosen", metavar="OPTION,...", help="options that no file of a world changes")
    parser.add_argument("--ready-fd", type=int, help="where to tell that it answers (used by the starter)")
    parser.add_argument("--parent", type=int, help="end with the process of this id, which started it")
    parser.add_argument("--foreground", action="store_true", help="stay on the terminal: log to stderr too")
    return parser
