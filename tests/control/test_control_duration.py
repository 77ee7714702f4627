"""Durations round as ros::Duration does."""

import pytest

from slidectl.control.duration import BadDuration, from_seconds, to_seconds, to_stamp
from slidectl.errors import UsageError


def test_a_millisecond_is_a_million_nanoseconds():
    assert from_seconds(0.001) == 1_000_000
    assert to_seconds(1_000_000) == 0.001


def test_seconds_are_the_sum_of_two_parts_and_not_a_quotient():
    assert to_seconds(12_345_678_901) == 12 + 1e-9 * 345_678_901


def test_half_a_nanosecond_rounds_up_and_less_rounds_down():
    assert from_seconds(0.5e-9) == 1
    assert from_seconds(1.5e-9) == 2
    assert from_seconds(0.49e-9) == 0


def test_negative_durations_are_whole_seconds_down_and_nanoseconds_up():
    assert from_seconds(-0.01) == -10_000_000
    assert to_seconds(-10_000_000) == -1 + 1e-9 * 990_000_000


@pytest.mark.parametrize("seconds", [float("nan"), float("inf"), float("-inf"), 3e9])
def test_what_no_duration_can_hold_is_refused(seconds):
    with pytest.raises(BadDuration, match="not a valid duration"):
        from_seconds(seconds)
    assert issubclass(BadDuration, UsageError)


def test_a_stamp_has_seconds_and_nanoseconds():
    assert to_stamp(12_000_000_345) == {"secs": 12, "nsecs": 345}
