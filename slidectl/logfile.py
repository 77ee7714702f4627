"""The log of a daemon or a gateway: a file that is rotated by size. An error of the file never stops the process."""

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
"""The number of rotated copies beside the file; `log.1` is the newest."""


class LogFile(RotatingFileHandler):
    """Appends entries with the wall-clock time.

    In the background stdout and stderr lead to the file too, so that it gets what C code prints. With `foreground` they
    stay as they are, and stderr also gets every entry.
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
        """Write one entry. Further lines of the text are indented; the middle of a text above a few kB is left out."""
        body = cut(text).rstrip("\n").replace("\n", "\n    ")
        record = logging.makeLogRecord({"levelname": severity, "msg": body})
        self.emit(record)
        if self._foreground:
            with suppress(OSError):
                os.write(2, (self.format(record) + "\n").encode("utf-8", "backslashreplace"))

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802, ARG002
        """Drop an entry that cannot be written; the next entry opens the file again."""
        self.reopen()

    def reopen(self) -> None:
        """Close the file, so that the next entry opens it anew: the file may have been deleted."""
        stream, self.stream = self.stream, None
        with suppress(OSError):
            if stream is not None:
                stream.close()
