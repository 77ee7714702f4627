"""How a joint is driven by its command each step: the modes of DefaultRobotHWSim other than plain effort.

A drive reads its handle and puts a force, a position or a motor into the world. Limits were enforced before.
"""

from __future__ import annotations

from slidectl.control.interfaces import EffortJointInterface, PositionJointInterface
from slidectl.control.node import NodeHandle
from slidectl.physics.body import Body
from slidectl.physics.effort import EffortTruncation
from slidectl.physics.hw_joint import HardwareJoint
from slidectl.physics.world import World

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


def drive_for(joint: HardwareJoint, world: World, body: Body, node: NodeHandle) -> Drive:  # noqa: ARG001
    """The drive of a joint's interface."""
    if joint.interface is EffortJointInterface:
        return EffortDrive(joint, world, body)
    kind = PositionDrive if joint.interface is PositionJointInterface else VelocityDrive
    return kind(joint, world, body)
