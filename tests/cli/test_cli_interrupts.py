"""Ctrl-C in the first and the last moments of a command: exit code 130, and never a traceback."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import slidectl

ROOT = str(Path(slidectl.__file__).parent.parent)


def command(program: str) -> subprocess.CompletedProcess[str]:
    """A command whose work is this Python text, in the place of the whole command line."""
    text = f"import os, select, signal\nimport slidectl.cli as cli\n{program}\ncli.entry()"
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60, check=False)


def test_the_command_line_is_ready_for_an_interrupt_before_anything_large_is_imported() -> None:
    text = f"import sys; sys.path.insert(0, {ROOT!r}); import slidectl.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", text], capture_output=True, text=True, check=True)
    assert not {"typing", "re", "enum", "click", "signal"} & set(done.stdout.split())


def test_a_second_interrupt_on_the_way_out_changes_nothing() -> None:
    done = command(
        """
def interrupted():
    os.kill(os.getpid(), signal.SIGINT)
    raise AssertionError
again = [interrupted]
ignore = cli._ignore_interrupts
def second():
    if again:
        again.pop()()
    ignore()
cli._run, cli._ignore_interrupts = interrupted, second
"""
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
