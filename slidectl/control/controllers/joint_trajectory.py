"""Follows trajectories of joints by commands and by an action, after ros_controllers' joint_trajectory_controller.

A trajectory is a block of numbers, in which each joint has a range of segments (`control/segments.py`). Times are
seconds of the controller's uptime, which counts from its start. New trajectories are blended with the present one when
they arrive, between two cycles; an update only samples. The interpreter runs an update in which a goal ends.

Topics `command` and `state`, service `query_state`, action `follow_joint_trajectory`. The types of the joints come from
`robot_description`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf, pi
from typing import Any, ClassVar

from slidectl.control import params, segments
from slidectl.control.angular_distance import shortest_angular_distance
from slidectl.control.controller_interface import Compiled, Member, Parts, State
from slidectl.control.duration import NANOSECONDS, from_seconds, header_of, nearest_ns, to_seconds, to_stamp
from slidectl.control.goals import MONITOR_RATE, ActionController, MonitoredGoal, period_of
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointHandle,
    JointStateHandle,
    PositionJointInterface,
    PosVelAccJointInterface,
    PosVelJointInterface,
    ResourceManager,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import joint_names, warn_of_other_joints
from slidectl.control.laws import LEAVE, Columns, LawTables, law
from slidectl.control.node_handle import GoalHandle, GoalStatus, Message, NodeHandle
from slidectl.control.params import BOOLEAN, JOINTS, NUMBER, Parameter, within
from slidectl.control.pid import GAINS, Pid, ReconfigurablePid, next_command_from
from slidectl.control.registry import controller
from slidectl.control.robot_description import joint_of_model
from slidectl.control.segments import (
    END,
    END_POSITION,
    END_TIME,
    END_VELOCITY,
    FROM_START,
    GOAL,
    PATH_POSITION,
    PATH_VELOCITY,
    SIZE,
    START,
    TOLERANCES,
    sample,
)
from slidectl.effects import Effect
from slidectl.errors import MessageRefused, Refused
from slidectl.msgs.schema import nanoseconds

SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -2, -4, -5
"""Error codes of control_msgs/FollowJointTrajectoryResult."""


STATE_RATE = Parameter("state_publish_rate", NUMBER, "messages on `state` per simulated second", "1/s", default=50.0)
STOP_DURATION = Parameter(
    "stop_trajectory_duration",
    NUMBER,
    "time to come to rest in, on an empty trajectory or a cancelled goal; 0 holds the measured positions",
    "s",
    default=0.0,
)
GOAL_TIME = Parameter(
    "constraints/goal_time", NUMBER, "time after the end to meet the goal tolerances in", "s", default=0.0
)
STOP_ON_ABORT = Parameter(
    "stop_on_abort",
    BOOLEAN,
    "stops the motion as a cancelled goal does when a tolerance aborts a goal, as ROS 2 does; ros_controllers drive on",
    default=False,
)
STOPPED_VELOCITY = Parameter(
    "constraints/stopped_velocity_tolerance",
    NUMBER,
    "largest velocity at the end of a goal; 0 checks none",
    "m/s or rad/s",
    default=0.01,
)


def _replaced(old: float, new: float) -> float:
    """A tolerance after that of a goal: above 0 replaces, below 0 switches off, 0 keeps."""
    return new if new > 0.0 else 0.0 if new < 0.0 else old


class Motion:
    """One joint's range of segments, and its states of the last update: desired, measured, and the errors."""

    columns = Columns(
        changing="index position velocity acceleration actual_position actual_velocity position_error velocity_error "
        "reached",
        fixed="last velocity_ff",
        whole="index reached last",
    )

    def __init__(self) -> None:
        self.position = self.velocity = self.acceleration = 0.0
        self.actual_position = self.actual_velocity = self.position_error = self.velocity_error = 0.0
        self.velocity_ff = 0.0
        """Command per desired velocity."""
        self.reached = False
        """True when the joint is at its goal. As upstream, the end of a goal clears it, its cancellation does not."""
        self.place(0, 0)

    def place(self, first: int, last: int) -> None:
        """Set the range of segments, by the indices of the first and the last one in the block."""
        self.index, self.last = first, last
        self.segment: list[float] = []
        """The numbers of the present segment, for the interpreter. At `next_s` the next one begins."""
        self.next_s = -inf

    def segment_at(self, numbers: Any, time_s: float) -> list[float]:
        """The last segment that has started, or the first one. Times never decrease."""
        if time_s >= self.next_s or not self.segment:
            advance(self, numbers, time_s)
            begin, end = self.index * SIZE, (self.index + 1) * SIZE
            self.segment = numbers[begin:end].tolist()
            self.next_s = numbers[end + START] if self.index < self.last else inf
        return self.segment


