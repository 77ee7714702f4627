"""What a world reads of the machine's files while it runs. A journal notes it, and a replay answers from the journal.

Whatever of the simulation looks at a file asks `read`, so that both have one place to be. Meshes are read otherwise,
since they are not waited for: see `Simulation.read_meshes`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from slidectl.errors import Refused, SlidectlError


def from_disk(what: str, look: Callable[[], Any]) -> Any:  # noqa: ARG001
    """Look now."""
    return look()


read: Callable[[str, Callable[[], Any]], Any] = from_disk
"""Takes what is looked at, in words, and the function that looks. It gives what JSON can hold, and raises nothing."""


def read_or_raise(what: str, look: Callable[[], Any]) -> Any:
    """The same of what may raise a SlidectlError; that of a replay is a Refused with its text.

    What `look` reads in its turn is a part of what it finds.
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
