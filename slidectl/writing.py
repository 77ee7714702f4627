"""Writing a file whole: what stood there stays until all of the new is on the disk.

Knows nothing of what is written.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress


def write_whole(path: str | os.PathLike[str], text: str) -> None:
    """Put the text (UTF-8) into the file; one that exists keeps its permissions.

    Pipes, devices, and files that are not to be replaced by another are written in place. Raises OSError.
    """
    target = os.path.realpath(path)
    there = os.stat(path) if os.path.exists(path) else None
    if there is not None and not _is_replaceable(target, there):
        _write(path, text)
        return
    draft = f"{target}.{os.getpid()}"
    try:
        _write(draft, text)
        if there is not None:
            os.chmod(draft, stat.S_IMODE(there.st_mode))
        os.replace(draft, target)
    except BaseException:
        with suppress(OSError):
            os.unlink(draft)
        raise


def _is_replaceable(target: str, there: os.stat_result) -> bool:
    """A plain file of ours with this one name, in a folder that takes another one."""
    is_ours_alone = stat.S_ISREG(there.st_mode) and there.st_uid == os.geteuid() and there.st_nlink == 1
    return is_ours_alone and os.access(target, os.W_OK) and os.access(os.path.dirname(target), os.W_OK)


def _write(path: str | os.PathLike[str], text: str) -> None:
    with open(path, "w", encoding="utf-8") as file:
        file.write(text)
