"""Meshes are read beside the world: it goes on meanwhile, and nothing that a file holds can hold it up or end it."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from daemon_fixture import Runtime
from rosbridge_wire import Wire

from slidectl.daemon import mesh_reader
from slidectl.daemon.mesh_reader import LIMITS, MeshReader
from slidectl.description.meshes import BadMesh
from slidectl.errors import SlidectlError
from slidectl.event_loop import EventLoop
from slidectl.operating_system import LINUX
from slidectl.physics import hulls
from slidectl.physics.hulls import Hull, MeshSource
from slidectl.simulation.pending import Pending

SPAWN = "/gazebo/spawn_urdf_model"
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SCALES = ("1 1 1",)


def robot(path: Path, scales: tuple[str, ...] = SCALES) -> str:
    """One link that collides as a mesh, once for each scale."""
    geometry = '<collision><geometry><mesh filename="file://{}" scale="{}"/></geometry></collision>'
    shapes = "".join(geometry.format(path, scale) for scale in scales)
    return f'<robot name="m"><link name="base">{INERTIAL}{shapes}</link></robot>'


def nodes(levels: int, twice: int = 2) -> str:
    """A DAE in which each node instances the next so many times: a few kB ask for `twice ** levels` triangles."""
    below = "".join(
        f'<node id="n{level}">' + f'<instance_node url="#n{level + 1}"/>' * twice + "</node>" for level in range(levels)
    )
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1
</float_array><technique_common><accessor source="#a" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries>
<library_nodes>{below}<node id="n{levels}"><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="s"><node><instance_node url="#n0"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.fixture
def tetrahedron(tmp_path: Path) -> Path:
    path = tmp_path / "tetrahedron.obj"
    path.write_text(TETRAHEDRON, "utf-8")
    return path


@pytest.fixture
def slow(tmp_path: Path) -> str:
    """A robot whose meshes take longer to read than any test waits."""
    path = tmp_path / "slow.dae"
    path.write_text(nodes(60), "utf-8")
    return robot(path, tuple(f"1 1 {k}" for k in range(1, 400)))


def children(pid: int) -> list[int]:
    """The processes that a process has started and that have not ended."""
    listed = Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()
    return [int(child) for child in listed if _is_alive(int(child))]


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def begun(wire: Wire, pid: int, xml: str, name: str = "m") -> list[int]:
    """Ask for a spawn, and give the processes that read its meshes."""
    before = children(pid)
    wire.send(op="call_service", id="spawn", service=SPAWN, args={"model_name": name, "model_xml": xml})
    wire.call("/slidectl/status")
    found = [child for child in children(pid) if child not in before]
    assert found
    return found


def delete(wire: Wire, name: str = "m") -> None:
    assert wire.call("/gazebo/delete_model", model_name=name)["values"]["success"]


def test_the_world_goes_on_while_meshes_are_read(wire: Wire, tmp_path: Path) -> None:
    path = tmp_path / "many.dae"
    path.write_text(nodes(11), "utf-8")
    wire.send(op="call_service", id="spawn", service=SPAWN, args={"model_name": "m", "model_xml": robot(path)})
    assert wire.call("/slidectl/step", cycles=50)["values"][
        "success"
    ]  # `call` skips other answers: see what comes next
    answer = wire.until("service_response", id="spawn")
    assert answer["values"]["success"], answer
    delete(wire)


def test_of_two_who_spawn_the_same_at_once_one_is_refused(connect: Callable[[], Wire], tetrahedron: Path) -> None:
    wires = [connect() for _ in range(5)]
    for wire in wires:
        xml = robot(tetrahedron)
        wire.send(op="call_service", id="spawn", service=SPAWN, args={"model_name": "m", "model_xml": xml})
    answers = [wire.until("service_response", id="spawn")["values"] for wire in wires]
    assert sorted(answer["success"] for answer in answers) == [False] * 4 + [True]
    assert all(
        "there is a robot 'm' already" in answer["status_message"] for answer in answers if not answer["success"]
    )
    delete(wires[0])


def test_who_goes_away_takes_the_process_along(
    daemon: Runtime, connect: Callable[[], Wire], wire: Wire, slow: str
) -> None:
    assert daemon.pid is not None
    going = connect()
    readers = begun(going, daemon.pid, slow)
    going.close()
    while any(map(_is_alive, readers)):
        wire.call("/slidectl/status")
    assert wire.call("/slidectl/list_robots")["values"]["robots"] == []
    listed = f"/proc/{daemon.pid}/task/{daemon.pid}/children"
    while set(map(int, Path(listed).read_text("ascii").split())) & set(readers):
        wire.call("/slidectl/status")  # it is not kept as a zombie either


def test_a_daemon_that_stops_leaves_no_process_behind(runtime: Runtime, slow: str) -> None:
    for number in (None, signal.SIGTERM, signal.SIGKILL):
        runtime.start(paused=True)
        pid = runtime.pid
        assert pid is not None
        with Wire(runtime.paths.socket) as wire:
            readers = begun(wire, pid, slow)
            descriptors = [os.pidfd_open(process) for process in (pid, *readers)]
            if number is None:
                runtime.stop()
            else:
                os.kill(pid, number)
            for descriptor in descriptors:
                assert select.select([descriptor], (), (), 20.0)[0], "it has not ended"
                os.close(descriptor)
        assert "Traceback" not in runtime.log


def sparse(folder: Path) -> Path:
    path = folder / "sparse.stl"
    with path.open("wb") as file:
        file.truncate(40 * 2**30)
    return path


def pipe(folder: Path) -> Path:
    path = folder / "pipe.stl"
    os.mkfifo(path)
    return path


def device(folder: Path) -> Path:
    path = folder / "zero.stl"
    path.symlink_to("/dev/zero")
    return path


def bomb(folder: Path) -> Path:
    path = folder / "bomb.dae"
    path.write_text(nodes(40), "utf-8")
    return path


def endless(folder: Path) -> Path:
    path = folder / "endless.dae"
    path.write_text(nodes(3).replace('url="#n3"', 'url="#n0"'), "utf-8")
    return path


def entities(folder: Path) -> Path:
    path = folder / "entities.dae"
    path.write_text('<!DOCTYPE a [<!ENTITY b "c">]>\n' + nodes(1).replace("1.4.1", "&b;"), "utf-8")
    return path


def flat(folder: Path) -> Path:
    path = folder / "flat.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n", "utf-8")
    return path


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (sparse, "is larger than 128 MiB, the most that is read"),
        (pipe, "no such file"),  # what is no file is not even looked at by the parser
        (device, "no such file"),
        (bomb, "the scene has more than 20000 nodes, instances included"),
        (endless, "the scene has more than 20000 nodes, instances included"),
        (entities, "entities are refused"),
        (flat, "it lies in one plane"),
    ],
)
def test_files_that_ask_for_too_much_are_refused_with_what_it_is(
    wire: Wire, tmp_path: Path, tetrahedron: Path, make: Callable[[Path], Path], reason: str
) -> None:
    path = make(tmp_path)
    answer = wire.call(SPAWN, model_name="m", model_xml=robot(path))["values"]
    assert not answer["success"]
    assert str(path) in answer["status_message"]
    assert reason in answer["status_message"]
    assert wire.call(SPAWN, model_name="m", model_xml=robot(tetrahedron))["values"]["success"]
    delete(wire)


# --- the reader alone ---------------------------------------------------------------------------------------------


def outcome(pending: Pending, loop: EventLoop) -> Any:
    """What comes of a job."""
    while not pending.done:
        loop.poll(20.0)
    return pending.result()


@pytest.fixture
def reader() -> Any:
    """A loop and a reader on it."""
    loop = EventLoop()

    def fail(what: str) -> None:
        raise AssertionError(what)

    reader = MeshReader(loop, fail)
    yield loop, reader
    reader.close()
    loop.close()


SOURCES = [MeshSource(f"/mesh{k}.stl", (1.0, 1.0, 1.0)) for k in range(3)]


def take_memory(_: MeshSource) -> Hull:
    return Hull(str(len(bytearray(8 * LIMITS.new_bytes))), b"")


def compute(_: MeshSource) -> Hull:
    while True:
        pass


def wait(_: MeshSource) -> Hull:
    while True:
        signal.pause()


def die(_: MeshSource) -> Hull:
    os.kill(os.getpid(), signal.SIGSEGV)
    signal.pause()
    raise AssertionError


def fail(_: MeshSource) -> Hull:
    raise ZeroDivisionError("a fault of ours")


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        pytest.param(
            take_memory,
            "the process that read it failed",
            marks=pytest.mark.skipif(not LINUX, reason="the memory of a process is not bounded here"),
        ),
        (compute, "more than 1 s"),
        (wait, "within 1 s"),
        (die, "SIGSEGV"),
        (fail, "the process that read it failed"),
    ],
)
def test_a_process_that_does_not_come_to_its_end_is_named_with_its_mesh(
    reader: Any, monkeypatch: pytest.MonkeyPatch, act: Callable[[MeshSource], Hull], reason: str, capfd: Any
) -> None:
    monkeypatch.setattr(mesh_reader, "LIMITS", replace(LIMITS, cpu_s=1, wall_s=1 if act is wait else 120))
    first = Hull("first.stl", b"")
    monkeypatch.setattr(hulls, "read", lambda source: first if source is SOURCES[0] else act(source))
    loop, meshes = reader
    results = outcome(meshes.read(SOURCES), loop)
    assert list(results) == SOURCES
    assert results[SOURCES[0]] == first
    assert isinstance(results[SOURCES[1]], BadMesh)
    assert reason in results[SOURCES[1]].reason
    assert str(results[SOURCES[1]]).startswith("/mesh1.stl: ")
    assert capfd.readouterr() == ("", "")


def test_jobs_beyond_those_at_once_wait_for_their_turn_and_one_that_is_dropped_never_begins(
    reader: Any, tetrahedron: Path
) -> None:
    loop, meshes = reader
    others = children(os.getpid())
    jobs = [meshes.read([MeshSource(str(tetrahedron), (1.0, 1.0, float(k)))]) for k in range(1, 8)]
    jobs[5].cancel()
    assert len(set(children(os.getpid())) - set(others)) <= mesh_reader.AT_ONCE
    for number, job in enumerate(jobs):
        if number != 5:
            ((source, hull),) = outcome(job, loop).items()
            assert source.scale[2] == number + 1
            assert isinstance(hull, Hull)


def test_a_process_and_the_daemon_itself_read_the_same_to_the_bit(reader: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.dae"
    path.write_text(nodes(3), "utf-8")
    source = MeshSource(str(path), (1.0, 2.0, -0.5))
    loop, meshes = reader
    assert outcome(meshes.read([source]), loop) == {source: hulls.read(source)}


def test_no_process_can_be_started(reader: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> int:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", refuse)
    loop, meshes = reader
    before = set(os.listdir("/proc/self/fd"))
    with pytest.raises(SlidectlError, match="no process can be started to read meshes: Resource temporarily"):
        outcome(meshes.read(SOURCES), loop)
    assert set(os.listdir("/proc/self/fd")) == before
