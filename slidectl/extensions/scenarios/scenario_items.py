"""Cases of scenarios as items of pytest. `slidectl test` and the pytest plugin both run them as such.

A case is run in the setup of its item, in a process of its own. So a case that could not be tried is an error of its
setup, and one that was tried and failed is a failure, as pytest tells them apart.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from slidectl.extensions.scenarios.case_process import run_apart
from slidectl.extensions.scenarios.case_run import BAD, ERROR, XFAILED, CaseResult, report_lines
from slidectl.extensions.scenarios.scenario_file import Case
from slidectl.extensions.scenarios.stages import CaseRuns

NOT_RUN = "not run"


class _CaseFailed(Exception):
    """A case has failed. The text is the report."""


class ScenarioItem(pytest.Item):
    """A case of a scenario file.

    Args:
        timeout: wall seconds that the case may take, unless its file says it.
        is_over: called ten times a second; True ends the running case.
        begins: True while cases may begin; then the remaining ones are skipped.
    """

    def __init__(
        self,
        case: Case,
        runs: CaseRuns,
        timeout: float,
        is_over: Callable[[], bool] = lambda: False,
        begins: Callable[[], bool] = lambda: True,
        **more: Any,
    ) -> None:
        super().__init__(**more)
        self.case = case
        self.runs = runs
        self._timeout = timeout
        self._is_over = is_over
        self._begins = begins
        self.result: CaseResult | None = None
        """Set when the case has been run."""
        # -k finds it by what identifies it: also where the file's node has another name.
        self.extra_keyword_matches |= {case.id, case.scenario, *case.tags}

    def setup(self) -> None:
        """Run the case. Raises _CaseFailed: it could not be tried."""
        if not self._begins():
            self.session.shouldstop = NOT_RUN
            pytest.skip(NOT_RUN)
        self.runs.prepare()
        limit_s = self.case.timeout or self._timeout
        result = self.result = run_apart(self.runs.run, self.case, limit_s, self._is_over)
        if result.verdict == ERROR:
            raise _CaseFailed(self._report())

    def runtest(self) -> None:
        """Raise what the verdict of the case is in terms of pytest."""
        assert self.result is not None
        if self.result.verdict in BAD:
            raise _CaseFailed(self._report())
        if self.result.verdict == XFAILED:
            pytest.xfail(self.case.xfail)

    def _report(self) -> str:
        assert self.result is not None
        return "\n".join(report_lines(self.case, self.result))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """The report of a case that failed, without a traceback."""
        if isinstance(excinfo.value, _CaseFailed):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[os.PathLike[str], int | None, str]:
        """Where the item is."""
        return Path(self.path), None, self.name
