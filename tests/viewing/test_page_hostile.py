"""The page beside browsers that do not read, that are many, and that send what no browser sends."""

from __future__ import annotations

import math
import os
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import msgspec.msgpack
import pytest
from daemon_fixture import Runtime, running_daemon
from other_user import as_nobody, needs_root
from page_browser import CommandLine, PageBrowser, served_page
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect

WELL = "cycles of a step"


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
        one.element("Step", "Button")
        yield one
        cycles = client.call("/slidectl/status")["cycles"]
        one.set(WELL, 3)
        one.click("Step")
        one.wait_for(lambda: client.call("/slidectl/status")["cycles"] == cycles + 3)


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
        hostile.element("Step", "Button")
        hostile.send(frame)
        hostile.send(frame)
        hostile.take(0.1)


def test_values_that_an_input_cannot_have_are_not_taken(world: CommandLine, page: str, other: PageBrowser) -> None:
    with PageBrowser(page) as hostile, world.client() as client:
        hostile.element("Step", "Button")
        status = client.call("/slidectl/status")
        wrong: list[tuple[str, Any]] = [
            *((WELL, value) for value in ("abc", math.nan, math.inf, [1], None, {}, -1, 1.5, True, 10**7, 1 << 63)),
            *(("speed", value) for value in ("abc", 1, None, ["1"])),
            *(("snapshot", value) for value in (1, None, ["x"], "x" * 10**6)),
            *(("dark", value) for value in ("yes", 1, None)), ("reset", "everything"), ("Step", "now"),
            ("Stop recording", True),
        ]  # fmt: skip
        for label, value in wrong:
            uuid, _ = hostile.wait_for(lambda label=label: hostile.find(label))
            hostile.send(message("GuiUpdateMessage", uuid=uuid, updates={"value": value}))
            hostile.send(message("GuiUpdateMessage", uuid=uuid, updates={"update_cb": [], "removed": True}))
        before = {label: other.element(label)["value"] for label, _ in wrong}
        hostile.set("snapshot", 7)
        hostile.wait_for(lambda: hostile.element("snapshot")["value"] == before["snapshot"])
        hostile.set(WELL, 5)
        other.wait_for(lambda: other.element(WELL)["value"] == 5)
        assert {label: other.element(label)["value"] for label, _ in wrong} == {**before, WELL: 5}
        after = client.call("/slidectl/status")
        assert (after["cycles"], after["speed"]) == (status["cycles"], status["speed"])


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


@pytest.mark.usefixtures("other")
def test_fifty_browsers_at_once(page: str) -> None:
    with ExitStack() as stack:
        many = [stack.enter_context(PageBrowser(page)) for _ in range(50)]
        for number, one in enumerate(many):
            one.element("Step", "Button")
            if number % 10 == 0:
                one.set(WELL, 100 + number)
        for one in many:
            one.wait_for(lambda one=one: one.element(WELL)["value"] == 140)


def test_a_browser_that_does_not_read_costs_no_memory_and_no_time(world: CommandLine, runtime: Runtime) -> None:
    """The log changes by 100 kB at once; it would show if that were kept for who sleeps."""
    before = children()
    with served_page(world) as url, PageBrowser(url) as other, PageBrowser(url, max_queue=1), world.client() as client:
        (pid,) = children() - before
        assert runtime.pid is not None
        pids = [runtime.pid, pid]
        other.element("Clear the log", "Button")
        begun: list[int] = []
        for number in range(150):
            for part in range(20):
                client.publish("/rosout", {"level": 2, "msg": f"{number}.{part} {'x' * 480}"}, "rosgraph_msgs/Log")
            client.flush()
            other.wait_for(lambda number=number: other.find(f"{number}.19 xxx", "Html"))
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
    assert (code, "the connection comes from the user 65534" in text) == (403, True)
