"""The scene of a DAE (COLLADA) file as one surface: geometries where the nodes of the scene put them.

Units count, `<up_axis>` does not: Gazebo and RViz pay no heed to it, and robots are drawn for them. Nodes may be
instanced again and again, so a file of 3 kB can ask for a million million of them: they are counted when visited.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slidectl.description import xml_tree
from slidectl.description.meshes import MOST_BYTES_OF_TEXT, MOST_FACES, BadMesh, Triangles, check_faces, used
from slidectl.description.xml_tree import Comment, Element
from slidectl.errors import BadFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

MOST_PARTS = 20_000
"""Nodes of the scene with their transforms and instances, each counted as often as its node is instanced."""
DEEPEST = 100
"""Nodes within nodes."""

_TRANSFORMS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3, "lookat": 9}
"""The transforms of nodes, and how many numbers each has."""
_PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")


def read(content: bytes, path: Path) -> Triangles:
    """All triangles of the file's scene, in metres.

    Raises:
        BadMesh: no XML, no scene, over a bound. ValueError: numbers that are none.
    """
    try:
        root = xml_tree.read(content, str(path), MOST_BYTES_OF_TEXT)
    except BadFile as error:
        raise BadMesh(f"cannot read the mesh: {error.reason}", path) from None
    if _kind(root) != "COLLADA":
        raise BadMesh(f"cannot read the mesh: the outermost element is <{root.tag}>, expected <COLLADA>", path)
    return _Scene(root, path).triangles()


class _Scene:
    def __init__(self, root: Element, path: Path) -> None:
        self.root = root
        self.path = path
        self.by_id = {element.attributes["id"]: element for element in root.walk() if "id" in element.attributes}
        self.surfaces: dict[int, Triangles] = {}
        """Of each geometry, by the identity of its element."""
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
            check_faces(face_count, self.path)
            vertices.append(surface.vertices @ placed[:3, :3].T + placed[:3, 3])
            turned = surface.faces[:, ::-1] if np.linalg.det(placed[:3, :3]) < 0 else surface.faces
            faces.append(turned + vertex_count)
            vertex_count += len(surface.vertices)
        if not faces:
            raise BadMesh("the mesh has no triangle", self.path)
        return Triangles(np.concatenate(vertices) * self._metres(), np.concatenate(faces).astype(np.int32))

    def _metres(self) -> float:
        """What one unit of the file is in metres."""
        asset = _child(self.root, "asset")
        unit = _child(asset, "unit") if asset is not None else None
        metres = float((unit.get("meter") if unit is not None else None) or 1.0)
        if not 0.0 < metres < math.inf:
            raise BadMesh(f"cannot read the mesh: a unit of {metres:g} m", self.path)
        return metres

    def _instances(self) -> Iterator[tuple[Element, NDArray[np.float64]]]:
        """Each geometry of the scene, as often as it is there, with its place."""
        count = 0
        waiting = [(node, np.eye(4), 0) for node in reversed(self._top_nodes())]
        while waiting:
            node, place, depth = waiting.pop()
            count += 1 + len(node.children)
            if count > MOST_PARTS:
                raise BadMesh(f"the scene has more than {MOST_PARTS} nodes, instances included", self.path)
            if depth > DEEPEST:
                raise BadMesh(f"the nodes of the scene are nested deeper than {DEEPEST}", self.path)
            below: list[tuple[Element, NDArray[np.float64], int]] = []
            for child in node.children:
                kind = _kind(child)
                if (placed := _transform(child)) is not None:
                    place = place @ placed
                elif kind == "node":
                    below.append((child, place, depth + 1))
                elif kind == "instance_node":
                    below.append((self._target(child, "url"), place, depth + 1))
                elif kind in ("instance_geometry", "instance_controller"):
                    yield self._geometry(child), place
            waiting.extend(reversed(below))

    def _top_nodes(self) -> list[Element]:
        scene = _child(self.root, "scene")
        instance = _child(scene, "instance_visual_scene") if scene is not None else None
        if instance is not None:
            shown: Element | None = self._target(instance, "url")
        else:
            library = _child(self.root, "library_visual_scenes")
            shown = _child(library, "visual_scene") if library is not None else None
        if shown is None:
            raise BadMesh("cannot read the mesh: it has no <visual_scene>", self.path)
        return _children(shown, "node")

    def _geometry(self, instance: Element) -> Element:
        """The geometry that is instanced; that of a skin or a morph as it is drawn at rest."""
        target = self._target(instance, "url")
        for _ in range(DEEPEST):
            if _kind(target) == "geometry":
                return target
            skin = _child(target, "skin") or _child(target, "morph")
            if skin is None:
                break
            target = self._target(skin, "source")
        raise BadMesh(f"cannot read the mesh: {instance.get('url')!r} is no geometry", self.path)

    def _target(self, element: Element, attribute: str) -> Element:
        name = (element.get(attribute) or "").removeprefix("#")
        found = self.by_id.get(name)
        if found is None:
            where = f"<{element.tag} {attribute}={element.get(attribute)!r}>"
            raise BadMesh(f"cannot read the mesh: {where} in line {element.line} names nothing in the file", self.path)
        return found

    def _read_surface(self, geometry: Element) -> Triangles:
        mesh = _child(geometry, "mesh")
        vertices: list[NDArray[np.float64]] = []
        faces: list[NDArray[np.int64]] = []
        starts: dict[int, int] = {}
        total = 0
        for primitive in mesh.children if mesh is not None else ():
            if _kind(primitive) in _PRIMITIVES and (inputs := _children(primitive, "input")):
                source, offset = self._positions(primitive, inputs)
                if id(source) not in starts:
                    starts[id(source)] = total
                    vertices.append(self._points(source))
                    total += len(vertices[-1])
                    # Many geometries may share one long list of points, and each would have a copy of it.
                    self.points_read += len(vertices[-1])
                    if self.points_read > 3 * MOST_FACES:
                        raise BadMesh(f"the mesh has more than {3 * MOST_FACES} vertices", self.path)
                stride = 1 + max(int(entry.get("offset") or 0) for entry in inputs)
                corners = _corners(primitive, offset, stride)
                if len(corners) and not 0 <= corners.min() <= corners.max() < total - starts[id(source)]:
                    raise BadMesh(f"cannot read the mesh: line {primitive.line} uses vertices that are none", self.path)
                faces.append(corners + starts[id(source)])
                check_faces(sum(map(len, faces)), self.path)
        if not faces:
            return Triangles(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
        every = np.concatenate(faces).astype(np.int32)
        return used(np.concatenate(vertices), every, self.path) if len(every) else Triangles(np.zeros((0, 3)), every)

    def _positions(self, primitive: Element, inputs: list[Element]) -> tuple[Element, int]:
        """The source of the positions of a primitive's corners, and where their indices are among those of a corner."""
        for entry in inputs:
            if entry.get("semantic") == "VERTEX":
                for inner in _children(self._target(entry, "source"), "input"):
                    if inner.get("semantic") == "POSITION":
                        return self._target(inner, "source"), int(entry.get("offset") or 0)
        raise BadMesh(f"cannot read the mesh: line {primitive.line} has no positions", self.path)

    def _points(self, source: Element) -> NDArray[np.float64]:
        array = _child(source, "float_array")
        common = _child(source, "technique_common")
        accessor = _child(common, "accessor") if common is not None else None
        if accessor is not None and (accessor.get("source") or "").removeprefix("#") in self.by_id:
            array = self._target(accessor, "source")
        if array is None:
            raise BadMesh(f"cannot read the mesh: line {source.line} has no <float_array>", self.path)
        numbers = _floats(array)
        stride = int((accessor.get("stride") if accessor is not None else None) or 3)
        offset = int((accessor.get("offset") if accessor is not None else None) or 0)
        if stride < 3 or offset < 0:
            raise BadMesh(f"cannot read the mesh: line {source.line} has points of {stride} numbers", self.path)
        numbers = numbers[offset:]
        return numbers[: len(numbers) // stride * stride].reshape(-1, stride)[:, :3]


def _corners(primitive: Element, offset: int, stride: int) -> NDArray[np.int64]:
    """Triangles, as indices of positions; polygons are cut into fans, and their holes are filled."""
    kind = _kind(primitive)
    holed = [inner for outer in _children(primitive, "ph") for inner in _children(outer, "p")]
    rows = [np.zeros(0, np.int64)]
    for text in _children(primitive, "p") + holed:
        numbers = _integers(text)
        rows.append(numbers[: len(numbers) // stride * stride].reshape(-1, stride)[:, offset])
    if kind == "triangles":
        return np.concatenate([row[: len(row) // 3 * 3] for row in rows]).reshape(-1, 3)
    if kind == "tristrips":
        strips = [np.stack([row[:-2], row[1:-1], row[2:]], axis=1) for row in rows if len(row) > 2]
        for strip in strips:
            strip[1::2] = strip[1::2, ::-1]
        return np.concatenate([np.zeros((0, 3), np.int64), *strips])
    counts = _child(primitive, "vcount")
    if kind != "polylist":
        sizes = np.array([len(row) for row in rows], np.int64)
    else:
        sizes = _integers(counts) if counts is not None else np.zeros(0, np.int64)
    return _fans(np.concatenate(rows), sizes)


def _fans(corners: NDArray[np.int64], sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Each polygon of so many corners as triangles that all have its first. Raises ValueError: too few corners."""
    if len(sizes) and (sizes.min() < 0 or sizes.max() > len(corners) or sizes.sum() > len(corners)):
        raise ValueError(f"{len(sizes)} polygons have not the {len(corners)} corners that are there")
    counts = np.maximum(sizes - 2, 0)
    starts = np.repeat(np.cumsum(sizes) - sizes, counts)
    steps = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([corners[starts], corners[starts + steps + 1], corners[starts + steps + 2]], axis=1)


def _kind(element: Element) -> str:
    """The tag without its namespace's prefix."""
    return element.tag.rpartition(":")[2]


def _children(element: Element, kind: str) -> list[Element]:
    return [child for child in element.children if _kind(child) == kind]


def _child(element: Element, kind: str) -> Element | None:
    return next((child for child in element.children if _kind(child) == kind), None)


def _text(element: Element) -> str:
    return "".join(node for node in element.content if isinstance(node, str) and not isinstance(node, Comment))


def _floats(element: Element) -> NDArray[np.float64]:
    return np.array(_text(element).replace(",", " ").split(), dtype=np.float64)


def _integers(element: Element) -> NDArray[np.int64]:
    return np.array(_text(element).split(), dtype=np.int64)


def _transform(element: Element) -> NDArray[np.float64] | None:
    """The 4 x 4 matrix of a node's transform; None of other elements. Raises ValueError for numbers too few or many."""
    kind = _kind(element)
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
        # About an axis by an angle in degrees: the formula of Rodrigues.
        length = float(np.linalg.norm(numbers[:3]))
        if length > 0.0:
            x, y, z = numbers[:3] / length
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            angle = math.radians(numbers[3])
            placed[:3, :3] += math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    else:
        # An eye, where it looks (-z) and what is up (y).
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
