"""The folder in which compiled code is kept between runs: what goes in, what comes out, and what is thrown away.

It is machine code, so only a whole file that nobody but the user could have written is taken: what a crash of the
machine or a full disk left of one would end the process without a word. Knows no compiler.
"""

from __future__ import annotations

import hashlib
import os
import stat
from contextlib import suppress
from pathlib import Path

from slidectl.writing import replace

KEPT = 8
"""Files that stay: those that were used last. Each version of anything that the code is made from has its own."""
_SEAL_BYTES = 32
_FOREIGN_WRITERS = stat.S_IWGRP | stat.S_IWOTH


class NotOurs(PermissionError):
    """A file or folder that somebody else could have written."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} belongs to somebody else, or others may write to it; move it away or chmod go-w it")


class Damaged(FileNotFoundError):
    """A file that is not what was written. It has been removed, so that it is made anew."""


def folder() -> Path:
    """Where the code is kept, below XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return Path(base if os.path.isabs(base) else os.path.expanduser("~/.cache")) / "slidectl"


def prepare() -> None:
    """See to it that the folder is there. Raises OSError: it cannot be made; NotOurs."""
    if not folder().is_absolute():
        raise FileNotFoundError("there is no home folder, and XDG_CACHE_HOME names none")
    folder().mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _is_ours(folder().stat()):
        raise NotOurs(folder())


def holds(path: Path) -> bool:
    """True when the file is there and may be trusted."""
    try:
        found = os.lstat(path)
        is_ours = _is_ours(found) and _is_ours(path.parent.stat())
        return is_ours and stat.S_ISREG(found.st_mode) and path.is_absolute()
    except OSError:
        return False


def read(path: Path) -> bytes:
    """The file's content; it counts as used now. Raises OSError: not there; NotOurs; Damaged."""
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC), "rb") as file:
        if not (_is_ours(os.fstat(file.fileno())) and _is_ours(path.parent.stat())):
            raise NotOurs(path)
        with suppress(OSError):  # a file system that can only be read
            os.utime(path)
        seal, content = file.read(_SEAL_BYTES), file.read()
    if seal != _seal(content):
        path.unlink(missing_ok=True)
        raise Damaged(path)
    return content


def write(path: Path, content: bytes) -> None:
    """Put the file there, at once or not at all. Raises OSError, also when the folder has gone meanwhile."""
    replace(path, _seal(content) + content, 0o600)


def _seal(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def tidy() -> None:
    """Throw away what was not used for longest, and drafts of those who ended before they were done.

    For whoever has the folder's lock; others may read meanwhile, and find a file gone.
    """
    for draft in folder().glob("*.o.*"):
        draft.unlink(missing_ok=True)
    by_use = sorted(folder().glob("*.o"), key=_last_use, reverse=True)
    for old in by_use[KEPT:]:
        old.unlink(missing_ok=True)


def _last_use(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _is_ours(found: os.stat_result) -> bool:
    return found.st_uid == os.geteuid() and not found.st_mode & _FOREIGN_WRITERS
