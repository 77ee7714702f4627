"""All that slidectl leaves on a machine, and its removal: compiled code, the shell's history, instances' folders.

A folder counts as ours by its name and its owner; a symbolic link is never followed. What a living daemon uses stays.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from slidectl import paths
from slidectl.daemon.lock import holder
from slidectl.paths import InstancePaths
from slidectl.simulation.compiled import object_file


class Leftover(NamedTuple):
    """One thing that is there. `pid` is the living daemon that uses it, None when nobody does."""

    path: Path
    what: str
    size: int
    """Bytes."""
    pid: int | None = None


def leftovers(history: Path, chosen: InstancePaths) -> list[Leftover]:
    """Everything that is there. `history` is the shell's file; `chosen` the instance of the command line.

    Raises:
        LockFailed: nobody can say whether a daemon lives there.
    """
    found = [*_folder(object_file.folder(), "compiled code"), *_folder(history.parent, "history of the shell")]
    for folder in dict.fromkeys((Path(paths.runtime_folder()), Path(paths.temporary_runtime_folder()))):
        for instance in _subfolders(folder):
            found += _folder(instance, f"instance {instance.name}", _user_of(instance.glob("*lock")))
        if _is_ours(folder) and not any(one.path.parent == folder for one in found):
            found += _folder(folder, "folder of the instances")
    if chosen.prefix:
        pid = _user_of([chosen.lock])
        files = (*chosen.folder.glob(f"{chosen.prefix}l*"), chosen.socket)
        found += [Leftover(path, f"socket {chosen.socket.name}", _size(path), pid) for path in files if _is_own(path)]
    return found


def remove(leftover: Leftover) -> None:
    """Raises OSError: it cannot be removed."""
    if stat.S_ISDIR(os.lstat(leftover.path).st_mode):
        shutil.rmtree(leftover.path)
        with suppress(OSError):  # the last instance takes the folder of all with it
            if leftover.path.parent.name.startswith("slidectl"):
                leftover.path.parent.rmdir()
    else:
        leftover.path.unlink()


def _folder(path: Path, what: str, pid: int | None = None) -> list[Leftover]:
    return [Leftover(path, what, _size(path), pid)] if _is_ours(path) else []


def _subfolders(folder: Path) -> Iterator[Path]:
    if _is_ours(folder):
        yield from (path for path in sorted(folder.iterdir()) if _is_ours(path))


def _user_of(locks: Iterator[Path] | list[Path]) -> int | None:
    """Process id of a daemon that holds one of the locks."""
    return next((pid for lock in locks if (pid := holder(lock)) is not None), None)


def _is_ours(folder: Path) -> bool:
    try:
        info = os.lstat(folder)
    except OSError:
        return False
    return stat.S_ISDIR(info.st_mode) and info.st_uid == os.geteuid()


def _is_own(path: Path) -> bool:
    """True for a file, or a socket, of the user's."""
    try:
        info = os.lstat(path)
    except OSError:
        return False
    return (stat.S_ISREG(info.st_mode) or stat.S_ISSOCK(info.st_mode)) and info.st_uid == os.geteuid()


def _size(path: Path) -> int:
    total = 0
    for below in [path, *path.rglob("*")] if path.is_dir() else [path]:
        with suppress(OSError):
            info = os.lstat(below)
            total += info.st_size if stat.S_ISREG(info.st_mode) else 0
    return total
