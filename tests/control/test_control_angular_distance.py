"""Angles and the turns between them, by the rules of ros/angles."""

from math import cos, inf, isnan, nan, pi, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slidectl.control.angular_distance import (
    distance_with_large_limits,
    distance_with_limits,
    min_max_turn,
    normalize_angle,
    shortest_angular_distance,
    two_pi_complement,
)


@pytest.mark.parametrize(
    ("angle", "normal"),
    [(0.0, 0.0), (pi, pi), (-pi, pi), (3 * pi, pi), (pi / 2 + 2 * pi, pi / 2), (-3 * pi / 2, pi / 2)],
)
def test_normal_angles_lie_above_minus_pi_and_up_to_pi(angle, normal):
    assert normalize_angle(angle) == pytest.approx(normal)


@pytest.mark.parametrize("angle", [nan, inf, -inf])
def test_what_is_not_finite_has_no_normal_angle(angle):
    assert isnan(normalize_angle(angle))


def test_the_shortest_turn_crosses_the_back_of_the_circle():
    assert shortest_angular_distance(pi - 0.1, -pi + 0.1) == pytest.approx(0.2)
    assert shortest_angular_distance(0.0, 7.0) == pytest.approx(7.0 - 2 * pi)


@pytest.mark.parametrize(
    ("angle", "other"), [(1.0, 1.0 - 2 * pi), (-1.0, 2 * pi - 1.0), (0.0, 2 * pi), (7.0, 7.0 - 4 * pi)]
)
def test_the_complement_turns_the_other_way_round(angle, other):
    assert two_pi_complement(angle) == pytest.approx(other)


def test_large_limits_allow_the_short_way_over_the_back():
    assert distance_with_large_limits(0.0, 6.0, -6.3, 6.3) == pytest.approx(6.0 - 2 * pi)
    assert distance_with_large_limits(0.0, 10.5 * pi, -2 * pi, 2 * pi) == pytest.approx(0.5 * pi)


def test_large_limits_turn_the_long_way_when_the_short_one_leaves_them():
    assert distance_with_large_limits(-1.9, 1.9, -2.0, 2.0) == pytest.approx(3.8)
    assert distance_with_large_limits(0.0, 10.5 * pi, -2 * pi, 0.1 * pi) == pytest.approx(-1.5 * pi)


def test_large_limits_that_no_turn_satisfies_give_the_short_one():
    assert distance_with_large_limits(0.0, 3.0, -1.0, 1.0) == pytest.approx(3.0)
    assert distance_with_large_limits(0.0, 1.0, 2.0, -2.0) == pytest.approx(1.0)


def test_turns_to_the_limits_of_a_place_within_them():
    inside, down, up = min_max_turn(0.5, -1.0, 2.0)
    assert inside
    assert (down, up) == (pytest.approx(-1.5), pytest.approx(1.5))


def test_turns_to_the_limits_of_a_place_outside_them():
    inside, down, up = min_max_turn(-2.0, -1.0, 1.0)
    assert not inside
    assert (down, up) == (pytest.approx(3.0 - 2 * pi), pytest.approx(1.0))


def test_turns_from_a_limit_itself_begin_with_zero():
    assert min_max_turn(-1.0, -1.0, 1.0)[:2] == (True, 0.0)
    inside, _, up = min_max_turn(1.0, -1.0, 1.0)
    assert (inside, up) == (True, 0.0)


def test_the_whole_circle_as_limits_contains_everything():
    assert min_max_turn(3.0, -pi, pi)[0]


@pytest.mark.parametrize(
    ("start", "end", "turn"),
    [
        (0.5, -0.5, -1.0),
        (-0.9, 0.9, 1.8),
        # The end lies outside: towards the limit that is nearer to it, without crossing the gap.
        (0.0, 2.0, 2.0),
        (0.0, -2.0, -2.0),
        # The start lies outside: back over the nearer limit.
        (1.5, 0.0, -1.5),
        (-1.5, 0.0, 1.5),
    ],
)
def test_limits_on_the_circle_are_not_crossed(start, end, turn):
    assert distance_with_limits(start, end, -1.0, 1.0) == pytest.approx(turn)


def test_limits_on_the_circle_may_enclose_its_back():
    assert distance_with_limits(-0.5, 0.5, 0.25, -0.25) == pytest.approx(1.0 - 2 * pi)


def test_limits_beyond_pi_are_folded_onto_the_circle():
    assert distance_with_large_limits(0.5, -1.0, -4.0, 4.0) == pytest.approx(-1.5)
    assert distance_with_limits(0.5, -1.0, -4.0, 4.0) == pytest.approx(2 * pi - 1.5)


angles = st.floats(-20.0, 20.0)


@settings(deadline=None)
@given(angles, angles, angles, angles)
def test_whatever_the_limits_a_turn_leads_to_the_end(start, end, one, other):
    lower, upper = sorted((one, other))
    for turn in (
        shortest_angular_distance(start, end),
        distance_with_large_limits(start, end, lower, upper),
        distance_with_limits(start, end, lower, upper),
    ):
        assert cos(start + turn) == pytest.approx(cos(end), abs=1e-9)
        assert sin(start + turn) == pytest.approx(sin(end), abs=1e-9)


@settings(deadline=None)
@given(angles, angles, angles, angles)
def test_large_limits_are_left_only_when_both_ways_leave_them(start, end, one, other):
    lower, upper = sorted((one, other))
    turn = distance_with_large_limits(start, end, lower, upper)
    if not lower <= start + turn <= upper:
        both = {shortest_angular_distance(start, end), two_pi_complement(shortest_angular_distance(start, end))}
        assert not any(lower <= start + way <= upper for way in both)
