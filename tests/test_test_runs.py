"""Runs of the tests themselves: on a bare machine, in the background of a script, and with a test that hangs."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def run(*words: str, before: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    """`pytest WORDS` in a shell, as `make test` starts it, after the commands `before`."""
    variables = {name: text for name, text in os.environ.items() if not name.startswith(("CI", "PYTEST_"))}
    command = shlex.join([sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *words])
    return subprocess.run(
        ["bash", "-c", f"{before}{command}"],
        cwd=ROOT, env={**variables, **environment}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_the_last_line_names_what_is_not_installed(tmp_path: Path) -> None:
    (tmp_path / "bash").symlink_to("/bin/bash")
    done = run("tests/gateways/websocket/test_websocket_page.py", "tests/test_rotations.py", PATH=str(tmp_path))
    assert done.returncode == 0, done.stdout
    assert "skipped, because it is not installed: Chromium (" in done.stdout
    assert "not installed" not in run("tests/test_rotations.py").stdout


def test_an_interrupt_reaches_what_a_test_starts_in_the_background_of_a_script() -> None:
    tests = "tests/client/test_client_connection.py::test_ctrl_c_ends_a_wait_at_once"
    done = run(tests, "tests/launch/test_launch_supervision.py", before="trap '' INT QUIT HUP; ")
    assert done.returncode == 0, done.stdout


def test_a_test_that_hangs_is_ended(tmp_path: Path) -> None:
    (tmp_path / "test_hanging.py").write_text(
        "import subprocess\n\ndef test_hangs():\n    subprocess.run(['sleep', '600'])\n\ndef test_next():\n    pass\n"
    )
    done = run(str(tmp_path), "--timeout", "1", "-c", str(ROOT / "pyproject.toml"))
    assert done.returncode == 1
    assert "Failed: Timeout" in done.stdout
    assert "1 failed, 1 passed" in done.stdout
