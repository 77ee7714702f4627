"""The examples of docs/python.md run as they stand, in order, against a daemon."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from daemon_fixture import running_daemon

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_every_example_of_the_python_page_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {}
    with running_daemon(rtf=10.0) as daemon, daemon.environment():
        for found in BLOCK.finditer(page):
            line = page.count("\n", 0, found.start(1))
            exec(compile("\n" * line + found[1], "docs/python.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "/slider ['joint_state_controller', 'joint1_position_controller']" in printed
    assert "nobody subscribes to /nobody/listens: 1 published, none of them received" in printed
    assert "received 1\nreceived 2\n" in printed
