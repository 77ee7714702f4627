"""The pytest plugin: fixtures for a world in this process and for a daemon, and the recordings of failed tests.

pytest finds it by its entry point. It is imported in each run of pytest where slidectl is installed, so it imports
nothing before a fixture is used. docs/pytest.md is its manual.

While a test runs, only the journal of its world is written. When a recording is needed, a replay of the journal in
another process makes it. So recording costs nothing while tests pass, and works for runs that cannot be repeated.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import pytest

from slidectl import paths as slidectl_paths
from slidectl.errors import NoDaemon, SlidectlError

if TYPE_CHECKING:
    from slidectl.client import Client
    from slidectl.daemon.in_process import InProcessWorld
    from slidectl.daemon.options import DaemonOptions
    from slidectl.extensions.scenarios.stages import CaseRuns

_MARKER = "slidectl"
_WORLD = ("timestep", "gravity", "ground", "engine", "imports", "paused")
_ARGUMENTS = (*_WORLD, "rtf", "sim_timeout")
SIM_TIMEOUT_S = 600.0
"""Default limit of the simulated time of a test, s."""
RECORDED_S = 60
"""The length of a recording: the last simulated seconds of the test, s."""
_REPLAY_S = 300.0
_RUN_S = 120.0
_CASE_S = 60.0
"""Wall seconds that a case of a scenario may take, unless its file says it, as in `slidectl test`."""
_CLIENT_S = 30.0
_LOG_LINES = 20
_VARIABLES = ("SLIDECTL_INSTANCE", "SLIDECTL_SOCKET", "SLIDECTL_NAMESPACE")
_LONGEST_STEM = 120
_PACKAGE = os.path.dirname(slidectl_paths.__file__) + os.sep
_UNSAFE = re.compile(r"[^A-Za-z0-9_.=+-]")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("slidectl", "slidectl: robots in tests")
    group.addoption(
        "--slidectl-record", choices=("failed", "all", "none"), default="failed",
        help="Keep the recordings and journals of these tests (failed).",
    )  # fmt: skip
    group.addoption(
        "--slidectl-keep", metavar="DIR", help="Where they are kept; by default in pytest's temporary folder."
    )
    parser.addini("slidectl_scenarios", "Scenario files to run as tests, such as scenarios/*.yaml.", type="args")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", f"{_MARKER}({', '.join(_ARGUMENTS)}): the world of slidectl's fixtures.")


# --- what is kept -----------------------------------------------------------------------------------------------------


@dataclass
class _JournaledRun:
    """The run of one world in one test, with its journal. `connect` makes a client of the world, `log` its log."""

    journal: Path | None
    environment: dict[str, str]
    """Environment variables with which a replay finds the modules that the world has imported."""
    connect: Callable[[], Client]
    log: Callable[[], Sequence[str]]
    said: str = ""
    """The text about the recording; empty before it is made."""

    def keep(self) -> str:
        """Make the recording up to this moment. Returns the text about it for the report."""
        if not self.said:
            try:
                files = [] if self.journal is None else [*self._record(self.journal), f"journal: {self.journal}"]
            except Exception as error:  # the report of the test must still be printed
                files = [f"no recording: {type(error).__name__}: {error}"]
            self.said = "\n".join([*files, "last lines of the log:", *list(self.log())[-_LOG_LINES:]])
        return self.said

    def _record(self, journal: Path) -> list[str]:
        from slidectl.extensions.recording.recording_files import usual_suffix

        with suppress(SlidectlError), self.connect() as client:  # the world may have ended
            client.sleep(0)  # adds an entry to the journal: a replay ends with the last entry
        file = journal.with_suffix(usual_suffix())
        words = ["replay", str(journal), "--record", str(file), "--last", str(RECORDED_S), "--json"]
        try:
            done = _slidectl(words, _REPLAY_S, env=self.environment)
        except subprocess.TimeoutExpired:
            file.unlink(missing_ok=True)
            return [f"no recording: the replay takes longer than {_REPLAY_S:g} s; slidectl {shlex.join(words)}"]
        if done.returncode:
            file.unlink(missing_ok=True)
            return [f"no recording: {done.stderr.strip()}"]
        found = json.loads(done.stdout)
        differs = [f"which differs from the test: {found['differs']}"] if found["differs"] else []
        return [f"recording: {file}, up to {found['time']:.3f} s", *differs]

    def forget(self) -> None:
        """Delete the journal, unless `keep` was called."""
        if self.journal is not None and not self.said:
            self.journal.unlink(missing_ok=True)


_RUNS = pytest.StashKey[list[_JournaledRun]]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    failure = call.excinfo
    if failure is not None and isinstance(failure.value, SlidectlError) and not item.config.getoption("fulltrace"):
        _cut(failure.tb)
    report = yield
    is_wanted = report.failed or (call.when == "call" and item.config.getoption("slidectl_record") == "all")
    for run in item.stash.get(_RUNS, ()):
        if is_wanted:
            report.sections.append(("slidectl", run.keep()))
        elif call.when == "teardown":
            run.forget()
    if call.when == "teardown" and _RUNS in item.stash:  # a plugin may run the same test again
        del item.stash[_RUNS]
    return report


def _cut(entry: TracebackType | None) -> None:
    """Cut a traceback after the last entry outside of slidectl: the error's message explains the rest."""
    last = None
    while entry is not None:
        if not entry.tb_frame.f_code.co_filename.startswith(_PACKAGE):
            last = entry
        entry = entry.tb_next
    if last is not None:
        last.tb_next = None


