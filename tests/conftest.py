"""What holds for all tests. Its place also makes the modules beside it importable by them."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import signal
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from kinds_of_tests import marks_left_out, marks_of

# No test may depend on how fast the machine is, nor leave a database behind; `make fuzz` takes another seed each time.
settings.register_profile(
    "slidectl", deadline=None, suppress_health_check=[HealthCheck.too_slow], database=None, derandomize=True
)
settings.register_profile("quick", settings.get_profile("slidectl"), max_examples=20)
settings.load_profile("slidectl")

_CACHE = pytest.StashKey[pytest.MonkeyPatch]()
_PREFIX = "slidectl-cache-"


def pytest_configure(config: pytest.Config) -> None:
    """Signals do what they do in a terminal, and the folder of compiled code is one of this run."""
    _restore_signals()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else each process of a test compiles all its modules anew
    _share_cache(config)


def _restore_signals() -> None:
    """`nohup` and the background of a script ignore signals, and what ignores one hands that on to what it starts.

    SIGHUP stays ignored here: the run outlives its terminal. Tests that need it set it for what they start.
    """
    with suppress(ValueError):  # not in the main thread
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if signal.getsignal(signal.SIGQUIT) is signal.SIG_IGN:
            signal.signal(signal.SIGQUIT, signal.SIG_DFL)


def _share_cache(config: pytest.Config) -> None:
    """Compiled code goes into a folder of this run, which all its workers and daemons share: it is compiled once.

    The compiled cycle of the run before is there from the start; it is used where its sources are still the same.
    """
    is_in_another = Path(os.environ.get("XDG_CACHE_HOME", "")).name.startswith(_PREFIX)  # a test that runs tests
    if not hasattr(config, "workerinput") and not is_in_another:
        config.stash[_CACHE] = pytest.MonkeyPatch()
        config.stash[_CACHE].setenv("XDG_CACHE_HOME", tempfile.mkdtemp(prefix=_PREFIX))
        if (before := _cycles_of_runs(config)) is not None:
            _copy_cycles(before, _compiled())


def _cycles_of_runs(config: pytest.Config) -> Path | None:
    """The folder that runs hand on; None where pytest keeps nothing."""
    cache: pytest.Cache | None = getattr(config, "cache", None)
    return cache.mkdir("slidectl-compiled") if cache is not None else None


def _compiled() -> Path:
    return Path(os.environ["XDG_CACHE_HOME"], "slidectl")


def _copy_cycles(from_folder: Path, to_folder: Path) -> None:
    """Copy the newest compiled cycles, with their times."""
    to_folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    for file in sorted(from_folder.glob("cycle-*.o"), key=lambda path: path.stat().st_mtime)[-2:]:
        partial = to_folder / f"{file.name}.{os.getpid()}"
        shutil.copy2(file, partial)
        partial.replace(to_folder / file.name)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files whose tests are all left out by `-m` are not even imported."""
    left_out = marks_left_out(config.option.markexpr)
    return True if left_out and collection_path.is_file() and left_out & marks_of(_name(collection_path)) else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give the tests the marks of their files."""
    for item in items:
        for mark in marks_of(_name(item.path)):
            item.add_marker(mark)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """After each file, give freed memory back to the system: glibc keeps it, and a worker runs a hundred files."""
    if nextitem is None or nextitem.path != item.path:
        with suppress(AttributeError):  # another C library
            ctypes.CDLL(None).malloc_trim(0)


def _name(path: Path) -> str:
    """The path of a file of tests in this folder; empty elsewhere."""
    here = Path(__file__).parent
    return path.relative_to(here).as_posix() if path.is_relative_to(here) else ""


def pytest_unconfigure(config: pytest.Config) -> None:
    """A compilation that is still under way finds its folder gone, and ends."""
    if _CACHE in config.stash:
        with suppress(OSError):
            if (after := _cycles_of_runs(config)) is not None:
                _copy_cycles(_compiled(), after)
        shutil.rmtree(os.environ["XDG_CACHE_HOME"], ignore_errors=True)
        config.stash[_CACHE].undo()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Close with one line that names what is not installed, with the number of tests that were skipped for it."""
    skipped = [str(report.longrepr[-1]) for report in terminalreporter.stats.get("skipped", ())]
    if line := missing_programs(skipped):
        terminalreporter.write_line(line)


def missing_programs(reasons: Iterable[str]) -> str:
    """The line for the reasons of skipped tests; empty where nothing was missing."""
    found = (
        re.search(r"^(?:Skipped: )?(.+?) is not installed|there is no (.+) on this machine", one) for one in reasons
    )
    counts = Counter(match[1] or match[2] for match in found if match)
    parts = [f"{name} ({count} {'test' if count == 1 else 'tests'})" for name, count in counts.most_common()]
    return f"skipped, because it is not installed: {', '.join(parts)}" if parts else ""


@pytest.fixture
def no_package_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of whoever runs the tests finds no package for them."""
    for variable in ("SLIDECTL_PACKAGE_PATH", "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH"):
        monkeypatch.delenv(variable, raising=False)


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    """Writes a text to a file below the test's own folder."""

    def write_file(name: str, text: str) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
        return path

    return write_file
