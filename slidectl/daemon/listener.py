"""The socket on which clients knock: bound in a private folder, and opened to processes of the same user only.

Cleans up what a dead daemon left, and never touches what a living one has.
"""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path

from slidectl.client.link import peer
from slidectl.errors import Refused

_BACKLOG = 128


def listen(path: Path) -> socket.socket:
    """A listening socket at `path`. The caller holds the lock of the instance, so what lies there is left over.

    Raises:
        Refused: something else lies there, or somebody answers on it although the lock was free.
    """
    _remove_stale(path)
    listener = socket.socket(socket.AF_UNIX)
    try:
        listener.bind(str(path))
        os.chmod(path, 0o600)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        raise Refused(f"cannot listen on {path}: {error.strerror}") from None
    listener.setblocking(False)
    return listener


def _remove_stale(path: Path) -> None:
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise Refused(f"{path} is there and is no socket", "choose another --socket, or remove it")
    pid = _who_answers(path)
    if pid is not None:
        raise Refused(f"process {pid} answers on {path} without holding its lock", f"end it first: kill {pid}")
    path.unlink()


def _who_answers(path: Path) -> int | None:
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except BlockingIOError:
            return 0  # a full backlog: somebody has it open
        except OSError:
            return None
        return peer(probe)[0]


def refusal(uid: int) -> str | None:
    """Why a process of this user may not come in; None when it may."""
    if uid == os.geteuid():
        return None
    return f"this daemon belongs to uid {os.geteuid()}; processes of uid {uid} may not use it"
