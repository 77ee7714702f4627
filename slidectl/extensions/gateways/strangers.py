"""Connections of other users of this machine to a gateway, on asyncio: how they are found, bounded and answered."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from slidectl import web_access

MOST = 10
"""Connections of other users that wait for their refusal at a time; more are cut without a word."""
_LINGER_S = 1.0
_LONGEST = 64 * 1024


class Strangers:
    """The connections of other users that are open at present."""

    def __init__(self, lets_all_in: bool) -> None:
        """With `lets_all_in` nobody is a stranger: clients show a token, or all users may come in."""
        self._lets_all_in = lets_all_in
        self._open: set[object] = set()
        self.refused = 0

    def seen(self, connection: object, transport: asyncio.BaseTransport) -> str:
        """Why a new connection is one of another user, as `web_access.stranger`; empty when it is not."""
        if self._lets_all_in:
            return ""
        peer, here = transport.get_extra_info("peername"), transport.get_extra_info("sockname")
        why = web_access.stranger(peer[:2], here[:2]) if peer and here else "the connection has ended"
        if why:
            self.refused += 1
            self._open.add(connection)
        return why

    def gone(self, connection: object) -> None:
        """Forget a connection that has ended."""
        self._open.discard(connection)

    @property
    def are_many(self) -> bool:
        """True when a connection that was just seen is one too many."""
        return len(self._open) > MOST


async def forbid(why: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Answer an HTTP request with 403. The client gets the answer, since it is read until it hangs up, for a while."""
    body = f"slidectl: {why}\n".encode()
    head = f"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {len(body)}\r\n"
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(_LINGER_S):
            writer.write(f"{head}Connection: close\r\n\r\n".encode() + body)
            writer.write_eof()
            left = _LONGEST
            while left > 0 and (piece := await reader.read(left)):
                left -= len(piece)
