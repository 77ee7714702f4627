"""Differences of angles on the circle, with and without limits: the functions of ros/angles 1.9.13.

Pure arithmetic, angles in radians. Names follow ros/angles. The functions treat limits wider than ±π differently.
"""

from __future__ import annotations

from math import fmod, isfinite, nan, pi

from slidectl.control.laws import law

TWO_PI = 2.0 * pi


@law
def normalize_angle(angle: float) -> float:
    """The same angle in (-π, π]; both -π and π become π. nan when it is not finite."""
    turned = angle + pi
    if 0.0 < turned < TWO_PI:  # fmod would return it unchanged, but takes longer
        return turned - pi
    if not isfinite(angle):
        return nan
    turned = fmod(turned, TWO_PI)
    return turned + pi if turned <= 0.0 else turned - pi


@law
def shortest_angular_distance(start: float, end: float) -> float:
    """The turn in (-π, π] that leads from `start` to `end`."""
    return normalize_angle(end - start)


@law
def unwrapped(position: float, angle: float) -> float:
    """The position nearest to `position` that equals `angle` modulo 2π. nan when an argument is infinite."""
    return position + shortest_angular_distance(position, angle)


@law
def two_pi_complement(angle: float) -> float:
    """The turn in the opposite direction that ends at the same angle."""
    if angle > TWO_PI or angle < -TWO_PI:
        angle = fmod(angle, TWO_PI) if isfinite(angle) else nan
    if angle < 0.0:
        return TWO_PI + angle
    if angle > 0.0:
        return angle - TWO_PI
    return TWO_PI


@law
def distance_with_large_limits(start: float, end: float, lower: float, upper: float) -> float:
    """The shortest turn from `start` to `end` that stays within the limits; limits may span many turns.

    The shortest turn when neither direction stays within them. Limits are not modulo 2π: a joint may make many turns.
    """
    delta = shortest_angular_distance(start, end)
    other = two_pi_complement(delta)
    if abs(delta) > abs(other):
        delta, other = other, delta
    if lower > upper or lower <= start + delta <= upper:
        return delta
    return other if lower <= start + other <= upper else delta


@law
def min_max_turn(angle: float, lower: float, upper: float) -> tuple[bool, float, float]:
    """(is `angle` within the limits, the largest turn down, the largest turn up), all on the circle.

    Outside the limits the two turns lead to the nearest limit on either side.
    """
    to_lower = shortest_angular_distance(angle, lower)
    to_upper = shortest_angular_distance(angle, upper)
    to_lower_round = two_pi_complement(to_lower)
    to_upper_round = two_pi_complement(to_upper)
    if to_lower == 0.0:
        return True, to_lower, max(to_upper, to_upper_round)
    if to_upper == 0.0:
        return True, min(to_lower, to_lower_round), to_upper
    down, down_far = (to_lower_round, to_lower) if to_lower_round < to_lower else (to_lower, to_lower_round)
    up, up_far = (to_upper_round, to_upper) if to_upper_round > to_upper else (to_upper, to_upper_round)
    if down <= up_far or up >= down_far:
        return lower == -pi and upper == pi, up_far, down_far
    return True, down, up


@law
def distance_with_limits(start: float, end: float, lower: float, upper: float) -> float:
    """The turn from `start` to `end` that does not cross the limits; these lie on the circle (modulo 2π).

    When no turn is valid, the one towards the permitted range.
    """
    inside, down, up = min_max_turn(start, lower, upper)
    delta = shortest_angular_distance(start, end)
    other = two_pi_complement(delta)
    if inside:
        if down <= delta <= up:
            return delta
        if down <= other <= up:
            return other
        _, down, up = min_max_turn(end, lower, upper)
        # Outside the limits the nearer limit is the one that was crossed, so turn away from it.
        down, up = up, down
    if abs(down) < abs(up):
        return min(delta, other)
    if abs(down) > abs(up):
        return max(delta, other)
    return delta if abs(delta) < abs(other) else other
