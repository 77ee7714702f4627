"""Meshes made ready to collide: read from their files, and reduced to their convex hulls.

It takes time and memory that the file's author chooses, so a driver does it in another process. What comes out is
small, and the file is not needed any more. `Hulls` of a robot go with it into the world.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from slidectl.description import meshes
from slidectl.description.meshes import BadMesh
from slidectl.description.robot import Mesh, Robot
from slidectl.physics import mujoco_library
from slidectl.rotations import Vector

MOST_VERTICES = 1000
"""Of a hull. MuJoCo adds points one by one, the farthest first, and stops there: of a ball's hull, 0.2 % of the radius
is missing. One of 10 000 takes it 0.3 s to prepare, in which the world would stand still."""


class MeshSource(NamedTuple):
    """A mesh file as a robot uses it."""

    path: str
    scale: Vector


class Hull(NamedTuple):
    """A convex hull, in m."""

    name: str
    """Says the content, with the suffix of its kind."""
    stl: bytes
    """The surface as the content of a binary STL file."""


Hulls = Mapping[MeshSource, Hull | BadMesh]
"""What became of each mesh of a robot."""


def source_of(mesh: Mesh) -> MeshSource:
    """The file and the scale of a mesh that was found."""
    assert mesh.path is not None
    return MeshSource(mesh.path, mesh.scale)


def sources(robot: Robot) -> list[MeshSource]:
    """The meshes of a robot that collide, each once, in the order of the file."""
    shapes = (shape.geometry for link in robot.links.values() for shape in link.collisions)
    return list(dict.fromkeys(source_of(mesh) for mesh in shapes if isinstance(mesh, Mesh) and mesh.path is not None))


def read_all(robot: Robot) -> Hulls:
    """The hulls of a robot's meshes, read now and here."""
    return {source: read(source) for source in sources(robot)}


def read(source: MeshSource) -> Hull | BadMesh:
    """The hull of one mesh file, or why there is none."""
    try:
        return _hull(source)
    except BadMesh as error:
        return error
    except MemoryError:
        return BadMesh("its hull needs more memory than there is for it", source.path)


def prepare(hull: Hull) -> None:
    """Let MuJoCo compute what it needs of a hull, which it keeps: then the compilation of a world is quick."""
    try:
        spec = _alone()
        spec.assets[hull.name] = hull.stl
        _put(spec, spec.add_mesh(name="mesh", file=hull.name))
        with mujoco_library.warnings_kept():
            spec.compile()
    except (ValueError, mujoco.FatalError):
        return  # the world's compilation says it, with the robot's name


def _hull(source: MeshSource) -> Hull:
    """Raises BadMesh."""
    vertices = meshes.load(source.path, source.scale).vertices
    if meshes.is_flat(vertices):
        raise BadMesh(meshes.FLAT, source.path)
    spec = _alone()
    mesh = spec.add_mesh(name="mesh", uservert=vertices.ravel(), maxhullvert=MOST_VERTICES)
    _put(spec, mesh)
    try:
        with mujoco_library.warnings_kept():
            graph = spec.compile().mesh_graph
    except (ValueError, mujoco.FatalError) as error:
        trouble = str(error).removeprefix("Error: ").split("\n", 1)[0]
        raise BadMesh(f"MuJoCo makes no hull of the mesh: {trouble}", source.path) from None
    # The graph: counts of vertices and faces, where each vertex's edges begin, its number, the edges, the faces.
    count, faces = int(graph[0]), int(graph[1])
    begin = 2 + 2 * count + count + 3 * faces
    corners = graph[begin : begin + 3 * faces].reshape(-1, 3)
    stl = _stl(vertices[corners])
    return Hull(f"{hashlib.blake2b(stl, digest_size=16).hexdigest()}.stl", stl)


def _stl(triangles: np.ndarray[Any, np.dtype[np.float64]]) -> bytes:
    """n x 3 x 3 corners of a convex surface, turned to be seen from outside."""
    inside = triangles.reshape(-1, 3).mean(axis=0)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = np.einsum("ij,ij->i", normals, triangles[:, 0] - inside) < 0
    triangles[inward] = triangles[inward, ::-1]
    facets = np.zeros(len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]))
    facets["corners"] = triangles
    return bytes(80) + len(facets).to_bytes(4, "little") + facets.tobytes()


def _alone() -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    return spec


def _put(spec: Any, mesh: Any) -> None:
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
