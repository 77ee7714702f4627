"""Rotations as physics needs them beside `slidectl.rotations`: MuJoCo's order, and axes.

`Quaternion` is x y z w as on messages; `wxyz` turns it for MuJoCo, whose quaternions begin with w.
"""

from __future__ import annotations

import math

from slidectl.rotations import Quaternion, Vector, cross


def wxyz(quaternion: Quaternion) -> tuple[float, float, float, float]:
    """MuJoCo's order."""
    x, y, z, w = quaternion
    return (w, x, y, z)


def xyzw(quaternion: Quaternion) -> Quaternion:
    """The order of messages, from MuJoCo's."""
    w, x, y, z = quaternion
    return (x, y, z, w)


def perpendicular(axis: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors that span the plane normal to `axis`; right-handed with it."""
    normal = unit(axis)
    smallest = min(range(3), key=lambda i: abs(normal[i]))
    helper = (float(smallest == 0), float(smallest == 1), float(smallest == 2))
    first = unit(cross(helper, normal))
    return first, cross(normal, first)


def unit(vector: Vector) -> Vector:
    """The vector at length one. Raises ZeroDivisionError for the null vector."""
    length = math.sqrt(sum(part * part for part in vector))
    return (vector[0] / length, vector[1] / length, vector[2] / length)
