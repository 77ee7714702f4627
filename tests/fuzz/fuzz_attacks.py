"""The attacks by kind. Each tries one case of a seed and says what came of it; a Fault is what may not happen."""

from __future__ import annotations

import json
import struct
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

from daemon_fixture import ROOT
from fuzz_foxglove import FoxgloveFrames
from fuzz_journals import Journals
from fuzz_limits import limited
from fuzz_mutations import ODD_VALUES, mutated_bytes, mutated_text, shrunk
from fuzz_read_files import Snapshots, Textures, Trajectories
from fuzz_target import RawWire, Target, check_text, write
from fuzz_tcpros import TcprosStreams
from fuzz_xmlrpc import XmlRpcCalls

from slidectl import description
from slidectl.check import dispatch
from slidectl.description import Packages
from slidectl.errors import SlidectlError, UsageError
from slidectl.features.posix_pattern import PosixPattern

# --- lines on the socket ---------------------------------------------------------------------------------------------

_NOT_CALLED = (
    "/slidectl/shutdown", "/slidectl/step", "/slidectl/set_speed", "/gazebo/unpause_physics",
    "/slidectl/set_simulation_state", "/slidectl/step_simulation",
)  # fmt: skip
"""These end the daemon or let time pass, which they may."""
_OPS = (
    "advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service", "service_response",
    "advertise_service", "unadvertise_service", "set_level", "status", "fly",
)  # fmt: skip
_FIELDS = ("topic", "type", "msg", "id", "service", "args", "values", "result", "queue_length", "throttle_rate",
           "latch", "level", "ack", "fragment_size", "compression")  # fmt: skip


