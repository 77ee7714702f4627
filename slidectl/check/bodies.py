"""Whether masses and inertias can be those of the shapes that they stand for.

The parser refuses what no body at all can have. Here is what no body of this mass and this size has: moments are at
most those of the whole mass at the farthest corner, and at least those of a ball of the densest matter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

from slidectl.check.findings import Findings
from slidectl.description.inertia import principal_moments
from slidectl.description.robot import Box, Cylinder, Inertial, Link, Mesh, Pose, Robot, Shape, Sphere, Vector
from slidectl.errors import BadFile

DENSEST = 22590.0
"""Osmium, kg/m³."""
_SLACK = 1.001
# Sensors of next to no weight are often given more inertia than they can have, for the solver's sake; this is a slip.
_SLIP = 100.0

Bounds = tuple[Vector, Vector]
"""Least and largest corner of a box, m."""


def tell(robot: Robot, findings: Findings) -> None:
    """Findings on every link with an inertia, and on meshes that cannot be read."""
    for link in robot.links.values():
        corners = list(_corners(link, findings))
        if link.inertial is not None:
            _tell_inertia(link, link.inertial, corners, findings)


def _tell_inertia(link: Link, inertial: Inertial, corners: list[Vector], findings: Findings) -> None:
    subject = f"link {link.name!r}/<inertial>"
    line = inertial.line if inertial.line is not None else link.line
    largest = principal_moments(inertial.inertia)[2]
    least = smallest_possible(inertial.mass)
    if largest * _SLACK < least:
        text = f"moments of at most {largest:.3g} kg·m²: no matter is so dense that {inertial.mass:g} kg have less than"
        findings.add("wrong", subject, f"{text} {least:.3g}", link.file or "", line)
    if not corners:
        return
    reach = max(math.dist(inertial.origin.xyz, corner) for corner in corners)
    times = largest / (inertial.mass * reach * reach) if reach > 0 else 0.0
    if times > _SLACK:
        text = f"{inertial.mass:g} kg within its shapes have moments of at most {inertial.mass * reach**2:.3g} kg·m²"
        text = f"{text}; the largest here is {largest:.3g}, {times:.3g} times as much"
        wrong = times > _SLIP
        findings.add("wrong" if wrong else "used", subject, text if wrong else f"note: {text}", link.file or "", line)
    if not _is_inside(inertial.origin.xyz, corners):
        x, y, z = inertial.origin.xyz
        text = f"note: the centre of mass, {x:g} {y:g} {z:g}, lies outside of its shapes"
        findings.add("used", subject, text, link.file or "", line)


def smallest_possible(mass: float) -> float:
    """The moment of inertia in kg·m² of a ball of the densest matter: 2/5 m r²."""
    return 0.4 * mass * math.pow(3 * mass / (4 * math.pi * DENSEST), 2 / 3)


def _is_inside(point: Vector, corners: list[Vector]) -> bool:
    """Whether a point is in the axis-aligned box around the corners, grown by a tenth of its diagonal."""
    lows = [min(corner[axis] for corner in corners) for axis in range(3)]
    highs = [max(corner[axis] for corner in corners) for axis in range(3)]
    slack = 0.1 * math.dist(lows, highs)
    return all(low - slack <= value <= high + slack for low, value, high in zip(lows, point, highs, strict=True))


def _corners(link: Link, findings: Findings) -> Iterator[Vector]:
    """Corners of the boxes around all shapes of a link, in the link's frame; each mesh is read on the way."""
    for shape in (*link.visuals, *link.collisions):
        bounds = _bounds(link, shape, findings)
        if bounds is not None:
            for corner in product(*zip(*bounds, strict=True)):
                yield _placed(shape.origin, (corner[0], corner[1], corner[2]))


def _bounds(link: Link, shape: Shape, findings: Findings) -> Bounds | None:
    geometry = shape.geometry
    if isinstance(geometry, Mesh):
        return _mesh_bounds(link, shape, geometry, findings)
    if isinstance(geometry, Box):
        x, y, z = geometry.size
    elif isinstance(geometry, Cylinder):
        x, y, z = 2 * geometry.radius, 2 * geometry.radius, geometry.length
    else:
        assert isinstance(geometry, Sphere)
        x = y = z = 2 * geometry.radius
    return (-x / 2, -y / 2, -z / 2), (x / 2, y / 2, z / 2)


def _mesh_bounds(link: Link, shape: Shape, mesh: Mesh, findings: Findings) -> Bounds | None:
    from slidectl.description import meshes

    if mesh.path is None:
        return None
    collides = shape in link.collisions
    subject = f"link {link.name!r}/<{'collision' if collides else 'visual'}>/<mesh>"
    try:
        triangles = meshes.load(mesh.path, mesh.scale)
    except BadFile as error:
        findings.add("wrong", subject, str(error), shape.file or "", shape.line)
        return None
    if collides:
        text = f"collides as its convex hull ({len(triangles.faces)} triangles as drawn)"
        findings.add("converted", subject, text, shape.file or "", shape.line)
    low, high = triangles.vertices.min(axis=0), triangles.vertices.max(axis=0)
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))


def _placed(pose: Pose, point: Vector) -> Vector:
    """A point of a shape in the link's frame: fixed-axis roll, pitch, yaw, then the shift."""
    roll, pitch, yaw = pose.rpy
    x, y, z = point
    y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
    x, z = x * math.cos(pitch) + z * math.sin(pitch), -x * math.sin(pitch) + z * math.cos(pitch)
    x, y = x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw)
    return pose.xyz[0] + x, pose.xyz[1] + y, pose.xyz[2] + z
