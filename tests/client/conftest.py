"""A paused daemon for a whole file of tests, clients of it, and a folder in which a test starts its own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from daemon_fixture import Runtime, running_daemon

from slidectl.client import Client


@pytest.fixture(scope="module")
def daemon() -> Iterator[Runtime]:
    """A daemon that stands still until it is told to step."""
    with running_daemon(paused=True) as runtime:
        yield runtime


@pytest.fixture
def client(daemon: Runtime) -> Iterator[Client]:
    """A client of `daemon`."""
    with daemon.client() as client:
        yield client


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    """A runtime folder in which nothing runs yet; whatever is started there is ended."""
    runtime = Runtime()
    try:
        yield runtime
    finally:
        runtime.remove()
