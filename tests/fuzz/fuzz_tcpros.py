"""What a node of ROS 1 may send over TCPROS: headers, frames and the bytes of messages, changed at random."""

from __future__ import annotations

import asyncio
import struct
from random import Random
from typing import Any

from fuzz_mutations import mutated_bytes
from fuzz_target import Fault, Target
from random_messages import all_types, random_message

from slidectl import msgs
from slidectl.errors import BadMessage, SlidectlError
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.extensions.gateways.ros1.tcpros import Fields, TcprosConnection, encode_header, frame
from slidectl.wire.json_lines import LONGEST_LINE, encode

STREAMS = 100
"""Of one case."""
_VALUES = ("*", "1", "true", "/slider/joint_states", "std_msgs/Float64", "é=", "", "a" * 3000)


class _Socket:
    """Takes every option."""

    def setsockopt(self, *_: Any) -> None:
        pass

    def fileno(self) -> int:
        return 7


class _Transport(asyncio.Transport):
    """Keeps what is written."""

    def __init__(self) -> None:
        super().__init__()
        self.written = b""

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return _Socket() if name == "socket" else default

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.written += bytes(data)

    def write_eof(self) -> None:
        pass

    def is_closing(self) -> bool:
        return False

    def close(self) -> None:
        pass


class TcprosStreams:
    """A header and some messages, changed, in pieces: they are taken, or refused with a reason, and never kept."""

    kind = "tcpros"

    def __init__(self, target: Target) -> None:
        del target
        self.types = all_types()

    def case(self, rng: Random) -> str:
        asyncio.run(self._streams(rng))
        return "taken or refused"

    async def _streams(self, rng: Random) -> None:
        before = TcprosConnection._account.sum
        for _ in range(STREAMS):
            self._stream(rng)
        if TcprosConnection._account.sum != before:
            raise Fault(f"{TcprosConnection._account.sum - before} bytes are still counted")

    def _stream(self, rng: Random) -> None:
        name = rng.choice(self.types)
        kind = ros1_type(name)
        begun: list[Fields] = []
        has_status = rng.random() < 0.3
        connection = TcprosConnection(lambda _, fields: begun.append(fields), has_status)
        taken: list[bytes] = []
        connection.on_message = lambda body, _: taken.append(body)
        transport = _Transport()
        connection.connection_made(transport)
        data = self._bytes(rng, name, has_status)
        while data:
            size = rng.choice((1, 4, 100, len(data)))
            connection.data_received(data[:size])
            data = data[size:]
        if not begun and transport.written and b"error=" not in transport.written:
            raise Fault(f"a header was refused without a reason: {transport.written!r}")
        for body in taken:
            try:
                message = kind.unpack(body)
            except BadMessage:
                continue
            line = encode(message)
            if len(line) < LONGEST_LINE:
                try:
                    msgs.check(name, message)  # as the daemon does: it takes it, or says what is wrong
                except SlidectlError:
                    continue
        connection.close()

    def _bytes(self, rng: Random, name: str, has_status: bool) -> bytes:
        fields = {key: rng.choice(_VALUES) for key in ("topic", "service", "md5sum", "callerid", "type", "persistent")}
        header = encode_header(fields)
        body = ros1_type(name).pack(random_message(rng, name))
        messages = []
        for _ in range(rng.choice((0, 1, 3))):
            one = mutated_bytes(rng, body) if rng.random() < 0.6 else body
            framed = frame(one) if rng.random() < 0.9 else struct.pack("<I", rng.choice((0, 5, 2**32 - 1))) + one
            messages.append((b"\1" if has_status else b"") + framed)
        whole = header + b"".join(messages)
        return mutated_bytes(rng, whole) if rng.random() < 0.5 else whole