def _journal_of(request: pytest.FixtureRequest, suffix: str = "") -> Path | None:
    """The path for the journal. Files of an earlier run of the test are deleted."""
    config = request.config
    if config.getoption("slidectl_record") == "none":
        return None
    keep = config.getoption("slidectl_keep")
    factory: pytest.TempPathFactory = request.getfixturevalue("tmp_path_factory")
    folder = factory.getbasetemp() / "slidectl" if keep is None else config.invocation_params.dir / keep
    folder.mkdir(parents=True, exist_ok=True)
    stem = _stem(request.node.nodeid) + suffix
    for old in (".journal", ".mcap", ".bag"):
        (folder / f"{stem}{old}").unlink(missing_ok=True)
    return folder / f"{stem}.journal"


def _stem(test: str) -> str:
    """A unique file name for a test; one that was changed or cut ends with a checksum."""
    function, _, parameters = test.partition("[")
    plain = function.replace("::", "-") + (f"-{parameters[:-1]}" if parameters else "")
    stem = _UNSAFE.sub("_", plain)
    if plain == stem and len(stem) <= _LONGEST_STEM:
        return stem
    return f"{stem[:_LONGEST_STEM]}-{hashlib.sha256(test.encode()).hexdigest()[:8]}"


# --- worlds -----------------------------------------------------------------------------------------------------------


def _marked(request: pytest.FixtureRequest) -> dict[str, Any]:
    """The arguments of the test's markers; the nearest marker overrides the others."""
    given: dict[str, Any] = {}
    for mark in reversed(list(request.node.iter_markers(_MARKER))):
        given |= mark.kwargs
        unknown = [*map(repr, mark.args), *(mark.kwargs.keys() - set(_ARGUMENTS))]
        if unknown:
            pytest.fail(f"@pytest.mark.{_MARKER} takes {', '.join(_ARGUMENTS)} by name, not {unknown[0]}", False)
    return given


def _options(given: dict[str, Any], folder: Path, journal: Path | None, **more: Any) -> DaemonOptions:
    """The daemon's options from the marker. Files to import are first searched in the test's folder."""
    from slidectl.cli.daemon import module_or_file
    from slidectl.daemon.options import DaemonOptions
    from slidectl.errors import UsageError

    world = {name: given[name] for name in _WORLD if name in given}
    wrong: Exception
    try:
        imports = given.get("imports", ())
        if isinstance(imports, str):
            raise UsageError(f"imports is a list of modules or files, not {imports!r}")
        beside = (folder / name for name in imports)
        world["imports"] = tuple(
            str(file) if file.suffix == ".py" and file.is_file() else module_or_file(name)
            for file, name in zip(beside, imports, strict=True)
        )
        if "gravity" in given:
            world["gravity"] = tuple(given["gravity"])
        float(given.get("sim_timeout", SIM_TIMEOUT_S))
        return DaemonOptions(**world, **more, strict=True, journal="" if journal is None else str(journal))
    except (SlidectlError, TypeError, ValueError) as error:
        wrong = error
    pytest.fail(f"@pytest.mark.{_MARKER}: {wrong}", False)


