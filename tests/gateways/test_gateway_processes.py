"""The life of a gateway's process: started, found, stopped, and what becomes of it when the daemon ends."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import click
import pytest
from daemon_fixture import Runtime
from waiting import eventually

from slidectl.extensions.gateways import Gateway, GatewayOptions, gateway_kinds
from slidectl.extensions.gateways.commands.gateway_commands import gateway

sys.path.append(str(Path(__file__).parent.parent / "cli"))
from command_line import CommandLine


@pytest.fixture
def slidectl() -> Iterator[CommandLine]:
    """A command line in a folder of its own, without a daemon."""
    runtime = Runtime()
    try:
        yield CommandLine(runtime.folder)
    finally:
        runtime.remove()


def gateways(slidectl: CommandLine) -> dict[str, dict[str, Any]]:
    told = map(json.loads, slidectl.ok("gateway", "status", "--json").splitlines())
    return {one["kind"]: one for one in told}


def _has_ended(status: Path) -> bool:
    """`status` is the file of a process in /proc."""
    try:
        return "zombie" in status.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True


class Telegraph(Gateway):
    """Let telegraphs in."""

    @dataclass(frozen=True)
    class Options(GatewayOptions):
        speed: int = field(default=20, metadata={"help": "Words a minute."})


def test_a_line_in_the_table_of_kinds_makes_a_gateway_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gateway_kinds.OURS, "telegraph", f"{__name__}:Telegraph")
    context = click.Context(gateway)
    assert "telegraph" in gateway.list_commands(context)
    command = gateway.get_command(context, "telegraph")
    assert command is not None
    text = command.get_help(click.Context(command))
    assert "Let telegraphs in." in text
    assert "--speed N" in text
    assert "--any-user" in text
    assert gateway_kinds.load("telegraph").kind == "telegraph"


def test_gateways_are_started_with_the_daemon_and_end_with_it(slidectl: CommandLine) -> None:
    started = slidectl.ok("daemon", "start", "--ros1", "0", "--websocket", "0", "--foxglove=0").splitlines()
    assert [line.split(":")[0] for line in started] == [
        "daemon default", "ros1 gateway", "websocket gateway", "foxglove gateway"
    ]  # fmt: skip
    running = gateways(slidectl)
    assert list(running) == ["ros1", "websocket", "foxglove"]
    for kind, one in running.items():
        assert started[list(running).index(kind) + 1] == (
            f"{kind} gateway: started, process {one['pid']}, {one['address']}"
        )
        assert one["connections"] == 0
    again = json.loads(slidectl.ok("gateway", "websocket", "start", "--json"))
    assert (again["already"], again["pid"]) == (True, running["websocket"]["pid"])
    other = slidectl("gateway", "websocket", "start", "--port", "0", "--read-only")
    assert (other.returncode, other.stderr) == (0, "warning: it runs already, so --port, --read-only had no effect\n")
    second = slidectl("gateway", "websocket", "run", "--port", "0")
    assert second.returncode == 1
    assert f"runs already: process {running['websocket']['pid']}" in second.stderr
    assert "gateway websocket stop" in second.stderr
    assert "stopped, it was process" in slidectl.ok("gateway", "foxglove", "stop")
    assert slidectl("gateway", "foxglove", "status").returncode == 1
    slidectl.ok("daemon", "stop")
    assert gateways(slidectl) == {}
    for one in running.values():
        eventually(lambda status=Path(f"/proc/{one['pid']}/status"): _has_ended(status))


def test_a_gateway_outlives_its_daemon_and_works_with_the_next(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start", "--paused")
    before = json.loads(slidectl.ok("gateway", "ros1", "start", "--port", "0", "--json"))
    with slidectl.client() as client:
        os.kill(client.daemon_pid, signal.SIGKILL)
    eventually(lambda: "waits for the daemon" in slidectl.ok("gateway", "ros1", "status"))
    assert f"stays: process {before['pid']}" in slidectl("daemon", "clean", "--dry-run").stderr
    slidectl.ok("daemon", "start", "--paused")
    eventually(lambda: "connections" in gateways(slidectl)["ros1"])
    slidectl.ok("daemon", "restart", "--paused")
    eventually(lambda: "connections" in gateways(slidectl).get("ros1", {}), "it did not come back")
    assert gateways(slidectl)["ros1"]["pid"] == before["pid"]
    assert gateways(slidectl)["ros1"]["address"] == before["address"]
    slidectl.ok("daemon", "stop")
    assert gateways(slidectl) == {}


def test_what_keeps_a_gateway_from_starting_is_said(slidectl: CommandLine) -> None:
    without = slidectl("gateway", "websocket", "start", "--port", "0")
    assert without.returncode == 3
    assert "no daemon answers" in without.stderr
    slidectl.ok("daemon", "start", "--paused")
    with socket.create_server(("localhost", 0)) as taken:
        port = str(taken.getsockname()[1])
        for kind in ("ros1", "websocket", "foxglove"):
            refused = slidectl("gateway", kind, "start", "--port", port)
            assert refused.returncode == 1
            assert port in refused.stderr
            assert "Traceback" not in refused.stderr
    nowhere = slidectl("gateway", "websocket", "start", "--port", "0", "--host", "no-such-host.invalid")
    assert nowhere.returncode in (1, 2)
    assert "no-such-host.invalid" in nowhere.stderr
    assert gateways(slidectl) == {}
    assert slidectl("gateway", "rosbridge", "start").returncode == 2


def test_a_gateway_in_the_foreground_ends_with_ctrl_c(slidectl: CommandLine) -> None:
    slidectl.ok("daemon", "start", "--paused")
    for number in (signal.SIGINT, signal.SIGTERM):
        running = slidectl.start("gateway", "websocket", "--port", "0")
        assert running.stdout is not None
        assert running.stdout.readline().startswith("ws://localhost:")
        running.send_signal(number)
        assert running.wait(60) == 0
        assert running.communicate()[1] == ""


@pytest.mark.parametrize("kind", ["ros1", "websocket", "foxglove"])
def test_a_gateway_that_was_killed_leaves_the_daemon_and_no_lock(slidectl: CommandLine, kind: str) -> None:
    slidectl.ok("daemon", "start", "--paused")
    with slidectl.client() as client:
        before = client.call("/slidectl/status")
        nodes = set(client.call("/rosapi/nodes")["nodes"])
        for _ in range(3):
            begun = json.loads(slidectl.ok("gateway", kind, "start", "--port", "0", "--json"))
            assert not begun["already"]
            os.kill(begun["pid"], signal.SIGKILL)
            eventually(lambda: gateways(slidectl) == {}, "it is still listed")
            assert slidectl("gateway", kind, "status").returncode == 1
        eventually(lambda: set(client.call("/rosapi/nodes")["nodes"]) == nodes, "it left nodes behind")
        assert client.call("/slidectl/status")["pid"] == before["pid"]
    port = str(urlsplit(begun["address"]).port)
    again = json.loads(slidectl.ok("gateway", kind, "start", "--port", port, "--json"))
    assert again["address"] == begun["address"]
    assert gateways(slidectl)[kind]["connections"] == 0
    slidectl.ok("daemon", "stop")
