"""Follows trajectories of joints by commands and by an action, after ros_controllers' joint_trajectory_controller.

A trajectory is a list of segments for each joint: a segment is a line, or a cubic or quintic polynomial of time,
between two points. Its times are seconds of the controller's uptime, which counts from its start. New trajectories are
blended with the present one when they arrive, between two cycles; an update only samples.

Topics `command` and `state`, service `query_state`, action `follow_joint_trajectory`. The types of the joints come from
`robot_description`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from copy import copy
from functools import partial
from itertools import pairwise
from math import isfinite, pi
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

from slidectl.control import params
from slidectl.control.angular_distance import shortest_angular_distance
from slidectl.control.controller_interface import State
from slidectl.control.duration import NANOSECONDS, from_seconds, from_stamp, to_seconds, to_stamp
from slidectl.control.goals import MONITOR_RATE, ActionController, MonitoredGoal, period_of
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointHandle,
    JointStateHandle,
    PositionJointInterface,
    PosVelAccJointHandle,
    PosVelAccJointInterface,
    PosVelJointHandle,
    PosVelJointInterface,
    ResourceManager,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import joint_names, warn_of_other_joints
from slidectl.control.node_handle import GoalHandle, GoalStatus, Message, NodeHandle
from slidectl.control.params import BOOLEAN, JOINTS, NUMBER, Parameter, within
from slidectl.control.pid import next_command_from
from slidectl.control.reconfigurable_pid import GAINS, ReconfigurablePid
from slidectl.control.registry import controller
from slidectl.control.robot_description import joint_on_paper
from slidectl.errors import MessageRefused, Refused

SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5
"""Error codes of control_msgs/FollowJointTrajectoryResult."""


STATE_RATE = Parameter("state_publish_rate", NUMBER, "messages on `state` per simulated second", "1/s", default=50.0)
Coefficients = tuple[float, float, float, float, float, float]


class PointState(NamedTuple):
    """What one joint is to do at one point; None is what a message does not say."""

    position: float
    velocity: float | None
    acceleration: float | None
    time_from_start_s: float = 0.0


class StateTolerances(NamedTuple):
    """The largest errors that count as none; 0 checks nothing."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0

    def allow(self, position_error: float, velocity_error: float) -> bool:
        """Are these errors within the tolerances? There is no error of acceleration: nobody measures it."""
        return not (0.0 < self.position < abs(position_error) or 0.0 < self.velocity < abs(velocity_error))

    def updated(self, message: Message) -> StateTolerances:
        """With what a control_msgs/JointTolerance says: above 0 replaces, below 0 switches off, 0 keeps."""
        return StateTolerances(*(_replaced(old, message[name]) for name, old in self._asdict().items()))


class SegmentTolerances(NamedTuple):
    """Those on the way, those at the end, and the seconds after the end in which the latter may be met."""

    path: StateTolerances = StateTolerances()
    goal: StateTolerances = StateTolerances()
    goal_time_s: float = 0.0


UNCHECKED = SegmentTolerances()


def _replaced(old: float, new: float) -> float:
    return new if new > 0.0 else 0.0 if new < 0.0 else old


class Segment:
    """The motion of one joint between two points. Its polynomial is made when it is first sampled: points are many."""

    __slots__ = ("_coefficients", "_end", "_start", "duration_s", "end_s", "goal", "start_s", "tolerances")

    def __init__(self, start_s: float, start: PointState, end_s: float, end: PointState) -> None:
        """Raises Refused: it ends before it starts."""
        if end_s < start_s:
            raise Refused("Quintic spline segment can't be constructed: end_time < start_time.")
        self.start_s = start_s
        self.duration_s = end_s - start_s
        self.end_s = start_s + self.duration_s
        self.goal: MonitoredGoal | None = None
        self.tolerances = UNCHECKED
        self._start = start
        self._end = end
        self._coefficients: Coefficients | None = None

    @property
    def time_from_start_s(self) -> float:
        """That of its first point; 0 where it begins in a motion of before."""
        return self._start.time_from_start_s

    def sample(self, time_s: float) -> tuple[float, float, float]:
        """Position, velocity and acceleration; outside of the segment those of its ends, at rest."""
        if self._coefficients is None:
            self._coefficients = spline(self._start, self._end, self.duration_s)
        x = time_s - self.start_s
        if 0.0 <= x <= self.duration_s:
            return evaluate(self._coefficients, x)
        return evaluate(self._coefficients, 0.0 if x < 0.0 else self.duration_s)[0], 0.0, 0.0

    def for_goal(self, goal: MonitoredGoal | None) -> Segment:
        """The same motion as part of a goal; the tolerances stay."""
        copied = copy(self)
        copied.goal = goal
        return copied


