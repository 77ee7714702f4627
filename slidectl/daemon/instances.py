"""The daemons of this user that run, and what each says about itself."""

from __future__ import annotations

import os
import stat
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slidectl import paths
from slidectl.client import Client
from slidectl.daemon import lifecycle
from slidectl.errors import SlidectlError

if TYPE_CHECKING:
    from slidectl.msgs.typed import StatusResponseMsg

_AT_A_TIME = 32
"""Daemons that are asked at the same time: one that does not answer takes the whole wait of its thread."""


@dataclass(frozen=True)
class ListedDaemon:
    """A daemon's process that runs, and its answer."""

    paths: paths.InstancePaths
    pid: int | None
    """None when the process is in another pid namespace."""
    since: float | None
    """When it started, in s of the wall clock since 1970."""
    status: StatusResponseMsg | None = None
    """None when it did not answer."""
    trouble: str = ""
    """Why it did not answer."""


def running_daemons(chosen: paths.InstancePaths, timeout_s: float) -> list[ListedDaemon]:
    """All daemons of this user, by instance, and that of `chosen` if it has a named socket.

    A daemon runs when its lock is held: files of one that was killed are none. All are asked at the same time; one
    that has not answered after `timeout_s` of wall time is listed with the reason.
    """
    places = [*paths.instances(), *([chosen] if chosen.prefix else [])]
    running = [(place, pid) for place in places if (pid := _pid(place)) is not None]
    with ThreadPoolExecutor(_AT_A_TIME) as threads:
        return list(threads.map(lambda one: _asked(one[0], one[1], timeout_s), running))


def _pid(place: paths.InstancePaths) -> int | None:
    """The process that holds the lock; None when nobody does, or the lock is not a file of this user."""
    return lifecycle.running(place) if paths.is_ours(place.lock, stat.S_IFREG) else None


def _asked(place: paths.InstancePaths, pid: int, timeout_s: float) -> ListedDaemon:
    try:
        # The daemon writes the lock once, when it starts.
        since = os.lstat(place.lock).st_mtime
    except OSError:  # it ends right now
        since = None
    status: StatusResponseMsg | None = None
    trouble = ""
    try:
        with Client(socket=place.socket_text, timeout=timeout_s) as client:
            status = client.call("/slidectl/status")
    except SlidectlError as error:
        trouble = error.message
    return ListedDaemon(place, pid or None, since, status, trouble)
