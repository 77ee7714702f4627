"""Meshes for collision: read from their files, and reduced to their convex hulls, or to pieces of their surfaces.

Time and memory depend on the file, so a driver does this in another process. The result is small, and the file is not
needed afterwards. The `Hulls` of a robot are passed to the world with it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import mujoco
import numpy as np

from slidectl.description import meshes
from slidectl.description.meshes import BadMesh, Triangles
from slidectl.description.rigid_bodies import surroundings
from slidectl.description.robot import Mesh, Robot
from slidectl.physics import mujoco_library, surfaces
from slidectl.rotations import Vector

MOST_VERTICES = 1000
"""Largest number of vertices of a hull. MuJoCo adds points one by one, the farthest first, and stops at this number: a
ball's hull lacks 0.2 % of the radius. A hull of 10 000 takes 0.3 s to prepare, during which the world would stop."""

_STOPGAP = b"slidectl hull"
"""The beginning of the file of a hull that `fills_hollows`."""


class MeshSource(NamedTuple):
    """A mesh file, with the scale at which a robot uses it."""

    path: str
    scale: Vector
    is_surface: bool = False
    """True when it collides as its faces: the mesh of a link of the surroundings."""


class Hull(NamedTuple):
    """A convex hull, or several that make up a surface, in m."""

    name: str
    """The hash of the content, with the suffix of the file type."""
    stl: bytes
    """The surface as the content of a binary STL file; of several hulls as `surfaces.encoded` has them."""

    @property
    def parts(self) -> list[Hull]:
        """The convex hulls, each by itself."""
        parts = surfaces.decoded(self.stl)
        return [self] if len(parts) == 1 else list(map(hull_of, parts))

    @property
    def fills_hollows(self) -> bool:
        """True for the hull of a mesh that should collide as its faces, and has too many."""
        return self.stl.startswith(_STOPGAP)


Hulls = Mapping[MeshSource, Hull | BadMesh]
"""The hull of each mesh of a robot, or the error."""


def source_of(mesh: Mesh, is_surface: bool) -> MeshSource:
    """The file and the scale of a mesh. Its file must have been found. `is_surface` is as in MeshSource."""
    assert mesh.path is not None
    return MeshSource(mesh.path, mesh.scale, is_surface)


def sources(robot: Robot) -> list[MeshSource]:
    """The collision meshes of a robot, each once, in the order of the file."""
    around = surroundings(robot)
    shapes = [(shape.geometry, link.name in around) for link in robot.links.values() for shape in link.collisions]
    found = (source_of(mesh, is_surface) for mesh, is_surface in shapes if isinstance(mesh, Mesh) and mesh.path)
    return list(dict.fromkeys(found))


def read_all(robot: Robot) -> Hulls:
    """Read the hulls of a robot's meshes, in this process."""
    return {source: read(source) for source in sources(robot)}


def read(source: MeshSource) -> Hull | BadMesh:
    """Read the hull or the surface of one mesh file. Returns the error if there is none."""
    try:
        mesh = meshes.load(source.path, source.scale)
        return _surface(mesh, source) if source.is_surface else _hull_of_points(mesh.vertices, source)
    except BadMesh as error:
        return error
    except MemoryError:
        return BadMesh("its hull needs more memory than is available", source.path)


def prepare(hull: Hull) -> None:
    """Let MuJoCo compute and cache its data of one convex hull, so that the compilation of a world is fast."""
    with suppress(ValueError, mujoco.FatalError):  # the compilation of the world raises it, with the robot's name
        _compile([hull])


def _compile(hulls: Sequence[Hull]) -> None:
    """Compile a world of convex hulls. Raises ValueError or mujoco.FatalError."""
    spec = _alone()
    for number, hull in enumerate(hulls):
        spec.assets[hull.name] = hull.stl
        _add_geom(spec, spec.add_mesh(name=f"mesh{number}", file=hull.name))
    with mujoco_library.warnings_kept():
        spec.compile()


def _surface(mesh: Triangles, source: MeshSource) -> Hull:
    """The pieces of a surface; its hull when it is convex, or has too many pieces. Raises BadMesh."""
    pieces = surfaces.split(mesh)
    if pieces is not None and len(pieces) > 1:
        surface = hull_of(surfaces.encoded(pieces))
        with suppress(ValueError, mujoco.FatalError):
            _compile(surface.parts)
            return surface
    if pieces is not None and meshes.is_flat(mesh.vertices):
        return hull_of(_stl(pieces[0]))
    hull = _hull_of_points(mesh.vertices, source)
    return hull if pieces is not None and len(pieces) == 1 else hull_of(_STOPGAP + hull.stl[len(_STOPGAP) :])


def _hull_of_points(vertices: np.ndarray[Any, np.dtype[np.float64]], source: MeshSource) -> Hull:
    """The convex hull of the vertices (n x 3) of a mesh. Raises BadMesh."""
    if meshes.is_flat(vertices):
        raise BadMesh(meshes.FLAT, source.path)
    spec = _alone()
    mesh = spec.add_mesh(name="mesh", uservert=vertices.ravel(), maxhullvert=MOST_VERTICES)
    _add_geom(spec, mesh)
    try:
        with mujoco_library.warnings_kept():
            graph = spec.compile().mesh_graph
    except (ValueError, mujoco.FatalError) as error:
        trouble = str(error).removeprefix("Error: ").split("\n", 1)[0]
        raise BadMesh(f"MuJoCo makes no hull of the mesh: {trouble}", source.path) from None
    # The graph: numbers of vertices and faces; start of the edges of each vertex; indices of vertices; edges; faces.
    count, faces = int(graph[0]), int(graph[1])
    begin = 2 + 2 * count + count + 3 * faces
    corners = graph[begin : begin + 3 * faces].reshape(-1, 3)
    return hull_of(_stl(vertices[corners]))


def hull_of(stl: bytes) -> Hull:
    """The hull with this surface."""
    return Hull(f"{hashlib.blake2b(stl, digest_size=16).hexdigest()}.stl", stl)


def _stl(triangles: np.ndarray[Any, np.dtype[np.float64]]) -> bytes:
    """A binary STL file of n x 3 x 3 corners of a convex surface. Each triangle is oriented outwards."""
    inside = triangles.reshape(-1, 3).mean(axis=0)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = np.einsum("ij,ij->i", normals, triangles[:, 0] - inside) < 0
    triangles[inward] = triangles[inward, ::-1]
    return surfaces.written([(triangles, 0)])


def _alone() -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    return spec


def _add_geom(spec: Any, mesh: Any) -> None:
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