Trajectory = list[list[Segment]]
"""The segments of each joint, in the order of time."""
_START = attrgetter("start_s")


def find_segment(segments: Sequence[Segment], time_s: float) -> int:
    """The index of the last segment that has started; 0 when none has."""
    return max(bisect_right(segments, time_s, key=_START) - 1, 0)


def spline(start: PointState, end: PointState, duration_s: float) -> Coefficients:
    """The polynomial of the least order that meets what both ends say, after quintic_spline_segment.h.

    The order of the operations is upstream's: the results are the same to the bit.
    """
    p0, v0, a0, _ = start
    p1, v1, a1, _ = end
    t = duration_s
    if v0 is None or v1 is None:
        return p0, 0.0 if t == 0.0 else (p1 - p0) / t, 0.0, 0.0, 0.0, 0.0
    if t == 0.0:
        return p0, v0, 0.0 if a0 is None or a1 is None else 0.5 * a0, 0.0, 0.0, 0.0
    t2 = t * t
    t3 = t2 * t
    if a0 is None or a1 is None:
        return (
            p0,
            v0,
            (-3.0 * p0 + 3.0 * p1 - 2.0 * v0 * t - v1 * t) / t2,
            (2.0 * p0 - 2.0 * p1 + v0 * t + v1 * t) / t3,
            0.0,
            0.0,
        )
    t4 = t3 * t
    t5 = t4 * t
    return (
        p0,
        v0,
        0.5 * a0,
        (-20.0 * p0 + 20.0 * p1 - 3.0 * a0 * t2 + a1 * t2 - 12.0 * v0 * t - 8.0 * v1 * t) / (2.0 * t3),
        (30.0 * p0 - 30.0 * p1 + 3.0 * a0 * t2 - 2.0 * a1 * t2 + 16.0 * v0 * t + 14.0 * v1 * t) / (2.0 * t4),
        (-12.0 * p0 + 12.0 * p1 - a0 * t2 + a1 * t2 - 6.0 * v0 * t - 6.0 * v1 * t) / (2.0 * t5),
    )


def evaluate(coefficients: Coefficients, x: float) -> tuple[float, float, float]:
    """The polynomial and its two derivatives at `x`."""
    c0, c1, c2, c3, c4, c5 = coefficients
    x2 = x * x
    x3 = x2 * x
    x4 = x3 * x
    x5 = x4 * x
    return (
        c0 + x * c1 + x2 * c2 + x3 * c3 + x4 * c4 + x5 * c5,
        c1 + 2.0 * x * c2 + 3.0 * x2 * c3 + 4.0 * x3 * c4 + 5.0 * x4 * c5,
        2.0 * c2 + 6.0 * x * c3 + 12.0 * x2 * c4 + 20.0 * x3 * c5,
    )


def wraparound_offset(previous: float, following: float) -> float:
    """What is to be added to `following` for a continuous joint to get there from `previous` by the shorter way."""
    distance = shortest_angular_distance(previous, following)
    if abs(abs(distance) - pi) < 1e-9:  # half a turn: in the direction that the numbers say
        distance = abs(distance) if following > previous else -abs(distance)
    return (previous + distance) - following


class MeasuredJoints(NamedTuple):
    """States of all joints in one cycle. The lists are made anew in each cycle, and never changed."""

    positions: list[float]
    velocities: list[float]
    accelerations: list[float]
    time_from_start_s: float = 0.0

    def message(self, with_accelerations: bool = False) -> Message:
        """As trajectory_msgs/JointTrajectoryPoint."""
        return {
            "positions": self.positions,
            "velocities": self.velocities,
            "accelerations": self.accelerations if with_accelerations else [],
            "effort": [],
            "time_from_start": to_stamp(from_seconds(self.time_from_start_s)),
        }


