"""Launches that went on in the background: each keeps its log locked, and whoever stops the daemon waits for them.

They end by themselves when their daemon does, but their nodes may take their time. No launch is looked into here.
"""

from __future__ import annotations

import fcntl
import os
import select
import time
from collections.abc import Callable
from pathlib import Path

from slidectl.errors import TimedOut
from slidectl.paths import InstancePaths

LIMIT_S = 30.0
"""Longer than a launch gives its nodes before it kills them."""
_QUIET_S = 0.5
_LOOK_EVERY_S = 0.02


def log_of(paths: InstancePaths, pid: int) -> Path:
    """Where a launch that this process begins writes when it goes on in the background."""
    return paths.folder / f"{paths.prefix}launch-{pid}.log"


def hold(log: int) -> None:
    """Lock the log that is open there until this process ends: no program that it starts inherits the open file."""
    fcntl.flock(log, fcntl.LOCK_EX)


def wait(paths: InstancePaths, limit_s: float, say: Callable[[str], None]) -> None:
    """Until the detached launches of a daemon that has ended have ended their nodes. Raises TimedOut."""
    began = time.monotonic()
    told = False
    for log in sorted(paths.folder.glob(f"{paths.prefix}launch-*.log")):
        while _is_held(log):
            waited_s = time.monotonic() - began
            if waited_s > limit_s:
                raise TimedOut(f"a detached launch has not ended its nodes within {limit_s:g} s", f"see: {log}")
            if waited_s > _QUIET_S and not told:
                told = True
                say(f"waiting until a detached launch has ended its nodes: {log}")
            select.select([], [], [], _LOOK_EVERY_S)


def _is_held(log: Path) -> bool:
    try:
        fd = os.open(log, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(fd)
    return False
