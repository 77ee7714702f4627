"""Reads the text of a model: from a file, a shipped model's name, standard input, or the text itself.

Nothing is expanded or parsed here.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from slidectl import input_files, paths
from slidectl.description.packages import is_file
from slidectl.description.xml_tree import MOST_BYTES
from slidectl.errors import BadFile, UnknownName, UsageError

SUFFIXES = (".xacro", ".urdf", ".xml")


@dataclass(frozen=True)
class ModelText:
    """The raw text of a model; `path` is None when it is not from a file."""

    text: bytes | str
    file: str
    path: Path | None


def read(source: str | Path) -> ModelText:
    """Read the text that `source` means.

    Raises BadFile: no such file, or one that cannot be read. UnknownName: no shipped model of that name.
    """
    if source == "-":
        return ModelText(input_files.read_stdin(MOST_BYTES), "<stdin>", None)
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        return ModelText(source, "<text>", None)
    path = find(source)
    return ModelText(read_file(path, pipes=True), str(path), path)


def read_file(path: Path, *, pipes: bool = False) -> bytes:
    """Read a user's file of at most MOST_BYTES; `pipes` is as in `input_files.opened`.

    Raises NotThere: missing. BadFile: not a regular file, too large, or not readable.
    """
    try:
        return input_files.read_bytes(path, MOST_BYTES, pipes=pipes)
    except BadFile as error:
        if path.suffix in SUFFIXES and path.stem in shipped():
            error.hint = f"a shipped model goes by its name alone: {path.stem}"
        raise


def xacro_words(words: Iterable[str]) -> tuple[dict[str, str], list[str]]:
    """The arguments among the words of xacro's command line, by name, and the other words.

    As with xacro, `name:=` leaves the model's own default, and `_name:=value` is a parameter of a node, of no effect.

    Raises UsageError: a word has several `:=`.
    """
    arguments, others = {}, []
    for word in words:
        name, *values = (part.strip() for part in word.split(":="))
        if len(values) > 1:
            raise UsageError(f"xacro: {word!r} assigns twice", "write name:=value")
        if not values:
            others.append(word)
        elif name and values[0] and not re.match(r"_[^_]", name):
            arguments[name] = values[0]
    return arguments, others


def find(source: str | Path) -> Path:
    """The file of a model: a bare name means a shipped model, anything else is a path.

    Raises UnknownName: a bare name that is neither a shipped model nor a file.
    """
    text = os.fspath(source)
    known = shipped()
    if text in known:
        return known[text]
    path = Path(os.path.expanduser(text))
    if is_path_like(text) or is_file(path):
        return path
    raise UnknownName("shipped model", text, sorted(known), "(and no file of that name here)")


def is_path_like(text: str) -> bool:
    """True for a text that can only be a path."""
    return "/" in text or os.sep in text or text.startswith(("~", ".")) or text.lower().endswith(SUFFIXES)


def shipped() -> dict[str, Path]:
    """The shipped models by name."""
    folder = paths.share("models")
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {path.stem: path for path in files if path.suffix in (".xacro", ".urdf")}