class JointTrajectoryController(ActionController[Any]):
    """Samples the trajectory in each cycle; what becomes of the desired states is the part of the children."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        JOINTS,
        STATE_RATE,
        MONITOR_RATE,
        Parameter(
            "stop_trajectory_duration",
            NUMBER,
            "time to come to rest in, on an empty trajectory or a cancelled goal; 0 holds the measured positions",
            "s",
            default=0.0,
        ),
        Parameter("allow_partial_joints_goal", BOOLEAN, "takes trajectories of some of the joints", default=False),
        Parameter(
            "constraints/goal_time", NUMBER, "time after the end to meet the goal tolerances in", "s", default=0.0
        ),
        Parameter(
            "constraints/stopped_velocity_tolerance",
            NUMBER,
            "largest velocity at the end of a goal; 0 checks none",
            "m/s or rad/s",
            default=0.01,
        ),
        Parameter(
            "constraints/<joint>/trajectory",
            NUMBER,
            "largest position error on the way of a goal; 0 checks none",
            "m or rad",
            default=0.0,
        ),
        Parameter(
            "constraints/<joint>/goal",
            NUMBER,
            "largest position error at the end of a goal; 0 checks none",
            "m or rad",
            default=0.0,
        ),
    )
    interface_type: type[ResourceManager[Any]]
    _joints: tuple[JointStateHandle, ...]

    # Init.

    def init(self, interface: ResourceManager[Any], node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint, or the robot description is missing or wrong."""
        self._node = node
        self._state_period_ns = period_of(node, STATE_RATE)
        monitor_period_ns = period_of(node, MONITOR_RATE)
        self._stop_duration_s = params.number(node, "stop_trajectory_duration") or 0.0
        if not 0.0 <= self._stop_duration_s < float("inf"):
            raise Refused(f"parameter {node.namespace}/stop_trajectory_duration must not be below 0")
        self._allow_partial = params.boolean(node, "allow_partial_joints_goal") or False
        self._names = joint_names(node)
        self._turns = [joint_on_paper(node, name).type == "continuous" for name in self._names]
        self._joints = tuple(interface.get_handle(name) for name in self._names)
        warn_of_other_joints(node, "constraints", [*self._names, "goal_time", "stopped_velocity_tolerance"])
        self._tolerances = self._default_tolerances()
        self._get_commands(node)
        nothing = [0.0] * len(self._names)
        self.desired = self.actual = self.error = MeasuredJoints(nothing, nothing, nothing)
        self._trajectory: Trajectory = []
        self._time_ns = self._uptime_ns = self._period_ns = self._published_ns = 0
        self._period_of_s: tuple[float, int] = (0.0, 0)
        self._reached = [False] * len(self._names)
        """The joints at their goals. As upstream, only the end of a goal clears it, not its cancellation."""
        self._state = node.advertise("state", "control_msgs/JointTrajectoryControllerState")
        node.advertise_service("query_state", "control_msgs/QueryTrajectoryState", self._query_state)
        self._serve(node, "follow_joint_trajectory", "control_msgs/FollowJointTrajectory", monitor_period_ns)
        node.subscribe("command", "trajectory_msgs/JointTrajectory", self._take_command)

    def _get_commands(self, node: NodeHandle) -> None:
        """Get what the commands need besides the joints. Raises SlidectlError."""

    def _start_commands(self) -> None:
        """The first commands, at the start."""

    def _command(self, period_s: float) -> None:
        """The commands for the desired states of this cycle."""
        raise NotImplementedError

    def _default_tolerances(self) -> list[SegmentTolerances]:
        """Of each joint, by the parameters."""
        stopped = self._tolerance("constraints/stopped_velocity_tolerance", 0.01)
        goal_time_s = params.number(self._node, "constraints/goal_time") or 0.0
        return [
            SegmentTolerances(
                StateTolerances(self._tolerance(f"constraints/{name}/trajectory")),
                StateTolerances(self._tolerance(f"constraints/{name}/goal"), stopped),
                goal_time_s,
            )
            for name in self._names
        ]

    def _tolerance(self, name: str, default: float = 0.0) -> float:
        value = params.number(self._node, name)
        if value is not None and value < 0.0:
            self._node.log("warn", f"{self._node.namespace}/{name} is below 0: it is not checked")
        return default if value is None else value

    # The cycle.

    def starting(self, time_ns: int) -> None:
        """Stay where the joints are."""
        self._time_ns = time_ns
        self._uptime_ns = self._period_ns = self._published_ns = 0
        positions = [joint.position for joint in self._joints]
        velocities = [joint.velocity for joint in self._joints]
        self.desired = self.desired._replace(positions=positions, velocities=velocities)
        self._hold()
        self._start_commands()

    def update(self, time_ns: int, period_s: float) -> None:
        if period_s != self._period_of_s[0]:
            self._period_of_s = period_s, from_seconds(period_s)
        self._time_ns = time_ns
        self._period_ns = self._period_of_s[1]
        self._uptime_ns += self._period_ns
        uptime_s = to_seconds(self._uptime_ns)
        active = self._sample(uptime_s)
        if self._goal is not None:
            self._judge(active, uptime_s)
        self._command(period_s)
        if self._goal is not None:
            self._goal.feedback = partial(self._message, time_ns, self.desired, self.actual, self.error)
        if self._published_ns + self._state_period_ns < self._uptime_ns:
            self._published_ns += self._state_period_ns
            if self._state.wanted:
                self._state.publish(self._message(time_ns, self.desired, self.actual, self.error))
            else:
                self._state.sequence += 1

    def _sample(self, uptime_s: float) -> list[Segment]:
        """Take the desired and the actual states and the errors. Returns the segment of each joint.

        The error of the position is the shortest angle for every joint, as upstream, also for one that slides.
        """
        active = []
        desired_p, desired_v, desired_a, actual_p, actual_v, error_p, error_v = [], [], [], [], [], [], []
        for joint, segments in zip(self._joints, self._trajectory, strict=True):
            segment = segments[find_segment(segments, uptime_s)]
            position, velocity, acceleration = segment.sample(uptime_s)
            active.append(segment)
            desired_p.append(position)
            desired_v.append(velocity)
            desired_a.append(acceleration)
            actual_p.append(joint.position)
            actual_v.append(joint.velocity)
            error_p.append(shortest_angular_distance(joint.position, position))
            error_v.append(velocity - joint.velocity)
        first = active[0]
        desired_s = first.time_from_start_s
        actual_s = uptime_s - first.start_s + desired_s
        self.desired = MeasuredJoints(desired_p, desired_v, desired_a, desired_s)
        self.actual = MeasuredJoints(actual_p, actual_v, [], actual_s)
        self.error = MeasuredJoints(error_p, error_v, [], desired_s - actual_s)
        return active

    def _judge(self, active: list[Segment], uptime_s: float) -> None:
        """Hold the errors against the tolerances of the goal. What violates them ends it, but not the motion."""
        for k, segment in enumerate(active):
            if self._goal is None or segment.goal is not self._goal:
                continue
            error, error_dot = self.error.positions[k], self.error.velocities[k]
            tolerances = segment.tolerances
            if uptime_s < segment.end_s:
                if not tolerances.path.allow(error, error_dot):
                    self._abort(PATH_TOLERANCE_VIOLATED, f"{self._names[k]} path error {error:f}")
            elif segment is self._trajectory[k][-1]:
                if tolerances.goal.allow(error, error_dot):
                    self._reached[k] = True
                elif not uptime_s < segment.end_s + tolerances.goal_time_s:
                    self._abort(GOAL_TOLERANCE_VIOLATED, f"{self._names[k]} goal error {error:f}")
        if self._goal is not None and all(self._reached):
            self._goal.decide(GoalStatus.SUCCEEDED, _result(SUCCESSFUL))
            self._end_goal()

    def _abort(self, code: int, text: str) -> None:
        """The goal has failed; the client hears of it at once."""
        assert self._goal is not None
        self._goal.decide(GoalStatus.ABORTED, _result(code, text))
        self._goal.tick()
        self._end_goal()

    def _end_goal(self) -> None:
        self._goal = None
        self._reached = [False] * len(self._names)

    def _message(self, time_ns: int, desired: MeasuredJoints, actual: MeasuredJoints, error: MeasuredJoints) -> Message:
        """As control_msgs/JointTrajectoryControllerState, and as the action's feedback."""
        return {
            "header": {"seq": 0, "stamp": to_stamp(time_ns), "frame_id": ""},
            "joint_names": self._names,
            "desired": desired.message(with_accelerations=True),
            "actual": actual.message(),
            "error": error.message(),
        }

    # What clients ask for, between two cycles.

    def _take_command(self, message: Message) -> None:
        try:
            self._replace(message, None)
        except Refused as refusal:
            self._node.log("error", f"{self._node.namespace}: {refusal.message}")
            raise MessageRefused(refusal.message) from None
        self._preempt()

    def _take_goal(self, handle: GoalHandle) -> None:
        trajectory = handle.goal["trajectory"]
        if self.state is not State.RUNNING:
            self._reject(handle, "Can't accept new action goals. Controller is not running.", _result(INVALID_GOAL))
        elif self._order_of(trajectory["joint_names"]) is None:
            self._reject(handle, "Joints on incoming goal don't match the controller joints.", _result(INVALID_JOINTS))
        else:
            goal = MonitoredGoal(handle)
            try:
                self._replace(trajectory, goal)
            except Refused as refusal:
                self._reject(handle, refusal.message, _result(INVALID_GOAL, refusal.message))
                return
            self._follow(goal)

    def _query_state(self, request: Message) -> Message:
        if self.state is not State.RUNNING:
            raise Refused("Can't sample trajectory. Controller is not running.")
        offset_ns = _duration(from_stamp(request["time"]) - self._time_ns)
        time_s = to_seconds(_time(self._uptime_ns + offset_ns))
        if any(time_s < segments[0].start_s for segments in self._trajectory):
            raise Refused("Requested sample time precedes trajectory start time.")
        samples = [segments[find_segment(segments, time_s)].sample(time_s) for segments in self._trajectory]
        positions, velocities, accelerations = map(list, zip(*samples, strict=True))
        return {"name": self._names, "position": positions, "velocity": velocities, "acceleration": accelerations}

    # Trajectories.

    def _hold(self, goal: MonitoredGoal | None = None) -> None:
        """From now on come to rest: at the measured positions, or from the desired motion in the time for that."""
        now_s = to_seconds(self._uptime_ns)
        self._trajectory = []
        for k, joint in enumerate(self._joints):
            if self._stop_duration_s == 0.0:
                state = PointState(joint.position, 0.0, 0.0)
                segment = Segment(now_s, state, now_s, state)
            else:
                # Half-way of a motion to the same place with the opposite velocity, the velocity is 0.
                end_s = now_s + self._stop_duration_s
                state = PointState(self.desired.positions[k], self.desired.velocities[k], 0.0)
                back = PointState(state.position, -self.desired.velocities[k], 0.0)
                half = Segment(now_s, state, now_s + 2.0 * self._stop_duration_s, back)
                segment = Segment(now_s, state, end_s, PointState(*half.sample(end_s)))
            segment.goal = goal
            self._trajectory.append([segment])

    def _order_of(self, wanted: Sequence[str]) -> list[int] | None:
        """The positions of a message's joints among ours; None when it has not all of them, or others."""
        counts_fit = 0 < len(wanted) <= len(self._names) and (self._allow_partial or len(wanted) == len(self._names))
        if not counts_fit or not set(wanted) <= set(self._names):
            return None
        return [self._names.index(name) for name in wanted]

    def _replace(self, message: Message, goal: MonitoredGoal | None) -> None:
        """Follow a trajectory_msgs/JointTrajectory from its start on, and what is there until then.

        Raises:
            Refused: with upstream's text; then nothing changes.
        """
        if self.state is not State.RUNNING:
            raise Refused("Can't accept new commands. Controller is not running.")
        points: list[Message] = message["points"]
        if not points:
            self._hold(goal)
            return
        next_ns, next_uptime_ns = self._time_ns + self._period_ns, self._uptime_ns + self._period_ns
        offsets_ns = [from_stamp(point["time_from_start"]) for point in points]
        if any(one >= other for one, other in pairwise(offsets_ns)):
            raise Refused("Trajectory message contains waypoints that are not strictly increasing in time.")
        start_ns = from_stamp(message["header"]["stamp"]) or next_ns
        start_uptime_ns = _time(next_uptime_ns + _duration(start_ns - next_ns))
        order = self._order_of(message["joint_names"])
        if order is None:
            raise Refused("Cannot create trajectory from message. It does not contain the expected joints.")
        tolerances = self._tolerances if goal is None else self._goal_tolerances(goal.handle.goal)
        first = self._first_point(message, offsets_ns, start_ns, next_ns)
        points, offsets_ns = points[first:], offsets_ns[first:]
        _check_points(points, len(order))
        times_s = [to_seconds(_time(start_uptime_ns + offset_ns)) for offset_ns in offsets_ns]
        next_s, start_s = to_seconds(next_uptime_ns), to_seconds(start_uptime_ns)
        changed: dict[int, list[Segment]] = {}
        for column, k in enumerate(order):
            old = self._trajectory[k]
            begin_s = max(start_s, next_s)
            begin = PointState(*old[find_segment(old, begin_s)].sample(begin_s))
            offset = wraparound_offset(begin.position, points[0]["positions"][column]) if self._turns[k] else 0.0
            states = [
                _state(point, column, offset, offset_ns) for point, offset_ns in zip(points, offsets_ns, strict=True)
            ]
            new = [Segment(begin_s, begin, start_s + to_seconds(offsets_ns[0]), states[0])]
            ends = zip(pairwise(times_s), pairwise(states), strict=True)
            new += [Segment(from_s, start, to_s, end) for (from_s, to_s), (start, end) in ends]
            for segment in new:
                segment.goal = goal
                segment.tolerances = UNCHECKED if goal is None else tolerances[k]
            changed[k] = old[find_segment(old, next_s) : find_segment(old, begin_s) + 1] + new
        self._trajectory = [
            changed[k] if k in changed else _for_goal(segments, next_s, goal)
            for k, segments in enumerate(self._trajectory)
        ]

    def _first_point(self, message: Message, offsets_ns: list[int], start_ns: int, next_ns: int) -> int:
        """The index of the first point that is not over yet; the others are dropped, which is said.

        Raises:
            Refused: all are over.
        """
        first = next((k for k, offset_ns in enumerate(offsets_ns) if next_ns < _time(start_ns + offset_ns)), None)
        if first is None:
            late_s = to_seconds(next_ns - start_ns - offsets_ns[-1])
            raise Refused(
                f"Dropping all {len(offsets_ns)} trajectory point(s), as they occur before the current time.\n"
                f"Last point is {late_s:f}s in the past."
            )
        is_usual = first == 1 and offsets_ns[0] == 0 and from_stamp(message["header"]["stamp"]) == 0
        if first > 0 and not is_usual:
            self._node.log(
                "warn",
                f"{self._node.namespace}: Dropping first {first} trajectory point(s) out of {len(offsets_ns)}, as they "
                "occur before the current time.\nFirst valid point will be reached in "
                f"{to_seconds(start_ns + offsets_ns[first] - next_ns):.3f}s.",
            )
        return first

    def _goal_tolerances(self, goal: Message) -> list[SegmentTolerances]:
        """The default ones of each joint with those that a goal has of its own."""
        time_ns = from_stamp(goal["goal_time_tolerance"])
        found = []
        for name, (path, end, goal_time_s) in zip(self._names, self._tolerances, strict=True):
            for message in goal["path_tolerance"]:
                path = path.updated(message) if message["name"] == name else path
            for message in goal["goal_tolerance"]:
                end = end.updated(message) if message["name"] == name else end
            found.append(SegmentTolerances(path, end, _replaced(goal_time_s, to_seconds(time_ns))))
        for message in (*goal["path_tolerance"], *goal["goal_tolerance"]):
            if message["name"] not in self._names:
                self._node.log(
                    "warn", f"{self._node.namespace} has no joint {message['name']!r}: its tolerance is ignored"
                )
        return found


