"""A command in a terminal of its own, as a person has it: keys go in, the screen is what was drawn last."""

from __future__ import annotations

import fcntl
import os
import re
import select
import struct
import subprocess
import termios
import time
from collections.abc import Callable
from typing import Any

from command_line import ROOT, CommandLine
from waiting import DEADLINE_S

_ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
_HOME = "\x1b[H"


class Terminal:
    """It is the command's controlling terminal: its end is a SIGHUP for the command. Use it as a context manager."""

    def __init__(
        self, slidectl: CommandLine, *words: str, size: tuple[int, int] = (80, 24), **environment: str
    ) -> None:
        self._master, slave = os.openpty()
        self.resize(*size)
        self.settings = termios.tcgetattr(slave)
        self.output = ""
        kept = {
            key: value for key, value in slidectl.environment.items() if key not in ("COLUMNS", "LINES", "NO_COLOR")
        }
        self.process = subprocess.Popen(
            slidectl.argv(*words),
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**kept, "TERM": "xterm", **environment},
            cwd=ROOT,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        self._slave = slave

    def resize(self, width: int, height: int) -> None:
        self._height = height
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", height, width, 0, 0))

    def press(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    @property
    def screen(self) -> list[str]:
        """The lines of the last whole picture that was drawn from the top, without colours."""
        for drawn in reversed(self.output.split(_HOME)):
            lines = _ESCAPE.sub("", drawn).replace("\r", "").split("\n")
            if len(lines) == self._height:
                return [line.rstrip() for line in lines]
        return []

    @property
    def is_restored(self) -> bool:
        """Whether the terminal has the settings that it had before."""
        return termios.tcgetattr(self._slave) == self.settings

    def until(self, condition: Callable[[], Any], meanwhile: Callable[[], Any] = lambda: None) -> Any:
        """Take in what is written until the condition holds; its value. `meanwhile` is done again and again."""
        deadline = time.monotonic() + DEADLINE_S
        while not (value := condition()):
            assert time.monotonic() < deadline, self.output
            meanwhile()
            if select.select([self._master], (), (), 0.05)[0]:
                self._read()
        return value

    def _read(self) -> None:
        self.output += os.read(self._master, 65536).decode(errors="replace")

    def says(self, *texts: str) -> None:
        """Wait until all the texts have been written."""
        self.until(lambda: all(text in self.output for text in texts))

    def shows(self, *texts: str) -> list[str]:
        """Wait until all the texts are on the screen, and give its lines."""
        self.until(lambda: all(text in "\n".join(self.screen) for text in texts))
        return self.screen

    def ended(self) -> int:
        """Wait for the end, and take in all that was written; the exit code."""
        self.until(lambda: self.process.poll() is not None)
        while select.select([self._master], (), (), 0.0)[0]:
            self._read()
        return int(self.process.returncode)

    def close(self) -> None:
        """The terminal is closed, as by its window's button."""
        os.close(self._slave)
        os.close(self._master)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
