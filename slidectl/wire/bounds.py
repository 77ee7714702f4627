"""Bytes that connections have sent and that are not handled yet, with a bound on their sum.

A connection counts what has come, not what it claims to send. When all of them together hold more than the bound, the
one that holds most for longest is given up. It knows no protocol.
"""

from __future__ import annotations

import time
from collections.abc import Callable

_WHOLE_SHARE = 1 / 8
"""How much a byte of a whole message weighs that is being handled: its sender cannot make that quicker."""
_YOUNG_S = 1.0
"""Added to each age, so that among those that have just begun the number of bytes decides."""


class HeldBytes:
    """The account of all connections of a process."""

    def __init__(self, most: int, kind: str = "unfinished", now: Callable[[], float] = time.monotonic) -> None:
        """`most` is the bound in bytes, `kind` what they are, for the reason; `now` returns seconds."""
        self.most = most
        self.kind = kind
        self.sum = 0
        """What is held at present, in bytes."""
        self.given_up = 0
        """The number of shares that were given up."""
        self.now = now
        self._shares: set[HeldShare] = set()

    def share(self, give_up: Callable[[str], None]) -> HeldShare:
        """A new share, with nothing in it. `give_up` takes a reason; it discards what is held."""
        return HeldShare(self, give_up)

    def change(self, share: HeldShare, count: int) -> None:
        """Count what a share holds from now on, and give up the worst until the sum is within the bound."""
        if not share.count:
            share.since = self.now()
        more = count - share.count
        self.sum += more
        share.count = count
        if count:
            self._shares.add(share)
        else:
            self._shares.discard(share)
        while more > 0 and self.sum > self.most:
            self._give_up_worst()

    def _give_up_worst(self) -> None:
        now = self.now()
        worst = max(self._shares, key=lambda share: share.weight * (now - share.since + _YOUNG_S))
        held = worst.count
        worst.close()
        self.given_up += 1
        mib = self.most / 2**20
        worst.give_up(f"more than {mib:g} MiB of {self.kind} data in all, {held} bytes of it from this connection")


class HeldShare:
    """What one connection holds."""

    def __init__(self, account: HeldBytes, give_up: Callable[[str], None]) -> None:
        self.give_up = give_up
        self.count = 0
        """In bytes."""
        self.weight = 0.0
        self.since = 0.0
        """The time since which it holds something."""
        self._account = account
        self._is_closed = False

    def set(self, count: int, whole: int = 0) -> None:
        """Say how many bytes are held now, and how many of them are of whole messages.

        This may give up any connection, this one too.
        """
        self.weight = count - whole + _WHOLE_SHARE * whole
        if count != self.count and not self._is_closed:
            self._account.change(self, count)

    def handled(self) -> None:
        """Say that something whole was handled: the connection is not a slow one."""
        self.since = self._account.now()

    def close(self) -> None:
        """Count nothing any more."""
        self.set(0)
        self._is_closed = True
