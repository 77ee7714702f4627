"""How a daemon is started: what can be chosen, and what the starter tells the daemon's process on its command line.

Standard library only; shared by both sides of a start.
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
    imports: tuple[str, ...] = ()
    """Modules with controllers and hardware of users: dotted names, or absolute paths that end with `.py`."""
    journal: str = ""
    """The absolute path of the journal that it writes, empty for none."""
    replay: str = ""
    """The journal whose replay it begins with, and then is paused. Its world's options are those of the journal."""
    until: float | None = None
    """The simulated time at which that replay ends, s; None: the end of the journal."""

    def __post_init__(self) -> None:
        if not self.rtf > 0:
            raise UsageError(f"the real-time factor is above 0 or 'max', not {self.rtf:g}")
        if not 1e-6 <= self.timestep <= 1:
            raise UsageError(f"the time step is between 1e-6 s and 1 s, not {self.timestep:g}")
        if len(self.gravity) != 3 or not all(math.isfinite(component) for component in self.gravity):
            raise UsageError("gravity is three finite numbers in m/s²")
        if self.engine not in ENGINES:
            raise UsageError(f"there is no engine {self.engine!r}", f"choose one of: {', '.join(ENGINES)}")

    @classmethod
    def read(cls, values: dict[str, Any]) -> DaemonOptions:
        """Options as JSON has them. Raises TypeError: there is one that is not known."""
        options: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
        }
        return cls(**options)

    def of_another(self, **changes: Any) -> DaemonOptions:
        """Those of another daemon like this one: a journal is that of one run, and so is what it was replayed from."""
        return replace(self, **{"journal": "", "replay": "", "until": None, **changes})

    def check_journal(self) -> None:
        """Raises Refused where there is a file already: it may be the journal of a run that is to be looked at."""
        if self.journal and os.path.lexists(self.journal):
            raise Refused(
                f"there is a file {self.journal} already", "give the journal another name, or remove that file"
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
    """Where the starter waits for a line of JSON: `state` is ready, running or failed."""

    @classmethod
    def at(cls, where: paths.InstancePaths, options: DaemonOptions, **more: Any) -> Start:
        """A start at the place of these paths."""
        return cls(options, where.socket_text, **more)

    @cached_property
    def paths(self) -> paths.InstancePaths:
        """Asked for before the daemon leaves the folder in which it was started: XDG_RUNTIME_DIR may be relative."""
        return paths.instance(socket=self.socket)

    def text(self) -> str:
        """JSON, from which `read` makes the same again."""
        return json.dumps(asdict(self))

    @classmethod
    def read(cls, text: str) -> Start:
        values = json.loads(text)
        return cls(DaemonOptions.read(values.pop("options")), **values)


def rtf(text: str) -> float:
    """`max` or a number. Raises UsageError."""
    try:
        return math.inf if text == "max" else float(text)
    except ValueError:
        raise UsageError(f"the real-time factor is a number or 'max', not {text!r}") from None
