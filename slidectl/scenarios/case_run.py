"""One case of a scenario, from its first step to the end of its teardown, on a stage: the world where it runs."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

from slidectl.client import Client
from slidectl.errors import Refused, SlidectlError
from slidectl.scenarios.scenario_file import TEMPORARY, Case, ScenarioStep
from slidectl.scenarios.step_commands import Commands, StepOutcome

PASSED, FAILED, ERROR, XFAILED, XPASSED = "passed", "failed", "error", "xfailed", "xpassed"
BAD = (FAILED, ERROR, XPASSED)
TEARDOWN_S = 60.0
"""Simulated seconds that the teardown may take, however much the steps have used."""
_EARLY_S = 1e-9
_ENDED = 130
"""How a command ends that was interrupted."""


@dataclass
class CaseResult:
    """How a case ended. Of a failure: the step with its line, what was said, and what the world had to say."""

    id: str
    verdict: str
    sim_time: float = 0.0
    wall_time: float = 0.0
    steps: int = 0
    """That were done."""
    step: str = ""
    section: str = ""
    line: int = 0
    message: str = ""
    hint: str = ""
    detail: dict[str, Any] = field(default_factory=dict)
    """What the step itself printed as a record: of `wait` expected, value, closest and time."""
    failed_at: float | None = None
    """Simulated time, s."""
    log: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    """Files that were kept of it."""

    def as_dict(self) -> dict[str, Any]:
        """Its JSON object."""
        return asdict(self)


class WallTimeUp(BaseException):
    """The case has used up its wall time, or is to end for another reason. No command takes it for a failure of its."""


class _Failed(Exception):
    """A step that failed."""

    def __init__(self, step: ScenarioStep, outcome: StepOutcome, time_s: float) -> None:
        super().__init__(outcome.message)
        self.step = step
        self.outcome = outcome
        self.time_s = time_s


class Stage:
    """Where a case runs: a client, the simulated time since it began, and the last lines of the log."""

    client: Client

    def now_s(self) -> float:
        """Simulated time since the case began."""
        raise NotImplementedError

    def limit(self, seconds: float | None) -> None:
        """Waits end with TimedOut so many simulated seconds from now; None: no limit."""

    def begin(self, run: Any) -> Any:
        """Run something with a client of its own in the background; what it gives has `end`."""
        raise NotImplementedError

    def log(self) -> list[str]:
        """The last lines."""
        raise NotImplementedError


def run_case(
    case: Case, commands: Commands, stage: Stage, sim_timeout: float, temporary: str, steps: Sequence[ScenarioStep]
) -> CaseResult:
    """Run the steps to the end, teardown included. Raises nothing but what is no failure of the case."""
    began_s = time.monotonic()
    result = CaseResult(case.id, PASSED)
    runner = _CaseRunner(steps, commands, stage, case.sim_timeout or sim_timeout, temporary, result)
    try:
        runner.run()
    finally:
        result.wall_time = time.monotonic() - began_s
    if case.xfail:
        result.verdict = XPASSED if result.verdict == PASSED else XFAILED
        if result.verdict == XPASSED:
            result.message = f"it passed, and was known to fail: {case.xfail}"
            result.hint = "take xfail out of the file"
    return result


class _CaseRunner:
    def __init__(
        self,
        steps: Sequence[ScenarioStep],
        commands: Commands,
        stage: Stage,
        sim_timeout: float,
        temporary: str,
        result: CaseResult,
    ) -> None:
        self._steps = steps
        self._commands = commands
        self._stage = stage
        self._sim_timeout = sim_timeout
        self._temporary = temporary
        self._result = result
        self._background: list[tuple[ScenarioStep, Any, list[StepOutcome]]] = []

    def run(self) -> None:
        result = self._result
        try:
            for step in self._steps:
                if step.section != "teardown":
                    self._do(step, self._sim_timeout - self._stage.now_s())
            self._end_background()
        except _Failed as failure:
            self._note(failure, FAILED if failure.step.section == "steps" else ERROR)
        except WallTimeUp as end:
            self._fail(ERROR, str(end))
        except SlidectlError as error:
            self._fail(ERROR, error.message, error.hint)
        with suppress(SlidectlError):
            result.sim_time = self._stage.now_s()
        self._tear_down()

    def _tear_down(self) -> None:
        """Every step of it, whatever happens. The first failure counts where all went well before."""
        with suppress(_Failed, WallTimeUp, SlidectlError):
            self._end_background()
        for step in self._steps:
            if step.section == "teardown":
                try:
                    self._do(step, TEARDOWN_S)
                except _Failed as failure:
                    if self._result.verdict == PASSED:
                        self._note(failure, ERROR)
                except (WallTimeUp, SlidectlError) as error:
                    if self._result.verdict == PASSED:
                        self._fail(ERROR, str(error))

    def _fail(self, verdict: str, message: str, hint: str | None = None) -> None:
        result = self._result
        result.verdict, result.message, result.hint = verdict, message, hint or ""
        with suppress(SlidectlError, WallTimeUp):
            result.failed_at = self._stage.now_s()
        result.log = self._stage.log()

    def _note(self, failure: _Failed, verdict: str) -> None:
        self._fail(verdict, failure.outcome.message, failure.outcome.hint)
        result, step = self._result, failure.step
        result.failed_at = failure.time_s
        result.step, result.section, result.line = step.text, step.section, step.line
        with suppress(ValueError, IndexError):
            record = json.loads(failure.outcome.output.strip().splitlines()[-1])
            result.detail = record if isinstance(record, dict) else {}

    def _do(self, step: ScenarioStep, most_s: float) -> None:
        """Raises _Failed."""
        stage = self._stage
        outcome = StepOutcome(0)
        began_s = stage.now_s()
        try:
            if step.at is not None:
                stage.limit(most_s)
                self._wait_for(step.at)
                most_s -= stage.now_s() - began_s
                began_s = stage.now_s()
            limit_s = most_s if step.within is None else min(most_s, step.within)
            stage.limit(limit_s)
            if step.words:
                outcome = self._run(step)
            took_s = stage.now_s() - began_s
            if outcome.exit_code and took_s >= limit_s - _EARLY_S:
                what = f"{step.within:g} s" if limit_s == step.within else f"the {self._sim_timeout:g} s of the case"
                outcome = outcome._replace(message=f"not done within {what} of simulated time: {outcome.message}")
            elif not outcome.exit_code and step.within is not None and took_s > step.within + _EARLY_S:
                outcome = StepOutcome(1, f"it took {took_s:g} s of simulated time, and {step.within:g} s are allowed")
        except SlidectlError as error:
            outcome = StepOutcome(error.exit_code, error.message, error.hint or "")
        finally:
            stage.limit(None)
        self._judge(step, outcome)
        self._result.steps += 1

    def _run(self, step: ScenarioStep) -> StepOutcome:
        words = [word.replace(TEMPORARY, self._temporary) for word in step.words]
        if not step.background:
            return self._commands.run(words, self._stage.client)
        outcomes: list[StepOutcome] = []
        handle = self._stage.begin(lambda client: outcomes.append(self._commands.run(words, client)))
        self._background.append((step, handle, outcomes))
        return outcomes[0] if outcomes else StepOutcome(0)

    def _end_background(self) -> None:
        """Raises _Failed for the first that failed."""
        ended, self._background = self._background, []
        for _, handle, _ in ended:
            handle.end()
        for step, _, outcomes in ended:
            if outcomes and outcomes[0].exit_code != _ENDED:
                self._judge(step, outcomes[0])

    def _judge(self, step: ScenarioStep, outcome: StepOutcome) -> None:
        if not step.fails and not outcome.exit_code:
            return
        if step.fails and outcome.exit_code:
            said = f"{outcome.message}\n{outcome.hint}"
            if step.fails is True or step.fails in said:
                return
            outcome = StepOutcome(1, f"it failed, but not with {step.fails!r}: {outcome.message}", outcome.hint)
        elif step.fails:
            outcome = StepOutcome(1, "it was to fail, and did not", output=outcome.output)
        raise _Failed(step, outcome, self._stage.now_s())

    def _wait_for(self, at_s: float) -> None:
        """Raises Refused: the time has passed."""
        client = self._stage.client
        left_s = at_s - self._stage.now_s()
        if left_s < -_EARLY_S:
            raise Refused(f"it is {at_s - left_s:.9g} s already, and the step is at {at_s:g} s")
        if left_s > _EARLY_S:
            if client.call("/slidectl/status")["paused"]:
                client.step(seconds=left_s)
            else:
                client.call("/slidectl/sleep", {"duration": left_s}, timeout=math.inf)
