"""The examples run from start to end, and leave nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from daemon_fixture import Runtime

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.parametrize("name", ["slide.sh", "rrbot.sh", "two_robots.sh", "demo.py"])
def test_an_example_runs_and_leaves_nothing_behind(tmp_path: Path, name: str) -> None:
    folders = {"XDG_RUNTIME_DIR": tmp_path / "run", "TMPDIR": tmp_path / "tmp"}
    for folder in folders.values():
        folder.mkdir(mode=0o700)
    bin_first = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash" if name.endswith(".sh") else sys.executable, EXAMPLES / name],
        cwd=EXAMPLES.parent,
        env={**Runtime(tmp_path).env, **folders, "PATH": bin_first, "RTF": "max"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert [list(folder.iterdir()) for folder in folders.values()] == [[], []]
