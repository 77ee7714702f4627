"""One client's socket: bytes in, lines on to its session; its session's lines out as fast as it takes them.

Never waits: what the kernel does not take stays in the outbox. Knows lines, not operations.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from slidectl.client.lines import BadLine, LineBuffer
from slidectl.daemon.loop import HANG_UP, ONCE, PEER_CLOSED, READ, WRITE, EventLoop
from slidectl.daemon.outbox import Outbox, Publications

_CHUNK = 64 * 1024
_SERVED_A_TURN_S = 0.002
_SENT_A_TURN = 256 * 1024
_MOST_UNREAD = 1024 * 1024


class Receiver(Protocol):
    """What a connection talks to: a session."""

    @property
    def waiting(self) -> bool:
        """True while something may still be sent to a client that will send no more."""

    def take(self, line: bytes) -> None:
        """One whole line."""

    def refuse(self, error: BadLine) -> None:
        """The stream is broken; the connection ends after what this sends."""

    def report(self, topic: str, dropped: int) -> bytes:
        """The line that tells of dropped messages."""

    def closed(self) -> None:
        """The connection is gone."""

    def unexpected(self, what: str) -> None:
        """The exception that is being handled is a fault of ours: log it."""


class Busy:
    """Connections that have more to do before the loop may wait, in order."""

    def __init__(self) -> None:
        self.with_input: dict[Connection, None] = {}
        self.with_output: dict[Connection, None] = {}
        self.with_messages: dict[Any, None] = {}
        """Readers of topics that have new messages."""

    def forget(self, connection: Connection) -> None:
        """It was closed."""
        self.with_input.pop(connection, None)
        self.with_output.pop(connection, None)
        self.with_messages.pop(connection, None)


class Connection:
    """A non-blocking socket with a buffer of lines on each side."""

    def __init__(
        self, raw: socket.socket, loop: EventLoop, busy: Busy, publications: Publications, receiver: Receiver
    ) -> None:
        self._socket = raw
        self._fd = raw.fileno()
        self._loop = loop
        self._busy = busy
        self._receiver = receiver
        self._incoming = LineBuffer()
        self.outbox = Outbox(receiver.report, publications)
        self._chunk: bytes | memoryview = b""
        self._failure: BadLine | None = None
        self._blocked = False  # the kernel takes no more for now
        self._readable = True  # the kernel may have something for us
        self._ends = False  # the client sends no more than what is here already
        self._ended = False  # no more will be read
        self._deaf = False  # the client takes no more, ever
        self._waits_to_write = False
        self.open = True
        loop.watch(self._fd, READ | ONCE, self._ready)

    # --- in -----------------------------------------------------------------------------------------------------

    def _ready(self, events: int) -> None:
        """Events are only noted: what is done about them has its turn when all have been noted."""
        self._readable = not self._ended
        self._ends = self._ends or bool(events & (HANG_UP | PEER_CLOSED))
        self._busy.with_input[self] = None
        if events & HANG_UP:
            self._stop_sending()
        if events & WRITE:
            self._blocked = False
            self._busy.with_output[self] = None

    def _safely(self, action: Callable[[], None]) -> None:
        """A fault of ours ends one connection, not the daemon."""
        try:
            action()
        except Exception:
            self._receiver.unexpected("serving a connection failed")
            self.close()

    def serve(self) -> None:
        """Take in what has come. There is a limit to each turn, so that no client holds up the others."""
        self._safely(self._serve_some)

    def _serve_some(self) -> None:
        # A client that does not take its answers is not listened to until it does: that bounds what we keep for it.
        # Lines of it that have come already wait as well.
        lines = self._incoming.lines
        end = time.monotonic() + _SERVED_A_TURN_S
        while (lines or self._readable) and not self.is_overfull:
            if lines:
                self._receiver.take(lines.popleft())
            else:
                self._receive()
            if time.monotonic() >= end:
                break
        if self._failure is not None and not lines:
            failure, self._failure = self._failure, None
            self._receiver.refuse(failure)
        self._settle()

    def _receive(self) -> None:
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            self._readable = False
            return
        except OSError:
            data = b""
        try:
            self._incoming.feed(data)
            if not data and self._incoming.unfinished:
                raise BadLine(f"a line that was cut off after {self._incoming.unfinished} bytes")
        except BadLine as error:
            self._failure = error
        self._ended = not data or self._failure is not None
        # A short piece is all that there is, except for the end; what comes later is told anew: see epoll(7).
        self._readable = not self._ended and (len(data) == _CHUNK or self._ends)

    # --- out ----------------------------------------------------------------------------------------------------

    def send(self, line: bytes) -> None:
        """A line that must arrive: an answer, a refusal."""
        if self._deaf:
            return
        self.outbox.put(line)
        if not self._blocked:
            # To the end of the row: answers leave in the order in which they were given, whoever they are for.
            self._busy.with_output.pop(self, None)
            self._busy.with_output[self] = None

    @property
    def unread(self) -> int:
        """Bytes that wait for this client alone."""
        return self.outbox.unbounded + len(self._chunk)

    @property
    def is_overfull(self) -> bool:
        """True while more waits for the client than may: what is not an answer to it should not be added."""
        return self.unread >= _MOST_UNREAD

    def flush(self) -> None:
        """Send what the kernel takes now, within reason."""
        if not self._blocked:
            self._safely(self._send_some)

    def _send_some(self) -> None:
        sent = 0
        while (self._chunk or self.outbox) and not self._blocked and sent < _SENT_A_TURN:
            chunk = self._chunk or self.outbox.take(_CHUNK)
            try:
                count = self._socket.send(chunk)
            except BlockingIOError:
                count = 0
            except OSError:
                self._stop_sending()
                break
            self._chunk = memoryview(chunk)[count:]  # no copy: a piece may be 16 MiB, and go out in a hundred parts
            self._blocked = bool(self._chunk)
            sent += count
        self._settle()

    def _stop_sending(self) -> None:
        self._deaf = True
        self._chunk = b""
        self.outbox.clear()

    def _settle(self) -> None:
        """After anything changed: what to wait for, and whether the end is reached."""
        lines = bool(self._incoming.lines)
        unsent = bool(self._chunk or self.outbox)
        if self._ended and not lines and not unsent and (self._deaf or not self._receiver.waiting):
            self.close()
        if not self.open:
            return
        if unsent and not self._blocked:
            self._busy.with_output[self] = None
        if (lines or self._readable) and not self.is_overfull:
            self._busy.with_input[self] = None
        if self._blocked != self._waits_to_write:
            self._waits_to_write = self._blocked
            self._loop.change(self._fd, READ | ONCE | (WRITE if self._blocked else 0))

    def close(self) -> None:
        """End it now; the session takes back all that the client had."""
        if not self.open:
            return
        self.open = False
        self._busy.forget(self)
        self._loop.forget(self._fd)
        self._socket.close()
        self._safely(self._receiver.closed)