def _for_goal(segments: list[Segment], next_s: float, goal: MonitoredGoal | None) -> list[Segment]:
    """The segments of a joint that a partial trajectory does not name: those to come count for the new goal."""
    active = find_segment(segments, next_s)
    return segments[:active] + [segment.for_goal(goal) for segment in segments[active:]]


def _check_points(points: list[Message], joints: int) -> None:
    """Raises Refused: the sizes of a point's lists differ, or a number is not finite.

    Upstream takes nan, reads past the end of lists that are too short, and ignores positions that are too many.
    """
    for k, point in enumerate(points):
        size = len(point["positions"])
        if any(point[name] and len(point[name]) != size for name in ("velocities", "accelerations")):
            raise Refused("Size mismatch in trajectory point position, velocity or acceleration data.")
        if size == 0:
            raise Refused(
                "Can't construct segment from ROS message: Start/end points data size mismatch."
                if k
                else "Size mismatch between trajectory point and vector specifying whether joints wrap around."
            )
        if size < joints:
            raise Refused(f"a trajectory point has {size} positions for {joints} joints")
        if not all(map(isfinite, (*point["positions"], *point["velocities"], *point["accelerations"]))):
            raise Refused("a trajectory point has nan or infinity: it must have finite numbers")


def _state(point: Message, column: int, offset: float, time_ns: int) -> PointState:
    """One joint's part of a trajectory_msgs/JointTrajectoryPoint, its position with an offset."""
    velocity = point["velocities"][column] if point["velocities"] else None
    acceleration = point["accelerations"][column] if point["accelerations"] else None
    return PointState(point["positions"][column] + offset, velocity, acceleration, to_seconds(time_ns))


