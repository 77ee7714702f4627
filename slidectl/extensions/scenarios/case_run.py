"""Runs one case of a scenario, from the first step to the end of its teardown, in a world (its stage)."""

from __future__ import annotations

import json
import math
import shlex
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from slidectl.client import Client
from slidectl.errors import EXIT_INTERRUPTED, Refused, SlidectlError
from slidectl.extensions.scenarios.scenario_file import TEMPORARY, Case, ScenarioStep
from slidectl.extensions.scenarios.step_commands import Commands, StepOutcome

PASSED, FAILED, ERROR, XFAILED, XPASSED = "passed", "failed", "error", "xfailed", "xpassed"
BAD = (FAILED, ERROR, XPASSED)
TEARDOWN_S = 60.0
"""Simulated seconds that the teardown may take, in addition to the limit of the steps."""
_EARLY_S = 1e-9
_LOOK_EVERY_S = 1e-3
"""Simulated seconds between two checks whether a step that stays is up."""


@dataclass
class CaseResult:
    """The result of a case. For a failure it has the step with its line, the messages, and the last log lines."""

    id: str
    verdict: str
    sim_time: float = 0.0
    wall_time: float = 0.0
    steps: int = 0
    """The number of steps done."""
    step: str = ""
    section: str = ""
    line: int = 0
    message: str = ""
    hint: str = ""
    detail: dict[str, Any] = field(default_factory=dict)
    """The record that the failed step printed: for `wait` expected, value, closest and time."""
    failed_at: float | None = None
    """Simulated time of the failure, s."""
    log: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    """Files that were kept, such as recordings."""
    baseline: str = ""
    """A text about the baseline that was written."""
    was_ended: bool = False
    """True when it was ended from outside: by Ctrl-C, or at its limit of wall time."""


class WallTimeUp(BaseException):
    """The case has used up its wall time, or must end for another reason. Commands do not catch it as an error."""


class _Failed(Exception):
    """A step has failed."""

    def __init__(self, step: ScenarioStep, outcome: StepOutcome, time_s: float) -> None:
        super().__init__(outcome.message)
        self.step = step
        self.outcome = outcome
        self.time_s = time_s


class Stage:
    """The world where a case runs: a client, the simulated time since the start, and the last lines of the log."""

    client: Client

    def now_s(self) -> float:
        """Simulated time since the case began, s."""
        raise NotImplementedError

    def limit(self, seconds: float | None) -> None:
        """Let waits end with TimedOut after this simulated time from now; None: no limit."""

    def begin(self, run: Any) -> Any:
        """Run a function with its own client in the background. Returns a handle with the method `end`."""
        raise NotImplementedError

    def log(self) -> list[str]:
        """The last lines of the log."""
        raise NotImplementedError


