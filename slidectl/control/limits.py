"""Joint limit handles: each watches one joint and rewrites its command in place, once a step.

The six handles of joint_limits_interface around the laws of `limit_steps.py`. Saturation handles clip to hard
limits; soft limit handles slow the joint down before it gets there.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, nan
from typing import ClassVar

from slidectl.control.handles import JointHandle
from slidectl.control.joint_limits import JointLimits, SoftJointLimits
from slidectl.control.laws import Columns
from slidectl.control.limit_laws import LARGEST
from slidectl.control.limit_steps import (
    EFFORT_SATURATION,
    EFFORT_SOFT,
    POSITION_SATURATION,
    POSITION_SOFT,
    VELOCITY_SATURATION,
    VELOCITY_SOFT,
    saturate_effort,
    saturate_position,
    saturate_velocity,
    slow_effort,
    slow_position,
    slow_velocity,
)
from slidectl.errors import Refused


class BadLimits(Refused):
    """Limits that a handle cannot work with."""

    def __init__(self, handle: str, joint: str, missing: str) -> None:
        super().__init__(f"joint {joint!r} has no {missing} limit, which {handle} needs")


class LimitHandle:
    """Base of the limit handles. `enforce` rewrites `handle.command`; `reset` forgets earlier commands."""

    __slots__ = (
        "handle",
        "has_acceleration_limits",
        "has_position_limits",
        "has_velocity_limits",
        "k_position",
        "k_velocity",
        "max_acceleration",
        "max_effort",
        "max_position",
        "max_velocity",
        "min_position",
        "previous",
        "soft_lower",
        "soft_upper",
    )
    kind: ClassVar[int]
    needs: ClassVar[tuple[str, ...]] = ()
    """The limits without which it cannot work, of `velocity` and `effort`."""
    farthest: ClassVar[float] = inf
    """The position limit where there is none."""
    fresh: ClassVar[float] = 0.0
    """The command before the first."""
    columns = Columns(
        changing="previous",
        fixed="kind min_position max_position soft_lower soft_upper has_position_limits has_velocity_limits "
        "has_acceleration_limits k_position k_velocity max_velocity max_acceleration max_effort",
        places="joint",
        whole="kind has_position_limits has_velocity_limits has_acceleration_limits joint",
    )

    def __init__(self, handle: JointHandle, limits: JointLimits, soft: SoftJointLimits | None = None) -> None:
        """Raises BadLimits: one of those that it needs is missing."""
        self.handle = handle
        for missing in self.needs:
            if not getattr(limits, f"has_{missing}_limits"):
                raise BadLimits(type(self).__name__, handle.name, missing)
        self._take_hard(limits)
        self._take_soft(soft or SoftJointLimits())
        self.reset()

    def _take_hard(self, limits: JointLimits) -> None:
        self.has_position_limits = limits.has_position_limits
        self.has_velocity_limits = limits.has_velocity_limits
        self.has_acceleration_limits = limits.has_acceleration_limits
        self.min_position = limits.min_position if limits.has_position_limits else -self.farthest
        self.max_position = limits.max_position if limits.has_position_limits else self.farthest
        self.max_velocity = limits.max_velocity if limits.has_velocity_limits else LARGEST
        self.max_acceleration = limits.max_acceleration
        self.max_effort = limits.max_effort

    def _take_soft(self, soft: SoftJointLimits) -> None:
        self.soft_lower, self.soft_upper = soft.min_position, soft.max_position
        self.k_position, self.k_velocity = soft.k_position, soft.k_velocity

    def enforce(self, period_s: float) -> None:
        """Put the command within the limits, given the seconds since the last call."""
        raise NotImplementedError

    def command_bounds(self) -> tuple[float, float]:
        """The lowest and the highest command that may ever be let through, whatever the joint does."""
        raise NotImplementedError

    def reset(self) -> None:
        """Be as on the first day."""
        self.previous = self.fresh


class EffortJointSaturation(LimitHandle):
    """Clips effort, and allows none that pushes further beyond a position or velocity limit."""

    __slots__ = ()
    kind = EFFORT_SATURATION
    needs = ("velocity", "effort")

    def enforce(self, period_s: float) -> None:  # noqa: ARG002 - this law has no memory
        saturate_effort(self, self.handle)

    def command_bounds(self) -> tuple[float, float]:
        return -self.max_effort, self.max_effort


class EffortJointSoftLimits(LimitHandle):
    """Effort that keeps the measured velocity within what the distance to the soft limits allows."""

    __slots__ = ()
    kind = EFFORT_SOFT
    needs = ("velocity", "effort")

    def enforce(self, period_s: float) -> None:  # noqa: ARG002 - this law has no memory
        slow_effort(self, self.handle)

    def command_bounds(self) -> tuple[float, float]:
        return -self.max_effort, self.max_effort


class PositionJointSaturation(LimitHandle):
    """Clips position, and with a velocity limit its change per step. The first step is from the measured position."""

    __slots__ = ()
    kind = POSITION_SATURATION
    farthest = LARGEST
    fresh = nan

    def enforce(self, period_s: float) -> None:
        saturate_position(self, self.handle, period_s)

    def command_bounds(self) -> tuple[float, float]:
        return self.min_position, self.max_position


class PositionJointSoftLimits(LimitHandle):
    """Position that approaches its soft limits ever more slowly. The first step is from the measured position."""

    __slots__ = ()
    kind = POSITION_SOFT
    needs = ("velocity",)
    fresh = nan

    def enforce(self, period_s: float) -> None:
        slow_position(self, self.handle, period_s)

    def command_bounds(self) -> tuple[float, float]:
        return self.min_position, self.max_position


class VelocityJointSaturation(LimitHandle):
    """Clips velocity, and its change per step when there is an acceleration limit. The first step is from 0."""

    __slots__ = ()
    kind = VELOCITY_SATURATION
    needs = ("velocity",)

    def enforce(self, period_s: float) -> None:
        saturate_velocity(self, self.handle, period_s)

    def command_bounds(self) -> tuple[float, float]:
        return -self.max_velocity, self.max_velocity


class VelocityJointSoftLimits(LimitHandle):
    """Velocity that the distance to the soft limits allows, from the measured position and velocity."""

    __slots__ = ()
    kind = VELOCITY_SOFT

    def enforce(self, period_s: float) -> None:
        slow_velocity(self, self.handle, period_s)

    def command_bounds(self) -> tuple[float, float]:
        return -self.max_velocity, self.max_velocity


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
    return sorted(handles, key=lambda limit: (limit.kind, limit.handle.name))