@law
def advance(motion: Motion, numbers: Any, time_s: float) -> None:
    """Set the index to the last segment that has started."""
    while motion.index < motion.last and numbers[(motion.index + 1) * SIZE + START] <= time_s:
        motion.index += 1


UNDECIDED, REACHED, OFF_PATH, OFF_GOAL = range(4)
"""Verdicts on a goal by one of its joints."""


@law
def judged(segment: Any, is_last: bool, time_s: float, error: float, error_dot: float) -> int:
    """The verdict on the errors of position and velocity by the tolerances of a segment."""
    size, size_dot = abs(error), abs(error_dot)
    if time_s < segment[END]:
        is_off = 0.0 < segment[PATH_POSITION] < size or 0.0 < segment[PATH_VELOCITY] < size_dot
        return OFF_PATH if is_off else UNDECIDED
    if not is_last:
        return UNDECIDED
    if not (0.0 < segment[END_POSITION] < size or 0.0 < segment[END_VELOCITY] < size_dot):
        return REACHED
    return UNDECIDED if time_s < segment[END] + segment[END_TIME] else OFF_GOAL


@law
def store_states(
    motion: Motion, joint: JointStateHandle, position: float, velocity: float, acceleration: float, error: float
) -> None:
    """Store the states of an update: the desired ones, the measured ones and the errors."""
    motion.position, motion.velocity, motion.acceleration = position, velocity, acceleration
    motion.actual_position, motion.actual_velocity = joint.position, joint.velocity
    motion.position_error, motion.velocity_error = error, velocity - joint.velocity


@law
def count_time(follower: Any, period_s: float) -> int:
    """The uptime of the update that begins, in ns. Stores the period."""
    if period_s != follower.period_s:
        follower.period_s = period_s
        follower.period_ns = nearest_ns(period_s)
    uptime_ns: int = follower.uptime_ns + follower.period_ns
    return uptime_ns


@law
def state_is_due(follower: Any) -> bool:
    """True when a message on `state` is due. Counts it, even without subscribers."""
    if not follower.published_ns + follower.state_period_ns < follower.uptime_ns:
        return False
    follower.published_ns += follower.state_period_ns
    follower.states += 1
    return True


@law
def goal_goes_on(follower: Any, tables: LawTables, uptime_s: float) -> bool:
    """False when the goal ends in this update; the changes made so far are then harmless, its end clears them."""
    reached = 0
    for k in range(len(tables.members)):
        motion = tables.members[k]
        advance(motion, tables.numbers, uptime_s)
        segment = tables.numbers[motion.index * SIZE : (motion.index + 1) * SIZE]
        if segment[GOAL] == follower.goal_number:
            joint = tables.joints[motion.joint]
            position, velocity, _ = sample(segment, uptime_s)
            error = shortest_angular_distance(joint.position, position)
            verdict = judged(segment, motion.index == motion.last, uptime_s, error, velocity - joint.velocity)
            if verdict >= OFF_PATH:
                return False
            if verdict == REACHED:
                motion.reached = True
        reached += motion.reached
    return reached < len(tables.members)


