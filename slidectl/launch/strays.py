"""What the programs of a launch leave behind in sessions of their own: adopted when their parents end, ended at last.

The kernel does the adopting, on Linux alone. Knows nothing of launch files.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_PR_SET_CHILD_SUBREAPER = 36
_LOOK_EVERY_S = 0.01


class Strays:
    """From its making on an orphan below this process becomes its child, and not init's."""

    def __init__(self) -> None:
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
        self._others = set(_children())

    def end(self, seconds: float, hurry: Callable[[], bool], tell: Callable[[int, str], None]) -> None:
        """End every child that has come since: with SIGTERM, after so long with SIGKILL. `tell` gets id and name.

        Those that were started on purpose have ended before.
        """
        deadline = time.monotonic() + seconds
        told: set[int] = set()
        # What even SIGKILL does not end is not ours to wait for.
        while (pids := self._alive()) and time.monotonic() < deadline + seconds:
            is_late = hurry() or time.monotonic() >= deadline
            for pid in pids:
                if pid not in told:
                    tell(pid, _name(pid))
                if pid not in told or is_late:
                    _signal(pid, signal.SIGKILL if is_late else signal.SIGTERM)
                told.add(pid)
            time.sleep(_LOOK_EVERY_S)

    def _alive(self) -> list[int]:
        """Those that live; the dead are buried on the way."""
        return [pid for pid in _children() if pid not in self._others and not _is_buried(pid)]


def _children() -> list[int]:
    pids: list[int] = []
    for task in Path("/proc/self/task").iterdir():
        with suppress(OSError):
            pids += map(int, (task / "children").read_text().split())
    return pids


def _is_buried(pid: int) -> bool:
    try:
        return os.waitpid(pid, os.WNOHANG)[0] == pid
    except ChildProcessError:
        return True


def _signal(pid: int, number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)


def _name(pid: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{pid}/comm").read_text().strip()
    return "?"
