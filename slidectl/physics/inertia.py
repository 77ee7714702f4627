"""Inertias that MuJoCo can take: URDF's tensor turned, checked, and put on a body.

Errors name the robot and the link. No joints and no shapes here.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slidectl.description.robot import Inertial, Link
from slidectl.errors import SlidectlError
from slidectl.physics.rotation import from_rpy, matrix, wxyz

SLACK = 1e-6
"""By how much, relative to the largest, the moments may break the triangle inequality: digits lost in a file."""


class BadInertia(SlidectlError):
    """A link that cannot be simulated as it is weighed."""

    def __init__(self, robot: str, link: Link, trouble: str, hint: str) -> None:
        at = f" (line {link.line})" if link.line is not None else ""
        super().__init__(f"link {link.name!r} of robot {robot!r}{at}: {trouble}", hint)
        self.link = link.name


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
    tensor = _tensor(inertial)
    if not np.isfinite(tensor).all():
        raise BadInertia(robot, link, "its inertia is not finite", "give numbers for ixx ... izz")
    low, middle, high = (float(moment) for moment in np.linalg.eigvalsh(tensor))
    shown = f"principal moments {low:.4g}, {middle:.4g}, {high:.4g} kg·m²"
    if low <= 0.0:
        raise BadInertia(robot, link, f"no body has this inertia, {shown}", "all three must be above 0")
    if low + middle < high * (1.0 - SLACK):
        hint = "none may exceed the sum of the other two; for a box: ixx = m (y² + z²) / 12"
        raise BadInertia(robot, link, f"no body has this inertia, {shown}", hint)


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