@dataclass
class CaseRun:
    """Runs the steps of a case on a stage, with the teardown. `after_step` is called after each step before that."""

    case: Case
    commands: Commands
    stage: Stage
    sim_timeout: float
    temporary: str
    steps: Sequence[ScenarioStep]
    after_step: Callable[[], None]

    def __post_init__(self) -> None:
        self.sim_timeout = self.case.sim_timeout or self.sim_timeout
        self._result = CaseResult(self.case.id, PASSED)
        self._background: list[tuple[ScenarioStep, Any, list[StepOutcome]]] = []
        self._step: ScenarioStep | None = None

    def run(self) -> CaseResult:
        """Run the case. Its failures are in the result and not raised."""
        began_s = time.monotonic()
        result = self._result
        try:
            self._run_steps()
        finally:
            result.wall_time = time.monotonic() - began_s
        if self.case.xfail and result.verdict in (PASSED, FAILED):
            result.verdict = XPASSED if result.verdict == PASSED else XFAILED
            if result.verdict == XPASSED:
                result.message = f"it passed, but is a known failure: {self.case.xfail}"
                result.hint = "remove xfail from the file"
        return result

    def _run_steps(self) -> None:
        result = self._result
        try:
            for step in self.steps:
                if step.section != "teardown":
                    self._do(step, self.sim_timeout - self.stage.now_s())
                    self.after_step()
            self._end_background()
        except _Failed as failure:
            self._note(failure, FAILED if failure.step.section == "steps" else ERROR)
        except WallTimeUp as end:
            self._fail(ERROR, str(end))
            result.was_ended = True
        except SlidectlError as error:
            self._fail(ERROR, error.message, error.hint)
        with suppress(SlidectlError, WallTimeUp):
            result.sim_time = self.stage.now_s()
        self._tear_down()

    def _tear_down(self) -> None:
        """Run all steps of the teardown. Their first failure counts if the case has passed before."""
        with suppress(_Failed, WallTimeUp, SlidectlError):
            self._end_background()
        for step in self.steps:
            if step.section == "teardown":
                try:
                    self._do(step, TEARDOWN_S)
                except _Failed as failure:
                    if self._result.verdict == PASSED:
                        self._note(failure, ERROR)
                    else:
                        self._result.message += f"\nand in the teardown, {step.text}: {failure.outcome.message}"
                except (WallTimeUp, SlidectlError) as error:
                    self._result.was_ended |= isinstance(error, WallTimeUp)
                    if self._result.verdict == PASSED:
                        self._fail(ERROR, str(error))

    def _fail(self, verdict: str, message: str, hint: str | None = None) -> None:
        result = self._result
        result.verdict, result.message, result.hint = verdict, message, hint or ""
        if self._step is not None:
            result.step, result.section, result.line = self._step.text, self._step.section, self._step.line
        with suppress(SlidectlError, WallTimeUp):
            result.failed_at = self.stage.now_s()
        result.log = self.stage.log()

    def _note(self, failure: _Failed, verdict: str) -> None:
        self._step = failure.step
        self._fail(verdict, failure.outcome.message, failure.outcome.hint)
        result = self._result
        result.failed_at = failure.time_s
        with suppress(ValueError, IndexError):
            record = json.loads(failure.outcome.output.strip().splitlines()[-1])
            result.detail = record if isinstance(record, dict) else {}

    def _do(self, step: ScenarioStep, most_s: float) -> None:
        """Run a step. Raises _Failed."""
        self._step = step
        stage = self.stage
        try:
            began_s = stage.now_s()
            if step.at is not None:
                stage.limit(most_s)
                self._wait_for(step.at)
                most_s -= stage.now_s() - began_s
                began_s = stage.now_s()
            limit_s = most_s if step.within is None else min(most_s, step.within)
            stage.limit(limit_s)
            outcome = self._run(step)
            took_s = stage.now_s() - began_s
        except SlidectlError as error:  # an error of the world; errors of a command are in its outcome
            raise self._failed(step, StepOutcome(error.exit_code, error.message, error.hint or "")) from None
        finally:
            stage.limit(None)
        if outcome is not None:
            is_late = bool(outcome.exit_code) and took_s >= limit_s - _EARLY_S
            if is_late and limit_s != step.within:
                is_teardown = step.section == "teardown"
                whole = f"{TEARDOWN_S:g} s of the teardown" if is_teardown else f"{self.sim_timeout:g} s of the case"
                raise self._failed(step, _late(outcome, f"the {whole}"))
            self._judge(step, outcome, f"{step.within:g} s" if is_late else "")
            if step.within is not None and not step.fails and took_s > step.within + _EARLY_S:
                text = f"it took {took_s:g} s of simulated time; {step.within:g} s are allowed"
                raise self._failed(step, StepOutcome(1, text))
        self._result.steps += 1

    def _run(self, step: ScenarioStep) -> StepOutcome | None:
        """Run a step's command; None when it continues in the background."""
        if not step.words:
            return StepOutcome(0)
        words = [word.replace(TEMPORARY, self.temporary) for word in step.words]
        stays = self.commands.stays(words)
        if not step.background and not stays:
            return self.commands.run(words, self.stage.client)
        outcomes: list[StepOutcome] = []
        is_up = threading.Event()
        handle = self.stage.begin(lambda client: outcomes.append(self.commands.run(words, client, is_up.set)))
        self._background.append((step, handle, outcomes))
        while stays and not step.background and not is_up.is_set() and not outcomes:
            next(self.stage.client.events(_LOOK_EVERY_S), None)
        return outcomes[0] if outcomes else None

    def _end_background(self) -> None:
        """End the background steps. Raises _Failed for the first failure."""
        ended, self._background = self._background, []
        for _, handle, _ in ended:
            handle.end()
        for step, _, outcomes in ended:
            for outcome in outcomes:
                self._judge(step, StepOutcome(0) if outcome.exit_code == EXIT_INTERRUPTED else outcome)

    def _judge(self, step: ScenarioStep, outcome: StepOutcome, limit: str = "") -> None:
        """Raise _Failed for an unexpected outcome. `limit`: the time limit that was used up."""
        if not step.fails and outcome.exit_code:
            raise self._failed(step, _late(outcome, limit) if limit else outcome)
        if step.fails and not outcome.exit_code:
            raise self._failed(step, StepOutcome(1, "it should have failed", output=outcome.output))
        if isinstance(step.fails, str) and step.fails not in f"{outcome.message}\n{outcome.hint}":
            text = f"it failed, but not with {step.fails!r}: {outcome.message}"
            raise self._failed(step, StepOutcome(1, text, outcome.hint))

    def _failed(self, step: ScenarioStep, outcome: StepOutcome) -> _Failed:
        return _Failed(step, outcome, self.stage.now_s())

    def _wait_for(self, at_s: float) -> None:
        """Wait until a simulated time. Raises Refused: it has passed."""
        client = self.stage.client
        left_s = at_s - self.stage.now_s()
        if left_s < -_EARLY_S:
            raise Refused(f"it is {at_s - left_s:.9g} s already, and the step is at {at_s:g} s")
        if left_s > _EARLY_S:
            if client.call("/slidectl/status")["paused"]:
                client.step(seconds=left_s)
            else:
                client.call("/slidectl/sleep", {"duration": left_s}, timeout=math.inf)


def _late(outcome: StepOutcome, limit: str) -> StepOutcome:
    return outcome._replace(message=f"not done within {limit} of simulated time: {outcome.message}")


def report_lines(case: Case, result: CaseResult) -> list[str]:
    """The lines that describe a failure."""
    lines = [result.message]
    lines += [result.hint] if result.hint else []
    if result.detail.keys() >= {"expected", "value", "closest"}:
        lines.append("expected {expected}; closest {closest}, last {value}".format(**result.detail))
    if result.step:
        lines.append(f"{case.file}:{result.line}: {result.section}: {result.step}")
    if result.failed_at is not None:
        lines.append(f"at {result.failed_at:.3f} s of simulated time")
    if result.log:
        lines += ["last lines of the log:", *(f"  {line}" for line in result.log)]
    lines += [f"kept: {', '.join(result.kept)}"] if result.kept else []
    return [*lines, f"to run it alone: slidectl test {shlex.quote(result.id)}"] if case.steps else lines
