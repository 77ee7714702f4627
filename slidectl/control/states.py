"""The states of a controller's life, with the words in which the manager lists them."""

from __future__ import annotations

from enum import StrEnum


class State(StrEnum):
    """A controller is in exactly one of these."""

    CONSTRUCTED = "constructed"
    """Never seen by anybody else: the manager lists a controller only after its init."""
    INITIALIZED = "initialized"
    RUNNING = "running"
    STOPPED = "stopped"
    WAITING = "waiting"
    ABORTED = "aborted"
