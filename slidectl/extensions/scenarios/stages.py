"""Runs a case in a new world of this process, without sockets; `live` runs cases in a daemon."""

from __future__ import annotations

import hashlib
import io
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from slidectl.client import Client
from slidectl.errors import SlidectlError
from slidectl.extensions.scenarios.baselines import Baselines, RecordedFields
from slidectl.extensions.scenarios.case_run import BAD, ERROR, PASSED, CaseResult, CaseRun, Stage, WallTimeUp
from slidectl.extensions.scenarios.scenario_file import Case, ScenarioStep
from slidectl.extensions.scenarios.step_commands import Commands

if TYPE_CHECKING:
    from slidectl.extensions.scenarios.live import Live

LOG_LINES = 20
_WARM = (
    "spawn slider --controllers config/slider_control.yaml --start joint_state_controller joint1_position_controller",
    "pub command 0.0",
    "wait joint_states/position[0] --near 0.0",
    "delete slider",
)


@dataclass
class CaseRuns:
    """Runs cases with these commands. `keep` is an existing folder for recordings of failed cases."""

    commands: Commands
    stages: InProcess | Live
    sim_timeout: float
    keep: str | None
    baselines: Baselines | None
    cases: Sequence[Case] = ()
    """Those of this run, where they are known before it begins."""
    is_ready: bool = False

    def prepare(self) -> None:
        """Load, once, what the cases need: their processes are forked from this one."""
        if not self.is_ready:
            self.is_ready = True
            self.stages.warm(self.commands, self.cases)

    def run(self, case: Case, temporary: str) -> CaseResult:
        """Run a case in its process; `temporary` is an existing folder for its files."""
        result = self._try(case, temporary)
        if self.keep is not None and result.was_ended:
            result.hint = "not recorded: for that it would run once more"
        elif self.keep is not None and result.verdict in BAD:
            try:
                self._run_recorded(case, temporary)  # runs it again, so that passed cases cost nothing
            except OSError as error:
                result.message += f"\nnot recorded: {error.filename or self.keep}: {error.strerror or error}"
            except (SlidectlError, WallTimeUp) as error:
                result.message += f"\nnot recorded: {error}"
            result.kept = [str(file) for file in self._files(case) if file.exists()]
        return result

    def _try(self, case: Case, temporary: str, journal: str = "", first: Sequence[ScenarioStep] = ()) -> CaseResult:
        folder = tempfile.mkdtemp(dir=temporary)  # empty, so that files of an earlier try have no effect
        try:
            with self.stages.of(case, journal) as stage:
                return self._run(case, stage, folder, (*first, *case.steps))
        except SlidectlError as error:
            return CaseResult(case.id, ERROR, message=error.message, hint=error.hint or "")

    def _run(self, case: Case, stage: Stage, folder: str, steps: Sequence[ScenarioStep]) -> CaseResult:
        if self.baselines is None:
            return CaseRun(case, self.commands, stage, self.sim_timeout, folder, steps, lambda: None).run()
        fields = RecordedFields(stage.client, case.baseline)
        result = CaseRun(case, self.commands, stage, self.sim_timeout, folder, steps, fields.update).run()
        if result.verdict == PASSED:
            self.baselines.judge(case, fields.table(), result)
        return result

    def _stem(self, case: Case) -> str:
        assert self.keep is not None
        name = re.sub(r"[^\w.=-]+", "_", case.id.removesuffix(".yaml"), flags=re.ASCII)[-_LONGEST_NAME:].lstrip(".")
        if f"{name}.yaml" != case.id:  # the name may not be unique
            name += f"-{hashlib.sha256(case.id.encode()).hexdigest()[:8]}"
        return os.path.join(self.keep, name)

    def _files(self, case: Case) -> list[Path]:
        return [Path(f"{self._stem(case)}{suffix}") for suffix in _KEPT]

    def _run_recorded(self, case: Case, temporary: str) -> None:
        """Run the case with a journal, and replay it into a recording; without a journal, record while the case runs.

        Raises OSError, SlidectlError, WallTimeUp: the recording is missing or incomplete.
        """
        from slidectl.extensions.journal.journal import read
        from slidectl.extensions.journal.journal_replay import Replay
        from slidectl.extensions.journal.replay_recording import ReplayRecording
        from slidectl.extensions.recording.recording_files import EVERY_CYCLE, usual_suffix

        for old in self._files(case):
            old.unlink(missing_ok=True)
        journal, file = f"{self._stem(case)}.journal", f"{self._stem(case)}{usual_suffix()}"
        if self.stages.has_journals:
            self._try(case, temporary, journal)
            with ReplayRecording(Path(file)) as recording:
                replay = Replay(read(journal))
                recording.watch(replay)
                replay.run(lambda _: None)
        else:
            words = ("record", "-a", "-x", EVERY_CYCLE, "-O", file)
            self._try(case, temporary, first=[ScenarioStep(words, 0, "setup", background=True)])


