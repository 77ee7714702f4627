"""What each kind of joint limit does to the command of its joint, and what it remembers: laws on objects or rows.

The formulas are in `limit_laws.py`, the objects in `limits.py`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.laws import law
from slidectl.control.limit_laws import (
    bounded,
    effort_saturation,
    effort_soft_limits,
    position_saturation,
    position_soft_limits,
    soft_velocity,
    velocity_saturation,
    velocity_soft_limits,
)

if TYPE_CHECKING:
    from slidectl.control.handles import JointHandle
    from slidectl.control.limits import LimitHandle

KINDS = range(6)
(
    EFFORT_SATURATION,
    EFFORT_SOFT,
    POSITION_SATURATION,
    POSITION_SOFT,
    VELOCITY_SATURATION,
    VELOCITY_SOFT,
) = KINDS
"""The kinds in the order in which gazebo_ros_control enforces them; within a kind the joints are alphabetical."""


@law
def saturate_effort(limit: LimitHandle, joint: JointHandle) -> None:
    """Rewrite the command of the joint by `effort_saturation`."""
    joint.command = effort_saturation(
        joint.command,
        joint.position,
        joint.velocity,
        limit.min_position,
        limit.max_position,
        limit.max_velocity,
        limit.max_effort,
    )


@law
def soft_velocities(limit: LimitHandle, position: float) -> tuple[float, float]:
    """The lowest and the highest velocity that a position allows; soft limits count only beside hard ones."""
    fastest = limit.max_velocity
    if not limit.has_position_limits:
        return -fastest, fastest
    low = soft_velocity(position, limit.soft_lower, limit.k_position, fastest)
    high = soft_velocity(position, limit.soft_upper, limit.k_position, fastest)
    return low, high


@law
def slow_effort(limit: LimitHandle, joint: JointHandle) -> None:
    """Rewrite the command of the joint by `effort_soft_limits`."""
    low, high = soft_velocities(limit, joint.position)
    joint.command = effort_soft_limits(joint.command, joint.velocity, low, high, limit.k_velocity, limit.max_effort)


@law
def previous_position(limit: LimitHandle, joint: JointHandle) -> float:
    """The last command, or where the joint is when there was none."""
    return joint.position if limit.previous != limit.previous else limit.previous


@law
def saturate_position(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Rewrite the command of the joint by `position_saturation`, which without velocity limit only clips."""
    low, high = limit.min_position, limit.max_position
    if limit.has_velocity_limits:
        step = limit.max_velocity * period_s
        limit.previous = position_saturation(joint.command, previous_position(limit, joint), step, low, high)
    else:
        limit.previous = bounded(joint.command, low, high)
    joint.command = limit.previous


@law
def slow_position(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Rewrite the command of the joint by `position_soft_limits`."""
    previous = previous_position(limit, joint)
    low, high = soft_velocities(limit, previous)
    limit.previous = position_soft_limits(
        joint.command, previous, low, high, period_s, limit.min_position, limit.max_position
    )
    joint.command = limit.previous


@law
def saturate_velocity(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Rewrite the command of the joint by `velocity_saturation`, which without acceleration limit only clips."""
    fastest = limit.max_velocity
    if limit.has_acceleration_limits:
        limit.previous = velocity_saturation(joint.command, limit.previous, limit.max_acceleration * period_s, fastest)
    else:
        limit.previous = bounded(joint.command, -fastest, fastest)
    joint.command = limit.previous


@law
def slow_velocity(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Rewrite the command of the joint by `velocity_soft_limits`, which without acceleration limit only clips."""
    low, high = soft_velocities(limit, joint.position)
    if limit.has_acceleration_limits:
        step = limit.max_acceleration * period_s
        joint.command = velocity_soft_limits(joint.command, joint.velocity, step, low, high)
    else:
        joint.command = bounded(joint.command, low, high)


@law
def enforce(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Rewrite the command of the joint as this kind of limit does."""
    if limit.kind == EFFORT_SATURATION:
        saturate_effort(limit, joint)
    elif limit.kind == EFFORT_SOFT:
        slow_effort(limit, joint)
    elif limit.kind == POSITION_SATURATION:
        saturate_position(limit, joint, period_s)
    elif limit.kind == POSITION_SOFT:
        slow_position(limit, joint, period_s)
    elif limit.kind == VELOCITY_SATURATION:
        saturate_velocity(limit, joint, period_s)
    else:
        slow_velocity(limit, joint, period_s)
