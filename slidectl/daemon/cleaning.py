"""All that slidectl leaves on a machine, and its removal: compiled code, the shell's history, instances' folders.

A folder is ours by its name and its owner; symbolic links are never followed. Files in use by a running daemon or
gateway stay.
"""

from __future__ import annotations

import os
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


def leftovers(history: Path, chosen: paths.InstancePaths) -> list[Leftover]:
    """All files and folders. `history` is the shell's file; `chosen` the instance of the command line.

    Raises:
        Refused: it cannot be determined whether a daemon runs there.
    """
    found = _folder(object_file.folder(), "compiled code") + _folder(history.parent, "history of the shell")
    for folder in dict.fromkeys((Path(paths.runtime_folder()), Path(paths.temporary_runtime_folder()))):
        inside = sorted(folder.iterdir()) if _is_ours(folder) else []
        instances = [one for path in inside for one in _folder(path, f"instance {path.name}", path.glob("*lock"))]
        found += instances or _folder(folder, "folder of the instances")
    if chosen.prefix:
        pid = _user_of(chosen.folder.glob(f"{chosen.prefix}*lock"))
        kinds = ("lock", "log", "log.*", "gateway-*", "launch-*.log", "recording-*.log", "playing-*.log")
        files = [*(file for kind in kinds for file in chosen.folder.glob(chosen.prefix + kind)), chosen.socket]
        what = f"socket {chosen.socket.name}"
        found += [
            Leftover(path, what, _size(path), pid) for path in files if _is_ours(path, stat.S_IFREG, stat.S_IFSOCK)
        ]
    return found


def remove(leftover: Leftover) -> None:
    """Remove it. Raises OSError: it cannot be removed."""
    if not _is_ours(leftover.path):
        leftover.path.unlink()
        return
    shutil.rmtree(leftover.path)
    with suppress(OSError):  # with the last instance, remove the common folder too
        if leftover.path.parent.name.startswith("slidectl"):
            leftover.path.parent.rmdir()


def _folder(path: Path, what: str, locks: Iterable[Path] = ()) -> list[Leftover]:
    return [Leftover(path, what, _size(path), _user_of(locks))] if _is_ours(path) else []


def _user_of(locks: Iterable[Path]) -> int | None:
    """The process id of a daemon or a gateway that holds one of the locks."""
    return next((pid for lock in locks if (pid := holder(lock)) is not None), None)


def _is_ours(path: Path, *kinds: int) -> bool:
    """True for a folder of this user, or for a file of one of the kinds (S_IFREG ...) of this user."""
    with suppress(OSError):
        info = os.lstat(path)
        return stat.S_IFMT(info.st_mode) in (kinds or (stat.S_IFDIR,)) and info.st_uid == os.geteuid()
    return False


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.lstat().st_size for file in files if file.is_file() and not file.is_symlink())
