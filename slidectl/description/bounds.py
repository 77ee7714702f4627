"""The bound of the memory that expanding a model may take: macros can make much of little."""

from __future__ import annotations

import contextlib
import resource
from collections.abc import Iterator

MOST_MEMORY = 1 << 30
"""Bytes that a run may take on top of what the process has."""


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