@law
def follow(follower: Any, tables: LawTables, time_ns: int, period_s: float) -> bool:
    """The update on rows, without the commands. False: the interpreter must run this update."""
    uptime_ns = count_time(follower, period_s)
    uptime_s = to_seconds(uptime_ns)
    if follower.goal_number != 0 and not goal_goes_on(follower, tables, uptime_s):
        return False
    for k in range(len(tables.members)):
        motion = tables.members[k]
        joint = tables.joints[motion.joint]
        advance(motion, tables.numbers, uptime_s)
        segment = tables.numbers[motion.index * SIZE : (motion.index + 1) * SIZE]
        position, velocity, acceleration = sample(segment, uptime_s)
        error = shortest_angular_distance(joint.position, position)
        store_states(motion, joint, position, velocity, acceleration, error)
    follower.time_ns = time_ns
    follower.uptime_ns = uptime_ns
    return True


@law
def follow_by_positions(follower: Any, tables: LawTables, time_ns: int, period_s: float) -> int:
    """The update of position joints on rows."""
    if not follow(follower, tables, time_ns, period_s):
        return LEAVE
    for k in range(len(tables.members)):
        motion = tables.members[k]
        tables.joints[motion.joint].command = motion.position
    return int(state_is_due(follower) and follower.wanted != 0)


@law
def correct(motion: Motion, pid: Pid, joint: JointHandle, period_s: float) -> None:
    """command = feed-forward gain · desired velocity + pid(errors of position and velocity)."""
    correction = next_command_from(pid, motion.position_error, motion.velocity_error, period_s)
    joint.command = motion.velocity * motion.velocity_ff + correction


@law
def follow_by_pids(follower: Any, tables: LawTables, time_ns: int, period_s: float) -> int:
    """The update of joints with PIDs on rows."""
    if not follow(follower, tables, time_ns, period_s):
        return LEAVE
    for k in range(len(tables.members)):
        motion = tables.members[k]
        correct(motion, tables.pids[motion.pid], tables.joints[motion.joint], period_s)
    return int(state_is_due(follower) and follower.wanted != 0)


FOLLOWER = Columns(
    changing="time_ns uptime_ns period_s period_ns published_ns states",
    fixed="state_period_ns goal_number",
    whole="time_ns uptime_ns period_ns published_ns states state_period_ns",
)


def wraparound_offset(previous: float, following: float) -> float:
    """The offset to `following` with which a continuous joint moves there from `previous` by the shorter way."""
    distance = shortest_angular_distance(previous, following)
    if abs(abs(distance) - pi) < 1e-9:  # half a turn: towards larger positions if `following` is larger
        distance = abs(distance) if following > previous else -abs(distance)
    return (previous + distance) - following


def point(
    positions: list[float], velocities: list[float], accelerations: list[float], time_from_start_s: float
) -> Message:
    """trajectory_msgs/JointTrajectoryPoint of the states of all joints in one update."""
    return {
        "positions": positions,
        "velocities": velocities,
        "accelerations": accelerations,
        "effort": [],
        "time_from_start": to_stamp(from_seconds(time_from_start_s)),
    }


