"""The server: accepts connections, serves those with pending work, and moves bytes between sockets and sessions.

Called from the event loop between two cycles. It never blocks: what the kernel does not accept stays in the outbox. It
handles lines, not operations: each connection has a session for these.
"""

from __future__ import annotations

import os
import resource
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from slidectl.daemon.outbox import Outbox, Publications, Reader
from slidectl.daemon.session import Session
from slidectl.event_loop import HANG_UP, ONCE, PEER_CLOSED, READ, WRITE, EventLoop
from slidectl.names import OWN_NODE
from slidectl.operating_system import peer
from slidectl.simulation.graph import Graph
from slidectl.simulation.loop import RunState
from slidectl.wire.json_lines import BadLine, LineBuffer, encode
from slidectl.wire.peers import why_not_client

if TYPE_CHECKING:
    from slidectl.simulation.host import InputRecorder

MOST_CONNECTIONS = 512
_KEPT_DESCRIPTORS = 32
"""File descriptors that connections must leave to the rest of the process."""
_ACCEPTED_A_TURN = 16
_CHUNK = 64 * 1024
_MOST_UNREAD = 1024 * 1024
_SERVED_ONE_S, _SERVED_A_TURN_S = 0.002, 0.005
"""The longest time in which one connection, and all of them, are served before cycles run."""
_SENT_ONE, _SENT_A_TURN_S = 256 * 1024, 0.003
"""The most bytes to one connection, and seconds for all of them, before cycles run."""
_COSTLY_S, _LONGEST_PAUSE_S = 0.0003, 0.1
_PAUSE_FACTOR = 3.0
"""After sending messages took long, the pause before the next is this many times as long, for cycles and other work."""
_LONGEST_STALL_S, _LONGEST_END_S = 0.5, 4.0
"""The longest waits at the daemon's end: while no client reads, and in total while some do."""
_GONE: Any = object()


class Server:
    """Connections on `listener` to the graph."""

    def __init__(
        self, listener: socket.socket, loop: EventLoop, graph: Graph, unexpected: Callable[[str], None], run: RunState
    ) -> None:
        self.loop = loop
        self.graph = graph
        self.unexpected = unexpected
        self.publications = Publications(run)
        self.recorder: InputRecorder | None = None
        """Records what clients do; set before the first of them connects."""
        self.connections: dict[Connection, None] = {}
        self.with_input: dict[Connection, None] = {}
        """Connections with work to do before the loop may wait, in order; so are the next two."""
        self.with_output: dict[Connection, None] = {}
        self.with_messages: dict[Reader, None] = {}
        """Readers of topics with new messages."""
        self._listener = listener
        self._most = _most_connections()
        self._serial = 0
        self._listening = False
        self._paused_for = ""
        self._messages_due_s = 0.0
        self._sending_s = 0.0
        self._listen()

    def serve(self) -> None:
        """Handle clients' input, one after the other. Clients not reached in time come first in the next call."""
        _in_turn(self.with_input, Connection.serve, time.monotonic() + _SERVED_A_TURN_S)

    def flush(self) -> None:
        """Send what the clients accept: messages of topics when they are due, then answers.

        Messages come first: an answer means that its effect was already sent.
        """
        began = time.monotonic()
        fresh = self.publications.fresh
        if fresh and not self.with_messages and began >= self._messages_due_s:
            self.with_messages = {reader: None for channel in fresh for reader in channel.readers}
            fresh.clear()
            self._sending_s = 0.0
        if self.with_messages:
            self._send_messages(began)
            began = time.monotonic()
        _in_turn(self.with_output, Connection.flush, began + _SENT_A_TURN_S)

    def _send_messages(self, began: float) -> None:
        """Send messages. If this takes longer than a cycle, the messages of several cycles are sent together."""
        _in_turn(self.with_messages, Connection.flush, began + _SENT_A_TURN_S)
        now = time.monotonic()
        self._sending_s += now - began
        if not self.with_messages and self._sending_s > _COSTLY_S:
            self._messages_due_s = now + min(_LONGEST_PAUSE_S, _PAUSE_FACTOR * self._sending_s)

    def wait(self, most_s: float | None) -> float | None:
        """How long the loop may wait for clients when it has nothing else to do for `most_s`, s."""
        if self.publications.held:
            left_s = self.publications.release()
            most_s = left_s if most_s is None else min(most_s, left_s)
        if self.with_input or self.with_output or self.with_messages:
            return 0.0
        if not self.publications.fresh:
            return most_s
        due_s = max(0.0, self._messages_due_s - time.monotonic())
        return due_s if most_s is None else min(most_s, due_s)

    def close(self, why: str) -> None:
        """End all connections and close. Clients that keep reading get all waiting lines: recordings are complete."""
        for connection in list(self.connections):
            connection.warn(why)
        end_s = time.monotonic() + _LONGEST_END_S
        while unsent := {connection.fileno(): connection for connection in self.connections if connection.unsent}:
            taking = select.poll()
            for fd in unsent:
                taking.register(fd, select.POLLOUT)
            ready = taking.poll(1000 * max(0.0, min(_LONGEST_STALL_S, end_s - time.monotonic())))
            for fd, _ in ready:
                unsent[fd].resume()
            if not ready:
                break
        for connection in list(self.connections):
            connection.close()
        self._pause()
        self._listener.close()

    def tidy(self) -> None:
        """Drop lines that no reader needs, and accept connections again when there is room."""
        self.publications.tidy()
        if len(self.connections) < self._most:
            self._listen()

    def ended(self, connection: Connection) -> None:
        """Forget a closed connection."""
        for waiting in (self.connections, self.with_input, self.with_output, self.with_messages):
            waiting.pop(connection, None)
        self._listen()

    def listen_on(self, listener: socket.socket) -> None:
        """Accept connections on another listener from now on; open ones stay."""
        self._pause()
        self._listener.close()
        self._listener = listener
        if len(self.connections) < self._most:
            self._listen()

    def _pause(self) -> None:
        if self._listening:
            self.loop.forget(self._listener.fileno())
        self._listening = False

    def _listen(self) -> None:
        """Accept while there is room: a ready listener that is not served would keep the loop from waiting."""
        if not self._listening:
            self.loop.watch(self._listener.fileno(), READ, self._accept)
        self._listening = True

    def _accept(self, _: int) -> None:
        for _ in range(_ACCEPTED_A_TURN):
            try:
                connection, _address = self._listener.accept()
            except BlockingIOError:
                return
            except OSError as error:  # out of file descriptors: open connections are still served
                self._pause_listening(f"cannot accept: {error.strerror}")
                return
            self._paused_for = ""
            self._admit(connection)
            if len(self.connections) >= self._most:
                self._pause_listening(f"{self._most} connections are open; others wait until one of them ends")
                return

    def _pause_listening(self, why: str) -> None:
        if why != self._paused_for:  # log once: it is tried again and again
            self.graph.log("warn", OWN_NODE, why)
        self._paused_for = why
        self._pause()

    def _admit(self, connection: socket.socket) -> None:
        pid, uid = peer(connection)
        connection.setblocking(False)
        reason = why_not_client(uid)
        if not reason:
            self._serial += 1
            self.connections[Connection(connection, self, pid, self._serial)] = None
            return
        self.graph.log("warn", OWN_NODE, f"refused a connection of process {pid}: {reason}")
        with connection, suppress(OSError):
            connection.send(encode({"op": "status", "level": "error", "msg": reason}))


