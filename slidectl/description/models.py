"""Reads the text of a model: from a file, a shipped model's name, standard input, or the text itself.

Nothing is expanded or parsed here.
"""

from __future__ import annotations

import errno
import os
import stat
import sys
from dataclasses import dataclass
from pathlib import Path

from slidectl import paths
from slidectl.description.packages import is_file
from slidectl.description.xml_tree import MOST_BYTES
from slidectl.errors import BadFile, NotThere, UnknownName

SUFFIXES = (".xacro", ".urdf", ".xml")


@dataclass(frozen=True)
class ModelText:
    """The raw text of a model; `path` is None when it is not from a file."""

    text: bytes | str
    file: str
    path: Path | None


def read(source: str | Path) -> ModelText:
    """Read the text that `source` means.

    Raises:
        BadFile: no such file, or one that cannot be read. UnknownName: no shipped model of that name.
    """
    if source == "-":
        return ModelText(sys.stdin.buffer.read(MOST_BYTES + 1), "<stdin>", None)
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        return ModelText(source, "<text>", None)
    path = find(source)
    return ModelText(read_file(path, pipes=True), str(path), path)


def read_file(path: Path, *, pipes: bool = False) -> bytes:
    """Read a user's file, at most MOST_BYTES + 1 bytes. `pipes` is as in read_regular.

    Raises:
            NotThere: missing. BadFile: a folder, not a regular file, or not readable.
    """
    try:
        return read_regular(path, MOST_BYTES, pipes=pipes)
    except (OSError, ValueError) as error:
        is_shipped = path.suffix in SUFFIXES and path.stem in shipped()
        hint = f"a shipped model goes by its name alone: {path.stem}" if is_shipped else None
        kind = NotThere if isinstance(error, FileNotFoundError) else BadFile
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise kind(reason[:1].lower() + reason[1:], str(path), hint=hint) from None


def read_regular(path: Path, most_bytes: int, *, pipes: bool = False) -> bytes:
    """Read a file, at most `most_bytes` + 1 bytes.

    Only regular files are read: a FIFO, a socket or a device may block or never end. With `pipes` a FIFO is read too.
    Use that only for files that the user names: a shell makes a FIFO for `<(xacro robot.xacro)`.

    Raises:
        BadFile: not a regular file. OSError, ValueError: a folder, or not readable.
    """
    is_pipe = pipes and stat.S_ISFIFO(os.stat(path).st_mode)
    _check_kind(path, os.stat(path).st_mode, is_pipe)
    # Without O_NONBLOCK the open would wait for a writer, if a FIFO has replaced the file since the check.
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | (0 if is_pipe else os.O_NONBLOCK))
    with open(descriptor, "rb") as stream:
        _check_kind(path, os.fstat(descriptor).st_mode, is_pipe)
        return stream.read(most_bytes + 1)


def _check_kind(path: Path, mode: int, is_pipe: bool) -> None:
    """Raise BadFile unless it is a regular file, or a pipe that is allowed; IsADirectoryError for a folder."""
    if stat.S_ISREG(mode) or (is_pipe and stat.S_ISFIFO(mode)):
        return
    if stat.S_ISDIR(mode):  # `open` would raise this too, but leave the descriptor open
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    kind = "a pipe" if stat.S_ISFIFO(mode) else "a socket" if stat.S_ISSOCK(mode) else "a device"
    raise BadFile(f"is {kind}, and only regular files are read", str(path))


def find(source: str | Path) -> Path:
    """The file of a model: a bare name means a shipped model, anything else is a path.

    Raises:
            UnknownName: a bare name that is neither a shipped model nor a file.
    """
    text = os.fspath(source)
    known = shipped()
    if text in known:
        return known[text]
    path = Path(os.path.expanduser(text))
    if looks_like_path(text) or is_file(path):
        return path
    raise UnknownName("shipped model", text, sorted(known), "(and no file of that name here)")


def looks_like_path(text: str) -> bool:
    """True for a text that can only be a path."""
    return "/" in text or os.sep in text or text.startswith(("~", ".")) or text.lower().endswith(SUFFIXES)


def shipped() -> dict[str, Path]:
    """The shipped models by name."""
    folder = paths.share("models")
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {path.stem: path for path in files if path.suffix in (".xacro", ".urdf")}
