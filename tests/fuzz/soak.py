"""`make soak`: hours of simulated time with all gateways and a client of each, the page, a recorder and a reader.

python tests/fuzz/soak.py [--hours H] [--factor F]

The slider moves to and fro. Each client follows `joint_states` and counts what it missed: two messages are 0.02 s
apart. At the end it prints these counts, and the memory of each process after a tenth of the time and at the end. It
fails when a message was lost, a process ended, a log has a traceback, or the memory of a process grew by a fifth and
8 MiB.
"""

from __future__ import annotations

import argparse
import multiprocessing
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple
from xmlrpc.client import ServerProxy

sys.path.insert(0, str(Path(__file__).parent.parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent / "gateways"))
sys.path.insert(0, str(Path(__file__).parent.parent / "gateways" / "ros1"))
sys.path.insert(0, str(Path(__file__).parent.parent / "cli"))

from command_line import CommandLine
from daemon_fixture import Runtime, running_daemon
from foxglove_app import FoxgloveApp
from page_browser import PageBrowser
from rosbridge_client import RosbridgeClient
from running_gateway import running_gateway
from tcpros_wire import TcprosWire

from slidectl.client import Client
from slidectl.extensions.gateways import process
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.extensions.recording import recording_files

KINDS = ("ros1", "websocket", "foxglove")
TOPIC = "/slider/joint_states"
STEP_NS = 20_000_000
MARKS = ("Traceback (most recent call last)", "a bug in slidectl", "internal error")
GROWTH, MOST_BYTES = 1.2, 8 << 20


class Count(NamedTuple):
    """What a client has received."""

    messages: int
    missed: int
    backwards: int


def count_of(stamps: Iterator[int], end_ns: int) -> Count:
    """Follow the times of messages, in ns, up to `end_ns`."""
    messages = missed = backwards = before = 0
    for stamp in stamps:
        messages += 1
        if before:
            missed += max(0, round((stamp - before) / STEP_NS) - 1)
            backwards += stamp <= before
        before = stamp
        if stamp >= end_ns:
            break
    return Count(messages, missed, backwards)


def _ns(stamp: dict[str, int]) -> int:
    return stamp["secs"] * 1_000_000_000 + stamp["nsecs"]


def daemon_reader(runtime: Runtime, _: str) -> Iterator[int]:
    """A client of the daemon itself."""
    with runtime.client() as client, client.subscribe(TOPIC, queue_length=100_000) as states:
        while True:
            yield _ns(states.get(60)["header"]["stamp"])


def websocket_reader(_: Runtime, address: str) -> Iterator[int]:
    """A browser of rosbridge."""
    with RosbridgeClient(address) as browser:
        browser.send(op="subscribe", topic=TOPIC, queue_length=100_000)
        while True:
            yield _ns(browser.op("publish")["msg"]["header"]["stamp"])


def foxglove_reader(_: Runtime, address: str) -> Iterator[int]:
    """An app of Foxglove."""
    with FoxgloveApp(address) as app:
        app.wait("advertise")
        subscription = app.subscribe(TOPIC)
        while True:
            yield _ns(app.message(TOPIC, subscription)["header"]["stamp"])
            app._kept.clear()  # times, which nobody waits for


def ros_reader(_: Runtime, address: str) -> Iterator[int]:
    """A subscriber over TCPROS."""
    with ServerProxy(address) as master:
        _, _, (publisher, *_) = master.registerSubscriber("/soak", TOPIC, "*", "http://127.0.0.1:1")  # type: ignore[misc]
    with ServerProxy(str(publisher)) as node:
        _, _, (_, host, port) = node.requestTopic("/soak", TOPIC, [["TCPROS"]])  # type: ignore[misc]
    kind = ros1_type("sensor_msgs/JointState")
    with TcprosWire((str(host), int(str(port)))) as wire:
        wire.begin(callerid="/soak", topic=TOPIC, type="*", md5sum="*")
        while True:
            yield _ns(kind.unpack(wire.message())["header"]["stamp"])


READERS: dict[str, Callable[[Runtime, str], Iterator[int]]] = {
    "reader": daemon_reader,
    "websocket": websocket_reader,
    "foxglove": foxglove_reader,
    "ros1": ros_reader,
}


def _follow(name: str, runtime: Runtime, address: str, end_ns: int, answer: Connection) -> None:
    answer.send(count_of(READERS[name](runtime, address), end_ns))


