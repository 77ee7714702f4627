"""TCPROS: connection headers, message frames, and an asyncio connection that uses both.

Received data is limited in length and time, queued data in count and length. What has come and is not whole is limited
over all connections; a length that is only claimed costs nothing. It knows no topic and no service.
"""

from __future__ import annotations

import asyncio
import socket
from collections import deque
from collections.abc import Callable
from itertools import count
from struct import Struct
from typing import Any, TypeVar

from slidectl.errors import Refused, SlidectlError, TimedOut, UsageError
from slidectl.extensions.gateways.strangers import Strangers
from slidectl.operating_system import keepalive
from slidectl.wire.bounds import HeldBytes
from slidectl.wire.json_lines import LONGEST_LINE

T = TypeVar("T")
Fields = dict[str, str]

LONGEST_HEADER = 256 * 1024
LONGEST_MESSAGE = LONGEST_LINE * 3 // 4
"""Bytes of a message: its base64 form must fit into a line to the daemon."""
HANDSHAKE_LIMIT_S = 10.0
SENDER_GONE = "unable to receive data from sender, check sender's logs for details"
"""rospy's text for a connection closed by the other side."""

_MOST_QUEUED = 4000
"""Messages queued for a subscriber: some seconds at 1 kHz, in case other processes occupy the CPU."""
_MOST_QUEUED_BYTES = 8 * 1024 * 1024
_MOST_HELD = 128 * 1024 * 1024
"""Limit of the bytes of messages that are unfinished or not handled, over all connections."""
_WRITE_AHEAD = 64 * 1024
"""Bytes in asyncio's write buffer beyond which messages are queued here."""
_KEEPALIVE = keepalive(60, 10, 9)
"""rospy's values: a vanished host is detected after two and a half minutes."""
_U32 = Struct("<I")


class BadHeader(UsageError):
    """Bytes that are not a valid connection header. The texts are rosgraph's."""


def encode_header(fields: Fields) -> bytes:
    """Encode a header, with its length first."""
    lines = [f"{name}={value}".encode("utf-8", "replace") for name, value in sorted(fields.items())]
    body = b"".join(_U32.pack(len(line)) + line for line in lines)
    return _U32.pack(len(body)) + body


def decode_header(body: bytes) -> Fields:
    """Decode a header, without the length. Raises BadHeader."""
    fields: Fields = {}
    at, size = 0, len(body)
    while at < size:
        if size - at < 4:
            raise BadHeader(f"Invalid line length in handshake header: {size}")
        (length,) = _U32.unpack_from(body, at)
        if not length:
            raise BadHeader("Invalid 0-length handshake header field")
        begin, at = at + 4, at + 4 + length
        if at > size:
            raise BadHeader(f"Invalid line length in handshake header: {size}")
        try:
            name, equals, value = body[begin:at].decode().partition("=")
        except UnicodeDecodeError:
            raise BadHeader("a line of the handshake header is not UTF-8") from None
        if not equals:
            raise BadHeader(f"Invalid line in handshake header: [{name[:200]}]")
        fields[name.strip()] = value
    return fields


def frame(body: bytes) -> bytes:
    """A message with its length first, as it is sent."""
    return _U32.pack(len(body)) + body


