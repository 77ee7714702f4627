"""Meshes for collision: read from their files, and reduced to their convex hulls.

Time and memory depend on the file, so a driver does this in another process. The result is small, and the file is not
needed afterwards. The `Hulls` of a robot are passed to the world with it.
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
"""Largest number of vertices of a hull. MuJoCo adds points one by one, the farthest first, and stops at this number: a
ball's hull lacks 0.2 % of the radius. A hull of 10 000 takes 0.3 s to prepare, during which the world would stop."""


class MeshSource(NamedTuple):
    """A mesh file, with the scale at which a robot uses it."""

    path: str
    scale: Vector


class Hull(NamedTuple):
    """A convex hull, in m."""

    name: str
    """The hash of the content, with the suffix of the file type."""
    stl: bytes
    """The surface as the content of a binary STL file."""


Hulls = Mapping[MeshSource, Hull | BadMesh]
"""The hull of each mesh of a robot, or the error."""


def source_of(mesh: Mesh) -> MeshSource:
    """The file and the scale of a mesh. Its file must have been found."""
    assert mesh.path is not None
    return MeshSource(mesh.path, mesh.scale)


def sources(robot: Robot) -> list[MeshSource]:
    """The collision meshes of a robot, each once, in the order of the file."""
    shapes = (shape.geometry for link in robot.links.values() for shape in link.collisions)
    return list(dict.fromkeys(source_of(mesh) for mesh in shapes if isinstance(mesh, Mesh) and mesh.path is not None))


def read_all(robot: Robot) -> Hulls:
    """Read the hulls of a robot's meshes, in this process."""
    return {source: read(source) for source in sources(robot)}


def read(source: MeshSource) -> Hull | BadMesh:
    """Read the hull of one mesh file. Returns the error if there is none."""
    try:
        return _hull(source)
    except BadMesh as error:
        return error
    except MemoryError:
        return BadMesh("its hull needs more memory than there is for it", source.path)


def prepare(hull: Hull) -> None:
    """Let MuJoCo compute and cache its data of a hull, so that the compilation of a world is fast."""
    try:
        spec = _alone()
        spec.assets[hull.name] = hull.stl
        _put(spec, spec.add_mesh(name="mesh", file=hull.name))
        with mujoco_library.warnings_kept():
            spec.compile()
    except (ValueError, mujoco.FatalError):
        return  # the compilation of the world raises the error, with the robot's name


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
