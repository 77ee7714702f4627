"""WebSocket connections on plain sockets, on which anything may be written, and what a gateway has in memory."""

from __future__ import annotations

import re
import select
import socket
import struct
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

from daemon_fixture import Runtime

from slidectl.extensions.gateways import process

LIMIT_S = 60.0
_KEY = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"


def raw_socket(url: str) -> socket.socket:
    parts = urlsplit(url)
    assert parts.hostname is not None
    return socket.create_connection((parts.hostname, parts.port or 0), timeout=LIMIT_S)


def request(more: str = "") -> bytes:
    """A handshake's request; `more` are header lines."""
    upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\n"
    return f"GET / HTTP/1.1\r\nHost: localhost\r\n{upgrade}{_KEY}{more}\r\n".encode()


def shaken(url: str, more: str = "") -> socket.socket:
    """A connection after its handshake, to write frames on by hand."""
    one = raw_socket(url)
    one.sendall(request(more))
    received = b""
    while b"\r\n\r\n" not in received:
        piece = one.recv(1)  # what comes after the handshake stays for others to read
        assert piece, f"no handshake: {received!r}"
        received += piece
    assert b" 101 " in received, received
    return one


def frame(payload: bytes, op: int = 1, is_last: bool = True, bits: int = 0) -> bytes:
    """A frame as a browser sends it, masked with zeros."""
    return head(len(payload), op, is_last, bits) + payload


def head(length: int, op: int = 1, is_last: bool = True, bits: int = 0) -> bytes:
    """What stands before the payload of a frame that claims this length."""
    if length < 126:
        size = bytes([0x80 | length])
    else:
        size = b"\xfe" + struct.pack(">H", length) if length < 65536 else b"\xff" + struct.pack(">Q", length)
    return bytes([(0x80 if is_last else 0) | bits | op]) + size + b"\0\0\0\0"


def send_all(one: socket.socket, data: bytes) -> bool:
    """False when the other side has hung up meanwhile."""
    with suppress(BrokenPipeError, ConnectionResetError):
        one.sendall(data)
        return True
    return False


def is_over(one: socket.socket) -> bool:
    """True when the other side has closed; what it sent before is taken."""
    with suppress(ConnectionResetError):
        while select.select([one], [], [], 0)[0]:
            if not one.recv(1 << 20):
                return True
        return False
    return True


def closed(one: socket.socket) -> tuple[int, str]:
    """Code and reason of the close frame with which the other side ends, after frames without masks."""
    data = b""
    with suppress(ConnectionResetError):
        while more := one.recv(1 << 16):
            data += more
    while data:
        op, length, at = data[0] & 15, data[1], 2
        if length == 126:
            length, at = struct.unpack(">H", data[2:4])[0], 4
        elif length == 127:
            length, at = struct.unpack(">Q", data[2:10])[0], 10
        if op == 8:
            return struct.unpack(">H", data[at : at + 2])[0], data[at + 2 : at + length].decode()
        data = data[at + length :]
    return 0, ""


def gateway_pid(runtime: Runtime, kind: str) -> int:
    with runtime.environment():
        running = process.find(runtime.paths, kind)
    assert running is not None
    return running.pid


def memory_mib(pid: int, field: str = "VmRSS") -> float:
    """What a process has in memory; VmHWM is the most that it had since `forget_peak`."""
    found = re.search(rf"{field}:\s+(\d+)", Path(f"/proc/{pid}/status").read_text("utf-8"))
    assert found is not None
    return int(found[1]) / 1024


def forget_peak(pid: int) -> None:
    """Let VmHWM begin at VmRSS again."""
    Path(f"/proc/{pid}/clear_refs").write_text("5", encoding="ascii")


def descriptors(pid: int) -> int:
    """How many descriptors a process has open."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))
