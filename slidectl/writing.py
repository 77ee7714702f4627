"""Writing a file whole: what stood there stays until all of the new is on the disk; and what kind a name asks for.

Knows nothing of what is written.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress


def file_kind(path: str | os.PathLike[str]) -> str:
    """The ending of a file's name in small letters, with its dot; empty where there is none."""
    return os.path.splitext(os.fspath(path))[1].lower()


def write_whole(path: str | os.PathLike[str], text: str | bytes) -> None:
    """Put the text (UTF-8) or the bytes into the file; one that exists keeps its permissions.

    A link stays, and what it points to is written. Pipes, devices, and files that are not to be replaced by another
    are written in place.

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
    """Put a file there, at once or not at all, in the place of one that may be there.

    Nobody can read of it what `mode` does not let them, not even while it is written. Without a mode it is what the
    umask leaves of 0666.

    Raises:
        OSError: it cannot be written; nothing is left of it then.
    """
    draft = f"{os.fspath(target)}.{os.urandom(4).hex()}"
    # O_EXCL: in a folder that others may write to, a link of that name may lie in wait.
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    with open(os.open(draft, flags, 0o666 if mode is None else 0o600), "wb") as file:
        try:
            file.write(content)
            file.flush()
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            os.fsync(file.fileno())
            os.replace(draft, target)
        except BaseException:  # a full disk wants back what it gave, and so does who was interrupted
            with suppress(OSError):
                os.unlink(draft)
            raise