class JointTrajectoryController(ActionController[Any]):
    """Samples the trajectory in each cycle. Subclasses turn the desired states into commands."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        JOINTS,
        STATE_RATE,
        MONITOR_RATE,
        STOP_DURATION,
        STOP_ON_ABORT,
        Parameter("allow_partial_joints_goal", BOOLEAN, "accepts trajectories of some of the joints", default=False),
        GOAL_TIME,
        STOPPED_VELOCITY,
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
    _pids: Sequence[Pid] = ()

    # Init.

    def init(self, interface: ResourceManager[Any], node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint, or the robot description is missing or wrong."""
        self._node = node
        self.state_period_ns = period_of(node, STATE_RATE)
        monitor_period_ns = period_of(node, MONITOR_RATE)
        self._stop_duration_s: float = params.value_of(node, STOP_DURATION)
        if not 0.0 <= self._stop_duration_s < float("inf"):
            raise Refused(f"parameter {node.namespace}/stop_trajectory_duration must not be below 0")
        self._allow_partial = params.read(node, "allow_partial_joints_goal", BOOLEAN) or False
        self._stops_on_abort = params.value_of(node, STOP_ON_ABORT)
        self._names = joint_names(node)
        joints = [joint_of_model(node, name) for name in self._names]
        self._turns = [joint.type == "continuous" for joint in joints]
        self._limits = [(joint.limit.lower, joint.limit.upper) if joint.limit else (-inf, inf) for joint in joints]
        self._joints = tuple(interface.get_handle(name) for name in self._names)
        warn_of_other_joints(node, "constraints", [*self._names, "goal_time", "stopped_velocity_tolerance"])
        self._tolerances = self._default_tolerances()
        self.motions = [Motion() for _ in self._names]
        self._get_commands(node)
        self._goals = 0
        """The number of accepted goals, which is the number of the present goal in its segments."""
        self._goal_since_ns = 0
        """The uptime at the acceptance of the present goal."""
        self.states = 0
        self._trajectory: list[segments.Rows] = []
        self._numbers: Any = SIZE * [0.0]
        self._start_time(0)
        self._state = node.advertise("state", "control_msgs/JointTrajectoryControllerState")
        node.advertise_service("query_state", "control_msgs/QueryTrajectoryState", self._query_state, Effect.READS)
        self._serve(node, "follow_joint_trajectory", "control_msgs/FollowJointTrajectory", monitor_period_ns)
        node.subscribe("command", "trajectory_msgs/JointTrajectory", self._receive_command)

    def _get_commands(self, node: NodeHandle) -> None:
        """Read further parameters that the commands need. Raises SlidectlError."""

    def _start_commands(self) -> None:
        """Set the first commands, at the start."""

    def _command(self, period_s: float) -> None:
        """Set the commands for the desired states of this cycle."""
        raise NotImplementedError

    def _default_tolerances(self) -> list[tuple[float, ...]]:
        """The tolerances of each joint by the parameters, as the columns `TOLERANCES` of a segment; 0 checks nothing.

        A path has none of velocity. Accelerations are not measured, so they have no tolerance.
        """
        stopped = self._tolerance(STOPPED_VELOCITY.name, STOPPED_VELOCITY.default)
        goal_time_s: float = params.value_of(self._node, GOAL_TIME)
        return [
            (
                self._tolerance(f"constraints/{name}/trajectory"),
                0.0,
                self._tolerance(f"constraints/{name}/goal"),
                stopped,
                goal_time_s,
            )
            for name in self._names
        ]

    def _tolerance(self, name: str, default: float = 0.0) -> float:
        value = params.read(self._node, name, NUMBER)
        if value is not None and value < 0.0:
            self._node.log("warn", f"{self._node.namespace}/{name} is below 0: it is not checked")
        return default if value is None else value

    # The cycle.

    def starting(self, time_ns: int) -> None:
        """Hold the measured positions."""
        self._start_time(time_ns)
        for motion, joint in zip(self.motions, self._joints, strict=True):
            motion.position, motion.velocity = joint.position, joint.velocity
        self._hold()
        self._start_commands()

    def _start_time(self, time_ns: int) -> None:
        self.time_ns = time_ns
        self.uptime_ns = self.period_ns = self.published_ns = 0
        self.period_s = 0.0

    def update(self, time_ns: int, period_s: float) -> None:
        uptime_ns = count_time(self, period_s)
        uptime_s, numbers = to_seconds(uptime_ns), self._numbers
        samples = []
        for joint, motion in zip(self._joints, self.motions, strict=True):
            position, velocity, acceleration = sample(motion.segment_at(numbers, uptime_s), uptime_s)
            # As upstream, the angular distance is used for all joints, prismatic ones too.
            error = shortest_angular_distance(joint.position, position)
            samples.append((motion, joint, position, velocity, acceleration, error))
        if self._goal is not None:
            self._judge(self._goal, samples, uptime_s)
        for states in samples:
            store_states(*states)
        self.time_ns, self.uptime_ns = time_ns, uptime_ns
        self._command(period_s)
        if state_is_due(self) and self._state.wanted:
            self.publish(time_ns, period_s)

    def _judge(self, goal: MonitoredGoal, samples: list[Any], uptime_s: float) -> None:
        """Check the errors against the tolerances of the goal.

        A violation ends the goal, but the motion only with `stop_on_abort`.

        The goal's last feedback is that of the previous update.
        """
        for name, (motion, joint, _, velocity, _, error) in zip(self._names, samples, strict=True):
            if motion.segment[GOAL] != self._goals:
                continue
            is_last = motion.index == motion.last
            verdict = judged(motion.segment, is_last, uptime_s, error, velocity - joint.velocity)
            if verdict == OFF_PATH:
                return self._abort(goal, PATH_TOLERANCE_VIOLATED, f"{name} path error {error:f}")
            if verdict == OFF_GOAL:
                return self._abort(goal, GOAL_TOLERANCE_VIOLATED, f"{name} goal error {error:f}")
            motion.reached = motion.reached or verdict == REACHED
        if all(motion.reached for motion in self.motions):
            goal.last_feedback = self._feedback()
            goal.decide(GoalStatus.SUCCEEDED, _result(SUCCESSFUL))
            self._end_goal()
        return None

    def _abort(self, goal: MonitoredGoal, code: int, text: str) -> None:
        """Abort the goal, and send the result at once."""
        goal.last_feedback = self._feedback()
        goal.decide(GoalStatus.ABORTED, _result(code, text))
        goal.tick(self._feedback)
        self._end_goal()
        if self._stops_on_abort:
            self._hold()

    def _end_goal(self) -> None:
        self._goal = None
        for motion in self.motions:
            motion.reached = False

    def publish(self, time_ns: int, period_s: float) -> None:
        """Publish the states of the last update."""
        self._state.sequence = self.states - 1
        self._state.publish(self._message())

    def _feedback(self) -> Message | None:
        return None if self.uptime_ns == self._goal_since_ns else self._message()

    def _message(self) -> Message:
        """control_msgs/JointTrajectoryControllerState, also used as the action's feedback.

        Measured accelerations are empty. The error of positions is the shortest angle.
        """
        motions = self.motions
        # For the first joint: the time from start at which its segment begins, and the present time from start.
        begin = motions[0].index * SIZE
        desired_s = self._numbers[begin + FROM_START]
        actual_s = to_seconds(self.uptime_ns) - self._numbers[begin + START] + desired_s
        return {
            "header": header_of(self.time_ns),
            "joint_names": self._names,
            "desired": point(
                [motion.position for motion in motions],
                [motion.velocity for motion in motions],
                [motion.acceleration for motion in motions],
                desired_s,
            ),
            "actual": point(
                [motion.actual_position for motion in motions],
                [motion.actual_velocity for motion in motions],
                [],
                actual_s,
            ),
            "error": point(
                [motion.position_error for motion in motions],
                [motion.velocity_error for motion in motions],
                [],
                desired_s - actual_s,
            ),
        }

    @property
    def goal_number(self) -> int:
        """The number of the goal that is followed; 0 for none."""
        return 0 if self._goal is None else self._goals

    def parts(self) -> Parts:
        """The parts of the compiled form."""
        pids = self._pids or len(self._joints) * (None,)
        members = [Member(*part) for part in zip(self.motions, self._joints, pids, strict=True)]
        return Parts((self._state,), members=members, numbers=self._numbers)

    def check_restored(self) -> None:
        rows = len(self._numbers) // SIZE
        if not all(0 <= motion.index <= motion.last < rows for motion in self.motions):
            raise Refused(f"a motion is beyond the {rows} segments")
        if not all(isinstance(row, tuple) and len(row) == SIZE - PATH_POSITION for row in self._tolerances):
            raise Refused("a joint has no tolerances")

    # Requests of clients, between two cycles.

    def _receive_command(self, message: Message) -> None:
        try:
            self._replace(message, None)
        except Refused as refusal:
            self._node.log("error", f"{self._node.namespace}: {refusal.message}")
            raise MessageRefused(refusal.message) from None
        self._preempt()

    def _receive_goal(self, handle: GoalHandle) -> None:
        trajectory = handle.goal["trajectory"]
        if self.state is not State.RUNNING:
            self._reject(handle, "Can't accept new action goals. Controller is not running.", _result(INVALID_GOAL))
        elif self._order_of(trajectory["joint_names"]) is None:
            self._reject(handle, "Joints on incoming goal don't match the controller joints.", _result(INVALID_JOINTS))
        else:
            self._goals += 1
            try:
                self._replace(trajectory, handle)
            except Refused as refusal:
                self._goals -= 1  # the present goal continues
                self._reject(handle, refusal.message, _result(INVALID_GOAL, refusal.message))
                return
            goal = MonitoredGoal(handle)
            self._goal_since_ns = self.uptime_ns
            self._follow(goal)

    def _query_state(self, request: Message) -> Message:
        if self.state is not State.RUNNING:
            raise Refused("Can't sample trajectory. Controller is not running.")
        offset_ns = _duration(nanoseconds(request["time"]) - self.time_ns)
        time_s = to_seconds(_time(self.uptime_ns + offset_ns))
        if any(time_s < rows[0, START] for rows in self._trajectory):
            raise Refused("Requested sample time precedes trajectory start time.")
        samples = [segments.sample_at(rows, time_s) for rows in self._trajectory]
        positions, velocities, accelerations = map(list, zip(*samples, strict=True))
        return {"name": self._names, "position": positions, "velocity": velocities, "acceleration": accelerations}

    # Trajectories.

    def _hold(self, goal_number: int = 0) -> None:
        """Come to rest: at the measured positions, or from the desired motion within `stop_trajectory_duration`."""
        now_s, duration_s = to_seconds(self.uptime_ns), self._stop_duration_s
        begin_s = [now_s] * len(self.motions)
        if duration_s == 0.0:
            begins = ends = segments.states([(joint.position, 0.0, 0.0) for joint in self._joints])
        else:
            # A motion to the same position with the opposite velocity has the velocity 0 half-way.
            begins = segments.states([(motion.position, motion.velocity, 0.0) for motion in self.motions])
            back = segments.states([(motion.position, -motion.velocity, 0.0) for motion in self.motions])
            double = segments.between(begin_s, begins, [now_s + 2.0 * duration_s] * len(begin_s), back)
            ends = segments.states([sample(row.tolist(), now_s + duration_s) for row in double])
        rows = segments.between(begin_s, begins, [now_s + duration_s] * len(begin_s), ends)
        rows[:, GOAL] = goal_number
        self._set_trajectory([rows[k : k + 1] for k in range(len(rows))])

    def _set_trajectory(self, trajectory: list[segments.Rows]) -> None:
        """Follow these segments of each joint."""
        self._trajectory = trajectory
        self._numbers = segments.joined(trajectory)
        first = 0
        for motion, rows in zip(self.motions, trajectory, strict=True):
            motion.place(first, first + len(rows) - 1)
            first += len(rows)

    def _order_of(self, wanted: Sequence[str]) -> list[int] | None:
        """The indices of a message's joints in this controller; None when joints are missing or unknown."""
        counts_fit = 0 < len(wanted) <= len(self._names) and (self._allow_partial or len(wanted) == len(self._names))
        if not counts_fit or not set(wanted) <= set(self._names):
            return None
        return [self._names.index(name) for name in wanted]

    def _replace(self, message: Message, goal: GoalHandle | None) -> None:
        """Follow a trajectory_msgs/JointTrajectory from its start on, and the present trajectory until then.

        Raises:
            Refused: with upstream's text; nothing changes.
        """
        if self.state is not State.RUNNING:
            raise Refused("Can't accept new commands. Controller is not running.")
        goal_number = 0 if goal is None else self._goals
        points: list[Message] = message["points"]
        if not points:
            self._hold(goal_number)
            return
        next_ns, next_uptime_ns = self.time_ns + self.period_ns, self.uptime_ns + self.period_ns
        offsets_ns = [nanoseconds(point["time_from_start"]) for point in points]
        if any(one >= other for one, other in pairwise(offsets_ns)):
            raise Refused("Trajectory message contains waypoints that are not strictly increasing in time.")
        start_ns = nanoseconds(message["header"]["stamp"]) or next_ns
        start_uptime_ns = _time(next_uptime_ns + _duration(start_ns - next_ns))
        order = self._order_of(message["joint_names"])
        if order is None:
            raise Refused("Cannot create trajectory from message. It does not contain the expected joints.")
        first = self._first_point(message, offsets_ns, start_ns, next_ns)
        points, offsets_ns = points[first:], offsets_ns[first:]
        states = segments.states_of(points, len(order))
        self._warn_of_points(points, order)
        _time(start_uptime_ns + offsets_ns[-1])
        times_s = segments.seconds(offsets_ns, start_uptime_ns)
        from_start_s = segments.seconds(offsets_ns)
        next_s, start_s = to_seconds(next_uptime_ns), to_seconds(start_uptime_ns)
        begin_s = max(start_s, next_s)
        tolerances = None if goal is None else self._goal_tolerances(goal.goal)
        trajectory = [rows.copy() for rows in self._trajectory]
        for rows in trajectory:  # the coming segments of joints that are not named count for the new goal
            rows[segments.find(rows, next_s) :, GOAL] = goal_number
        begins = segments.states([segments.sample_at(self._trajectory[k], begin_s) for k in order])
        for column, k in enumerate(order):
            first_position = float(states[0, 0, column])
            offset = wraparound_offset(float(begins[0, column]), first_position) if self._turns[k] else 0.0
            states[0, :, column] += offset
        made = segments.through(begin_s, begins, start_s + from_start_s[0], times_s, states, from_start_s)
        segments.check_range([self._names[k] for k in order], made, first)
        for k, new in zip(order, made, strict=True):
            old = self._trajectory[k]
            new[:, GOAL] = goal_number
            if tolerances is not None:
                new[:, TOLERANCES] = tolerances[k]
            kept = old[segments.find(old, next_s) : segments.find(old, begin_s) + 1]
            trajectory[k] = segments.following(kept, new)
        self._set_trajectory(trajectory)

    def _first_point(self, message: Message, offsets_ns: list[int], start_ns: int, next_ns: int) -> int:
        """The index of the first point in the future. Earlier points are dropped, with a warning.

        Raises:
            Refused: all points are in the past.
        """
        first = next((k for k, offset_ns in enumerate(offsets_ns) if next_ns < _time(start_ns + offset_ns)), None)
        if first is None:
            late_s = to_seconds(next_ns - start_ns - offsets_ns[-1])
            raise Refused(
                f"Dropping all {len(offsets_ns)} trajectory point(s), as they occur before the current time.\n"
                f"Last point is {late_s:f}s in the past."
            )
        is_usual = first == 1 and offsets_ns[0] == 0 and nanoseconds(message["header"]["stamp"]) == 0
        if first > 0 and not is_usual:
            self._node.log(
                "warn",
                f"{self._node.namespace}: Dropping first {first} trajectory point(s) out of {len(offsets_ns)}, as they "
                "occur before the current time.\nFirst valid point will be reached in "
                f"{to_seconds(start_ns + offsets_ns[first] - next_ns):.3f}s.",
            )
        return first

    def _warn_of_points(self, points: list[Message], order: list[int]) -> None:
        """Warn of what ros_controllers take silently: surplus positions, and positions beyond the limits of a joint."""
        most = max(len(point["positions"]) for point in points)
        if most > len(order):
            text = f"a point has {most} positions for {len(order)} joints: the surplus ones have no effect"
            self._node.log("warn", f"{self._node.namespace}: {text}")
        for column, k in enumerate(order):
            lower, upper = self._limits[k]
            wanted = [point["positions"][column] for point in points if column < len(point["positions"])]
            beyond = max(wanted, key=lambda position: max(lower - position, position - upper), default=lower)
            if not self._turns[k] and not lower - _BESIDE <= beyond <= upper + _BESIDE:
                text = f"is commanded to {beyond:g}, outside its limits {lower:g} to {upper:g}"
                self._node.log("warn", f"{self._node.namespace}: {self._names[k]} {text}")

    def _goal_tolerances(self, goal: Message) -> list[tuple[float, ...]]:
        """The tolerances of each joint: the default ones, changed by those of the goal."""
        rows = {name: list(row) for name, row in zip(self._names, self._tolerances, strict=True)}
        for place, first in (("path_tolerance", 0), ("goal_tolerance", 2)):
            for message in goal[place]:
                name = message["name"]
                if name not in rows:
                    self._node.log("warn", f"{self._node.namespace} has no joint {name!r}: its tolerance is ignored")
                    continue
                for column, quantity in enumerate(("position", "velocity"), start=first):
                    rows[name][column] = _replaced(rows[name][column], message[quantity])
        goal_time_s = to_seconds(nanoseconds(goal["goal_time_tolerance"]))
        return [(*rows[name][:-1], _replaced(rows[name][-1], goal_time_s)) for name in self._names]


