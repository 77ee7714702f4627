"""The log of a daemon or a gateway: a file that is rotated by size, and that can fail without hurting anybody."""

from __future__ import annotations

import logging
import os
from contextlib import suppress
from io import TextIOWrapper
from logging.handlers import RotatingFileHandler
from pathlib import Path

from slidectl.errors import cut

MOST_BYTES = 1024 * 1024
COPIES = 2
"""Rotated copies beside the file itself: `log.1` is the younger."""


class LogFile(RotatingFileHandler):
    """Appends entries with the time of the machine.

    In the background the file is also what is behind stdout and stderr, so that it gets what C code prints. With
    `foreground` these stay as they are, and stderr gets every entry too.
    """

    def __init__(self, path: Path, foreground: bool = False, most_bytes: int = MOST_BYTES) -> None:
        self._foreground = foreground
        super().__init__(path, "a", most_bytes, COPIES, "utf-8", errors="backslashreplace")
        self.setFormatter(logging.Formatter("%(asctime)s.%(msecs)03d %(levelname)-5s %(message)s", "%Y-%m-%d %H:%M:%S"))

    def _open(self) -> TextIOWrapper:
        try:
            stream = super()._open()
        except OSError:
            stream = open(os.devnull, "a", encoding="utf-8")  # noqa: SIM115
        if not self._foreground:
            os.dup2(stream.fileno(), 1)
            os.dup2(stream.fileno(), 2)
        return stream

    def write(self, severity: str, text: str) -> None:
        """One entry; the lines of a longer text are indented. Of one of more than a few kB the middle is left out."""
        body = cut(text).rstrip("\n").replace("\n", "\n    ")
        record = logging.makeLogRecord({"levelname": severity, "msg": body})
        self.emit(record)
        if self._foreground:
            with suppress(OSError):
                os.write(2, (self.format(record) + "\n").encode("utf-8", "backslashreplace"))

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802, ARG002
        """The file cannot be written: the entry is lost, and the next one opens the file anew."""
        self.reopen()

    def reopen(self) -> None:
        """The file may have been deleted: go on in one that others find."""
        stream, self.stream = self.stream, None
        with suppress(OSError):
            if stream is not None:
                stream.close()
