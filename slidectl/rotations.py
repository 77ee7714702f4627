"""Rotations as quaternions x y z w, as on messages: from roll, pitch and yaw, one after another, and back.

Plain Python, for whoever has a rotation: the command line, launch files, physics. Poses and frames are theirs.
"""

from __future__ import annotations

import math

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]

IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


def from_rpy(rpy: Vector) -> Quaternion:
    """The attitude after turning about the fixed x, then y, then z axis by roll, pitch, yaw (rad); URDF's `rpy`."""
    if rpy == (0.0, 0.0, 0.0):
        return IDENTITY
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in rpy)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def message(quaternion: Quaternion) -> dict[str, float]:
    """geometry_msgs/Quaternion."""
    return dict(zip("xyzw", quaternion, strict=True))


def normalized(quaternion: Quaternion) -> Quaternion:
    """The quaternion at length one; all zeros mean no rotation, as in messages that leave it out."""
    length = math.hypot(*quaternion)
    if length == 0.0:
        return IDENTITY
    x, y, z, w = (part / length for part in quaternion)
    return (x, y, z, w)


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation that does `b` first, then `a` (Hamilton's product)."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(quaternion: Quaternion) -> Quaternion:
    """The inverse of a unit quaternion."""
    x, y, z, w = quaternion
    return (-x, -y, -z, w)


def matrix(quaternion: Quaternion) -> Matrix:
    """The rotation matrix of a unit quaternion, by rows."""
    x, y, z, w = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
