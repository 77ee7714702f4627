"""A world that fills up: the hundredth RRBot beside ninety-nine that run, and the longest halt that they see meanwhile;
the longest halt of a running RRBot while robots with meshes come; and a robot of a thousand links that comes and goes.

A halt is a gap between two messages of /clock, which is published in every cycle.
"""

from __future__ import annotations

import json
import socket
import statistics
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import RRBOT_CONTROLLERS, Daemon, Row, daemon, timed
from slidectl import Client
from slidectl.description import load
from slidectl.description.controllers_file import read
from slidectl.paths import share

ROBOTS = 105
MEASURED = 9
SETTLE_S = 0.05
MESH_SETTLE_S = 0.5
"""As long as a spawn with meshes takes, or so: longer times see longer halts of a busy machine."""
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
        *_measure_meshes(xml, parameters),
        Row("spawn of the 100th RRBot, running", 1e3 * statistics.median(taken), "ms", 50, note="five service calls"),
        Row("longest halt of the others meanwhile", 1e3 * statistics.median(halts), "ms", 20, note=note),
        Row(f"memory of the daemon with {ROBOTS} RRBots", status["memory"] / 2**20, "MiB"),
        *_many_links(),
    ]


def _many_links(runs: int = 5) -> list[Row]:
    """A robot of many links with collision shapes, in a world that stands still, beside an RRBot."""
    spawned, deleted = [], []
    with daemon("--paused") as instance, instance.client() as client:
        _accepted(client, "/gazebo/spawn_urdf_model", {"model_name": "rrbot", "model_xml": load("rrbot").xml})
        for _ in range(runs):
            request = {"model_name": "bush", "model_xml": bush(LINKS)}
            spawned.append(timed(lambda request=request: _accepted(client, "/gazebo/spawn_urdf_model", request)))
            deleted.append(timed(lambda: _accepted(client, "/gazebo/delete_model", {"model_name": "bush"})))
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


def _measure_meshes(xml: str, parameters: dict[str, Any]) -> list[Row]:
    """Each mesh is new to the daemon whenever it comes: its size is another."""
    rows = []
    with (
        tempfile.TemporaryDirectory() as folder,
        daemon("--rtf", "1.0") as instance,
        instance.client() as client,
        Halts(instance) as clock,
    ):
        spawn(client, xml, parameters, 0)
        for title, path in _mesh_files(Path(folder)).items():
            halts, quiet_halts, taken = [], [], []
            for number in range(MEASURED):
                clock.begin()
                time.sleep(MESH_SETTLE_S)
                quiet_halts.append(clock.longest_s)
                clock.begin()
                request = {"model_name": "mesh", "model_xml": _robot_of(path, 1.0 + 0.01 * number)}
                taken.append(timed(lambda request=request: _accepted(client, "/gazebo/spawn_urdf_model", request)))
                time.sleep(SETTLE_S)
                halts.append(clock.longest_s)
                _accepted(client, "/gazebo/delete_model", {"model_name": "mesh"})
            quiet = f"{1e3 * statistics.median(quiet_halts):.1f} ms just before"
            note = f"{quiet}; the spawn takes {1e3 * statistics.median(taken):.0f} ms"
            halt_ms = 1e3 * statistics.median(halts)
            rows.append(Row(f"longest halt while {title} is spawned", halt_ms, "ms", 20, note=note))
    return rows


def _accepted(client: Client, service: str, request: dict[str, Any]) -> None:
    answer = client.call(service, request)
    if not answer["success"]:
        raise RuntimeError(answer["status_message"])


def _mesh_files(folder: Path) -> dict[str, Path]:
    """A mesh of each kind by what to call it: a binary STL of 20 000 triangles, a text STL and a DAE of 2 000."""
    vertices, faces = _lumpy_ball(101, 100)
    facets = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    facets["corners"] = vertices[faces]
    header = bytes(80) + len(faces).to_bytes(4, "little")
    (folder / "binary.stl").write_bytes(header + facets.tobytes())
    vertices, faces = _lumpy_ball(51, 20)
    corners = [" ".join(map(repr, corner)) for corner in vertices[faces].reshape(-1, 3).tolist()]
    loops = (f"facet\nouter loop\n{loop}\nendloop\nendfacet" for loop in _threes([f"vertex {c}" for c in corners]))
    (folder / "text.stl").write_text("solid\n" + "\n".join(loops) + "\nendsolid\n", "ascii")
    points, indices = (" ".join(map(str, array.ravel().tolist())) for array in (vertices, faces))
    (folder / "scene.dae").write_text(_DAE.format(points=points, indices=indices), "ascii")
    titles = {"an STL of 20 000 triangles": "binary.stl", "a text STL": "text.stl", "a DAE": "scene.dae"}
    return {title: folder / name for title, name in titles.items()}


def _threes(lines: list[str]) -> list[str]:
    return ["\n".join(lines[k : k + 3]) for k in range(0, len(lines), 3)]


def _lumpy_ball(rows: int, columns: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """2 x (rows - 1) x columns triangles around a ball that is not quite round."""
    along, around = np.meshgrid(np.linspace(0.05, np.pi - 0.05, rows), np.arange(columns) * 2 * np.pi / columns)
    radius = 0.1 + 0.02 * np.random.default_rng(1).random(along.shape)
    places = [np.sin(along) * np.cos(around), np.sin(along) * np.sin(around), np.cos(along)]
    vertices = np.stack([radius * place for place in places], axis=-1).reshape(-1, 3)
    first = (np.arange(columns)[:, None] * rows + np.arange(rows - 1)).ravel()
    beside = (first + rows) % (rows * columns)
    triangles = [np.stack([first, first + 1, beside], axis=1), np.stack([first + 1, beside + 1, beside], axis=1)]
    return vertices, np.concatenate(triangles)


def _robot_of(path: Path, scale: float) -> str:
    """One free link, far from the others."""
    return f"""<robot name="mesh"><link name="base">
<inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
<collision><origin xyz="0 -5 1"/><geometry><mesh filename="{path.as_uri()}" scale="{scale} 1 1"/></geometry></collision>
</link></robot>"""


_DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a">{points}</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles><input semantic="VERTEX" source="#v" offset="0"/><p>{indices}</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


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
