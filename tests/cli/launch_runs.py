"""Launches as a user starts them: real processes in a runtime folder of their own, and what is left of them."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from command_line import CommandLine
from waiting import DEADLINE_S, eventually

RUNS = "everything runs"
RUNS_WITHOUT = "listed below"


class Launched:
    """A `slidectl launch` that runs. Its output is read as it comes, both streams together."""

    def __init__(self, slidectl: CommandLine, *words: str, cwd: Path | None = None, **environment: str) -> None:
        self.process = subprocess.Popen(
            slidectl.argv("launch", *words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**slidectl.environment, **environment},
            cwd=cwd,
        )
        self.pid = self.process.pid
        self._text = b""

    @property
    def text(self) -> str:
        return self._text.decode("utf-8", "replace")

    def until(self, text: str, times: int = 1) -> str:
        """Read until the text has come so many times; all that has come. Fails when the process ends before."""
        self._read_until(lambda: self.text.count(text) >= times, text)
        return self.text

    def until_one_of(self, *texts: str) -> None:
        """Read until one of them has come."""
        self._read_until(lambda: any(text in self.text for text in texts), " or ".join(texts))

    def _read_until(self, condition: Callable[[], bool], what: str) -> None:
        assert self.process.stdout is not None
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            left = deadline - time.monotonic()
            assert left > 0, f"{what!r} did not come:\n{self.text}"
            if not select.select([self.process.stdout], [], [], left)[0]:
                continue
            data = os.read(self.process.stdout.fileno(), 65536)
            assert data, f"it ended without {what!r}:\n{self.text}"
            self._text += data

    def up(self) -> str:
        """Wait until everything runs that there is."""
        self.until_one_of(RUNS, RUNS_WITHOUT)
        return self.text

    def signal(self, number: int = signal.SIGINT) -> None:
        self.process.send_signal(number)

    def end(self, number: int | None = None) -> int:
        """Send a signal if there is one, read all that is left, and return the exit code."""
        if number is not None:
            self.signal(number)
        self._text += self.process.communicate(timeout=DEADLINE_S)[0]
        return self.process.returncode

    def interrupt(self) -> int:
        """Ctrl-C; the exit code."""
        return self.end(signal.SIGINT)


def write_everything(folder: Path) -> str:
    """The launch file of the slider with programs before and after it."""
    package = folder / "demo"
    (package / "scripts").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>demo</name></package>")
    script = package / "scripts" / "live"
    script.write_text("#!/bin/bash\nsleep 600 &\nwait\n")
    script.chmod(0o755)
    path = package / "all.launch"
    path.write_text(
        '<launch><node pkg="demo" type="live" name="first"/><include file="$(find my_slider)/launch/slider.launch"/>'
        '<node pkg="demo" type="live" name="last" respawn="true"/></launch>'
    )
    return str(path)


def processes(runtime: Path) -> list[int]:
    """Ids of all processes with this runtime folder, but for a compiler, which outlives its daemon."""
    mark = f"XDG_RUNTIME_DIR={runtime}\0".encode()
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            is_ours = entry.name.isdigit() and mark in (entry / "environ").read_bytes() + b"\0"
            if is_ours and not _is_dead(entry) and b"compiled.compiler" not in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
    return [pid for pid in found if pid != os.getpid()]


def _is_dead(entry: Path) -> bool:
    return (entry / "stat").read_text().rpartition(")")[2].split()[0] in ("Z", "X")


def nothing_is_left(runtime: Path) -> None:
    """No process and no lock of a daemon."""
    eventually(lambda: not processes(runtime), f"these processes are left: {processes(runtime)}")
    assert not list(runtime.glob("slidectl/*/socket"))


def kill_all(runtime: Path) -> None:
    """End whatever a test has left behind."""
    for pid in processes(runtime):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
