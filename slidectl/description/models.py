"""What the user calls a model, as a text with a name.

A file, a shipped model's name, standard input, or the text itself. Nothing is expanded or parsed here.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from slidectl import paths
from slidectl.description.packages import is_file
from slidectl.description.xml_tree import MOST_BYTES
from slidectl.errors import BadFile, NotThere, UnknownName

SUFFIXES = (".xacro", ".urdf", ".xml")


@dataclass(frozen=True)
class Source:
    """The raw text of a model; `path` is None when it came without a file."""

    text: bytes | str
    file: str
    path: Path | None


def read(source: str | Path) -> Source:
    """The text that `source` means.

    Raises:
        BadFile: no such file, or one that cannot be read. UnknownName: no shipped model of that name.
    """
    if source == "-":
        return Source(sys.stdin.buffer.read(MOST_BYTES + 1), "<stdin>", None)
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        return Source(source, "<text>", None)
    path = find(source)
    return Source(read_file(path), str(path), path)


def read_file(path: Path) -> bytes:
    """The bytes of a user's file, or the first of too many.

    Raises:
        NotThere: missing. BadFile: a folder, or not readable.
    """
    try:
        with path.open("rb") as stream:
            return stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        is_shipped = path.suffix in SUFFIXES and path.stem in shipped()
        hint = f"a shipped model goes by its name alone: {path.stem}" if is_shipped else None
        kind = NotThere if isinstance(error, FileNotFoundError) else BadFile
        raise kind(_why(error), str(path), hint=hint) from None


def _why(error: OSError | ValueError) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror[0].lower() + error.strerror[1:]
    return str(error)


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
