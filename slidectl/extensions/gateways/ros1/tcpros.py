"""TCPROS: connection headers, message frames, and a connection that uses both.

Received data is limited in length and time, queued data in count and length. What has come and is not handled is
limited over all connections. It knows no topic and no service.
"""

from __future__ import annotations

import asyncio
import math
import socket
from collections import deque
from contextlib import suppress
from itertools import count
from struct import Struct

from slidectl.errors import Refused, TimedOut, UsageError
from slidectl.extensions.gateways.ros1 import counted_streams
from slidectl.extensions.gateways.ros1.counted_streams import CountedReader
from slidectl.operating_system import keepalive
from slidectl.wire.bounds import HeldBytes
from slidectl.wire.json_lines import LONGEST_LINE

Fields = dict[str, str]

LONGEST_HEADER = 256 * 1024
LONGEST_MESSAGE = LONGEST_LINE * 3 // 4
"""Bytes of a message: its base64 form must fit into a line to the daemon."""
HANDSHAKE_LIMIT_S = 10.0
SENDER_GONE = "unable to receive data from sender, check sender's logs for details"
"""rospy's text for a connection closed by the other side."""
HELD = HeldBytes(128 * 1024 * 1024)
"""The bytes that have come and are not handled, of all connections of this process."""

ANY_MD5 = "*"
"""The md5 sum of a client that takes any type."""

_MOST_QUEUED = 4000
"""Messages queued for a subscriber: some seconds at 1 kHz, in case other processes occupy the CPU."""
_MOST_QUEUED_BYTES = 8 * 1024 * 1024
_WRITE_AHEAD = 64 * 1024
"""Bytes in asyncio's write buffer beyond which messages are queued here."""
_KEEPALIVE = keepalive(60, 10, 9)
"""rospy's values: a vanished host is detected after two and a half minutes."""
_U32 = Struct("<I")


class BadHeader(UsageError):
    """Bytes that are no valid connection header. The texts are rosgraph's."""


class MessageTooLong(Refused):
    """A message above the limit, which was discarded."""


def encode_header(fields: Fields) -> bytes:
    """Encode a header, with its length first."""
    lines = [f"{name}={value}".encode("utf-8", "replace") for name, value in sorted(fields.items())]
    return frame(b"".join(map(frame, lines)))


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


def check_has(header: Fields, *required: str) -> None:
    """Raise Refused, with rospy's text, for a header without one of these fields."""
    for name in required:
        if name not in header:
            raise Refused(f"Missing required '{name}' field")


def frame(body: bytes) -> bytes:
    """A message with its length first, as it is sent."""
    return _U32.pack(len(body)) + body


