"""Measures against closed forms: the response of a second order system, a first order one, a sine, rectangles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from slidectl import measures
from slidectl.measures import NoMeasure

TIMES = np.arange(0.0, 20.0005, 0.001)


def second_order(damping: float, frequency: float = 2.0, delay: float = 0.0) -> Any:
    """The response to a step of 1 (Ogata, Modern Control Engineering, 5-3)."""
    t = np.maximum(TIMES - delay, 0.0)
    root = math.sqrt(1.0 - damping**2)
    damped = frequency * root
    return 1.0 - np.exp(-damping * frequency * t) * (np.cos(damped * t) + damping / root * np.sin(damped * t))


@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7])
@pytest.mark.parametrize(("begin", "size"), [(0.0, 1.0), (2.0, -0.3)])
def test_overshoot_and_its_peak_are_those_of_the_textbook(damping: float, begin: float, size: float) -> None:
    found = measures.overshoot(TIMES, begin + size * second_order(damping), begin + size)
    root = math.sqrt(1.0 - damping**2)
    assert found == pytest.approx(100.0 * math.exp(-math.pi * damping / root), rel=1e-5)
    assert found.time == pytest.approx(math.pi / (2.0 * root), abs=0.001)


def test_a_first_order_system_rises_and_settles_as_its_exponential_does() -> None:
    values = 1.0 - np.exp(-TIMES / 0.5)
    assert measures.rise_time(TIMES, values, 1.0) == pytest.approx(0.5 * math.log(9.0), abs=1e-6)
    settled = measures.settling_time(TIMES, values, 1.0, 0.0)
    assert settled == pytest.approx(0.5 * math.log(50.0), abs=1e-5)
    assert settled.time == float(settled)
    assert measures.settling_time(TIMES, values, 1.0, 0.0, band=0.05) == pytest.approx(0.5 * math.log(20.0), abs=1e-5)
    assert measures.overshoot(TIMES, values, 1.0) == 0.0


def test_the_settling_time_of_an_oscillation_is_that_of_its_last_way_out_of_the_band() -> None:
    found = measures.settling_time(TIMES, second_order(0.2), 1.0, 0.0)
    fine = np.linspace(0.0, 20.0, 2_000_001)
    root = math.sqrt(1.0 - 0.2**2)
    error = np.exp(-0.4 * fine) * np.abs(np.cos(2.0 * root * fine) + 0.2 / root * np.sin(2.0 * root * fine))
    assert found == pytest.approx(fine[error > 0.02][-1], abs=1e-4)


def test_a_step_begins_where_the_motion_does_unless_its_time_is_given() -> None:
    values = second_order(0.7, delay=3.0)
    found = measures.step(TIMES, values)
    assert (found.initial, found.final) == (0.0, pytest.approx(1.0))
    assert found.start == pytest.approx(3.0, abs=0.03)
    moved, known = measures.settling_time(TIMES, values), measures.settling_time(TIMES, values, start=2.5)
    assert moved.time == known.time
    assert known - moved == pytest.approx(found.start - 2.5)
    assert measures.rise_time(TIMES, values) == measures.rise_time(TIMES, values, start=2.5)


def test_what_never_gets_there_never_does() -> None:
    values = 0.5 * second_order(0.7)
    assert measures.rise_time(TIMES, values, 1.0) == math.inf
    assert measures.settling_time(TIMES, values, 1.0) == math.inf
    assert measures.overshoot(TIMES, values, 1.0) == 0.0
    assert measures.steady_state_error(TIMES, values, 1.0) == pytest.approx(0.5, abs=1e-9)


def test_errors_of_a_sine_are_those_of_its_integrals() -> None:
    times = np.linspace(0.0, 4.0 * math.pi, 20001)
    values = 3.0 + 0.5 * np.sin(times)
    assert measures.rms(times, values, 3.0) == pytest.approx(0.5 / math.sqrt(2.0), rel=1e-6)
    assert measures.integral_of_absolute_error(times, values, 3.0) == pytest.approx(4.0, rel=1e-6)
    largest = measures.peak(times, values, 3.0)
    assert (float(largest), largest.time) == (pytest.approx(0.5), pytest.approx(math.pi / 2, abs=1e-3))
    assert measures.peak(times, values, values) == 0.0
    assert measures.steady_state_error([0.0, 9.0, 10.0], [5.0, 1.0, 0.0], [5.0, 2.0, 2.0]) == 1.5


def test_integrals_are_exact_for_what_is_linear_between_uneven_samples() -> None:
    times, values = [0.0, 1.0, 4.0], [-1.0, 1.0, 1.0]
    assert measures.integral_of_absolute_error(times, values) == 3.5
    assert measures.rms(times, values) == pytest.approx(math.sqrt((1.0 / 3.0 + 3.0) / 4.0))
    assert measures.energy([0.0, 2.0], [0.0, 3.0], [0.0, 2.0]) == pytest.approx(4.0)  # 3/2 t · t from 0 to 2
    assert measures.energy([0.0, 2.0], [3.0, 3.0], [-1.0, -1.0]) == -6.0


def test_the_time_between_two_samples_is_that_of_the_line_through_them() -> None:
    times = [0.0, 1.0, 2.0, 3.0]
    assert measures.settling_time(times, [0.0, 1.10, 0.99, 1.0]) == pytest.approx(1.0 + 0.08 / 0.11)
    assert measures.settling_time(times, [0.0, 0.90, 1.01, 1.0]) == pytest.approx(1.0 + 0.08 / 0.11)
    error = measures.steady_state_error([0.0, 0.5, 1.0], [0.0, 0.0, 1.0], 1.0)
    assert (float(error), error.time) == pytest.approx((0.1, 0.9))


def test_times_of_saturation_and_contact_are_those_of_rectangles() -> None:
    times, force = [0.0, 1.0, 2.0, 4.0, 5.0], [0.0, 10.0, -10.0, 0.5, 0.0]
    saturated = measures.saturation_time(times, force, 10.0)
    assert (float(saturated), saturated.time) == (3.0, 1.0)
    assert measures.contact_time(times, force) == 4.0
    assert measures.contact_time(times, force, threshold=1.0) == 3.0
    assert measures.saturation_time(times, force, 11.0) == 0.0


def test_a_bound_is_hit_again_only_after_it_was_left() -> None:
    positions = [0.0, 0.5, 1.0, 0.9999, 1.0001, 0.5, -0.001, 0.5]
    hits = measures.limit_hits(range(8), positions, 0.0, 1.0)
    assert (float(hits), hits.time) == (2.0, 2.0)
    assert measures.limit_hits(range(8), positions, upper=1.5) == 0.0


@pytest.mark.parametrize(
    ("take", "said"),
    [
        (lambda: measures.overshoot([], []), "no samples"),
        (lambda: measures.overshoot([0, 1, 2], [1.0, 1.0, 1.0]), "no step"),
        (lambda: measures.rise_time([0, 1], [0.0, math.nan]), "at 1 s is nan"),
        (lambda: measures.rms([0, 1], [0.0, math.inf]), "at 1 s is inf"),
        (lambda: measures.rms([0, 1, 0.5], [0.0, 0.0, 0.0]), "go back"),
        (lambda: measures.rms([0, 1], [0.0]), "one for each"),
        (lambda: measures.settling_time([0, 1], [0.0, 1.0], start=3.0), "after the last sample"),
        (lambda: measures.saturation_time([0, 1], [0.0, 1.0], math.nan), "largest effort"),
        (lambda: measures.limit_hits([0, 1], [0.0, 1.0]), "bound"),
        (lambda: measures.overshoot([0, 1], [0.0, 1.0], math.nan), "set point is nan"),
        (lambda: measures.settling_time([0, 1], [0.0, 1.0], 1.0, math.nan), "start is nan"),
        (lambda: measures.settling_time([0, 1], [0.0, 1.0], band=math.nan), "band is nan"),
        (lambda: measures.contact_time([0, 1], [0.0, 1.0], math.nan), "threshold is nan"),
        (lambda: measures.limit_hits([0, 1], [0.0, 2.0], math.nan, 1.0), "bound"),
    ],
)
def test_what_does_not_suffice_is_said(take: Any, said: str) -> None:
    with pytest.raises(NoMeasure, match=said):
        take()


def test_one_sample_has_an_error_and_no_length() -> None:
    assert measures.rms([2.0], [0.5], 1.0) == 0.5
    assert measures.steady_state_error([2.0], [0.5], 1.0) == 0.5
    assert measures.energy([2.0], [1.0], [1.0]) == 0.0
