"""Reading a log file that grows and is rotated meanwhile. No daemon is asked, so it works after one has died."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from slidectl.cli.output import watch_reader
from slidectl.errors import Refused

_LOOK_AGAIN_S = 0.1


def lines(path: Path, last: int | None, follow: bool) -> Iterator[str]:
    """The last lines of the file (None: all of them), then with `follow` those that are added, for ever.

    Raises:
        Refused: there is no log, or it cannot be read.
    """
    with _opened(path) as file:
        *whole, begun = file.read().split("\n")
        yield from whole if last is None else whole[max(0, len(whole) - last) :]
        if follow:
            watch_reader()
            yield from _growing(file, path, begun)
        elif begun and last != 0:
            yield begun


def _growing(file: TextIO, path: Path, begun: str) -> Iterator[str]:
    """New lines of the file, and of the one that takes its name when it is rotated away.

    `begun` is the beginning of a line whose end has not been written yet.
    """
    while True:
        begun += file.readline()
        if begun.endswith("\n"):
            yield begun[:-1]
            begun = ""
        elif not _is_current(file, path):
            file.close()
            file = _opened(path)
        else:
            select.select([], [], [], _LOOK_AGAIN_S)


def _is_current(file: TextIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.stat(path))
    except FileNotFoundError:
        return True  # between two renames


def _opened(path: Path) -> TextIO:
    try:
        return path.open(encoding="utf-8", errors="replace", newline="\n")
    except FileNotFoundError:
        raise Refused(f"there is no log {path}", "no daemon of this instance has run") from None
    except OSError as error:
        raise Refused(f"cannot read the log {path}: {error.strerror or error}") from None