class Connection:
    """A non-blocking socket with a buffer of lines on each side."""

    def __init__(self, raw: socket.socket, server: Server, pid: int, serial: int) -> None:
        self._socket = raw
        self._fd = raw.fileno()
        self._server = server
        self._loop = server.loop
        self._incoming = LineBuffer()
        self.node = f"/slidectl_{pid}_{serial}"
        self._session = Session(
            self, server.graph, server.publications, server.unexpected, self.node, _session_of(pid), server.recorder
        )
        self.outbox = Outbox(self._session.report, server.publications)
        self._chunk: bytes | memoryview = b""
        self._failure: BadLine | None = None
        self._blocked = False  # the kernel accepts no more for now
        self._readable = True  # the kernel may have input for us
        self._ends = False  # the client sends no more than what has arrived
        self._ended = False  # no more will be read
        self._never_reads = False  # the client will never read more
        self._waits_to_write = False
        self.open = True
        self._loop.watch(self._fd, READ | ONCE, self._ready)

    # --- in -----------------------------------------------------------------------------------------------------

    def _ready(self, events: int) -> None:
        """Note events only; they are handled after all have been noted."""
        self._readable = not self._ended
        self._ends = self._ends or bool(events & (HANG_UP | PEER_CLOSED))
        self._server.with_input[self] = None
        if events & HANG_UP:
            self._stop_sending()
        if events & WRITE:
            self._blocked = False
            self._server.with_output[self] = None

    def _safely(self, action: Callable[[], None]) -> None:
        """Call `action`. An internal error ends this connection, not the daemon."""
        try:
            action()
        except Exception:
            self._session.unexpected("serving a connection failed")
            self.close()

    def serve(self) -> None:
        """Handle input. Each turn is limited, so that no client blocks the others."""
        self._safely(self._serve_some)

    def _serve_some(self) -> None:
        # A client that does not read its answers is not served until it does: that bounds what we store for it. Its
        # lines that have arrived wait too.
        lines = self._incoming.lines
        end = time.monotonic() + _SERVED_ONE_S
        while (lines or self._readable) and not self.is_overfull:
            if lines:
                self._session.handle(lines.popleft())
            else:
                self._receive()
            if time.monotonic() >= end:
                break
        if self._failure is not None and not lines:
            failure, self._failure = self._failure, None
            self._session.send_error(failure, {})
        self._settle()

    def _receive(self) -> None:
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            self._readable = False
            self._loop.read_all(self._fd)
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
        # A short piece is all the input, except for the end; later input raises a new event: see epoll(7).
        self._readable = not self._ended and (len(data) == _CHUNK or self._ends)
        if not self._readable and not self._ended:
            self._loop.read_all(self._fd)

    # --- out ----------------------------------------------------------------------------------------------------

    def send(self, line: bytes) -> None:
        """Send a line that must arrive: an answer or a refusal."""
        if self._never_reads:
            return
        self.outbox.add(line)
        if not self._blocked:
            # Move to the end of the queue: answers leave in the order in which they were given, across clients.
            self._server.with_output.pop(self, None)
            self._server.with_output[self] = None

    def check_end(self) -> None:
        """Check, between two cycles, whether the connection can end: its session has fewer open requests."""
        self._server.with_output[self] = None

    @property
    def unread(self) -> int:
        """Bytes that wait for this client alone."""
        return self.outbox.unbounded + len(self._chunk)

    @property
    def is_overfull(self) -> bool:
        """True while too much waits for the client: only answers to it should be added."""
        return self.unread >= _MOST_UNREAD

    def flush(self) -> None:
        """Send what the kernel accepts now, up to a limit."""
        if not self._blocked:
            self._safely(self._send_some)

    def _send_some(self) -> None:
        sent = 0
        while self.unsent and not self._blocked and sent < _SENT_ONE:
            chunk = self._chunk or self.outbox.next_piece(_CHUNK)
            try:
                count = self._socket.send(chunk)
            except BlockingIOError:
                count = 0
            except OSError:
                self._stop_sending()
                break
            # Do not copy the rest: a piece may be 16 MiB, and be sent in a hundred parts.
            self._chunk = memoryview(chunk)[count:] if count < len(chunk) else b""
            self._blocked = bool(self._chunk)
            sent += count
        self._settle()

    def _stop_sending(self) -> None:
        self._never_reads = True
        self._chunk = b""
        self.outbox.clear()

    def _settle(self) -> None:
        """Update the events to wait for, and close when the end is reached."""
        lines = bool(self._incoming.lines)
        unsent = self.unsent
        if self._ended and not lines and not unsent and (self._never_reads or not self._session.waiting):
            self.close()
        if not self.open:
            return
        if unsent and not self._blocked:
            self._server.with_output[self] = None
        if (lines or self._readable) and not self.is_overfull:
            self._server.with_input[self] = None
        if self._blocked != self._waits_to_write:
            self._waits_to_write = self._blocked
            self._loop.change(self._fd, READ | ONCE | (WRITE if self._blocked else 0))

    def close(self) -> None:
        """Close now; the session removes all that the client had."""
        if not self.open:
            return
        self.open = False
        self._loop.forget(self._fd)
        self._socket.close()
        self._safely(self._session.closed)
        self._server.ended(self)

    def fileno(self) -> int:
        return self._fd

    @property
    def unsent(self) -> bool:
        """True while something waits that the client may still read."""
        return bool(self._chunk or self.outbox)

    def warn(self, text: str) -> None:
        """Send a status line, after all that waits already."""
        self._session.warn(text)

    def resume(self) -> None:
        """Send again: the kernel accepts data, or reports that the client has disconnected."""
        self._blocked = False
        self.flush()


def _in_turn(waiting: dict[Any, None], action: Callable[[Any], None], end_s: float) -> None:
    """Call `action` for each until the time is up. The rest stay, before those that are added meanwhile."""
    for connection in list(waiting):
        if waiting.pop(connection, _GONE) is not _GONE:
            action(connection)
            if time.monotonic() >= end_s:
                break


def _session_of(pid: int) -> int:
    """The session id of a process, 0 when it has ended or is not visible from here."""
    try:
        return os.getsid(pid) if pid else 0  # pid 0 is in another pid namespace, but getsid(0) is our own session
    except OSError:
        return 0


def _most_connections() -> int:
    """The most connections, by the limit of file descriptors."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit == resource.RLIM_INFINITY:
        return MOST_CONNECTIONS
    return max(1, min(MOST_CONNECTIONS, limit - _KEPT_DESCRIPTORS))
