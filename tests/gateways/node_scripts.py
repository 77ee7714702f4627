"""Scripts of Node with the real clients of npm: roslib, ws, @foxglove/ws-protocol.

They stand in `js/` beside their package.json; `npm ci` installs there, once for all tests that run at the same time.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "js"
LIMIT_S = 300


def modules() -> Path:
    """`js/node_modules` as package-lock.json says. Without npm the test is skipped, and fails where CI is set."""
    if shutil.which("npm") is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)("npm is not installed")
    folder, lock = FOLDER / "node_modules", (FOLDER / "package-lock.json").read_bytes()
    installed = folder / ".installed"
    with (FOLDER / "package.json").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        if not installed.exists() or installed.read_bytes() != lock:
            command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
            result = subprocess.run(command, cwd=FOLDER, capture_output=True, text=True, timeout=LIMIT_S)
            assert result.returncode == 0, result.stderr
            installed.write_bytes(lock)
    return folder


def run(script: str, *arguments: str, env: Mapping[str, str] | None = None) -> str:
    """What a script of `js/` prints; it must end with 0."""
    modules()
    command = ["node", str(FOLDER / script), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, env={**os.environ, **(env or {})})
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout
