"""Opens the files that a user or a client names. All of them are opened here: regular files, within a bound.

Against: a file that was sent and names another one, and a client that names a path. A FIFO, a device or a socket may
block its reader for ever or never end, and a file may be of any size. So the kind and the size are checked before
anything is read, and what is read is counted: a file may grow, and those in /proc tell no size. Standard library only.
"""

from __future__ import annotations

import io
import os
import stat
import sys
from collections.abc import Callable
from itertools import islice
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO, cast

from slidectl.errors import BadFile, NotThere, closest
from slidectl.operating_system import OPEN_FILES

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

MOST_TEXT = 16 * 2**20
"""The most bytes of a file that is read as text: a model, a launch file, parameters, a user's code."""
LARGEST = 256 * 2**20
"""The most bytes of any other file that is read whole."""
ReadInput = Callable[[str, Callable[[], Any]], Any]
"""Reads for a world: takes a description of what is read, and a function that reads it and returns JSON values."""
_PIECE = 2**20
_MOST_COMPARED = 1000
"""The most files of a folder that are looked at for a similar name."""
_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFLNK: "a link", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


def opened(
    path: str | os.PathLike[str], most_bytes: int | None = None, *, pipes: bool = False, links: bool = True
) -> BinaryIO:
    """Open a regular file for reading. Opening and reading never wait for another process.

    Args:
        most_bytes: the largest file that is opened; reading more of a file that grows raises BadFile too. None is for
            files that are never read whole.
        pipes: the shell's `<(...)` is opened too; reading waits for its writer then. Use that only in a command, for a
            file that the user names.
        links: False for a path whose links were resolved: what is a link now has been put there since, and is refused.

    Raises:
        NotThere: missing. BadFile: a folder, a pipe, a device, a socket, larger than the bound, or not readable.
    """
    shown = os.fspath(path)
    may_be_pipe = pipes and _is_of_the_shell(path)
    try:
        # Looked at before it is opened: that alone has an effect on some devices, and on the writer of a pipe.
        _check(os.stat(path, follow_symlinks=links), shown, most_bytes, pipes, may_be_pipe)
        # Looked at again: it may have been replaced. O_NONBLOCK: then the open waits for no writer.
        flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY | (0 if links else os.O_NOFOLLOW)
        descriptor = os.open(path, flags)
        try:
            there = os.fstat(descriptor)
            _check(there, shown, most_bytes, pipes, may_be_pipe)
            if stat.S_ISFIFO(there.st_mode):
                os.set_blocking(descriptor, True)
        except BaseException:
            os.close(descriptor)
            raise
    except OSError as error:
        raise _unreadable(error, shown) from None
    except ValueError as error:  # a null character in the path
        raise BadFile(str(error), shown) from None
    return io.BufferedReader(_InputFile(descriptor, shown, most_bytes))


def opened_text(
    path: str | os.PathLike[str],
    most_bytes: int | None = None,
    *,
    errors: str = "strict",
    newline: str | None = None,
    pipes: bool = False,
) -> TextIO:
    """As `opened`, for text in UTF-8; `errors` and `newline` are as for Python's `open`."""
    return io.TextIOWrapper(opened(path, most_bytes, pipes=pipes), "utf-8", errors, newline)


def read_bytes(
    path: str | os.PathLike[str], most_bytes: int = LARGEST, *, pipes: bool = False, links: bool = True
) -> bytes:
    """The content of a file. Arguments and errors are those of `opened`."""
    with opened(path, most_bytes, pipes=pipes, links=links) as file:
        try:
            return file.read()
        except OSError as error:
            raise _unreadable(error, os.fspath(path)) from None


def read_text(path: str | os.PathLike[str], most_bytes: int = MOST_TEXT, *, pipes: bool = False) -> str:
    """The text of a file in UTF-8. Arguments and errors are those of `opened`; BadFile also for other bytes."""
    try:
        return read_bytes(path, most_bytes, pipes=pipes).decode()
    except UnicodeDecodeError as error:
        raise BadFile(f"is not text in UTF-8: {error.reason} at byte {error.start}", os.fspath(path)) from None


