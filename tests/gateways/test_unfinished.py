"""What is unfinished holds neither memory nor places, in the WebSocket gateway and in that of Foxglove."""

from __future__ import annotations

import json
import socket
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from daemon_fixture import Runtime, running_daemon
from foxglove_app import FoxgloveApp
from raw_websocket import (
    closed,
    descriptors,
    forget_peak,
    frame,
    gateway_pid,
    head,
    is_over,
    memory_mib,
    raw_socket,
    request,
    send_all,
    shaken,
)
from running_gateway import log, running_gateway
from waiting import eventually
from websockets.exceptions import ConnectionClosed

sys.path.append(str(Path(__file__).parent / "websocket"))
from rosbridge_client import RosbridgeClient

MIB = 1 << 20
MOST_MIB = 128
"""The bound on what all connections of a gateway hold unfinished."""
SPARE_MIB = 150
"""For what is being copied, and for what allocators keep."""
ATTEMPTS = 24
KINDS = ("websocket", "foxglove")
DEFLATE = "Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits\r\n"
PROTOCOL = {"websocket": "", "foxglove": "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"}


@pytest.fixture(scope="module")
def runtime() -> Iterator[Runtime]:
    with running_daemon(paused=True) as one:
        yield one


class Gateway:
    """A running gateway, and a client of it that works before and after, on one connection."""

    def __init__(self, runtime: Runtime, kind: str, url: str) -> None:
        self.runtime, self.kind, self.url = runtime, kind, url
        self.pid = gateway_pid(runtime, kind)
        self.client: Any = RosbridgeClient(url) if kind == "websocket" else FoxgloveApp(url)

    def shaken(self, more: str = "") -> socket.socket:
        return shaken(self.url, PROTOCOL[self.kind] + more)

    def works(self, client: Any = None) -> bool:
        client = client or self.client
        if self.kind == "websocket":
            return bool(client.call("/rosapi/get_time")["result"])
        client.send("getParameters", parameterNames=["/no_such"], id="ask")
        return bool(client.wait("parameterValues", id="ask"))

    def lets_in(self) -> bool:
        """True when a newcomer is served."""
        with RosbridgeClient(self.url) if self.kind == "websocket" else FoxgloveApp(self.url) as one:
            return self.works(one)

    def connections(self) -> int:
        with self.runtime.client() as client:
            answer = client.call(f"/slidectl/gateways/{self.kind}")
        return int(dict(zip(answer["names"], answer["values"], strict=True))["connections"])

    def send_long(self) -> None:
        """A whole message of 8 MiB of the client that works."""
        text = "x" * (8 * MIB)
        if self.kind == "websocket":
            self.client.send(op="publish", topic="/long", type="std_msgs/String", msg={"data": text})
        else:
            self.client.send("getParameters", parameterNames=[text[:100]], id=text)
            assert self.client.wait("parameterValues", id=text)


@pytest.fixture(params=KINDS)
def gateway(runtime: Runtime, request: pytest.FixtureRequest) -> Iterator[Gateway]:
    """It writes nothing, and its client is never disconnected."""
    more = {"compress": True} if request.param == "websocket" else {}
    with running_gateway(runtime, request.param, **more) as url:
        one = Gateway(runtime, request.param, url)
        assert one.works()
        yield one
        assert one.works()
        assert log(runtime, request.param) == ""
        (one.client.socket if request.param == "websocket" else one.client.websocket).close()


def attack(
    gateway: Gateway,
    begun: Callable[[socket.socket], object],
    more: str = "",
    is_bounded_by_loss: bool = True,
    copies: int = 1,
) -> None:
    """Many connections begin something; the sum stays bounded, the client loses nothing, and the rest is freed."""
    before = memory_mib(gateway.pid)
    forget_peak(gateway.pid)
    with ExitStack() as stack:
        some = [stack.enter_context(gateway.shaken(more)) for _ in range(ATTEMPTS)]
        for number, one in enumerate(some):
            begun(one)
            if number % 8 == 7:
                assert gateway.works()
        gateway.send_long()
        assert gateway.works()
        assert gateway.lets_in()
        grown = memory_mib(gateway.pid, "VmHWM") - before
        assert grown < copies * MOST_MIB + SPARE_MIB, f"{grown:.0f} MiB"
        ended = [one for one in some if is_over_softly(one)]
        if is_bounded_by_loss:
            assert ended, "nobody was closed"
    eventually(lambda: gateway.connections() == 1)
    eventually(lambda: memory_mib(gateway.pid) < before + SPARE_MIB, "memory stays")


