"""What joint limits make of a command: the formulas of joint_limits_interface (ros_control 0.20), to the bit.

Pure arithmetic on floats, each law once. Units are those of the joint (m or rad, and per s); `dt` in s.
The order of comparisons is part of the law: it decides what becomes of nan and of bounds the wrong way round.
"""

from __future__ import annotations

from slidectl.control.laws import law

LARGEST = 1.7976931348623157e308
"""The bound where there is none (DBL_MAX)."""


@law
def bounded(value: float, lower: float, upper: float) -> float:
    """min(max(value, lower), upper): with bounds the wrong way round it is `upper`; nan stays nan."""
    if value < lower:
        value = lower
    if upper < value:
        value = upper
    return value


@law
def effort_saturation(
    command: float,
    position: float,
    velocity: float,
    min_position: float,
    max_position: float,
    max_velocity: float,
    max_effort: float,
) -> float:
    """At most `max_effort`, and none that pushes further beyond a position or velocity limit.

    Without position limits give -inf and inf.
    """
    lower = -max_effort
    upper = max_effort
    if position < min_position:
        lower = 0.0
    elif position > max_position:
        upper = 0.0
    if velocity < -max_velocity:
        lower = 0.0
    elif velocity > max_velocity:
        upper = 0.0
    return bounded(command, lower, upper)


@law
def effort_soft_limits(
    command: float,
    velocity: float,
    min_velocity: float,
    max_velocity: float,
    k_velocity: float,
    max_effort: float,
) -> float:
    """Effort that lets the velocity settle between the two bounds."""
    lower = bounded(-k_velocity * (velocity - min_velocity), -max_effort, max_effort)
    upper = bounded(-k_velocity * (velocity - max_velocity), -max_effort, max_effort)
    return bounded(command, lower, upper)


@law
def soft_velocity(position: float, soft_limit: float, k_position: float, max_velocity: float) -> float:
    """The velocity at which a joint may still move towards (or must move back to) its soft limit."""
    return bounded(-k_position * (position - soft_limit), -max_velocity, max_velocity)


@law
def within_step(command: float, start: float, step: float, lowest: float, highest: float) -> float:
    """At most one `step` from where it starts, and within the two bounds."""
    lower = start - step
    upper = start + step
    if lower < lowest:
        lower = lowest
    if highest < upper:
        upper = highest
    return bounded(command, lower, upper)


@law
def position_saturation(
    command: float, previous: float, step: float, min_position: float, max_position: float
) -> float:
    """Within the position limits, and within one `step` (velocity limit times dt) of the previous command."""
    return within_step(command, previous, step, min_position, max_position)


@law
def position_soft_limits(
    command: float,
    previous: float,
    min_velocity: float,
    max_velocity: float,
    dt: float,
    min_position: float,
    max_position: float,
) -> float:
    """Between the places that the velocity bounds reach within dt, and within the hard position limits."""
    lower = previous + min_velocity * dt
    upper = previous + max_velocity * dt
    if lower < min_position:
        lower = min_position
    if max_position < upper:
        upper = max_position
    return bounded(command, lower, upper)


@law
def velocity_saturation(command: float, previous: float, step: float, max_velocity: float) -> float:
    """Within the velocity limit, and within one `step` (acceleration limit times dt) of the previous command."""
    return within_step(command, previous, step, -max_velocity, max_velocity)


@law
def velocity_soft_limits(
    command: float, velocity: float, step: float, min_velocity: float, max_velocity: float
) -> float:
    """Within the velocity bounds, and within one `step` (acceleration limit times dt) of the measured velocity."""
    return within_step(command, velocity, step, min_velocity, max_velocity)
