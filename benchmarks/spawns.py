"""A world that fills up: the hundredth RRBot beside ninety-nine that run, and the longest halt that they see meanwhile;
and a robot of a thousand links that come and go.

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
LINKS = 1000


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
        *_many_links(),
    ]


def _many_links(runs: int = 5) -> list[Row]:
    """A robot of many links with collision shapes, in a world that stands still, beside an RRBot."""
    spawned, deleted = [], []
    with daemon("--paused") as instance, instance.client() as client:
        _call(client, "/gazebo/spawn_urdf_model", {"model_name": "rrbot", "model_xml": load("rrbot").xml})
        for _ in range(runs):
            request = {"model_name": "bush", "model_xml": bush(LINKS)}
            spawned.append(timed(lambda request=request: _call(client, "/gazebo/spawn_urdf_model", request)))
            deleted.append(timed(lambda: _call(client, "/gazebo/delete_model", {"model_name": "bush"})))
    return [
        Row(f"spawn of a robot of {LINKS} colliding links", statistics.median(spawned), "s", 1.0),
        Row("its deletion", statistics.median(deleted), "s", 0.1),
    ]


def bush(links: int) -> str:
    """The URDF of so many cubes, in chains of ten that hang side by side from the world."""
    parts = ['<robot name="bush">', '<link name="world"/>']
    for i in range(links):
        parent, place = (f"l{i - 1}", "0 0 -0.3") if i % 10 else ("world", f"{0.3 * (i // 10)} 5 4")
        parts.append(
            f'<link name="l{i}"><inertial><mass value="1"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
            '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
            f'<joint name="j{i}" type="continuous"><parent link="{parent}"/><child link="l{i}"/>'
            f'<origin xyz="{place}"/><axis xyz="1 0 0"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def _call(client: Client, service: str, request: dict[str, Any]) -> None:
    answer = client.call(service, request)
    if not answer["success"]:
        raise RuntimeError(answer["status_message"])


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
