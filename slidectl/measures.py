"""Measures of a motion: step response, errors, efforts, contact. See docs/measures.md.

All functions take arrays: `times` in s, rising, and values of the same length (n,). Values are linear between two
samples. Where a force or an effort is compared with a threshold, a sample holds until the next one. Each function
returns a `Measured`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from slidectl.errors import Refused

Array = np.ndarray[Any, np.dtype[np.float64]]

LOW, HIGH = 0.1, 0.9
"""Rise time is from 10 % to 90 % of the step."""
BAND = 0.02
"""Half the width of the settling band, as a part of the step."""
END = 0.1
"""The last part of the time, over which the steady-state error is the mean."""
SATURATED = 0.999
"""An effort counts as saturated from this part of its limit on."""
NEAR_LIMIT = 1e-3
"""The distance from a bound beyond which a joint can hit the bound again, m or rad."""
_MOVED = 1e-3
"""The motion begins when the value has moved by this part of the step."""
_NO_STEP = 1e-9


class NoMeasure(Refused):
    """There are not enough samples for the measure."""


class Measured(float):
    """The value of a measure. `time` is when it occurred, in s; nan for a measure of the whole time."""

    time: float

    def __new__(cls, value: float, time: float = math.nan) -> Measured:
        made = super().__new__(cls, value)
        made.time = float(time)
        return made


def measure_text(value: float, unit: str) -> str:
    """The measure as text; `never` for inf."""
    return "never" if value == math.inf else f"{value:.6g} {unit}".rstrip()


def samples(times: Any, *values: Any) -> tuple[Array, ...]:
    """Times and values as arrays (n,). A single number stands for a constant value.

    Raises:
        NoMeasure: no samples, different lengths, times that go back, or a number that is not finite.
    """
    moments = np.asarray(times, dtype=np.float64)
    arrays = [np.asarray(value, dtype=np.float64) for value in values]
    arrays = [np.full(moments.shape, value) if value.ndim == 0 else value for value in arrays]
    if moments.ndim != 1 or not len(moments):
        raise NoMeasure("there are no samples")
    for array in arrays:
        if array.shape != moments.shape:
            raise NoMeasure(f"{len(moments)} times and values of the shape {array.shape}: one for each")
    if not np.isfinite(moments).all() or (np.diff(moments) < 0).any():
        raise NoMeasure("the times are not finite, or go back: the world was reset, or the samples are of two runs")
    for array in arrays:
        wrong = np.flatnonzero(~np.isfinite(array))
        if len(wrong):
            raise NoMeasure(f"the value at {moments[wrong[0]]:g} s is {array[wrong[0]]:g}")
    return moments, *arrays


def _check_finite(**numbers: float | None) -> None:
    """Raise NoMeasure for a number that is nan or infinite. None means not given."""
    for name, value in numbers.items():
        if value is not None and not math.isfinite(value):
            raise NoMeasure(f"the {name.replace('_', ' ')} is {value:g}")


# --- the response to a step -------------------------------------------------------------------------------------------


class Step(NamedTuple):
    """The start of a step (s), and the values before and after it."""

    start: float
    initial: float
    final: float

    @property
    def size(self) -> float:
        return self.final - self.initial


def step(times: Any, values: Any, set_point: float | None = None, start: float | None = None) -> Step:
    """Find the step in the samples: from the value at `start` to `set_point`.

    Args:
        set_point: by default the last value.
        start: by default the last sample before the value has moved by a thousandth of the step.

    Raises:
        NoMeasure: there is no step, or a number is not finite.
    """
    _check_finite(set_point=set_point, start=start)
    moments, numbers = samples(times, values)
    final = float(numbers[-1] if set_point is None else set_point)
    begin = 0
    if start is not None:
        begin = int(np.searchsorted(moments, start - 1e-9))
        if begin == len(moments):
            raise NoMeasure(f"the step at {start:g} s is after the last sample, at {moments[-1]:g} s")
    initial = float(numbers[begin])
    if abs(final - initial) <= _NO_STEP * max(1.0, abs(final)):
        raise NoMeasure(f"there is no step: it begins at {initial:g} and ends at {final:g}")
    if start is None:
        moved = np.flatnonzero(np.abs(numbers - initial) > _MOVED * abs(final - initial))
        begin = max(0, int(moved[0]) - 1) if len(moved) else 0
    return Step(float(moments[begin] if start is None else start), initial, final)


def _response(times: Any, values: Any, set_point: float | None, start: float | None) -> tuple[Step, Array, Array]:
    """The step, and the samples from its start on: times (n,), and values as parts of the step, from 0 to 1 (n,)."""
    found = step(times, values, set_point, start)
    moments, numbers = samples(times, values)
    here = moments >= found.start - 1e-9
    return found, moments[here], (numbers[here] - found.initial) / found.size


def _crossing(times: Array, levels: Array, after: int) -> float:
    """The time at which `levels` crosses 0 between the samples `after` and `after + 1`."""
    rise = levels[after + 1] - levels[after]
    return float(times[after] - levels[after] * (times[after + 1] - times[after]) / rise)


def _reached(times: Array, parts: Array, level: float) -> float:
    """The time at which the response first reaches a part of the step; inf when it never does."""
    there = np.flatnonzero(parts >= level)
    if not len(there):
        return math.inf
    return _crossing(times, parts - level, int(there[0]) - 1) if there[0] else float(times[0])


def rise_time(times: Any, values: Any, set_point: float | None = None, start: float | None = None) -> Measured:
    """Seconds from 10 % to 90 % of the step; inf when it does not reach 90 %. `time` is when it reaches 90 %.

    Raises:
        NoMeasure: there is no step.
    """
    _, moments, parts = _response(times, values, set_point, start)
    end = _reached(moments, parts, HIGH)
    return Measured(end - _reached(moments, parts, LOW) if end < math.inf else math.inf, end)


def overshoot(times: Any, values: Any, set_point: float | None = None, start: float | None = None) -> Measured:
    """How far the value goes beyond the end of the step, in % of the step; 0 when it does not. `time` is the peak.

    Raises:
        NoMeasure: there is no step.
    """
    _, moments, parts = _response(times, values, set_point, start)
    peak = int(parts.argmax())
    return Measured(max(0.0, 100.0 * float(parts[peak] - 1.0)), moments[peak])


def settling_time(
    times: Any, values: Any, set_point: float | None = None, start: float | None = None, band: float = BAND
) -> Measured:
    """Seconds from the step until the value stays within `band` (2 %) of the end of the step; inf when it does not.

    Raises:
        NoMeasure: there is no step.
    """
    _check_finite(band=band)
    found, moments, parts = _response(times, values, set_point, start)
    outside = np.flatnonzero(np.abs(parts - 1.0) > band)
    if not len(outside):
        return Measured(0.0, found.start)
    last = int(outside[-1])
    if last == len(moments) - 1:
        return Measured(math.inf)
    settled = _crossing(moments, parts - 1.0 - math.copysign(band, parts[last] - 1.0), last)
    return Measured(settled - found.start, settled)


# --- errors -----------------------------------------------------------------------------------------------------------


def _integral_of_product(times: Array, one: Array, other: Array) -> float:
    """Integrate the product of two piecewise linear functions."""
    a, b, c, d = one[:-1], one[1:], other[:-1], other[1:]
    return float(np.sum(np.diff(times) * (2.0 * a * c + a * d + b * c + 2.0 * b * d)) / 6.0)


def steady_state_error(times: Any, values: Any, set_point: Any) -> Measured:
    """The size of the difference of the means of set point and value over the last tenth of the time."""
    moments, numbers, wanted = samples(times, values, set_point)
    since = moments[-1] - END * (moments[-1] - moments[0])
    errors, here = wanted - numbers, moments > since
    ends = np.append(since, moments[here])
    errors = np.append(np.interp(since, moments, errors), errors[here])
    length = ends[-1] - since
    mean = _integral_of_product(ends, errors, np.ones_like(errors)) / length if length > 0 else errors.mean()
    return Measured(abs(float(mean)), since)


def rms(times: Any, values: Any, set_point: Any = 0.0) -> Measured:
    """The root mean square of set point minus value over the time."""
    moments, numbers, wanted = samples(times, values, set_point)
    errors, length = wanted - numbers, moments[-1] - moments[0]
    if length <= 0:
        return Measured(math.sqrt(float(np.mean(errors**2))))
    return Measured(math.sqrt(_integral_of_product(moments, errors, errors) / length))


def peak(times: Any, values: Any, set_point: Any = 0.0) -> Measured:
    """The largest absolute value of set point minus value."""
    moments, numbers, wanted = samples(times, values, set_point)
    errors = np.abs(wanted - numbers)
    return Measured(errors.max(), moments[errors.argmax()])


def integral_of_absolute_error(times: Any, values: Any, set_point: Any = 0.0) -> Measured:
    """The integral of the absolute value of set point minus value over the time, in its unit times s."""
    moments, numbers, wanted = samples(times, values, set_point)
    errors = wanted - numbers
    begin, end = np.abs(errors[:-1]), np.abs(errors[1:])
    both = begin + end
    crosses = errors[:-1] * errors[1:] < 0
    means = np.where(crosses, (begin**2 + end**2) / np.where(both > 0, both, 1.0), both) / 2.0
    return Measured(np.sum(np.diff(moments) * means))


# --- efforts, contact, limits -----------------------------------------------------------------------------------------


def _time_of(times: Array, holds: Any) -> Measured:
    """How long a condition held (each sample counts until the next), s; `time` is when it first held."""
    found = np.flatnonzero(holds)
    return Measured(np.sum(np.diff(times)[holds[:-1]]), times[found[0]] if len(found) else math.nan)


def saturation_time(times: Any, efforts: Any, limit: float) -> Measured:
    """Seconds during which the absolute effort was at its limit (99.9 % of it or more). Raises NoMeasure: no limit."""
    if not 0 < limit < math.inf:
        raise NoMeasure(f"saturation needs a largest effort above 0, not {limit:g}")
    moments, numbers = samples(times, efforts)
    return _time_of(moments, np.abs(numbers) >= SATURATED * limit)


def contact_time(times: Any, forces: Any, threshold: float = 0.0) -> Measured:
    """Seconds during which the absolute force was above the threshold, N."""
    _check_finite(threshold=threshold)
    moments, numbers = samples(times, forces)
    return _time_of(moments, np.abs(numbers) > threshold)


def limit_hits(times: Any, positions: Any, lower: float = -math.inf, upper: float = math.inf) -> Measured:
    """How often the position reached a bound; `time` is the first time.

    A start at the bound does not count. The joint must leave the bound by more than 1 mm or 1 mrad before the next hit
    counts. Raises NoMeasure: there is no bound.
    """
    if math.isnan(lower) or math.isnan(upper) or not (lower > -math.inf or upper < math.inf):
        raise NoMeasure("limit hits need a lower or an upper bound")
    moments, numbers = samples(times, positions)
    distances = np.minimum(numbers - lower, upper - numbers)
    states = np.where(distances <= 0, 1, np.where(distances > NEAR_LIMIT, -1, 0))
    states[0] = states[0] or -1
    known = np.flatnonzero(states)
    hits = known[1:][np.diff(states[known]) == 2]
    return Measured(len(hits), moments[hits[0]] if len(hits) else math.nan)


def energy(times: Any, efforts: Any, velocities: Any) -> Measured:
    """The work of the effort on the joint, J; negative where the joint drives the actuator."""
    return Measured(_integral_of_product(*samples(times, efforts, velocities)))