class TcprosConnection(asyncio.Protocol):
    """One socket. Each side first sends a header, then messages.

    A message above the length limit is read and discarded, and `on_too_long` is called.
    """

    _serials = count(1)
    _account = HeldBytes(_MOST_HELD)

    def __init__(self, on_header: Callable[[TcprosConnection, Fields], None], has_status: bool = False) -> None:
        """`has_status`: a byte before each message tells success from an error text, as for services."""
        self.on_header = on_header
        self.on_message: Callable[[bytes, bool], None] = lambda _body, _is_done: None
        """Takes the body, and False when it is an error text."""
        self.on_too_long: Callable[[str], None] = lambda _: None
        self.on_closed: Callable[[], None] = lambda: None
        """Called once when the connection has ended, on whichever side."""
        self.on_opened: Callable[[TcprosConnection], None] = lambda _: None
        self.on_gone: Callable[[TcprosConnection], None] = lambda _: None
        """`on_opened` and `on_gone` are for the listener."""
        self.id = next(self._serials)
        self.sent = self.received = 0
        """The number of messages."""
        self.sent_bytes = self.received_bytes = 0
        self.dropped = 0
        """The number of messages dropped because the other side read too slowly."""
        self.is_open = False
        self._is_refused = False
        self._prefix = 1 if has_status else 0
        self._has_header = False
        self._rest = bytearray()
        self._share = self._account.share(lambda _: self.close())
        self._kept = 0
        """Bytes of messages that are whole and not handled yet."""
        self._skip = 0
        self._queue: deque[bytes] = deque()
        self._queued_bytes = 0
        self._may_write = asyncio.Event()
        self._may_write.set()
        self.where = ""
        """The text for getBusInfo."""

    # --- asyncio.Protocol ---------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.is_open = True
        transport.set_write_buffer_limits(high=_WRITE_AHEAD)
        end: socket.socket = transport.get_extra_info("socket")
        end.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # asyncio has set TCP_NODELAY, for everybody
        for option, value in _KEEPALIVE:
            end.setsockopt(socket.IPPROTO_TCP, option, value)
        peer = transport.get_extra_info("peername") or ("", 0)
        own = transport.get_extra_info("sockname") or ("", 0)
        self.where = f"TCPROS connection on port {own[1]} to [{peer[0]}:{peer[1]} on socket {end.fileno()}]"
        self._limit = asyncio.get_running_loop().call_later(HANDSHAKE_LIMIT_S, self.close)
        self.on_opened(self)

    def stranger(self, strangers: Strangers) -> str:
        """Why the connection is one of another user, who may not come in; empty when it is not."""
        return strangers.seen(self, self._transport)

    def connection_lost(self, error: Exception | None) -> None:  # noqa: ARG002
        self._end()

    def pause_writing(self) -> None:
        self._may_write.clear()

    def resume_writing(self) -> None:
        self._may_write.set()
        while self._queue and self._may_write.is_set():
            data = self._queue.popleft()
            self._queued_bytes -= len(data)
            self._write_message(data)

    def data_received(self, data: bytes) -> None:
        self.received_bytes += len(data)
        if self._skip:
            skipped = min(self._skip, len(data))
            self._skip -= skipped
            data = data[skipped:]
        if self._rest:
            self._rest += data
            data = self._rest  # type: ignore[assignment]
        at = self._take_frames(data)
        if data is self._rest:
            del self._rest[:at]
        elif at < len(data):
            self._rest += data[at:]
        self._share.set(len(self._rest) + self._kept, self._kept)

    def keep(self, more: int) -> None:
        """Count bytes of a whole message that is not handled at once; call it with their negative number afterwards."""
        self._kept += more
        if more < 0:
            self._share.handled()
        self._share.set(len(self._rest) + self._kept, self._kept)

    def _take_frames(self, data: bytes) -> int:
        """Process whole frames. Returns the index of the unfinished rest."""
        at, size = 0, len(data)
        while self.is_open:
            begin = at + (self._prefix if self._has_header else 0)
            if size - begin < 4:
                break
            (length,) = _U32.unpack_from(data, begin)
            end = begin + 4 + length
            if not self._has_header:
                if length > LONGEST_HEADER:
                    self.refuse(f"a header of {length} bytes exceeds {LONGEST_HEADER}")
                    return size
                if end > size:
                    break
                at = end
                self._take_header(bytes(data[begin + 4 : end]))
            elif length > LONGEST_MESSAGE:
                self._skip = max(0, end - size)
                at = min(end, size)
                self.on_too_long(f"a message of {length} bytes exceeds {LONGEST_MESSAGE}")
            elif end > size:
                break
            else:
                is_done = not self._prefix or data[at] != 0
                at = end
                self.received += 1
                self._share.handled()
                self.on_message(bytes(data[begin + 4 : end]), is_done)
        return size if self._skip or not self.is_open else at

    def _take_header(self, body: bytes) -> None:
        try:
            fields = decode_header(body)
        except BadHeader as error:
            self.refuse(str(error))
            return
        self._has_header = True
        self._limit.cancel()
        self.on_header(self, fields)

    # --- for those who use it -----------------------------------------------------------------------------------

    @property
    def has_header(self) -> bool:
        """True when the other side's header has come."""
        return self._has_header

    def send_header(self, fields: Fields) -> None:
        """Send this side's header."""
        self.write(encode_header(fields))

    def refuse(self, reason: str) -> None:
        """Send a header with an error text, and end the connection when it has been read."""
        if not self.is_open or self._is_refused:
            return
        self.send_header({"error": reason})
        self._is_refused = True
        self._transport.write_eof()
        self.ignore()
        self._limit.cancel()
        self._limit = asyncio.get_running_loop().call_later(HANDSHAKE_LIMIT_S, self.close)

    def write(self, data: bytes) -> None:
        """Send bytes at once, before any queued messages."""
        if self._is_writable():
            self._transport.write(data)

    def _is_writable(self) -> bool:
        """True when the connection is open and was not refused."""
        return self.is_open and not self._is_refused and not self._transport.is_closing()

    def send(self, data: bytes) -> int:
        """Send a framed message, or queue it. Returns how many older messages were dropped."""
        if not self._is_writable():
            return 0
        if self._may_write.is_set():
            self._write_message(data)
            return 0
        self._queue.append(data)
        self._queued_bytes += len(data)
        lost = 0
        while len(self._queue) > _MOST_QUEUED or (self._queued_bytes > _MOST_QUEUED_BYTES and len(self._queue) > 1):
            self._queued_bytes -= len(self._queue.popleft())
            lost += 1
        self.dropped += lost
        return lost

    async def writable(self) -> None:
        """Wait until most of what was sent has been read."""
        await self._may_write.wait()

    def ignore(self) -> None:
        """Discard everything received from now on."""
        self._has_header, self._skip = True, 1 << 62

    def pause_reading(self) -> None:
        """Stop reading until `resume_reading`; data read before is still processed."""
        if self.is_open:
            self._transport.pause_reading()

    def resume_reading(self) -> None:
        """Start reading again."""
        if self.is_open:
            self._transport.resume_reading()

    def close(self) -> None:
        """End the connection: at once if the other side does not read, else after sending what is buffered."""
        if self.is_open:
            if self._may_write.is_set():
                self._transport.close()
            else:
                self._transport.abort()
            self._end()

    def _write_message(self, data: bytes) -> None:
        self.sent += 1
        self.sent_bytes += len(data)
        self._transport.write(data)

    def _end(self) -> None:
        if self.is_open:
            self.is_open = False
            self._limit.cancel()
            self._queue.clear()
            self._rest.clear()
            self._share.close()
            self._may_write.set()
            self.on_gone(self)
            self.on_closed()