_KEPT = (".journal", ".mcap", ".bag")
_LONGEST_NAME = 120
_LONGEST_S = 1e9


# --- in this process ------------------------------------------------------------------------------------------------


class InProcess:
    """Makes a new world for each case."""

    has_journals: ClassVar[bool] = True
    """True when a case can write a journal, from which its recording is made."""

    def warm(self, commands: Commands, cases: Sequence[Case]) -> None:
        """Do once what most cases do, so that modules are imported, files are read and the engine is loaded.

        If the engine is not compiled yet, this starts the compiler. Cases that begin before it ends run in the
        interpreter, with the same results. For a single case it would only do everything twice.
        """
        from slidectl.daemon.in_process import InProcessWorld
        from slidectl.simulation.compiled import object_file
        from slidectl.simulation.simulation import Simulation

        is_plain = {case.world.get("engine", "auto") for case in cases} == {"plain"}
        if len(cases) == 1 and (is_plain or object_file.is_there() or not object_file.is_possible()):
            return
        world = InProcessWorld(Simulation(engine="plain" if is_plain else "auto"))
        with world.client() as client, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            for line in _WARM:
                commands.run(line.split(), client)

    @contextmanager
    def of(self, case: Case, journal: str = "") -> Iterator[Stage]:
        """Make the stage of a case; it writes a journal if a path is given. Raises SlidectlError: it cannot start."""
        from slidectl.daemon.options import DaemonOptions
        from slidectl.daemon.time_limit import TimeLimit
        from slidectl.extensions.journal.journal import Journal
        from slidectl.simulation.compiled import object_file
        from slidectl.simulation.host import Host
        from slidectl.simulation.simulation import Simulation

        wanted = dict(case.world)
        paused = wanted.pop("paused", False)
        if "gravity" in wanted:
            wanted["gravity"] = tuple(wanted["gravity"])
        host = Host(TimeLimit())
        if journal:
            host = Journal(DaemonOptions(paused=paused, journal=os.path.abspath(journal), **wanted), host)
        simulation = Simulation(**wanted, host=host)
        simulation.engine.may_load = object_file.is_there()  # if it is not there, `warm` has started the compiler
        stage = _WorldStage(simulation)
        stage.world.simulation.run.paused = paused
        try:
            yield stage
        finally:
            host.close("the case is over")


class _WorldStage(Stage):
    def __init__(self, simulation: Any) -> None:
        from slidectl.daemon.in_process import InProcessWorld

        self.world = InProcessWorld(simulation)
        self.client = self.world.client()

    def now_s(self) -> float:
        return self.world.simulation.graph.clock.seconds

    def limit(self, seconds: float | None) -> None:
        now_ns = self.world.simulation.time_ns
        self.world.end_ns = None if seconds is None else now_ns + max(0, round(min(seconds, _LONGEST_S) * 1e9))

    def begin(self, run: Callable[[Client], None]) -> Any:
        from slidectl.extensions.scenarios.background import BackgroundStep, InProcessBackground

        return BackgroundStep(partial(InProcessBackground, self.world), run, self.client.timeout)

    def log(self) -> list[str]:
        return list(self.world.log)[-LOG_LINES:]
