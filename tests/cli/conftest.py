"""The command line in a private runtime folder, with or without a scripted daemon."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon
from fake_daemon import FakeDaemon


@pytest.fixture
def slidectl(tmp_path: Path) -> CommandLine:
    """The command line in a runtime folder of its own: no daemon answers there."""
    return CommandLine(tmp_path)


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeDaemon]:
    """A scripted daemon on the default instance of `slidectl`."""
    daemon = FakeDaemon(tmp_path)
    yield daemon
    daemon.close()


@pytest.fixture(scope="module")
def world() -> Iterator[CommandLine]:
    """The command line with a real daemon of its own, which is paused: time passes only by `sim step`."""
    with running_daemon(paused=True) as runtime:
        yield CommandLine(runtime.folder)
