"""Splits a mesh that is fixed to the world into thin convex pieces along its faces, so that its hollows stay hollow.

MuJoCo collides meshes as convex hulls: a table, a shelf, a room or a valley would be filled. A convex solid in the mesh
is one piece. Of the other faces, those in one plane that are convex together make one thin piece: in a solid it lies
behind its face, up to the opposite face; a face of an open surface lies in the middle of its piece.

The pieces of a mesh are one binary STL file, in which the attribute of a triangle is the number of its piece. Positions
are in m. Nothing here knows MuJoCo.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from slidectl.description.meshes import Triangles, is_flat
from slidectl.rotations import perpendicular

Array = np.ndarray[Any, np.dtype[Any]]

MOST_FACES = 20_000
"""The most triangles of a mesh that is split."""
MOST_PIECES = 4_000
"""The most pieces of a mesh. While a robot is added to their world, it stands for 0.2 s."""
MOST_TRIANGLES = 40_000
"""The most triangles of all pieces of a mesh."""
THICKEST = 0.02
"""Thickness of a piece of a solid, m: less where the solid is thinner."""
THINNEST = 1e-4
THICKNESS_OF_SHEETS = 0.004
"""Thickness of a piece of an open surface, m: its face is in the middle."""

_MARK = b"slidectl pieces"
_HEADER = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("piece", "<u2")])
_SAME_PLACE = 1e-6
"""Vertices that are closer to each other than this part of the mesh's size are one."""
_SMALLEST_AREA = 1e-10
"""m²; smaller triangles are left out."""
_SAME_PLANE = 1.0 - 1e-6
"""Cosine of the angle between faces that are in one plane."""
_SAME_AREA = 1e-4
_CONVEX = 1e-5
"""How far a corner of a convex solid may be outside of a face, as a part of the solid's size."""
_MOST_COMPARED = 4_000_000
"""The most pairs of a face and a corner that are compared to see whether a solid is convex."""
_INSIDE = 0.1
"""How far a corner is moved towards the middle of its face before the thickness is measured there."""


class _Facet(NamedTuple):
    """A convex polygon in one plane."""

    corners: Array
    """n x 3, counter-clockwise seen from the side of the normal."""
    normal: Array
    is_of_solid: bool


def split(mesh: Triangles) -> list[Array] | None:
    """The pieces, each as triangles (n x 3 x 3) of a closed convex surface; None when there would be too many."""
    if len(mesh.faces) > MOST_FACES:
        return None
    vertices, faces = _welded(mesh)
    if not len(faces):
        return None
    neighbours, faces, solid = _solids(vertices, faces)
    corners = vertices[faces]
    normals, areas = _normals(corners)
    pieces = []
    is_left = np.ones(len(faces), bool)
    for number in np.unique(solid[solid >= 0]):
        inside = solid == number
        if _is_convex(corners[inside], normals[inside]):
            pieces.append(corners[inside])
            is_left[inside] = False
    pairs = [
        (first, second)
        for first, second in neighbours
        if is_left[first] and float(normals[first] @ normals[second]) > _SAME_PLANE
    ]
    facets = [
        _Facet(polygon, normals[face], bool(solid[face] >= 0))
        for face, polygon in _polygons(corners, normals, areas, pairs, is_left)
    ]
    triangles = sum(map(len, pieces)) + sum(4 * len(facet.corners) - 4 for facet in facets)
    if len(pieces) + len(facets) > MOST_PIECES or triangles > MOST_TRIANGLES:
        return None
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    pieces += [_prism(facet, corners, lows, highs) for facet in facets]
    # Far from the origin, the single precision of the file makes the thinnest pieces flat.
    return [
        piece for piece in pieces if not is_flat(piece.astype(np.float32).astype(np.float64).reshape(-1, 3))
    ] or None


def encoded(pieces: Sequence[Array]) -> bytes:
    """The pieces as one STL file."""
    return written(zip(pieces, range(len(pieces)), strict=True), _MARK)


def decoded(stl: bytes) -> list[bytes]:
    """The pieces of a file that `encoded` has made, each as a file of its own; the file itself for any other."""
    if not stl.startswith(_MARK):
        return [stl]
    facets = _facets(stl)
    starts = np.flatnonzero(np.diff(facets["piece"])) + 1
    return [written([(piece["corners"], 0)]) for piece in np.split(facets, starts)]


def corners(stl: bytes) -> Array:
    """The corners of all triangles of a file (n x 3)."""
    return _facets(stl)["corners"].reshape(-1, 3).astype(np.float64)


def _facets(stl: bytes) -> Array:
    return np.frombuffer(stl, _FACET, offset=_HEADER)


