"""Background processes: find the process that holds a lock, start a process, and end it with its parent.

A held lock means that its process is alive: the kernel releases it when the process ends, in whatever way. It is a
POSIX record lock, because F_GETLK names the holder without side effects. The lock file must not be opened elsewhere in
the process that holds the lock: closing it there would release the lock.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import sys
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from slidectl.errors import Refused
from slidectl.operating_system import lock_holder
from slidectl.paths import with_package

if TYPE_CHECKING:
    import subprocess
    from pathlib import Path

assert sys.maxsize > 1 << 32, "slidectl needs a 64-bit system"
_HELD = (errno.EAGAIN, errno.EACCES)
"""errno values that mean another process holds the lock."""
_LAST_LINES = 8


def holder(path: Path) -> int | None:
    """The id of the process that holds the lock, or None; 0 when that process is in another pid namespace.

    Raises:
        Refused: the file exists and cannot be asked.
    """
    try:
        if not stat.S_ISREG(os.lstat(path).st_mode):
            return None  # a link, a FIFO or a device is nobody's lock
        with open(path, "rb+", buffering=0) as file:
            pid = lock_holder(file)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise _lock_failed("check", path, error) from None
    return None if pid is None else max(0, pid)


class Listening(NamedTuple):
    """A process that holds a lock, and the address that it has written behind its process id; empty at its start."""

    pid: int
    address: str


def listening(path: Path) -> Listening | None:
    """The process that holds the lock, with the address where it listens, or None. Raises Refused as `holder`."""
    pid = holder(path)
    if pid is None:
        return None
    try:
        _, _, address = path.read_text(encoding="utf-8").partition("\n")
    except OSError:  # the process ends right now
        address = ""
    return Listening(pid, address)


def lock(path: Path) -> int | None:
    """Lock the file and write our process id into it. Returns its descriptor; None when another process has the lock.

    Raises:
        Refused: the file cannot be made or locked.
    """
    while True:
        try:
            # Without links, against: a second user, who has put one into a folder that others can write.
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise _lock_failed("create", path, error) from None
        try:
            fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(fd)
            if error.errno in _HELD:
                return None
            raise _lock_failed("acquire", path, error) from None
        if is_at(path, os.fstat(fd)):
            break
        os.close(fd)  # its last owner removed the file after our open and before our lock
    # The text is for people who look into the folder. The kernel has the lock in any case, so a full disk is no error.
    with suppress(OSError):
        os.ftruncate(fd, 0)
        os.write(fd, f"{os.getpid()}\n".encode())
    return fd


def _lock_failed(what: str, path: Path, error: OSError) -> Refused:
    hint = "is it on a file system that knows locks? XDG_RUNTIME_DIR or --socket name another place"
    return Refused(f"cannot {what} the lock {path}: {error.strerror or error}", hint)


def is_at(path: Path, file: os.stat_result | None) -> bool:
    """True when the path still leads to this file."""
    try:
        return file is not None and os.path.samestat(file, os.lstat(path))
    except OSError:
        return False


def command_of(module: str, *arguments: str) -> list[str]:
    """The command line that runs a module of the package."""
    # -P: a user's file with the name of a library must not be imported instead of it.
    return [sys.executable, "-P", "-m", module, *arguments]


def start(command: list[str], output: IO[bytes], **more: Any) -> subprocess.Popen[bytes]:
    """Start a program in the background, in its own session. It prints into `output`; `more` are options of Popen."""
    import subprocess

    environment = with_package(os.environ)
    return subprocess.Popen(command, env=environment, stdout=output, stderr=output, start_new_session=True, **more)


def opened_log(path: Path) -> IO[bytes]:
    """Open the log for appending, private to the user; the null device when it cannot be written."""
    try:
        return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "wb")
    except OSError:
        return open(os.devnull, "wb")


def last_lines(log: Path, after: int) -> str:
    """The last lines of what was written to a log after its first `after` bytes."""
    try:
        text = log.read_bytes()[after:].decode("utf-8", "replace")
    except OSError:
        text = ""
    return "\n".join(text.splitlines()[-_LAST_LINES:]) or f"its log {log} is empty"
