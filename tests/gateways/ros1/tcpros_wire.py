"""A node's end of TCPROS on a plain socket, on which anything may be sent."""

from __future__ import annotations

import socket
import struct
from types import TracebackType
from xmlrpc.client import ServerProxy

from ros1_tools import Ros

from slidectl.extensions.gateways.ros1.tcpros import Fields, decode_header, encode_header

LIMIT_S = 60.0


def subscribers_address(ros: Ros, topic: str, type_name: str = "*") -> tuple[str, int]:
    """Where a subscriber of a topic of slidectl connects to, as the master and the node that publishes it say."""
    with ServerProxy(ros.env["ROS_MASTER_URI"]) as master:
        code, _, (publisher, *_) = master.registerSubscriber("/wire", topic, type_name, "http://127.0.0.1:1")
    assert code == 1
    with ServerProxy(publisher) as node:
        code, _, (_, host, port) = node.requestTopic("/wire", topic, [["TCPROS"]])
    assert code == 1
    return host, port


class TcprosWire:
    """One connection. `small` makes it one that the other side cannot send much ahead on."""

    def __init__(self, address: tuple[str, int], small: bool = False) -> None:
        self.socket = socket.socket()
        self.socket.settimeout(LIMIT_S)
        if small:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.socket.connect(address)

    def begin(self, **fields: str) -> Fields:
        """Send a header and read the other one."""
        self.socket.sendall(encode_header(fields))
        return self.header()

    def header(self) -> Fields:
        return decode_header(self.message())

    def message(self) -> bytes:
        (length,) = struct.unpack("<I", self.exactly(4))
        return self.exactly(length)

    def exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            piece = self.socket.recv(min(1 << 20, count - len(data)))
            assert piece, f"the other side hung up after {data[:1000]!r}"
            data += piece
        return data

    def is_over(self) -> bool:
        """Wait until the other side hangs up; True when nothing came before."""
        try:
            return self.socket.recv(1) == b""
        except ConnectionResetError:
            return True

    def close(self) -> None:
        self.socket.close()

    def __enter__(self) -> TcprosWire:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
