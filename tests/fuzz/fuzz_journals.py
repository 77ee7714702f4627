"""Attacks on the replay of journals: entries changed, left out, doubled and swapped, each with its right checksum."""

from __future__ import annotations

import base64
import json
import tempfile
import zlib
from pathlib import Path
from random import Random
from typing import Any

from fuzz_limits import limited
from fuzz_mutations import ODD_VALUES, mutated_bytes
from fuzz_target import Fault, Target, write

from slidectl import description
from slidectl.daemon.in_process import InProcessWorld
from slidectl.daemon.options import DaemonOptions
from slidectl.errors import SlidectlError
from slidectl.extensions.journal import journal
from slidectl.extensions.journal.journal import Journal
from slidectl.extensions.journal.journal_replay import Replay
from slidectl.simulation import Simulation

_SPRING = """
from slidectl.control import Controller, EffortJointInterface

class Spring(Controller):
    interface_type = EffortJointInterface
    def init(self, interface, node):
        self.joint = interface.get_handle("joint1")
        return True
    def update(self, time_ns, period_s):
        self.joint.command = 100.0 * (0.5 - self.joint.position)
"""
_BLOCK = (
    '<robot name="block"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    'iyz="0"/></inertial><collision><geometry><mesh filename="file://{}"/></geometry></collision></link></robot>'
)
_ODD: tuple[Any, ...] = (
    *ODD_VALUES, None, True, False, 0, -1, 1, 2, 3, 999, 1000, 1001, 3000, 2**31, 2**63, 10**30, 0.5, 1e308,
    float("nan"), float("inf"), [], {}, [[]], [1, 2, 3], {"data": 1}, [None, ""], ["", ""],
)  # fmt: skip


class Journals:
    """Journals of a short run with a robot, a mesh and a controller of a user, replayed in this process."""

    kind = "journals"

    def __init__(self, target: Target) -> None:
        del target
        self.folder = Path(tempfile.mkdtemp(prefix="slidectl-fuzz-"))
        self.first, self.entries = self.recorded()

    def recorded(self) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """The first line and the entries of a sound journal."""
        import trimesh  # heavy

        path = self.folder / "sound.journal"
        law, mesh = write(self.folder, "law.py", _SPRING.encode()), self.folder / "block.stl"
        trimesh.creation.box((0.1, 0.2, 0.3)).export(mesh)
        notes = Journal(DaemonOptions(journal=str(path), engine="plain", paused=True))
        try:
            simulation = Simulation(engine="plain", host=notes)
            simulation.run.paused = True
            world = InProcessWorld(simulation)
            with world.client() as client:
                client.call(
                    "/gazebo/spawn_urdf_model", {"model_name": "slider", "model_xml": description.load("slider").xml}
                )
                client.call("/gazebo/spawn_urdf_model", {"model_name": "block", "model_xml": _BLOCK.format(mesh)})
                request = {"robot": "slider", "name": "spring", "file": str(law), "class_name": "Spring"}
                assert client.call("/slidectl/load_controller_file", request)["ok"]
                start = {"start_controllers": ["spring"], "stop_controllers": [], "strictness": 2}
                client.call("/slider/controller_manager/switch_controller", start)
                for _ in range(3):
                    client.call("/slidectl/step", {"cycles": 1000})
        finally:
            notes.close("it is recorded")
        first, *entries = (json.loads(line) for line in path.read_bytes().splitlines())
        assert {"line", "read", "meshes", "state", "end"} <= {key for entry in entries for key in entry}
        return first, entries

    def case(self, rng: Random) -> str:
        first, entries = dict(self.first), [dict(entry) for entry in self.entries]
        for _ in range(rng.choice((1, 1, 1, 2, 4))):
            self.change(rng, first, entries)
        path = write(self.folder, "changed.journal", b"".join(map(sealed, [first, *entries])))
        try:
            with limited():
                replay = Replay(journal.read(str(path)))
                replay.run(self.unexpected)
        except SlidectlError as error:
            if str(path) not in str(error):
                raise Fault(f"it does not say which file: {error}") from error
            return "refused"
        return "differs" if replay.differs else "replayed"

    def unexpected(self, what: str) -> None:
        raise Fault(what)

    def change(self, rng: Random, first: dict[str, Any], entries: list[dict[str, Any]]) -> None:
        """Change one entry. The code of the user's controller stays: another code may do anything."""
        if rng.random() < 0.1:
            first["options"] = changed(rng, first["options"])
            return
        if not entries:
            return
        place, other = rng.randrange(len(entries)), rng.randrange(len(entries))
        kind, sound = rng.randrange(8), entries[place] in self.entries
        if kind == 0:
            del entries[place]
        elif kind == 1:
            entries.insert(other, entries[place])
        elif kind == 2:
            entries[place], entries[other] = entries[other], entries[place]
        elif not sound:  # changed before
            entries[place] = changed(rng, entries[place])
        elif str(entries[place].get("read", "")).startswith("code of "):
            entries[place]["cycle"] = rng.choice(_ODD)
        elif kind == 3 and "state" in entries[place]:
            content = mutated_bytes(rng, base64.b64decode(str(entries[place]["state"])))
            entries[place]["state"] = base64.b64encode(content).decode()
        else:
            entries[place] = changed(rng, entries[place])


def changed(rng: Random, value: Any) -> Any:
    """A copy with one value at any depth replaced, left out, added or renamed."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.1:
        return rng.choice(_ODD)
    if isinstance(value, list):
        place = rng.randrange(len(value))
        return [changed(rng, one) if at == place else one for at, one in enumerate(value)]
    key, kind = rng.choice(sorted(value)), rng.randrange(8)
    if kind == 0:
        return {name: one for name, one in value.items() if name != key}
    if kind == 1:
        return {**value, rng.choice(("cycle", "client", "gone", "wind", "state", "limit")): rng.choice(_ODD)}
    return {**value, key: changed(rng, value[key])}


def sealed(entry: Any) -> bytes:
    """The line of an entry, with its checksum."""
    entry = {key: value for key, value in entry.items() if key != "crc"} if isinstance(entry, dict) else {"": entry}
    body = json.dumps(entry, separators=(",", ":"))[:-1].encode("utf-8", "surrogatepass")
    return b'%b,"crc":"%08x"}\n' % (body, zlib.crc32(body))
