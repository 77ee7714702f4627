"""The daemon's log: a file that is rotated by size, and that can fail without hurting anybody.

In the background the file is also what stands behind stdout and stderr, so that whatever C code prints lands there.
"""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

from slidectl.errors import cut

MOST_BYTES = 1024 * 1024
COPIES = 2
"""Rotated copies beside the file itself: `log.1` is the younger."""


class LogFile:
    """Appends lines with the time of the machine. `foreground`: stderr stays what it is and gets every line too."""

    def __init__(self, path: Path, foreground: bool = False, most_bytes: int = MOST_BYTES) -> None:
        self._path = path
        self._foreground = foreground
        self._most_bytes = most_bytes
        self._lost = 0
        self._cut = False
        self._fd = -1
        self._size = 0
        self._open()

    def _open(self) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
        try:
            fd = os.open(self._path, flags, 0o600)
        except OSError:
            fd = os.open(os.devnull, flags)
        self._size = os.fstat(fd).st_size
        if not self._foreground:
            os.dup2(fd, 1)
            os.dup2(fd, 2)
        self._fd = fd

    def write(self, severity: str, text: str) -> None:
        """One entry; the lines of a longer text are indented. Of one of more than a few kB the middle is left out."""
        now = time.time()
        stamp = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(now)) + f".{int(now % 1 * 1000):03d}"
        body = cut(text).rstrip("\n").replace("\n", "\n    ")
        self._append(f"{stamp} {severity:<5} {body}\n")

    def _append(self, entry: str) -> None:
        data = entry.encode("utf-8", "backslashreplace")
        if self._foreground:
            with suppress(OSError):
                os.write(2, data)
        if self._size + len(data) > self._most_bytes:
            self._rotate()
        if self._lost:
            note = f"({self._lost} entries before this one are lost: the file could not be written)\n"
            data = b"\n" * self._cut + note.encode() + data
        try:
            written = os.write(self._fd, data)
        except OSError:
            self._lost += 1
            return
        self._size += written
        self._lost = int(written < len(data))  # the disk is full: what is there of this entry must not run on
        self._cut = written < len(data)

    def _rotate(self) -> None:
        names = [self._path, *(self._path.with_name(f"{self._path.name}.{n}") for n in range(1, COPIES + 1))]
        with suppress(OSError):
            for older, newer in zip(reversed(names), reversed(names[:-1]), strict=False):
                with suppress(FileNotFoundError):
                    os.replace(newer, older)
        os.close(self._fd)
        self._open()

    def reopen(self) -> None:
        """The file may have been deleted: go on in one that others find."""
        os.close(self._fd)
        self._open()

    def close(self) -> None:
        """Let go of the file. stdout and stderr keep it."""
        os.close(self._fd)
