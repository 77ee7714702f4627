"""The client's end of the socket: connect to a daemon that is ours, send lines, receive lines, all within deadlines.

Knows lines and the clock, not operations. Nothing waits without looking at the socket, so a daemon's death is noticed.
"""

from __future__ import annotations

import os
import select
import struct
import time

# What `socket` is made of. That module turns hundreds of constants into enumerations when it is imported, which
# takes longer than all else that a command does with its connection.
from _socket import AF_UNIX, SO_PEERCRED, SOL_SOCKET, socket
from typing import Any

from slidectl.client.lines import LineBuffer, decode
from slidectl.errors import NoDaemon, Refused, TimedOut
from slidectl.paths import DEFAULT_INSTANCE, InstancePaths, check_private

_CHUNK = 256 * 1024
_GRACE_S = 0.25
"""How long after a deadline what has arrived is still taken in. It ends, however fast other things go on arriving."""
_CREDENTIALS = struct.Struct("3i")


def command(paths: InstancePaths, words: str) -> str:
    """The command line that does `words` with this instance, as a user would type it."""
    if paths.prefix:
        return f"slidectl --socket {paths.socket_text} {words}"
    name = paths.name
    return f"slidectl {words}" if name == DEFAULT_INSTANCE else f"slidectl -i {name} {words}"


def peer(connection: socket) -> tuple[int, int]:
    """Process id and user id at the other end, as the kernel vouches for them (SO_PEERCRED)."""
    raw = connection.getsockopt(SOL_SOCKET, SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, _ = _CREDENTIALS.unpack(raw)
    return pid, uid


class Link:
    """One connection to the daemon of `paths`. Deadlines are on `time.monotonic()`; `inf` is none."""

    def __init__(self, paths: InstancePaths, deadline: float) -> None:
        self._paths = paths
        self._incoming = LineBuffer()
        self._chunk = memoryview(bytearray(_CHUNK))  # made once: memory of this size is the kernel's to give and take
        self._closed = False
        self.farewell = ""
        self._socket = self._connect(deadline)
        self._itself = (self._socket.fileno(),)
        self.daemon_pid, uid = peer(self._socket)
        if uid != os.geteuid():
            self.close()
            raise Refused(f"the daemon on {paths.socket_text} belongs to another user (uid {uid})")

    def fileno(self) -> int:
        return self._socket.fileno()

    def _connect(self, deadline: float) -> socket:
        connection = socket(AF_UNIX)
        try:
            if self._paths.prefix:
                os.lstat(self._paths.socket_text)  # where nothing is, nobody answers, whatever the folder is like
            check_private(self._paths.folder_text)
            # The kernel makes a connect wait while the daemon's backlog is full, but only that of a blocking socket.
            connection.settimeout(max(0.001, min(deadline - time.monotonic(), 1e6)))
            _connect_patiently(connection, self._paths.socket_text, deadline)
        except OSError as error:
            connection.close()
            raise self._nobody(error) from None
        except Refused:
            connection.close()
            raise
        connection.setblocking(False)
        return connection

    def _nobody(self, error: OSError) -> NoDaemon:
        hint = "start it with: " + command(self._paths, "daemon start")
        if isinstance(error, FileNotFoundError | ConnectionRefusedError):
            return NoDaemon(f"no daemon answers on {self._paths.socket_text}", hint)
        if isinstance(error, BlockingIOError | TimeoutError):
            return NoDaemon(
                f"the daemon on {self._paths.socket_text} takes no connection: it hangs, is stopped, or has too many",
                f"see: {command(self._paths, 'daemon logs')}\nend it with: {command(self._paths, 'daemon stop')}",
            )
        return NoDaemon(f"no daemon answers on {self._paths.socket_text}: {error.strerror or error}", hint)

    def send(self, line: bytes, deadline: float) -> None:
        """Hand one line or several to the kernel; lines that arrive meanwhile are kept. Raises TimedOut, NoDaemon."""
        rest: bytes | memoryview = line
        while rest:
            try:
                rest = memoryview(rest)[self._socket.send(rest) :]
            except BlockingIOError:
                self._until_writable(deadline)
            except OSError:
                self._read_what_is_left()
                raise self.gone() from None

    def _until_writable(self, deadline: float) -> None:
        # A daemon whose answers we do not take stops reading from us, so take them while we wait.
        left = deadline - time.monotonic()
        readable, writable, _ = select.select(self._itself, self._itself, (), _for_select(left))
        if not readable and not writable:
            raise TimedOut("the daemon does not read what is sent to it")
        if readable:
            self._read()

    def receive(self, deadline: float) -> dict[str, Any] | None:
        """The next object from the daemon, or None when the deadline passes first. Raises NoDaemon."""
        lines = self._incoming.lines
        while not lines:
            if self._closed:
                raise self.gone()
            left = deadline - time.monotonic()
            if left < -_GRACE_S or not select.select(self._itself, (), (), _for_select(left))[0]:
                return None
            self._read()
        return decode(lines.popleft())

    def _read(self) -> bool:
        """Take what has arrived; False when there is nothing, now or ever."""
        try:
            data = bytes(self._chunk[: self._socket.recv_into(self._chunk)])
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        self._closed = not data
        self._incoming.feed(data)
        return not self._closed

    def _read_what_is_left(self) -> None:
        while self._read():
            pass
        for line in self._incoming.lines:
            message = decode(line)
            if message.get("op") == "status":
                self.farewell = str(message.get("msg", ""))

    def gone(self) -> NoDaemon:
        """The error that says the daemon closed the connection, with its last words if it said any."""
        why = f": {self.farewell}" if self.farewell else ""
        return NoDaemon(f"the daemon went away{why}", "start it with: " + command(self._paths, "daemon start"))

    def close(self) -> None:
        self._closed = True
        self._socket.close()


def _connect_patiently(connection: socket, path: str, deadline: float) -> None:
    # A socket with a timeout is non-blocking underneath, and then a full backlog is EAGAIN instead of a wait.
    while True:
        try:
            return connection.connect(path)
        except BlockingIOError:
            if time.monotonic() >= deadline:
                raise
            select.select([], [], [], 0.005)


def _for_select(left: float) -> float | None:
    return None if left > 1e6 else max(0.0, left)
