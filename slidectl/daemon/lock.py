"""The sign of life of a daemon: a lock on a file that the kernel takes back when the process ends, however it ends.

POSIX record locks, because they can be asked about (F_GETLK names the holder) without disturbing anybody. The file
must not be opened elsewhere in the process that holds the lock: closing it there would let the lock go.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import sys
from contextlib import suppress
from pathlib import Path

from slidectl.errors import Refused

# struct flock of a 64-bit Linux: type, whence, start, length, pid. Elsewhere it is laid out in other ways, and the
# answers would be nonsense.
assert sys.maxsize > 1 << 32, "slidectl needs a 64-bit Linux"
_FLOCK = struct.Struct("hhqqi4x")
_HELD = (errno.EAGAIN, errno.EACCES)
"""What POSIX lets a lock that somebody else has be refused with."""


class LockFailed(Refused):
    """The lock cannot be taken or asked about, whoever may have it."""

    def __init__(self, what: str, path: Path, error: OSError) -> None:
        hint = "is it on a file system that knows locks? XDG_RUNTIME_DIR or --socket name another place"
        super().__init__(f"cannot {what} the lock {path}: {error.strerror or error}", hint)


def holder(path: Path) -> int | None:
    """Process id of the daemon that lives there, or None. It is 0 when that is in another pid namespace.

    Raises:
        LockFailed: the file is there and cannot be asked.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise LockFailed("ask", path, error) from None
    try:
        question = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
        kind, _, _, _, pid = _FLOCK.unpack(fcntl.fcntl(fd, fcntl.F_GETLK, question))
    except OSError as error:
        raise LockFailed("ask", path, error) from None
    finally:
        os.close(fd)
    return None if kind == fcntl.F_UNLCK else max(0, pid)


class InstanceLock:
    """The lock of an instance, from `acquire` to `release`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._fd = -1

    def acquire(self) -> bool:
        """Take the lock if it is free. False when another process has it.

        Raises:
            LockFailed: no lock can be had there, held or not.
        """
        while True:
            try:
                fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            except OSError as error:
                raise LockFailed("make", self._path, error) from None
            try:
                fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                os.close(fd)
                if error.errno in _HELD:
                    return False
                raise LockFailed("take", self._path, error) from None
            if self._is_current(fd):
                break
            os.close(fd)  # its last owner removed the file between our open and our lock
        self._fd = fd
        self._note_pid()
        return True

    def _is_current(self, fd: int) -> bool:
        try:
            return os.path.samestat(os.fstat(fd), os.stat(self._path))
        except OSError:
            return False

    def _note_pid(self) -> None:
        # For people who look into the folder. The kernel knows better, so a full disk is no reason to give up.
        with suppress(OSError):
            os.ftruncate(self._fd, 0)
            os.write(self._fd, f"{os.getpid()}\n".encode())

    def is_current(self) -> bool:
        """True while the file that is locked is the one that others find."""
        return self._fd >= 0 and self._is_current(self._fd)

    def release(self) -> None:
        """Remove the file while it is still ours, then let go. Harmless when it was not acquired."""
        if self.is_current():
            with suppress(FileNotFoundError):
                os.unlink(self._path)
        self.forget()

    def forget(self) -> None:
        """Let go of a lock whose file has gone."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
