"""What one instance leaves on a machine, or all of slidectl: instances' folders, compiled code, the shell's history.

A folder is ours by its name and its owner; symbolic links are never followed. Files in use by a running daemon or
gateway stay.
"""

from __future__ import annotations

import shutil
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from slidectl import paths
from slidectl.processes import holder
from slidectl.simulation.compiled import object_file


class Leftover(NamedTuple):
    """One file or folder that exists. `pid` is the running daemon or gateway that uses it, None without one."""

    path: Path
    what: str
    size: int
    """Size in bytes."""
    pid: int | None = None


def of_instance(chosen: paths.InstancePaths) -> list[Leftover]:
    """What one instance has left: its folder, or the files beside its named socket.

    Raises:
        Refused: it cannot be determined whether a daemon runs there.
    """
    if not chosen.prefix:
        return _instance(chosen.folder)
    # Not `prefix*lock`: socket `s` must not take the lock of a socket `s.x` for one of its own.
    pid = _user_of((chosen.lock, chosen.page, *chosen.folder.glob(f"{chosen.prefix}gateway-*.lock")))
    kinds = ("lock", "page.lock", "log", "log.*", "gateway-*", "launch-*.log", "recording-*.log", "playing-*.log")
    files = [*(file for kind in kinds for file in chosen.folder.glob(chosen.prefix + kind)), chosen.socket]
    what = f"socket {chosen.socket.name}"
    ours = [path for path in files if paths.is_ours(path, stat.S_IFREG, stat.S_IFSOCK)]
    return [Leftover(path, what, _size(path), pid) for path in ours]


def of_all(history: Path, chosen: paths.InstancePaths) -> list[Leftover]:
    """What slidectl has left: compiled code, `history` of the shell, all instances, and `chosen` by its socket.

    Raises:
        Refused: it cannot be determined whether a daemon runs there.
    """
    found = _folder(object_file.folder(), "compiled code") + _folder(history.parent, "history of the shell")
    for folder in map(Path, paths.runtime_folders()):
        inside = sorted(folder.iterdir()) if paths.is_ours(folder) else []
        instances = [one for path in inside for one in _instance(path)]
        found += instances or _folder(folder, "folder of the instances")
    return found + (of_instance(chosen) if chosen.prefix else [])


def remove(leftover: Leftover) -> None:
    """Remove it. Raises OSError: it cannot be removed."""
    if not paths.is_ours(leftover.path):
        leftover.path.unlink()
        return
    shutil.rmtree(leftover.path)
    with suppress(OSError):  # with the last instance, remove the common folder too
        if leftover.path.parent.name.startswith("slidectl"):
            leftover.path.parent.rmdir()


def _instance(path: Path) -> list[Leftover]:
    return _folder(path, f"instance {path.name}", path.glob("*lock"))


def _folder(path: Path, what: str, locks: Iterable[Path] = ()) -> list[Leftover]:
    return [Leftover(path, what, _size(path), _user_of(locks))] if paths.is_ours(path) else []


def _user_of(locks: Iterable[Path]) -> int | None:
    """The process id of a daemon or a gateway that holds one of the locks."""
    return next((pid for lock in locks if (pid := holder(lock)) is not None), None)


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.lstat().st_size for file in files if file.is_file() and not file.is_symlink())
