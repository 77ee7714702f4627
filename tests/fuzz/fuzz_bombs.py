"""Bombs for the gateways: little that becomes much, much that is never whole, and claims."""

from __future__ import annotations

import json
import socket
import struct
import sys
import zlib
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from random import Random
from urllib.parse import urlsplit

from fuzz_target import Fault, Target, check_text

sys.path.append(str(Path(__file__).parent.parent / "gateways"))
from raw_websocket import frame, gateway_pid, head, memory_mib, request, send_all, shaken
from running_gateway import log, running_gateway

KINDS = ("websocket", "foxglove", "ros1")
CONNECTIONS = 20
"""Of a case."""
MOST_MIB = 600
"""How much a gateway may have in memory: bounds of 128 and 64 MiB, times the copies while something is handled."""
_DEFLATE = "Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits\r\n"
_FOXGLOVE = "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"
_MIB = 1 << 20
_ANSWER_S = 20.0


class Bombs:
    """Some connections with bombs to each gateway, left open for a case: its memory is bounded, and it answers."""

    kind = "bombs"

    def __init__(self, target: Target) -> None:
        self.target = target
        self.addresses = {}
        for kind in KINDS:
            more = {"compress": True} if kind == "websocket" else {}
            self.addresses[kind] = target.closing.enter_context(running_gateway(target.runtime, kind, **more))

    def case(self, rng: Random) -> str:
        kind = rng.choice(KINDS)
        with ExitStack() as stack:
            for _ in range(CONNECTIONS):
                one = stack.enter_context(self._connected(kind))
                one.settimeout(_ANSWER_S)
                with suppress(TimeoutError):  # it is not read any more: that is an answer, too
                    send_all(one, _bomb(rng, kind))
                self._check_memory(kind)
            self._check_answer(kind)
        self._check_memory(kind)
        check_text(log(self.target.runtime, kind), "the log of the gateway")
        self.target.check()
        return kind

    def _connected(self, kind: str) -> socket.socket:
        if kind == "ros1":
            return _plain(self.addresses[kind])
        return shaken(self.addresses[kind], _DEFLATE if kind == "websocket" else _FOXGLOVE)

    def _check_memory(self, kind: str) -> None:
        used = memory_mib(gateway_pid(self.target.runtime, kind))
        if used > MOST_MIB:
            raise Fault(f"the {kind} gateway has {used:.0f} MiB in memory")

    def _check_answer(self, kind: str) -> None:
        """Raises Fault unless a newcomer is served while the others are there."""
        with _plain(self.addresses[kind]) as one:
            one.settimeout(_ANSWER_S)
            if kind == "ros1":
                param = b"<params><param><value>/x</value></param></params>"
                body = b"<methodCall><methodName>getPid</methodName>" + param + b"</methodCall>"
                one.sendall(b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
            else:
                one.sendall(request(_FOXGLOVE if kind == "foxglove" else ""))
            try:
                answer = one.recv(20)
            except (OSError, TimeoutError) as error:
                raise Fault(f"the {kind} gateway does not answer: {error!r}") from None
        if answer[9:12] not in (b"101", b"200"):
            raise Fault(f"the {kind} gateway answers {answer!r}")


def _plain(address: str) -> socket.socket:
    url = urlsplit(address)
    return socket.create_connection((url.hostname, url.port), timeout=_ANSWER_S)


def _bomb(rng: Random, kind: str) -> bytes:
    if kind == "ros1":
        return rng.choice(_XML_BOMBS)(rng)
    bombs = [*_FRAME_BOMBS, *(_ROSBRIDGE_BOMBS if kind == "websocket" else _FOXGLOVE_BOMBS)]
    return rng.choice(bombs)(rng)


def _packed(rng: Random) -> bytes:
    """A frame of some thousand bytes that unpacks to megabytes, or to more than a message may have."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -12)
    much = bytes(rng.randrange(100_000, 40 * _MIB))
    packed = packer.compress(much) + packer.flush(zlib.Z_SYNC_FLUSH)
    is_last = rng.random() < 0.5
    return frame(packed[:-4] if is_last else packed, is_last=is_last, bits=0x40) * rng.choice((1, 5))


def _fragments(rng: Random) -> bytes:
    """Fragments of rosbridge: many ids, some twice, some missing, with totals that do not come."""
    text = "x" * rng.choice((0, 100, 1_000_000))
    total = rng.choice((1, 2, 16, 10**9))
    return b"".join(
        frame(json.dumps({"op": "fragment", "id": str(rng.randrange(20)), "num": rng.randrange(20), "total": total,
                          "data": text}).encode())
        for _ in range(rng.choice((10, 20)))
    )  # fmt: skip


def _picture(rng: Random) -> bytes:
    """What says that it is a PNG or CBOR."""
    packed = zlib.compress(bytes(rng.randrange(_MIB, 50 * _MIB)), 9)
    if rng.random() < 0.5:
        return frame(json.dumps({"op": "png", "data": packed.hex()}).encode())
    return frame(rng.choice((b"\x9b" + b"\xff" * 8, b"\x5b\0\0\0\x40" + bytes(4), b"\x9f" * 100_000, packed)), op=2)


_FRAME_BOMBS: tuple[Callable[[Random], bytes], ...] = (
    lambda rng: head(rng.choice((16 * _MIB, 1 << 40, 1 << 62))) + bytes(rng.randrange(10)),
    lambda rng: head(16_000_000) + bytes(rng.randrange(15_900_000)),
    lambda rng: frame(bytes(rng.randrange(8 * _MIB)), is_last=False) + frame(bytes(7 * _MIB), 0, is_last=False),
    lambda rng: frame(b"", is_last=False) + frame(b"", 0, is_last=False) * rng.randrange(100_000),
    lambda rng: frame(b"p" * rng.randrange(126), 9) * rng.randrange(10_000),
    lambda rng: frame(b"[" * rng.randrange(_MIB)),
    lambda rng: frame(b'{"op":"x","a":[' + b"{}," * rng.randrange(500_000) + b"{}]}"),
)
_ROSBRIDGE_BOMBS = (_packed, _fragments, _picture)
_FOXGLOVE_BOMBS: tuple[Callable[[Random], bytes], ...] = (
    lambda rng: frame(struct.pack("<BIII", 2, 1, 1, rng.choice((4, 1 << 31))) + b"json" + bytes(8 * _MIB), op=2),
    lambda rng: frame(json.dumps({"op": "subscribeParameterUpdates",
                                  "parameterNames": [f"/{rng.randrange(10**9)}" + "x" * 900] * 9000}).encode()),
)  # fmt: skip
_XML_BOMBS: tuple[Callable[[Random], bytes], ...] = (
    lambda rng: b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % rng.choice((16 * _MIB, 17 * _MIB, 10**11)),
    lambda rng: b"POST / HTTP/1.1\r\nContent-Length: 16777216\r\n\r\n" + bytes(rng.randrange(16 * _MIB)),
    lambda _: b"POST / HTTP/1.1\r\nX: " + b"y" * 15_000,
    lambda rng: _posted(b"<value><array><data>" * rng.randrange(100_000)),
    lambda rng: _posted(b"<methodCall><params><param><value><array><data>" + b"<value/>" * rng.randrange(200_000)),
    lambda _: _posted(
        b"<!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;&a;&a;'>]><methodCall>&b;</methodCall>"
    ),
)


def _posted(body: bytes) -> bytes:
    return b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(body) + body
