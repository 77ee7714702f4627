"""The page beside browsers that do not read, that are many, and that send what no browser sends."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urljoin, urlsplit
from urllib.request import urlopen

import msgspec.msgpack
import pytest
import viser
from daemon_fixture import Runtime, running_daemon
from other_user import as_nobody, needs_root
from page_browser import CommandLine, PageBrowser, served_page
from waiting import eventually
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect

sys.path.append(str(Path(__file__).parent.parent / "gateways"))
from raw_websocket import closed, descriptors, head, memory_mib, raw_socket, request, send_all, shaken


@pytest.fixture(scope="module")
def runtime() -> Iterator[Runtime]:
    with running_daemon(paused=True) as one:
        CommandLine(one.folder).ok("spawn", "slider", "--controllers", "config/slider_control.yaml")
        yield one


@pytest.fixture(scope="module")
def world(runtime: Runtime) -> CommandLine:
    return CommandLine(runtime.folder)


@pytest.fixture(scope="module")
def page(world: CommandLine) -> Iterator[str]:
    """At its end nothing may have been written to stderr."""
    with served_page(world) as url:
        yield url


@pytest.fixture
def other(page: str, world: CommandLine) -> Iterator[PageBrowser]:
    """A browser that works before and after."""
    with PageBrowser(page) as one, world.client() as client:
        one.page("state")
        yield one
        cycles = client.call("/slidectl/status")["cycles"]
        assert one.call("/slidectl/step", cycles=3)["cycles"] == cycles + 3
        one.wait_for(lambda: "/ground" in one.nodes)


def message(kind: str, **fields: Any) -> bytes:
    return msgspec.msgpack.encode({"type": kind, **fields})


@pytest.mark.parametrize(
    "frame",
    [
        b"", b"\xff\x00garbage" * 1000, b"\x91" * 100_000, "text", "\x00", b"\x93\x01\x02\x03",
        message("NoSuchMessage"),
        msgspec.msgpack.encode({"type": [1]}), msgspec.msgpack.encode({1: 2}),
        message("GuiUpdateMessage"), message("GuiUpdateMessage", uuid="nobody", updates={"value": 1}),
        message("GuiUpdateMessage", uuid=["x"], updates={"value": 1}),
        message("GuiUpdateMessage", uuid="nobody", updates={"value": 1}, more=1),
        message("CommandTriggerMessage", uuid="nobody"), message("GuiFormDirtyMessage", uuid="nobody"),
        message("FileTransferStartUpload", source_component_uuid="x", transfer_uuid="x", filename="x", mime_type="x",
                part_count=-1, size_bytes=1 << 60),
        message("ViewerCameraMessage", wxyz="abc"),
        message("TransformControlsUpdateMessage", name="/place", wxyz=[1, 0, 0, 0], position=[math.nan, 0, 0]),
        message("TransformControlsUpdateMessage", name="nobody", wxyz=[1, 0, 0, 0], position=[0, 0, 0]),
        message("TransformControlsDragStartMessage", name="nobody"),
        message("TransformControlsDragEndMessage", name="nobody"),
        message("SceneNodeDragMessage", phase="update", name="nobody", instance_index=None, start_position=[0, 0, 0],
                start_screen_pos=[0, 0], end_position=[1, 1, 1], end_screen_pos=[1, 1], button="left", modifier=None),
        message("ShareUrlRequest"), message("RunJavascriptMessage", source="1"), message("ResetGuiMessage"),
        message("GetRenderResponseMessage", payload=b"x", render_uuid="x"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("other")
def test_nonsense_harms_nobody(page: str, frame: bytes | str) -> None:
    with PageBrowser(page) as hostile, suppress(ConnectionClosed):
        hostile.page("state")
        hostile.send(frame)
        hostile.send(frame)
        hostile.take(0.1)
    with PageBrowser(page) as hostile, suppress(ConnectionClosed):
        hostile.panels.send(frame)
        hostile.panels.send(frame)
        hostile.take(0.1)


@pytest.mark.usefixtures("other")
@pytest.mark.parametrize(
    "args",
    [
        None, [], "x", {"view": 1}, {"frames": {"a": []}}, {"topic": 1, "texts": 2, "rate": "x"}, {"file": ["x"]},
        {"topic": "/clock", "texts": {"a.b.c": 1}, "rate": 1}, {"namespace": {}}, {"of": "x" * 100_000}, {"robot": []},
        {"topic": "/clock", "twist": 5}, {"trace": {}}, {"topic": "/clock", "shown": True},
        {"robot": "slider", "positions": {"joint1": None}}, {"robot": "slider", "positions": [1]},
        {"robot": "slider", "positions": {"joint1": 1e308}}, {"browser": {}, "pixel_ratio": -1e308},
        {"browser": "x", "pixel_ratio": 10**400}, {"browser": "x", "pixel_ratio": math.nan},
        {"robot": "slider", "positions": {"joint1": 10**400}},
    ],
)  # fmt: skip
def test_requests_of_the_page_that_are_not_valid_are_refused_or_do_nothing(page: str, args: Any) -> None:
    services = (
        "state",
        "view",
        "sensor",
        "ghost",
        "camera",
        "fill",
        "graph",
        "gains_file",
        "record",
        "publish",
        "drive",
        "place",
        "no",
        "",
        "a/b",
    )
    with PageBrowser(page) as hostile:
        for service in services:
            assert "result" in hostile.ask(f"/slidectl_page/{service}", args)
        hostile.page("view", frames=False)
        assert not [text for text in hostile.told if "internal error" in text]


def test_a_camera_without_a_field_of_view_costs_the_others_nothing(page: str, other: PageBrowser) -> None:
    with PageBrowser(page) as odd:
        odd.page("view", frames=True)
        looks = {"wxyz": [1, 0, 0, 0], "position": [3, 3, 3], "fov": 0.0, "near": 0.01, "far": 1000.0}
        more = {"image_height": 600, "image_width": 800, "look_at": [0, 0, 0], "up_direction": [0, 0, 1]}
        odd.send(message("ViewerCameraMessage", **looks, **more))
        other.wait_for(lambda: any(name.startswith("/labels/") for name in other.nodes))
        assert not other.told
        odd.page("view", frames=False)


@pytest.mark.usefixtures("other")
def test_what_is_no_browser_is_turned_away(page: str) -> None:
    address = urlsplit(page)
    for text in (
        b"\x00" * 5000,
        b"GET / HTTP/1.1\r\n",
        b"GET /../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"",
    ):
        with socket.create_connection((address.hostname, address.port)) as one:
            one.sendall(text)
    for protocol in (None, ["viser-v0.0.1"], ["other"]):
        socket_url = page.replace("http", "ws", 1)
        with pytest.raises((ConnectionClosed, InvalidHandshake)), connect(socket_url, subprotocols=protocol) as old:
            old.recv(timeout=60)


LINES = b"GET %s HTTP/1.1\r\nHost: localhost\r\n%s\r\n"
UPGRADE = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"


def status_of(url: str, sent: bytes) -> int:
    """The status of the answer to bytes."""
    with raw_socket(url) as one:
        send_all(one, sent)
        answer = b""
        while b"\r\n" not in answer and (more := one.recv(4096)):
            answer += more
        assert answer.startswith(b"HTTP/1.1 "), f"{sent[:100]!r} is answered with {answer!r}"
        return int(answer.split()[1])


@pytest.mark.usefixtures("other")
@pytest.mark.parametrize(
    "sent",
    [
        b"nonsense\r\n\r\n", b"\0\xff\xfe\r\n\r\n", b"\n\n", b"GET\r\n\r\n", b"GET /\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n", b"GET / HTTP/1.0\r\n\r\n", b"get / HTTP/1.1\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nabc", b"HEAD / HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\n",
        LINES % (b"/", b"no colon\r\n"), LINES % (b"/", b"a b: c\r\n"), LINES % (b"/", b": x\r\n"),
        LINES % (b"/", b"X: a\0b\r\n"), LINES % (b"/", b" folded\r\n"), LINES % (b"/", b"X: y\n"),
        LINES % (b"/", b"X: " + b"y" * 9000 + b"\r\n"), LINES % (b"/", b"X: y\r\n" * 200),
        LINES % (b"/", b"".join(b"X%d: %s\r\n" % (number, b"y" * 8000) for number in range(100))),
        LINES % (b"/" + b"a" * 9000, b""), LINES % (b"/" + b"a" * 5000, b""), LINES % (b"//[", b""),
        LINES % (b"http://[::/", b""), LINES % (b"/", b"Content-Length: many\r\n"),
        LINES % (b"/", b"Transfer-Encoding: chunked\r\n"), LINES % (b"/", b"Host: localhost\r\n"),
        LINES % (b"/", b"Origin: http://[\r\n"), LINES % (b"/", b"Origin: a\r\nOrigin: b\r\n"),
        LINES % (b"/", b"Accept-Encoding: gzip\r\nAccept-Encoding: br\r\n"),
        LINES % (b"/", b"Upgrade: websocket\r\nUpgrade: websocket\r\n"),
        LINES % (b"/", UPGRADE + b"Sec-WebSocket-Key: \xff\r\n"), LINES % (b"/", UPGRADE),
        LINES % (b"/", UPGRADE + b"Sec-WebSocket-Key: AAAA\r\n"),
    ],
)  # fmt: skip
def test_requests_that_are_not_valid_are_answered_with_400(page: str, sent: bytes) -> None:
    assert status_of(page, sent) == 400


@pytest.mark.usefixtures("other")
@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (LINES % (b"/%00", b""), 404), (LINES % (b"/%", b""), 404), (LINES % (b"/%zz%ff%ed%b2%80", b""), 404),
        (LINES % (b"/\xff", b""), 404), (LINES % (b"/..%2f..%2fetc/passwd", b""), 404),
        (LINES % (b"/%2e%2e/%2e%2e/etc/passwd", b""), 404), (LINES % (b"/?%00=%ff&token=%zz", b""), 200),
        (LINES % (b"/", b"Cookie: ;;=;a==\xff;{\"a\": 1}; b=\"\r\n"), 200), (LINES % (b"/", b"X: \xff\r\n"), 200),
        (b"GET / HTTP/1.1\r\n\r\n", 403), (b"GET / HTTP/1.1\r\nHost:\r\n\r\n", 403),
        (b"GET / HTTP/1.1\r\nHost: [\r\n\r\n", 403), (b"GET / HTTP/1.1\r\nHost: \xff\r\n\r\n", 403),
        (b"GET / HTTP/1.1\r\nHost: localhost.\r\n\r\n", 403), (b"GET / HTTP/1.1\r\nHost: a@localhost\r\n\r\n", 200),
        (b"GET / HTTP/1.1\r\nHost: LOCALHOST:1\r\n\r\n", 200), (LINES % (b"/", b"Origin: \xff\r\n"), 403),
    ],
)  # fmt: skip
def test_odd_requests_that_are_valid_are_served_or_refused(page: str, sent: bytes, status: int) -> None:
    assert status_of(page, sent) == status


def opened(url: str, *headers: str) -> tuple[int, str, str]:
    """Status, cookie and body of the page at an address with headers."""
    parts = urlsplit(url)
    with raw_socket(url) as one:
        where = f"{parts.path or '/'}?{parts.query}"
        lines = "".join(f"{line}\r\n" for line in (f"Host: {parts.netloc}", "Connection: close", *headers))
        one.sendall(f"GET {where} HTTP/1.1\r\n{lines}\r\n".encode("latin-1"))
        answer = b""
        while more := one.recv(1 << 16):
            answer += more
    head, _, body = answer.decode("utf-8", "replace").partition("\r\n\r\n")
    cookies = [line.partition(": ")[2] for line in head.splitlines() if line.lower().startswith("set-cookie: ")]
    return int(head.split()[1]), "".join(cookies), body


def test_the_cookie_is_a_secret_of_this_page_at_its_port_and_not_the_token(world: CommandLine) -> None:
    token = "open-sesame"
    with served_page(world, "--token", token) as first, served_page(world, "--token", token) as second:
        address, other = (url.partition("?")[0] for url in (first, second))
        (status, cookie, _), (_, foreign, _) = opened(first), opened(second)
        name, _, value = cookie.partition(";")[0].partition("=")
        assert (status, name) == (302, f"slidectl-{urlsplit(first).port}")
        assert len(value) >= 32
        assert token not in cookie
        assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(cookie.split("; "))
        assert opened(address, f"Cookie: {name}={value}")[0] == 200
        for wrong in (f"{name}={token}", f"{name}={value}x", f"{name}=", f"x{name}={value}", value,
                      f"{name}={foreign.partition(';')[0].partition('=')[2]}"):  # fmt: skip
            assert opened(address, f"Cookie: {wrong}")[0] == 403, wrong
        assert opened(other, f"Cookie: {name}={value}")[0] == 403
        # Cookies of other programs at this host harm nothing, and neither does one of this name from elsewhere.
        beside = f'Cookie: a={{"b": 1}}; \xff; =; {name}=planted; {name}={value}; c="'
        assert opened(address, beside)[0] == 200
        assert opened(address, "Cookie: a=b", f"Cookie: {name}={value}")[0] == 200
        # After a link of another site a browser would not send the cookie where a redirect leads.
        status, cookie, body = opened(first, "Sec-Fetch-Site: cross-site", "Sec-Fetch-Mode: navigate")
        assert (status, 'http-equiv="refresh"' in body, token in body) == (200, True, False)
        assert value in cookie


def page_pid(before: set[int]) -> int:
    (pid,) = children() - before
    return pid


def test_messages_that_are_begun_and_not_ended_hold_a_bounded_sum(world: CommandLine) -> None:
    before = children()
    with served_page(world) as url, PageBrowser(url) as other:
        pid = page_pid(before)
        other.page("state")
        used = memory_mib(pid)
        protocol = f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n"
        with ExitStack() as stack:
            some = [stack.enter_context(shaken(url, protocol)) for _ in range(60)]
            for one in some:
                send_all(one, head(2_000_000) + bytes(1_900_000))
            other.page("state")
            other.take(0.1)
            assert memory_mib(pid) < used + 32 + 60
        with shaken(url, protocol) as one:
            send_all(one, head(3_000_000) + bytes(100))
            assert closed(one)[0] == 1009
        other.wait_for(lambda: memory_mib(pid) < used + 60)


def test_a_thousand_browsers_are_refused_plainly_and_leave_nothing(world: CommandLine) -> None:
    before = children()
    with served_page(world) as url, PageBrowser(url) as other:
        pid = page_pid(before)
        other.page("state")
        had, used = descriptors(pid), memory_mib(pid)
        half = request()[:60]
        with ExitStack() as stack:
            for _ in range(500):
                send_all(stack.enter_context(raw_socket(url)), half)
            answers = []
            for _ in range(500):  # of the protocol's other name: viser would send each the whole page
                one = stack.enter_context(raw_socket(url))
                one.sendall(request(f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n"))
                answers.append(one.recv(200))
            assert sum(b" 101 " in answer for answer in answers) == 99
            assert all(b" 101 " in answer or answer.startswith(b"HTTP/1.1 503") for answer in answers)
            other.page("state")
        other.wait_for(lambda: descriptors(pid) <= had + 1, "descriptors stay open")
        assert memory_mib(pid) < used + 200
        with PageBrowser(url) as late:
            late.page("state")


def test_a_page_that_was_killed_leaves_the_daemon_and_its_port(world: CommandLine, runtime: Runtime) -> None:
    pid = runtime.pid
    with world.client() as client:
        nodes = set(client.call("/rosapi/nodes")["nodes"])
        killed = world.start("view", "--no-open", "--port", "0")
        assert killed.stdout is not None
        url = killed.stdout.readline().strip()
        killed.kill()
        killed.communicate(timeout=60)
        port = str(urlsplit(url).port)
        again = world.start("view", "--no-open", "--port", port)
        assert again.stdout is not None
        assert again.stdout.readline().strip() == url
        with PageBrowser(url) as browser:
            browser.page("state")
        again.send_signal(signal.SIGINT)
        assert (again.communicate(timeout=60)[1], again.returncode) == ("", 0)
        eventually(lambda: set(client.call("/rosapi/nodes")["nodes"]) == nodes, "it left nodes behind")
    assert runtime.pid == pid


@pytest.mark.usefixtures("other")
def test_many_browsers_at_once(page: str) -> None:
    with ExitStack() as stack:
        many = [stack.enter_context(PageBrowser(page)) for _ in range(20)]
        for number, one in enumerate(many):
            one.page("view", frames=number % 2 == 0)
        for one in many:
            assert one.page("state")["view"]["frames"] is False


def test_a_browser_that_does_not_read_costs_no_memory_and_no_time(world: CommandLine, runtime: Runtime) -> None:
    """The log changes by 100 kB at once; it would show if that were kept for who sleeps."""
    before = children()
    sleeps = {"max_queue": 1, "max_size": None}
    with (
        served_page(world) as url,
        PageBrowser(url) as other,
        PageBrowser(url, max_queue=1),
        connect(urljoin(url.replace("http", "ws", 1), "/rosbridge"), **sleeps) as sleeper,
        world.client() as client,
    ):
        (pid,) = children() - before
        assert runtime.pid is not None
        pids = [runtime.pid, pid]
        for one in (other.panels, sleeper):
            one.send(json.dumps({"op": "subscribe", "topic": "/rosout", "type": "rosgraph_msgs/Log"}))
        other.page("state")
        begun: list[int] = []
        for number in range(150):
            for part in range(20):
                client.publish("/rosout", {"level": 2, "msg": f"{number}.{part} {'x' * 480}"}, "rosgraph_msgs/Log")
            client.flush()
            other.wait_for(lambda number=number: f"{number}.19 xxx" in other.newest.get("/rosout", {}).get("msg", ""))
            if number == 30:
                begun = [memory(pid) for pid in pids]
        grown = [memory(pid) - before for pid, before in zip(pids, begun, strict=True)]
        assert max(grown) < 8000, f"kB of the daemon and the page: {grown}"


def children() -> set[int]:
    """The processes that this one has started."""
    found = set()
    for status in Path("/proc").glob("[0-9]*/status"):
        with suppress(OSError):  # it has ended meanwhile
            if f"\nPPid:\t{os.getpid()}\n" in status.read_text("utf-8"):
                found.add(int(status.parent.name))
    return found


def memory(pid: int) -> int:
    """What a process has in memory, kB."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text("utf-8"))
    assert found is not None
    return int(found[1])


@needs_root
def test_another_user_of_the_machine_does_not_get_the_page(page: str, other: PageBrowser) -> None:  # noqa: ARG001
    def status() -> tuple[int, str]:
        try:
            with urlopen(page, timeout=20) as answer:
                return answer.status, ""
        except HTTPError as error:
            return error.code, error.read().decode()

    assert status()[0] == 200
    code, text = as_nobody(status)
    assert (code, "the connection comes from user 65534" in text) == (403, True)