def is_over_softly(one: socket.socket) -> bool:
    one.setblocking(False)
    return is_over(one)


def test_frames_that_are_begun_and_not_ended(gateway: Gateway) -> None:
    data = head(16_000_000) + bytes(15_900_000)
    attack(gateway, lambda one: send_all(one, data))


def test_messages_whose_last_frame_does_not_come(gateway: Gateway) -> None:
    data = frame(bytes(8_000_000), is_last=False) + frame(bytes(7_900_000), 0, is_last=False)
    attack(gateway, lambda one: send_all(one, data))


def test_frames_without_content_that_never_end(gateway: Gateway) -> None:
    """Each has six bytes on the wire, and is an object in memory."""
    data = frame(b"", is_last=False) + frame(b"", 0, is_last=False) * 100_000
    attack(gateway, lambda one: send_all(one, data))


def test_who_is_closed_is_told_the_reason(gateway: Gateway) -> None:
    with ExitStack() as stack:
        some = [stack.enter_context(gateway.shaken()) for _ in range(12)]
        for one in some:
            send_all(one, head(16_000_000) + bytes(15_000_000))
        code, reason = closed(some[0])  # they hold the same, and it for longest
        assert (code, "unfinished" in reason, "128 MiB" in reason) == (1013, True, True), reason


def test_a_message_that_was_handled_is_not_kept(gateway: Gateway) -> None:
    """The library keeps the last frame of a connection."""
    before = memory_mib(gateway.pid)
    sent = frame(b'{"op":"' + b"x" * 15_000_000 + b'"}')
    with ExitStack() as stack:
        for _ in range(20):
            one = stack.enter_context(gateway.shaken())
            one.sendall(sent)
            assert gateway.works()
        eventually(lambda: memory_mib(gateway.pid) < before + SPARE_MIB)


def test_small_frames_that_unpack_to_much(runtime: Runtime) -> None:
    packer = zlib.compressobj(9, zlib.DEFLATED, -12)
    bomb = packer.compress(bytes(15_900_000)) + packer.flush(zlib.Z_SYNC_FLUSH)
    assert len(bomb) < 20_000
    with running_gateway(runtime, "websocket", compress=True) as url:
        gateway = Gateway(runtime, "websocket", url)
        attack(gateway, lambda one: send_all(one, frame(bomb, is_last=False, bits=0x40)), DEFLATE)
        many = frame(bomb[:-4], bits=0x40) * 100  # whole ones; each is also read as JSON, and told to the daemon
        attack(gateway, lambda one: send_all(one, many), DEFLATE, is_bounded_by_loss=False, copies=4)
        gateway.client.close()


# --- fragments of rosbridge ------------------------------------------------------------------------------------------


def fragment(name: Any, number: Any, total: Any, data: Any) -> bytes:
    return frame(json.dumps({"op": "fragment", "id": name, "num": number, "total": total, "data": data}).encode())


@pytest.fixture
def rosbridge(runtime: Runtime) -> Iterator[Gateway]:
    with running_gateway(runtime, "websocket") as url:
        one = Gateway(runtime, "websocket", url)
        yield one
        assert one.works()
        one.client.close()


def test_fragments_of_which_one_is_missing(rosbridge: Gateway) -> None:
    text = "x" * 1_000_000
    data = b"".join(fragment("a", number, 16, text) for number in range(15))
    attack(rosbridge, lambda one: send_all(one, data))


def test_fragments_that_never_end(rosbridge: Gateway) -> None:
    data = b"".join(fragment("a", number, 10**9, "") for number in range(70_000))
    attack(rosbridge, lambda one: send_all(one, data), is_bounded_by_loss=False)