def _path_for(options: DaemonOptions) -> dict[str, str]:
    """The environment in which another process finds the modules that are imported by their names."""
    names_modules = any(not name.endswith(".py") for name in options.imports)
    return {"PYTHONPATH": os.pathsep.join(sys.path)} if names_modules else {}


@contextmanager
def _failing_with_message() -> Iterator[None]:
    """Fail the test with the message of a SlidectlError only: a traceback would show pytest's own code."""
    said = None
    try:
        yield
    except SlidectlError as error:
        said = str(error)
    if said is not None:
        pytest.fail(said, pytrace=False)


_FIRST = pytest.StashKey["InProcessWorld"]()
"""The world that compiles the engine if it is not compiled yet: the compiler is its child and outlives its test."""


@pytest.fixture
def slidectl_world(request: pytest.FixtureRequest) -> Iterator[InProcessWorld]:
    """A new world in this process, without a daemon. Time passes in it only while a client waits for something."""
    from slidectl.daemon.in_process import InProcessWorld
    from slidectl.extensions.journal.journal import Journal
    from slidectl.simulation.compiled import object_file
    from slidectl.simulation.host import Host
    from slidectl.simulation.simulation import Simulation

    given = _marked(request)
    path = _journal_of(request)
    options = _options(given, request.path.parent, path)
    host = Host() if path is None else Journal(options)
    try:
        with _failing_with_message():
            simulation = Simulation(**options.of_simulation(), host=host)
        world = InProcessWorld(simulation)
        request.node.stash.setdefault(_RUNS, []).append(
            _JournaledRun(path, _path_for(options), world.client, lambda: world.log)
        )
        if options.engine != "plain":
            first = request.config.stash.setdefault(_FIRST, world)
            simulation.engine.may_load = first is world or object_file.is_there()
        simulation.run.paused = options.paused
        limit_s = float(given.get("sim_timeout", SIM_TIMEOUT_S))
        world.end_ns = round(limit_s * 1e9)
        world.end_hint = f"more of it: @pytest.mark.{_MARKER}(sim_timeout={2 * limit_s:g})"
        yield world
    finally:
        host.close("the test is over")


@pytest.fixture
def slidectl_client(slidectl_world: InProcessWorld) -> Iterator[Client]:
    """A client of a new world in this process: spawn, publish, wait, measure. Waits end at the time limit."""
    # Leaving the client raises MessageRefused if a message was refused.
    with _failing_with_message(), suppress(NoDaemon), slidectl_world.client(timeout=math.inf) as client:
        yield client


# --- a daemon ---------------------------------------------------------------------------------------------------------


class TemporaryDaemon:
    """A daemon in its own folder. Commands and clients of this process and its children use it by default."""

    def __init__(self, folder: Path, options: DaemonOptions) -> None:
        from slidectl import paths
        from slidectl.daemon import lifecycle

        self._folder = folder / "slidectl"
        self._paths = paths.instance()
        with warnings.catch_warnings():  # its process keeps running: with warnings as errors this would fail
            warnings.simplefilter("ignore", ResourceWarning)
            self.pid, _ = lifecycle.start(self._paths, options)

    def run(
        self, *words: object, check: bool = True, input: str | None = None, timeout: float = _RUN_S
    ) -> subprocess.CompletedProcess[str]:
        """Run a command line of slidectl. Returns its `stdout`, `stderr` and exit code (`returncode`).

        With `check` the test fails when the exit code is not 0. `timeout` is in wall seconds.
        """
        __tracebackhide__ = True
        done = _slidectl(list(map(str, words)), timeout, input)
        if check and done.returncode:
            said = "\n".join(filter(None, [done.stdout.rstrip(), done.stderr.rstrip()]))
            pytest.fail(f"slidectl {shlex.join(map(str, words))}: exit code {done.returncode}\n{said}")
        return done

    def connect(self) -> Client:
        """Open a new connection to the daemon; the caller closes it."""
        from slidectl.client import Client

        return Client(socket=self._paths.socket_text, timeout=_CLIENT_S)

    @cached_property
    def client(self) -> Client:
        """A connection to the daemon."""
        return self.connect()

    @property
    def log(self) -> str:
        """The text of the daemon's log."""
        with suppress(FileNotFoundError):
            return self._paths.log.read_text("utf-8", "replace")
        return ""

    def stop(self) -> None:
        """End the daemon, and other daemons that were started in its folder. Raises MessageRefused as a client does."""
        try:
            if "client" in vars(self):
                with suppress(NoDaemon), self.client:
                    pass
        finally:
            for instance in sorted(self._folder.iterdir()):
                self.run("-i", instance.name, "daemon", "stop")


