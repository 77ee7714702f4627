"""The run of `slidectl test`: pytest in the process of the command, and workers of pytest-xdist.

The command has read and checked the files. Their cases go to pytest, and on to its workers, in a file of a temporary
folder: so all processes run the same cases, also of a file that can be read only once, and the name of a user's file
means nothing to pytest. The folder has the configuration too: pytest sees no configuration, no conftest.py, no
environment variables and no plugins of the user.

This module is also the plugin of these runs, in the workers too. It is not for the user's own runs of pytest: that is
`slidectl.extensions.scenarios.pytest_plugin`, which collects the same items.
"""

from __future__ import annotations

import json
import os
import pickle
import shlex
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slidectl.errors import UsageError
from slidectl.extensions.scenarios.baselines import Baselines
from slidectl.extensions.scenarios.case_run import BAD, ERROR, CaseResult, report_lines
from slidectl.extensions.scenarios.commands.step_runner import StepRunner
from slidectl.extensions.scenarios.scenario_file import Case
from slidectl.extensions.scenarios.scenario_items import NOT_RUN, ScenarioItem
from slidectl.extensions.scenarios.stages import CaseRuns, InProcess
from slidectl.operating_system import end_with
from slidectl.paths import shown

if TYPE_CHECKING:
    from slidectl.extensions.scenarios.live import Live