def test_fragments_that_come_twice_in_turn_or_within_others(rosbridge: Gateway) -> None:
    call = json.dumps({"op": "call_service", "service": "/rosapi/get_time", "id": "whole"})
    parts = [call[at : at + 20] for at in range(0, len(call), 20)]
    sent = rosbridge.client
    for name in ("a", "b"):  # the same message twice, its pieces in turn with those of the other, the last one first
        sent.send(op="fragment", id=name, num=len(parts) - 1, total=len(parts), data=parts[-1])
    for number, part in enumerate(parts[:-1]):
        for name in ("a", "b", "a"):  # one comes twice
            sent.send(op="fragment", id=name, num=number, total=len(parts), data=part)
        if number == 0:
            sent.send(op="fragment", id="a", num=0, total=len(parts), data="another text, which comes too late")
    for _ in range(2):
        assert sent.op("service_response", id="whole")["result"]
    within = json.dumps({"op": "fragment", "id": "c", "num": 0, "total": 2, "data": "x"})
    sent.send(op="fragment", id="d", num=0, total=1, data=within)
    assert "within" in sent.op("status", level="error")["msg"]
    for wrong in ({"num": 1, "total": 1}, {"num": -1, "total": 1}, {"num": 0, "total": 0}, {"num": 0.5, "total": 2},
                  {"num": None, "total": 2}, {"num": 0, "total": 2, "data": 1}):  # fmt: skip
        sent.send(**{"op": "fragment", "id": "e", "data": "x", **wrong})
        assert "fragment" in sent.op("status", level="error")["msg"]
    sent.send(op="fragment", id="f", num=0, total=2, data="x")
    sent.send(op="fragment", id="f", num=1, total=3, data="x")
    assert "total" in sent.op("status", level="error")["msg"]


def test_goals_with_long_ids_are_not_kept(rosbridge: Gateway) -> None:
    rosbridge.client.send(op="send_action_goal", action="/a", action_type="a/B", id="x" * 10_000, args={})
    assert "at most 1000 characters" in rosbridge.client.op("action_result")["values"]


# --- what is packed --------------------------------------------------------------------------------------------------


def test_a_png_or_cbor_of_a_client_is_not_unpacked(rosbridge: Gateway) -> None:
    import cbor2

    before = memory_mib(rosbridge.pid)
    forget_peak(rosbridge.pid)
    bomb = zlib.compress(bytes(500 * MIB), 9).hex()
    rosbridge.client.send(op="png", data=bomb, id="png")
    assert "png" in str(rosbridge.client.op("status", level="error"))
    deep: Any = 1
    for _ in range(300):
        deep = [deep]
    for sent in (cbor2.dumps({"op": "publish", "msg": deep}), b"\x9b" + b"\xff" * 8, b"\x5b\0\0\0\x40" + bytes(4),
                 b"\x9f" * 100_000, cbor2.dumps(["x" * 1000] * 1000)):  # fmt: skip
        rosbridge.client.socket.send(sent)
        assert "JSON" in rosbridge.client.op("status", level="error")["msg"]
    assert memory_mib(rosbridge.pid, "VmHWM") < before + 30


# --- calls that are not answered -------------------------------------------------------------------------------------


def test_requests_of_calls_that_nobody_answers_are_counted(runtime: Runtime) -> None:
    with running_gateway(runtime, "foxglove") as url, RosbridgeProvider(runtime) as service:
        gateway = Gateway(runtime, "foxglove", url)
        before = memory_mib(gateway.pid)
        while service not in gateway.client.services:
            gateway.client.receive()
        number = gateway.client.services[service]["id"]
        payload = json.dumps({"node": "x" * 10_000_000}).encode()
        with ExitStack() as stack:
            apps = [stack.enter_context(FoxgloveApp(url)) for _ in range(4)]
            forget_peak(gateway.pid)
            lost = [app for app in apps if not all(calls(app, number, payload) for _ in range(15))]
            assert gateway.works()
            assert lost
            assert memory_mib(gateway.pid, "VmHWM") < before + 4 * MOST_MIB
        eventually(lambda: memory_mib(gateway.pid) < before + SPARE_MIB, "memory stays")
        gateway.client.websocket.close()


