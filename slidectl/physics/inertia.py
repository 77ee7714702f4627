"""Inertias that MuJoCo can take: those of a body's links checked, lumped, turned, and put on the body.

Errors name the robot and the link. No joints and no shapes here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from slidectl.description.inertia import LEAST, is_mass, why_impossible
from slidectl.description.rigid_bodies import lumped
from slidectl.description.robot import Inertial, Link
from slidectl.physics.frames import compose
from slidectl.physics.parts import BadPart
from slidectl.physics.rotation import ORIGIN, Pose, wxyz
from slidectl.rotations import Quaternion, from_rpy, matrix

Array = np.ndarray[Any, np.dtype[Any]]


class BadInertia(BadPart):
    """A link that cannot be simulated as it is weighed."""

    kind = "link"


def put_inertia(body: Any, robot: str, links: Sequence[tuple[Link, Pose]]) -> None:
    """Give the MjsBody the mass, centre of mass and inertia of its links, each with its frame in the body.

    A link without `<inertial>` weighs nothing.

    Raises:
        BadInertia: mass not positive, or moments that no body can have.
    """
    body.explicitinertial = True
    body.mass = 0.0
    weighing = [(inertial, frame) for link, frame in links if (inertial := _checked(robot, link)) is not None]
    if not weighing:
        return
    if len(weighing) == 1:
        inertial, frame = weighing[0]
    else:
        inertial, frame = lumped([(inertial, matrix(frame[1]), frame[0]) for inertial, frame in weighing]), ORIGIN
    body.mass = inertial.mass
    body.ipos, attitude = compose(frame, (inertial.origin.xyz, from_rpy(inertial.origin.rpy)))
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    if ixy == ixz == iyz == 0.0:
        body.inertia = _within_triangle(ixx, iyy, izz)
        body.iquat = wxyz(attitude)
        return
    tensor = _turned(inertial, attitude)
    if _is_on_the_edge(tensor) and not _is_taken(tensor):
        body.inertia, body.iquat = _principal(tensor)
    else:
        body.fullinertia = _row(tensor)


def _checked(robot: str, link: Link) -> Inertial | None:
    """What the link weighs. Raises BadInertia."""
    if link.inertial is None:
        return None
    mass = link.inertial.mass
    if not is_mass(mass):
        raise BadInertia(robot, link, f"mass {mass:g} kg is not positive", 'give it <mass value="..."/> above 0')
    check_moments(robot, link, link.inertial)
    return link.inertial


def check_moments(robot: str, link: Link, inertial: Inertial) -> None:
    """Raises BadInertia unless the principal moments are positive and each is at most the sum of the others."""
    if not all(map(math.isfinite, (*inertial.inertia, *inertial.origin.xyz, *inertial.origin.rpy))):
        raise BadInertia(robot, link, "its inertia is not finite", "give numbers for ixx ... izz")
    why = why_impossible(inertial.inertia)
    if why is not None:
        hint = "for a box of sides x, y, z: ixx = m (y² + z²) / 12"
        raise BadInertia(robot, link, f"no body has its inertia: {why}", hint)


def _tensor(inertial: Inertial) -> Array:
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def _turned(inertial: Inertial, attitude: Quaternion) -> Array:
    """The tensor about the body's axes: R I Rᵀ with R of its attitude in the body."""
    turn = np.array(matrix(attitude))
    return np.asarray(turn @ _within_triangle_tensor(_tensor(inertial)) @ turn.T)


def _row(tensor: Array) -> list[float]:
    """MuJoCo's order, xx yy zz xy xz yz."""
    return [float(tensor[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _within_triangle(ixx: float, iyy: float, izz: float) -> list[float]:
    """The three moments, the largest cut to the sum of the others when it exceeds it by digits lost in the file."""
    moments = [ixx, iyy, izz]
    largest = max(range(3), key=moments.__getitem__)
    # MuJoCo compares with the sum of the two, without any margin; the difference may be rounded to more than that.
    rest = sum(moments[:largest] + moments[largest + 1 :])
    moments[largest] = min(moments[largest], sum(moments) - moments[largest], rest)
    return moments


def _within_triangle_tensor(tensor: Array) -> Array:
    moments, axes = np.linalg.eigh(tensor)
    if moments[0] + moments[1] >= moments[2]:
        return tensor
    moments[2] = moments[0] + moments[1]
    return np.asarray((axes * moments) @ axes.T)


def _is_on_the_edge(tensor: Array) -> bool:
    """Whether MuJoCo, which finds the principal moments of a tensor itself, may refuse it for its rounding: the body is
    flat, or thin as a needle. Its moments are off by no more than 1e-12 of the largest or of 1 kg·m²."""
    small, middle, large = np.linalg.eigvalsh(tensor)
    return bool(small + middle - large < 1e-6 * large + 1e-11 or small < 1e-6 * large + 1e-13)


def _is_taken(tensor: Array) -> bool:
    """Whether MuJoCo takes the tensor of a body on the edge: asked of MuJoCo itself, whose rounding nobody can tell.

    What it takes is left to it, so that a robot which could be spawned before moves as it did, to the last bit.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=1.0, explicitinertial=True, ipos=(0.0, 0.0, 0.0), fullinertia=_row(tensor))
    body.add_freejoint()
    try:
        spec.compile()
    except (ValueError, mujoco.FatalError):
        return False
    return True


def _principal(tensor: Array) -> tuple[list[float], tuple[float, float, float, float]]:
    """Principal moments that keep the triangle rule to the last bit, and MuJoCo's quaternion of their axes."""
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] = -axes[:, 2]
    attitude = np.zeros(4)
    mujoco.mju_mat2Quat(attitude, axes.ravel())
    small, middle, large = (float(max(moment, LEAST)) for moment in moments)
    w, x, y, z = (float(part) for part in attitude)
    return _within_triangle(small, middle, large), (w, x, y, z)
