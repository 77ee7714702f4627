"""Reads mesh files as triangles: STL (binary and text), OBJ and DAE, with numpy alone.

trimesh takes a second to import, in each process that reads meshes. All sizes and counts are bounded. Against:
a mesh that was sent, or that a client names. Nothing is downloaded, and materials, textures and normals are not read.

Of a DAE (COLLADA) file the scene counts: its nodes place the geometries. Units are applied; `<up_axis>` is ignored, as
in Gazebo and RViz, for which robots are drawn. Nodes can be instanced repeatedly, so a file of 3 kB can describe 10^12
of them: they are counted when visited.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slidectl import input_files
from slidectl.description import xml_tree
from slidectl.description.inertia import LEAST
from slidectl.description.mesh_files import SUFFIXES
from slidectl.description.robot import Vector
from slidectl.description.xml_tree import Element, below
from slidectl.errors import BadFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_BYTES = 128 * 2**20
"""The largest file in a binary format, bytes."""
_MOST_BYTES_OF_TEXT = 64 * 2**20
"""The largest file in a text format, bytes; reading takes several times its size in memory."""
_MOST_FACES = 2_000_000
_LONGEST_SKIN_CHAIN = 10
_MOST_PARTS = 20_000
"""The most nodes of a scene with their transforms and instances; repeated instances count again."""

_TRANSFORMS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3, "lookat": 9}
"""The transforms of nodes, each with its count of numbers."""
_PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")

_STL_HEADER = 84
_STL_FACET = 50
_LONGEST_NUMBER = 64
"""The most bytes of a number: numpy stores each text of an array at the size of the longest."""
_VERTEX = re.compile(rb"\bvertex\s+(\S{1,64})\s+(\S{1,64})\s+(\S{1,64})(?!\S)", re.IGNORECASE)
_THINNEST = 1e-12
_FARTHEST = 1e12
_SMALLEST_BOX = 100 * LEAST
"""m³. MuJoCo refuses convex hulls with a volume below LEAST."""
FLAT = "it lies in one plane or is too small, and what is flat cannot collide; a thin <box> can"
"""The message for a collision mesh that `is_flat`."""


class BadMesh(BadFile):
    """A mesh file cannot be read or is over a bound; the message names the reason or the bound."""

    def __init__(self, message: str, path: str | Path) -> None:
        super().__init__(message, str(path))


class Triangles(NamedTuple):
    """A triangulated surface."""

    vertices: NDArray[np.float64]
    """Positions (n, 3), m."""
    faces: NDArray[np.int32]
    """Indices of vertices (m, 3), counter-clockwise seen from outside."""


def load(path: str | Path, scale: Vector = (1.0, 1.0, 1.0)) -> Triangles:
    """Read all triangles of a mesh file as one surface, in the file's own frame, scaled by `scale`.

    Raises BadMesh: of no known kind, unreadable, over a bound, or without a triangle.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise BadMesh(f"is not of a known kind of mesh; known: {', '.join(SUFFIXES)}", path)
    content = _content(path)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused below
            if kind == ".stl":
                vertices, faces = _stl(content, path)
            else:
                _check_size(len(content), _MOST_BYTES_OF_TEXT, path)
                vertices, faces = _obj(content, path) if kind == ".obj" else _dae(content, path)
    except (ValueError, IndexError, ArithmeticError) as error:
        raise BadMesh(f"cannot read the mesh: {error}", path) from None
    except RecursionError:
        raise BadMesh("cannot read the mesh: it is nested too deep", path) from None
    except MemoryError:
        raise BadMesh("cannot read the mesh: it needs more memory than is available", path) from None
    if not len(faces):
        raise BadMesh("the mesh has no triangle", path)
    _check_faces(len(faces), path)
    vertices, faces = _used(vertices, faces, path)
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = vertices * np.asarray(scale)
    if not np.isfinite(vertices).all():
        raise BadMesh("the mesh has infinite coordinates", path)
    if np.abs(vertices).max() > _FARTHEST:
        raise BadMesh(f"the mesh has coordinates of more than {_FARTHEST:g} m", path)
    # Mirroring turns triangles inside out; reversing their corners corrects that.
    return Triangles(vertices, faces[:, ::-1].copy() if np.prod(scale) < 0 else faces)


