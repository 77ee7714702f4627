"""The bounds of what expanding a model may take, in steps, time and memory: macros can make much of little."""

from __future__ import annotations

import contextlib
import resource
import time
from collections.abc import Iterator

from slidectl.errors import Refused

MOST_MEMORY = 1 << 30
"""Bytes that a run may take on top of what the process has."""

MOST_STEPS = 50_000
"""Elements that xacro looks at; a humanoid takes some ten thousand."""
MOST_SECONDS = 60.0
"""Of the processor's time, so that a busy machine refuses no more than an idle one."""


class Steps:
    """The steps of one run, and when it began."""

    def __init__(self) -> None:
        self.count = 0
        self.began_s = time.process_time()

    def take(self) -> None:
        """One more. Raises Refused when they are too many, or have taken too long."""
        self.count += 1
        if self.count > MOST_STEPS:
            raise Refused(f"unfolds to more than {MOST_STEPS} elements", "do macros call each other many times over?")
        if time.process_time() - self.began_s > MOST_SECONDS:
            raise Refused(f"takes more than {MOST_SECONDS:g} s to expand", "do macros call each other many times over?")


@contextlib.contextmanager
def bounded_memory() -> Iterator[None]:
    """Inside, more than MOST_MEMORY is a MemoryError. For the whole process: nothing else must run meanwhile."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = _address_space() + MOST_MEMORY
    if soft != resource.RLIM_INFINITY and soft <= limit:
        yield
        return
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _address_space() -> int:
    """Bytes that the process has now."""
    with open("/proc/self/statm", encoding="ascii") as statm:
        return int(statm.read().split()[0]) * resource.getpagesize()
