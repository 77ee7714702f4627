"""Ctrl-C in the first and the last moments of a command: exit code 130, and never a traceback."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import slidectl

ROOT = str(Path(slidectl.__file__).parent.parent)


def test_the_command_line_is_ready_for_an_interrupt_before_anything_large_is_imported() -> None:
    text = f"import sys; sys.path.insert(0, {ROOT!r}); import slidectl.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", text], capture_output=True, text=True, check=True)
    assert not {"typing", "re", "enum", "click", "signal"} & set(done.stdout.split())