_CONFIGURATION = "pytest.ini"
_CASES = "cases.pickle"
_RESULTS = "results.xml"
_ENOUGH, _INTERRUPTED = "enough", "interrupted"
"""Files that tell all workers to begin no further case, and to end the running ones too."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_UNUSED = (
    "cacheprovider", "capture", "debugging", "doctest", "faulthandler", "legacypath", "logging", "pastebin",
    "setuponly", "setupplan", "stepwise", "terminal", "threadexception", "tmpdir", "unittest", "unraisableexception",
    "warnings",
)  # fmt: skip
"""Plugins of pytest that print, write files, or change what a case finds in its process."""
_RESTARTS = 4
"""How often each worker may die before the run ends: one that dies at its start would be started for ever."""


@dataclass(frozen=True)
class RunOptions:
    """How the cases of a run are run, in each of its processes."""

    timeout: float = 0.0
    """Wall seconds that a case may take, unless its file says it."""
    sim_timeout: float = 0.0
    keep: str | None = None
    """An existing folder for the recordings of failed cases."""
    baselines: Baselines | None = None
    socket: str | None = None
    """The socket of the daemon in which the cases run; None for worlds of their own."""


def chosen(cases: Sequence[Case], keyword: str) -> list[Case]:
    """The cases that pytest chooses by an expression of `-k`. Raises UsageError: it is no expression."""
    selection = _Selection()
    with tempfile.TemporaryDirectory(prefix="slidectl-test-") as folder:
        _pytest(Path(folder), cases, RunOptions(), ["--collect-only", "-k", keyword], selection)
    if selection.mistake is not None:
        raise UsageError(selection.mistake, "-k takes words with and, or, not and ( )")
    return selection.cases


class _Selection:
    """Collects the chosen cases."""

    def __init__(self) -> None:
        self.cases: list[Case] = []
        self.mistake: str | None = None

    @pytest.hookimpl(wrapper=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> Generator[None]:
        try:
            yield
        except pytest.UsageError as error:
            self.mistake = str(error)
            items.clear()
        except RecursionError:
            self.mistake = "the expression of -k is nested too deeply"
            items.clear()
        self.cases = [item.case for item in items if isinstance(item, ScenarioItem)]


class CaseRunner:
    """Runs cases with pytest. SIGINT, SIGTERM and SIGHUP end the running cases, with their teardown, and then the run.

    Args:
        workers: how many cases run at the same time.
        maxfail: stop after so many failures; None: never.
        more: further cases with results, which are asked for after the last case, unless a signal has ended the run.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        options: RunOptions,
        workers: int,
        maxfail: int | None,
        more: Iterable[tuple[Case, CaseResult]],
    ) -> None:
        self.cases = list(cases)
        self.results: dict[str, CaseResult] = {}
        """By the names of their cases. Cases that were not run have none."""
        self.interrupted = False
        self.junit = b""
        """The results as JUnit XML."""
        self._options = options
        self._workers = min(workers, len(cases)) if _goes_to_workers([tempfile.gettempdir(), *sys.path]) else 1
        self._maxfail = maxfail
        self._more = more
        self._ids = {_node_id(case): case.id for case in cases}
        self._reported: set[str] = set()
        self._failures = 0
        self._folder: Path | None = None
        self._on_result: Callable[[CaseResult], None] = lambda _: None

    def run(self, on_result: Callable[[CaseResult], None]) -> None:
        """Run the cases, and call `on_result` with each result, in the order in which the cases end.

        Raises:
            RuntimeError: pytest could not run them. OSError: the folder for temporary files could not be written. The
            results so far are there.
        """
        self._on_result = on_result
        with self._signals(), tempfile.TemporaryDirectory(prefix="slidectl-test-") as folder:
            self._folder = Path(folder)
            if self.interrupted:  # since the handlers are there
                self._stop(_INTERRUPTED)
            words = ["--junitxml", str(self._folder / _RESULTS), "-o", "junit_suite_name=slidectl test"]
            words += [] if self._maxfail is None else ["--maxfail", str(self._maxfail)]
            if self._workers > 1:
                # -P: a user's file with the name of a library must not be imported instead of it.
                python = shlex.join([os.path.normpath(sys.executable), "-P"])
                words += ["--tx", f"{self._workers}*popen//python={python}", "--dist", "load", "--maxschedchunk", "1",
                          "--max-worker-restart", str(_RESTARTS * self._workers)]  # fmt: skip
            _pytest(self._folder, self.cases, self._options, words, self)
            self.junit = (self._folder / _RESULTS).read_bytes()

    def _stop(self, how: str) -> None:
        if self._folder is not None:
            with suppress(OSError):
                (self._folder / how).touch()

    @contextmanager
    def _signals(self) -> Iterator[None]:
        previous = {}
        for number in _SIGNALS:
            if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:  # `nohup` ignores SIGHUP
                previous[number] = signal.signal(number, self._interrupt)
        try:
            yield
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)

    def _interrupt(self, *_: object) -> None:
        self.interrupted = True
        self._stop(_INTERRUPTED)

    # The hooks of pytest, called in the process of the command:

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the result of a case. The report of a worker that has died has none."""
        self._reported.add(report.nodeid)
        text = getattr(report, "scenario", None)
        case_id = self._ids.get(report.nodeid, report.nodeid)
        if text is not None:
            result = CaseResult(**json.loads(text))
        elif report.failed and case_id not in self.results:
            result = CaseResult(case_id, ERROR, message=str(report.longrepr))
        else:
            return
        self.results[result.id] = result
        self._failures += result.verdict in BAD
        if self._maxfail is not None and self._failures >= self._maxfail:
            self._stop(_ENOUGH)
        self._on_result(result)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Add to the report what pytest has not run, before it is written."""
        for node_id in self._ids:
            if node_id not in self._reported:
                _log(session, node_id, "skipped", ("", 0, NOT_RUN))
        for case, result in [] if self.interrupted else self._more:
            self.cases.append(case)
            self.results[case.id] = result
            _log(session, _node_id(case), "failed", shown("\n".join(report_lines(case, result))))


def _log(session: pytest.Session, node_id: str, outcome: Any, text: Any) -> None:
    report = pytest.TestReport(node_id, ("", None, ""), {}, outcome, text, "call")
    session.config.hook.pytest_runtest_logreport(report=report)


def _goes_to_workers(texts: Sequence[str]) -> bool:
    """True when pytest-xdist can send these to its workers, which it does in UTF-8."""
    return all(text == shown(text) for text in texts)