def _time(time_ns: int) -> int:
    """The same time. Raises Refused: ros::Time cannot hold it."""
    if not 0 <= time_ns < 2**32 * NANOSECONDS:
        raise Refused("Time is out of dual 32-bit range")
    return time_ns


def _duration(duration_ns: int) -> int:
    """The same duration. Raises Refused: ros::Duration cannot hold it."""
    if not -(2**31) * NANOSECONDS <= duration_ns < 2**31 * NANOSECONDS:
        raise Refused("Duration is out of dual 32-bit range")
    return duration_ns


def _result(code: int, text: str = "") -> Message:
    """As control_msgs/FollowJointTrajectoryResult."""
    return {"error_code": code, "error_string": text}


@controller("position_controllers/JointTrajectoryController")
class PositionJointTrajectoryController(JointTrajectoryController):
    """The commands are the desired positions."""

    interface_type = PositionJointInterface
    _joints: tuple[JointHandle, ...]

    def _start_commands(self) -> None:
        for joint in self._joints:
            joint.command = joint.position

    def _command(self, period_s: float) -> None:  # noqa: ARG002
        for joint, position in zip(self._joints, self.desired.positions, strict=True):
            joint.command = position


class PidJointTrajectoryController(JointTrajectoryController):
    """command = feed-forward gain · desired velocity + pid(errors of position and velocity)."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *JointTrajectoryController.parameters,
        *within("gains/<joint>", GAINS),
        Parameter("velocity_ff/<joint>", NUMBER, "command per desired velocity, without any error", default=0.0),
    )
    _joints: tuple[JointHandle, ...]

    def _get_commands(self, node: NodeHandle) -> None:
        for place in ("gains", "velocity_ff"):
            warn_of_other_joints(node, place, self._names)
        self._pids = [ReconfigurablePid(node.child(f"gains/{name}")).pid for name in self._names]
        self._velocity_ff = [params.number(node, f"velocity_ff/{name}") or 0.0 for name in self._names]

    def _start_commands(self) -> None:
        for joint, pid in zip(self._joints, self._pids, strict=True):
            pid.reset()
            joint.command = 0.0

    def _command(self, period_s: float) -> None:
        for k, (joint, pid) in enumerate(zip(self._joints, self._pids, strict=True)):
            error = self.error.positions[k]
            correction = next_command_from(pid, error, self.error.velocities[k], period_s)
            joint.command = self.desired.velocities[k] * self._velocity_ff[k] + correction
            if pid.observer is not None:
                pid.tell(error, period_s)


@controller("effort_controllers/JointTrajectoryController")
class EffortJointTrajectoryController(PidJointTrajectoryController):
    """The commands are efforts."""

    interface_type = EffortJointInterface


@controller("velocity_controllers/JointTrajectoryController")
class VelocityJointTrajectoryController(PidJointTrajectoryController):
    """The commands are velocities."""

    interface_type = VelocityJointInterface


@controller("pos_vel_controllers/JointTrajectoryController")
class PosVelJointTrajectoryController(JointTrajectoryController):
    """The commands are the desired positions and velocities."""

    interface_type: type[ResourceManager[Any]] = PosVelJointInterface
    _joints: tuple[PosVelJointHandle, ...]

    def _command(self, period_s: float) -> None:  # noqa: ARG002
        for k, joint in enumerate(self._joints):
            joint.command_position = self.desired.positions[k]
            joint.command_velocity = self.desired.velocities[k]


@controller("pos_vel_acc_controllers/JointTrajectoryController")
class PosVelAccJointTrajectoryController(PosVelJointTrajectoryController):
    """The commands are the desired positions, velocities and accelerations."""

    interface_type = PosVelAccJointInterface
    _joints: tuple[PosVelAccJointHandle, ...]

    def _command(self, period_s: float) -> None:
        super()._command(period_s)
        for joint, acceleration in zip(self._joints, self.desired.accelerations, strict=True):
            joint.command_acceleration = acceleration
