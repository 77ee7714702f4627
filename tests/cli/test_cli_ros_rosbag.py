"""`rosbag record`, `info` and `play` as shell functions: ours, whatever stands on the PATH."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine, Done
from daemon_fixture import running_daemon


@pytest.fixture
def line() -> Iterator[CommandLine]:
    with running_daemon(rtf=10.0) as runtime:
        yield CommandLine(runtime.folder)


def typed(line: CommandLine, folder: Path, text: str) -> Done:
    """What a shell with the functions prints; a `rosbag` that fails stands first on its PATH."""
    (folder / "bin").mkdir(exist_ok=True)
    (folder / "bin" / "rosbag").write_text("#!/bin/sh\necho the real one >&2\nexit 77\n")
    (folder / "bin" / "rosbag").chmod(0o755)
    environment = {**line.environment, "PATH": f"{folder}/bin:{os.environ['PATH']}"}
    script = f'eval "$({sys.executable} -m slidectl ros-commands --shell bash)"; {text}'
    return subprocess.run(
        ["bash", "-c", script], cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


def test_what_is_recorded_is_shown_and_played(line: CommandLine, tmp_path: Path) -> None:
    done = typed(line, tmp_path, "rosbag record -O run --duration=0.5 /clock")
    assert (done.returncode, "the real one" in done.stderr) == (0, False)
    assert (tmp_path / "run.bag").exists()
    done = typed(line, tmp_path, "rosbag info run.bag")
    assert "/clock" in done.stdout
    done = typed(line, tmp_path, "rosbag info -y run.bag")
    assert "path: run.bag" in done.stdout
    done = typed(line, tmp_path, "rosbag play -r 2 --clock run.bag --topics /clock")
    assert (done.returncode, "the real one" in done.stderr) == (0, False)


def test_the_prefix_and_the_compression_are_those_of_rosbag(line: CommandLine, tmp_path: Path) -> None:
    assert typed(line, tmp_path, "rosbag record -o walk --lz4 --duration=0.1 /clock").returncode == 0
    [file] = tmp_path.glob("walk_*.bag")
    assert "lz4" in line.ok("bag", "info", str(file))


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        ("record", 1, "You must specify a topic name or else use the '-a' option."),
        ("info", 2, "You must specify at least 1 bag file."),
        ("play", 1, "You must specify at least one bag file to play back."),
        ("record --node=/a /clock", 2, "no such option: --node"),
        ("compress run.bag", 1, "rosbag compress is not available"),
    ],
)
def test_what_cannot_be_done_is_said(line: CommandLine, tmp_path: Path, words: str, code: int, told: str) -> None:
    done = typed(line, tmp_path, f"rosbag {words}")
    assert (done.returncode, told in done.stderr) == (code, True), done.stderr