def read_stdin(most_bytes: int = MOST_TEXT) -> bytes:
    """All of standard input. Raises BadFile: it is longer than the bound."""
    content = sys.stdin.buffer.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise _too_large("<stdin>", most_bytes)
    return content


def is_output(path: str | os.PathLike[str]) -> bool:
    """True for the shell's `<(...)`, or standard input by its path: the output of a command, to be read once."""
    try:
        return _is_of_the_shell(path) and stat.S_ISFIFO(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


class _InputFile(io.FileIO):
    """A file that raises BadFile when more is read of it than its bound, and when reading would wait."""

    def __init__(self, descriptor: int, name: str, most_bytes: int | None) -> None:
        super().__init__(descriptor, "rb")
        self._shown = name
        self._most_bytes = most_bytes
        self._taken = 0

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        return self._counted(cast("int | None", super().readinto(buffer)))

    def readall(self) -> bytes:
        pieces = []
        while piece := super().read(_PIECE):
            self._counted(len(piece))
            pieces.append(piece)
        if piece is None:
            self._counted(None)
        return b"".join(pieces)

    def _counted(self, count: int | None) -> int:
        if count is None:  # some files in /proc wait for an event, and tell so because of O_NONBLOCK
            raise BadFile("cannot be read: it would wait for an event", self._shown)
        self._taken += count
        if self._most_bytes is not None and self._taken > self._most_bytes:
            raise _too_large(self._shown, self._most_bytes)
        return count


def _is_of_the_shell(path: str | os.PathLike[str]) -> bool:
    whole = os.path.abspath(path)
    return whole == "/dev/stdin" or os.path.dirname(whole) in OPEN_FILES


def _check(there: os.stat_result, shown: str, most_bytes: int | None, pipes: bool, may_be_pipe: bool) -> None:
    """Raise BadFile for what is not opened."""
    if stat.S_ISREG(there.st_mode):
        if most_bytes is not None and there.st_size > most_bytes:
            raise _too_large(shown, most_bytes)
        return
    is_pipe = stat.S_ISFIFO(there.st_mode)
    if is_pipe and may_be_pipe:
        return
    kind = _KINDS.get(stat.S_IFMT(there.st_mode), "no file")
    bound = "" if most_bytes is None else f", of at most {_mebibytes(most_bytes)}"
    hint = "for the output of a command write <(COMMAND), in bash or zsh" if is_pipe and pipes else None
    raise BadFile(f"is {kind}, and only regular files are read{bound}", shown, hint=hint)


def _unreadable(error: OSError, shown: str) -> BadFile:
    """The error for a file that the system does not open or read."""
    reason = error.strerror or str(error)
    if not isinstance(error, FileNotFoundError):
        return BadFile(reason[:1].lower() + reason[1:], shown)
    return NotThere(reason[:1].lower() + reason[1:], shown, hint=near(shown))


def near(path: str) -> str | None:
    """A hint for a file that is not there: one beside it with a similar name, or the folder that is not there."""
    folder, name = os.path.split(path)
    try:
        with os.scandir(folder or ".") as there:
            known = [entry.name for entry in islice(there, _MOST_COMPARED)]
        stem, suffix = os.path.splitext(name)
        # Endings make all names alike, and an ending may be what is wrong.
        stems = {os.path.splitext(other)[0]: other for other in known if os.path.splitext(other)[1] == suffix}
        stems |= {other: other for other in known if os.path.splitext(other)[0] == stem}
    except FileNotFoundError:
        return f"there is no folder {folder}"
    except (OSError, ValueError):
        return None
    found = closest(stem, stems) or closest(name, stems)
    return None if found is None else f"did you mean {os.path.join(folder, stems[found])}?"


def _too_large(shown: str, most_bytes: int) -> BadFile:
    return BadFile(f"is larger than {_mebibytes(most_bytes)}, the most that is read", shown)


def _mebibytes(count: int) -> str:
    return f"{count >> 20} MiB" if count >= 2**20 else f"{count} bytes"


def from_disk(what: str, look: Callable[[], Any]) -> Any:  # noqa: ARG001 - for those that record and answer
    """A ReadInput: call `look`."""
    return look()
