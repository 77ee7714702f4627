"""`slidectl replay` shows robots as `slidectl robots` does."""

from __future__ import annotations

from pathlib import Path

from command_line import CommandLine
from daemon_fixture import running_daemon


def test_a_value_that_is_not_there_is_shown_as_robots_shows_it(tmp_path: Path) -> None:
    journal = tmp_path / "run.journal"
    with running_daemon(paused=True, journal=str(journal)) as runtime:
        line = CommandLine(runtime.folder)
        line.ok("spawn", "cartpole")
        line.ok("sim", "step", "2")
        shown = line.ok("robots", "cartpole")
    again = line.ok("replay", str(journal))
    assert "nan" not in again
    assert next(row for row in shown.splitlines() if "continuous" in row) in again