class TcprosConnection:
    """One socket. Each side first sends a header, then messages. Reading raises EOFError or OSError at its end."""

    _serials = count(1)

    def __init__(self, reader: CountedReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.id = next(self._serials)
        self.sent = self.sent_bytes = self.received = 0
        """Messages sent, their bytes, and messages received."""
        self.has_header = False
        """True when the other side's header has come."""
        self._writer = writer
        self._is_refused = False
        self._queue: deque[bytes] = deque()
        self._queued_bytes = 0
        self._flushing: asyncio.Task[None] | None = None
        writer.transport.set_write_buffer_limits(high=_WRITE_AHEAD)
        end: socket.socket = writer.get_extra_info("socket")
        end.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # asyncio has set TCP_NODELAY, for everybody
        for option, value in _KEEPALIVE:
            end.setsockopt(socket.IPPROTO_TCP, option, value)
        peer = writer.get_extra_info("peername") or ("", 0)
        own = writer.get_extra_info("sockname") or ("", 0)
        self.where = f"TCPROS connection on port {own[1]} to [{peer[0]}:{peer[1]} on socket {end.fileno()}]"
        """The text for getBusInfo."""

    # --- receiving ----------------------------------------------------------------------------------------------

    async def read_header(self) -> Fields:
        """Read the other side's header. Raises BadHeader, TimeoutError."""
        async with asyncio.timeout(HANDSHAKE_LIMIT_S):
            (length,) = _U32.unpack(await self.reader.readexactly(4))
            if length > LONGEST_HEADER:
                raise BadHeader(f"a header of {length} bytes; the maximum is {LONGEST_HEADER}")
            fields = decode_header(await self.reader.readexactly(length))
        self.has_header = True
        self.reader.handled()
        return fields

    async def read_message(self) -> bytes:
        """Read a message; call `reader.handled` when it is handled. Raises MessageTooLong."""
        (length,) = _U32.unpack(await self.reader.readexactly(4))
        if length > LONGEST_MESSAGE:
            await self.reader.discard(length)
            raise MessageTooLong(f"a message of {length} bytes; the maximum is {LONGEST_MESSAGE}")
        body = await self.reader.readexactly(length)
        self.received += 1
        return body

    async def discard(self) -> None:
        """Discard everything that comes, until the end."""
        self.has_header = True
        await self.reader.discard(math.inf)

    # --- sending ------------------------------------------------------------------------------------------------

    def send_header(self, fields: Fields) -> None:
        """Send this side's header."""
        self._write(encode_header(fields))

    async def refuse(self, reason: str) -> None:
        """Send a header with an error text, and wait until it has been read, for a limited time."""
        self.send_header({"error": reason.replace("\n", "; ")})
        self._is_refused = True
        with suppress(OSError, TimeoutError):
            self._writer.write_eof()
            async with asyncio.timeout(HANDSHAKE_LIMIT_S):
                await self.discard()

    async def write(self, data: bytes) -> None:
        """Send bytes, and wait until most of what was sent has been read."""
        self._write(data)
        await self._writer.drain()

    def send(self, data: bytes) -> int:
        """Send a framed message, or queue it. Returns how many older messages were dropped."""
        if self._flushing is None:
            if self._writer.transport.get_write_buffer_size() <= _WRITE_AHEAD:
                self._write_message(data)
                return 0
            self._flushing = asyncio.get_running_loop().create_task(self._flush())
        self._queue.append(data)
        self._queued_bytes += len(data)
        lost = 0
        while len(self._queue) > _MOST_QUEUED or (self._queued_bytes > _MOST_QUEUED_BYTES and len(self._queue) > 1):
            self._queued_bytes -= len(self._queue.popleft())
            lost += 1
        return lost

    async def _flush(self) -> None:
        with suppress(OSError):  # the other side has disconnected
            while self._queue:
                await self._writer.drain()
                data = self._queue.popleft()
                self._queued_bytes -= len(data)
                self._write_message(data)
            self._flushing = None

    def _write_message(self, data: bytes) -> None:
        if self._write(data):
            self.sent += 1
            self.sent_bytes += len(data)

    def _write(self, data: bytes) -> bool:
        is_writable = not self._is_refused and not self._writer.is_closing()
        if is_writable:
            self._writer.write(data)
        return is_writable

    def close(self) -> None:
        """End the connection: at once if the other side does not read, else after sending what is buffered."""
        self.reader.close()
        if self._flushing is not None:
            self._flushing.cancel()
        if self._writer.transport.get_write_buffer_size() > _WRITE_AHEAD:
            self._writer.transport.abort()
        else:
            self._writer.close()


async def connect(host: str, port: int, fields: Fields) -> tuple[TcprosConnection, Fields]:
    """Connect, and exchange the headers. Raises Refused, with the reason of the other side; BadHeader, TimedOut."""
    try:
        async with asyncio.timeout(HANDSHAKE_LIMIT_S):
            connection = TcprosConnection(*await counted_streams.connect(host, port, HELD))
    except TimeoutError:
        raise TimedOut(f"{host}:{port} did not answer within {HANDSHAKE_LIMIT_S:g} s") from None
    except (OSError, UnicodeError, OverflowError) as error:
        raise Refused(f"no connection to {host}:{port}: {getattr(error, 'strerror', None) or error}") from None
    try:
        connection.send_header(fields)
        header = await connection.read_header()
        if "error" in header:
            raise Refused(f"remote error reported: {header['error']}")
    except (OSError, EOFError, TimeoutError):
        connection.close()
        raise Refused(SENDER_GONE) from None
    except BaseException:
        connection.close()
        raise
    return connection, header