class OutgoingConnection:
    """A connection opened by this side, for one task that waits for the answer. Use `connect`.

    `check` takes the other side's header before any message, and raises SlidectlError to reject it.
    """

    def __init__(self, has_status: bool, check: Callable[[Fields], None]) -> None:
        self._check = check
        self._header: asyncio.Future[Fields] = asyncio.get_running_loop().create_future()
        self._answer: asyncio.Future[tuple[bytes, bool]] = asyncio.get_running_loop().create_future()
        self.closed = asyncio.Event()
        self.connection = TcprosConnection(self._take_header, has_status)
        self.connection.on_closed = self._take_end

    @classmethod
    async def connect(
        cls,
        host: str,
        port: int,
        fields: Fields,
        has_status: bool = False,
        check: Callable[[Fields], None] = lambda _: None,
    ) -> OutgoingConnection:
        """Connect and send the header. Raises Refused, TimedOut."""
        made = cls(has_status, check)
        loop = asyncio.get_running_loop()
        try:
            await asyncio.wait_for(loop.create_connection(lambda: made.connection, host, port), HANDSHAKE_LIMIT_S)
        except TimeoutError:
            raise TimedOut(f"{host}:{port} did not answer within {HANDSHAKE_LIMIT_S:g} s") from None
        except (OSError, UnicodeError, OverflowError) as error:
            raise Refused(f"no connection to {host}:{port}: {getattr(error, 'strerror', None) or error}") from None
        made.connection.send_header(fields)
        return made

    async def header(self) -> Fields:
        """Wait for the other side's header. Raises SlidectlError: it has an error, is rejected, or did not arrive."""
        return await self._header

    async def exchange(self, request: bytes) -> tuple[bytes, bool]:
        """Send a request and wait for the answer of a service; False when the answer is an error text.

        Raises Refused: the other side disconnected, or the answer is too long.
        """
        self.connection.on_message = lambda body, is_done: _settle(self._answer, (body, is_done))
        self.connection.on_too_long = lambda reason: _fail(self._answer, Refused(reason))
        self.connection.write(request)
        return await self._answer

    def _take_header(self, _: TcprosConnection, fields: Fields) -> None:
        try:
            if "error" in fields:
                raise Refused(f"remote error reported: {fields['error']}")
            self._check(fields)
        except SlidectlError as error:
            _fail(self._header, error)
            self.connection.close()
        else:
            _settle(self._header, fields)

    def _take_end(self) -> None:
        self.closed.set()
        _fail(self._header, Refused(SENDER_GONE))
        _fail(self._answer, Refused(f"transport error completing service call: {SENDER_GONE}"))


def _settle(future: asyncio.Future[T], value: T) -> None:
    if not future.done():
        future.set_result(value)


def _fail(future: asyncio.Future[Any], error: SlidectlError) -> None:
    if not future.done():
        future.set_exception(error)
        future.exception()  # marks the exception as retrieved: possibly no task waits for it
