"""Limits of one joint, as its URDF and the parameters `joint_limits/<joint>` give them.

Data and its two sources, after joint_limits_interface. What the limits do to a command is in `limits.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from slidectl.control import params
from slidectl.control.node import NodeHandle
from slidectl.control.parameters import BOOLEAN, NUMBER, Parameter
from slidectl.description.robot import Joint


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Positions in m or rad, velocity in m/s or rad/s and so on, effort in N or N·m. Flags say which count."""

    has_position_limits: bool = False
    min_position: float = 0.0
    max_position: float = 0.0
    has_velocity_limits: bool = False
    max_velocity: float = 0.0
    has_acceleration_limits: bool = False
    max_acceleration: float = 0.0
    has_jerk_limits: bool = False
    max_jerk: float = 0.0
    has_effort_limits: bool = False
    max_effort: float = 0.0
    angle_wraparound: bool = False


@dataclass(frozen=True, slots=True)
class SoftJointLimits:
    """Positions in m or rad; k_position in 1/s; k_velocity in N·s/m or N·m·s/rad."""

    min_position: float = 0.0
    max_position: float = 0.0
    k_position: float = 0.0
    k_velocity: float = 0.0


NO_LIMITS = JointLimits()

LIMITS = (
    Parameter("has_position_limits", BOOLEAN, "min_position and max_position count, or (false) there are none"),
    Parameter("min_position", NUMBER, "least position", "m or rad"),
    Parameter("max_position", NUMBER, "largest position", "m or rad"),
    Parameter("has_velocity_limits", BOOLEAN, "max_velocity counts, or (false) there is none"),
    Parameter("max_velocity", NUMBER, "largest velocity", "m/s or rad/s"),
    Parameter("has_acceleration_limits", BOOLEAN, "max_acceleration counts, or (false) there is none"),
    Parameter("max_acceleration", NUMBER, "largest acceleration", "m/s² or rad/s²"),
    Parameter("has_jerk_limits", BOOLEAN, "max_jerk counts, or (false) there is none"),
    Parameter("max_jerk", NUMBER, "largest jerk", "m/s³ or rad/s³"),
    Parameter("has_effort_limits", BOOLEAN, "max_effort counts, or (false) there is none"),
    Parameter("max_effort", NUMBER, "largest effort", "N or N·m"),
    Parameter("angle_wraparound", BOOLEAN, "the joint turns on and on"),
    Parameter("has_soft_limits", BOOLEAN, "the four values of soft limits count"),
    Parameter("soft_lower_limit", NUMBER, "where slowing down ends, below", "m or rad"),
    Parameter("soft_upper_limit", NUMBER, "where slowing down ends, above", "m or rad"),
    Parameter("k_position", NUMBER, "velocity allowed per distance to the soft limit", "1/s"),
    Parameter("k_velocity", NUMBER, "effort allowed per velocity left", "N·s/m or N·m·s/rad"),
)
"""What `joint_limits/<joint>` may hold, as joint_limits_interface reads it."""

_BOUNDS = {
    "has_velocity_limits": "max_velocity",
    "has_acceleration_limits": "max_acceleration",
    "has_jerk_limits": "max_jerk",
    "has_effort_limits": "max_effort",
}


def limits_from_joint(joint: Joint, base: JointLimits = NO_LIMITS) -> JointLimits | None:
    """`base` with what `<limit>` says; None without `<limit>`. Jerk stays that of `base`."""
    limit = joint.limit
    if limit is None:
        return None
    limits = replace(
        base,
        has_position_limits=joint.type in ("revolute", "prismatic"),
        has_velocity_limits=True,
        max_velocity=limit.velocity,
        has_acceleration_limits=False,
        has_effort_limits=True,
        max_effort=limit.effort,
    )
    if limits.has_position_limits:
        return replace(limits, min_position=limit.lower, max_position=limit.upper)
    return replace(limits, angle_wraparound=True) if joint.type == "continuous" else limits


def soft_limits_from_joint(joint: Joint) -> SoftJointLimits | None:
    """What `<safety_controller>` says; None without it."""
    safety = joint.safety
    if safety is None:
        return None
    return SoftJointLimits(safety.soft_lower_limit, safety.soft_upper_limit, safety.k_position, safety.k_velocity)


def limits_from_parameters(node: NodeHandle, joint: str, base: JointLimits = NO_LIMITS) -> JointLimits | None:
    """`base` with what `joint_limits/<joint>/*` says; None when nothing is set there.

    A group counts only with its flag; a true flag without its values changes nothing.
    """
    where = f"joint_limits/{joint}"
    if not node.has_param(where):
        return None
    limits = _with_position(node, where, base)
    for flag, bound in _BOUNDS.items():
        limits = _with_bound(node, where, limits, flag, bound)
    return limits


def soft_limits_from_parameters(node: NodeHandle, joint: str) -> SoftJointLimits | None:
    """The soft limits at `joint_limits/<joint>`; None unless `has_soft_limits` is true and all four values are set."""
    where = f"joint_limits/{joint}"
    if params.boolean(node, f"{where}/has_soft_limits") is not True:
        return None
    lower = params.number(node, f"{where}/soft_lower_limit")
    upper = params.number(node, f"{where}/soft_upper_limit")
    k_position = params.number(node, f"{where}/k_position")
    k_velocity = params.number(node, f"{where}/k_velocity")
    if lower is None or upper is None or k_position is None or k_velocity is None:
        return None
    return SoftJointLimits(lower, upper, k_position, k_velocity)


def _with_position(node: NodeHandle, where: str, limits: JointLimits) -> JointLimits:
    has = params.boolean(node, f"{where}/has_position_limits")
    if has is None:
        return limits
    if has:
        lower = params.number(node, f"{where}/min_position")
        upper = params.number(node, f"{where}/max_position")
        if lower is None or upper is None:
            return limits
        return replace(limits, has_position_limits=True, min_position=lower, max_position=upper)
    wraparound = params.boolean(node, f"{where}/angle_wraparound")
    return replace(
        limits,
        has_position_limits=False,
        angle_wraparound=limits.angle_wraparound if wraparound is None else wraparound,
    )


def _with_bound(node: NodeHandle, where: str, limits: JointLimits, flag: str, bound: str) -> JointLimits:
    has = params.boolean(node, f"{where}/{flag}")
    if has is None:
        return limits
    if not has:
        return replace(limits, **{flag: False})
    value = params.number(node, f"{where}/{bound}")
    changes: dict[str, Any] = {flag: True, bound: value}
    return limits if value is None else replace(limits, **changes)
