"""A WebSocket connection of a server that bounds what is unfinished: handshakes, frames, messages and their queue.

The gateways and the page use it. It does not decide who may connect.
"""

from __future__ import annotations

import asyncio
import http
import ssl
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.frames import DATA_OPCODES, Frame
from websockets.http11 import Request, Response
from websockets.protocol import OPEN, Event

from slidectl.wire.bounds import HeldBytes

HANDSHAKE_S = 10.0
"""How long a client may take for its handshake, and before that for the one of TLS."""
CLOSE_S = 2.0
"""How long a client may take to close its side."""
_LONGEST_HANDSHAKE = 64 * 1024
_MOST_WAITING = 1024 * 1024
"""Bytes of whole messages that wait to be handled, at which reading stops."""
_FRAME_BYTES = 400
"""What a frame costs in addition to its data: a client may send millions of empty ones."""
_COPIES = 2
"""How often a message is in memory while it is handled: as it came, and as what is made of it."""
_MOST_FRAMES = 10_000
"""Frames of one message."""
_PIECE = 8192
"""Received bytes that are handled at a time. Unpacked they become a thousand times as much at the most."""
_TOO_BIG = 1009
TRY_LATER = 1013
"""The close code of a server that has too much to do."""
_LONGEST_REASON = 120

Judge = Callable[[ServerConnection, Request], Response | None]


class ConnectionBounds:
    """What all connections of a server share: the account of bytes, and the places."""

    def __init__(self, most_bytes: int, most_places: int, tls: ssl.SSLContext | None = None) -> None:
        """`most_places` counts all connections, before, during and after their handshakes.

        With `tls` the server itself listens without TLS: a connection has its place before the handshake of TLS.
        """
        self.held = HeldBytes(most_bytes)
        self.tls = tls
        self._most_places = most_places
        self._places: dict[BoundedConnection, asyncio.Transport] = {}
        """In the order in which they came."""

    @property
    def open(self) -> int:
        """The number of connections between their handshake and their end."""
        return sum(one.is_open for one in self._places)

    def admit(self, connection: BoundedConnection, transport: asyncio.Transport) -> None:
        """Give a new connection its place. The oldest that is not open loses its own when there are too many."""
        self._places[connection] = transport
        if len(self._places) > self._most_places:
            oldest = next((one for one in self._places if not one.is_open), connection)
            self._places.pop(oldest).abort()

    def forget(self, connection: BoundedConnection) -> None:
        """Free the place of a connection that has ended."""
        self._places.pop(connection, None)


