"""Files that a running world reads, changed: snapshots, trajectories, and the pictures and materials of meshes."""

from __future__ import annotations

import asyncio
import hashlib
import json
import struct
import tempfile
import warnings
import zlib
from pathlib import Path
from random import Random
from typing import Any

from fuzz_limits import limited
from fuzz_mutations import ODD_VALUES, mutated_bytes, mutated_text
from fuzz_target import ANSWER_LIMIT_S, Fault, Target, check_text, write
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

from slidectl import description
from slidectl.cli.trajectory import read_goal
from slidectl.client.action_client import Action
from slidectl.errors import SlidectlError
from slidectl.extensions.gateways.foxglove.foxglove_frames import SUBPROTOCOLS
from slidectl.extensions.gateways.foxglove.foxglove_gateway import FoxgloveGateway, FoxgloveOptions
from slidectl.extensions.viewing.drawn_scene import DrawnScene, ViewpointChoice
from slidectl.extensions.viewing.software_renderer import SoftwareRenderer
from slidectl.features.snapshot_files import MAGIC

ARM = "arm_controller"
ROBOT = "fuzzed"


def spawn_arm(target: Target) -> None:
    """RRBot under a trajectory controller, in the robot's own namespace."""
    space = f"/{ROBOT}"
    xml = description.load("rrbot", {"namespace": space}).xml
    answer = target.call("/gazebo/spawn_urdf_model", model_name=ROBOT, model_xml=xml, robot_namespace=space)
    assert answer["success"], answer
    controllers = {
        "states": {"type": "joint_state_controller/JointStateController", "publish_rate": 100},
        ARM: {
            "type": "effort_controllers/JointTrajectoryController",
            "joints": ["joint1", "joint2"],
            "gains": {name: {"p": 100.0, "d": 10.0} for name in ("joint1", "joint2")},
            "constraints": {"goal_time": 1.0},
        },
    }
    target.client.params.set_all({f"{space}/{name}": value for name, value in controllers.items()})
    target.client.controllers(space).bring_up(list(controllers))


# --- snapshots --------------------------------------------------------------------------------------------------------

_NUMBERS: tuple[Any, ...] = (
    0,
    -1,
    1,
    2**31,
    2**63,
    -(2**64),
    0.5,
    -0.0,
    1e-9,
    1e300,
    1e308,
    float("inf"),
    float("nan"),
)
_OTHERS: tuple[Any, ...] = (None, True, [], {}, [1], {"~": "left"}, {"~": "tuple", "of": []}, {"~": "Ref", "of": [0]})


class Snapshots:
    """Snapshots changed in their bytes, or in their content under a sound checksum.

    One is loaded and can be simulated, or it is refused and the world is as before. The sound one can always be loaded.
    """

    kind = "snapshots"

    def __init__(self, target: Target) -> None:
        self.target = target
        self.folder = Path(tempfile.mkdtemp(prefix="slidectl-fuzz-"))
        spawn_arm(target)
        target.call("/slidectl/step", cycles=20)
        target.client.save("sound", str(self.folder / "sound.snapshot"))
        self.content = (self.folder / "sound.snapshot").read_bytes()
        first, _, packed = self.content.removeprefix(MAGIC).partition(b"\n")
        self.about, self.tree = json.loads(first), zlib.decompress(packed)
        self.before = target.world()

    def case(self, rng: Random) -> str:
        target, is_signed = self.target, rng.random() < 0.85
        changed = self.signed(rng) if is_signed else mutated_bytes(rng, self.content)
        path = write(self.folder, "changed.snapshot", changed)
        try:
            target.client.load(file=str(path))
        except SlidectlError as error:
            check_text(str(error), "the answer of load")
            self.as_before("a refused snapshot")
            target.check()
            return "refused"
        answer = target.call("/slidectl/step", cycles=rng.choice((1, 3, 20)))
        check_text(answer["message"], "the answer of step")
        target.client.load("sound")
        self.as_before("the sound snapshot after a changed one")
        target.check()
        return "simulated" if answer["success"] else "diverged"

    def as_before(self, what: str) -> None:
        after = self.target.world()
        if after != self.before:
            raise Fault(f"{what} left another world\nbefore {self.before}\nafter {after}")

    def signed(self, rng: Random) -> bytes:
        """The content with one to four changes, under its own length and checksum."""
        tree = json.loads(self.tree)
        for _ in range(rng.choice((1, 1, 2, 4))):
            _change(rng, tree)
        packed = zlib.compress(json.dumps(tree).encode(), 1)
        about = self.about | {"size": len(packed), "sha256": hashlib.sha256(packed).hexdigest()}
        return MAGIC + json.dumps(about).encode() + b"\n" + packed