@pytest.fixture
def slidectl_daemon(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[TemporaryDaemon]:
    """A new daemon that runs as fast as it can, with the command line: `slidectl_daemon.run("spawn", "slider")`."""
    given = _marked(request)
    path = _journal_of(request, "-daemon")
    options = _options(given, request.path.parent, path, rtf=given.get("rtf", math.inf), child=True)
    folder = Path(tempfile.mkdtemp(prefix="slidectl-"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    for variable in _VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    try:
        with _failing_with_message(), monkeypatch.context() as patch:
            for variable, value in _path_for(options).items():
                patch.setenv(variable, value)
            daemon = TemporaryDaemon(folder, options)
        request.node.stash.setdefault(_RUNS, []).append(
            _JournaledRun(path, _path_for(options), daemon.connect, lambda: daemon.log.splitlines())
        )
        try:
            yield daemon
        finally:
            with _failing_with_message():
                daemon.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


# --- scenarios --------------------------------------------------------------------------------------------------------


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    if any(file_path.match(pattern) for pattern in parent.config.getini("slidectl_scenarios")):
        return _ScenarioFile.from_parent(parent, path=file_path)
    return None


class _ScenarioFile(pytest.File):
    def collect(self) -> Iterable[pytest.Item]:
        from slidectl.errors import BadFile
        from slidectl.extensions.scenarios import scenario_file
        from slidectl.extensions.scenarios.scenario_items import ScenarioItem

        if _CASE_RUNS not in self.config.stash:
            self.config.stash[_CASE_RUNS] = _case_runs(self.config)
        runs = self.config.stash[_CASE_RUNS]
        mistakes: list[BadFile] = []
        cases = scenario_file.read(os.path.relpath(self.path), runs.commands, mistakes)
        if mistakes:
            raise self.CollectError("\n".join(map(str, mistakes)))
        for case in cases:
            yield ScenarioItem.from_parent(self, name=case.name or case.scenario, case=case, runs=runs, timeout=_CASE_S)


_CASE_RUNS = pytest.StashKey["CaseRuns"]()


def _case_runs(config: pytest.Config) -> CaseRuns:
    """The runs of all scenarios of this session."""
    from slidectl.extensions.scenarios.commands.step_runner import StepRunner
    from slidectl.extensions.scenarios.stages import CaseRuns, InProcess

    keep = config.getoption("slidectl_keep")
    if keep is not None and config.getoption("slidectl_record") != "none":
        keep = str(config.invocation_params.dir / keep)
        os.makedirs(keep, exist_ok=True)
    else:
        keep = None
    return CaseRuns(StepRunner(), InProcess(), SIM_TIMEOUT_S, keep, None)


def _slidectl(
    words: Sequence[str], timeout: float, input: str | None = None, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command line of slidectl in another process."""
    from slidectl.paths import with_package

    # -P: a user's file with the name of a library must not be imported instead of it.
    command = [sys.executable, "-P", "-m", "slidectl", *words]
    stdin: dict[str, Any] = {"stdin": subprocess.DEVNULL} if input is None else {"input": input}
    environment = with_package(os.environ | (env or {}))
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout, **stdin)
