"""Runs cases in several worker processes at a time, forked from this one, in which everything is already loaded.

A worker writes its result to a pipe. An early end (limit, crash, Ctrl-C) gives a result too, and its folder is deleted.
Workers are killed when this process ends; if this process is killed by SIGKILL, their folders stay.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from slidectl.event_loop import READ, EventLoop
from slidectl.extensions.scenarios.case_run import ERROR, CaseResult, WallTimeUp
from slidectl.extensions.scenarios.scenario_file import Case
from slidectl.operating_system import end_with

_GRACE_S = 5.0
"""The time for the teardown of a worker that is told to end, s; then it is killed."""
_LONGEST_WAIT_S = 0.1

RunCase = Callable[[Case, str], CaseResult]
"""Runs a case; the second argument is the folder for it."""


@dataclass
class _Worker:
    case: Case
    pid: int
    pipe: int
    folder: str
    limit_s: float
    began_s: float = field(default_factory=time.monotonic)
    said: bytearray = field(default_factory=bytearray)
    told: str = ""
    """Why it was told to end, or empty."""

    def __post_init__(self) -> None:
        self.deadline_s = self.began_s + self.limit_s
        """The time when it is told to end, or then killed; monotonic clock, s."""


class WorkerPool:
    """Runs cases, at most `count` at a time. A context manager: leaving it ends the running cases."""

    def __init__(self, run: RunCase, count: int, timeout: float, is_over: Callable[[], bool]) -> None:
        """`is_over` is called ten times a second: True means that no case is started any more, and `results` ends."""
        self._run = run
        self._is_over = is_over
        self._count = count
        self._timeout = timeout
        self._running: dict[int, _Worker] = {}
        self._loop = EventLoop()
        self._results: list[CaseResult] = []
        """Those that have come and are not handed out yet."""

    def __enter__(self) -> WorkerPool:
        gc.collect()
        gc.freeze()  # the workers share these objects; a garbage collection would copy their pages
        return self

    def __exit__(self, *_: object) -> None:
        self.ended()
        self._loop.close()
        gc.unfreeze()

    def results(self, cases: Sequence[Case]) -> Iterator[CaseResult]:
        """The results in the order in which cases end. After an early end `ended` has those of the running cases."""
        waiting = list(reversed(cases))
        while (waiting or self._running) and not self._is_over():
            while waiting and len(self._running) < self._count:
                self._begin(waiting.pop())
            yield from self._take()

    def ended(self) -> list[CaseResult]:
        """End the running cases, with their teardown, and return their results."""
        found: list[CaseResult] = []
        for worker in self._running.values():
            _tell(worker, "interrupted")
        while self._running:
            found += self._take()
        return found

    def _begin(self, case: Case) -> None:
        folder = tempfile.mkdtemp(prefix="slidectl-test-")
        reading, writing = os.pipe()
        parent = os.getpid()
        sys.stdout.flush()
        sys.stderr.flush()
        with warnings.catch_warnings():
            # The warning about threads: those of numpy's linear algebra are idle.
            warnings.simplefilter("ignore", DeprecationWarning)
            pid = os.fork()
        if pid == 0:
            _work(self._run, case, folder, writing, parent)
        os.close(writing)
        worker = self._running[pid] = _Worker(case, pid, reading, folder, case.timeout or self._timeout)
        self._loop.watch(reading, READ, lambda _: self._hear(worker))

    def _hear(self, worker: _Worker) -> None:
        piece = os.read(worker.pipe, 1 << 16)
        worker.said.extend(piece)
        if not piece:
            self._results.append(self._reap(worker))

    def _take(self) -> list[CaseResult]:
        """Wait for an event. Returns new results."""
        wait_s = min([_LONGEST_WAIT_S, *(worker.deadline_s - time.monotonic() for worker in self._running.values())])
        self._loop.poll(max(0.0, wait_s))
        now_s = time.monotonic()
        for worker in self._running.values():
            if now_s >= worker.deadline_s and worker.told:
                with suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGKILL)
            elif now_s >= worker.deadline_s:
                _tell(worker, f"not done within {worker.limit_s:g} s of wall time")
        results, self._results = self._results, []
        return results

    def _reap(self, worker: _Worker) -> CaseResult:
        self._loop.forget(worker.pipe)
        os.close(worker.pipe)
        del self._running[worker.pid]
        why = worker.told
        status = os.waitpid(worker.pid, 0)[1]
        shutil.rmtree(worker.folder, ignore_errors=True)
        with suppress(ValueError, TypeError):
            result = CaseResult(**json.loads(worker.said))
            if why and result.verdict == ERROR:
                result.message = why
            return result
        if os.WIFSIGNALED(status):
            why = why or f"its process was ended by {signal.Signals(os.WTERMSIG(status)).name}"
        why = why or f"its process ended with exit code {os.waitstatus_to_exitcode(status)} and no result"
        wall_s = time.monotonic() - worker.began_s
        return CaseResult(worker.case.id, ERROR, message=why, wall_time=wall_s, was_ended=bool(worker.told))


def _tell(worker: _Worker, why: str) -> None:
    """Tell a worker to end."""
    worker.told = worker.told or why
    worker.deadline_s = time.monotonic() + _GRACE_S
    with suppress(ProcessLookupError):
        os.kill(worker.pid, signal.SIGTERM)


def _work(run: RunCase, case: Case, folder: str, writing: int, parent: int) -> None:
    """The body of a worker process. It never returns into the code of the parent."""
    code = 1
    try:
        is_wanted = end_with(parent, signal.SIGKILL)
        for number in (signal.SIGINT, signal.SIGHUP):  # a terminal sends these to all; the parent sends SIGTERM
            signal.signal(number, lambda *_: None)  # not SIG_IGN, which programs of a launch would inherit
        signal.signal(signal.SIGTERM, _end)
        if is_wanted:
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


def _end(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # only once, so that the teardown is not interrupted
    raise WallTimeUp("told to end")
