"""The extensions: each uses public faces only, and the rest works without it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from test_floors import EXTENSIONS, PACKAGE, REACHES

IMPORT_ALL = """
import importlib, pkgutil, slidectl
for module in pkgutil.walk_packages(slidectl.__path__, "slidectl."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
print(slidectl.__file__)
"""


def dependents(extension: str) -> set[str]:
    """The extension and those that cannot be without it, by the table of reaches."""
    found = {extension}
    while more := {user for user, used in REACHES if used in found and user in EXTENSIONS} - found:
        found |= more
    return found


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("extension", sorted(EXTENSIONS))
def test_without_an_extension_the_rest_is_imported_and_runs_a_robot(extension: str, tmp_path: Path) -> None:
    gone = dependents(extension)
    shutil.copytree(
        PACKAGE,
        tmp_path / "slidectl",
        ignore=lambda folder, names: gone & set(names) if Path(folder).name == "extensions" else {"__pycache__"},
    )
    with tempfile.TemporaryDirectory(prefix="slidectl-", dir="/tmp") as runtime:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path), "XDG_RUNTIME_DIR": runtime}

        def run(*words: str) -> str:
            done = subprocess.run(
                [sys.executable, *words], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120
            )
            assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
            return done.stdout

        def slidectl(*words: str) -> str:
            return run("-m", "slidectl", *words)

        assert run("-c", IMPORT_ALL).strip() == str(tmp_path / "slidectl" / "__init__.py")
        assert "spawn" in slidectl("--help")
        slidectl("doctor")
        model, config = (str(PACKAGE.parent / file) for file in ("models/slider.xacro", "config/slider_control.yaml"))
        slidectl("daemon", "start", "--paused")
        try:
            slidectl("spawn", model, "--controllers", config, "--start", "joint1_position_controller")
            slidectl("pub", "command", "0.5")
            slidectl("sim", "step", "10s")
            slidectl("assert", "joint1", "--near", "0.5")
            assert "running" in slidectl("controller", "list")
            assert "slider" in slidectl("robots")
        finally:
            slidectl("daemon", "stop")


def test_a_command_of_an_extension_that_is_not_there_is_unknown(tmp_path: Path) -> None:
    """Its line in the table of commands is passed over, in the help too."""
    shutil.copytree(PACKAGE, tmp_path / "slidectl", ignore=shutil.ignore_patterns("viewing", "__pycache__"))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "slidectl", "view"], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "no command 'view'" in done.stderr
    done = subprocess.run(
        [sys.executable, "-m", "slidectl", "--help"], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert "  view " not in done.stdout
    assert "  spawn " in done.stdout
