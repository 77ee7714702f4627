"""A slider on a page, for the tests of the page."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from daemon_fixture import running_daemon
from page_browser import CommandLine, PageBrowser, served_page, spawn_slider


@pytest.fixture(scope="module")
def world() -> Iterator[CommandLine]:
    """A paused slider with its controller: what stands still is drawn once."""
    with running_daemon(paused=True) as runtime:
        command = CommandLine(runtime.folder)
        spawn_slider(command)
        yield command


@pytest.fixture(scope="module")
def page(world: CommandLine) -> Iterator[str]:
    """The address of a page that shows the world."""
    with served_page(world) as url:
        yield url


@pytest.fixture
def browser(page: str) -> Iterator[PageBrowser]:
    """A browser that has the page open."""
    with PageBrowser(page) as one:
        yield one