def written(pieces: Iterable[tuple[Array, int]], mark: bytes = b"") -> bytes:
    """A binary STL file of triangles (n x 3 x 3), each with the number of its piece; `mark` begins its header."""
    parts = []
    for triangles, number in pieces:
        facets = np.zeros(len(triangles), _FACET)
        facets["corners"], facets["piece"] = triangles, number
        parts.append(facets.tobytes())
    content = b"".join(parts)
    return mark.ljust(80, b"\0") + (len(content) // _FACET.itemsize).to_bytes(4, "little") + content


def _volume(triangles: Array) -> float:
    """The signed volume inside a closed surface (n x 3 x 3), m³; positive when it is oriented outwards."""
    return float(np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2]))) / 6.0


# --- faces -----------------------------------------------------------------------------------------------------------


def _welded(mesh: Triangles) -> tuple[Array, Array]:
    """Vertices at different places, and the triangles that have an area, each once."""
    vertices = np.asarray(mesh.vertices)
    size = float((vertices.max(axis=0) - vertices.min(axis=0)).max()) or 1.0
    _, first, place = np.unique(
        np.round(vertices / (size * _SAME_PLACE)).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    faces = place.reshape(-1)[mesh.faces]
    vertices = vertices[first]
    faces = faces[_normals(vertices[faces])[1] > _SMALLEST_AREA]
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return vertices, faces[np.sort(once)]


def _normals(corners: Array) -> tuple[Array, Array]:
    """The unit normals and the areas of triangles."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(across, axis=1)
    return across / np.maximum(lengths, 1e-300)[:, None], lengths / 2.0


def _solids(vertices: Array, faces: Array) -> tuple[list[tuple[int, int]], Array, Array]:
    """The pairs of faces with a common edge that no third one has; the faces; the solid of each face, else -1.

    The faces of each solid are returned with their normals outwards.
    """
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    _, edge, counts = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    order = np.argsort(edge, kind="stable")
    shared = (np.cumsum(counts) - counts)[counts == 2]
    first, second = order[shared], order[shared + 1]
    pairs = list(zip((first // 3).tolist(), (second // 3).tolist(), strict=True))
    component = _components(len(faces), pairs)
    # A solid is closed, and its faces agree on what is outside: they run along an edge in opposite directions.
    is_open = np.zeros(len(faces), bool)
    is_open[np.flatnonzero(counts[edge] != 2) // 3] = True
    is_open[first[edges[first, 0] == edges[second, 0]] // 3] = True
    solid = np.where(np.isin(component, component[is_open]), -1, component)
    turned = faces.copy()
    for number in np.unique(solid[solid >= 0]):
        inside = solid == number
        if is_flat(vertices[np.unique(faces[inside])]):
            solid[inside] = -1
        elif _volume(vertices[faces[inside]]) < 0.0:
            turned[inside] = faces[inside, ::-1]
    return pairs, turned, solid


def _is_convex(corners: Array, normals: Array) -> bool:
    """True when no corner of a solid (n x 3 x 3) is outside of one of its faces."""
    points = np.unique(corners.reshape(-1, 3), axis=0)
    if len(points) * len(corners) > _MOST_COMPARED:
        return False
    outside = points @ normals.T - np.einsum("ij,ij->i", corners[:, 0], normals)
    return float(outside.max()) <= _CONVEX * float((points.max(axis=0) - points.min(axis=0)).max())


def _components(count: int, pairs: Iterable[tuple[int, int]]) -> Array:
    """The number of the connected component of each of `count` things."""
    parents = list(range(count))
    for first, second in pairs:
        first, second = _root(parents, first), _root(parents, second)
        parents[max(first, second)] = min(first, second)
    return np.array([_root(parents, one) for one in range(count)])


def _root(parents: list[int], one: int) -> int:
    while parents[one] != one:
        parents[one] = one = parents[parents[one]]
    return one


# --- polygons --------------------------------------------------------------------------------------------------------


def _polygons(
    corners: Array, normals: Array, areas: Array, pairs: Sequence[tuple[int, int]], is_left: Array
) -> Iterable[tuple[int, Array]]:
    """Convex polygons that the triangles that are left make: a face of each, and its corners (n x 3).

    `pairs` are neighbours in one plane. All of a plane are taken together where that is convex, else one by one.
    """
    together = _components(len(corners), pairs)
    members: dict[int, list[int]] = {}
    for face in np.flatnonzero(is_left).tolist():
        members.setdefault(int(together[face]), []).append(face)
    inner: dict[int, list[tuple[int, int]]] = {}
    for pair in pairs:
        inner.setdefault(int(together[pair[0]]), []).append(pair)
    for group, faces in members.items():
        axes = np.array(perpendicular(tuple(normals[group].tolist())))
        flat = corners[faces] @ axes.T
        whole = _convex(flat.reshape(-1, 2), float(areas[faces].sum()))
        if whole is not None:
            yield group, corners[faces].reshape(-1, 3)[whole]
            continue
        yield from _merged(faces, corners, areas, axes, inner[group])


def _merged(
    faces: list[int], corners: Array, areas: Array, axes: Array, pairs: list[tuple[int, int]]
) -> Iterable[tuple[int, Array]]:
    """Join neighbours of one plane to convex polygons, as long as two make one."""
    points = {face: corners[face] for face in faces}
    area = {face: float(areas[face]) for face in faces}
    parents = dict(zip(faces, faces, strict=True))

    def root(face: int) -> int:
        while parents[face] != face:
            face = parents[face]
        return face

    goes_on = True
    while goes_on:
        goes_on = False
        for one, other in pairs:
            first, second = root(one), root(other)
            if first == second:
                continue
            both = np.concatenate([points[first], points[second]])
            outline = _convex(both @ axes.T, area[first] + area[second])
            if outline is not None:
                parents[second] = first
                points[first], area[first] = both[outline], area[first] + area.pop(second)
                del points[second]
                goes_on = True
    yield from points.items()


def _convex(flat: Array, area: float) -> list[int] | None:
    """Indices of the corners of the convex hull of points (n x 2), when it has this area, m²; else None."""
    outline = _outline(flat)
    x, y = flat[outline].T
    found = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    return outline if found <= area * (1.0 + _SAME_AREA) else None


def _outline(flat: Array) -> list[int]:
    """Indices of the corners of the convex hull of points (n x 2), counter-clockwise (Andrew's monotone chain)."""
    points = flat.tolist()
    order = sorted(range(len(points)), key=points.__getitem__)
    halves: list[list[int]] = []
    for indices in (order, order[::-1]):
        half: list[int] = []
        for index in indices:
            x, y = points[index]
            while len(half) > 1:
                (ax, ay), (bx, by) = points[half[-2]], points[half[-1]]
                along = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
                if along > 1e-9 * (abs(bx - ax) + abs(by - ay)) * (abs(x - ax) + abs(y - ay)):
                    break
                half.pop()
            half.append(index)
        halves.append(half[:-1])
    return halves[0] + halves[1]


# --- pieces ----------------------------------------------------------------------------------------------------------


def _prism(facet: _Facet, corners: Array, lows: Array, highs: Array) -> Array:
    """The triangles (n x 3 x 3) of the piece; `corners`, `lows` and `highs` are of all faces of the mesh."""
    shift = facet.normal * (0.0 if facet.is_of_solid else THICKNESS_OF_SHEETS / 2.0)
    depth = _depth(facet, corners, lows, highs) if facet.is_of_solid else THICKNESS_OF_SHEETS
    top = facet.corners + shift
    bottom = top - depth * facet.normal
    following, below = np.roll(top, -1, axis=0), np.roll(bottom, -1, axis=0)
    fans = [
        np.stack([np.broadcast_to(first, rest[1:-1].shape), rest[1:-1], rest[2:]], axis=1)
        for first, rest in ((top[0], top), (bottom[-1], bottom[::-1]))
    ]
    sides = [np.stack([top, bottom, following], axis=1), np.stack([following, bottom, below], axis=1)]
    return np.concatenate([*fans, *sides])


def _depth(facet: _Facet, corners: Array, lows: Array, highs: Array) -> float:
    """How far the solid goes behind a facet, THICKEST at most, m: the least way to the faces on the other side."""
    inward = -facet.normal
    probes = facet.corners + _INSIDE * (facet.corners.mean(axis=0) - facet.corners)
    probes = np.concatenate([probes, facet.corners.mean(axis=0)[None]])
    ends = np.concatenate([facet.corners, facet.corners + THICKEST * inward])
    near = np.flatnonzero((lows <= ends.max(axis=0)).all(axis=1) & (highs >= ends.min(axis=0)).all(axis=1))
    # Where a ray from each probe meets each of these triangles (Möller and Trumbore).
    start = corners[near, 0]
    one, other = corners[near, 1] - start, corners[near, 2] - start
    across = np.cross(inward, other)
    scale = np.einsum("ij,ij->i", one, across)
    is_met = np.abs(scale) > 1e-14
    start, one, other, across, scale = start[is_met], one[is_met], other[is_met], across[is_met], scale[is_met]
    away = probes[:, None] - start
    u = np.einsum("pij,ij->pi", away, across) / scale
    turned = np.cross(away, one)
    v = turned @ inward / scale
    way = np.einsum("pij,ij->pi", turned, other) / scale
    hits = way[(u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (way > THINNEST / 10.0) & (way < THICKEST)]
    return max(float(hits.min()), THINNEST) if hits.size else THICKEST
