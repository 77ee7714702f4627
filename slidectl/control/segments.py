"""Segments of trajectories: the motions of one joint between two points, as rows of numbers.

A segment is a line, or a cubic or quintic polynomial of time. Many are made at once, with numpy, in the order of
operations of upstream's quintic_spline_segment.h, so the results are equal to the bit. numpy is imported inside the
functions, since other users of the controller modules do not need it and its import takes long.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from math import isfinite
from typing import TYPE_CHECKING, Any

from slidectl.control.duration import NANOSECONDS
from slidectl.control.laws import law
from slidectl.control.node_handle import Message
from slidectl.errors import Refused

if TYPE_CHECKING:
    import numpy
    from numpy.typing import ArrayLike

    Rows = numpy.ndarray[Any, numpy.dtype[numpy.float64]]

SIZE = 16
(
    START, DURATION, END, FROM_START, C0, C1, C2, C3, C4, C5,
    GOAL, PATH_POSITION, PATH_VELOCITY, END_POSITION, END_VELOCITY, END_TIME,
) = range(SIZE)  # fmt: skip
"""The columns of a row. Times in s: START and END in the controller's uptime, FROM_START the time of the first point in
its message, 0 when the segment begins in an earlier motion. C0 to C5: the coefficients. GOAL: the number of the goal
that it is part of, 0 for none. The others: the tolerances of that goal; 0 checks nothing."""
TOLERANCES = slice(PATH_POSITION, SIZE)


@law
def evaluate(segment: Any, x: float) -> tuple[float, float, float]:
    """The polynomial and its two derivatives at `x`."""
    c1, c2, c3, c4, c5 = segment[C1], segment[C2], segment[C3], segment[C4], segment[C5]
    x2 = x * x
    x3 = x2 * x
    x4 = x3 * x
    x5 = x4 * x
    return (
        segment[C0] + x * c1 + x2 * c2 + x3 * c3 + x4 * c4 + x5 * c5,
        c1 + 2.0 * x * c2 + 3.0 * x2 * c3 + 4.0 * x3 * c4 + 5.0 * x4 * c5,
        2.0 * c2 + 6.0 * x * c3 + 12.0 * x2 * c4 + 20.0 * x3 * c5,
    )


@law
def sample(segment: Any, time_s: float) -> tuple[float, float, float]:
    """Position, velocity and acceleration; outside of the segment the position of its nearer end, at rest."""
    x = time_s - segment[START]
    if 0.0 <= x <= segment[DURATION]:
        return evaluate(segment, x)
    position, _, _ = evaluate(segment, 0.0 if x < 0.0 else segment[DURATION])
    return position, 0.0, 0.0


def find(rows: Rows, time_s: float) -> int:
    """The index of the last segment that has started; 0 when none has."""
    return max(int(rows[:, START].searchsorted(time_s, side="right")) - 1, 0)


def sample_at(rows: Rows, time_s: float) -> tuple[float, float, float]:
    """Position, velocity and acceleration of a joint, by its segments."""
    return sample(rows[find(rows, time_s)].tolist(), time_s)


def states(values: Sequence[Sequence[float]]) -> Rows:
    """The states for `between`, 3 x joints, from position, velocity and acceleration of each joint."""
    import numpy as np

    return np.array(values).T


def between(start_s: ArrayLike, start: ArrayLike, end_s: ArrayLike, end: ArrayLike) -> Rows:
    """Segments from start times and states to end times and states, without goals and tolerances.

    States are 3 x segments: positions, velocities and accelerations; nan stands for a value that is not given.

    Raises:
        Refused: a segment ends before it starts.
    """
    import numpy as np

    start_s = np.asarray(start_s)
    duration_s: Rows = np.asarray(end_s) - start_s
    if (duration_s < 0.0).any():
        raise Refused("Quintic spline segment can't be constructed: end_time < start_time.")
    rows = np.zeros((len(start_s), SIZE))
    rows[:, START], rows[:, DURATION], rows[:, END] = start_s, duration_s, start_s + duration_s
    rows[:, C0 : C5 + 1] = splines(np.asarray(start), np.asarray(end), duration_s)
    return rows


def splines(start: Rows, end: Rows, t: Rows) -> Rows:
    """The polynomials of the least order that match the values given at both ends: n x 6 coefficients."""
    import numpy as np

    (p0, v0, a0), (p1, v1, a1) = start, end
    t2 = t * t
    t3 = t2 * t
    t4 = t3 * t
    t5 = t4 * t
    is_line = np.isnan(v0) | np.isnan(v1)
    is_cubic = np.isnan(a0) | np.isnan(a1)
    found = np.zeros((len(t), 6))
    found[:, 0] = p0
    with np.errstate(all="ignore"):
        found[:, 1] = np.where(is_line, np.where(t == 0.0, 0.0, (p1 - p0) / t), v0)
        curved = ~is_line & (t == 0.0) & ~is_cubic
        found[curved, 2] = 0.5 * a0[curved]
        curved = ~is_line & (t != 0.0)
        if (curved & is_cubic).any():
            cubic = (
                (-3.0 * p0 + 3.0 * p1 - 2.0 * v0 * t - v1 * t) / t2,
                (2.0 * p0 - 2.0 * p1 + v0 * t + v1 * t) / t3,
            )
            found[curved & is_cubic, 2:4] = np.stack(cubic, axis=1)[curved & is_cubic]
        if (curved & ~is_cubic).any():
            quintic = (
                0.5 * a0,
                (-20.0 * p0 + 20.0 * p1 - 3.0 * a0 * t2 + a1 * t2 - 12.0 * v0 * t - 8.0 * v1 * t) / (2.0 * t3),
                (30.0 * p0 - 30.0 * p1 + 3.0 * a0 * t2 - 2.0 * a1 * t2 + 16.0 * v0 * t + 14.0 * v1 * t) / (2.0 * t4),
                (-12.0 * p0 + 12.0 * p1 - a0 * t2 + a1 * t2 - 6.0 * v0 * t - 6.0 * v1 * t) / (2.0 * t5),
            )
            found[curved & ~is_cubic, 2:6] = np.stack(quintic, axis=1)[curved & ~is_cubic]
    return found


def through(begin_s: float, begins: Rows, first_s: float, times_s: Rows, ends: Rows, from_start_s: Rows) -> list[Rows]:
    """The segments of each joint from a state through the points of a trajectory. `first_s`: time of the first point.

    `begins` holds the first states, 3 x joints; `ends` the states at the points, 3 x points x joints. `times_s` and
    `from_start_s` are the times of the points in uptime and in the message. Raises Refused as `between`.
    """
    import numpy as np

    points, joints = ends.shape[1:]
    states = np.concatenate([begins[:, np.newaxis], ends], axis=1).swapaxes(1, 2)
    starts, stops = (side.reshape(3, -1) for side in (states[:, :, :-1], states[:, :, 1:]))
    start_s, stop_s = [begin_s, *times_s[:-1]], [first_s, *times_s[1:]]
    rows = between(np.tile(start_s, joints), starts, np.tile(stop_s, joints), stops).reshape(joints, points, SIZE)
    rows[:, 1:, FROM_START] = from_start_s[:-1]
    return list(rows)


def check_range(names: Sequence[str], made: list[Rows], dropped: int) -> None:
    """Check that the coefficients and the motions of `through` are finite; `names` are those of the joints.

    In a segment no term of the polynomial is larger than at its end, so finite sums of their sizes there suffice.
    `dropped` is the number of points of the message before the first one of `made`.

    Raises:
        Refused: a number on the way to a point is too large. Upstream commands nan.
    """
    import numpy as np

    for name, rows in zip(names, made, strict=True):
        duration_s = rows[:, DURATION, np.newaxis]
        factors = np.abs(rows[:, C0 : C5 + 1])
        for quantity in ("position", "velocity", "acceleration"):
            with np.errstate(all="ignore"):
                sizes = (factors * duration_s ** np.arange(factors.shape[1])).sum(axis=1)
                factors = (factors * np.arange(factors.shape[1]))[:, 1:]
            wrong = np.flatnonzero(~np.isfinite(sizes))
            if len(wrong):
                k = int(wrong[0])
                raise Refused(
                    f"joint {name!r} cannot move to point {dropped + k + 1} within {rows[k, DURATION]:g} s: "
                    f"its {quantity} on the way is too large for a number"
                )


def following(kept: Rows, new: Rows) -> Rows:
    """A joint's kept segments, followed by the new ones."""
    import numpy as np

    return np.concatenate([kept, new])


