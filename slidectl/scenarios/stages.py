"""Where cases run, and how one is run there: in a new world of this process, without sockets. `live` has the other."""

from __future__ import annotations

import io
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, Protocol

from slidectl.client import Client
from slidectl.errors import SlidectlError
from slidectl.scenarios.case_run import BAD, ERROR, CaseResult, Stage, run_case
from slidectl.scenarios.scenario_file import Case, ScenarioStep
from slidectl.scenarios.step_commands import Commands

LOG_LINES = 20
_WARM = (
    "spawn slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller",
    "pub command 0.0",
    "wait joint_states/position[0] --near 0.0",
    "delete slider",
)


class StageMaker(Protocol):
    """Makes a stage for each case."""

    def warm(self, cases: Sequence[Case], commands: Commands) -> None:
        """Load what all cases need, before processes for them are made."""

    def of(self, case: Case, journal: str = "") -> AbstractContextManager[Stage]:
        """The stage of a case, with a journal there if its world is new. Raises SlidectlError: it cannot begin."""


class CaseRuns:
    """Runs cases with these commands, for workers. `keep` is the folder for recordings of those that fail."""

    def __init__(self, commands: Commands, stages: StageMaker, sim_timeout: float, keep: str | None) -> None:
        self._commands = commands
        self._stages = stages
        self._sim_timeout = sim_timeout
        self._keep = keep

    def run(self, case: Case, temporary: str) -> CaseResult:
        """In a process of its own: what commands print goes into a file in the case's folder."""
        _print_into(os.path.join(temporary, "output"))
        result = self._try(case, temporary, None)
        if self._keep is not None and result.verdict in BAD:
            self._try(case, temporary, self._record(case))  # the same once more, recorded: who passes pays nothing
            result.kept = [str(file) for file in self._files(case)]
        return result

    def _try(self, case: Case, temporary: str, first: ScenarioStep | None) -> CaseResult:
        steps = case.steps if first is None else (first, *case.steps)
        folder = tempfile.mkdtemp(dir=temporary)  # empty, whatever an earlier try has left
        try:
            with self._stages.of(case, f"{self._stem(case)}.journal" if first is not None else "") as stage:
                return run_case(case, self._commands, stage, self._sim_timeout, folder, steps)
        except SlidectlError as error:
            return CaseResult(case.id, ERROR, message=error.message, hint=error.hint or "")

    def _stem(self, case: Case) -> Path:
        assert self._keep is not None
        return Path(self._keep) / re.sub(r"[^\w.=-]+", "_", case.id.removesuffix(".yaml"))

    def _files(self, case: Case) -> list[Path]:
        stem = self._stem(case)
        return sorted(file for file in stem.parent.glob("*") if file.stem == stem.name and file.suffix in _KEPT)

    def _record(self, case: Case) -> ScenarioStep:
        stem = self._stem(case)
        stem.parent.mkdir(parents=True, exist_ok=True)
        for old in self._files(case):
            old.unlink()
        return ScenarioStep(("record", "-a", "-x", _LEFT_OUT, "-O", f"{stem}{_suffix()}"), 0, "setup", background=True)


_LEFT_OUT = "/clock|/gazebo/(link|model)_states"
"""What comes in every cycle: the frames on /tf say the same."""
_RECORDINGS = (".mcap", ".bag")
_KEPT = (*_RECORDINGS, ".journal")


def _suffix() -> str:
    """Of a recording: MCAP where its library is there."""
    from importlib.util import find_spec

    return _RECORDINGS[0] if find_spec("mcap") else _RECORDINGS[1]


def _print_into(path: str) -> None:
    """Standard output and error of this process go into a file, and its input is empty."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(file, 1)
    os.dup2(file, 2)
    os.dup2(empty, 0)


# --- in this process ------------------------------------------------------------------------------------------------


class InProcess:
    """A new world for each case."""

    def warm(self, cases: Sequence[Case], commands: Commands) -> None:
        """Do once what most cases do: that imports and reads what they need, and loads the engine.

        Where nobody has compiled the engine yet, that is begun; cases that begin before it is there run in the
        interpreter, with the same results.
        """
        from slidectl.daemon.in_process import InProcessWorld
        from slidectl.simulation.simulation import Simulation

        is_plain = {case.world.get("engine", "auto") for case in cases} == {"plain"}
        world = InProcessWorld(Simulation(engine="plain" if is_plain else "auto"))
        with world.client() as client, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            for line in _WARM:
                commands.run(line.split(), client)

    @contextmanager
    def of(self, case: Case, journal: str = "") -> Iterator[Stage]:
        from slidectl.control import user_classes
        from slidectl.daemon.journal import Journal
        from slidectl.daemon.options import DaemonOptions
        from slidectl.daemon.time_limit import TimeLimit
        from slidectl.simulation.compiled import object_file
        from slidectl.simulation.simulation import Simulation

        wanted = dict(case.world)
        paused = wanted.pop("paused", False)
        if "gravity" in wanted:
            wanted["gravity"] = tuple(wanted["gravity"])
        user_classes.limit = limit = TimeLimit()
        notes = None
        if journal:
            notes = Journal(DaemonOptions(paused=paused, journal=os.path.abspath(journal), **wanted))
            limit.on_end = notes.took_too_long
        simulation = Simulation(**wanted)
        simulation.engine.may_load = object_file.is_there()  # `warm` has begun to compile it otherwise
        stage = _WorldStage(simulation, notes)
        stage.world.simulation.run.paused = paused
        try:
            yield stage
        finally:
            if notes is not None:
                notes.close("the case is over")


class _WorldStage(Stage):
    def __init__(self, simulation: Any, journal: Any) -> None:
        from slidectl.daemon.in_process import InProcessWorld

        self.world = InProcessWorld(simulation, journal)
        self.client = self.world.client()

    def now_s(self) -> float:
        return self.world.simulation.graph.clock.seconds

    def limit(self, seconds: float | None) -> None:
        now_ns = self.world.simulation.time_ns
        self.world.end_ns = None if seconds is None else now_ns + max(0, round(seconds * 1e9))

    def begin(self, run: Callable[[Client], None]) -> Any:
        from slidectl.scenarios.background import BackgroundStep

        return BackgroundStep(self.world, run, self.client.timeout)

    def log(self) -> list[str]:
        return list(self.world.log)[-LOG_LINES:]
