"""What a node of ROS 1 may send over TCPROS: headers, frames and the bytes of messages, changed at random."""

from __future__ import annotations

import asyncio
import struct
from contextlib import suppress
from random import Random
from typing import Any

from fuzz_mutations import mutated_bytes
from fuzz_target import Fault, Target
from random_messages import all_types, random_message

from slidectl import msgs
from slidectl.errors import BadMessage, SlidectlError
from slidectl.extensions.gateways.ros1.counted_streams import connect
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.extensions.gateways.ros1.tcpros import (
    HELD,
    BadHeader,
    MessageTooLong,
    TcprosConnection,
    encode_header,
    frame,
)
from slidectl.wire.json_lines import LONGEST_LINE, encode

STREAMS = 100
"""Of one case."""
_LIMIT_S = 20.0
_VALUES = ("*", "1", "true", "/slider/joint_states", "std_msgs/Float64", "é=", "", "a" * 3000)


def _check(name: str, message: Any) -> None:
    """Check a message as the daemon does: it takes it, or says what is wrong."""
    if len(encode(message)) < LONGEST_LINE:
        with suppress(SlidectlError):
            msgs.check(name, message)


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
        before = HELD.sum
        server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        self._sent: asyncio.Queue[bytes] = asyncio.Queue()
        try:
            for _ in range(STREAMS):
                await self._stream(rng, server.sockets[0].getsockname()[1])
        finally:
            server.close()
        if HELD.sum != before:
            raise Fault(f"{HELD.sum - before} bytes are still counted")

    async def _accept(self, _: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Be the other side: send the bytes of this stream in pieces, and hang up."""
        data = await self._sent.get()
        size = max(1, len(data) // 3)
        try:
            for at in range(0, len(data), size):
                writer.write(data[at : at + size])
                await writer.drain()
        except ConnectionError:
            pass  # it was refused
        finally:
            writer.close()

    async def _stream(self, rng: Random, port: int) -> None:
        name = rng.choice(self.types)
        kind = ros1_type(name)
        has_status = rng.random() < 0.3
        await self._sent.put(self._bytes(rng, name, has_status))
        connection = TcprosConnection(*await connect("127.0.0.1", port, HELD))
        try:
            async with asyncio.timeout(_LIMIT_S):
                await connection.read_header()
                while True:
                    if has_status:
                        await connection.reader.readexactly(1)
                    with suppress(BadMessage):
                        _check(name, kind.unpack(await connection.read_message()))
                    connection.reader.handled()
        except TimeoutError:
            raise Fault("a stream that has ended is waited for") from None
        except (BadHeader, MessageTooLong, EOFError, OSError):
            pass
        finally:
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