def _node_id(case: Case) -> str:
    """The name of the item in pytest, which goes through pipes as UTF-8."""
    return shown(f"{case.file}::{case.name or case.scenario}")


# --- pytest ---------------------------------------------------------------------------------------------------------


def _pytest(folder: Path, cases: Sequence[Case], options: RunOptions, words: Sequence[str], plugin: object) -> None:
    """Run pytest with the cases in this process. Raises RuntimeError, OSError."""
    (folder / _CONFIGURATION).write_text("[pytest]\n")
    (folder / _CASES).write_bytes(pickle.dumps((tuple(cases), options)))
    fault = _Fault()
    arguments = ["-c", str(folder / _CONFIGURATION), "--rootdir", str(folder), "--noconftest", "--assert", "plain"]
    for name in _UNUSED:
        arguments += ["-p", f"no:{name}"]
    # pytest looks in all installed packages for a plugin that is named by -p, and for none that is named here.
    plugins = [__name__, *(["xdist.plugin"] if "--tx" in words else [])]
    with _environment(PYTEST_PLUGINS=",".join(plugins), PYTEST_DISABLE_PLUGIN_AUTOLOAD="1"):
        code = pytest.main([*arguments, *words, str(folder / _CASES)], [plugin, fault])
    if code in (pytest.ExitCode.INTERNAL_ERROR, pytest.ExitCode.USAGE_ERROR):
        raise RuntimeError(f"pytest ended with exit code {int(code)}\n{fault.text}".rstrip())


@contextmanager
def _environment(**variables: str) -> Iterator[None]:
    """These variables instead of all that begin with PYTEST_, which the workers inherit."""
    before = dict(os.environ)
    for name in before:
        if name.startswith("PYTEST_"):
            del os.environ[name]
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


class _Fault:
    """The text of an internal error of pytest, or of this module."""

    text = ""

    def pytest_internalerror(self, excrepr: object) -> None:
        self.text = f"{self.text}\n{excrepr}".strip()


# --- the plugin, in the process that runs cases ---------------------------------------------------------------------


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect the cases."""
    # Its name is empty, as -k would find all cases by it.
    return _Cases.from_parent(parent, path=file_path, name="") if file_path.name == _CASES else None


class _Cases(pytest.File):
    def collect(self) -> Iterable[pytest.Item]:
        if hasattr(self.config, "workerinput"):
            _follow_the_command()
        options: RunOptions
        cases, options = pickle.loads(self.path.read_bytes())
        commands = StepRunner(options.socket is not None)
        stages: InProcess | Live = InProcess()
        if options.socket is not None:
            from slidectl.extensions.scenarios.live import Live  # late import: the physics that it imports is slow

            stages = Live(options.socket)
        runs = CaseRuns(commands, stages, options.sim_timeout, options.keep, options.baselines, cases)
        interrupted, enough = self.path.with_name(_INTERRUPTED), self.path.with_name(_ENOUGH)
        for case in cases:
            yield ScenarioItem.from_parent(
                self,
                name=shown(case.name or case.scenario),
                nodeid=_node_id(case),
                case=case,
                runs=runs,
                timeout=options.timeout,
                is_over=interrupted.exists,
                begins=lambda: not (interrupted.exists() or enough.exists()),
            )


def _follow_the_command() -> None:
    """Let a worker end with the command, and leave to the command what a terminal sends to both."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    if not end_with(os.getppid(), signal.SIGKILL):
        os._exit(1)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> None:
    """Load what the cases need, before the time of the first one begins."""
    for item in session.items[:1]:
        if isinstance(item, ScenarioItem) and not session.config.option.collectonly:
            item.runs.prepare()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Give the result to the command, as JSON in ASCII."""
    report = yield
    if call.when == "setup" and isinstance(item, ScenarioItem) and item.result is not None:
        report.scenario = json.dumps(vars(item.result))  # type: ignore[attr-defined]
    return report
