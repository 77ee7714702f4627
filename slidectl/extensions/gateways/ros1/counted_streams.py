"""asyncio's streams, with what has come and is not handled counted in an account of all connections."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from slidectl.wire.bounds import HeldBytes

_AHEAD = 64 * 1024
"""Reading stops at twice as many unread bytes, unless more are waited for."""
_BACKLOG = 1000

Serve = Callable[["CountedReader", asyncio.StreamWriter], Coroutine[Any, Any, None]]


class GivenUp(ConnectionError):
    """The connection holds too much: `bounds.HeldBytes` has chosen it."""


class CountedReader(asyncio.StreamReader):
    """A reader that counts its bytes from their arrival until `handled`. A length that is only claimed costs nothing.

    Reading raises GivenUp when all connections together hold too much, and this one most for longest.
    """

    def __init__(self, account: HeldBytes) -> None:
        super().__init__(limit=_AHEAD)
        self.received = 0
        """Bytes, in all."""
        self.on_end: Callable[[Exception | None], object] = _ignore
        """Called when the other side has disconnected (None, or an error), or the connection is given up (GivenUp)."""
        self._handled = self._in_hand = 0
        self._share = account.share(lambda reason: self.set_exception(GivenUp(reason)))

    def feed_data(self, data: Any) -> None:
        self.received += len(data)
        self._count()  # first: it may raise in who waits, whom data would only wake
        super().feed_data(data)

    def feed_eof(self) -> None:
        super().feed_eof()
        self.on_end(None)

    def set_exception(self, exc: Exception) -> None:
        super().set_exception(exc)
        self.on_end(exc)

    async def readexactly(self, n: int) -> bytes:
        data = await super().readexactly(n)
        self._in_hand += n
        self._count()
        return data

    async def readuntil(self, separator: Any = b"\n") -> bytes:
        data = await super().readuntil(separator)
        self._in_hand += len(data)
        return data

    async def discard(self, count: float) -> None:
        """Read `count` bytes (`inf`: all until the end) and forget them. Raises EOFError, GivenUp."""
        while count > 0:
            piece = await self.read(int(min(_AHEAD, count)))
            if not piece:
                raise EOFError
            count -= len(piece)
            self._handled += len(piece)
            self._count()

    def handled(self) -> None:
        """Count what was read no longer."""
        self._handled += self._in_hand
        self._in_hand = 0
        self._share.handled()
        self._count()

    def close(self) -> None:
        """Count nothing any more, and end the cycles of references that would keep the buffer for a while."""
        self._share.close()
        self.on_end = self._share.give_up = _ignore
        if self.exception() is not None:
            super().set_exception(EOFError())  # in place of one whose traceback refers to this reader

    def _count(self) -> None:
        self._share.set(self.received - self._handled, self._in_hand)


def _ignore(_: object) -> None:
    pass


async def listen(host: str, port: int, account: HeldBytes, serve: Serve) -> asyncio.Server:
    """Listen, and run `serve` for each connection. Raises OSError."""

    def protocol() -> asyncio.StreamReaderProtocol:
        return asyncio.StreamReaderProtocol(CountedReader(account), serve)  # type: ignore[arg-type]

    loop = asyncio.get_running_loop()
    return await loop.create_server(protocol, host, port, reuse_address=True, backlog=_BACKLOG)


async def connect(host: str, port: int, account: HeldBytes) -> tuple[CountedReader, asyncio.StreamWriter]:
    """Connect. Raises OSError, UnicodeError or OverflowError (no such host or port)."""
    loop = asyncio.get_running_loop()
    reader = CountedReader(account)
    protocol = asyncio.StreamReaderProtocol(reader)
    transport, _ = await loop.create_connection(lambda: protocol, host, port)
    return reader, asyncio.StreamWriter(transport, protocol, reader, loop)
