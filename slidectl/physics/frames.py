"""Poses in and out of frames: composition, inverse, and carrying vectors over.

Plain Python on `rotation`'s types; a pose is (position in m, attitude x y z w).
"""

from __future__ import annotations

from slidectl.physics.rotation import Pose, cross
from slidectl.rotations import Quaternion, Vector, conjugate, multiply


def rotate(quaternion: Quaternion, vector: Vector) -> Vector:
    """The vector turned by a unit quaternion."""
    x, y, z, w = quaternion
    axis = (x, y, z)
    tx, ty, tz = (2 * part for part in cross(axis, vector))
    cx, cy, cz = cross(axis, (tx, ty, tz))
    return (vector[0] + w * tx + cx, vector[1] + w * ty + cy, vector[2] + w * tz + cz)


def add(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def compose(frame: Pose, local: Pose) -> Pose:
    """What is `local` in `frame`, seen from where `frame` is given."""
    return add(frame[0], rotate(frame[1], local[0])), multiply(frame[1], local[1])


def relative(pose: Pose, frame: Pose) -> Pose:
    """`pose` seen from `frame`, both given in the same frame."""
    back = conjugate(frame[1])
    return rotate(back, subtract(pose[0], frame[0])), multiply(back, pose[1])
