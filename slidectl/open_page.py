"""The page that `slidectl view` serves for a daemon: whether it is open, and where.

The process that serves it holds a lock, whose file has the address. Of several pages the first one holds it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from slidectl import processes
from slidectl.client import windows
from slidectl.paths import InstancePaths, instance


def address_of(paths: InstancePaths) -> str | None:
    """The address of the page that is open for this daemon now, or None."""
    found = processes.listening(paths.page)
    return found.address or None if found is not None else None


@contextmanager
def announced(paths: InstancePaths, address: str) -> Iterator[None]:
    """Other commands name the page by its address in this context, unless another one is open already."""
    held = processes.lock(paths.page)
    if held is None:
        yield
        return
    try:
        os.write(held, address.encode())
        yield
    finally:
        paths.page.unlink(missing_ok=True)
        os.close(held)


def has_page() -> bool:
    """True when the library that draws the page is installed."""
    return find_spec("viser") is not None


def instead_of_window(package: str, words: list[str] | tuple[str, ...], paths: InstancePaths | None) -> list[str]:
    """As `windows.instead`, with the page of the daemon of `paths`, or of the one that the environment chooses."""
    paths = instance() if paths is None else paths
    return windows.instead(package, words, paths, address_of(paths), has_page())
