"""Checks masses and inertias of bodies, and finds the nearest possible ones for impossible ones.

`check`, `spawn` and the physics all use these rules. Arithmetic on six numbers and a mass; no XML.

An inertia is possible when its principal moments A <= B <= C are above 0 and C <= A + B (the triangle rule). Rounding
errors of the numbers in files are tolerated.
"""

from __future__ import annotations

import math

from slidectl.rotations import Matrix, Vector

Tensor = tuple[float, float, float, float, float, float]
"""ixx, ixy, ixz, iyy, iyz, izz in kg·m²."""

LEAST = 1e-15
"""kg and kg·m². The least mass and principal moment of a moving body: MuJoCo's mjMINVAL."""

SMALLEST_MASS = 1e-3
"""kg. The mass given to a body without one: it falls, touches and is pushed at steps of 1 ms without trouble."""

SMALLEST_MOMENT = 1e-6
"""kg·m². The least principal moment given to a body without a mass: one gram at a distance of 3 cm."""

DENSEST = 22590.0
"""kg/m³. The density of osmium."""

# Exporters write few digits: rounding may make the moments of a flat plate break the triangle rule.
_ROUNDING = 1e-3
# A moment below this share of the largest counts as 0.
_NOTHING = 1e-12
# A corrected moment is at least this share of the largest: a thinner body would turn too fast for steps of 1 ms.
_THINNEST = 1e-6
_IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def principal_moments(inertia: Tensor) -> Vector:
    """The eigenvalues of the symmetric tensor, rising; exact to the last digits of the largest."""
    return principal(inertia)[0]


def principal(inertia: Tensor) -> tuple[Vector, Matrix]:
    """The principal moments, rising, and their axes as columns of a matrix (Jacobi's method, which is exact for
    diagonal tensors and separates close moments, unlike the closed form)."""
    scale = max(map(abs, inertia))
    if scale == 0.0 or not math.isfinite(scale):
        return (scale, scale, scale), _IDENTITY
    ixx, ixy, ixz, iyy, iyz, izz = (part / scale for part in inertia)
    rows = [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]
    axes = [list(row) for row in _IDENTITY]
    for _ in range(50):
        i, j = max(((0, 1), (0, 2), (1, 2)), key=lambda pair: abs(rows[pair[0]][pair[1]]))
        if abs(rows[i][j]) < 1e-18:
            break
        _turn(rows, axes, i, j)
    order = sorted(range(3), key=lambda k: rows[k][k])
    x, y, z = (rows[k][k] * scale for k in order)
    first, second, third = ((row[order[0]], row[order[1]], row[order[2]]) for row in axes)
    return (x, y, z), (first, second, third)


def _turn(rows: list[list[float]], axes: list[list[float]], i: int, j: int) -> None:
    """Rotate about the third axis so that the element i, j becomes 0 (Golub and Van Loan, 8.5)."""
    theta = (rows[j][j] - rows[i][i]) / (2 * rows[i][j])
    tangent = math.copysign(1.0, theta) / (abs(theta) + math.hypot(theta, 1.0))
    cosine = 1 / math.hypot(tangent, 1.0)
    sine = tangent * cosine
    for row in (*rows, *axes):
        row[i], row[j] = cosine * row[i] - sine * row[j], sine * row[i] + cosine * row[j]
    first, second = rows[i], rows[j]
    rows[i] = [cosine * a - sine * b for a, b in zip(first, second, strict=True)]
    rows[j] = [sine * a + cosine * b for a, b in zip(first, second, strict=True)]
    rows[i][j] = rows[j][i] = 0.0


def is_mass(mass: float) -> bool:
    """True for a mass that a body can have."""
    return 0.0 < mass < math.inf


def why_impossible(inertia: Tensor) -> str | None:
    """Why no body has this inertia, as a clause; None when a body can have it."""
    if not all(map(math.isfinite, inertia)):
        return "it is not finite"
    small, middle, large = principal_moments(inertia)
    moments = f"its principal moments are {small:.4g}, {middle:.4g}, {large:.4g}"
    if not math.isfinite(large):
        return "it is not finite"
    if small <= large * _NOTHING:
        return f"{moments}; each must be above 0"
    if small + middle < large * (1 - _ROUNDING):
        return f"{moments}; none may exceed the sum of the other two"
    return None


def can_move(mass: float, inertia: Tensor) -> bool:
    """True when a possible mass and inertia are large enough for a moving body."""
    return mass >= LEAST and principal_moments(inertia)[0] >= LEAST


def densest_ball(mass: float) -> float:
    """The moment of inertia in kg·m² of a ball of the densest matter, the least that a body can have: 2/5 m r²."""
    return 0.4 * mass * math.pow(3 * mass / (4 * math.pi * DENSEST), 2 / 3)


def nearest_possible(mass: float, inertia: Tensor) -> tuple[float, Tensor]:
    """The nearest mass and inertia that a moving body can have; possible ones are returned unchanged.

    A mass below LEAST becomes SMALLEST_MASS. The principal axes of the inertia stay, and the principal moments
    A <= B <= C become the nearest ones (least sum of squares) that keep the triangle rule:

        A + e, B + e, C - e  with  e = max(0, C - A - B) / 3
        0, m, m              with  m = max(0, (B + C) / 2), if A + e is still negative

    Then each is raised to a lower bound: the moment of a ball of osmium of that mass, a millionth of the largest
    moment, and SMALLEST_MOMENT if there was no mass.
    """
    weight = mass if mass >= LEAST else SMALLEST_MASS
    if weight == mass and why_impossible(inertia) is None and can_move(mass, inertia):
        return mass, inertia
    (small, middle, large), axes = principal(inertia)
    if why_impossible(inertia) is not None:
        small, middle, large = _within_triangle(small, middle, large)
    floor = max(densest_ball(weight), large * _THINNEST, 2 * LEAST if weight == mass else SMALLEST_MOMENT)
    small, middle, large = (max(moment, floor) for moment in (small, middle, large))
    return weight, _tensor((small, middle, large), axes)


def _within_triangle(small: float, middle: float, large: float) -> Vector:
    excess = max(0.0, (large - small - middle) / 3)
    if small + excess >= 0.0:
        return small + excess, middle + excess, large - excess
    mean = max(0.0, (middle + large) / 2)
    return 0.0, mean, mean


def _tensor(moments: Vector, axes: Matrix) -> Tensor:
    """The tensor with these principal moments about the axes that are the columns of the matrix."""

    def part(i: int, j: int) -> float:
        return sum(axes[i][k] * moments[k] * axes[j][k] for k in range(3))

    return part(0, 0), part(0, 1), part(0, 2), part(1, 1), part(1, 2), part(2, 2)
