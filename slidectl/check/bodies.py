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


def tell(robot: Robot, findings: Findings) -> None:
    """Add findings on every link with an inertia, and on meshes that cannot be read."""
    around = surroundings(robot)
    for link in robot.links.values():
        corners = list(_corners(link, link.name in around, findings))
        if link.inertial is not None and not link.inertial.mended:
            _Body(link, link.inertial, corners, findings).tell()


class _Body:
    """The mass and moments of a link; `corners` are those of the boxes around its shapes."""

    def __init__(self, link: Link, inertial: Inertial, corners: list[Vector], findings: Findings) -> None:
        self.link = link
        self.inertial = inertial
        self.mass = inertial.mass
        self.largest = principal_moments(inertial.inertia)[2]
        self.corners = corners
        self.findings = findings

    def tell(self) -> None:
        """Add findings on values that contradict each other."""
        least = densest_ball(self.mass)
        if self.largest * _SLACK < least:
            text = f"moments of at most {self.largest:.3g} kg·m²: no matter is so dense that {self.mass:g} kg have less"
            self._add(f"{text} than {least:.3g}", is_wrong=True)
        if self.corners:
            self._tell_moments()
            self._tell_density_and_centre()
        elif (reach := math.sqrt(self.largest / self.mass)) > _FAR:
            text = f"{self.mass:g} kg with moments of {self.largest:.3g} kg·m² lie {reach:.3g} m away from their centre"
            self._add(text)

    def _tell_moments(self) -> None:
        reach = max(math.dist(self.inertial.origin.xyz, corner) for corner in self.corners)
        most = self.mass * reach * reach
        # If the product overflows or is 0 there is nothing to compare.
        times = self.largest / most if 0.0 < most < math.inf else 0.0
        if times > _SLACK:
            text = f"{self.mass:g} kg within its shapes have moments of at most {most:.3g} kg·m²"
            text = f"{text}; the largest here is {self.largest:.3g}, {times:.3g} times as much"
            self._add(text, is_wrong=times > _SLIP)

    def _tell_density_and_centre(self) -> None:
        """Find masses in grams, wrong decimal points, and centres of mass outside of the box around all shapes."""
        box = [(min(values), max(values)) for values in zip(*self.corners, strict=True)]
        volume = math.prod(high - low for low, high in box)
        density = self.mass / volume if 0.0 < volume < math.inf else DENSEST
        if density > DENSEST:
            text = f"{self.mass:g} kg in at most {volume:.3g} m³ are {density / DENSEST:.3g} times as dense as osmium"
            self._add(text, is_wrong=density > _SLIP * DENSEST)
        elif 0.0 < density < _THINNEST:
            self._add(f"{self.mass:g} kg in {volume:.3g} m³ are {AIR / density:.3g} times as thin as air")
        slack = 0.1 * math.dist(*zip(*box, strict=True))
        centre = self.inertial.origin.xyz
        if not all(low - slack <= value <= high + slack for value, (low, high) in zip(centre, box, strict=True)):
            x, y, z = centre
            self._add(f"the centre of mass, {x:g} {y:g} {z:g}, lies outside of its shapes")

    def _add(self, text: str, is_wrong: bool = False) -> None:
        line = self.inertial.line if self.inertial.line is not None else self.link.line
        verdict: Verdict = "wrong" if is_wrong else "used"
        text = text if is_wrong else f"note: {text}"
        self.findings.add(verdict, f"link {self.link.name!r}/<inertial>", text, self.link.file or "", line)


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
