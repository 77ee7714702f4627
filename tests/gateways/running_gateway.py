"""A gateway in a process of its own, on any port that is free, for a daemon of tests/daemon_fixture.py."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from daemon_fixture import Runtime

from slidectl.extensions.gateways import process


@contextmanager
def running_gateway(runtime: Runtime, kind: str, **options: Any) -> Iterator[str]:
    """Gives its address, such as ws://localhost:4711. It must still run at the end, and end when it is told to."""
    with runtime.environment():
        running, _ = process.start(runtime.paths, kind, {"port": 0, **options})
    try:
        yield running.address
        with runtime.environment():
            assert process.find(runtime.paths, kind) == running, log(runtime, kind)
    finally:
        with runtime.environment():
            process.stop(runtime.paths, kind)


def log(runtime: Runtime, kind: str) -> str:
    """What it has written."""
    with runtime.environment():
        return process.log_file(runtime.paths, kind).read_text(encoding="utf-8")
