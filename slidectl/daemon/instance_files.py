"""The files by which clients find a daemon: its folder, its lock, its socket. Created, repaired and removed here."""

from __future__ import annotations

import os
import socket
import stat
from contextlib import suppress
from pathlib import Path

from slidectl.errors import Refused
from slidectl.operating_system import peer
from slidectl.paths import InstancePaths, make_private
from slidectl.processes import holder, is_at, lock

_BACKLOG = 128


class InstanceInUse(Refused):
    """Another daemon uses this place."""


class InstanceFiles:
    """The files of one daemon, from `acquire` to `release`."""

    def __init__(self, paths: InstancePaths) -> None:
        self._paths = paths
        self._lock_fd: int | None = None
        self._listener: socket.socket | None = None
        self._socket_file: os.stat_result | None = None

    def acquire(self) -> bool:
        """Create the folder and take the lock. False when another daemon holds it. Raises SlidectlError."""
        make_private(self._paths.folder)
        fd = lock(self._paths.lock)
        if fd is None:
            return False
        self._unlock()
        self._lock_fd = fd
        return True

    def listen(self) -> socket.socket:
        """A listening socket, open to this user alone. An old socket is removed, as the holder of the lock may do.

        Raises:
            Refused: another file is there, or a process answers on it although the lock was free.
        """
        path = self._paths.socket
        _remove_old(path)
        listener = socket.socket(socket.AF_UNIX)
        try:
            listener.bind(str(path))
            os.chmod(path, 0o600)
            listener.listen(_BACKLOG)
            self._socket_file = os.lstat(path)
        except OSError as error:
            listener.close()
            raise Refused(f"cannot listen on {path}: {error.strerror}") from None
        listener.setblocking(False)
        self._listener = listener
        return listener

    def repair(self) -> tuple[list[str], socket.socket | None]:
        """Create deleted files again (cleaners of temporary folders delete them), so that clients find the daemon.

        Returns:
            The names of deleted files, and the new socket if any.

        Raises:
            InstanceInUse: another daemon is there. SlidectlError: a file cannot be created.
        """
        gone: list[str] = []
        if self._lock_fd is None or not is_at(self._paths.lock, os.fstat(self._lock_fd)):
            gone.append("its lock" if self._paths.folder.is_dir() else "its folder")
            if not self.acquire():
                raise InstanceInUse(f"another daemon (process {holder(self._paths.lock)}) has taken this place")
        if is_at(self._paths.socket, self._socket_file):
            return gone, None
        gone.append("its socket")
        return gone, self.listen()

    def release(self) -> None:
        """Remove our files, but none that another daemon has created there."""
        if self._listener is not None:
            self._listener.close()
        with suppress(OSError):
            if is_at(self._paths.socket, self._socket_file):
                self._paths.socket.unlink()
            if self._lock_fd is not None and is_at(self._paths.lock, os.fstat(self._lock_fd)):
                self._paths.lock.unlink()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock_fd is not None:
            os.close(self._lock_fd)
        self._lock_fd = None


def _remove_old(path: Path) -> None:
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise Refused(f"{path} exists and is not a socket", "choose another --socket, or remove it")
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
            pid = peer(probe)[0]
        except BlockingIOError:
            pid = 0  # a full backlog: a process has it open
        except OSError:
            path.unlink()
            return
    who, way = (f"process {pid}", f"kill {pid}") if pid else ("a process", f"lsof {path} names it")
    raise Refused(f"{who} answers on {path} without holding its lock", f"end it first: {way}")
