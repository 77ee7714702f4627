"""Opens the files that a user or a client names. All of them are opened here: regular files, within a bound.

Against: a file that was sent and names another one, and a client that names a path. A FIFO, a device or a socket may
block its reader for ever or never end, and a file may be of any size. So the kind and the size are checked before
anything is read. Standard library only.
"""

from __future__ import annotations

import io
import os
import stat
import sys
from collections.abc import Callable
from itertools import islice
from typing import Any, BinaryIO, TextIO

from slidectl.errors import BadFile, NotThere, closest
from slidectl.operating_system import OPEN_FILES

MOST_TEXT = 16 * 2**20
"""The most bytes of a file that is read as text: a model, a launch file, parameters, a user's code."""
LARGEST = 256 * 2**20
"""The most bytes of any other file that is read whole."""
ReadInput = Callable[[str, Callable[[], Any]], Any]
"""Reads for a world: takes a description of what is read, and a function that reads it and returns JSON values."""
_MOST_COMPARED = 1000
"""The most files of a folder that are looked at for a similar name."""
_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFLNK: "a link", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}  # fmt: skip


def opened(
    path: str | os.PathLike[str], most_bytes: int | None = None, *, pipes: bool = False, links: bool = True
) -> BinaryIO:
    """Open a regular file for reading.

    Args:
        most_bytes: the largest file that is opened.
        pipes: the shell's `<(...)` is opened too; reading waits for its writer then. Use that only in a command, for a
            file that the user names.
        links: False for a path whose links were resolved: a link there is refused.

    Raises:
        NotThere: missing. BadFile: a folder, a pipe, a device, a socket, larger than the bound, or not readable.
    """
    shown = os.fspath(path)
    try:
        _check(os.stat(path, follow_symlinks=links), shown, most_bytes, pipes)
        return open(path, "rb")
    except OSError as error:
        raise _unreadable(error, shown) from None
    except ValueError as error:  # a null character in the path
        raise BadFile(str(error), shown) from None


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
    """The content of a file. Arguments and errors are those of `opened`.

    What is read is counted: files in /proc and pipes tell no size.
    """
    with opened(path, most_bytes, pipes=pipes, links=links) as file:
        try:
            content = file.read(most_bytes + 1)
        except OSError as error:
            raise _unreadable(error, os.fspath(path)) from None
    if len(content) > most_bytes:
        raise _too_large(os.fspath(path), most_bytes)
    return content


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


def _is_of_the_shell(path: str | os.PathLike[str]) -> bool:
    whole = os.path.abspath(path)
    return whole == "/dev/stdin" or os.path.dirname(whole) in OPEN_FILES


def _check(there: os.stat_result, shown: str, most_bytes: int | None, pipes: bool) -> None:
    """Raise BadFile for what is not opened."""
    if stat.S_ISREG(there.st_mode):
        if most_bytes is not None and there.st_size > most_bytes:
            raise _too_large(shown, most_bytes)
        return
    is_pipe = stat.S_ISFIFO(there.st_mode)
    if is_pipe and pipes and _is_of_the_shell(shown):
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
