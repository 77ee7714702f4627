"""Collision shapes as MuJoCo geoms: boxes, cylinders, spheres and meshes, each with the friction of its link.

Visuals never come here: the simulated world has no picture. The files of meshes are read once, before a robot is
attached: see hulls.py.
"""

from __future__ import annotations

import struct
from typing import Any

import mujoco

from slidectl.description.robot import Box, Cylinder, Link, Mesh, Robot, Shape, Sphere, Surface
from slidectl.physics.frames import compose
from slidectl.physics.hulls import Hull, Hulls, source_of
from slidectl.physics.parts import BadPart, place
from slidectl.physics.rotation import Pose, wxyz
from slidectl.rotations import from_rpy

GAZEBO_FRICTION = 1.0
"""Gazebo's mu of a surface that says nothing, and MuJoCo's sliding friction too."""

LARGEST_FRICTION = 1e6
"""What every larger coefficient counts as, `Inf` included: nothing slides at it, and its square is an exact number."""


class BadShape(BadPart):
    """A collision shape that MuJoCo cannot take. `part` is the link's name."""

    kind = "link"

    def __init__(self, robot: str, link: Link, shape: Shape, trouble: str) -> None:
        super().__init__(robot, link, f"collision shape{place(shape.file, shape.line)}: {trouble}")


def put_shapes(spec: Any, body: Any, robot: str, link: Link, frame: Pose, bits: tuple[int, int], hulls: Hulls) -> None:
    """Add one geom per collision of the link, with these bits (contype, conaffinity) of what it may touch.

    `frame` is the link's in the body, `hulls` has what its meshes collide as.

    Raises:
        BadShape: a size that is not positive, or a mesh that could not be read.
    """
    for number, shape in enumerate(link.collisions):
        position, attitude = compose(frame, (shape.origin.xyz, from_rpy(shape.origin.rpy)))
        geom = body.add_geom(name=_geom_name(robot, link, number), pos=position, quat=wxyz(attitude))
        geom.contype, geom.conaffinity = bits
        put_friction(geom, sliding_friction(link.surface))
        if isinstance(shape.geometry, Mesh):
            _put_mesh(spec, geom, robot, link, shape, hulls)
        else:
            geom.type, geom.size = _primitive(robot, link, shape)


def mesh_names(robot: Robot, name: str) -> list[str]:
    """The meshes that `put_shapes` adds to the specification itself, for a robot of this name."""
    shapes = ((link, number, shape) for link in robot.links.values() for number, shape in enumerate(link.collisions))
    return [_geom_name(name, link, number) for link, number, shape in shapes if isinstance(shape.geometry, Mesh)]


def _geom_name(robot: str, link: Link, number: int) -> str:
    return f"{robot}/{link.name}/{number}"


def put_friction(geom: Any, mu: float) -> None:
    """Between two geoms the smaller coefficient counts, as in Gazebo.

    MuJoCo takes the larger one, unless one geom has priority: so the lower the friction, the higher the priority. The
    bits of positive single-precision numbers, read as integers, are in the order of the numbers.
    """
    geom.friction[0] = mu = min(mu, LARGEST_FRICTION)
    geom.priority = -struct.unpack("<i", struct.pack("<f", mu))[0]


def sliding_friction(surface: Surface) -> float:
    """The one coefficient that MuJoCo has for both directions: mu1, else mu2, else Gazebo's default."""
    for mu in (surface.mu1, surface.mu2):
        if mu is not None:
            return mu
    return GAZEBO_FRICTION


def _primitive(robot: str, link: Link, shape: Shape) -> tuple[Any, list[float]]:
    """MuJoCo's type, and its size: half lengths, and radius before half length."""
    geometry = shape.geometry
    if isinstance(geometry, Box):
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, [edge / 2 for edge in geometry.size]
    elif isinstance(geometry, Cylinder):
        kind, size = mujoco.mjtGeom.mjGEOM_CYLINDER, [geometry.radius, geometry.length / 2, 0.0]
    elif isinstance(geometry, Sphere):
        kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, [geometry.radius, 0.0, 0.0]
    else:
        raise TypeError(f"not a primitive: {geometry!r}")
    needed = {Box: 3, Cylinder: 2, Sphere: 1}[type(geometry)]
    if not all(0.0 < length < float("inf") for length in size[:needed]):
        raise BadShape(robot, link, shape, f"{geometry} needs sizes above 0")
    return kind, size


def _put_mesh(spec: Any, geom: Any, robot: str, link: Link, shape: Shape, hulls: Hulls) -> None:
    """A mesh collides as its convex hull, which is a file in the specification's memory.

    Of a file MuJoCo keeps what it has computed for the next compilation, of vertices in the specification it does not;
    the file's name says its content, so equal meshes are one.
    """
    source = shape.geometry
    assert isinstance(source, Mesh)
    if source.path is None:
        raise BadShape(robot, link, shape, f"mesh {source.uri!r} was not found")
    hull = hulls.get(source_of(source))
    if not isinstance(hull, Hull):
        raise BadShape(
            robot, link, shape, f"mesh {hull.message if hull is not None else source.path + ' was not read'}"
        )
    spec.assets[hull.name] = hull.stl
    mesh = spec.add_mesh(name=geom.name, file=hull.name)
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, mesh.name
