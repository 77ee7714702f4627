"""The snapshots of a simulation by name and as files, and the services that save, load, list, delete and export them.

A file is a magic line, a line of JSON with metadata, and compressed JSON. Nothing in it is code. The metadata holds the
versions of slidectl and MuJoCo, and the length and the digest of the rest. A file of other versions is refused: it
would continue with other bits, or have other attributes.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import zlib
from array import array
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

import slidectl
from slidectl import input_files, names, writing
from slidectl.control.node_handle import Message
from slidectl.description.meshes import BadMesh
from slidectl.effects import Effect
from slidectl.errors import BadFile, BadName, Refused, SlidectlError, UnknownName, UsageError
from slidectl.features.own_services import absolute_path
from slidectl.features.saved_state import NOT_SAVED, NUMBER_TYPES, Method, Named, NotSaved, Ref, SavedObject
from slidectl.features.snapshots import Snapshot, SpawnedAs, capture, restore
from slidectl.physics import mujoco_library
from slidectl.physics.hulls import Hull, MeshSource
from slidectl.simulation.clock import NEVER, SECOND
from slidectl.simulation.feature import Feature
from slidectl.simulation.host import Host
from slidectl.simulation.services import Handler

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

MAGIC = b"slidectl snapshot\n"
LARGEST = 1 << 30
"""The most bytes of the uncompressed content. A file from another user may expand to far more than its size."""
_TAG = "~"
_Packed = Any
"""A value that JSON can represent."""


def write(snapshot: Snapshot, path: str, host: Host) -> None:
    """Write the file, whole or not at all. Raises Refused: it cannot be written."""
    content = zlib.compress(json.dumps(_pack_all(snapshot), separators=(",", ":")).encode(), 1)
    about = {
        "slidectl": slidectl.__version__,
        "mujoco": mujoco_library.VERSION,
        "size": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    whole = MAGIC + json.dumps(about).encode() + b"\n" + content
    trouble, _, hint = host.read(f"writing of the snapshot {path}", lambda: _written(path, whole)).partition("\n")
    if trouble:
        raise Refused(f"cannot write the snapshot {path}: {trouble}", hint or None)


def _written(path: str, content: bytes) -> str:
    """Write the content. Returns the reason of a failure, and in a second line what to do about it; else nothing."""
    if os.path.exists(path) and not os.path.isfile(path):  # opening a pipe would block the daemon
        return "it is not a regular file"
    try:
        writing.write_whole(path, content)
    except OSError as error:
        return "\n".join(filter(None, (writing.reason(error, path), writing.hint(error, path))))
    return ""


def read(path: str, host: Host) -> Snapshot:
    """The snapshot in a file. Raises BadFile: not a snapshot, of another version, cut off, or damaged."""
    text, trouble = host.read(f"snapshot {path}", lambda: _content(path))
    if trouble:
        raise BadFile(trouble, path)
    try:
        first, _, content = base64.b64decode(text).partition(b"\n")
        about = json.loads(first)
        versions = {name: about[name] for name in ("slidectl", "mujoco")}
        size, digest = int(about["size"]), str(about["sha256"])
    except (ValueError, LookupError, TypeError, RecursionError):
        raise BadFile("the snapshot is cut off or damaged in its second line", path) from None
    for name, here in (("slidectl", slidectl.__version__), ("mujoco", mujoco_library.VERSION)):
        if versions[name] != here:
            text = f"the snapshot was saved with {name} {versions[name]}, and this is {name} {here}"
            raise BadFile(text, path, hint="save it again with this version")
    if len(content) < size:
        raise BadFile(f"the snapshot is cut off: {len(content)} bytes of {size} are there", path)
    if hashlib.sha256(content).hexdigest() != digest:
        raise BadFile("the snapshot is damaged: checksum mismatch", path)
    try:
        expander = zlib.decompressobj()
        expanded = expander.decompress(content, LARGEST)
        if expander.unconsumed_tail:
            raise ValueError(f"more than {LARGEST} bytes")
        snapshot = _unpack_all(json.loads(expanded))
        _check(snapshot)
        return snapshot
    except (
        ArithmeticError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        RecursionError,
        zlib.error,
        SlidectlError,
    ) as error:
        raise BadFile(f"the snapshot is damaged: {type(error).__name__}: {error}", path) from None


def _content(path: str) -> tuple[str, str]:
    """The content after the first line, in base64; or the reason why it cannot be read."""
    try:
        with input_files.opened(path, input_files.LARGEST) as file:
            if file.read(len(MAGIC)) != MAGIC:
                return "", "it is not a snapshot of slidectl"
            return base64.b64encode(file.read()).decode(), ""
    except BadFile as error:
        return "", f"cannot be read: {error.reason}"
    except OSError as error:
        return "", f"cannot be read: {error.strerror or error}"


def _pack_all(snapshot: Snapshot) -> _Packed:
    robots = [
        vars(one)
        | {
            "hulls": [
                [*source, [hull.name, hull.stl] if isinstance(hull, Hull) else hull.reason]
                for source, hull in one.hulls.items()
            ]
        }
        for one in snapshot.robots
    ]
    return _pack(vars(snapshot) | {"robots": robots, "entries": [list(entry) for entry in snapshot.entries]})


def _unpack_all(packed: _Packed) -> Snapshot:
    values = _unpack(packed)
    robots = [
        SpawnedAs(
            **{
                **one,
                "hulls": dict(_hull(*hull) for hull in one["hulls"]),
                # A file of an earlier version does not tell the parameters: then the controllers are loaded again.
                "controllers": [(*each, None)[:3] for each in one["controllers"]],
            }
        )
        for one in values.pop("robots")
    ]
    values["is_from_file"] = True
    values.setdefault("derived", [])  # a file that does not tell them has all parameters as set by clients
    values.setdefault("features", ["faults"])  # a file that does not tell them is of a time with one such feature
    values.setdefault("parts", {"faults": values.pop("faults", [])})
    entries = [SavedObject(*entry) for entry in values.pop("entries")]
    return Snapshot(robots=robots, entries=entries, **values)


def _check(snapshot: Snapshot) -> None:
    """Raise ValueError or UsageError for values that no simulation can have."""
    whole = snapshot.time_ns, snapshot.cycles, snapshot.step_ns - 1
    if not all(type(number) is int and 0 <= number < NEVER for number in whole):
        raise ValueError("its time is not a whole number of ns")
    if len(snapshot.gravity) != 3 or not all(math.isfinite(number) for number in snapshot.gravity):
        raise ValueError("its gravity is not a vector")
    if not isinstance(snapshot.parameters, dict) or not isinstance(snapshot.world, dict):
        raise ValueError("it has no parameters, or no world")
    if not all(type(name) is str and len(name) <= names.LONGEST for name in snapshot.derived):
        raise ValueError("its derived parameters are not names")
    if not all(type(name) is str and len(name) <= names.LONGEST for name in (*snapshot.features, *snapshot.parts)):
        raise ValueError("its features are not names")
    if not all(type(parts) is list for parts in snapshot.parts.values()):
        raise ValueError("a feature has no list of its parts")


def _hull(path: str, scale: tuple[float, float, float], *rest: Any) -> tuple[MeshSource, Hull | BadMesh]:
    *kind, content = rest  # a file of an earlier version does not tell surfaces from hulls
    return MeshSource(path, scale, *kind), BadMesh(content, path) if isinstance(content, str) else Hull(*content)


# -- values ------------------------------------------------------------------------------------------------------------


def _pack(value: Any) -> _Packed:
    """The value for JSON. Numbers, texts, bools, None, lists and dicts with text keys stay; others get a type tag."""
    kind = type(value)
    if kind in (bool, int, float, str, type(None)):
        return value
    if kind is list:
        return [_pack(one) for one in value]
    if isinstance(value, dict):
        if all(type(key) is str for key in value) and _TAG not in value:
            return {key: _pack(one) for key, one in value.items()}
        return {_TAG: "dict", "of": [[_pack(key), _pack(one)] for key, one in value.items()]}
    if isinstance(value, NotSaved):
        return {_TAG: "left"}
    if isinstance(value, Ref | Method | Named):
        return {_TAG: kind.__name__, "of": [_pack(one) for one in value]}
    if isinstance(value, tuple):
        return {_TAG: "tuple", "of": [_pack(one) for one in value]}
    if isinstance(value, bytes):
        return {_TAG: "bytes", "of": base64.b64encode(value).decode()}
    if isinstance(value, np.ndarray | array | memoryview):
        numbers = np.asarray(value)
        packed = base64.b64encode(numbers.tobytes()).decode()
        return {_TAG: "numbers", "of": [numbers.dtype.str, list(numbers.shape), packed]}
    raise Refused(f"no file holds a {kind.__module__}.{kind.__qualname__}")


def _unpack(packed: _Packed) -> Any:
    if isinstance(packed, list):
        return [_unpack(one) for one in packed]
    if not isinstance(packed, dict):
        return packed
    if _TAG not in packed:
        return {key: _unpack(one) for key, one in packed.items()}
    kind = packed[_TAG]
    if kind == "left":
        return NOT_SAVED
    of = packed["of"]
    if kind == "dict":
        return {_unpack(key): _unpack(one) for key, one in of}
    if kind == "tuple":
        return tuple(map(_unpack, of))
    if kind == "bytes":
        return base64.b64decode(of)
    if kind == "numbers":
        dtype, shape, content = of
        return np.frombuffer(base64.b64decode(content), NUMBER_TYPES[dtype]).reshape(shape).copy()
    return {"Ref": Ref, "Method": Method, "Named": Named}[kind](*map(_unpack, of))


# -- the services ------------------------------------------------------------------------------------------------------


class Snapshots(Feature):
    """The snapshots of one simulation, by name, in the order of their saving."""

    MOST: ClassVar[int] = 1000

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._kept: dict[str, Snapshot] = {}
        node = simulation.graph.node(names.OWN_NODE, names.OWN_NODE)
        offers: dict[str, tuple[Effect, str, Handler]] = {
            "save": (Effect.WRITES, "Save", self._save),
            "load": (Effect.WRITES, "Load", self._load),
            "snapshots": (Effect.READS, "ListSnapshots", self._list),
            "delete_snapshots": (Effect.WRITES, "DeleteSnapshots", self._delete_several),
            "export_snapshot": (Effect.FILES, "ExportSnapshot", self._export),
        }
        for name, (effect, kind, handler) in offers.items():
            file_field = "file" if name in ("save", "load") else ""
            node.advertise_service(name, f"slidectl/{kind}", handler, effect, file_field)

    def __iter__(self) -> Iterator[tuple[str, Snapshot]]:
        return iter(tuple(self._kept.items()))

    def get(self, name: str) -> Snapshot:
        """The snapshot. Raises UnknownName."""
        if name not in self._kept:
            raise UnknownName("snapshot", name, list(self._kept))
        return self._kept[name]

    def save(self, name: str, first: Callable[[Snapshot], None] = lambda _: None) -> Snapshot:
        """Save the present state under the name, after `first` was called with it. An older one is replaced.

        Raises as `capture`, the errors of `first`, and BadName; then nothing has changed.
        """
        if not names.is_component(name):
            raise BadName(name, "name of a snapshot: letters, digits and '_', and the first is a letter")
        if len(self._kept) >= self.MOST and name not in self._kept:
            raise Refused(f"there are {self.MOST} snapshots already, the maximum", "slidectl sim delete NAME")
        snapshot = capture(self._simulation)
        first(snapshot)
        self._kept.pop(name, None)
        self._kept[name] = snapshot
        return snapshot

    def load(self, name: str) -> list[str]:
        """Restore a snapshot. Returns the names of the robots spawned again. Raises UnknownName, and as `restore`."""
        return restore(self._simulation, self.get(name))

    def delete(self, name: str) -> None:
        """Delete a snapshot. Raises UnknownName."""
        self.get(name)
        del self._kept[name]

    def _save(self, request: Message) -> Message:
        file = request["file"] and absolute_path(request["file"])
        export = partial(write, path=file, host=self._simulation.host) if file else lambda _: None
        return {"time": self.save(request["name"], export).time_ns / SECOND}

    def _load(self, request: Message) -> Message:
        name, file = request["name"], request["file"]
        if bool(name) == bool(file):
            raise UsageError("give the name of a snapshot that is kept, or a file")
        simulation = self._simulation
        snapshot = self.get(name) if name else read(absolute_path(file), simulation.host)
        made = restore(simulation, snapshot)
        return {"time": simulation.graph.clock.seconds, "robots": made}

    def _list(self, _: Message) -> Message:
        infos = [
            {
                "name": name,
                "time": snapshot.time_ns / SECOND,
                "cycles": snapshot.cycles,
                "robots": [robot.name for robot in snapshot.robots],
            }
            for name, snapshot in self
        ]
        return {"snapshots": infos}

    def _delete_several(self, request: Message) -> Message:
        for name in request["names"]:
            self.get(name)
        for name in dict.fromkeys(request["names"]):
            self.delete(name)
        return {}

    def _export(self, request: Message) -> Message:
        write(self.get(request["name"]), absolute_path(request["file"]), self._simulation.host)
        return {}
