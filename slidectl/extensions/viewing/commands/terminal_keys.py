"""Keys from a terminal, one at a time. The terminal is restored in all cases."""

from __future__ import annotations

import os
import re
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from slidectl.errors import EXIT_INTERRUPTED
from slidectl.supervision import Interrupted, Interrupts

_NAMES = {
    b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left", b"\x1b": "escape",
    b"\r": "enter", b"\n": "enter", b"\t": "tab", b"\x7f": "backspace", b"\b": "backspace", b" ": "space",
}  # fmt: skip
_KEY = re.compile(rb"\x1b\[[\d;]*[A-Za-z~]|\x1bO[A-Za-z]|[\xc2-\xf4][\x80-\xbf]+|.", re.DOTALL)


@contextmanager
def terminal_keys() -> Iterator[Callable[[], list[str]]]:
    """Within the block, the terminal of stdin gives each key at once and echoes none.

    Yields a function that waits for a key and returns all pressed keys, each a character or one of `up`, `down`,
    `left`, `right`, `enter`, `tab`, `escape`, `backspace`, `space`. Ctrl-Z is a key, because a suspended process cannot
    stop a robot. Ctrl-C, SIGTERM and the end of the terminal end the block, with the exit code of an interrupt.
    """
    import click

    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)

    def read() -> list[str]:
        try:
            pressed = os.read(descriptor, 1024)
        except OSError:  # the terminal was closed
            pressed = b""
        if not pressed:
            raise click.exceptions.Exit(EXIT_INTERRUPTED)
        found = (key.replace(b"\x1bO", b"\x1b[") for key in _KEY.findall(pressed))
        return [_NAMES.get(key, key.decode(errors="replace")) for key in found]

    try:
        with Interrupts() as interrupts, interrupts.raised():
            try:
                tty.setcbreak(descriptor)
                attributes = termios.tcgetattr(descriptor)
                attributes[6][termios.VSUSP] = b"\0"
                termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
                yield read
            finally:
                with suppress(termios.error):
                    termios.tcflush(descriptor, termios.TCIFLUSH)  # discard repeated keys, which the shell would read
                    termios.tcsetattr(descriptor, termios.TCSANOW, before)
    except Interrupted:
        raise click.exceptions.Exit(EXIT_INTERRUPTED) from None
