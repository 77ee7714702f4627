"""Measures of a motion: of the response to a step, of an error, of efforts, of contact. See docs/measures.md.

Functions of arrays: `times` in s, in order, and values of the same length (n,). Between two samples a value is taken as
linear; where a force or an effort is compared with a threshold, each sample counts until the next one. Each returns a
`Measured`.
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
"""Half the width of the band in which a response has settled, as a part of the step."""
END = 0.1
"""The part of the time, at its end, of which the steady-state error is the mean."""
SATURATED = 0.999
"""The part of its limit from which on an effort counts as saturated."""
NEAR_LIMIT = 1e-3
"""How far a joint must have left a bound before it can hit it again, m or rad."""
_MOVED = 1e-3
"""The part of a step by which a value leaves its beginning when the motion begins."""
_NO_STEP = 1e-9


class NoMeasure(Refused):
    """The samples do not suffice for the measure."""


class Measured(float):
    """A measure. `time` is when it was so, in s; nan where it is of the whole time."""

    time: float

    def __new__(cls, value: float, time: float = math.nan) -> Measured:
        made = super().__new__(cls, value)
        made.time = float(time)
        return made


def measure_text(value: float, unit: str) -> str:
    """A measure as text."""
    return "never" if value == math.inf else f"{value:.6g} {unit}".rstrip()


def samples(times: Any, *values: Any) -> tuple[Array, ...]:
    """Times and values as arrays (n,). A value that is one number counts for all times.

    Raises:
        NoMeasure: there are none, their numbers differ, the times go back, or one is not finite.
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
    """Raises NoMeasure for a number that is nan or infinite. None was not given."""
    for name, value in numbers.items():
        if value is not None and not math.isfinite(value):
            raise NoMeasure(f"the {name.replace('_', ' ')} is {value:g}")


# --- the response to a step -------------------------------------------------------------------------------------------


class Step(NamedTuple):
    """When a step began (s), and the values that it leads from and to."""

    start: float
    initial: float
    final: float

    @property
    def size(self) -> float:
        return self.final - self.initial


def step(times: Any, values: Any, set_point: float | None = None, start: float | None = None) -> Step:
    """The step in the samples: from the value at `start` to `set_point`.

    Args:
        set_point: without it, the last value.
        start: without it, the last sample within a thousandth of the step of the first value, before the motion.

    Raises:
        NoMeasure: there is none, or one of these is not finite.
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
    """The step, and times and values from then on, these as parts of the step: from 0 to 1."""
    found = step(times, values, set_point, start)
    moments, numbers = samples(times, values)
    here = moments >= found.start - 1e-9
    return found, moments[here], (numbers[here] - found.initial) / found.size


def _crossing(times: Array, levels: Array, after: int) -> float:
    """When `levels` passed 0 between the samples `after` and the next."""
    rise = levels[after + 1] - levels[after]
    return float(times[after] - levels[after] * (times[after + 1] - times[after]) / rise)


def _reached(times: Array, parts: Array, level: float) -> float:
    """When the response first reached a part of the step; inf when never."""
    there = np.flatnonzero(parts >= level)
    if not len(there):
        return math.inf
    return _crossing(times, parts - level, int(there[0]) - 1) if there[0] else float(times[0])


def rise_time(times: Any, values: Any, set_point: float | None = None, start: float | None = None) -> Measured:
    """Seconds from 10 % to 90 % of the step; inf when it did not get there. `time` is when it had risen.

    Raises:
        NoMeasure: there is no step.
    """
    _, moments, parts = _response(times, values, set_point, start)
    end = _reached(moments, parts, HIGH)
    return Measured(end - _reached(moments, parts, LOW) if end < math.inf else math.inf, end)


def overshoot(times: Any, values: Any, set_point: float | None = None, start: float | None = None) -> Measured:
    """How far it went beyond the end of the step, in % of the step, at the peak; 0 when it did not.

    Raises:
        NoMeasure: there is no step.
    """
    _, moments, parts = _response(times, values, set_point, start)
    peak = int(parts.argmax())
    return Measured(max(0.0, 100.0 * float(parts[peak] - 1.0)), moments[peak])


def settling_time(
    times: Any, values: Any, set_point: float | None = None, start: float | None = None, band: float = BAND
) -> Measured:
    """Seconds from the step until it stayed within `band` (2 %) of the step around its end; inf when it does not.

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
    """Of two that are linear between the samples."""
    a, b, c, d = one[:-1], one[1:], other[:-1], other[1:]
    return float(np.sum(np.diff(times) * (2.0 * a * c + a * d + b * c + 2.0 * b * d)) / 6.0)