_BESIDE = 1e-6
"""Positions so close to a limit, in rad or m, were meant to be the limit."""


def _time(time_ns: int) -> int:
    """The time unchanged. Raises Refused: ros::Time cannot hold it."""
    if not 0 <= time_ns < 2**32 * NANOSECONDS:
        raise Refused("Time is out of dual 32-bit range")
    return time_ns


def _duration(duration_ns: int) -> int:
    """The duration unchanged. Raises Refused: ros::Duration cannot hold it."""
    if not -(2**31) * NANOSECONDS <= duration_ns < 2**31 * NANOSECONDS:
        raise Refused("Duration is out of dual 32-bit range")
    return duration_ns


def _result(code: int, text: str = "") -> Message:
    """control_msgs/FollowJointTrajectoryResult."""
    return {"error_code": code, "error_string": text}


@controller("position_controllers/JointTrajectoryController")
class PositionJointTrajectoryController(JointTrajectoryController):
    """The commands are the desired positions."""

    interface_type = PositionJointInterface
    compiled = Compiled(follow_by_positions, FOLLOWER, Motion.columns, instead_of="_command")
    _joints: tuple[JointHandle, ...]

    def _start_commands(self) -> None:
        for joint in self._joints:
            joint.command = joint.position

    def _command(self, period_s: float) -> None:
        for joint, motion in zip(self._joints, self.motions, strict=True):
            joint.command = motion.position


