"""Writing a file as a whole: the old content stays until the new content is complete on the disk.

Also the kind of a file by its name. The content does not matter here.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress


def file_kind(path: str | os.PathLike[str]) -> str:
    """The suffix of a file name in lower case, with its dot; empty when there is none."""
    return os.path.splitext(os.fspath(path))[1].lower()


def write_whole(path: str | os.PathLike[str], text: str | bytes) -> None:
    """Write the text (UTF-8) or the bytes to the file; an existing file keeps its permissions.

    A link stays, and its target is written. Pipes, devices, and files that cannot be replaced are written in place.

    Raises:
        OSError: it cannot be written.
    """
    target, content = os.path.realpath(path), text.encode() if isinstance(text, str) else text
    if not os.path.exists(path):
        replace(target, content)
        return
    there = os.stat(path)
    is_ours_alone = stat.S_ISREG(there.st_mode) and there.st_uid == os.geteuid() and there.st_nlink == 1
    if is_ours_alone and os.access(target, os.W_OK) and os.access(os.path.dirname(target), os.W_OK):
        replace(target, content, stat.S_IMODE(there.st_mode))
    else:
        with open(path, "wb") as file:
            file.write(content)


def replace(target: str | os.PathLike[str], content: bytes, mode: int | None = None) -> None:
    """Write a file in one step: it is complete, or the old file stays.

    The permissions are `mode` from the start, so that no other user can read it while it is written. Without a mode the
    umask applies to 0666.

    Raises:
        OSError: it cannot be written; nothing is left behind.
    """
    draft = f"{os.fspath(target)}.{os.urandom(4).hex()}"
    # O_EXCL: in a folder that others may write to, another user may have put a link of that name.
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    with open(os.open(draft, flags, 0o666 if mode is None else 0o600), "wb") as file:
        try:
            file.write(content)
            file.flush()
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            os.fsync(file.fileno())
            os.replace(draft, target)
        except BaseException:  # also on an interrupt; on a full disk the space must be freed
            with suppress(OSError):
                os.unlink(draft)
            raise
