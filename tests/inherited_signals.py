"""What programs that tests start do at a signal, however the shell of the tests was started."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def inherited(number: int, handler: signal.Handlers) -> Iterator[None]:
    """What programs that are started meanwhile do at this signal, whatever the tests' own shell has set."""
    previous = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, previous)