def calls(app: FoxgloveApp, service: int, payload: bytes) -> bool:
    """False when the app has been disconnected."""
    try:
        app.websocket.send(b"\2" + service.to_bytes(4, "little") + bytes(4) + b"\4\0\0\0json" + payload)
    except ConnectionClosed as error:
        return (error.rcvd and error.rcvd.code) not in (1013, None)
    return True


class RosbridgeProvider:
    """A service that is offered and never answers, by a client of the daemon."""

    def __init__(self, runtime: Runtime) -> None:
        self._client = runtime.client()

    def __enter__(self) -> str:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(self._client.paths.socket_text)
        self._socket.sendall(b'{"op":"advertise_service","service":"/silent","type":"rosapi/NodeDetails"}\n')
        eventually(lambda: "/silent" in self._client.call("/rosapi/services")["services"])
        return "/silent"

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._client.close()


# --- places ----------------------------------------------------------------------------------------------------------


def test_a_thousand_handshakes_that_are_begun_do_not_keep_newcomers_out(gateway: Gateway) -> None:
    before, had = memory_mib(gateway.pid), descriptors(gateway.pid)
    half = request(PROTOCOL[gateway.kind])[:60]
    with ExitStack() as stack:
        some = [stack.enter_context(raw_socket(gateway.url)) for _ in range(1000)]
        for one in some:
            send_all(one, half + b"X" * 4000)
        for _ in range(3):
            assert gateway.lets_in()
        assert gateway.works()
        assert memory_mib(gateway.pid) < before + 60
    eventually(lambda: descriptors(gateway.pid) <= had + 1)


def test_a_handshake_that_is_too_long_is_refused(gateway: Gateway) -> None:
    with raw_socket(gateway.url) as one:
        send_all(one, b"GET / HTTP/1.1\r\n" + b"".join(b"X%d: %s\r\n" % (n, b"y" * 8000) for n in range(100)))
        assert one.recv(12) == b"HTTP/1.1 400"


def test_a_thousand_clients_are_refused_plainly_and_leave_nothing(gateway: Gateway) -> None:
    eventually(lambda: gateway.connections() == 1)
    before, had = memory_mib(gateway.pid), descriptors(gateway.pid)
    answers: list[bytes] = []
    with ExitStack() as stack:
        for _ in range(1000):
            one = stack.enter_context(raw_socket(gateway.url))
            one.sendall(request(PROTOCOL[gateway.kind]))
            answers.append(one.recv(4096))
        assert sum(b" 101 " in answer for answer in answers) == 199
        refused = [answer for answer in answers if b" 101 " not in answer]
        assert all(answer.startswith(b"HTTP/1.1 503") for answer in refused)
        assert all(b"200 clients are connected, which is the maximum" in answer for answer in refused)
        assert gateway.works()
    eventually(lambda: gateway.connections() == 1)
    eventually(lambda: descriptors(gateway.pid) <= had + 1)
    assert memory_mib(gateway.pid) < before + 60
    assert gateway.lets_in()


def test_apps_that_do_not_read_hold_a_bounded_sum(runtime: Runtime) -> None:
    with running_gateway(runtime, "foxglove") as url, runtime.client() as client:
        gateway = Gateway(runtime, "foxglove", url)
        client.publish("/flood", {"data": ""}, type="std_msgs/String")
        channel = gateway.client.channel("/flood")["id"]
        before = memory_mib(gateway.pid)
        forget_peak(gateway.pid)
        subscribe = json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel}]}).encode()
        with ExitStack() as stack:
            some = [stack.enter_context(gateway.shaken()) for _ in range(40)]
            for one in some:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                send_all(one, frame(subscribe))
            eventually(lambda: "/flood" in str(client.call("/rosapi/topics")))
            assert gateway.works()
            for _ in range(40):
                client.publish("/flood", {"data": "x" * 500_000}, type="std_msgs/String")
                assert gateway.works()
            assert memory_mib(gateway.pid, "VmHWM") < before + 256 + 40 * 2 + SPARE_MIB
        eventually(lambda: gateway.connections() == 1)
        eventually(lambda: memory_mib(gateway.pid) < before + SPARE_MIB, "memory stays")
        gateway.client.websocket.close()