def _change(rng: Random, tree: Any) -> None:
    """Change one place of the tree, at a random depth."""
    place = tree
    while True:
        keys = list(place) if isinstance(place, dict) else range(len(place))
        if not keys:
            return
        key = rng.choice(keys)
        inside = place[key]
        if not isinstance(inside, dict | list) or not inside or rng.random() < 0.1:
            break
        place = inside
    kind = rng.randrange(6)
    if kind == 0:
        del place[key]
    elif kind == 1 and isinstance(place, list):
        place.insert(key, rng.choice(place))
    elif kind == 2:
        place[key] = place[rng.choice(keys)]
    elif kind == 3 and isinstance(inside, str):
        place[key] = mutated_text(rng, inside).encode("utf-8", "replace").decode()
    elif kind == 4 and isinstance(inside, bool | int | float):
        place[key] = rng.choice((inside + 1, -inside, inside * 2, inside * 1e9))
    else:
        place[key] = rng.choice((*_NUMBERS, *_OTHERS, *ODD_VALUES))


# --- trajectories -----------------------------------------------------------------------------------------------------

_YAML = """joint_names: [joint1, joint2]
points:
  - {positions: [0.1, 0.2], velocities: [0.0, 0.1], accelerations: [0.0, 0.0], time_from_start: 0.05}
  - positions: [0.3, -0.2]
    time_from_start: {secs: 0, nsecs: 100000000}
"""
_GOAL = {
    "trajectory": {
        "joint_names": ["joint2", "joint1"],
        "points": [
            {"positions": [0.5, 0.25], "velocities": [0.5, 0.5], "time_from_start": {"sec": 0, "nanosec": 50000000}},
            {"positions": [1.0, 0.5], "velocities": [0.0, 0.0], "time_from_start": 0.1},
        ],
    },
    "path_tolerance": [{"name": "joint1", "position": 0.5, "velocity": 0.0, "acceleration": 0.0}],
    "goal_tolerance": [{"name": "joint2", "position": 0.1, "velocity": 0.0, "acceleration": 0.0}],
    "goal_time_tolerance": 0.5,
}
_CSV = "time, joint1, joint2, joint1.velocity, joint2.velocity\n0.05, 0.1, 0.2, 0.0, 0.1\n0.1, 0.3, -0.2, 0, 0\n"


class Trajectories:
    """Changed files of trajectories, YAML, JSON and CSV, sent to a controller that runs.

    Each is refused, or becomes a goal that is rejected or followed; the world goes on, and so does the controller.
    """

    kind = "trajectories"

    def __init__(self, target: Target) -> None:
        self.target = target
        self.folder = Path(tempfile.mkdtemp(prefix="slidectl-fuzz-"))
        spawn_arm(target)
        target.client.save("sound")
        self.before = target.world()

    def case(self, rng: Random) -> str:
        name, text = rng.choice((("t.yaml", _YAML), ("t.json", json.dumps(_GOAL)), ("t.csv", _CSV)))
        if rng.random() < 0.8:
            content = mutated_text(rng, text).encode("utf-8", "surrogatepass")
        else:
            content = mutated_bytes(rng, text.encode())
        target = self.target
        try:
            goal = read_goal(str(write(self.folder, name, content)))
        except SlidectlError as error:
            check_text(str(error), "reading")
            return "refused"
        try:
            with Action(target.client, f"/{ROBOT}/{ARM}/follow_joint_trajectory") as action:
                sent = action.send(goal)
                step = target.call("/slidectl/step", cycles=rng.choice((1, 10, 150)))
                if not step["success"]:
                    raise Fault(f"it stopped the world: {step['message']}\n{content.decode('utf-8', 'replace')}")
                ended = action.ended(sent)
                outcome = ended.state.lower() if ended is not None else "under way"
                check_text("" if ended is None else ended.text, "the result")
        except SlidectlError as error:
            check_text(str(error), "sending")
            outcome = "not sent"
        target.client.load("sound")
        after = target.world()
        if after != self.before:
            raise Fault(f"it left another world\nbefore {self.before}\nafter {after}")
        target.check()
        return outcome


# --- textures ---------------------------------------------------------------------------------------------------------


