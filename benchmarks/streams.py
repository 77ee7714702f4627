"""joint_states at 1 kHz to many subscribers at real time: what is lost, what it costs, and what a stopped reader does.

The readers are connections of this process, which counts lines and looks at the numbers in their headers.
"""

from __future__ import annotations

import json
import re
import selectors
import socket
import time
from contextlib import ExitStack
from pathlib import Path

from benchmarks.harness import RRBOT_CONTROLLERS, Daemon, Row, daemon, process_cpu_s

SECONDS = 5.0
SUBSCRIBERS = (1, 10, 50)
TOPIC = "/rrbot/joint_states"
STOPPED, READING = 50, 150
STOPPED_ON = (
    TOPIC,
    "/clock",
    "/tf",
    "/gazebo/link_states",
    "/gazebo/model_states",
    "/rrbot/joint1_position_controller/state",
    "/rrbot/joint2_position_controller/state",
)
_SEQ = re.compile(rb'"seq":(\d+)')


class Reader:
    """A raw connection that subscribes and keeps up: the first and the last number, and how many came."""

    def __init__(self, instance: Daemon) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(Path(instance.folder) / "slidectl" / "bench" / "socket"))
        _subscribe(self.socket, TOPIC)
        self.count = 0
        self.dropped = False
        self.first = self.last = -1
        self._rest = b""

    def read(self) -> None:
        data = self._rest + self.socket.recv(1 << 20)
        lines, _, self._rest = data.rpartition(b"\n")
        if not lines:
            return
        self.dropped = self.dropped or b'"dropped"' in lines
        self.count += lines.count(b"\n") + 1
        if self.first < 0:
            self.first = int(_SEQ.search(lines).group(1))  # type: ignore[union-attr]
        self.last = int(_SEQ.search(lines, lines.rfind(b"\n") + 1).group(1))  # type: ignore[union-attr]

    @property
    def lost(self) -> int:
        return self.last - self.first + 1 - self.count


def measure() -> list[Row]:
    """So many readers, then ten beside one that does not read, then many beside many that do not."""
    rows = []
    with daemon("--rtf", "1.0") as instance:
        instance.spawn("rrbot", ())
        instance.run("param", "set", "/rrbot/joint_state_controller/publish_rate", "1000")
        instance.run("controller", "spawn", *RRBOT_CONTROLLERS)
        for number in SUBSCRIBERS:
            rows += _stream(instance, number, f"{number} at 1 kHz")
        with socket.socket(socket.AF_UNIX) as idle:
            idle.connect(str(Path(instance.folder) / "slidectl" / "bench" / "socket"))
            _subscribe(idle, TOPIC)
            rows += _stream(instance, 10, "10 beside one that stopped")
        with ExitStack() as stack:
            for _ in range(STOPPED):
                idle = stack.enter_context(socket.socket(socket.AF_UNIX))
                idle.connect(str(Path(instance.folder) / "slidectl" / "bench" / "socket"))
                for topic in STOPPED_ON:
                    _subscribe(idle, topic)
            title = f"{READING} at 1 kHz beside {STOPPED} that stopped, on {len(STOPPED_ON)} topics each"
            rows += _stream(instance, READING, title)
    return rows


def _subscribe(connection: socket.socket, topic: str) -> None:
    connection.sendall(json.dumps({"op": "subscribe", "topic": topic}).encode() + b"\n")


def _stream(instance: Daemon, number: int, title: str) -> list[Row]:
    pid = int(instance.status()["pid"])
    readers = [Reader(instance) for _ in range(number)]
    cpu, began = process_cpu_s(pid), time.perf_counter()
    _read(readers, SECONDS)
    wall = time.perf_counter() - began
    share = (process_cpu_s(pid) - cpu) / wall
    status = instance.status()
    received = sum(reader.count for reader in readers) / wall
    lost = sum(reader.lost for reader in readers)
    for reader in readers:
        reader.socket.close()
    return [
        Row(f"subscribers of joint_states, {title}: lost", lost, "", 0, note=f"{received:.0f} messages/s in all"),
        Row(f"subscribers of joint_states, {title}: processor use", 100 * share, "%", 100),
        Row(
            f"subscribers of joint_states, {title}: real-time factor",
            round(status["speed_reached"], 3),
            "",
            0.99,
            better="higher",
            note=f"lateness p99 {1e3 * status['lateness_p99']:.2f} ms",
        ),
    ]


def _read(readers: list[Reader], seconds: float) -> None:
    with selectors.DefaultSelector() as selector:
        for reader in readers:
            selector.register(reader.socket, selectors.EVENT_READ, reader)
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            for key, _ in selector.select(0.1):
                key.data.read()
