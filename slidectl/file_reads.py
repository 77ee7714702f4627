"""File accesses of a running world. A journal records the results, and a replay answers from the journal.

Every part of the simulation that looks at a file calls `read`, so that journal and replay work in one place. Meshes
are an exception, as they are read in the background: see `Simulation.read_meshes`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from slidectl.errors import Refused, SlidectlError


def from_disk(what: str, look: Callable[[], Any]) -> Any:  # noqa: ARG001
    """Call `look` and return its result."""
    return look()


read: Callable[[str, Callable[[], Any]], Any] = from_disk
"""Takes a description of what is read, and the function that reads it. That returns JSON values and never raises."""


def read_or_raise(what: str, look: Callable[[], Any]) -> Any:
    """As `read`, for a `look` that may raise a SlidectlError; a replay raises a Refused with its text.

    Calls of `read` inside `look` are not recorded by themselves.
    """
    raised: list[SlidectlError] = []

    def look_and_tell() -> tuple[Any, str]:
        global read
        outer, read = read, from_disk
        try:
            return look(), ""
        except SlidectlError as error:
            raised.append(error)
            return None, str(error)
        finally:
            read = outer

    found, trouble = read(what, look_and_tell)
    if trouble:
        raise raised[0] if raised else Refused(trouble)
    return found
