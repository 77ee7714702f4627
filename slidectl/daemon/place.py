"""The files by which a daemon is found: its folder, its lock, its socket. Taken, looked after, and given back.

The lock says that a daemon lives: the kernel takes it back when the process ends, however it ends. It is a POSIX record
lock, because F_GETLK names the holder without disturbing anybody. The lock file must not be opened elsewhere in the
process that holds the lock: closing it there would let the lock go.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import stat
import struct
import sys
from contextlib import suppress
from pathlib import Path

from slidectl.client.link import peer
from slidectl.errors import Refused
from slidectl.paths import InstancePaths, make_private

# struct flock of a 64-bit Linux: type, whence, start, length, pid. Elsewhere it is laid out in other ways, and the
# answers would be nonsense.
assert sys.maxsize > 1 << 32, "slidectl needs a 64-bit Linux"
_FLOCK = struct.Struct("hhqqi4x")
_HELD = (errno.EAGAIN, errno.EACCES)
"""errno values that mean another process holds the lock."""
_BACKLOG = 128


class TakenOver(Refused):
    """Another daemon has this place."""


def holder(path: Path) -> int | None:
    """Process id of the daemon that holds the lock, or None. It is 0 when that is in another pid namespace.

    Raises:
        Refused: the file is there and cannot be asked.
    """
    try:
        with open(path, "rb+", buffering=0) as file:
            question = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
            kind, _, _, _, pid = _FLOCK.unpack(fcntl.fcntl(file, fcntl.F_GETLK, question))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise _lock_failed("ask", path, error) from None
    return None if kind == fcntl.F_UNLCK else max(0, pid)


def _lock(path: Path) -> int | None:
    """The descriptor of the locked file; None when another process has the lock. Raises Refused: no lock can be had."""
    while True:
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise _lock_failed("make", path, error) from None
        try:
            fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(fd)
            if error.errno in _HELD:
                return None
            raise _lock_failed("take", path, error) from None
        if _is_at(path, os.fstat(fd)):
            break
        os.close(fd)  # its last owner removed the file between our open and our lock
    # For people who look into the folder. The kernel knows better, so a full disk is no reason to give up.
    with suppress(OSError):
        os.ftruncate(fd, 0)
        os.write(fd, f"{os.getpid()}\n".encode())
    return fd


def _lock_failed(what: str, path: Path, error: OSError) -> Refused:
    hint = "is it on a file system that knows locks? XDG_RUNTIME_DIR or --socket name another place"
    return Refused(f"cannot {what} the lock {path}: {error.strerror or error}", hint)


def _is_at(path: Path, file: os.stat_result | None) -> bool:
    """True when the file is the one that others find at the path."""
    try:
        return file is not None and os.path.samestat(file, os.lstat(path))
    except OSError:
        return False


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
        fd = _lock(self._paths.lock)
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

    def mend(self) -> tuple[list[str], socket.socket | None]:
        """Make again what has been deleted, as cleaners of temporary folders do: nobody would find the daemon else.

        Returns:
            What was gone, and the socket when there is a new one.

        Raises:
            TakenOver: another daemon is there. SlidectlError: it cannot be made again.
        """
        gone: list[str] = []
        if self._lock_fd is None or not _is_at(self._paths.lock, os.fstat(self._lock_fd)):
            gone.append("its lock" if self._paths.folder.is_dir() else "its folder")
            if not self.take():
                raise TakenOver(f"another daemon (process {holder(self._paths.lock)}) has taken this place")
        if _is_at(self._paths.socket, self._socket_file):
            return gone, None
        gone.append("its socket")
        return gone, self.listen()

    def give_back(self) -> None:
        """Remove what is ours, and nothing that another daemon has put there."""
        if self._listener is not None:
            self._listener.close()
        with suppress(OSError):
            if _is_at(self._paths.socket, self._socket_file):
                self._paths.socket.unlink()
            if self._lock_fd is not None and _is_at(self._paths.lock, os.fstat(self._lock_fd)):
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
