"""Trajectories of all joints of a controller as ROS 2's joint_trajectory_controller samples, fills and replaces them.

Times are integer nanoseconds. Vectors have one number per joint, in m or rad and their derivatives by s, and N or N·m;
an empty vector is not given. Nothing here knows messages, commands or tolerances.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import ceil, copysign, pi
from typing import NamedTuple

from slidectl.control.angular_distance import shortest_angular_distance
from slidectl.control.duration import to_seconds
from slidectl.control.saved_classes import recreated
from slidectl.control.segments import C0, evaluate

Vector = list[float]
FIELDS = ("positions", "velocities", "accelerations", "effort")


@recreated
class Waypoint:
    """The state of all joints at one time. `time_ns` counts from the start of the trajectory."""

    __slots__ = ("accelerations", "effort", "positions", "time_ns", "velocities")

    def __init__(
        self,
        time_ns: int,
        positions: Sequence[float],
        velocities: Sequence[float] = (),
        accelerations: Sequence[float] = (),
        effort: Sequence[float] = (),
    ) -> None:
        self.time_ns = time_ns
        self.positions, self.velocities = list(positions), list(velocities)
        self.accelerations, self.effort = list(accelerations), list(effort)

    def copy(self, time_ns: int = 0) -> Waypoint:
        """The same state at another time."""
        return Waypoint(time_ns, self.positions, self.velocities, self.accelerations, self.effort)

    def completed(self) -> Waypoint:
        """A copy with zeros for the vectors that are not given."""
        zeros = [0.0] * len(self.positions)
        vectors = (self.velocities or zeros, self.accelerations or zeros, self.effort or zeros)
        return Waypoint(self.time_ns, self.positions, *vectors)


class Sample(NamedTuple):
    """A sampled state, and where in the trajectory it is."""

    state: Waypoint
    """With all vectors."""
    segment: int
    """The index of the waypoint at which the segment begins; 0 also before the first waypoint."""
    next: int
    """The index of the waypoint that is approached; the number of waypoints at the end."""


@recreated
class Trajectory:
    """Waypoints, which begin at `start_ns`, and the state from which the first one is approached."""

    def __init__(self, start_ns: int, points: list[Waypoint], joints: list[int], is_hold: bool = False) -> None:
        """`start_ns` 0: it starts when it is first sampled. `joints`: the indices of the joints of each vector."""
        self.start_ns = start_ns
        self.points = points
        self.joints = joints
        self.is_hold = is_hold
        """True for a trajectory that the controller made to stay where it is."""
        self.is_begun = False
        self._before = Waypoint(0, ())
        self._before_ns = 0
        self._cursor = 0
        """The segment that was found last. Later ones are searched from there."""

    def begin(self, time_ns: int, before: Waypoint, before_ns: int, turns: Sequence[bool]) -> None:
        """Start at `time_ns`, if no time is given, from the state `before`, which was at `before_ns`.

        `turns`: the joints that go to the first waypoint by the shorter way; the start is then shifted by full turns.
        Positions that are not given are integrated.
        """
        first = self.points[0]
        self.start_ns = self.start_ns or time_ns
        before = before.copy()
        zeros = [0.0] * len(before.positions)
        before.velocities = before.velocities or (zeros if first.velocities else [])
        before.accelerations = before.accelerations or (zeros if first.accelerations else [])
        for k, turn in enumerate(turns):
            if turn and first.positions:
                before.positions[k] = first.positions[k] - shorter_way(before.positions[k], first.positions[k])
        self._before, self._before_ns, self.is_begun = before, before_ns, True
        earlier, earlier_ns = before, before_ns
        for point in self.points:
            point_ns = self.start_ns + point.time_ns
            _integrate(earlier, point, to_seconds(point_ns - earlier_ns))
            earlier, earlier_ns = point, point_ns

    def sample(self, time_ns: int, interpolates: bool) -> Sample | None:
        """The state at that time; None before the time of the state from which it begins.

        Without `interpolates` the next waypoint is output at once, and before the first one the start.
        """
        if time_ns < self._before_ns:
            return None
        since_ns, last = time_ns - self.start_ns, len(self.points) - 1
        first = self.points[0]
        if since_ns < first.time_ns:
            if not interpolates:
                return Sample(self._before.completed(), 0, 0)
            duration_ns = self.start_ns + first.time_ns - self._before_ns
            return Sample(_between(self._before, first, time_ns - self._before_ns, duration_ns), 0, 0)
        k = self._cursor if self.points[self._cursor].time_ns <= since_ns else 0
        while k < last and self.points[k + 1].time_ns <= since_ns:
            k += 1
        if k == last:
            return Sample(self.points[last].completed(), last, last + 1)
        start, end = self.points[k], self.points[k + 1]
        if not interpolates:
            return Sample(end.completed(), k, k + 1)
        return Sample(_between(start, end, since_ns - start.time_ns, end.time_ns - start.time_ns), k, k + 1)

    def advance(self, sample: Sample) -> None:
        """Search for later segments from that of this sample on."""
        self._cursor = sample.segment


def shorter_way(start: float, end: float) -> float:
    """The shorter turn to an angle, in rad; of half a turn the sign of `end - start`."""
    distance = shortest_angular_distance(start, end)
    if abs(abs(distance) - pi) < 1e-9:
        distance = abs(distance) if end > start else -abs(distance)
    return distance


def _integrate(start: Waypoint, end: Waypoint, duration_s: float) -> None:
    """Give the end positions that follow from its velocities, or from its accelerations, and to both what that needs.

    As upstream the velocities and accelerations that count as 0 are then given ones, which raises the degree.
    """
    if end.positions:
        return
    joints = range(len(start.positions))
    start.velocities = start.velocities or [0.0] * len(joints)
    if not end.velocities:
        start.accelerations = start.accelerations or [0.0] * len(joints)
        a0, a1 = start.accelerations, end.accelerations
        end.velocities = [start.velocities[k] + (a0[k] + a1[k]) * 0.5 * duration_s for k in joints]
    v0, v1 = start.velocities, end.velocities
    end.positions = [start.positions[k] + (v0[k] + v1[k]) * 0.5 * duration_s for k in joints]


def _between(start: Waypoint, end: Waypoint, elapsed_ns: int, duration_ns: int) -> Waypoint:
    """The state on the way between two, by the polynomials of the highest degree for which both have the vectors."""
    elapsed_s, duration_s = to_seconds(elapsed_ns), to_seconds(duration_ns)
    x = min(max(elapsed_s, 0.0), duration_s)
    has_velocities = bool(start.velocities and end.velocities) and x == elapsed_s
    has_accelerations = has_velocities and bool(start.accelerations and end.accelerations)
    states = []
    for k, (p0, p1) in enumerate(zip(start.positions, end.positions, strict=True)):
        if has_accelerations:
            v0, v1, a0, a1 = start.velocities[k], end.velocities[k], start.accelerations[k], end.accelerations[k]
            factors = _quintic(p0, v0, a0, p1, v1, a1, duration_s)
        elif has_velocities:
            factors = _cubic(p0, start.velocities[k], p1, end.velocities[k], duration_s)
        else:
            factors = (p0, 0.0 if duration_s == 0.0 else (p1 - p0) / duration_s, 0.0, 0.0, 0.0, 0.0)
        states.append(evaluate((*[0.0] * C0, *factors), x))
    zeros = [0.0] * len(states)
    rate = 0.0 if duration_s == 0.0 else x / duration_s
    e0, e1 = start.effort or zeros, end.effort or zeros
    effort = [one + (other - one) * rate for one, other in zip(e0, e1, strict=True)]
    positions, velocities, accelerations = zip(*states, strict=True)
    return Waypoint(0, positions, velocities, accelerations, effort)


Factors = tuple[float, float, float, float, float, float]


def _cubic(p0: float, v0: float, p1: float, v1: float, t: float) -> Factors:
    """The polynomial that meets positions and velocities after `t` seconds."""
    if t == 0.0:
        return p0, v0, 0.0, 0.0, 0.0, 0.0
    c2 = (-3.0 * p0 + 3.0 * p1 - 2.0 * v0 * t - v1 * t) / t**2
    c3 = (2.0 * p0 - 2.0 * p1 + v0 * t + v1 * t) / t**3
    return p0, v0, c2, c3, 0.0, 0.0


def _quintic(p0: float, v0: float, a0: float, p1: float, v1: float, a1: float, t: float) -> Factors:
    """The polynomial that meets positions, velocities and accelerations after `t` seconds."""
    if t == 0.0:
        return p0, v0, 0.5 * a0, 0.0, 0.0, 0.0
    t2 = t * t
    c3 = (-20.0 * p0 + 20.0 * p1 - 3.0 * a0 * t2 + a1 * t2 - 12.0 * v0 * t - 8.0 * v1 * t) / (2.0 * t**3)
    c4 = (30.0 * p0 - 30.0 * p1 + 3.0 * a0 * t2 - 2.0 * a1 * t2 + 16.0 * v0 * t + 14.0 * v1 * t) / (2.0 * t**4)
    c5 = (-12.0 * p0 + 12.0 * p1 - a0 * t2 + a1 * t2 - 6.0 * v0 * t - 6.0 * v1 * t) / (2.0 * t**5)
    return p0, v0, 0.5 * a0, c3, c4, c5


def completed(new: Trajectory, positions: Sequence[float]) -> Trajectory:
    """The trajectory for all joints, in their order. Joints that it omits stay at these positions, at rest."""
    zeros = [0.0] * len(positions)
    points = [
        Waypoint(
            point.time_ns,
            _merged(point.positions, new.joints, positions),
            _merged(point.velocities, new.joints, zeros),
            _merged(point.accelerations, new.joints, zeros),
            _merged(point.effort, new.joints, zeros),
        )
        for point in new.points
    ]
    return Trajectory(new.start_ns, points, list(range(len(positions))), new.is_hold)


def _merged(given: Vector, joints: Sequence[int], others: Sequence[float]) -> Vector:
    """`others`, with the given numbers for these joints; nothing when nothing is given."""
    if not given:
        return []
    merged = list(others)
    for joint, number in zip(joints, given, strict=True):
        merged[joint] = number
    return merged


def replaced(
    running: Trajectory, new: Trajectory, now_ns: int, begin_ns: int, positions: Sequence[float], interpolates: bool
) -> Trajectory:
    """The running trajectory until the new one begins, then the new one. It starts when it is first sampled.

    `now_ns` and `begin_ns` are times of the running one: the present, and the begin of the new one. Joints that the new
    one omits follow the running one to its end. `positions` are theirs where the running one cannot be sampled.
    """

    def running_at(time_ns: int) -> Waypoint:
        sample = running.sample(time_ns, interpolates)
        return Waypoint(0, positions).completed() if sample is None else sample.state

    zeros = [0.0] * len(positions)
    points = []
    for point in running.points:
        if now_ns < running.start_ns + point.time_ns < begin_ns:
            points.append(point.copy(running.start_ns + point.time_ns - now_ns))
    if new.points[0].time_ns > 0:
        points.append(running_at(begin_ns).copy(begin_ns - now_ns))
    for point in new.points:
        old = running_at(begin_ns + point.time_ns)
        vectors = (
            _merged(point.positions, new.joints, old.positions),
            _merged(point.velocities, new.joints, old.velocities),
            _merged(point.accelerations, new.joints, old.accelerations),
            _merged(point.effort, new.joints, zeros),
        )
        points.append(Waypoint(begin_ns + point.time_ns - now_ns, *vectors))
    last, end_ns = new.points[-1], begin_ns + new.points[-1].time_ns
    for point in running.points if len(new.joints) < len(positions) else ():
        if running.start_ns + point.time_ns > end_ns:
            rest = [0.0] * len(new.joints)
            kept = point.copy(running.start_ns + point.time_ns - now_ns)
            kept.positions = _merged(last.positions, new.joints, point.positions)
            kept.velocities = point.velocities and _merged(rest, new.joints, point.velocities)
            kept.accelerations = point.accelerations and _merged(rest, new.joints, point.accelerations)
            points.append(kept)
    return Trajectory(0, points, list(range(len(positions))))


def give_times(points: list[Waypoint], frequency: float) -> None:
    """Give the points the times 1/f, 2/f and so on, if they have none."""
    if frequency > 0.0 and not any(point.time_ns for point in points):
        for k, point in enumerate(points):
            point.time_ns = round((k + 1) / frequency * 1e9)


def give_velocities(points: list[Waypoint]) -> None:
    """Give points of positions alone the velocities of the cubic spline through them, with rest at both ends.

    Its accelerations are continuous: v[i-1]/h + 2 (1/h + 1/k) v[i] + v[i+1]/k = 3 (dp[i]/h² + dp[i+1]/k²), with the
    durations h and k before and after point i. Fewer than two points, and others, stay as they are.
    """
    if len(points) < 2 or any(p.velocities or p.accelerations or not p.positions for p in points):
        return
    durations = [to_seconds(end.time_ns - start.time_ns) for start, end in pairwise(points)]
    if min(durations) <= 0.0:
        return
    velocities = [
        _spline_velocities([p.positions[k] for p in points], durations) for k in range(len(points[0].positions))
    ]
    for point, row in zip(points, zip(*velocities, strict=True), strict=True):
        point.velocities = list(row)


def _spline_velocities(positions: Vector, durations: Vector) -> Vector:
    """The velocities of one joint at its points, by elimination in the tridiagonal equations of `give_velocities`."""
    rates = [1.0 / duration for duration in durations]
    slopes = [3.0 * (end - start) * rate**2 for (start, end), rate in zip(pairwise(positions), rates, strict=True)]
    factors, sides = [0.0], [0.0]
    for k in range(1, len(positions) - 1):
        pivot = 2.0 * (rates[k - 1] + rates[k]) - rates[k - 1] * factors[-1]
        factors.append(rates[k] / pivot)
        sides.append((slopes[k - 1] + slopes[k] - rates[k - 1] * sides[-1]) / pivot)
    velocities = [0.0]
    for factor, side in zip(reversed(factors[1:]), reversed(sides[1:]), strict=True):
        velocities.append(side - factor * velocities[-1])
    return [0.0, *reversed(velocities)]


def decelerating(
    positions: Sequence[float],
    velocities: Sequence[float],
    decelerations: Sequence[float],
    fastest: Sequence[float],
    period_ns: int,
) -> list[Waypoint]:
    """Points at each period until all joints have come to rest with their decelerations, in m/s² or rad/s².

    `fastest` are the velocity limits: the points last as long as a stop from them.
    """
    longest_s = max(limit / deceleration for limit, deceleration in zip(fastest, decelerations, strict=True))
    points = []
    for k in range(ceil(longest_s / to_seconds(period_ns)) + 1):
        time_s = to_seconds(k * period_ns)
        states = [_stopping(*one, time_s) for one in zip(positions, velocities, decelerations, strict=True)]
        points.append(Waypoint(k * period_ns, *zip(*states, strict=True)))
    return points


def _stopping(position: float, velocity: float, deceleration: float, time_s: float) -> tuple[float, float, float]:
    """Position, velocity and acceleration of a joint that has braked for this time."""
    sign = copysign(1.0, velocity) if velocity else 1.0
    if time_s >= abs(velocity) / deceleration:
        return position + sign * velocity**2 / (2.0 * deceleration), 0.0, 0.0
    braking = sign * deceleration
    return position + velocity * time_s - braking * time_s**2 / 2.0, velocity - braking * time_s, -braking
