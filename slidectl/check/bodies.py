"""Compares masses and inertias of links with their shapes.

The parser refuses what is impossible for any body. This module finds what is impossible for a body of this mass and
size: a moment is at most that of the whole mass at the farthest corner, and at least that of a ball of osmium.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

from slidectl.check.findings import Findings
from slidectl.description.inertia import DENSEST, densest_ball, principal_moments
from slidectl.description.rigid_bodies import surroundings
from slidectl.description.robot import Box, Cylinder, Inertial, Link, Mesh, Robot, Shape, Vector, Verdict
from slidectl.errors import BadFile
from slidectl.rotations import from_rpy, matrix

_SLACK = 1.001
# Very light sensors are often given too large inertias, for the solver's sake. Above this factor it is a mistake.
_SLIP = 100.0
AIR = 1.2
"""The density of air, kg/m³."""
# The cameras of the tutorials have almost no mass, which is no mistake.
_THINNEST = AIR / 1000
_FAR = 10.0

Bounds = tuple[Vector, Vector]
"""The smallest and the largest corner of a box, m."""


def check(robot: Robot, findings: Findings) -> None:
    """Add findings on every link with an inertia, and on meshes that cannot be read."""
    around = surroundings(robot)
    for link in robot.links.values():
        corners = list(_corners(link, link.name in around, findings))
        inertial = link.inertial
        if inertial is None or inertial.mended:
            continue
        line = inertial.line if inertial.line is not None else link.line
        for is_wrong, text in _contradictions(inertial, corners):
            verdict: Verdict = "wrong" if is_wrong else "used"
            text = text if is_wrong else f"note: {text}"
            findings.add(verdict, f"link {link.name!r}/<inertial>", text, link.file or "", line)


def _contradictions(inertial: Inertial, corners: list[Vector]) -> Iterator[tuple[bool, str]]:
    """Values that contradict each other, as text, each with whether it is wrong or only unlikely.

    `corners` are those of the boxes around the link's shapes.
    """
    mass, largest = inertial.mass, principal_moments(inertial.inertia)[2]
    least = densest_ball(mass)
    if largest * _SLACK < least:
        text = f"moments of at most {largest:.3g} kg·m²: no matter is so dense that {mass:g} kg have less"
        yield True, f"{text} than {least:.3g}"
    if not corners:
        if (reach := math.sqrt(largest / mass)) > _FAR:
            yield False, f"{mass:g} kg with moments of {largest:.3g} kg·m² lie {reach:.3g} m away from their centre"
        return
    centre = inertial.origin.xyz
    reach = max(math.dist(centre, corner) for corner in corners)
    most = mass * reach * reach
    # If the product overflows or is 0 there is nothing to compare.
    times = largest / most if 0.0 < most < math.inf else 0.0
    if times > _SLACK:
        text = f"{mass:g} kg within its shapes have moments of at most {most:.3g} kg·m²"
        yield times > _SLIP, f"{text}; the largest here is {largest:.3g}, {times:.3g} times as much"
    # Masses in grams, wrong decimal points, and centres of mass outside of the box around all shapes.
    box = [(min(values), max(values)) for values in zip(*corners, strict=True)]
    volume = math.prod(high - low for low, high in box)
    density = mass / volume if 0.0 < volume < math.inf else DENSEST
    if density > DENSEST:
        text = f"{mass:g} kg in at most {volume:.3g} m³ are {density / DENSEST:.3g} times as dense as osmium"
        yield density > _SLIP * DENSEST, text
    elif 0.0 < density < _THINNEST:
        yield False, f"{mass:g} kg in {volume:.3g} m³ are {AIR / density:.3g} times as thin as air"
    slack = 0.1 * math.dist(*zip(*box, strict=True))
    if not all(low - slack <= value <= high + slack for value, (low, high) in zip(centre, box, strict=True)):
        x, y, z = centre
        yield False, f"the centre of mass, {x:g} {y:g} {z:g}, lies outside of its shapes"


def _corners(link: Link, is_around: bool, findings: Findings) -> Iterator[Vector]:
    """Corners of the boxes around all shapes of a link, in the link's frame. It reads the meshes.

    `is_around`: the link is part of the surroundings, whose meshes collide as their faces.
    """
    for shape in (*link.visuals, *link.collisions):
        bounds = _bounds(link, shape, is_around, findings)
        if bounds is not None:
            turn = matrix(from_rpy(shape.origin.rpy))
            for corner in product(*zip(*bounds, strict=True)):
                x, y, z = (
                    shift + sum(a * b for a, b in zip(row, corner, strict=True))
                    for shift, row in zip(shape.origin.xyz, turn, strict=True)
                )
                yield x, y, z


def _bounds(link: Link, shape: Shape, is_around: bool, findings: Findings) -> Bounds | None:
    geometry = shape.geometry
    if isinstance(geometry, Mesh):
        return _mesh_bounds(link, shape, geometry, is_around, findings)
    if isinstance(geometry, Box):
        x, y, z = geometry.size
    else:
        x = y = z = 2 * geometry.radius
        z = geometry.length if isinstance(geometry, Cylinder) else z
    return (-x / 2, -y / 2, -z / 2), (x / 2, y / 2, z / 2)


def _mesh_bounds(link: Link, shape: Shape, mesh: Mesh, is_around: bool, findings: Findings) -> Bounds | None:
    from slidectl.description import meshes

    if mesh.path is None:
        return None
    collides = shape in link.collisions
    subject = f"link {link.name!r}/<{'collision' if collides else 'visual'}>/<mesh>"
    try:
        triangles = meshes.load(mesh.path, mesh.scale)
        if collides and not is_around and meshes.is_flat(triangles.vertices):
            raise BadFile(meshes.FLAT, mesh.path)
    except BadFile as error:
        findings.add("wrong", subject, str(error), shape.file or "", shape.line)
        if collides:
            findings.refuse(BadFile(f"{subject}: {error}", shape.file, shape.line))
        return None
    if collides:
        how = "its faces, if they are not too many" if is_around else "its convex hull"
        text = f"collides as {how} ({len(triangles.faces)} triangles as drawn)"
        findings.add("converted", subject, text, shape.file or "", shape.line)
    low, high = triangles.vertices.min(axis=0), triangles.vertices.max(axis=0)
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