def is_flat(vertices: NDArray[np.float64]) -> bool:
    """True when points lie in a plane (within rounding errors), or their bounding box has almost no volume.

    Each axis is scaled to its own length first, so that the scale of an axis makes nothing flat.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    with np.errstate(over="ignore"):
        if len(vertices) < 4 or float(np.prod(high - low)) < _SMALLEST_BOX:
            return True
    # Halves, because the difference of two finite numbers may overflow.
    spread = (vertices / 2 - low / 2) / (high / 2 - low / 2)
    centred = spread - spread.mean(axis=0)
    # The singular values of the points are the square roots of these eigenvalues, but squares lose digits: a body that
    # is a million times wider than thick needs the exact method.
    spans = np.linalg.eigvalsh(np.dot(centred.T, centred))
    if spans[0] > 1e-10 * spans[2]:
        return False
    exact = np.linalg.svd(centred, compute_uv=False)
    return bool(exact[2] <= _THINNEST * exact[0])


def _check_faces(count: int, path: str | Path) -> None:
    """Raise BadMesh when a mesh has too many triangles."""
    if count > _MOST_FACES:
        raise BadMesh(f"the mesh has {count} triangles, and more than {_MOST_FACES} are refused", path)


def _content(path: Path) -> bytes:
    """The content of a regular file within the size bound."""
    try:
        return input_files.read_bytes(path, _MOST_BYTES)
    except BadFile as error:
        raise BadMesh(error.reason, path) from None


def _check_size(size: int, most: int, path: Path) -> None:
    if size > most:
        raise BadMesh(f"the file has {size / 2**20:.0f} MiB, and more than {most // 2**20} MiB are refused", path)


def _stl(content: bytes, path: Path) -> Triangles:
    """Read STL. It is binary when the size fits the header: some binary files begin with `solid` like the text form."""
    count = int.from_bytes(content[80:_STL_HEADER], "little") if len(content) >= _STL_HEADER else 0
    if count and len(content) == _STL_HEADER + _STL_FACET * count:
        _check_faces(count, path)
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(content, facet, count, _STL_HEADER)["corners"].reshape(-1, 3)
        return _merged(corners.astype(np.float64))
    _check_size(len(content), _MOST_BYTES_OF_TEXT, path)
    if count and not content.lstrip()[:5].lower() == b"solid":
        raise BadMesh(f"cannot read the mesh: {len(content)} bytes are not those of {count} triangles", path)
    found = _VERTEX.findall(content)
    _check_faces(len(found) // 3, path)
    corners = np.array(found, dtype=np.bytes_).astype(np.float64).reshape(-1, 3)
    return _merged(corners[: len(corners) // 3 * 3])


def _merged(corners: NDArray[np.float64]) -> Triangles:
    """Make triangles of three corners each; corners at the same place become one vertex."""
    # Exact equality: comparing rows as wholes takes a tenth of the time of np.unique(axis=0).
    corners = np.ascontiguousarray(corners) + 0.0
    rows = corners.view([("x", "<f8"), ("y", "<f8"), ("z", "<f8")]).ravel()
    _, first, inverse = np.unique(rows, return_index=True, return_inverse=True)
    return Triangles(corners[first], inverse.reshape(-1, 3).astype(np.int32))


def _obj(content: bytes, path: Path) -> Triangles:
    """Read `v` and `f` lines; polygons are split into fans. Negative indices count back from the last vertex."""
    places: list[list[bytes]] = []
    faces: list[tuple[int, int, int]] = []
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            if len(words) < 4:
                raise BadMesh("cannot read the mesh: a vertex has three coordinates", path)
            if max(map(len, words[1:4])) > _LONGEST_NUMBER:
                raise BadMesh(f"cannot read the mesh: a number of more than {_LONGEST_NUMBER} letters", path)
            places.append(words[1:4])
        elif words[0] == b"f":
            corners = [_obj_index(word, len(places)) for word in words[1:]]
            faces += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
            _check_faces(len(faces), path)
    vertices = np.array(places, dtype=np.bytes_).astype(np.float64).reshape(-1, 3)
    return Triangles(vertices, np.array(faces, np.int32).reshape(-1, 3))


def _obj_index(word: bytes, count: int) -> int:
    number = int(word.partition(b"/")[0])
    index = number - 1 if number > 0 else count + number
    if number == 0 or index < 0:
        raise ValueError(f"there is no vertex {number}")
    return index


def _used(vertices: NDArray[np.float64], faces: NDArray[np.int32], path: Path) -> Triangles:
    """Remove vertices that no triangle uses. Raises BadMesh for triangles with indices out of range."""
    if faces.min() < 0 or faces.max() >= len(vertices):
        text = f"a triangle has the vertex {max(faces.max(), -faces.min())} of {len(vertices)}"
        raise BadMesh(f"cannot read the mesh: {text}", path)
    is_used = np.zeros(len(vertices), bool)
    is_used[faces.ravel()] = True
    return Triangles(vertices[is_used], (np.cumsum(is_used) - 1)[faces].astype(np.int32))


# --- DAE -------------------------------------------------------------------------------------------------------------


def _dae(content: bytes, path: Path) -> Triangles:
    """All triangles of the file's scene, in metres.

    Raises BadMesh: not XML, no scene, or over a bound. ValueError: malformed numbers.
    """
    try:
        root = xml_tree.read(content, str(path), _MOST_BYTES_OF_TEXT)
    except BadFile as error:
        raise BadMesh(f"cannot read the mesh: {error.reason}", path) from None
    for element in root.walk():
        element.tag = element.tag.rpartition(":")[2]  # without a namespace prefix
    if root.tag != "COLLADA":
        raise BadMesh(f"cannot read the mesh: the outermost element is <{root.tag}>, expected <COLLADA>", path)
    return _Scene(root, path).triangles()


class _Scene:
    def __init__(self, root: Element, path: Path) -> None:
        self.root = root
        self.path = path
        self.by_id = {element.attributes["id"]: element for element in root.walk() if "id" in element.attributes}
        self.surfaces: dict[int, Triangles] = {}
        """The surface of each geometry, by the id() of its element."""
        self.points_read = 0

    def triangles(self) -> Triangles:
        vertices: list[NDArray[np.float64]] = []
        faces: list[NDArray[np.int32]] = []
        vertex_count = face_count = 0
        for geometry, placed in self._instances():
            surface = self.surfaces.get(id(geometry))
            if surface is None:
                surface = self.surfaces[id(geometry)] = self._read_surface(geometry)
            if not len(surface.faces):
                continue
            face_count += len(surface.faces)
            _check_faces(face_count, self.path)
            vertices.append(surface.vertices @ placed[:3, :3].T + placed[:3, 3])
            turned = surface.faces[:, ::-1] if np.linalg.det(placed[:3, :3]) < 0 else surface.faces
            faces.append(turned + vertex_count)
            vertex_count += len(surface.vertices)
        if not faces:
            raise BadMesh("the mesh has no triangle", self.path)
        return Triangles(np.concatenate(vertices) * self._metres(), np.concatenate(faces).astype(np.int32))

    def _metres(self) -> float:
        """The length of one unit of the file in metres."""
        unit = below(self.root, "asset", "unit")
        metres = float((unit.get("meter") if unit is not None else None) or 1.0)
        if not 0.0 < metres < math.inf:
            raise BadMesh(f"cannot read the mesh: a unit of {metres:g} m", self.path)
        return metres

    def _instances(self) -> Iterator[tuple[Element, NDArray[np.float64]]]:
        """Each instance of a geometry in the scene, with its 4 x 4 placement."""
        count = 0
        scene = below(self.root, "library_visual_scenes", "visual_scene")
        if (instance := below(self.root, "scene", "instance_visual_scene")) is not None:
            scene = self._target(instance, "url")
        if scene is None:
            raise BadMesh("cannot read the mesh: it has no <visual_scene>", self.path)
        pending = [(node, np.eye(4)) for node in reversed(scene.find_all("node"))]
        while pending:
            node, place = pending.pop()
            count += 1 + len(node.children)
            if count > _MOST_PARTS:
                raise BadMesh(f"the scene has more than {_MOST_PARTS} nodes, instances included", self.path)
            inside: list[tuple[Element, NDArray[np.float64]]] = []
            for child in node.children:
                kind = child.tag
                if (placed := _transform(child)) is not None:
                    place = place @ placed
                elif kind == "node":
                    inside.append((child, place))
                elif kind == "instance_node":
                    inside.append((self._target(child, "url"), place))
                elif kind in ("instance_geometry", "instance_controller"):
                    yield self._geometry(child), place
            pending.extend(reversed(inside))

    def _geometry(self, instance: Element) -> Element:
        """The instanced geometry; for a skin or a morph the geometry at rest."""
        target = self._target(instance, "url")
        for _ in range(_LONGEST_SKIN_CHAIN):
            skin = target.find("skin") or target.find("morph")
            if skin is None:
                break
            target = self._target(skin, "source")
        if target.tag != "geometry":
            raise BadMesh(f"cannot read the mesh: {instance.get('url')!r} is not a geometry", self.path)
        return target

    def _target(self, element: Element, attribute: str) -> Element:
        name = (element.get(attribute) or "").removeprefix("#")
        found = self.by_id.get(name)
        if found is None:
            where = f"<{element.tag} {attribute}={element.get(attribute)!r}>"
            raise BadMesh(f"cannot read the mesh: {where} in line {element.line} names nothing in the file", self.path)
        return found

    def _read_surface(self, geometry: Element) -> Triangles:
        mesh = geometry.find("mesh")
        vertices: list[NDArray[np.float64]] = []
        faces: list[NDArray[np.int64]] = []
        starts: dict[int, int] = {}
        total = 0
        for primitive in mesh.children if mesh is not None else ():
            if primitive.tag in _PRIMITIVES and (inputs := primitive.find_all("input")):
                source, offset = self._positions(primitive, inputs)
                if id(source) not in starts:
                    starts[id(source)] = total
                    vertices.append(self._points(source))
                    total += len(vertices[-1])
                    # Many geometries may share one long list of points, and each makes its own copy.
                    self.points_read += len(vertices[-1])
                    if self.points_read > 3 * _MOST_FACES:
                        raise BadMesh(f"the mesh has more than {3 * _MOST_FACES} vertices", self.path)
                offsets = [int(entry.get("offset") or 0) for entry in inputs]
                if min(offsets) < 0:
                    text = f"line {primitive.line} has an input of offset {min(offsets)}"
                    raise BadMesh(f"cannot read the mesh: {text}", self.path)
                stride = 1 + max(offsets)
                corners = _corners(primitive, offset, stride)
                if len(corners) and not 0 <= corners.min() <= corners.max() < total - starts[id(source)]:
                    text = f"line {primitive.line} uses vertices that do not exist"
                    raise BadMesh(f"cannot read the mesh: {text}", self.path)
                faces.append(corners + starts[id(source)])
                _check_faces(sum(map(len, faces)), self.path)
        if not faces:
            return Triangles(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
        every = np.concatenate(faces).astype(np.int32)
        return _used(np.concatenate(vertices), every, self.path) if len(every) else Triangles(np.zeros((0, 3)), every)

    def _positions(self, primitive: Element, inputs: list[Element]) -> tuple[Element, int]:
        """The source of a primitive's vertex positions, and the offset of their index within a corner's indices."""
        for entry in inputs:
            if entry.get("semantic") == "VERTEX":
                for inner in self._target(entry, "source").find_all("input"):
                    if inner.get("semantic") == "POSITION":
                        return self._target(inner, "source"), int(entry.get("offset") or 0)
        raise BadMesh(f"cannot read the mesh: line {primitive.line} has no positions", self.path)

    def _points(self, source: Element) -> NDArray[np.float64]:
        array = source.find("float_array")
        accessor = below(source, "technique_common", "accessor")
        if accessor is not None and (accessor.get("source") or "").removeprefix("#") in self.by_id:
            array = self._target(accessor, "source")
        if array is None:
            raise BadMesh(f"cannot read the mesh: line {source.line} has no <float_array>", self.path)
        numbers = _floats(array)
        layout = accessor.attributes if accessor is not None else {}
        stride, offset = int(layout.get("stride") or 3), int(layout.get("offset") or 0)
        if stride < 3:
            raise BadMesh(f"cannot read the mesh: line {source.line} has points of {stride} numbers", self.path)
        if offset < 0:
            raise BadMesh(f"cannot read the mesh: line {source.line} has points of offset {offset}", self.path)
        numbers = numbers[offset:]
        return numbers[: len(numbers) // stride * stride].reshape(-1, stride)[:, :3]


def _corners(primitive: Element, offset: int, stride: int) -> NDArray[np.int64]:
    """The triangles as indices of positions (n, 3); polygons are split into fans, and their holes are filled."""
    kind = primitive.tag
    holed = [inner for outer in primitive.find_all("ph") for inner in outer.find_all("p")]
    rows = [np.zeros(0, np.int64)]
    for text in primitive.find_all("p") + holed:
        numbers = _integers(text)
        rows.append(numbers[: len(numbers) // stride * stride].reshape(-1, stride)[:, offset])
    if kind == "triangles":
        return np.concatenate([row[: len(row) // 3 * 3] for row in rows]).reshape(-1, 3)
    if kind == "tristrips":
        strips = [np.stack([row[:-2], row[1:-1], row[2:]], axis=1) for row in rows if len(row) > 2]
        for strip in strips:
            strip[1::2] = strip[1::2, ::-1]
        return np.concatenate([np.zeros((0, 3), np.int64), *strips])
    counts = primitive.find("vcount")
    if kind != "polylist":
        sizes = np.array([len(row) for row in rows], np.int64)
    else:
        sizes = _integers(counts) if counts is not None else np.zeros(0, np.int64)
    return _fans(np.concatenate(rows), sizes)


def _fans(corners: NDArray[np.int64], sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Split polygons of `sizes` corners into triangles around their first corners. Raises ValueError."""
    if len(sizes) and (sizes.min() < 0 or sizes.max() > len(corners) or sizes.sum() > len(corners)):
        raise ValueError(f"{len(sizes)} polygons do not fit the {len(corners)} corners that are there")
    counts = np.maximum(sizes - 2, 0)
    starts = np.repeat(np.cumsum(sizes) - sizes, counts)
    steps = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([corners[starts], corners[starts + steps + 1], corners[starts + steps + 2]], axis=1)


