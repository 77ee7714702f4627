"""Real transmissions between actuators and joints of a robot. The limits of the actuators limit the joint efforts.

The inertia of the rotors is in the model (builder.py). This module uses no commands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from slidectl.control.hardware_interface import JointStateHandle
from slidectl.description.robot import TransmissionInfo
from slidectl.physics.attached_robot import AttachedRobot
from slidectl.physics.builder import loaded


class ActuatorState(NamedTuple):
    """State of an actuator, on its side: position in m or rad, velocity in m/s or rad/s, effort in N or N·m."""

    name: str
    position: float
    velocity: float
    effort: float


class RealTransmission:
    """One transmission of a robot in the world."""

    def __init__(self, robot: AttachedRobot, info: TransmissionInfo) -> None:
        """Raises BadTransmission: the loaders of ros_control refuse it."""
        self._maths, joints, self._actuators = loaded(robot.description, robot.name, info)
        self.joints = [joint.name for joint in joints]
        self._most = [actuator.max_effort for actuator in self._actuators]
        self.is_limited = min(self._most) < math.inf
        self.bind(robot)

    def bind(self, robot: AttachedRobot) -> None:
        """Find the joints after a rebuild of the model."""
        self._dofs = [robot.place(joint).dof for joint in self.joints]

    def most_effort(self, joint: str) -> float:
        """The largest effort on a joint that all actuators can give together, N or N·m."""
        at, size = self.joints.index(joint), len(self._most)
        units = [[float(row == column) for row in range(size)] for column in range(size)]
        gains = [abs(self._maths.joint_effort(unit)[at]) for unit in units]
        return float(sum(gain * most for gain, most in zip(gains, self._most, strict=True) if gain))

    def bound(self, forces: memoryview[float]) -> None:
        """Clip the joint efforts of the step, by dof, so that each actuator is within its limit.

        When no actuator exceeds its limit, the efforts stay the same to the bit.
        """
        asked = self._maths.actuator_effort([forces[dof] for dof in self._dofs])
        given = [max(-most, min(effort, most)) for effort, most in zip(asked, self._most, strict=True)]
        if given != asked:
            for dof, effort in zip(self._dofs, self._maths.joint_effort(given), strict=True):
                forces[dof] = effort

    def states(self, handles: Mapping[str, JointStateHandle]) -> Sequence[ActuatorState]:
        """The states of the actuators, computed from the joint states of the last read."""
        joints = [handles[joint] for joint in self.joints]
        positions = self._maths.actuator_position([joint.position for joint in joints])
        velocities = self._maths.actuator_velocity([joint.velocity for joint in joints])
        efforts = self._maths.actuator_effort([joint.effort for joint in joints])
        names = [actuator.name for actuator in self._actuators]
        return [ActuatorState(*row) for row in zip(names, positions, velocities, efforts, strict=True)]