def steady_state_error(times: Any, values: Any, set_point: Any) -> Measured:
    """How far the mean of the last tenth of the time is from the mean of the set point there; never below 0."""
    moments, numbers, wanted = samples(times, values, set_point)
    since = moments[-1] - END * (moments[-1] - moments[0])
    errors, here = wanted - numbers, moments > since
    ends = np.append(since, moments[here])
    errors = np.append(np.interp(since, moments, errors), errors[here])
    length = ends[-1] - since
    mean = _integral_of_product(ends, errors, np.ones_like(errors)) / length if length > 0 else errors.mean()
    return Measured(abs(float(mean)), since)


def rms(times: Any, values: Any, set_point: Any = 0.0) -> Measured:
    """The root of the mean square of set point minus value, over the time."""
    moments, numbers, wanted = samples(times, values, set_point)
    errors, length = wanted - numbers, moments[-1] - moments[0]
    if length <= 0:
        return Measured(math.sqrt(float(np.mean(errors**2))))
    return Measured(math.sqrt(_integral_of_product(moments, errors, errors) / length))


def peak(times: Any, values: Any, set_point: Any = 0.0) -> Measured:
    """The largest size of set point minus value."""
    moments, numbers, wanted = samples(times, values, set_point)
    errors = np.abs(wanted - numbers)
    return Measured(errors.max(), moments[errors.argmax()])


def integral_of_absolute_error(times: Any, values: Any, set_point: Any = 0.0) -> Measured:
    """The integral of the size of set point minus value over the time, in its unit times s."""
    moments, numbers, wanted = samples(times, values, set_point)
    errors = wanted - numbers
    begin, end = np.abs(errors[:-1]), np.abs(errors[1:])
    both = begin + end
    crosses = errors[:-1] * errors[1:] < 0
    means = np.where(crosses, (begin**2 + end**2) / np.where(both > 0, both, 1.0), both) / 2.0
    return Measured(np.sum(np.diff(moments) * means))


# --- efforts, contact, limits -----------------------------------------------------------------------------------------


def _time_of(times: Array, holds: Any) -> Measured:
    """How long something held that holds from a sample to the next; `time` is when it first did."""
    found = np.flatnonzero(holds)
    return Measured(np.sum(np.diff(times)[holds[:-1]]), times[found[0]] if len(found) else math.nan)


def saturation_time(times: Any, efforts: Any, limit: float) -> Measured:
    """Seconds during which the effort was at its limit (at 99.9 % of it, either way). Raises NoMeasure: no limit."""
    if not 0 < limit < math.inf:
        raise NoMeasure(f"saturation needs a largest effort above 0, not {limit:g}")
    moments, numbers = samples(times, efforts)
    return _time_of(moments, np.abs(numbers) >= SATURATED * limit)


def contact_time(times: Any, forces: Any, threshold: float = 0.0) -> Measured:
    """Seconds during which the size of the force was above the threshold, N."""
    _check_finite(threshold=threshold)
    moments, numbers = samples(times, forces)
    return _time_of(moments, np.abs(numbers) > threshold)


def limit_hits(times: Any, positions: Any, lower: float = -math.inf, upper: float = math.inf) -> Measured:
    """How often the position came to a bound; the first time is its `time`.

    A beginning at the bound does not count, and one that stays near (within 1 mm or 1 mrad) counts once. Raises
    NoMeasure: there is no bound.
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
    """The work that the effort has done on the joint, J: below 0 where the joint has driven the actuator."""
    return Measured(_integral_of_product(*samples(times, efforts, velocities)))
