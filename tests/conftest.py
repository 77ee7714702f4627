"""What holds for all tests. Its place also makes the modules beside it importable by them."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# No test may depend on how fast the machine is, nor leave a database behind; `make fuzz` takes another seed each time.
settings.register_profile(
    "slidectl", deadline=None, suppress_health_check=[HealthCheck.too_slow], database=None, derandomize=True
)
settings.load_profile("slidectl")

_CACHE = pytest.StashKey[pytest.MonkeyPatch]()


def pytest_configure(config: pytest.Config) -> None:
    """Compiled code goes into a folder of this run, which all its workers and daemons share: it is compiled once."""
    if not hasattr(config, "workerinput"):
        config.stash[_CACHE] = pytest.MonkeyPatch()
        config.stash[_CACHE].setenv("XDG_CACHE_HOME", tempfile.mkdtemp(prefix="slidectl-cache-"))


def pytest_unconfigure(config: pytest.Config) -> None:
    """A compilation that is still under way finds its folder gone, and ends."""
    if _CACHE in config.stash:
        shutil.rmtree(os.environ["XDG_CACHE_HOME"], ignore_errors=True)
        config.stash[_CACHE].undo()


@pytest.fixture
def no_package_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of whoever runs the tests finds no package for them."""
    for variable in ("SLIDECTL_PACKAGE_PATH", "ROS_PACKAGE_PATH"):
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
