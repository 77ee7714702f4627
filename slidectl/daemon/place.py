"""The files by which a daemon is found: its folder, its lock, its socket. Taken, looked after, and given back.

Cleaners of temporary folders delete them under a daemon that lives; nobody would find it then, and another one would
start beside it.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress

from slidectl.daemon.listener import listen
from slidectl.daemon.lock import InstanceLock, holder
from slidectl.errors import Refused, SlidectlError
from slidectl.paths import InstancePaths, make_private


class TakenOver(Refused):
    """Another daemon has this place."""

    def __init__(self, pid: int | None) -> None:
        super().__init__(f"another daemon (process {pid}) has taken this place")


class Place:
    """The place of one daemon, from `take` to `give_back`."""

    def __init__(self, paths: InstancePaths) -> None:
        self._paths = paths
        self._lock = InstanceLock(paths.lock)
        self._listener: socket.socket | None = None
        self._socket_file: os.stat_result | None = None

    def take(self) -> bool:
        """Make the folder and take the lock. False when another daemon has it. Raises SlidectlError."""
        make_private(self._paths.folder)
        return self._lock.acquire()

    def listen(self) -> socket.socket:
        """A listening socket, found under its name. Raises Refused."""
        self._listener = listen(self._paths.socket)
        self._socket_file = os.lstat(self._paths.socket)
        return self._listener

    def mend(self) -> tuple[list[str], socket.socket | None]:
        """Make again what has gone. Returns what that was, and the socket when there is another one now.

        Raises:
            TakenOver: another daemon is there. SlidectlError: it cannot be made again.
        """
        gone: list[str] = []
        if not self._lock.is_current():
            gone.append("its lock" if self._paths.folder.is_dir() else "its folder")
            make_private(self._paths.folder)
            lock = InstanceLock(self._paths.lock)
            if not lock.acquire():
                raise TakenOver(holder(self._paths.lock))
            self._lock.forget()
            self._lock = lock
        if self._has_socket():
            return gone, None
        gone.append("its socket")
        return gone, self.listen()

    def _has_socket(self) -> bool:
        try:
            found = os.lstat(self._paths.socket)
        except OSError:
            return False
        return self._socket_file is not None and os.path.samestat(found, self._socket_file)

    def give_back(self) -> None:
        """Remove what is ours, and nothing that another daemon has put there."""
        if self._listener is not None:
            self._listener.close()
        if self._socket_file is not None and self._has_socket():
            with suppress(OSError):
                self._paths.socket.unlink()
        with suppress(SlidectlError):
            self._lock.release()
