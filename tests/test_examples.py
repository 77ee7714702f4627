"""The examples run from start to end, and leave nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_fixture import Runtime

EXAMPLES = Path(__file__).parent.parent / "examples"
SCRIPTS = (
    "slide.sh", "rrbot.sh", "two_robots.sh", "gravity.sh", "sine.sh", "trajectory.sh", "cart.sh", "cartpole.sh",
    "car.sh", "wrist.sh", "rospy_slide.sh", "roslibpy.sh", "demo.py",
)  # fmt: skip


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder with a short name: the path of a socket must fit into 107 bytes."""
    with tempfile.TemporaryDirectory(prefix="slidectl-ex-", dir="/tmp") as folder:
        yield Path(folder)


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_runs_and_leaves_nothing_behind(place: Path, name: str) -> None:
    folders = {"XDG_RUNTIME_DIR": place / "run", "TMPDIR": place / "tmp"}
    for folder in folders.values():
        folder.mkdir(mode=0o700)
    bin_first = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash" if name.endswith(".sh") else sys.executable, EXAMPLES / name],
        cwd=EXAMPLES.parent,
        env={**Runtime(place).env, **folders, "PATH": bin_first, "RTF": "max"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert [list(folder.iterdir()) for folder in folders.values()] == [[], []]
