"""Whether a body can have an inertia: its principal moments are above zero, and none exceeds the sum of the others.

Pure arithmetic on six numbers; no XML.
"""

from __future__ import annotations

import math

Tensor = tuple[float, float, float, float, float, float]
"""ixx, ixy, ixz, iyy, iyz, izz in kg·m²."""

# Exporters print few digits: a flat plate's moments may break the triangle inequality by their rounding.
_ROUNDING = 1e-3


def principal_moments(inertia: Tensor) -> tuple[float, float, float]:
    """The eigenvalues of the symmetric tensor, rising (closed form with the cosine, Smith 1961)."""
    ixx, ixy, ixz, iyy, iyz, izz = inertia
    scale = max(abs(part) for part in inertia)
    if scale == 0.0:
        return 0.0, 0.0, 0.0
    ixx, ixy, ixz, iyy, iyz, izz = (part / scale for part in inertia)
    mean = (ixx + iyy + izz) / 3
    a, b, c = ixx - mean, iyy - mean, izz - mean
    spread = math.sqrt((a * a + b * b + c * c + 2 * (ixy * ixy + ixz * ixz + iyz * iyz)) / 6)
    if spread == 0.0:
        return mean * scale, mean * scale, mean * scale
    half_determinant = (a * (b * c - iyz * iyz) - ixy * (ixy * c - iyz * ixz) + ixz * (ixy * iyz - b * ixz)) / 2
    angle = math.acos(max(-1.0, min(1.0, half_determinant / spread**3))) / 3
    largest = mean + 2 * spread * math.cos(angle)
    smallest = mean + 2 * spread * math.cos(angle + 2 * math.pi / 3)
    return smallest * scale, (3 * mean - largest - smallest) * scale, largest * scale


def why_impossible(inertia: Tensor) -> str | None:
    """Why no body has this inertia, as a clause; None when one can."""
    small, middle, large = principal_moments(inertia)
    moments = f"its principal moments are {small:.4g}, {middle:.4g}, {large:.4g}"
    if small <= large * 1e-12:
        return f"{moments}; each must be above 0"
    if small + middle < large * (1 - _ROUNDING):
        return f"{moments}; none may exceed the sum of the other two"
    return None
