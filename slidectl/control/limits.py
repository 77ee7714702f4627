"""Joint limit handles: each watches one joint and rewrites its command in place, once a step.

The six handles of joint_limits_interface around the laws of `limit_laws.py`. Saturation handles clip to hard
limits; soft limit handles slow the joint down before it gets there.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, nan
from typing import ClassVar

from slidectl.control.handles import JointHandle
from slidectl.control.joint_limits import JointLimits, SoftJointLimits
from slidectl.control.laws import Columns, Compiled, law
from slidectl.control.limit_laws import (
    LARGEST,
    bounded,
    effort_saturation,
    effort_soft_limits,
    position_saturation,
    position_soft_limits,
    soft_velocity,
    velocity_saturation,
    velocity_soft_limits,
)
from slidectl.errors import Refused


class BadLimits(Refused):
    """Limits that a handle cannot work with."""

    def __init__(self, handle: str, joint: str, missing: str) -> None:
        super().__init__(f"joint {joint!r} has no {missing} limit, which {handle} needs")


@law
def saturate_effort(limit: EffortJointSaturation, joint: JointHandle) -> None:
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
def slow_effort(limit: EffortJointSoftLimits, joint: JointHandle) -> None:
    """Rewrite the command of the joint by `effort_soft_limits`; soft limits count only beside hard ones."""
    fastest = limit.max_velocity
    low, high = -fastest, fastest
    if limit.has_position_limits:
        low = soft_velocity(joint.position, limit.min_position, limit.k_position, fastest)
        high = soft_velocity(joint.position, limit.max_position, limit.k_position, fastest)
    joint.command = effort_soft_limits(joint.command, joint.velocity, low, high, limit.k_velocity, limit.max_effort)


class LimitHandle:
    """Base of the limit handles. `enforce` rewrites `handle.command`; `reset` forgets earlier commands."""

    __slots__ = ("handle",)
    compiled: ClassVar[Compiled | None] = None

    def __init__(self, handle: JointHandle) -> None:
        self.handle = handle

    def enforce(self, period_s: float) -> None:
        """Put the command within the limits, given the seconds since the last call."""
        raise NotImplementedError

    def reset(self) -> None:
        """Be as on the first day."""

    def _needs(self, missing: str, has: bool) -> None:
        if not has:
            raise BadLimits(type(self).__name__, self.handle.name, missing)


class EffortJointSaturation(LimitHandle):
    """Clips effort, and allows none that pushes further beyond a position or velocity limit."""

    __slots__ = ("max_effort", "max_position", "max_velocity", "min_position")
    compiled = Compiled(
        "effort_saturation",
        Columns(fixed="min_position max_position max_velocity max_effort", places="joint", whole="joint"),
    )

    def __init__(self, handle: JointHandle, limits: JointLimits) -> None:
        super().__init__(handle)
        self._needs("velocity", limits.has_velocity_limits)
        self._needs("effort", limits.has_effort_limits)
        self.min_position = limits.min_position if limits.has_position_limits else -inf
        self.max_position = limits.max_position if limits.has_position_limits else inf
        self.max_velocity = limits.max_velocity
        self.max_effort = limits.max_effort

    def enforce(self, period_s: float) -> None:  # noqa: ARG002 - this law has no memory
        saturate_effort(self, self.handle)


class EffortJointSoftLimits(LimitHandle):
    """Effort that keeps the measured velocity within what the distance to the soft limits allows."""

    __slots__ = (
        "has_position_limits",
        "k_position",
        "k_velocity",
        "max_effort",
        "max_position",
        "max_velocity",
        "min_position",
    )
    compiled = Compiled(
        "effort_soft_limits",
        Columns(
            fixed="has_position_limits min_position max_position k_position k_velocity max_velocity max_effort",
            places="joint",
            whole="joint has_position_limits",
        ),
    )

    def __init__(self, handle: JointHandle, limits: JointLimits, soft: SoftJointLimits) -> None:
        super().__init__(handle)
        self._needs("velocity", limits.has_velocity_limits)
        self._needs("effort", limits.has_effort_limits)
        self.has_position_limits = limits.has_position_limits
        self.min_position, self.max_position = soft.min_position, soft.max_position
        self.k_position, self.k_velocity = soft.k_position, soft.k_velocity
        self.max_velocity = limits.max_velocity
        self.max_effort = limits.max_effort

    def enforce(self, period_s: float) -> None:  # noqa: ARG002 - this law has no memory
        slow_effort(self, self.handle)


class PositionJointSaturation(LimitHandle):
    """Clips position, and with a velocity limit its change per step. The first step is from the measured position."""

    __slots__ = ("_has_velocity_limits", "_max_position", "_max_velocity", "_min_position", "_previous")

    def __init__(self, handle: JointHandle, limits: JointLimits) -> None:
        super().__init__(handle)
        self._min_position = limits.min_position if limits.has_position_limits else -LARGEST
        self._max_position = limits.max_position if limits.has_position_limits else LARGEST
        self._has_velocity_limits = limits.has_velocity_limits
        self._max_velocity = limits.max_velocity
        self._previous = nan

    def enforce(self, period_s: float) -> None:
        handle, low, high = self.handle, self._min_position, self._max_position
        previous = self._previous
        if previous != previous:
            previous = handle.position
        if self._has_velocity_limits:
            step = self._max_velocity * period_s
            command = position_saturation(handle.command, previous, step, low, high)
        else:
            command = bounded(handle.command, low, high)
        handle.command = self._previous = command

    def reset(self) -> None:
        self._previous = nan


class PositionJointSoftLimits(LimitHandle):
    """Position that approaches its soft limits ever more slowly. The first step is from the measured position."""

    __slots__ = ("_limits", "_max_position", "_min_position", "_previous", "_soft")

    def __init__(self, handle: JointHandle, limits: JointLimits, soft: SoftJointLimits) -> None:
        super().__init__(handle)
        self._needs("velocity", limits.has_velocity_limits)
        self._min_position = limits.min_position if limits.has_position_limits else -inf
        self._max_position = limits.max_position if limits.has_position_limits else inf
        self._limits = limits
        self._soft = soft
        self._previous = nan

    def enforce(self, period_s: float) -> None:
        handle, limits = self.handle, self._limits
        previous = self._previous
        if previous != previous:
            previous = handle.position
        low, high = _soft_velocities(previous, limits, self._soft, limits.max_velocity)
        handle.command = self._previous = position_soft_limits(
            handle.command, previous, low, high, period_s, self._min_position, self._max_position
        )

    def reset(self) -> None:
        self._previous = nan


class VelocityJointSaturation(LimitHandle):
    """Clips velocity, and its change per step when there is an acceleration limit. The first step is from 0."""

    __slots__ = ("_has_acceleration_limits", "_max_acceleration", "_max_velocity", "_previous")

    def __init__(self, handle: JointHandle, limits: JointLimits) -> None:
        super().__init__(handle)
        self._needs("velocity", limits.has_velocity_limits)
        self._max_velocity = limits.max_velocity
        self._has_acceleration_limits = limits.has_acceleration_limits
        self._max_acceleration = limits.max_acceleration
        self._previous = 0.0

    def enforce(self, period_s: float) -> None:
        handle, fastest = self.handle, self._max_velocity
        if self._has_acceleration_limits:
            step = self._max_acceleration * period_s
            command = velocity_saturation(handle.command, self._previous, step, fastest)
        else:
            command = bounded(handle.command, -fastest, fastest)
        handle.command = self._previous = command

    def reset(self) -> None:
        self._previous = 0.0


class VelocityJointSoftLimits(LimitHandle):
    """Velocity that the distance to the soft limits allows, from the measured position and velocity."""

    __slots__ = ("_limits", "_max_velocity", "_soft")

    def __init__(self, handle: JointHandle, limits: JointLimits, soft: SoftJointLimits) -> None:
        super().__init__(handle)
        self._limits = limits
        self._soft = soft
        self._max_velocity = limits.max_velocity if limits.has_velocity_limits else LARGEST

    def enforce(self, period_s: float) -> None:
        handle, limits = self.handle, self._limits
        low, high = _soft_velocities(handle.position, limits, self._soft, self._max_velocity)
        if limits.has_acceleration_limits:
            step = limits.max_acceleration * period_s
            handle.command = velocity_soft_limits(handle.command, handle.velocity, step, low, high)
        else:
            handle.command = bounded(handle.command, low, high)


SATURATION: dict[str, type[EffortJointSaturation | PositionJointSaturation | VelocityJointSaturation]] = {
    "hardware_interface::EffortJointInterface": EffortJointSaturation,
    "hardware_interface::PositionJointInterface": PositionJointSaturation,
    "hardware_interface::VelocityJointInterface": VelocityJointSaturation,
}
SOFT_LIMITS: dict[str, type[EffortJointSoftLimits | PositionJointSoftLimits | VelocityJointSoftLimits]] = {
    "hardware_interface::EffortJointInterface": EffortJointSoftLimits,
    "hardware_interface::PositionJointInterface": PositionJointSoftLimits,
    "hardware_interface::VelocityJointInterface": VelocityJointSoftLimits,
}
ORDER: tuple[type[LimitHandle], ...] = (
    EffortJointSaturation,
    EffortJointSoftLimits,
    PositionJointSaturation,
    PositionJointSoftLimits,
    VelocityJointSaturation,
    VelocityJointSoftLimits,
)
"""The order in which gazebo_ros_control enforces kinds of limits; within a kind the joints are alphabetical."""


def limit_handle(
    interface: str, handle: JointHandle, limits: JointLimits, soft: SoftJointLimits | None = None
) -> LimitHandle:
    """The handle for a joint of that interface (`hardware_interface::X`): soft limits alone when there are some.

    Raises:
        BadLimits: the limits lack one that the handle needs.
    """
    if soft is not None:
        return SOFT_LIMITS[interface](handle, limits, soft)
    return SATURATION[interface](handle, limits)


def in_order(handles: Iterable[LimitHandle]) -> list[LimitHandle]:
    """The handles in the order in which they are to be enforced."""
    return sorted(handles, key=lambda limit: (ORDER.index(type(limit)), limit.handle.name))


def _soft_velocities(
    position: float, limits: JointLimits, soft: SoftJointLimits, max_velocity: float
) -> tuple[float, float]:
    """The lowest and the highest velocity that a position allows; soft limits count only beside hard ones."""
    if not limits.has_position_limits:
        return -max_velocity, max_velocity
    low = soft_velocity(position, soft.min_position, soft.k_position, max_velocity)
    high = soft_velocity(position, soft.max_position, soft.k_position, max_velocity)
    return low, high
