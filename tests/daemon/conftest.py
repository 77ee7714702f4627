"""A paused daemon for a whole file of tests, raw connections to it, and folders for those who start their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from daemon_fixture import Runtime, running_daemon
from rosbridge_wire import Wire


@pytest.fixture(scope="module")
def daemon() -> Iterator[Runtime]:
    """A daemon that stands still until it is told to step."""
    with running_daemon(paused=True) as runtime:
        yield runtime


@pytest.fixture
def connect(daemon: Runtime) -> Iterator[Callable[[], Wire]]:
    """Makes raw connections to `daemon`, closed at the end of the test."""
    with ExitStack() as stack:
        yield lambda: stack.enter_context(Wire(daemon.paths.socket))


@pytest.fixture
def wire(connect: Callable[[], Wire]) -> Wire:
    """One raw connection to `daemon`."""
    return connect()


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    """A runtime folder in which nothing runs yet; whatever is started there is ended."""
    runtime = Runtime()
    try:
        yield runtime
    finally:
        runtime.remove()
