"""An environment with rclpy's wheels and slidectl, and a domain of ROS 2 that no other test uses."""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import pytest

ROOT = Path(__file__).parent.parent.parent.parent
LIMIT_S = 900
DISTRIBUTIONS = {
    "kilted": ("ros-rclpy[fastrtps]", "ros-"),
    "jazzy": ("ros-jazzy-rclpy[fastrtps]", "ros-jazzy-"),
}
"""Name -> the wheel of rclpy and the beginning of the names of its messages."""
MESSAGES = ("geometry-msgs", "nav-msgs", "rosgraph-msgs", "sensor-msgs", "std-msgs", "std-srvs", "trajectory-msgs")


def _python312() -> str | None:
    """A Python 3.12, for which the wheels are: on the PATH, or among those of pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for python in (shutil.which("python3.12"), *sorted(map(str, pyenv.glob("3.12.*/bin/python3")))):
        words = [python or "", "-c", "import ensurepip, sys, venv; sys.exit(sys.version_info[:2] != (3, 12))"]
        if python and subprocess.run(words, capture_output=True, timeout=60).returncode == 0:
            return python
    return None


def folder_of(distribution: str) -> Path:
    """The folder of the programs of an environment with that ROS 2; made once for all runs of the tests.

    Without Python 3.12 the test is skipped, and fails where CI is set.
    """
    python = _python312()
    if python is None:
        lacks("Python 3.12, for which rclpy's wheels are,")
    rclpy, prefix = DISTRIBUTIONS[distribution]
    wanted = ["--editable", str(ROOT), rclpy, *(prefix + name for name in MESSAGES)]
    made = ROOT / ".environments" / f"ros2-{distribution}"

    def install() -> None:
        run(python, "-m", "venv", str(made))
        run(str(made / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted)

    return made_once(made, "\n".join([*wanted, (ROOT / "pyproject.toml").read_text("utf-8")]), install) / "bin"


def lacks(what: str) -> NoReturn:
    """Skip the test, which needs what is not here; fail where CI is set."""
    (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{what} is not here")


def made_once(folder: Path, text: str, make: Callable[[], None]) -> Path:
    """The folder, emptied and made anew unless it was made from this text. One process makes it, and others wait."""
    folder.parent.mkdir(exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        installed = folder / ".installed"
        if not installed.exists() or installed.read_text("utf-8") != text:
            shutil.rmtree(folder, ignore_errors=True)
            make()
            installed.write_text(text, "utf-8")
    return folder


def run(*words: str) -> None:
    """Run a program that must succeed."""
    result = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S)
    assert result.returncode == 0, result.stdout + result.stderr


@contextmanager
def free_domain() -> Iterator[int]:
    """A domain that no other process of these tests uses meanwhile: a name of a socket stands for each."""
    for domain in range(1, 100):
        with socket.socket(socket.AF_UNIX) as lock:
            try:
                lock.bind(f"\0slidectl-test-ros-domain-{domain}")
            except OSError:
                continue
            yield domain
            return
    pytest.fail("no domain of ROS 2 is free")
