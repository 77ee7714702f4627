"""A daemon in a folder of its own: started as a real process, reached as any client would, gone at the end.

with running_daemon(rtf=math.inf) as daemon:
    daemon.client().call("/slidectl/status")
    subprocess.run([..., "topic", "list"], env=daemon.env)
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from slidectl import paths
from slidectl.client import Client
from slidectl.daemon import lifecycle
from slidectl.daemon.options import DaemonOptions
from slidectl.operating_system import LINUX, PORTABLE
from slidectl.processes import holder
from slidectl.wire.json_lines import encode

ROOT = Path(__file__).parent.parent


def send(client: Client, **operation: Any) -> None:
    """Send an operation as it is given, for what no method of the client sends."""
    client._send_line(encode(operation))


def shown(page: str, text: str) -> list[list[str]]:
    """The words of each line of the block of a page in docs/ that has this text."""
    blocks = re.findall(r"^```\w+\n(.*?)^```", (ROOT / "docs" / page).read_text("utf-8"), re.MULTILINE | re.DOTALL)
    [block] = [block for block in blocks if text in block]
    return [shlex.split(line, comments=True) for line in block.splitlines()]


knows_peers = pytest.mark.skipif(not LINUX, reason="the kernel does not tell whose a connection is")
"""Marks a test that asks the kernel for the process or the user at the other end of a Unix socket."""


def clean_environment() -> dict[str, str]:
    """This process's environment without the settings of a user's slidectl, with the package on the path."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("SLIDECTL_") or key == PORTABLE}
    return {**kept, "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))}


class Runtime:
    """A private XDG_RUNTIME_DIR with one instance in it. The folder's path is short: socket paths are limited."""

    def __init__(self, folder: Path | None = None, name: str = paths.DEFAULT_INSTANCE) -> None:
        self.folder = folder or Path(tempfile.mkdtemp(prefix="slidectl-", dir="/tmp"))
        self.env = {**clean_environment(), "XDG_RUNTIME_DIR": str(self.folder)}
        with self.environment():
            self.paths = paths.instance(name)

    @contextmanager
    def environment(self) -> Iterator[None]:
        """Inside, this process sees what a command started with `env` would see."""
        with mock.patch.dict(os.environ, self.env, clear=True):
            yield

    def start(self, **options: Any) -> tuple[int, bool]:
        """lifecycle.start with these DaemonOptions."""
        with self.environment():
            return lifecycle.start(self.paths, DaemonOptions(**options))

    def stop(self) -> int | None:
        """lifecycle.stop."""
        with self.environment():
            return lifecycle.stop(self.paths)

    @property
    def pid(self) -> int | None:
        """Process id of the daemon that lives here."""
        return lifecycle.running(self.paths)

    @property
    def log(self) -> str:
        """The text of the daemon's log."""
        return self.paths.log.read_text(encoding="utf-8")

    def client(self, timeout: float = 20.0) -> Client:
        """A connection to the daemon; the caller closes it."""
        with self.environment():
            return Client(self.paths.folder.name, timeout=timeout)

    def remove(self) -> None:
        """End whatever runs here and remove the folder."""
        for lock in self.folder.glob("slidectl/*/*lock"):
            _end(lock)
        shutil.rmtree(self.folder, ignore_errors=True)


def _end(lock: Path) -> None:
    pid = holder(lock)
    if not pid:
        return
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    with suppress(ChildProcessError):
        os.waitpid(pid, 0)


@contextmanager
def running_daemon(**options: Any) -> Iterator[Runtime]:
    """A daemon of its own, started with these DaemonOptions, and stopped and cleaned up at the end."""
    runtime = Runtime()
    try:
        runtime.start(**options)
        yield runtime
        runtime.stop()
    finally:
        runtime.remove()
