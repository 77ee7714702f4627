"""Background tasks of a gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any


class Tasks:
    """Holds running tasks until they end. asyncio keeps only weak references, so an unheld task may be lost."""

    def __init__(self) -> None:
        self._running: set[asyncio.Task[None]] = set()

    def __len__(self) -> int:
        return len(self._running)

    def begin(self, work: Coroutine[Any, Any, None], ended: Callable[[], None] = lambda: None) -> None:
        """Run `work` and call `ended` after it, also when it was cancelled."""
        task = asyncio.get_running_loop().create_task(work)
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        task.add_done_callback(lambda _: ended())

    def cancel(self) -> None:
        for task in self._running:
            task.cancel()
