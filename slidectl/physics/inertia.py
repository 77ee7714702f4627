"""Inertias that MuJoCo can take: URDF's tensor turned, checked, and put on a body.

Errors name the robot and the link. No joints and no shapes here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slidectl.description.inertia import why_impossible
from slidectl.description.robot import Inertial, Link
from slidectl.physics.parts import BadPart
from slidectl.physics.rotation import matrix, wxyz
from slidectl.rotations import from_rpy


class BadInertia(BadPart):
    """A link that cannot be simulated as it is weighed."""

    kind = "link"


def put_inertia(body: Any, robot: str, link: Link) -> None:
    """Give the MjsBody the link's mass, centre of mass and inertia; a link without `<inertial>` weighs nothing.

    Raises:
        BadInertia: mass not positive, or moments that no body can have.
    """
    body.explicitinertial = True
    body.mass = 0.0
    if link.inertial is None:
        return
    inertial = link.inertial
    if not inertial.mass > 0.0 or inertial.mass == float("inf"):
        hint = 'give it <mass value="..."/> above 0'
        raise BadInertia(robot, link, f"mass {inertial.mass:g} kg is not positive", hint)
    check_moments(robot, link, inertial)
    body.mass = inertial.mass
    body.ipos = inertial.origin.xyz
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    if ixy == ixz == iyz == 0.0:
        body.inertia = _within_triangle(ixx, iyy, izz)
        body.iquat = wxyz(from_rpy(inertial.origin.rpy))
    else:
        body.fullinertia = _turned(inertial)


def check_moments(robot: str, link: Link, inertial: Inertial) -> None:
    """Raises BadInertia unless the principal moments are positive and each is at most the sum of the others."""
    if not all(map(math.isfinite, (*inertial.inertia, *inertial.origin.xyz, *inertial.origin.rpy))):
        raise BadInertia(robot, link, "its inertia is not finite", "give numbers for ixx ... izz")
    why = why_impossible(inertial.inertia)
    if why is not None:
        hint = "for a box of sides x, y, z: ixx = m (y² + z²) / 12"
        raise BadInertia(robot, link, f"no body has its inertia: {why}", hint)


def _tensor(inertial: Inertial) -> np.ndarray[Any, Any]:
    ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def _turned(inertial: Inertial) -> list[float]:
    """The tensor about the link's axes, in MuJoCo's order xx yy zz xy xz yz. R I Rᵀ with R of the inertial origin."""
    turn = np.array(matrix(from_rpy(inertial.origin.rpy)))
    tensor = turn @ _within_triangle_tensor(_tensor(inertial)) @ turn.T
    return [float(tensor[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _within_triangle(ixx: float, iyy: float, izz: float) -> list[float]:
    """The three moments, the largest cut to the sum of the others when it exceeds it by digits lost in the file."""
    moments = [ixx, iyy, izz]
    largest = max(range(3), key=moments.__getitem__)
    moments[largest] = min(moments[largest], sum(moments) - moments[largest])
    return moments


def _within_triangle_tensor(tensor: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    moments, axes = np.linalg.eigh(tensor)
    if moments[0] + moments[1] >= moments[2]:
        return tensor
    moments[2] = moments[0] + moments[1]
    return np.asarray((axes * moments) @ axes.T)
