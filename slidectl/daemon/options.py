"""The start options of a daemon, and their form on the command line of the daemon's process.

Standard library only; used by both sides of a start.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

from slidectl import paths
from slidectl.errors import Refused, UsageError

_OF_SIMULATION = ("timestep", "gravity", "ground", "engine", "imports", "strict")
ENGINES = ("plain", "compiled", "auto")
"""The interpreter, machine code (when it is ready), or machine code if it is possible."""


@dataclass(frozen=True)
class DaemonOptions:
    """The start options of a daemon.

    `rtf` is the requested real-time factor (`inf`: as fast as possible), `timestep` in s, `gravity` in m/s² (x y z).
    With `child` it ends when the process that started it ends, for any reason. `engine` is one of ENGINES.
    `chosen` are the names of the options that the user gave, which a world file does not change.
    """

    rtf: float = 1.0
    paused: bool = False
    timestep: float = 0.001
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)
    ground: bool = True
    child: bool = False
    strict: bool = False
    """A robot that diverges stops the world; else it is frozen and the others go on."""
    engine: str = "auto"
    chosen: tuple[str, ...] = ()
    imports: tuple[str, ...] = ()
    """Modules with controllers and hardware of users: dotted names, or absolute paths that end with `.py`."""
    journal: str = ""
    """The absolute path of the journal to write, empty for none."""
    replay: str = ""
    """The journal to replay at the start; then the daemon is paused. The world's options are those of the journal."""
    until: float | None = None
    """The simulated time at which that replay ends, s; None: the end of the journal."""

    def __post_init__(self) -> None:
        if not self.rtf > 0:
            raise UsageError(f"the real-time factor must be above 0 or 'max', not {self.rtf:g}")
        if not 1e-6 <= self.timestep <= 1:
            raise UsageError(f"the time step must be between 1e-6 s and 1 s, not {self.timestep:g}")
        if len(self.gravity) != 3 or not all(math.isfinite(component) for component in self.gravity):
            raise UsageError("gravity must be three finite numbers in m/s²")
        if self.engine not in ENGINES:
            raise UsageError(f"unknown engine {self.engine!r}", f"choose one of: {', '.join(ENGINES)}")

    @classmethod
    def read(cls, values: dict[str, Any]) -> DaemonOptions:
        """Options from JSON. Raises TypeError: one is unknown."""
        options: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
        }
        return cls(**options)

    def of_simulation(self) -> dict[str, Any]:
        """The arguments of `Simulation`."""
        return {name: getattr(self, name) for name in _OF_SIMULATION}

    def of_another(self, **changes: Any) -> DaemonOptions:
        """The options for another daemon like this one, without the journal and the replay, which belong to one run."""
        return replace(self, **{"journal": "", "replay": "", "until": None, **changes})

    def check_journal(self) -> None:
        """Raise Refused when the file exists: it may be the journal of an earlier run."""
        if self.journal and os.path.lexists(self.journal):
            raise Refused(
                f"the file {self.journal} already exists", "give the journal another name, or remove that file"
            )


@dataclass(frozen=True)
class Start:
    """One start of a daemon's process."""

    options: DaemonOptions
    socket: str
    """The path of its socket."""
    foreground: bool = False
    parent: int | None = None
    """The process whose end ends the daemon."""
    ready_fd: int | None = None
    """The descriptor for a line of JSON to the waiting starter: `state` is ready, running or failed."""

    @classmethod
    def at(cls, where: paths.InstancePaths, options: DaemonOptions, **more: Any) -> Start:
        """A start with the socket of these paths."""
        return cls(options, where.socket_text, **more)

    @cached_property
    def paths(self) -> paths.InstancePaths:
        """The paths. First read before the daemon changes its working directory: XDG_RUNTIME_DIR may be relative."""
        return paths.instance(socket=self.socket)

    def text(self) -> str:
        """JSON for `read`."""
        return json.dumps(asdict(self))

    @classmethod
    def read(cls, text: str) -> Start:
        values = json.loads(text)
        return cls(DaemonOptions.read(values.pop("options")), **values)


def rtf(text: str) -> float:
    """The real-time factor from `max` or a number. Raises UsageError."""
    try:
        return math.inf if text == "max" else float(text)
    except ValueError:
        raise UsageError(f"the real-time factor is a number or 'max', not {text!r}") from None