def _floats(element: Element) -> NDArray[np.float64]:
    return np.array(element.text.replace(",", " ").split(), dtype=np.float64)


def _integers(element: Element) -> NDArray[np.int64]:
    return np.array(element.text.split(), dtype=np.int64)


def _transform(element: Element) -> NDArray[np.float64] | None:
    """The 4 x 4 matrix of a node's transform; None for other elements. Raises ValueError: wrong count of numbers."""
    kind = element.tag
    if kind not in _TRANSFORMS:
        return None
    numbers = _floats(element)
    if len(numbers) != _TRANSFORMS[kind]:
        found = f"{len(numbers)} numbers instead of {_TRANSFORMS[kind]}"
        raise ValueError(f"<{element.tag}> in line {element.line} has {found}")
    if kind == "matrix":
        return numbers.reshape(4, 4)
    if kind == "scale":
        return np.diag([*numbers, 1.0])
    placed = np.eye(4)
    if kind == "translate":
        placed[:3, 3] = numbers
    elif kind == "rotate":
        # An axis and an angle in degrees (Rodrigues' formula).
        length = float(np.linalg.norm(numbers[:3]))
        if length > 0.0:
            x, y, z = numbers[:3] / length
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            angle = math.radians(numbers[3])
            placed[:3, :3] += math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    else:
        # The eye point, the point that it looks at (-z), and the up direction (y).
        eye, interest, up = numbers.reshape(3, 3)
        back = eye - interest
        side = np.cross(up, back)
        axes = np.stack([side, np.cross(back, side), back], axis=1)
        lengths = np.linalg.norm(axes, axis=0)
        if lengths.min() == 0.0:
            raise ValueError(f"<{element.tag}> in line {element.line} has no direction")
        placed[:3, :3] = axes / lengths
        placed[:3, 3] = eye
    return placed
