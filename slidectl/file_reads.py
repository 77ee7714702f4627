"""What a world reads of the machine's files while it runs. A journal notes it, and a replay answers from the journal.

Whatever of the simulation looks at a file asks `read`, so that both have one place to be. Meshes are read otherwise,
since they are not waited for: see `Simulation.read_meshes`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def from_disk(what: str, look: Callable[[], Any]) -> Any:  # noqa: ARG001
    """Look now."""
    return look()


read: Callable[[str, Callable[[], Any]], Any] = from_disk
"""Takes what is looked at, in words, and the function that looks. It gives what JSON can hold, and raises nothing."""
