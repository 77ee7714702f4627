"""A world that fills up: the hundredth RRBot beside ninety-nine that run, and the longest halt that they see meanwhile.

A halt is a gap between two messages of /clock, which is published in every cycle.
"""

from __future__ import annotations

import json
import socket
import statistics
import threading
import time
from pathlib import Path
from typing import Any

from benchmarks.harness import RRBOT_CONTROLLERS, Daemon, Row, daemon, timed
from slidectl import Client
from slidectl.description import load
from slidectl.description.controllers_file import read
from slidectl.paths import share

ROBOTS = 105
MEASURED = 9
SETTLE_S = 0.05
MANAGER = "controller_manager"


def measure() -> list[Row]:
    """At real time; each robot runs its three controllers as soon as it is there."""
    xml = load("rrbot").xml
    parameters = read(share("config") / "rrbot_control.yaml")["rrbot"]
    taken, halts, quiet_halts = [], [], []
    with daemon("--rtf", "1.0") as instance, instance.client() as client, Halts(instance) as clock:
        for number in range(ROBOTS):
            clock.begin()
            time.sleep(SETTLE_S)
            quiet, _ = clock.longest_s, clock.begin()
            seconds = timed(lambda number=number: spawn(client, xml, parameters, number))
            time.sleep(SETTLE_S)
            if number >= ROBOTS - MEASURED:
                taken.append(seconds)
                halts.append(clock.longest_s)
                quiet_halts.append(quiet)
        status = client.call("/slidectl/status")
    note = f"{1e3 * statistics.median(quiet_halts):.1f} ms just before, without a spawn"
    return [
        Row("spawn of the 100th RRBot, running", 1e3 * statistics.median(taken), "ms", 50, note="five service calls"),
        Row("longest halt of the others meanwhile", 1e3 * statistics.median(halts), "ms", 20, note=note),
        Row(f"memory of the daemon with {ROBOTS} RRBots", status["memory"] / 2**20, "MiB"),
    ]


def spawn(client: Client, xml: str, parameters: dict[str, Any], number: int) -> None:
    """One more RRBot two metres beside the last, with its controllers running."""
    name = f"rrbot{number}"
    client.call("/rosapi/set_param", {"name": f"/{name}", "value": json.dumps(parameters)})
    pose = {"position": {"x": 2.0 * number}, "orientation": {"w": 1.0}}
    request = {"model_name": name, "model_xml": xml, "robot_namespace": name, "initial_pose": pose}
    answer = client.call("/gazebo/spawn_urdf_model", request)
    if not answer["success"]:
        raise RuntimeError(answer["status_message"])
    for controller in RRBOT_CONTROLLERS:
        client.call(f"/{name}/{MANAGER}/load_controller", {"name": controller})
    switch = {"start_controllers": list(RRBOT_CONTROLLERS), "strictness": 2}
    client.call(f"/{name}/{MANAGER}/switch_controller", switch)


class Halts:
    """Reads /clock in a thread of its own and keeps the longest gap between two arrivals since `begin`."""

    def __init__(self, instance: Daemon) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(Path(instance.folder) / "slidectl" / "bench" / "socket"))
        self._socket.sendall(b'{"op":"subscribe","topic":"/clock"}\n')
        self._thread = threading.Thread(target=self._read)
        self.longest_s = 0.0

    def begin(self) -> None:
        """Forget the gaps so far."""
        self.longest_s = 0.0

    def _read(self) -> None:
        last = time.perf_counter()
        while self._socket.recv(1 << 20):
            now = time.perf_counter()
            self.longest_s = max(self.longest_s, now - last)
            last = now

    def __enter__(self) -> Halts:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()
