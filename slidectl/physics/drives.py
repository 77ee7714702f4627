"""How a joint is driven by its command each step: the modes of DefaultRobotHWSim other than plain effort.

A drive reads its handle and puts a force, a position or a motor into the world. Limits were enforced before.
"""

from __future__ import annotations

from slidectl.control.angular_distance import distance_with_limits, shortest_angular_distance
from slidectl.control.hardware_interface import EffortJointInterface, JointHandle, PositionJointInterface
from slidectl.control.laws import Columns, law
from slidectl.control.limits import bounded
from slidectl.control.node_handle import NodeHandle
from slidectl.control.params import BadParameter
from slidectl.control.pid import Pid, next_command
from slidectl.control.reconfigurable_pid import ReconfigurablePid
from slidectl.physics.body import Body
from slidectl.physics.effort import EffortTruncation
from slidectl.physics.hw_joint import HardwareJoint
from slidectl.physics.world import World

GAINS = "gazebo_ros_control/pid_gains"

REACH = 1.01
"""A position command at most this many times the velocity limit away (per step) is moved to, else it is set."""


MOTOR, EFFORT, VELOCITY, LENGTH, REVOLVING, TURNING = range(6)
"""What a drive makes of a command: the velocity of a motor, an effort, or an effort by a PID on the difference of two
velocities, lengths, angles between limits, or angles on the circle."""


@law
def drive_error(drive: Drive, joint: JointHandle) -> float:
    """Command minus what was measured at the last read. For angles the shortest turn, within the limits if any."""
    if drive.kind == VELOCITY:
        return joint.command - joint.velocity
    if drive.kind == REVOLVING:
        return distance_with_limits(joint.position, joint.command, drive.lower, drive.upper)
    if drive.kind == TURNING:
        return shortest_angular_distance(joint.position, joint.command)
    return joint.command - joint.position


@law
def drive_effort(drive: Drive, pid: Pid, joint: JointHandle, period_s: float) -> float:
    """The effort for the joint's command, before the joint's bounds cut it."""
    if drive.kind == EFFORT:
        return joint.command
    return bounded(next_command(pid, drive_error(drive, joint), period_s), -drive.limit, drive.limit)


class Drive:
    """Base: `apply` once a step; `stopped` is the emergency stop."""

    kind = MOTOR
    pid: Pid | None = None
    columns = Columns(fixed="kind lower upper limit", places="pid joint", whole="kind pid joint")

    def __init__(self, joint: HardwareJoint, world: World, body: Body) -> None:
        self.joint = joint
        self.lower, self.upper, self.limit = joint.bounds.lower, joint.bounds.upper, joint.bounds.effort
        self.handle = joint.handle
        self.world = world
        self.body = body
        self.truncation = EffortTruncation.of(joint.joint)

    def apply(self, period_s: float, stopped: bool) -> None:
        """Drive the joint for the step to come; `period_s` since the last call."""
        raise NotImplementedError

    def reset(self) -> None:
        """Forget the past."""

    def push(self, effort: float) -> None:
        """Gazebo's SetForce: cut by the joint's limits; several in one step add up."""
        place, data = self.body.joints[self.joint.name], self.world.data
        data.qfrc_applied[place.dof] += self.truncation.cut(effort, float(data.qvel[place.dof]))

    def turn(self, velocity: float, max_effort: float) -> None:
        """Let a motor bring the joint to this velocity within the step."""
        self.world.ask_motor(self.body, self.joint.name, velocity, max_effort)


class EffortDrive(Drive):
    """The command is the effort."""

    kind = EFFORT

    def apply(self, period_s: float, stopped: bool) -> None:  # noqa: ARG002 - this drive has no memory
        if not stopped:
            self.push(self.handle.command)


class VelocityDrive(Drive):
    """A motor brings the joint to the commanded velocity in one step, with no more than the joint's effort limit."""

    def apply(self, period_s: float, stopped: bool) -> None:  # noqa: ARG002 - this drive has no memory
        self.turn(0.0 if stopped else self.handle.command, self.limit)


class PositionDrive(Drive):
    """The joint is where the command says after the step, whatever acts on it.

    Gazebo puts it there and lets the links keep their velocities, so gravity makes these grow for ever. Here the
    joint moves with the velocity that leads there, when its velocity limit allows that in one step; a command
    farther off, or of a joint without velocity limit, puts it there at rest. Either way a motor without bounds
    holds it against gravity and contacts.
    """

    def apply(self, period_s: float, stopped: bool) -> None:  # noqa: ARG002 - the hardware holds the command then
        place, data, step = self.body.joints[self.joint.name], self.world.data, self.world.timestep
        velocity = (self.handle.command - float(data.qpos[place.qpos])) / step
        limit = self.joint.joint.limit
        if limit is None or abs(velocity) > REACH * limit.velocity:
            data.qpos[place.qpos], data.qvel[place.dof], velocity = self.handle.command, 0.0, 0.0
        self.turn(velocity, float("inf"))


class PidDrive(Drive):
    """A PID makes an effort of the error, within the joint's effort limit. Its gains can be changed while it runs."""

    pid: Pid

    def __init__(self, joint: HardwareJoint, world: World, body: Body, pid: Pid, kind: int) -> None:
        super().__init__(joint, world, body)
        self.pid = pid
        self.kind = kind

    def apply(self, period_s: float, stopped: bool) -> None:
        """Stopped, no velocity is asked for; the hardware holds the commands of positions then."""
        error = -self.handle.velocity if stopped and self.kind == VELOCITY else drive_error(self, self.handle)
        self.push(bounded(self.pid.compute_command(error, period_s), -self.limit, self.limit))

    def reset(self) -> None:
        self.pid.reset()


_POSITION_KINDS = {"revolute": REVOLVING, "continuous": TURNING}


def drive_for(joint: HardwareJoint, world: World, body: Body, node: NodeHandle) -> Drive:
    """The drive of a joint's interface: with a PID where `gazebo_ros_control/pid_gains/<joint>/p` is a number."""
    if joint.interface is EffortJointInterface:
        return EffortDrive(joint, world, body)
    pid = _pid_of(joint, node)
    is_position = joint.interface is PositionJointInterface
    if pid is None:
        return (PositionDrive if is_position else VelocityDrive)(joint, world, body)
    return PidDrive(joint, world, body, pid, _POSITION_KINDS.get(joint.joint.type, LENGTH) if is_position else VELOCITY)


def _pid_of(joint: HardwareJoint, node: NodeHandle) -> Pid | None:
    gains = node.child(f"{GAINS}/{joint.name}")
    if not gains.has_param("p"):
        node.log("info", f"joint {joint.name!r} is driven without PID: no gains at {gains.namespace}")
        return None
    try:
        return ReconfigurablePid(gains).pid
    except BadParameter as error:
        node.log("error", f"joint {joint.name!r} is driven without PID: {error}")
        return None
