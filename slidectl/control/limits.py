"""Limits of joints: reading them, and enforcing them on commands.

After joint_limits_interface (ros_control 0.20), to the bit. Saturation clips to hard limits; soft limits slow the
joint down before it gets there. Units are those of the joint (m or rad, and per s).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from math import inf, nan
from typing import Any, ClassVar, NamedTuple

from slidectl.control import params
from slidectl.control.hardware_interface import JointCommands, JointHandle
from slidectl.control.laws import Columns, law
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import BOOLEAN, NUMBER, Parameter
from slidectl.description.interfaces import Quantity
from slidectl.description.robot import Joint
from slidectl.errors import Refused

LARGEST = 1.7976931348623157e308
"""The bound where there is no limit (DBL_MAX)."""


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Positions in m or rad, velocity in m/s or rad/s and so on, effort in N or N·m. Flags tell which limits count."""

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
    Parameter("has_position_limits", BOOLEAN, "true: min_position and max_position apply; false: no limits"),
    Parameter("min_position", NUMBER, "least position", "m or rad"),
    Parameter("max_position", NUMBER, "largest position", "m or rad"),
    Parameter("has_velocity_limits", BOOLEAN, "true: max_velocity applies; false: no limit"),
    Parameter("max_velocity", NUMBER, "largest velocity", "m/s or rad/s"),
    Parameter("has_acceleration_limits", BOOLEAN, "true: max_acceleration applies; false: no limit"),
    Parameter("max_acceleration", NUMBER, "largest acceleration", "m/s² or rad/s²"),
    Parameter("has_jerk_limits", BOOLEAN, "true: max_jerk applies; false: no limit"),
    Parameter("max_jerk", NUMBER, "largest jerk", "m/s³ or rad/s³"),
    Parameter("has_effort_limits", BOOLEAN, "true: max_effort applies; false: no limit"),
    Parameter("max_effort", NUMBER, "largest effort", "N or N·m"),
    Parameter("angle_wraparound", BOOLEAN, "the joint turns without limits"),
    Parameter("has_soft_limits", BOOLEAN, "the four values of soft limits apply"),
    Parameter("soft_lower_limit", NUMBER, "lower soft limit", "m or rad"),
    Parameter("soft_upper_limit", NUMBER, "upper soft limit", "m or rad"),
    Parameter("k_position", NUMBER, "velocity allowed per distance to the soft limit", "1/s"),
    Parameter("k_velocity", NUMBER, "effort allowed per velocity left", "N·s/m or N·m·s/rad"),
)
"""The parameters of `joint_limits/<joint>`, as joint_limits_interface reads them."""

_BOUNDS = (
    ("has_position_limits", "min_position", "max_position"),
    ("has_velocity_limits", "max_velocity"),
    ("has_acceleration_limits", "max_acceleration"),
    ("has_jerk_limits", "max_jerk"),
    ("has_effort_limits", "max_effort"),
)
"""Each flag, and the values that it requires."""


def limits_from_joint(joint: Joint, base: JointLimits = NO_LIMITS) -> JointLimits | None:
    """`base` with the values of `<limit>`; None without `<limit>`. The jerk limit stays that of `base`."""
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
    """The soft limits of `<safety_controller>`; None without it."""
    safety = joint.safety
    if safety is None:
        return None
    return SoftJointLimits(safety.soft_lower_limit, safety.soft_upper_limit, safety.k_position, safety.k_velocity)


def limits_from_parameters(node: NodeHandle, joint: str, base: JointLimits = NO_LIMITS) -> JointLimits | None:
    """`base` with the parameters `joint_limits/<joint>/*`; None when none is set.

    A group counts only with its flag; a true flag without its values changes nothing.
    """
    where = f"joint_limits/{joint}"
    if not node.has_param(where):
        return None
    changes: dict[str, Any] = {}
    for flag, *bounds in _BOUNDS:
        has = params.read(node, f"{where}/{flag}", BOOLEAN)
        values = [params.read(node, f"{where}/{bound}", NUMBER) for bound in bounds] if has else []
        if has is False:
            changes[flag] = False
        elif has and None not in values:
            changes |= {flag: True, **dict(zip(bounds, values, strict=True))}
    if changes.get("has_position_limits") is False:
        wraparound = params.read(node, f"{where}/angle_wraparound", BOOLEAN)
        changes |= {} if wraparound is None else {"angle_wraparound": wraparound}
    return replace(base, **changes)


def soft_limits_from_parameters(node: NodeHandle, joint: str) -> SoftJointLimits | None:
    """The soft limits at `joint_limits/<joint>`; None unless `has_soft_limits` is true and all four values are set."""
    where = f"joint_limits/{joint}"
    if not params.read(node, f"{where}/has_soft_limits", BOOLEAN):
        return None
    names = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")
    values = [params.read(node, f"{where}/{name}", NUMBER) for name in names]
    return None if None in values else SoftJointLimits(*(value for value in values if value is not None))


