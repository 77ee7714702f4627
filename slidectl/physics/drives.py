"""How a joint is driven by its command each step: the modes of DefaultRobotHWSim other than plain effort.

A drive reads its handle and puts a force, a position or a motor into the world. Limits were enforced before.
"""

from __future__ import annotations

from slidectl.control.angles import distance_with_limits, shortest_angular_distance
from slidectl.control.interfaces import EffortJointInterface, PositionJointInterface
from slidectl.control.limit_laws import bounded
from slidectl.control.live_pid import LivePid
from slidectl.control.node import NodeHandle
from slidectl.control.params import BadParameter
from slidectl.control.pid import Pid
from slidectl.physics.body import Body
from slidectl.physics.effort import EffortTruncation
from slidectl.physics.hw_joint import HardwareJoint
from slidectl.physics.world import World

GAINS = "gazebo_ros_control/pid_gains"

REACH = 1.01
"""A position command at most this many times the velocity limit away (per step) is moved to, else it is set."""


class Drive:
    """Base: `apply` once a step; `stopped` is the emergency stop."""

    def __init__(self, joint: HardwareJoint, world: World, body: Body) -> None:
        self.joint = joint
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

    def apply(self, period_s: float, stopped: bool) -> None:  # noqa: ARG002 - this drive has no memory
        if not stopped:
            self.push(self.handle.command)


class VelocityDrive(Drive):
    """A motor brings the joint to the commanded velocity in one step, with no more than the joint's effort limit."""

    def apply(self, period_s: float, stopped: bool) -> None:  # noqa: ARG002 - this drive has no memory
        self.turn(0.0 if stopped else self.handle.command, self.joint.bounds.effort)


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

    def __init__(self, joint: HardwareJoint, world: World, body: Body, pid: Pid) -> None:
        super().__init__(joint, world, body)
        self.pid = pid

    def apply(self, period_s: float, stopped: bool) -> None:
        limit = self.joint.bounds.effort
        self.push(bounded(self.pid.compute_command(self.error(stopped), period_s), -limit, limit))

    def reset(self) -> None:
        self.pid.reset()

    def error(self, stopped: bool) -> float:
        """Command minus what was measured at the last read."""
        raise NotImplementedError


class PositionPidDrive(PidDrive):
    """The error is a length for sliding joints, and the shortest turn (within the limits, if any) for others."""

    def error(self, stopped: bool) -> float:  # noqa: ARG002 - the hardware holds the command then
        handle, bounds = self.handle, self.joint.bounds
        if self.joint.joint.type == "revolute":
            return distance_with_limits(handle.position, handle.command, bounds.lower, bounds.upper)
        if self.joint.joint.type == "continuous":
            return shortest_angular_distance(handle.position, handle.command)
        return handle.command - handle.position


class VelocityPidDrive(PidDrive):
    """The error is a velocity; stopping means that none is asked for."""

    def error(self, stopped: bool) -> float:
        return -self.handle.velocity if stopped else self.handle.command - self.handle.velocity


def drive_for(joint: HardwareJoint, world: World, body: Body, node: NodeHandle) -> Drive:
    """The drive of a joint's interface: with a PID where `gazebo_ros_control/pid_gains/<joint>/p` is a number."""
    if joint.interface is EffortJointInterface:
        return EffortDrive(joint, world, body)
    pid = _pid_of(joint, node)
    is_position = joint.interface is PositionJointInterface
    if pid is None:
        return (PositionDrive if is_position else VelocityDrive)(joint, world, body)
    return (PositionPidDrive if is_position else VelocityPidDrive)(joint, world, body, pid)


def _pid_of(joint: HardwareJoint, node: NodeHandle) -> Pid | None:
    gains = node.child(f"{GAINS}/{joint.name}")
    if not gains.has_param("p"):
        node.log("info", f"joint {joint.name!r} is driven without PID: no gains at {gains.namespace}")
        return None
    try:
        return LivePid(gains).pid
    except BadParameter as error:
        node.log("error", f"joint {joint.name!r} is driven without PID: {error}")
        return None
