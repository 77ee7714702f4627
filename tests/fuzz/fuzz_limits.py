"""The limit of wall time for what an attack does in its own process."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_CASE_LIMIT_S = 20


@contextmanager
def limited() -> Iterator[None]:
    """TimeoutError inside, when it takes too long."""

    def ring(*_: Any) -> None:
        raise TimeoutError(f"took longer than {_CASE_LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, _CASE_LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