# Laws that enforce a limit on a command. They work on a limit handle and its joint, or on their rows. The formulas are
# those of joint_limits_interface (ros_control 0.20). Do not change the order of the comparisons: it decides the result
# for nan and for bounds in the wrong order. Comparisons are inline, since calls cost most in the interpreter.


@law
def bounded(value: float, lower: float, upper: float) -> float:
    """min(max(value, lower), upper). `upper` when lower > upper; nan stays nan."""
    if value < lower:
        value = lower
    if upper < value:
        value = upper
    return value


@law
def bounded_twice(value: float, lower: float, upper: float, lowest: float, highest: float) -> float:
    """The value clipped to `lower` and `upper`, after these are clipped to `lowest` and `highest`."""
    if lower < lowest:
        lower = lowest
    if highest < upper:
        upper = highest
    if value < lower:
        value = lower
    if upper < value:
        value = upper
    return value


@law
def soft_velocities(limit: LimitHandle, position: float) -> tuple[float, float]:
    """The lowest and the highest velocity that a position allows. Soft limits count only together with hard limits."""
    fastest = limit.max_velocity
    if not limit.has_position_limits:
        return -fastest, fastest
    low = bounded(-limit.k_position * (position - limit.soft_lower), -fastest, fastest)
    high = bounded(-limit.k_position * (position - limit.soft_upper), -fastest, fastest)
    return low, high


