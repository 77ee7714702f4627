"""Launches, recordings and playings in the background. `slidectl daemon stop` waits until they have ended.

Each holds a lock on its log. It ends by itself some time after its daemon.
"""

from __future__ import annotations

import fcntl
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from slidectl.errors import EXIT_DONE, Refused, TimedOut
from slidectl.paths import InstancePaths, make_private
from slidectl.writing import CannotWrite, write_whole

KINDS = ("launch", "recording", "playing")
LIMIT_S = 30.0
"""Longer than a launch waits before it kills its nodes."""
_QUIET_S = 0.5
_LOOK_EVERY_S = 0.02


class Background:
    """A command that goes on in a child process. The parent process waits until everything runs, and exits.

    `what` is one of KINDS.

    Raises:
        Refused: the folder for its log is not private.
    """

    def __init__(self, paths: InstancePaths, what: str) -> None:
        make_private(paths.folder)
        self.what = what
        self.log = str(paths.folder / f"{paths.prefix}{what}-{os.getpid()}.log")
        self._paths = paths
        self._read, self._write = os.pipe()

    def fork(self) -> None:
        """Fork; only the child returns. The parent exits with 0 when everything runs, else with the child's exit code.

        The child leaves the terminal's process group, so that Ctrl-C reaches it only once, through the parent.

        Raises:
            Refused: in the parent, when a signal killed the child.
        """
        from slidectl.supervision import SIGNALS

        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if child == 0:
            os.close(self._read)
            os.setsid()
            return

        def pass_on(number: int, _frame: object) -> None:
            with suppress(ProcessLookupError):
                os.kill(child, number)

        os.close(self._write)
        for number in SIGNALS:
            signal.signal(number, pass_on)
        self._follow(child)

    def _follow(self, child: int) -> NoReturn:
        from slidectl.cli import leave
        from slidectl.paths import command

        if os.read(self._read, 1):
            leave(EXIT_DONE)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code < 0:
            raise Refused(
                f"the {self.what} was ended by {signal.Signals(-code).name} before everything ran",
                "a daemon that was started may still run; stop it with: " + command(self._paths, "daemon stop"),
            )
        leave(code)

    def everything_runs(self) -> None:
        """Let the parent exit, and redirect the child's output into its log."""
        log = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        fcntl.flock(log, fcntl.LOCK_EX)  # held until this process ends: programs that it starts do not inherit the file
        null = os.open(os.devnull, os.O_RDONLY)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for source, target in ((null, 0), (log, 1), (log, 2)):
            os.dup2(source, target)
        os.write(self._write, b"r")
        os.close(self._write)


@contextmanager
def pid_file(path: str | None) -> Iterator[None]:
    """Write the file of `--pid`, and remove it at the end. Raises Refused when it cannot be written."""
    if path is None:
        yield
        return
    try:
        write_whole(path, f"{os.getpid()}\n")
    except OSError as error:
        raise CannotWrite(path, error) from None
    try:
        yield
    finally:
        Path(path).unlink(missing_ok=True)


def wait(paths: InstancePaths, limit_s: float, say: Callable[[str], None]) -> None:
    """Wait for the end of the background launches, recordings and playings of an ended daemon. Raises TimedOut."""
    began = time.monotonic()
    told = False
    for log in sorted(log for what in KINDS for log in paths.folder.glob(f"{paths.prefix}{what}-*.log")):
        while _is_held(log):
            waited_s = time.monotonic() - began
            if waited_s > limit_s:
                raise TimedOut(f"what runs in the background has not ended within {limit_s:g} s", f"see: {log}")
            if waited_s > _QUIET_S and not told:
                told = True
                say(f"waiting for the background process to end: {log}")
            select.select([], [], [], _LOOK_EVERY_S)


def _is_held(log: Path) -> bool:
    try:
        with log.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False
