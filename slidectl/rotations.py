"""Rotations as quaternions x y z w, as on messages, and poses in frames: composition, inverse, roll pitch yaw.

Plain Python, for the command line, launch files, models and physics. `wxyz` converts a quaternion for MuJoCo, whose
quaternions begin with w.
"""

from __future__ import annotations

import math

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]

Pose = tuple[Vector, Quaternion]
"""Position in m, rotation as a quaternion x y z w."""

IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)
ORIGIN: Pose = ((0.0, 0.0, 0.0), IDENTITY)


def from_rpy(rpy: Vector) -> Quaternion:
    """The rotation about the fixed x, then y, then z axis by roll, pitch, yaw (rad); URDF's `rpy`."""
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
    """The rotation as geometry_msgs/Quaternion."""
    return dict(zip("xyzw", quaternion, strict=True))


def normalized(quaternion: Quaternion) -> Quaternion:
    """The quaternion scaled to length one; all zeros mean no rotation, as in messages that leave it out."""
    length = math.hypot(*quaternion)
    if length == 0.0:
        return IDENTITY
    x, y, z, w = (part / length for part in quaternion)
    return (x, y, z, w)


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """The product of two rotations (Hamilton's product): first `b`, then `a`."""
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


def to_rpy(quaternion: Quaternion) -> Vector:
    """Roll, pitch, yaw (rad) about the fixed axes, the inverse of from_rpy; at pitch +-pi/2 the roll is 0."""
    (m00, m01, _), (m10, m11, _), (m20, m21, m22) = matrix(quaternion)
    horizontal = math.hypot(m21, m22)
    if horizontal < 1e-9:
        return (0.0, math.copysign(math.pi / 2, -m20), math.atan2(-m01, m11))
    return (math.atan2(m21, m22), math.atan2(-m20, horizontal), math.atan2(m10, m00))


def rotate(quaternion: Quaternion, vector: Vector) -> Vector:
    """The vector rotated by a unit quaternion."""
    x, y, z, w = quaternion
    axis = (x, y, z)
    tx, ty, tz = (2 * part for part in cross(axis, vector))
    cx, cy, cz = cross(axis, (tx, ty, tz))
    return (vector[0] + w * tx + cx, vector[1] + w * ty + cy, vector[2] + w * tz + cz)


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def add(a: Vector, b: Vector) -> Vector:
    """Sum of two vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """Difference of two vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def compose(frame: Pose, local: Pose) -> Pose:
    """The pose `local`, which is given in `frame`, in the frame in which `frame` is given."""
    return add(frame[0], rotate(frame[1], local[0])), multiply(frame[1], local[1])


def relative(pose: Pose, frame: Pose) -> Pose:
    """The pose `pose` in `frame`; both are given in the same frame."""
    back = conjugate(frame[1])
    return rotate(back, subtract(pose[0], frame[0])), multiply(back, pose[1])


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