class PidJointTrajectoryController(JointTrajectoryController):
    """command = feed-forward gain · desired velocity + pid(errors of position and velocity)."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *JointTrajectoryController.parameters,
        *within("gains/<joint>", GAINS),
        Parameter("velocity_ff/<joint>", NUMBER, "command per desired velocity, without any error", default=0.0),
    )
    compiled = Compiled(follow_by_pids, FOLLOWER, Motion.columns, instead_of="_command")
    _joints: tuple[JointHandle, ...]

    def _get_commands(self, node: NodeHandle) -> None:
        for place in ("gains", "velocity_ff"):
            warn_of_other_joints(node, place, self._names)
        self._pids = [ReconfigurablePid(node.child(f"gains/{name}")).pid for name in self._names]
        for motion, name in zip(self.motions, self._names, strict=True):
            motion.velocity_ff = params.read(node, f"velocity_ff/{name}", NUMBER) or 0.0

    def _start_commands(self) -> None:
        for joint, pid in zip(self._joints, self._pids, strict=True):
            pid.reset()
            joint.command = 0.0

    def _command(self, period_s: float) -> None:
        for motion, pid, joint in zip(self.motions, self._pids, self._joints, strict=True):
            correct(motion, pid, joint, period_s)
            if pid.observer is not None:
                pid.report(motion.position_error, period_s)


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
    _joints: tuple[JointHandle, ...]

    def _command(self, period_s: float) -> None:
        for motion, joint in zip(self.motions, self._joints, strict=True):
            joint.command, joint.command_velocity = motion.position, motion.velocity


@controller("pos_vel_acc_controllers/JointTrajectoryController")
class PosVelAccJointTrajectoryController(PosVelJointTrajectoryController):
    """The commands are the desired positions, velocities and accelerations."""

    interface_type = PosVelAccJointInterface

    def _command(self, period_s: float) -> None:
        super()._command(period_s)
        for motion, joint in zip(self.motions, self._joints, strict=True):
            joint.command_acceleration = motion.acceleration
