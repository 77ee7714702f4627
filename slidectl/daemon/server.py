"""All connections: accepts them, serves those that have more to do, and ends them.

Called from the event loop between two cycles. Knows no operations: each connection has its session for that.
"""

from __future__ import annotations

import os
import resource
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from slidectl.client.lines import encode
from slidectl.client.link import peer
from slidectl.daemon.connection import Connection
from slidectl.daemon.loop import READ, EventLoop
from slidectl.daemon.session import Around, Session
from slidectl.simulation.graph import Graph

MOST_CONNECTIONS = 512
_KEPT_DESCRIPTORS = 32
"""File descriptors that connections must leave to the rest of the process."""
_ACCEPTED_A_TURN = 16
_GONE: Any = object()
_SERVED_A_TURN_S = 0.005
_SENT_A_TURN_S = 0.003
_COSTLY_S, _LONGEST_PAUSE_S = 0.0003, 0.1
_PAUSE_FACTOR = 3.0
"""Between two rounds of messages that took long, so many times that time is left to the cycles and to all else."""


class Server:
    """Connections on `listener`, with the graph behind them."""

    def __init__(
        self, listener: socket.socket, loop: EventLoop, graph: Graph, unexpected: Callable[[str], None]
    ) -> None:
        self._around = Around(graph, loop, unexpected, self._listen)
        self.sessions = self._around.sessions
        self.publications = self._around.publications
        self.busy = self._around.busy
        self._listener = listener
        self._most = _most_connections()
        self._serial = 0
        self._listening = False
        self._paused_for = ""
        self._messages_due_s = 0.0
        self._sending_s = 0.0
        self._listen()

    def serve(self) -> None:
        """Take in what clients have said, in turn. Who has no turn before the time is up is the first the next time."""
        _in_turn(self.busy.with_input, Connection.serve, time.monotonic() + _SERVED_A_TURN_S)

    def flush(self) -> None:
        """Send what the clients take: messages of topics when it is time for these, then answers.

        Messages come first: an answer says that its effect is there.
        """
        began = time.monotonic()
        busy, fresh = self.busy, self.publications.fresh
        if fresh and not busy.with_messages and began >= self._messages_due_s:
            busy.with_messages = {reader: None for channel in fresh for reader in channel.readers}
            fresh.clear()
            self._sending_s = 0.0
        if busy.with_messages:
            self._send_messages(began)
            began = time.monotonic()
        _in_turn(busy.with_output, Connection.flush, began + _SENT_A_TURN_S)

    def _send_messages(self, began: float) -> None:
        """To a hundred readers sending takes longer than a cycle: then several cycles' messages are sent together."""
        with_messages = self.busy.with_messages
        _in_turn(with_messages, Connection.flush, began + _SENT_A_TURN_S)
        now = time.monotonic()
        self._sending_s += now - began
        if not with_messages and self._sending_s > _COSTLY_S:
            self._messages_due_s = now + min(_LONGEST_PAUSE_S, _PAUSE_FACTOR * self._sending_s)

    def wait(self, most_s: float | None) -> float | None:
        """How long the loop may wait for clients when it has nothing else to do for `most_s`."""
        busy = self.busy
        if busy.with_input or busy.with_output or busy.with_messages:
            return 0.0
        if not self.publications.fresh:
            return most_s
        due_s = max(0.0, self._messages_due_s - time.monotonic())
        return due_s if most_s is None else min(most_s, due_s)

    def close(self, why: str) -> None:
        """End all sessions and let go of everything."""
        for session in list(self.sessions):
            session.end(why)
        self._pause()
        self._listener.close()

    def tidy(self) -> None:
        """Now and then: give up lines that nobody wants, and look whether there is room for connections again."""
        self.publications.tidy()
        if len(self.sessions) < self._most:
            self._listen()

    def listen_on(self, listener: socket.socket) -> None:
        """Accept connections here from now on; those that there are stay."""
        self._pause()
        self._listener.close()
        self._listener = listener
        if len(self.sessions) < self._most:
            self._listen()

    def _pause(self) -> None:
        if self._listening:
            self._around.loop.forget(self._listener.fileno())
        self._listening = False

    def _listen(self) -> None:
        """Accept while there is room: a listener that is ready and not served would keep the loop from waiting."""
        if not self._listening:
            self._around.loop.watch(self._listener.fileno(), READ, self._accept)
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
            self._paused_for = ""
            self._admit(connection)
            if len(self.sessions) >= self._most:
                self._pause_listening(f"{self._most} connections are open; others wait until one of them ends")
                return

    def _pause_listening(self, why: str) -> None:
        if why != self._paused_for:  # it is tried again and again
            self._around.graph.log("warn", "/slidectl", why)
        self._paused_for = why
        self._pause()

    def _admit(self, connection: socket.socket) -> None:
        pid, uid = peer(connection)
        connection.setblocking(False)
        reason = refusal(uid)
        if reason is None:
            self._serial += 1
            Session(connection, self._around, f"/slidectl_{pid}_{self._serial}", _session_of(pid))
            return
        self._around.graph.log("warn", "/slidectl", f"refused a connection of process {pid}: {reason}")
        with connection, suppress(OSError):
            connection.send(encode({"op": "status", "level": "error", "msg": reason}))


def _in_turn(waiting: dict[Any, None], action: Callable[[Any], None], end_s: float) -> None:
    """Act for those who wait, until the time is up: the others stay, before those who come to wait meanwhile."""
    for connection in list(waiting):
        if waiting.pop(connection, _GONE) is not _GONE:
            action(connection)
            if time.monotonic() >= end_s:
                break


def _session_of(pid: int) -> int:
    """The session id of a process, 0 when it has gone or is not to be seen from here."""
    try:
        return os.getsid(pid) if pid else 0  # 0 is a process of another pid namespace, and for getsid ourselves
    except OSError:
        return 0


def refusal(uid: int) -> str | None:
    """Why a process of this user may not come in; None when it may."""
    if uid == os.geteuid():
        return None
    return f"this daemon belongs to uid {os.geteuid()}; processes of uid {uid} may not use it"


def _most_connections() -> int:
    """How many connections there may be."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit == resource.RLIM_INFINITY:
        return MOST_CONNECTIONS
    return max(1, min(MOST_CONNECTIONS, limit - _KEPT_DESCRIPTORS))
