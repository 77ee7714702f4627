"""Writing a file as a whole: the old content stays until the new content is complete on the disk.

Also the kind of a file by its name, and why a file cannot be written. The content does not matter here. Every file of
a user that a command makes is written here, except those that grow while something happens and are readable at any
time: recordings that are being recorded, journals and logs.
"""

from __future__ import annotations

import errno
import os
import signal
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, BinaryIO, NoReturn, cast

from slidectl.errors import Refused
from slidectl.operating_system import reserve_space

if TYPE_CHECKING:
    from pathlib import Path

AnyPath = str | os.PathLike[str]
_FULL = {errno.ENOSPC: "is full", errno.EDQUOT: "has no more room for this user"}
_ENDING = (signal.SIGTERM, signal.SIGHUP)
_LONGEST_STEM = 200
"""Bytes of a name that its draft has too; a file system takes 255 in all."""


class CannotWrite(Refused):
    """A file cannot be written. A full disk is named."""

    def __init__(self, path: AnyPath, error: OSError, what: str = "", more: str = "", then: str = "") -> None:
        """`what` the file is, such as "the journal"; `more` about it ends the message, and `then` the hint."""
        named = f"{what} {os.fspath(path)}".strip()
        advice = "; then ".join(filter(None, (hint(error, path), then)))
        super().__init__(f"cannot write {named}: {reason(error, path)}{more}", advice or None)


def reason(error: OSError, path: AnyPath) -> str:
    """Why the file cannot be written; of a full disk where it is mounted."""
    text, disk = error.strerror or str(error), _full_disk(error, path)
    return f"{text}: the disk at {disk} {_FULL[error.errno or 0]}" if disk else text


def hint(error: OSError, path: AnyPath) -> str | None:
    """What to do about it; None unless a disk is full."""
    return "make room there, or name a file elsewhere" if _full_disk(error, path) else None


def _full_disk(error: OSError, path: AnyPath) -> str:
    """Where the full disk is mounted; empty when that is not the cause, or the file is no regular one."""
    place = os.path.realpath(error.filename if isinstance(error.filename, str) else path)
    if error.errno not in _FULL or (os.path.exists(place) and not os.path.isfile(place) and not os.path.isdir(place)):
        return ""
    while not os.path.ismount(place):
        place = os.path.dirname(place)
    return place


def file_kind(path: AnyPath) -> str:
    """The suffix of a file name in lower case, with its dot; empty when there is none."""
    return os.path.splitext(os.fspath(path))[1].lower()


# --- whole files ------------------------------------------------------------------------------------------------------


def write_whole(path: AnyPath, text: str | bytes) -> None:
    """Write the text (UTF-8) or the bytes to the file, as `whole_file` does.

    Raises:
        OSError: it cannot be written.
    """
    with whole_file(path) as file:
        file.write(text.encode() if isinstance(text, str) else text)


@contextmanager
def whole_file(path: AnyPath) -> Iterator[BinaryIO]:
    """A file to write piece by piece. It is there when the block ends; after an exception the old one is, or none.

    A link stays, and its target is written. An existing file keeps its permissions. Pipes and devices are written as
    the pieces come. A file that cannot be replaced (of another user, with several names, in a folder that may not be
    changed) gets the new content at the end, if the disk has room for it.

    Raises:
        OSError: it cannot be written.
    """
    target = os.path.realpath(path)
    if os.path.exists(path) and not os.path.exists(target):  # a pipe of the shell, `>(...)`: its link leads nowhere
        target = os.fspath(path)
    there = os.stat(target) if os.path.exists(path) else None
    is_regular = there is None or stat.S_ISREG(there.st_mode)
    if there is None or (is_regular and _can_be_replaced(target, there)):
        mode = None if there is None else stat.S_IMODE(there.st_mode)
        with draft(target) as new, _created(new, mode) as file:
            yield file
    elif is_regular:
        with _collected() as file:
            yield file
            _overwrite(target, file)
    else:
        with open(target, "wb") as file:
            yield file


