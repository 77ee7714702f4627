"""`/slidectl/next_change`: answered as soon as what exists has changed, so that a client may keep what it looked up.

A change is a publisher, a subscriber, a service or the name of a parameter that comes or goes. The answer leaves
before that of the call that made the change.
"""

from __future__ import annotations

from slidectl.simulation.pending import Pending


class Changes:
    """Those who wait for the next change."""

    def __init__(self) -> None:
        self._waiting: dict[Pending, None] = {}

    def next(self) -> Pending:
        """Settled by the next change."""
        pending = Pending()
        pending.on_cancel = lambda: self._waiting.pop(pending, None)
        self._waiting[pending] = None
        return pending

    def note(self) -> None:
        """Something has changed."""
        if self._waiting:
            waiting, self._waiting = self._waiting, {}
            for pending in waiting:
                pending.resolve({})


def nobody() -> None:
    """Takes the place of `Changes.note` where nobody asks."""