class Lines:
    """Objects of the protocol with odd fields, JSON that is broken, and bytes that are none."""

    kind = "lines"

    def __init__(self, target: Target) -> None:
        self.target = target
        called = target.call("/rosapi/services")["services"]
        self.services = sorted(name for name in called if name not in _NOT_CALLED)
        self.topics = [*sorted(target.client.topics()), "/x", "/y/z"]

    def case(self, rng: Random) -> str:
        wire = RawWire(self.target.runtime)
        try:
            alive = all(wire.send(self.line(rng)) for _ in range(rng.choice((1, 3, 10))))
            mark = f"done{rng.randrange(10**9)}"
            last = {"op": "call_service", "id": mark, "service": "/rosapi/get_time", "args": {}}
            alive = alive and wire.send(b"\n" + json.dumps(last).encode())
            got = wire.until(f'"{mark}"'.encode())
        finally:
            wire.close()
        check_text(got.decode("utf-8", "replace"), "an answer")
        self.target.check()
        return "answered" if alive and mark.encode() in got else "hung up on"

    def line(self, rng: Random) -> bytes:
        message = {"op": rng.choice(_OPS)}
        message |= {field: self.value(rng, field) for field in rng.sample(_FIELDS, rng.randrange(6))}
        if message["op"] == "call_service":
            message["service"] = rng.choice(self.services)
        line = json.dumps(message, ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass")
        line = line.replace(b"\n", b" ")
        if rng.random() < 0.3:
            line = mutated_bytes(rng, line).replace(b"\n", b" ")
        return b"" if any(name.encode() in line for name in _NOT_CALLED) else line

    def value(self, rng: Random, field: str, depth: int = 0) -> Any:
        if field in ("topic", "service") and rng.random() < 0.7:
            return rng.choice(self.topics if field == "topic" else self.services)
        if field == "type" and rng.random() < 0.7:
            return rng.choice(("std_msgs/Float64", "std_msgs/String", "std_srvs/Empty", "tf2_msgs/TFMessage"))
        kind = rng.randrange(9 if depth < 4 else 6)
        if kind < 2:
            return rng.choice(ODD_VALUES)
        if kind < 6:
            return rng.choice((None, True, 0, -1, 2**63, 2**70, 1e308, float("nan"), float("inf"), 0.5))
        if kind == 6:
            return [self.value(rng, "", depth + 1) for _ in range(rng.randrange(4))]
        keys = ("data", "name", "names", "secs", "model_name", "value", "header", "transforms", "start_controllers")
        return {key: self.value(rng, "", depth + 1) for key in rng.sample(keys, rng.randrange(4))}


# --- files -----------------------------------------------------------------------------------------------------------


def _samples() -> list[tuple[str, str]]:
    """Names and texts of sound files of every kind."""
    wanted = [*ROOT.glob("models/*.xacro"), *ROOT.glob("config/*.yaml"), *ROOT.glob("launch/*.launch")]
    wanted += [path for path in (ROOT / "tests" / "data" / "packages").rglob("*") if path.suffix in _SUFFIXES]
    return [(path.name, path.read_text("utf-8")) for path in sorted(wanted) if path.is_file()]


_SUFFIXES = (".xacro", ".urdf", ".yaml", ".launch")


class Files:
    """xacro, URDF, YAML and launch files through `slidectl check`'s machinery, in this process."""

    kind = "files"

    def __init__(self, target: Target) -> None:
        del target
        self.samples = [*_samples(), ("slider.urdf", description.load("slider").urdf)]
        self.folder = Path(tempfile.mkdtemp(prefix="slidectl-fuzz-"))

    def case(self, rng: Random) -> str:
        name, text = rng.choice(self.samples)
        changed = mutated_text(rng, text)
        try:
            return self.check(name, changed)
        except Exception as error:
            kind = type(error)
            small = shrunk(changed, lambda fewer: self.fails(name, fewer, kind))
            raise AssertionError(f"{name}: {type(error).__name__}: {error}\n{small}") from error

    def fails(self, name: str, text: str, kind: type[Exception]) -> bool:
        try:
            self.check(name, text)
        except kind:
            return True
        except Exception:
            return False
        return False

    def check(self, name: str, text: str) -> str:
        path = write(self.folder, name, text.encode("utf-8", "surrogatepass"))
        words, files = ([str(path)], []) if path.suffix != ".yaml" else (["slider"], [path])
        packages = Packages({"here": self.folder}, start=self.folder)
        try:
            with limited():
                findings = dispatch.check(words, {}, packages, files, None, second_opinion=False)
        except SlidectlError:
            return "refused"
        if findings.broken:
            return "refused"
        return "found wrong" if findings.count("wrong") else "passed"


# --- robots and meshes -----------------------------------------------------------------------------------------------


class Robots:
    """Changed URDFs into the daemon: spawned, stepped and deleted, or refused with the world as it was."""

    kind = "robots"

    def __init__(self, target: Target) -> None:
        self.target = target
        self.samples = [description.load(name).urdf for name in ("slider", "rrbot")]

    def case(self, rng: Random) -> str:
        return self.spawn(mutated_text(rng, rng.choice(self.samples)), rng)

    def spawn(self, xml: str, rng: Random) -> str:
        target = self.target
        before = target.world()
        xml = xml.encode("utf-8", "replace").decode()
        answer = target.call("/gazebo/spawn_urdf_model", model_name="fuzzed", model_xml=xml)
        check_text(answer["status_message"], "the answer of spawn")
        outcome = "refused"
        if answer["success"]:
            step = target.call("/slidectl/step", cycles=rng.choice((1, 3)))
            outcome = "simulated" if step["success"] else "diverged"
            deleted = target.call("/gazebo/delete_model", model_name="fuzzed")
            if not deleted["success"]:
                raise AssertionError(f"cannot be deleted: {deleted['status_message']}\n{xml}")
        after = target.world()
        if after != before:
            raise AssertionError(f"{outcome}, and the world is another one\nbefore {before}\nafter {after}\n{xml}")
        target.check()
        return outcome


_DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="1"/></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1
</float_array><technique_common><accessor source="#a" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""
_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
_CORNERS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
_STL = (
    bytes(80)
    + struct.pack("<I", 4)
    + b"".join(struct.pack("<12fH", 0, 0, 0, *(x for c in f for x in _CORNERS[c]), 0) for f in _FACES)
)
_TEXT_STL = "solid s\n" + "".join(
    "facet normal 0 0 0\nouter loop\n"
    + "".join("vertex {} {} {}\n".format(*_CORNERS[c]) for c in face)
    + "endloop\nendfacet\n"
    for face in _FACES
)
_MESHED = (
    '<robot name="m"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    'iyz="0"/></inertial><collision><geometry><mesh filename="file://{}"/></geometry></collision></link></robot>'
)


class Meshes(Robots):
    """Changed mesh files, STL in both forms, OBJ and DAE, on a robot in the daemon."""

    kind = "meshes"

    def __init__(self, target: Target) -> None:
        super().__init__(target)
        self.folder = Path(tempfile.mkdtemp(prefix="slidectl-fuzz-"))

    def case(self, rng: Random) -> str:
        name, content = rng.choice((("b.stl", _STL), ("t.stl", _TEXT_STL), ("o.obj", _OBJ), ("d.dae", _DAE)))
        if isinstance(content, str) and rng.random() < 0.7:
            changed = mutated_text(rng, content).encode("utf-8", "surrogatepass")
        else:
            changed = mutated_bytes(rng, content.encode() if isinstance(content, str) else content)
        path = write(self.folder, name, changed)
        try:
            return self.spawn(_MESHED.format(path), rng)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{name}: {changed!r}") from error


# --- the controller manager ------------------------------------------------------------------------------------------

_CONTROLLERS = {
    "states": ({"type": "joint_state_controller/JointStateController", "publish_rate": 50}, ()),
    "one": ({"type": "effort_controllers/JointEffortController", "joint": "joint1"}, ("joint1",)),
    "other": ({"type": "effort_controllers/JointEffortController", "joint": "joint1"}, ("joint1",)),
    "two": ({"type": "effort_controllers/JointPositionController", "joint": "joint2", "pid": {"p": 1.0}}, ("joint2",)),
    "both": ({"type": "effort_controllers/JointGroupEffortController", "joints": ["joint1", "joint2"]},
             ("joint1", "joint2")),
    "lost": ({"type": "effort_controllers/JointEffortController", "joint": "joint9"}, None),
}  # fmt: skip
"""Parameters, and the joints that are claimed; None where it cannot be loaded."""


class ManagerModel:
    """What the rules of ros_control say: who is loaded, who runs, and what is refused."""

    def __init__(self, loadable: dict[str, tuple[str, ...]]) -> None:
        self.loadable = loadable
        self.states: dict[str, str] = {}

    def load(self, name: str) -> bool:
        if name not in self.loadable or name in self.states:
            return False
        self.states[name] = "initialized"
        return True

    def unload(self, name: str) -> bool:
        return self.states.get(name, "running") != "running" and bool(self.states.pop(name))

    def switch(self, start: list[str], stop: list[str], strict: bool) -> bool:
        if strict and not {*start, *stop} <= self.states.keys():
            return False
        running = {name for name, state in self.states.items() if state == "running"}
        stopping, starting = set(stop) & running, (set(start) & self.states.keys()) - (running - set(stop))
        if strict and (set(stop) - running or set(start) & running - set(stop)):
            return False
        if starting & stopping:
            return False
        claims = [joint for name in (running - stopping) | starting for joint in self.loadable[name]]
        if len(claims) != len(set(claims)):
            return False
        self.states |= dict.fromkeys(stopping, "stopped") | dict.fromkeys(starting, "running")
        return True


class Manager:
    """Random operations of the controller manager, held against the model after each."""

    kind = "manager"
    robot = "managed"

    def __init__(self, target: Target) -> None:
        self.target = target
        self.space = f"/{self.robot}"

    def case(self, rng: Random) -> str:
        target = self.target
        xml = description.load("rrbot", {"namespace": self.space}).xml
        request = {"model_name": self.robot, "model_xml": xml, "robot_namespace": self.space}
        assert target.call("/gazebo/spawn_urdf_model", **request)["success"]
        try:
            known = set(target.call(f"{self.space}/controller_manager/list_controller_types")["types"])
            for name, (parameters, _) in _CONTROLLERS.items():
                value = json.dumps(parameters)
                target.call("/rosapi/set_param", name=f"{self.space}/{name}", value=value)
            able = {n: j for n, (p, j) in _CONTROLLERS.items() if j is not None and p["type"] in known}
            model = ManagerModel(able)
            for _ in range(25):
                self.step(rng, model)
        finally:
            target.call("/gazebo/delete_model", model_name=self.robot)
            for name in _CONTROLLERS:
                with suppress(SlidectlError):
                    target.call("/rosapi/delete_param", name=f"{self.space}/{name}")
        target.check()
        return "agreed"

    def step(self, rng: Random, model: ManagerModel) -> None:
        names = [*_CONTROLLERS, "nobody"]
        verb = rng.choice(("load", "load", "unload", "switch", "switch", "switch", "step"))
        if verb == "step":
            self.target.call("/slidectl/step", cycles=rng.choice((1, 2, 7)))
            return
        if verb == "switch":
            start, stop = (rng.sample(names, rng.choice((0, 1, 1, 2, 3))) for _ in range(2))
            strictness = rng.choice((1, 2))
            request: dict[str, Any] = {"start_controllers": start, "stop_controllers": stop, "strictness": strictness}
            expected = model.switch(start, stop, strictness == 2)
        else:
            request = {"name": rng.choice(names)}
            expected = getattr(model, verb)(request["name"])
        answer = self.target.call(f"{self.space}/controller_manager/{verb}_controller", **request)["ok"]
        listed = self.target.call(f"{self.space}/controller_manager/list_controllers")["controller"]
        states = {one["name"]: one["state"] for one in listed}
        if (answer, states) != (expected, model.states):
            raise AssertionError(f"{verb} {request}: {answer} {states}, expected {expected} {model.states}")


# --- patterns for names -----------------------------------------------------------------------------------------------


class Patterns:
    """Regular expressions of signs that mean something, nested and repeated at random, on names of all lengths."""

    kind = "patterns"
    SIGNS = (
        *("a", "b", "_", "1", ".", "^", "$", "|", "(", "(", ")", ")", "[", "]", "[^", "a-z", "[:alpha:]", "\\"),
        *("*", "+", "?", "{", "}", "{2}", "{,3}", "{0,255}", "{255}", "{3,}", "é", "\0"),
    )

    def __init__(self, target: Target) -> None:
        pass

    def case(self, rng: Random) -> str:
        fitting = 0
        for _ in range(100):
            length = rng.choice((3, 8, 8, 20, 20, 60))
            text = "".join(rng.choices(self.SIGNS, k=length)) if rng.random() < 0.5 else self._nested(rng, length)
            name = "".join(rng.choices("ab_1", k=rng.choice((0, 1, 8, 8, 40, 40, 200))))
            with suppress(UsageError):
                fitting += PosixPattern(text).is_in(name)
        return "some fit" if fitting else "none fits"

    def _nested(self, rng: Random, length: int) -> str:
        """One without mistakes, which may be too large."""
        if length < 4:
            return rng.choice(("a", ".", "[ab]", "[^1]", "", "^", "$"))
        first, second = self._nested(rng, length // 2), self._nested(rng, length // 3)
        return f"({first}{rng.choice(('', '|'))}{second}){rng.choice(('', '*', '+', '?', '{2}', '{0,9}', '{255}'))}"


ATTACKS: dict[str, Callable[[Target], Any]] = {
    attack.kind: attack
    for attack in (
        Lines,
        Files,
        Robots,
        Meshes,
        Snapshots,
        Trajectories,
        Textures,
        Manager,
        TcprosStreams,
        XmlRpcCalls,
        FoxgloveFrames,
        Patterns,
        Journals,
    )
}
