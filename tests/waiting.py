"""Waiting for what comes soon, in another process."""

from __future__ import annotations

import time
from collections.abc import Callable

DEADLINE_S = 60.0
_LOOK_EVERY_S = 0.01


def eventually(
    condition: Callable[[], object], what: str = "the condition did not become true", limit_s: float = DEADLINE_S
) -> None:
    """Fail unless the condition holds soon; looks again every few milliseconds."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(_LOOK_EVERY_S)
