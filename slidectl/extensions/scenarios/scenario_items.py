"""Cases of scenarios as items of pytest. `slidectl test` and the pytest plugin both run them as such.

A case is run in the setup of its item. So a case that could not be tried is an error of its setup, and one that was
tried and failed is a failure, as pytest tells them apart. It runs in a process of its own, forked from this one, in
which everything is already loaded. An early end (limit, crash, Ctrl-C) gives a result too.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest

from slidectl.extensions.scenarios.case_run import BAD, ERROR, XFAILED, CaseResult, WallTimeUp, report_lines
from slidectl.extensions.scenarios.scenario_file import Case
from slidectl.extensions.scenarios.stages import CaseRuns
from slidectl.operating_system import end_with
from slidectl.paths import shown

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
        return shown("\n".join(report_lines(self.case, self.result)))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """The report of a case that failed, without a traceback."""
        if isinstance(excinfo.value, _CaseFailed):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[os.PathLike[str], int | None, str]:
        """Where the item is."""
        return Path(self.path), None, self.name


# --- the process of a case ------------------------------------------------------------------------------------------

INTERRUPTED = "interrupted"
"""The message of a case that was ended by Ctrl-C."""
_GRACE_S = 5.0
"""The time for the teardown of a case that must end, s; then its process is killed."""
_CHECK_EVERY_S = 0.1
_FORK = multiprocessing.get_context("fork")

RunCase = Callable[[Case, str], CaseResult]
"""Runs a case; the second argument is the folder for it."""


def run_apart(run: RunCase, case: Case, limit_s: float, is_over: Callable[[], bool]) -> CaseResult:
    """Run a case in another process for at most `limit_s` wall seconds, plus 5 s for its teardown.

    `is_over` is called ten times a second: True ends the case, with its teardown. An exception, such as
    KeyboardInterrupt, ends it as well and passes through.
    """
    folder = tempfile.mkdtemp(prefix="slidectl-test-")
    receiving, sending = _FORK.Pipe(duplex=False)
    process = _FORK.Process(target=_work, args=(run, case, folder, sending, os.getpid()))
    began_s = time.monotonic()
    try:
        with warnings.catch_warnings():
            # The warning about threads: those of numpy's linear algebra are idle, and those of pytest-xdist have
            # nothing that the case needs.
            warnings.simplefilter("ignore", DeprecationWarning)
            process.start()
        sending.close()
        why, deadline_s = "", began_s + limit_s
        while not receiving.poll(_CHECK_EVERY_S):  # at the end of the process, too
            is_late = time.monotonic() >= deadline_s
            if why and is_late:
                process.kill()
            elif not why and (is_late or is_over()):
                why = f"not done within {limit_s:g} s of wall time" if is_late else INTERRUPTED
                deadline_s = time.monotonic() + _GRACE_S
                process.terminate()
        try:
            result: CaseResult = receiving.recv()
        except EOFError:
            process.join()
            return CaseResult(
                case.id,
                ERROR,
                message=why or _end_of(process.exitcode or 0),
                wall_time=time.monotonic() - began_s,
                was_ended=bool(why),
            )
        if why and result.verdict == ERROR:
            result.message = why
        return result
    except BaseException:
        process.terminate()
        raise
    finally:
        process.join(_GRACE_S)
        process.kill()
        process.join()
        receiving.close()
        shutil.rmtree(folder, ignore_errors=True)


def _end_of(exit_code: int) -> str:
    if exit_code < 0:
        return f"its process was ended by {signal.Signals(-exit_code).name}"
    return f"its process ended with exit code {exit_code} and no result"


def _work(run: RunCase, case: Case, folder: str, sending: Connection, parent: int) -> None:
    """The body of the process. It never returns into the code of the parent."""
    code = 1
    try:
        gc.freeze()  # the objects of the parent: a garbage collection would copy their pages
        gc.enable()  # the parent may do without
        is_wanted = end_with(parent, signal.SIGKILL)
        for number in (signal.SIGINT, signal.SIGHUP):  # a terminal sends these to all; the parent sends SIGTERM
            signal.signal(number, lambda *_: None)  # not SIG_IGN, which programs of a launch would inherit
        signal.signal(signal.SIGTERM, _raise_end)
        if is_wanted:
            _redirect_streams(os.path.join(folder, "output"))
            sending.send(run(case, folder))
            code = 0
    except BaseException as error:
        sending.send(CaseResult(case.id, ERROR, message=f"{type(error).__name__}: {error}"))
    finally:
        os._exit(code)


def _redirect_streams(path: str) -> None:
    """Redirect standard output and error of this process to a file, and make its input empty."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    empty = os.open(os.devnull, os.O_RDONLY)
    for source, number in ((empty, 0), (file, 1), (file, 2)):
        os.dup2(source, number)
    # Those of the parent may write elsewhere: pytest captures what a test prints.
    sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)


def _raise_end(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # only once, so that the teardown is not interrupted
    raise WallTimeUp("ended by a signal")
