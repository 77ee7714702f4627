"""Runs a case in a process of its own, forked from this one, in which everything is already loaded.

The process writes its result to a pipe. An early end (limit, crash, Ctrl-C) gives a result too, and the folder of the
case is deleted. The process is killed when this one ends; if this process is killed by SIGKILL, the folder stays.
"""

from __future__ import annotations

import gc
import json
import os
import select
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress

from slidectl.extensions.scenarios.case_run import ERROR, CaseResult, WallTimeUp
from slidectl.extensions.scenarios.scenario_file import Case
from slidectl.operating_system import end_with

INTERRUPTED = "interrupted"
"""The message of a case that was ended by Ctrl-C."""
_GRACE_S = 5.0
"""The time for the teardown of a case that is told to end, s; then its process is killed."""
_LONGEST_WAIT_S = 0.1

RunCase = Callable[[Case, str], CaseResult]
"""Runs a case; the second argument is the folder for it."""


def run_apart(run: RunCase, case: Case, limit_s: float, is_over: Callable[[], bool]) -> CaseResult:
    """Run a case in another process for at most `limit_s` wall seconds, plus 5 s for its teardown.

    `is_over` is called ten times a second: True ends the case, with its teardown. An exception, such as
    KeyboardInterrupt, ends it as well and passes through.
    """
    folder = tempfile.mkdtemp(prefix="slidectl-test-")
    try:
        return _CaseProcess(run, case, folder, limit_s).result(is_over)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class _CaseProcess:
    """A running process with its pipe."""

    def __init__(self, run: RunCase, case: Case, folder: str, limit_s: float) -> None:
        self._case = case
        self._limit_s = limit_s
        self._began_s = time.monotonic()
        self._deadline_s = self._began_s + limit_s
        """The time when it is told to end, or then killed; monotonic clock, s."""
        self._said = bytearray()
        self._why = ""
        """Why it was told to end, or empty."""
        self._pipe, writing = os.pipe()
        parent = os.getpid()
        sys.stdout.flush()
        sys.stderr.flush()
        with warnings.catch_warnings():
            # The warning about threads: those of numpy's linear algebra are idle, and those of pytest-xdist have
            # nothing that the case needs.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._pid = os.fork()
        if self._pid == 0:
            _work(run, case, folder, writing, parent)
        os.close(writing)

    def result(self, is_over: Callable[[], bool]) -> CaseResult:
        """Wait for the end of the process."""
        try:
            while self._is_running():
                if not self._why and is_over():
                    self._tell(INTERRUPTED)
            return self._outcome(os.waitpid(self._pid, 0)[1])
        except BaseException:
            self._tell(INTERRUPTED)
            try:
                while self._is_running():
                    pass
            finally:
                with suppress(ProcessLookupError, ChildProcessError):
                    os.kill(self._pid, signal.SIGKILL)
                    os.waitpid(self._pid, 0)
            raise
        finally:
            os.close(self._pipe)

    def _is_running(self) -> bool:
        """Read from the pipe, or wait a moment for it, and keep the limit. False when the process has closed it."""
        wait_s = min(_LONGEST_WAIT_S, max(0.0, self._deadline_s - time.monotonic()))
        if select.select([self._pipe], [], [], wait_s)[0]:
            piece = os.read(self._pipe, 1 << 16)
            self._said.extend(piece)
            if not piece:
                return False
        if time.monotonic() < self._deadline_s:
            return True
        if self._why:
            with suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
        else:
            self._tell(f"not done within {self._limit_s:g} s of wall time")
        return True

    def _tell(self, why: str) -> None:
        """Tell the process to end."""
        self._why = self._why or why
        self._deadline_s = time.monotonic() + _GRACE_S
        with suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGTERM)

    def _outcome(self, status: int) -> CaseResult:
        why = self._why
        with suppress(ValueError, TypeError):
            result = CaseResult(**json.loads(self._said))
            if why and result.verdict == ERROR:
                result.message = why
            return result
        if os.WIFSIGNALED(status):
            why = why or f"its process was ended by {signal.Signals(os.WTERMSIG(status)).name}"
        why = why or f"its process ended with exit code {os.waitstatus_to_exitcode(status)} and no result"
        wall_s = time.monotonic() - self._began_s
        return CaseResult(self._case.id, ERROR, message=why, wall_time=wall_s, was_ended=bool(self._why))


def _work(run: RunCase, case: Case, folder: str, writing: int, parent: int) -> None:
    """The body of the process. It never returns into the code of the parent."""
    code = 1
    try:
        gc.freeze()  # the objects of the parent: a garbage collection would copy their pages
        gc.enable()  # the parent may do without
        is_wanted = end_with(parent, signal.SIGKILL)
        for number in (signal.SIGINT, signal.SIGHUP):  # a terminal sends these to all; the parent sends SIGTERM
            signal.signal(number, lambda *_: None)  # not SIG_IGN, which programs of a launch would inherit
        signal.signal(signal.SIGTERM, _end)
        if is_wanted:
            _redirect_streams(os.path.join(folder, "output"))
            result = run(case, folder)
            with os.fdopen(writing, "wb") as pipe:
                pipe.write(json.dumps(result.as_dict()).encode())
            code = 0
    except BaseException as error:
        with suppress(OSError), os.fdopen(writing, "wb") as pipe:
            result = CaseResult(case.id, ERROR, message=f"{type(error).__name__}: {error}")
            pipe.write(json.dumps(result.as_dict()).encode())
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


def _end(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # only once, so that the teardown is not interrupted
    raise WallTimeUp("told to end")