class BoundedConnection(ServerConnection):
    """A connection of a client. Reading stops while much of it waits to be handled.

    When all connections of the server hold too much, the worst is closed with 1013.
    """

    def __init__(self, *args: Any, bounds: ConnectionBounds, **options: Any) -> None:
        super().__init__(*args, **{**options, "max_queue": None})  # this class itself stops reading, by bytes
        self._bounds = bounds
        self._share = bounds.held.share(self._give_up)
        self._is_made = False
        self._is_answered = False
        self._is_given_up = False
        """True when nothing that comes is of interest any more."""
        self._head = 0
        """Bytes of the handshake's request."""
        self._rest = bytearray()
        """What has come and is not parsed, while reading is stopped."""
        self._frames = self._unfinished = 0
        """The number and bytes of the whole frames of a message whose last frame has not come."""
        self._last: Frame | None = None
        """The last frame that came. The library's parser keeps it until the next one comes."""
        self._whole: deque[tuple[int, Frame]] = deque()
        """Bytes and last frame of each message that waits to be handled."""
        self._waiting = 0
        """Their sum."""
        self._in_hand = 0
        """Bytes of the message that is being handled."""
        self._stops: set[str] = set()
        """Why reading is stopped."""
        self._tls_task: asyncio.Task[None] | None = None
        self._cut: asyncio.TimerHandle | None = None

    @property
    def is_open(self) -> bool:
        """True between the handshake and the closing of the connection."""
        return self._is_made and self.protocol.state is OPEN

    # --- asyncio.Protocol ---------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        plain = cast(asyncio.Transport, transport)
        self._bounds.admit(self, plain)
        if self._bounds.tls is None:
            self._begin(plain)
        else:
            plain.pause_reading()  # until TLS reads
            self._tls_task = self.loop.create_task(self._start_tls(plain, self._bounds.tls))

    async def _start_tls(self, plain: asyncio.Transport, tls: ssl.SSLContext) -> None:
        try:
            secured = await self.loop.start_tls(
                plain,
                self,
                tls,
                server_side=True,
                ssl_handshake_timeout=HANDSHAKE_S,
                ssl_shutdown_timeout=CLOSE_S,
            )
        except OSError:  # no TLS, a version that is not offered, too slow, or disconnected
            secured = None
        if secured is None or secured.is_closing():
            plain.abort()
            self.connection_lost(None)  # asyncio does not say it of a handshake that failed
            return
        self._begin(secured)

    def _begin(self, transport: asyncio.Transport) -> None:
        self._is_made = True
        super().connection_made(transport)
        # The frames are freed with the handler: the connection itself is part of cycles, and may stay for minutes.
        self.server.handlers[self].add_done_callback(lambda _: self._discard())

    def connection_lost(self, exc: Exception | None) -> None:
        self._bounds.forget(self)
        self._share.close()
        if self._cut is not None:
            self._cut.cancel()
        if self._is_made:
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._rest += data
        self._feed()

    def eof_received(self) -> None:
        self._feed(is_all=True)
        super().eof_received()

    def _feed(self, is_all: bool = False) -> None:
        """Handle what has come, until reading is stopped."""
        while self._rest and not self._is_given_up and (is_all or not self._stops):
            piece = bytes(self._rest[:_PIECE])
            del self._rest[:_PIECE]
            if self.request is None:
                self._head += len(piece)
                if self._head > _LONGEST_HANDSHAKE:
                    self._refuse("the request is too long")
                    return
            super().data_received(piece)
            if self.protocol.close_expected():
                self._cut_soon()
            if self._waiting > _MOST_WAITING:
                self.stop_reading("waiting")
            if self._frames > _MOST_FRAMES:
                self.end_at_once(_TOO_BIG, f"a message of more than {_MOST_FRAMES} frames")
        self._count()

    def process_event(self, event: Event) -> None:
        super().process_event(event)
        if isinstance(event, Request):
            self._head = 0
        elif isinstance(event, Frame) and event.opcode in DATA_OPCODES:
            self._last = event
            self._unfinished += len(event.data) + _FRAME_BYTES
            self._frames += 1
            if event.fin:
                self._whole.append((self._unfinished, event))
                self._waiting += self._unfinished
                self._frames = self._unfinished = 0

    def send_data(self) -> None:
        if self.request is None and self.protocol.handshake_exc is not None and self._head:
            self._answer_bad_request("the request is not HTTP/1.1, or not one that browsers send")
        super().send_data()

    # --- reading ------------------------------------------------------------------------------------------------

    async def recv(self, decode: bool | None = None) -> Any:
        """Receive a message; the one before counts as handled."""
        if self._in_hand:
            self._in_hand = 0
            self._share.handled()
            self._count()
        try:
            message = await super().recv(decode)
        except AssertionError:  # the library: more frames have come in the moment in which the handler is cancelled
            if self._is_given_up:
                raise asyncio.CancelledError from None
            raise
        size, last = self._whole.popleft()
        self._waiting -= size
        self._in_hand = _COPIES * size
        last.data = b""  # it may be the one that the parser keeps
        if self._waiting <= _MOST_WAITING // 2:
            self.go_on_reading("waiting")
        return message

    def stop_reading(self, why: str) -> None:
        """Stop reading until `go_on_reading` was called for each reason."""
        self._stops.add(why)
        self.transport.pause_reading()

    def go_on_reading(self, why: str) -> None:
        """Read again, unless reading is stopped for another reason."""
        if why in self._stops:
            self._stops.discard(why)
            self._feed()
            if not self._stops:
                self.transport.resume_reading()

    def _count(self) -> None:
        unparsed = self._head + len(self._rest) + len(self.protocol.reader.buffer)
        whole = self._waiting + self._in_hand
        self._share.set(unparsed + self._unfinished + whole, whole)

    # --- ending -------------------------------------------------------------------------------------------------

    def _give_up(self, reason: str) -> None:
        self.end_at_once(TRY_LATER, reason)

    def end_at_once(self, code: int, reason: str) -> None:
        """Close without waiting, and discard what has come of an unfinished message."""
        self._is_given_up = True
        self._share.close()
        if not self.is_open:
            self._bounds.forget(self)
            if self._is_made:
                self.transport.abort()
            return
        self.protocol.fail(code, cut_reason(reason))
        super().send_data()
        self._cut_soon()
        self._rest.clear()
        # What the handler holds is freed now, and not when the client has closed. Then `_discard` frees the rest: the
        # handler may be about to take a message from the queue.
        self.server.handlers[self].cancel()

    def _discard(self) -> None:
        """Free what nobody will handle. The library has no way for that; a test measures the memory."""
        self._rest.clear()
        self._whole.clear()
        if self._last is not None:
            self._last.data = b""
        self.recv_messages.frames.queue.clear()

    def _cut_soon(self) -> None:
        """Give the client a while to close its side."""
        if self._cut is None:
            self._cut = self.loop.call_later(min(CLOSE_S, self.close_timeout or CLOSE_S), self.transport.abort)

    def _refuse(self, text: str) -> None:
        self._is_given_up = True
        self._answer_bad_request(text)
        if self.transport.can_write_eof():
            self.transport.write_eof()
        else:
            self.transport.close()
        self._cut_soon()

    def _answer_bad_request(self, text: str) -> None:
        if not self._is_answered:
            self._is_answered = True
            self.transport.write(bad_request(text).serialize())


def bad_request(text: str) -> Response:
    """The answer to a request that is not valid."""
    body = f"slidectl: {text}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Connection": "close"})
    headers["Content-Length"] = str(len(body))
    return Response(http.HTTPStatus.BAD_REQUEST, "Bad Request", headers, body)


def answering_bad_requests(judge: Judge) -> Judge:
    """Let `judge` be asked about requests; one that it cannot read is answered with 400."""

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        try:
            for name, value in request.headers.raw_items():
                if name.lower().startswith("sec-websocket-"):
                    value.encode("ascii")
            return judge(connection, request)
        except (ValueError, LookupError, OSError):  # a header twice, a bad address or escape, a name of no file
            return bad_request("the address or a header of the request is not valid")

    return answer


def cut_reason(text: str) -> str:
    """A text, cut to the length of a close frame."""
    return text.encode()[:_LONGEST_REASON].decode(errors="ignore")