def joined(trajectory: list[Rows]) -> memoryview:
    """The segments of all joints in one block of numbers, joint by joint."""
    import numpy as np

    return np.concatenate(trajectory).reshape(-1).data


def seconds(times_ns: list[int], start_ns: int = 0) -> Rows:
    """The sum of each time and the start, in s, rounded as by `to_seconds`."""
    import numpy as np

    whole, rest = np.divmod(np.array(times_ns) + start_ns, NANOSECONDS)
    return whole + 1e-9 * rest


_NAMES = ("positions", "velocities", "accelerations")


def states_of(points: list[Message], joints: int) -> Rows:
    """Positions, velocities and accelerations of trajectory_msgs/JointTrajectoryPoint: an array of 3 x points x joints.

    Raises:
        Refused: the sizes of a point's lists differ, or a number is not finite. Upstream accepts nan, reads past the
        end of lists that are too short, and ignores surplus positions.
    """
    import numpy as np

    for k, point in enumerate(points):
        size = len(point["positions"])
        if any(point[name] and len(point[name]) != size for name in _NAMES):
            raise Refused("Size mismatch in trajectory point position, velocity or acceleration data.")
        if size == 0:
            raise Refused(
                "Can't construct segment from ROS message: Start/end points data size mismatch."
                if k
                else "Size mismatch between trajectory point and vector specifying whether joints wrap around."
            )
        if size < joints:
            raise Refused(f"a trajectory point has {size} positions for {joints} joints")
    if not all(map(isfinite, chain.from_iterable(point[name] for point in points for name in _NAMES))):
        raise Refused("a trajectory point has nan or infinity: it must have finite numbers")
    unsaid = joints * [np.nan]
    return np.array([[point[name][:joints] or unsaid for point in points] for name in _NAMES])
