"""All connections: accepts them, serves those that have more to do, and says goodbye.

Called from the event loop between two cycles. Knows no operations: each connection has its session for that.
"""

from __future__ import annotations

import resource
import socket
from collections.abc import Callable
from contextlib import suppress

from slidectl.client.lines import encode
from slidectl.client.link import peer
from slidectl.daemon.connection import Connection
from slidectl.daemon.feed import Publications
from slidectl.daemon.listener import refusal
from slidectl.daemon.loop import READ, EventLoop
from slidectl.daemon.session import Session
from slidectl.simulation.graph import Graph

MOST_CONNECTIONS = 512
_KEPT_DESCRIPTORS = 32
"""File descriptors that connections must leave to the rest of the process."""
_ACCEPTED_A_TURN = 16


class Busy:
    """Connections that have more to do before the loop may wait, in order."""

    def __init__(self) -> None:
        self.with_input: dict[Connection, None] = {}
        self.with_output: dict[Connection, None] = {}

    def forget(self, connection: Connection) -> None:
        """It was closed."""
        self.with_input.pop(connection, None)
        self.with_output.pop(connection, None)


class Server:
    """Connections on `listener`, with the graph behind them. `log` takes a severity and a text."""

    def __init__(
        self,
        listener: socket.socket,
        loop: EventLoop,
        graph: Graph,
        unexpected: Callable[[str], None],
    ) -> None:
        self.graph = graph
        self.publications = Publications()
        self.unexpected = unexpected
        self.busy = Busy()
        self.sessions: dict[Connection, Session] = {}
        self._listener = listener
        self._most = _room()
        self._loop = loop
        self._serial = 0
        self._listening = False
        self._listen()

    def serve(self) -> None:
        """Go on with those who said more than one turn allows; they come before what has arrived since."""
        connections, self.busy.with_input = self.busy.with_input, {}
        for connection in connections:
            connection.serve()

    def flush(self) -> None:
        """Send what the clients take."""
        connections, self.busy.with_output = self.busy.with_output, {}
        for connection in connections:
            connection.flush()

    def close(self, farewell: str) -> None:
        """Say goodbye to all and let go of everything. What a client does not take at once is lost."""
        for connection, session in list(self.sessions.items()):
            session.tell("warning", farewell)
            connection.flush()
            connection.close()
        if self._listening:
            self._loop.forget(self._listener.fileno())
        self._listener.close()

    def _listen(self) -> None:
        """Accept while there is room: a listener that is ready and not served would keep the loop from waiting."""
        if not self._listening:
            self._loop.watch(self._listener.fileno(), READ, self._accept)
        self._listening = True

    def _accept(self, _: int) -> None:
        for _ in range(_ACCEPTED_A_TURN):
            try:
                connection, _address = self._listener.accept()
            except BlockingIOError:
                return
            except OSError as error:  # out of file descriptors: the others are served on
                self._pause_listening(f"cannot accept: {error.strerror}")
                return
            self._admit(connection)
            if len(self.sessions) >= self._most:
                self._pause_listening(f"{self._most} connections are open; others wait until one of them ends")
                return

    def _pause_listening(self, why: str) -> None:
        self.graph.log("warn", "/slidectl", why)
        self._loop.forget(self._listener.fileno())
        self._listening = False

    def _admit(self, connection: socket.socket) -> None:
        pid, uid = peer(connection)
        reason = refusal(uid)
        if reason is None:
            connection.setblocking(False)
            self._begin(connection, pid)
            return
        self.graph.log("warn", "/slidectl", f"refused a connection of process {pid}: {reason}")
        with connection, suppress(OSError):
            connection.setblocking(False)
            connection.send(encode({"op": "status", "level": "error", "msg": reason}))

    def _begin(self, raw: socket.socket, pid: int) -> None:
        self._serial += 1
        node = f"/slidectl_{pid}_{self._serial}"
        begun: list[Session] = []

        def session_of(connection: Connection) -> Session:
            begun.append(Session(connection, self, node))
            return begun[0]

        connection = Connection(raw, self._loop, self.busy, session_of, self._ended)
        self.sessions[connection] = begun[0]

    def _ended(self, connection: Connection) -> None:
        self.sessions.pop(connection, None)
        self._listen()


def _room() -> int:
    """How many connections there may be."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit == resource.RLIM_INFINITY:
        return MOST_CONNECTIONS
    return max(1, min(MOST_CONNECTIONS, limit - _KEPT_DESCRIPTORS))
