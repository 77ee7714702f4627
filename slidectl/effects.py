"""What a service does: it is said where the service is advertised, and a connection may be restricted to some effects.

Gateways restrict the connections of their clients. docs/security.md says who may do what. Standard library only.
"""

from __future__ import annotations

from collections.abc import Collection
from enum import StrEnum

from slidectl.errors import SlidectlError


class Effect(StrEnum):
    """The most that a service does. Services of other programs have WRITES unless they say otherwise."""

    READS = "reads"
    """It changes nothing."""
    WRITES = "writes"
    """It changes the world: robots, controllers, parameters, time."""
    FILES = "files"
    """It reads or writes files that the caller names, with the rights of the daemon's owner."""
    CODE = "code"
    """It runs code that the caller names, with the rights of the daemon's owner."""


EVERYTHING = frozenset(Effect)
_SAID = {
    Effect.READS: "reads the world",
    Effect.WRITES: "changes the world",
    Effect.FILES: "uses files that the caller names",
    Effect.CODE: "runs code that the caller names",
}


class NotPermitted(SlidectlError):
    """A connection may not do this: it was restricted to `permitted` effects."""

    def __init__(self, what: str, effect: Effect, permitted: Collection[Effect]) -> None:
        hint = f"permitted here: {', '.join(each for each in Effect if each in permitted) or 'nothing'}"
        if Effect.WRITES in permitted:
            hint += f"; a gateway that is started with --allow {effect} permits it"
        else:
            hint += "; the gateway was started with --read-only"
        super().__init__(f"{what} {_SAID[effect]}, which is not permitted on this connection", hint)