def _png(width: int, height: int) -> bytes:
    rows = b"".join(b"\0" + bytes((7 * (x + y)) % 256 for x in range(3 * width)) for y in range(height))
    parts = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(rows)))
    chunks = (
        struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in (*parts, (b"IEND", b""))
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


_MTL = "newmtl skin\nKa 1 1 1\nKd 0.8 0.8 0.8\nmap_Kd skin.png\nmap_Ks -s 1 1 1 shine.png\nnewmtl bare\nKd 0 0 1\n"
_OBJ = (
    "mtllib part.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl skin\n"
    "f 1/1 3/3 2/2\nf 1/1 2/2 4/3\nusemtl bare\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n"
)
_DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="1"/></asset>
<library_images><image id="i" name="i"><init_from>skin.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON><newparam sid="s"><surface type="2D"><init_from>i</init_from></surface>
</newparam><newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam><technique sid="c"><lambert><diffuse>
<texture texture="t" texcoord="UV"/></diffuse></lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1
</float_array><technique_common><accessor source="#a" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4" material="k"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="k" target="#m"/></technique_common></bind_material></instance_geometry></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""
_URDF = """<robot name="textured"><material name="skin"><texture filename="file://{folder}/skin.png"/></material>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="file://{folder}/part.obj"/></geometry><material name="skin"/></visual>
<visual><geometry><mesh filename="file://{folder}/part.dae"/></geometry>
<material name="other"><color rgba="1 0 0 1"/><texture filename="file://{folder}/skin.png"/></material></visual>
<collision><geometry><mesh filename="file://{folder}/part.obj"/></geometry></collision></link></robot>
"""
_SECRET = b"only the owner may read this"
_REACHED = (
    "../secret.png",
    "../secret.mtl",
    "link.png",
    "part.obj",
    "skin.png",
    "%2e%2e/secret.png",
    "./../secret.png",
)
"""Names that a material is changed to: files beside it, above it, and behind a link."""


class Textures:
    """A mesh with materials and pictures, one of the files changed: spawned, drawn, and fetched by an app.

    No file from outside of the model's folder is ever fetched.
    """

    kind = "textures"

    def __init__(self, target: Target) -> None:
        self.target = target
        outer = Path(tempfile.mkdtemp(prefix="slidectl-fuzz-"))
        self.folder = outer / "model"
        self.folder.mkdir()
        for name in ("secret.png", "secret.mtl"):
            (outer / name).write_bytes(_SECRET)
        (self.folder / "link.png").symlink_to(outer / "secret.png")
        picture = _png(8, 8)
        self.sound: dict[str, bytes] = {
            "part.obj": _OBJ.encode(), "part.dae": _DAE.encode(), "part.mtl": _MTL.encode(), "skin.png": picture,
            "shine.png": picture, "part.urdf": _URDF.format(folder=self.folder).encode(),
        }  # fmt: skip

    def case(self, rng: Random) -> str:
        files = dict(self.sound)
        for name in rng.sample(list(files), rng.choice((1, 1, 2))):
            files[name] = self.changed(rng, name, files[name])
        for name, content in files.items():
            write(self.folder, name, content)
        try:
            document = description.load(str(self.folder / "part.urdf"))
        except SlidectlError as error:
            check_text(str(error), "reading the model")
            return "refused"
        target, before = self.target, self.target.world()
        answer = target.call("/gazebo/spawn_urdf_model", model_name=ROBOT, model_xml=document.xml)
        check_text(answer["status_message"], "the answer of spawn")
        if not answer["success"]:
            if target.world() != before:
                raise Fault("it is refused, and the world is another one")
            target.check()
            return "refused"
        self.draw()
        fetched = asyncio.run(self.fetched())
        assert target.call("/gazebo/delete_model", model_name=ROBOT)["success"]
        target.check()
        if any(_SECRET in content for content in fetched):
            raise Fault("an app could fetch a file from outside of the model's folder")
        return f"drawn and {len(fetched)} fetched"

    def changed(self, rng: Random, name: str, content: bytes) -> bytes:
        if name.endswith(".png"):
            return mutated_bytes(rng, content)
        text = content.decode()
        if rng.random() < 0.4:
            old = rng.choice(("skin.png", "shine.png", "part.mtl"))
            text = text.replace(old, rng.choice((*_REACHED, *ODD_VALUES)))
        return mutated_text(rng, text).encode("utf-8", "surrogatepass") if rng.random() < 0.8 else text.encode()

    def draw(self) -> None:
        """As `slidectl render` does without OpenGL."""
        answer = self.target.call("/slidectl/scene", descriptions=True)
        with limited(), warnings.catch_warnings():
            warnings.simplefilter("error")
            scene = DrawnScene(answer)
            SoftwareRenderer((32, 32)).draw(scene, ViewpointChoice(scene, "iso", (32, 32)).of(scene))

    async def fetched(self) -> list[bytes]:
        """What an app gets that asks for the meshes, and for all that they may name."""
        gateway = FoxgloveGateway(FoxgloveOptions(port=0))
        address = await gateway.open()
        try:
            await gateway.attach(self.target.runtime.paths)
            async with connect(address, subprotocols=[Subprotocol(SUBPROTOCOLS[0])], max_queue=None) as app:
                names = ("part.obj", "part.dae", "part.mtl", "skin.png", "shine.png", *_REACHED)
                uris = [f"file://{self.folder}/{name}" for name in names] + [f"file://{self.folder.parent}/secret.png"]
                found = [await asyncio.wait_for(_fetch(app, uri), ANSWER_LIMIT_S) for uri in uris]
                return [content for content in found if content is not None]
        finally:
            await gateway.close()


async def _fetch(app: ClientConnection, uri: str) -> bytes | None:
    """The content of an asset; None when it is refused."""
    await app.send(json.dumps({"op": "fetchAsset", "uri": uri, "requestId": 1}))
    async for frame in app:
        if isinstance(frame, bytes) and frame[0] == 4:
            status, length = frame[5], int.from_bytes(frame[6:10], "little")
            check_text(frame[10 : 10 + length].decode("utf-8", "replace"), "the answer to fetchAsset")
            return None if status else frame[10 + length :]
    raise Fault("the gateway hung up")
