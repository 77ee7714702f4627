"""Browsers that do not read, that are many, that send too much, or half; and the others beside them."""

from __future__ import annotations

import json
import socket
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

import pytest
import raw_websocket
from daemon_fixture import Runtime, running_daemon
from raw_websocket import frame, raw_socket, shaken
from rosbridge_client import RosbridgeClient
from running_gateway import log, running_gateway
from waiting import eventually
from websockets.exceptions import InvalidHandshake

TOPIC = "/slider/joint_states"


@pytest.fixture(scope="module")
def url(world: Runtime) -> Iterator[str]:
    """At its end it may have written nothing."""
    with running_gateway(world, "websocket", max_connections=50, compress=True) as address:
        yield address
        assert log(world, "websocket") == ""


@pytest.fixture
def other(url: str) -> Iterator[RosbridgeClient]:
    """A browser that works before and after."""
    with RosbridgeClient(url) as one:
        assert one.call("/rosapi/get_time")["result"]
        yield one
        assert one.call("/rosapi/get_time")["result"]


def status(world: Runtime) -> dict[str, int]:
    with world.client() as client:
        answer = client.call("/slidectl/gateways/websocket")
    return {name: int(value) for name, value in zip(answer["names"], answer["values"], strict=True)}


def memory_mib(world: Runtime) -> float:
    return raw_websocket.memory_mib(raw_websocket.gateway_pid(world, "websocket"))


def test_a_reader_that_stops_loses_messages_and_costs_nothing(url: str, world: Runtime, other: RosbridgeClient) -> None:
    text = "x" * 5000
    before = status(world)["dropped"]
    with shaken(url) as stopped, world.client() as client:
        stopped.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stopped.sendall(frame(json.dumps({"op": "subscribe", "topic": "/flood", "type": "std_msgs/String"}).encode()))
        other.send(op="subscribe", topic="/flood", type="std_msgs/String", queue_length=100_000)
        assert other.call("/rosapi/get_time")["result"]
        eventually(lambda: len(client.call("/rosapi/subscribers", {"topic": "/flood"})["subscribers"]) == 2)
        used = memory_mib(world)
        for number in range(3000):
            client.publish("/flood", {"data": f"{number} {text}"}, type="std_msgs/String")
            if number % 100 == 99:
                assert other.op("publish", topic="/flood")["msg"]["data"].startswith(f"{number - 99} ")
                for _ in range(99):
                    other.op("publish", topic="/flood")
        assert memory_mib(world) < used + 20
        stopped.settimeout(60)
        while status(world)["dropped"] == before:
            assert stopped.recv(65536)
    other.send(op="unsubscribe", topic="/flood")


def send_for_ever(one: socket.socket, sent: bytes) -> None:
    """Until it is not taken any more; 500 MB are."""
    for _ in range(500 * 1024 * 1024 // len(sent)):
        one.sendall(sent)


def test_answers_that_nobody_takes_stop_the_questions(url: str, world: Runtime, other: RosbridgeClient) -> None:
    asked = frame(json.dumps({"op": "call_service", "service": "/rosapi/topics_and_raw_types"}).encode())
    used = memory_mib(world)
    with shaken(url) as greedy, shaken(url) as pinging:
        for one, sent in ((greedy, asked * 100), (pinging, frame(b"p" * 125, op=9) * 1000)):
            one.settimeout(3)
            with pytest.raises(TimeoutError):
                send_for_ever(one, sent)
        assert other.call("/rosapi/get_time")["result"]
        assert memory_mib(world) < used + 60


@pytest.mark.usefixtures("other")
def test_a_thousand_connections(url: str, world: Runtime) -> None:
    with ExitStack() as stack:
        eventually(lambda: status(world)["connections"] == 1)
        let_in: list[RosbridgeClient] = []
        for _ in range(60):
            with suppress(InvalidHandshake):
                let_in.append(stack.enter_context(RosbridgeClient(url)))
        assert len(let_in) == 49
        idle = []
        for _ in range(1000):
            idle.append(stack.enter_context(raw_socket(url)))
        values = let_in[-1].call("/slidectl/gateways/websocket")["values"]
        assert dict(zip(values["names"], values["values"], strict=True))["connections"] == "50"
        assert len(let_in[0].call("/rosapi/nodes")["values"]["nodes"]) < 100
    eventually(lambda: status(world)["connections"] == 1)

    def comes_in() -> bool:
        with suppress(InvalidHandshake, OSError), RosbridgeClient(url) as one:
            return bool(one.call("/rosapi/get_time")["result"])
        return False

    eventually(comes_in)


@pytest.mark.usefixtures("other")
@pytest.mark.parametrize(
    "sent",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03", b"\0" * 100_000,
        b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 10_000, b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nhello",
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    ],
)  # fmt: skip
def test_what_is_no_handshake(url: str, sent: bytes) -> None:
    with raw_socket(url) as one, suppress(OSError):
        one.sendall(sent)
        one.shutdown(socket.SHUT_WR)
        while one.recv(4096):
            pass