def memory(pid: int) -> int:
    """Resident memory of a process, bytes."""
    pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * 4096


def soak(hours: float, factor: float) -> list[str]:
    """Run it. Returns what is wrong."""
    end_ns = int(3600e9 * hours)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="slidectl-soak-")))
        runtime = stack.enter_context(running_daemon(rtf=factor))
        client = stack.enter_context(runtime.client())
        controllers = ["joint_state_controller", "joint1_position_controller"]
        client.spawn("slider", controllers="config/slider_control.yaml", start=controllers)
        client.spawn("rrbot", controllers="config/rrbot_control.yaml", start=controllers[:1])
        addresses = {kind: stack.enter_context(running_gateway(runtime, kind)) for kind in KINDS}
        with runtime.environment():
            gateways = {kind: process.find(runtime.paths, kind) for kind in KINDS}
        command = CommandLine(runtime.folder)
        page, recorder = (
            stack.enter_context(_ended(command.start(*words)))
            for words in (("view", "--no-open", "--port", "0"), ("record", "-O", str(folder / "run.bag"), TOPIC))
        )
        assert page.stdout is not None
        browser = PageBrowser(page.stdout.readline().strip())
        readers = {name: _begin(name, runtime, addresses.get(name, ""), end_ns) for name in READERS}
        pids = {"daemon": runtime.pid or 0, "page": page.pid, "recorder": recorder.pid}
        pids |= {kind: one.pid for kind, one in gateways.items() if one is not None}
        early, worst_s = _run(client, browser, end_ns, pids)
        late = {name: memory(pid) for name, pid in pids.items()}
        counts = {name: here.recv() if here.poll(60) else None for name, here in readers.items()}
        recorder.send_signal(signal.SIGINT)
        recorder.communicate(timeout=60)
        with recording_files.opened(folder / "run.bag") as run:
            counts["recorder"] = count_of((_ns(run.message(one)["header"]["stamp"]) for one in run.records()), end_ns)
        with runtime.environment():
            logs = [runtime.log, *(process.log_file(runtime.paths, kind).read_text("utf-8") for kind in KINDS)]
    wrong = [f"a log has {mark!r}" for mark in MARKS if any(mark in log for log in logs)]
    for name, count in counts.items():
        print(f"{name:<10} {count}")
        if count is None or count.missed or count.backwards:
            wrong.append(f"{name} missed messages, or did not reach the end")
    for name, before in early.items():
        print(f"{name:<10} {before / 2**20:.1f} MiB after a tenth of the time, {late[name] / 2**20:.1f} MiB at the end")
        if late[name] > GROWTH * before + MOST_BYTES:
            wrong.append(f"{name} grew by {(late[name] - before) / 2**20:.1f} MiB")
    print(f"the slowest answer of the daemon took {worst_s:.3f} s")
    return wrong


def _run(client: Client, browser: PageBrowser, end_ns: int, pids: dict[str, int]) -> tuple[dict[str, int], float]:
    """Move the slider to and fro until the end. Returns the memory after a tenth, and the slowest answer in s."""
    early: dict[str, int] = {}
    now_s = worst_s = 0.0
    while now_s * 1e9 < end_ns + STEP_NS:
        began = time.monotonic()
        now_s = client.call("/slidectl/status")["time"]
        worst_s = max(worst_s, time.monotonic() - began)
        client.publish("/slider/joint1_position_controller/command", {"data": 1.0 + 0.5 * ((now_s // 5) % 2)})
        browser.take(0.2)
        if not early and now_s * 1e10 > end_ns:
            early = {name: memory(pid) for name, pid in pids.items()}
    return early, worst_s


def _begin(name: str, runtime: Runtime, address: str, end_ns: int) -> Connection:
    """Start a reader in a process of its own. Its count comes by the connection."""
    here, there = multiprocessing.Pipe()
    one = multiprocessing.Process(target=_follow, args=(name, runtime, address, end_ns, there), daemon=True)
    one.start()
    return here


@contextmanager
def _ended(started: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    """A process of a command, which is interrupted at the end."""
    try:
        yield started
    finally:
        started.send_signal(signal.SIGINT)
        started.communicate(timeout=60)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=5.0, help="of simulated time (5)")
    parser.add_argument("--factor", type=float, default=20.0, help="real-time factor (20)")
    given = parser.parse_args()
    found = soak(given.hours, given.factor)
    print("\n".join(found) or "nothing was lost")
    sys.exit(bool(found))
