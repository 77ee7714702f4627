"""The client's end of the socket: connect to a daemon of the same user, send and receive lines, within deadlines.

It knows lines and the clock, not operations. Every wait watches the socket, so the end of the daemon is noticed.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from socket import AF_UNIX, socket
from typing import Any, Protocol

from slidectl.errors import NoDaemon, TimedOut
from slidectl.operating_system import peer
from slidectl.paths import InstancePaths, check_socket, command
from slidectl.wire.json_lines import LineBuffer, decode
from slidectl.wire.peers import check_daemon_user, nobody_answers, went_away

_CHUNK = 64 * 1024
"""Bytes per receive call. Python allocates this many each time; above 128 KiB malloc would map and unmap memory."""
_GRACE_S = 0.25
"""Seconds after a deadline in which arrived data is still read. Bounds the wait under constant traffic."""
_LONGEST_WAIT_S = 1e6
"""`select` and `settimeout` accept no longer wait, in s."""


class ClientLink(Protocol):
    """A client's connection to a daemon. Deadlines are on `monotonic`; `inf` is none."""

    paths: InstancePaths
    daemon_pid: int | None
    """0 in another process namespace; None where the kernel does not tell it."""
    last_status: str

    def another(self, deadline: float) -> ClientLink:
        """Open a further connection to the same daemon. Raises NoDaemon."""

    def monotonic(self) -> float:
        """The clock of deadlines, in s."""

    def fileno(self) -> int:
        """The file descriptor for `select`."""

    def call_back(self, action: Callable[[], object] | None) -> bool:
        """Set a callback for data that arrives while other clients wait. Returns whether the connection supports it."""

    def send(self, line: bytes, deadline: float) -> None:
        """Send a line. Raises TimedOut, NoDaemon."""

    def receive(self, deadline: float) -> dict[str, Any] | None:
        """The next object, or None when the deadline passes first. Raises NoDaemon."""

    def close(self) -> None:
        """Close the connection."""


class SocketLink:
    """One connection to the daemon of `paths`. Deadlines are on `time.monotonic()`; `inf` is none."""

    def __init__(self, paths: InstancePaths, deadline: float) -> None:
        self.paths = paths
        self._incoming = LineBuffer()
        self._closed = False
        self.last_status = ""
        """The text of the last status. When the daemon ends, it gives the reason."""
        self._socket = self._connect(deadline)
        self._to_wait = (self._socket.fileno(),)
        pid, uid = peer(self._socket)
        self.daemon_pid = None if uid is None else pid
        try:
            check_daemon_user(uid, paths)
        except BaseException:
            self.close()
            raise

    def another(self, deadline: float) -> SocketLink:
        """Open a further connection to the same daemon. Raises as the constructor."""
        return SocketLink(self.paths, deadline)

    def monotonic(self) -> float:
        """The clock of deadlines, in s."""
        return time.monotonic()

    def fileno(self) -> int:
        return self._socket.fileno()

    def call_back(self, action: Callable[[], object] | None) -> bool:  # noqa: ARG002
        """Return False: a process that has a socket waits on `fileno` and needs no callback."""
        return False

    def _connect(self, deadline: float) -> socket:
        connection = socket(AF_UNIX)
        try:
            check_socket(self.paths)
            # The kernel makes a connect wait while the daemon's backlog is full, but only that of a blocking socket.
            # One with a timeout is non-blocking underneath: then a full backlog is EAGAIN, and the connect is repeated.
            connection.settimeout(max(0.001, min(deadline - time.monotonic(), _LONGEST_WAIT_S)))
            while True:
                try:
                    connection.connect(self.paths.socket_text)
                    break
                except BlockingIOError:
                    if time.monotonic() >= deadline:
                        raise
                    time.sleep(0.005)
        except OSError as error:
            connection.close()
            raise nobody_answers(self.paths, error) from None
        except BaseException:
            connection.close()
            raise
        connection.setblocking(False)
        return connection

    def send(self, line: bytes, deadline: float) -> None:
        """Send a line; lines that arrive meanwhile are kept. Raises TimedOut, NoDaemon."""
        rest: bytes | memoryview = line
        while rest:
            try:
                count = self._socket.send(rest)
                if count == len(rest):
                    return
                rest = memoryview(rest)[count:]
            except BlockingIOError:
                # A daemon whose answers are not read stops reading, so read them while waiting.
                left = deadline - time.monotonic()
                readable, writable, _ = select.select(self._to_wait, self._to_wait, (), _for_select(left))
                if not readable and not writable:
                    raise TimedOut("the daemon does not read its input") from None
                if readable:
                    self._read()
            except OSError:
                while self._read():
                    pass
                for message in map(decode, self._incoming.lines):
                    if message.get("op") == "status":
                        self.last_status = str(message.get("msg", ""))
                raise self._gone() from None

    def receive(self, deadline: float) -> dict[str, Any] | None:
        """The next object from the daemon, or None when the deadline passes first. Raises NoDaemon."""
        lines = self._incoming.lines
        while not lines:
            if self._closed:
                raise self._gone()
            left = deadline - time.monotonic()
            if left < -_GRACE_S or not select.select(self._to_wait, (), (), _for_select(left))[0]:
                return None
            self._read()
        return decode(lines.popleft())

    def _read(self) -> bool:
        """Read what has arrived; False when there is nothing to read or the connection has ended."""
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        self._closed = not data
        self._incoming.feed(data)
        return not self._closed

    def _gone(self) -> NoDaemon:
        return went_away(self.last_status, "start it with: " + command(self.paths, "daemon start"))

    def close(self) -> None:
        self._closed = True
        self._socket.close()


def _for_select(left: float) -> float | None:
    return None if left > _LONGEST_WAIT_S else max(0.0, left)