@law
def saturate_effort(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:  # noqa: ARG001 - it has no memory
    """Clip the effort to the largest one. Towards a position or velocity limit that is exceeded, the bound is 0."""
    lower = -limit.max_effort
    upper = limit.max_effort
    if joint.position < limit.min_position:
        lower = 0.0
    elif joint.position > limit.max_position:
        upper = 0.0
    if joint.velocity < -limit.max_velocity:
        lower = 0.0
    elif joint.velocity > limit.max_velocity:
        upper = 0.0
    joint.command = bounded(joint.command, lower, upper)


@law
def soften_effort(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:  # noqa: ARG001 - it has no memory
    """Clip the effort so that the velocity converges to the range that the position allows."""
    slowest, fastest = soft_velocities(limit, joint.position)
    most = limit.max_effort
    lower = bounded(-limit.k_velocity * (joint.velocity - slowest), -most, most)
    upper = bounded(-limit.k_velocity * (joint.velocity - fastest), -most, most)
    joint.command = bounded(joint.command, lower, upper)


@law
def saturate_position(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Clip the position to the limits and, with a velocity limit, to one step from the previous command."""
    if limit.has_velocity_limits:
        previous = joint.position if limit.previous != limit.previous else limit.previous
        step = limit.max_velocity * period_s
        limit.previous = bounded_twice(
            joint.command, previous - step, previous + step, limit.min_position, limit.max_position
        )
    else:
        limit.previous = bounded(joint.command, limit.min_position, limit.max_position)
    joint.command = limit.previous


@law
def soften_position(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Clip the position to the range that the allowed velocities reach, and to the hard position limits."""
    previous = joint.position if limit.previous != limit.previous else limit.previous
    slowest, fastest = soft_velocities(limit, previous)
    lower, upper = previous + slowest * period_s, previous + fastest * period_s
    limit.previous = bounded_twice(joint.command, lower, upper, limit.min_position, limit.max_position)
    joint.command = limit.previous


@law
def saturate_velocity(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Clip the velocity to the limit and, with an acceleration limit, to one step from the previous command."""
    fastest = limit.max_velocity
    if limit.has_acceleration_limits:
        step = limit.max_acceleration * period_s
        limit.previous = bounded_twice(joint.command, limit.previous - step, limit.previous + step, -fastest, fastest)
    else:
        limit.previous = bounded(joint.command, -fastest, fastest)
    joint.command = limit.previous


@law
def soften_velocity(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Clip to the allowed velocities and, with an acceleration limit, to one step from the measured velocity."""
    slowest, fastest = soft_velocities(limit, joint.position)
    if limit.has_acceleration_limits:
        step = limit.max_acceleration * period_s
        joint.command = bounded_twice(joint.command, joint.velocity - step, joint.velocity + step, slowest, fastest)
    else:
        joint.command = bounded(joint.command, slowest, fastest)


class LimitKind(NamedTuple):
    """One kind of limit: its name in joint_limits_interface, its law, what it requires and its initial state."""

    name: str
    law: Callable[[LimitHandle, JointHandle, float], None]
    needs: tuple[str, ...] = ()
    """The limits that it requires, of `velocity` and `effort`."""
    farthest: float = inf
    """The position limit of a joint without one."""
    initial: float = 0.0
    """The previous command before the first one; nan stands for the measured position."""


LIMIT_KINDS = (
    LimitKind("EffortJointSaturation", saturate_effort, ("velocity", "effort")),
    LimitKind("EffortJointSoftLimits", soften_effort, ("velocity", "effort")),
    LimitKind("PositionJointSaturation", saturate_position, farthest=LARGEST, initial=nan),
    LimitKind("PositionJointSoftLimits", soften_position, ("velocity",), initial=nan),
    LimitKind("VelocityJointSaturation", saturate_velocity, ("velocity",)),
    LimitKind("VelocityJointSoftLimits", soften_velocity),
)
"""In the order in which gazebo_ros_control enforces them; within a kind the joints are alphabetical."""
(
    EFFORT_SATURATION,
    EFFORT_SOFT,
    POSITION_SATURATION,
    POSITION_SOFT,
    VELOCITY_SATURATION,
    VELOCITY_SOFT,
) = range(len(LIMIT_KINDS))
_SATURATION: dict[Quantity, int] = {
    "effort": EFFORT_SATURATION,
    "position": POSITION_SATURATION,
    "velocity": VELOCITY_SATURATION,
}
"""The saturation kind for commands of each quantity; the next index is the kind of soft limits."""


@law
def enforce(limit: LimitHandle, joint: JointHandle, period_s: float) -> None:
    """Enforce a limit on the command of the joint. For rows; a handle calls its law directly."""
    if limit.kind == EFFORT_SATURATION:
        saturate_effort(limit, joint, period_s)
    elif limit.kind == EFFORT_SOFT:
        soften_effort(limit, joint, period_s)
    elif limit.kind == POSITION_SATURATION:
        saturate_position(limit, joint, period_s)
    elif limit.kind == POSITION_SOFT:
        soften_position(limit, joint, period_s)
    elif limit.kind == VELOCITY_SATURATION:
        saturate_velocity(limit, joint, period_s)
    else:
        soften_velocity(limit, joint, period_s)


class LimitHandle:
    """Enforces one kind of limit on the command of one joint, once per step, in place."""

    saved_attributes: ClassVar[tuple[str, ...]] = ("previous",)

    columns = Columns(
        changing="previous",
        fixed="kind min_position max_position soft_lower soft_upper has_position_limits has_velocity_limits "
        "has_acceleration_limits k_position k_velocity max_velocity max_acceleration max_effort",
        places="joint",
        whole="kind has_position_limits has_velocity_limits has_acceleration_limits joint",
    )

    def __init__(
        self, kind: int, handle: JointHandle, limits: JointLimits, soft: SoftJointLimits | None = None
    ) -> None:
        """Raises Refused when a limit that the kind requires is missing."""
        of_kind = LIMIT_KINDS[kind]
        for missing in of_kind.needs:
            if not getattr(limits, f"has_{missing}_limits"):
                raise Refused(f"joint {handle.name!r} has no {missing} limit, which {of_kind.name} needs")
        self.kind = kind
        self.handle = handle
        self.enforce: Callable[[float], None] = partial(of_kind.law, self, handle)
        """Enforces the limit; the argument is the seconds since the last call. Bound to the law directly: hot path."""
        self.has_position_limits = limits.has_position_limits
        self.has_velocity_limits = limits.has_velocity_limits
        self.has_acceleration_limits = limits.has_acceleration_limits
        self.min_position = limits.min_position if limits.has_position_limits else -of_kind.farthest
        self.max_position = limits.max_position if limits.has_position_limits else of_kind.farthest
        self.max_velocity = limits.max_velocity if limits.has_velocity_limits else LARGEST
        self.max_acceleration = limits.max_acceleration
        self.max_effort = limits.max_effort
        soft = soft or SoftJointLimits()
        self.soft_lower, self.soft_upper = soft.min_position, soft.max_position
        self.k_position, self.k_velocity = soft.k_position, soft.k_velocity
        self.reset()

    def command_bounds(self) -> tuple[float, float]:
        """The lowest and the highest command that the limit can ever leave, in any state of the joint."""
        if self.kind in (POSITION_SATURATION, POSITION_SOFT):
            return self.min_position, self.max_position
        most = self.max_effort if self.kind in (EFFORT_SATURATION, EFFORT_SOFT) else self.max_velocity
        return -most, most

    def reset(self) -> None:
        """Discard the previous command."""
        self.previous = LIMIT_KINDS[self.kind].initial


def limit_handle(
    interface: type[JointCommands],
    handle: JointHandle,
    limits: JointLimits,
    soft: SoftJointLimits | None = None,
) -> LimitHandle:
    """The limit handle for a joint of that interface. With soft limits, it enforces the soft kind only.

    Raises:
        Refused: a limit that the handle requires is missing.
    """
    return LimitHandle(_SATURATION[interface.declared.quantity] + (soft is not None), handle, limits, soft)


def in_order(handles: Iterable[LimitHandle]) -> list[LimitHandle]:
    """The handles in the order of enforcement."""
    return sorted(handles, key=lambda limit: (limit.kind, limit.handle.name))
