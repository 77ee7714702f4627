"""The files by which a daemon is found: its folder, its lock, its socket. Taken, looked after, and given back."""

from __future__ import annotations

import os
import socket
import stat
from contextlib import suppress
from pathlib import Path

from slidectl.client.link import peer
from slidectl.errors import Refused
from slidectl.paths import InstancePaths, make_private
from slidectl.processes import holder, is_at, lock

_BACKLOG = 128


class TakenOver(Refused):
    """Another daemon has this place."""


class Place:
    """The place of one daemon, from `take` to `give_back`."""

    def __init__(self, paths: InstancePaths) -> None:
        self._paths = paths
        self._lock_fd: int | None = None
        self._listener: socket.socket | None = None
        self._socket_file: os.stat_result | None = None

    def take(self) -> bool:
        """Make the folder and take the lock. False when another daemon has it. Raises SlidectlError."""
        make_private(self._paths.folder)
        fd = lock(self._paths.lock)
        if fd is None:
            return False
        self._unlock()
        self._lock_fd = fd
        return True

    def listen(self) -> socket.socket:
        """A listening socket, open to this user alone. Whoever holds the lock may remove a socket that is there.

        Raises:
            Refused: something else is there, or somebody answers on it although the lock was free.
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
        """Make again what has been deleted, as cleaners of temporary folders do: nobody would find the daemon else.

        Returns:
            What was gone, and the socket when there is a new one.

        Raises:
            TakenOver: another daemon is there. SlidectlError: it cannot be made again.
        """
        gone: list[str] = []
        if self._lock_fd is None or not is_at(self._paths.lock, os.fstat(self._lock_fd)):
            gone.append("its lock" if self._paths.folder.is_dir() else "its folder")
            if not self.take():
                raise TakenOver(f"another daemon (process {holder(self._paths.lock)}) has taken this place")
        if is_at(self._paths.socket, self._socket_file):
            return gone, None
        gone.append("its socket")
        return gone, self.listen()

    def give_back(self) -> None:
        """Remove what is ours, and nothing that another daemon has put there."""
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
        raise Refused(f"{path} is there and is no socket", "choose another --socket, or remove it")
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
            pid = peer(probe)[0]
        except BlockingIOError:
            pid = 0  # a full backlog: somebody has it open
        except OSError:
            path.unlink()
            return
    raise Refused(f"process {pid} answers on {path} without holding its lock", f"end it first: kill {pid}")