@pytest.mark.usefixtures("other")
def test_half_a_handshake_is_not_waited_for_without_end(url: str) -> None:
    with raw_socket(url) as silent, raw_socket(url) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgr")
        for one in (silent, slow):
            with suppress(OSError):
                while one.recv(4096):
                    pass


@pytest.mark.usefixtures("other")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: frame(b"x" * (17 << 20)), 1009),
        (lambda: frame(b"x" * (9 << 20), is_last=False) + frame(b"x" * (9 << 20), op=0), 1009),
        (lambda: b"\x81\xff" + struct.pack(">Q", 1 << 62) + b"\0\0\0\0", 1009),
        (lambda: frame(b"x", bits=0x70), 1002), (lambda: frame(b"x", op=3), 1002), (lambda: frame(b"x", op=0), 1002),
        (lambda: b"\x81\x05hello", 1002), (lambda: frame(b"x" * 126, op=9), 1002),
    ],
)  # fmt: skip
def test_frames_that_are_none_or_too_large_end_the_connection(url: str, make: Callable[[], bytes], code: int) -> None:
    sent = make()  # here, since the parameters of tests stay in memory to the end
    with shaken(url) as one:
        with suppress(OSError):
            one.sendall(sent)
        received = b""
        with suppress(OSError):
            while more := one.recv(65536):
                received += more
        assert not received or struct.unpack(">H", received[2:4])[0] == code


@pytest.mark.usefixtures("other")
def test_a_bomb_of_packed_zeros_is_not_unpacked(url: str, world: Runtime) -> None:
    packer = zlib.compressobj(9, zlib.DEFLATED, -12)
    bomb = b"".join(packer.compress(b" " * (1 << 20)) for _ in range(100)) + packer.flush(zlib.Z_SYNC_FLUSH)
    used = memory_mib(world)
    with shaken(url, "Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits\r\n") as one:
        one.sendall(frame(bomb[:-4], bits=0x40))
        assert struct.unpack(">H", one.recv(65536)[2:4])[0] == 1009
    assert memory_mib(world) < used + 100


def test_a_frame_of_eight_mib_and_one_of_many_values(other: RosbridgeClient) -> None:
    text = json.dumps({"op": "publish", "topic": "/rosout", "msg": {"msg": "x" * (8 << 20)}, "id": "big"})
    other.socket.send(text)
    other.socket.send(
        '{"op":"call_service","id":"many","service":"/rosapi/topics","args":[' + "[]," * 1_000_000 + "[]]}"
    )
    assert not other.op("service_response", id="many")["result"]


def test_who_sends_too_fast_has_to_wait() -> None:
    with (
        running_daemon(paused=True) as quick,
        running_gateway(quick, "websocket", max_rate=50) as slow,
        RosbridgeClient(slow) as one,
    ):
        began = time.monotonic()
        for _ in range(120):
            one.send(op="publish", topic="/x", type="std_msgs/Empty", msg={})
        assert one.call("/rosapi/get_time")["result"]
        assert time.monotonic() - began > 2.0