def check_writable(path: AnyPath) -> None:
    """Raise OSError when `whole_file` cannot write a file of one byte. Nothing changes."""
    if not os.path.exists(path):
        with suppress(_Discarded), whole_file(path) as file:
            file.write(b"\n")
            file.flush()
            raise _Discarded
    elif os.path.isfile(path):
        open(path, "rb+").close()
    elif os.path.isdir(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)


class _Discarded(Exception):
    """Ends the writing of a file that is not wanted."""


def replace(target: AnyPath, content: bytes, mode: int | None = None) -> None:
    """Write a file in one step: it is complete, or the old file stays. A link is replaced.

    The permissions are `mode` from the start, so that no other user can read it while it is written. Without a mode the
    umask applies to 0666.

    Raises:
        OSError: it cannot be written; nothing is left behind.
    """
    with draft(target) as new, _created(new, mode) as file:
        file.write(content)


@contextmanager
def draft(target: AnyPath) -> Iterator[Path]:
    """A path beside `target`, with its suffix, for a file that takes its place when the block ends.

    The block makes the file. After an exception it is removed. SIGTERM and SIGHUP, where they would end the process,
    end it when the file is removed.

    Raises:
        OSError: it cannot be put on the disk.
    """
    from pathlib import Path  # imported here: everyday commands import this module, and pathlib is slow

    folder, name = os.path.split(os.fspath(target))
    stem, suffix = os.path.splitext(name)
    stem = os.fsdecode(os.fsencode(stem)[:_LONGEST_STEM])
    new = Path(folder, f".{stem}.{os.urandom(4).hex()}{suffix}")
    with _ended_late():
        try:
            yield new
            file = os.open(new, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(file)
            finally:
                os.close(file)
            os.replace(new, target)
        except BaseException:  # also on an interrupt; on a full disk the space must be freed
            with suppress(OSError):
                os.unlink(new)
            raise


@contextmanager
def _created(new: Path, mode: int | None) -> Iterator[BinaryIO]:
    # O_EXCL: in a folder that others may write to, another user may have put a link of that name.
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    with open(os.open(new, flags, 0o666 if mode is None else 0o600), "wb") as file:
        if mode is not None:
            os.fchmod(file.fileno(), mode)
        yield file


class _Ended(BaseException):
    """A signal that ends the process came."""


@contextmanager
def _ended_late() -> Iterator[None]:
    """Raise _Ended inside for a signal that would end the process, and end it by that signal afterwards."""
    caught, received = [], []

    def end(number: int, _: object) -> NoReturn:
        received.append(number)
        raise _Ended

    with suppress(ValueError):  # not in the main thread, where signals are handled
        for number in _ENDING:
            if signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, end)
                caught.append(number)
    try:
        yield
    finally:
        for number in caught:
            signal.signal(number, signal.SIG_DFL)
        if received:
            os.kill(os.getpid(), received[0])


# --- files that cannot be replaced ------------------------------------------------------------------------------------


def _can_be_replaced(target: str, there: os.stat_result) -> bool:
    is_ours_alone = there.st_uid == os.geteuid() and there.st_nlink == 1
    return is_ours_alone and os.access(target, os.W_OK) and os.access(os.path.dirname(target), os.W_OK)


@contextmanager
def _collected() -> Iterator[BinaryIO]:
    """A file without a name, in the folder for temporary files, which an error names."""
    import tempfile  # imported here, as shutil: most commands write no such file, and many import this one

    with tempfile.TemporaryFile() as file:
        try:
            yield cast("BinaryIO", file)
        except OSError as error:
            error.filename = error.filename or tempfile.gettempdir()
            raise


def _overwrite(target: str, content: BinaryIO) -> None:
    """Give the file this content. The room is taken first, so that a full disk leaves the old content."""
    import shutil

    content.flush()
    size = content.seek(0, os.SEEK_END)
    content.seek(0)
    held = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, *_ENDING))  # half of it would be worse
    try:
        with open(os.open(target, os.O_WRONLY | os.O_CLOEXEC), "wb") as file:
            before = os.fstat(file.fileno()).st_size
            try:
                if size:
                    reserve_space(file.fileno(), size)
            except OSError as error:
                os.ftruncate(file.fileno(), before)
                error.filename = target
                raise
            shutil.copyfileobj(content, file)
            file.truncate()
            file.flush()
            os.fsync(file.fileno())
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
