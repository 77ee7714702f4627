"""What the user calls a model, as a text with a name.

A file, a shipped model's name, standard input, or the text itself. Nothing is expanded or parsed here.
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
    """The raw text of a model; `path` is None when it came without a file."""

    text: bytes | str
    file: str
    path: Path | None


def read(source: str | Path) -> ModelText:
    """The text that `source` means.

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
    """The bytes of a user's file, or the first of too many. `pipes` as for read_regular.

    Raises:
        NotThere: missing. BadFile: a folder, no regular file, or not readable.
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
    """The bytes of a file, or one more than `most_bytes` of them.

    Only regular files are read: a FIFO, a socket or a device may never end, or never begin. With `pipes` a FIFO is
    read too, which is for files that the user names himself: a shell makes one of `<(xacro robot.xacro)`.

    Raises:
        BadFile: it is none. OSError, ValueError: it is a folder, or cannot be read.
    """
    is_pipe = pipes and stat.S_ISFIFO(os.stat(path).st_mode)
    _check_kind(path, os.stat(path).st_mode, is_pipe)
    # Without O_NONBLOCK the open itself would wait for a writer, if a FIFO has come into the file's place by now.
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | (0 if is_pipe else os.O_NONBLOCK))
    with open(descriptor, "rb") as stream:
        _check_kind(path, os.fstat(descriptor).st_mode, is_pipe)
        return stream.read(most_bytes + 1)


def _check_kind(path: Path, mode: int, is_pipe: bool) -> None:
    """Raises BadFile unless it is a regular file, or a pipe that may be; of a folder IsADirectoryError."""
    if stat.S_ISREG(mode) or (is_pipe and stat.S_ISFIFO(mode)):
        return
    if stat.S_ISDIR(mode):  # `open` would say so too, and leave the descriptor open
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    kind = "a pipe" if stat.S_ISFIFO(mode) else "a socket" if stat.S_ISSOCK(mode) else "a device"
    raise BadFile(f"is {kind}, and only regular files are read", str(path))


def find(source: str | Path) -> Path:
    """The file of a model: a bare name means a shipped one, anything else is a path.

    Raises:
        UnknownName: a bare name that is neither shipped nor a file here.
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
    """True for what can only be meant as a file."""
    return "/" in text or os.sep in text or text.startswith(("~", ".")) or text.lower().endswith(SUFFIXES)


def shipped() -> dict[str, Path]:
    """The shipped models by name."""
    folder = paths.share("models")
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {path.stem: path for path in files if path.suffix in (".xacro", ".urdf")}
