"""Transmissions: they convert positions, velocities and efforts between actuators and joints. They are made from URDF.

The maths of transmission_interface, to the bit. Values are sequences, one per actuator or joint.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple, TypeVar

from slidectl.description.robot import Robot, TransmissionActuator, TransmissionInfo, TransmissionJoint
from slidectl.errors import Refused, UnknownName, listing

Values = Sequence[float]


class Transmission(ABC):
    """Base of all transmissions. `reduction` is dimensionless, offsets in m or rad, values in SI units."""

    size: ClassVar[int]
    """The number of actuators, which is also the number of joints."""

    @abstractmethod
    def joint_effort(self, actuator: Values) -> list[float]:
        """Joint efforts for these actuator efforts."""

    @abstractmethod
    def joint_velocity(self, actuator: Values) -> list[float]:
        """Joint velocities for these actuator velocities."""

    @abstractmethod
    def joint_position(self, actuator: Values) -> list[float]:
        """Joint positions for these actuator positions."""

    def joint_absolute_position(self, actuator: Values) -> list[float]:
        """Joint positions for the readings of absolute encoders on the actuators."""
        return self.joint_position(actuator)

    def joint_torque_sensor(self, actuator: Values) -> list[float]:
        """Joint torques for the readings of torque sensors on the actuators. They convert like efforts."""
        return self.joint_effort(actuator)

    @abstractmethod
    def actuator_effort(self, joint: Values) -> list[float]:
        """Actuator efforts for these joint efforts."""

    @abstractmethod
    def actuator_velocity(self, joint: Values) -> list[float]:
        """Actuator velocities for these joint velocities."""

    @abstractmethod
    def actuator_position(self, joint: Values) -> list[float]:
        """Actuator positions for these joint positions."""


class SimpleTransmission(Transmission):
    """One actuator and one joint. A negative reduction reverses the direction."""

    size = 1

    def __init__(self, reduction: float, joint_offset: float = 0.0) -> None:
        """Raises Refused for a reduction of 0."""
        _check_reductions("mechanical reduction", (reduction,))
        self._reduction = reduction
        self._offset = joint_offset

    def joint_effort(self, actuator: Values) -> list[float]:
        return [actuator[0] * self._reduction]

    def joint_velocity(self, actuator: Values) -> list[float]:
        return [actuator[0] / self._reduction]

    def joint_position(self, actuator: Values) -> list[float]:
        return [actuator[0] / self._reduction + self._offset]

    def actuator_effort(self, joint: Values) -> list[float]:
        return [joint[0] / self._reduction]

    def actuator_velocity(self, joint: Values) -> list[float]:
        return [joint[0] * self._reduction]

    def actuator_position(self, joint: Values) -> list[float]:
        return [(joint[0] - self._offset) * self._reduction]


class _TwoDofTransmission(Transmission):
    """Two actuators and two joints, each with a reduction."""

    size = 2

    def __init__(
        self,
        actuator_reduction: Values,
        joint_reduction: Values = (1.0, 1.0),
        joint_offset: Values = (0.0, 0.0),
    ) -> None:
        """Raises Refused unless each sequence has two entries and no reduction is 0."""
        for what, values in (
            ("actuator reduction", actuator_reduction),
            ("joint reduction", joint_reduction),
            ("joint offset", joint_offset),
        ):
            if len(values) != self.size:
                raise Refused(f"{type(self).__name__} needs 2 of {what}, not {len(values)}")
        _check_reductions("actuator reduction", actuator_reduction)
        _check_reductions("joint reduction", joint_reduction)
        self._actuator = tuple(actuator_reduction)
        self._joint = tuple(joint_reduction)
        self._offset = tuple(joint_offset)

    def joint_position(self, actuator: Values) -> list[float]:
        first, second = self.joint_velocity(actuator)
        return [first + self._offset[0], second + self._offset[1]]


class DifferentialTransmission(_TwoDofTransmission):
    """Two actuators. Their sum moves the first joint, their difference the second."""

    def __init__(
        self,
        actuator_reduction: Values,
        joint_reduction: Values = (1.0, 1.0),
        joint_offset: Values = (0.0, 0.0),
        ignore_absolute_encoders: bool = False,
    ) -> None:
        """`ignore_absolute_encoders`: the absolute encoders are on the joints; the other actuator reads each."""
        super().__init__(actuator_reduction, joint_reduction, joint_offset)
        self._ignore_absolute_encoders = ignore_absolute_encoders

    def joint_effort(self, actuator: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            j1 * (actuator[0] * a1 + actuator[1] * a2),
            j2 * (actuator[0] * a1 - actuator[1] * a2),
        ]

    def joint_velocity(self, actuator: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            (actuator[0] / a1 + actuator[1] / a2) / (2.0 * j1),
            (actuator[0] / a1 - actuator[1] / a2) / (2.0 * j2),
        ]

    def joint_absolute_position(self, actuator: Values) -> list[float]:
        if self._ignore_absolute_encoders:
            return [actuator[1], actuator[0]]
        return self.joint_position(actuator)

    def actuator_effort(self, joint: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            (joint[0] / j1 + joint[1] / j2) / (2.0 * a1),
            (joint[0] / j1 - joint[1] / j2) / (2.0 * a2),
        ]

    def actuator_velocity(self, joint: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            (joint[0] * j1 + joint[1] * j2) * a1,
            (joint[0] * j1 - joint[1] * j2) * a2,
        ]

    def actuator_position(self, joint: Values) -> list[float]:
        return self.actuator_velocity([joint[0] - self._offset[0], joint[1] - self._offset[1]])


class FourBarLinkageTransmission(_TwoDofTransmission):
    """Two actuators on the base, the second of which moves its joint through a four-bar linkage."""

    def joint_effort(self, actuator: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            actuator[0] * a1 * j1,
            j2 * (actuator[1] * a2 - actuator[0] * a1 * j1),
        ]

    def joint_velocity(self, actuator: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            actuator[0] / (j1 * a1),
            (actuator[1] / a2 - actuator[0] / (j1 * a1)) / j2,
        ]

    def actuator_effort(self, joint: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            joint[0] / (a1 * j1),
            (joint[0] + joint[1] / j2) / a2,
        ]

    def actuator_velocity(self, joint: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        return [
            joint[0] * j1 * a1,
            (joint[0] + joint[1] * j2) * a2,
        ]

    def actuator_position(self, joint: Values) -> list[float]:
        (a1, a2), (j1, j2) = self._actuator, self._joint
        first, second = joint[0] - self._offset[0], joint[1] - self._offset[1]
        return [first * j1 * a1, (first + second * j2) * a2]


def _check_reductions(what: str, reductions: Values) -> None:
    if 0.0 in reductions:
        raise Refused(f"{what} must not be 0, but is {list(reductions)}")


# -- the loaders -------------------------------------------------------------------------------------------------------

_PREFIX = "transmission_interface/"
_KINDS: dict[str, type[SimpleTransmission | _TwoDofTransmission]] = {
    _PREFIX + kind.__name__: kind for kind in (SimpleTransmission, DifferentialTransmission, FourBarLinkageTransmission)
}
MOST_FELT = 1e9
"""The largest entry of `rotor_inertia`, in kg·m² or kg. The physics accepts much larger numbers."""
P = TypeVar("P", TransmissionJoint, TransmissionActuator)


class LoadedTransmission(NamedTuple):
    """A transmission, with its joints and actuators in the order of the values of `maths`."""

    maths: Transmission
    joints: tuple[TransmissionJoint, ...]
    actuators: tuple[TransmissionActuator, ...]

    @property
    def ratios(self) -> list[list[float]]:
        """The actuators' velocities when one joint has velocity 1 and the others 0: joints x actuators."""
        size = range(len(self.joints))
        return [self.maths.actuator_velocity([float(row == column) for row in size]) for column in size]

    @property
    def rotor_inertia(self) -> list[list[float]]:
        """The part of the joints' mass matrix that the actuators' rotors add. joints x joints, kg·m² or kg."""
        inertias = [actuator.rotor_inertia for actuator in self.actuators]
        return [
            [sum(i * a * b for i, a, b in zip(inertias, first, second, strict=True)) for second in self.ratios]
            for first in self.ratios
        ]


def load(info: TransmissionInfo, robot: Robot) -> LoadedTransmission:
    """Load a transmission as the loaders of ros_control do.

    Raises:
        Refused: no such type; too few or too many joints or actuators; a role that is missing, unknown or repeated; an
        actuator without reduction; a reduction of 0; joints with different interfaces; rotors that are too heavy, or
        that couple two joints of which neither is an ancestor of the other, which MuJoCo does not support.
    """
    kind = _KINDS.get(info.type)
    if kind is None:
        raise UnknownName("transmission type", info.type, list(_KINDS))
    for what, parts in (("joint", info.joints), ("actuator", info.actuators)):
        if len(parts) != kind.size:
            raise Refused(f"{info.type} has {kind.size} {what}{'s' * (kind.size > 1)}, not {len(parts)}")
    for actuator in info.actuators:
        if actuator.reduction is None:
            raise Refused(f"actuator {actuator.name!r} has no <mechanicalReduction>")
    for joint in info.joints:
        if set(joint.hardware_interfaces) != set(info.joints[0].hardware_interfaces):
            raise Refused(f"joint {joint.name!r} has other interfaces than joint {info.joints[0].name!r}")
    joints, actuators = info.joints, info.actuators
    if kind.size > 1:
        joints, actuators = _in_roles("joint", joints), _in_roles("actuator", actuators)
    reductions = [actuator.reduction or 0.0 for actuator in actuators]
    offsets = [joint.offset for joint in joints]
    maths: Transmission
    if issubclass(kind, SimpleTransmission):
        maths = SimpleTransmission(reductions[0], offsets[0])
    else:
        maths = kind(reductions, [joint.reduction for joint in joints], offsets)
    loaded = LoadedTransmission(maths, joints, actuators)
    felt = loaded.rotor_inertia
    if not all(abs(inertia) <= MOST_FELT for row in felt for inertia in row):
        raise Refused(f"its joints would feel more than {MOST_FELT:g} kg m2 of its rotors")
    if kind.size > 1 and felt[0][1] != 0.0 and not _are_in_a_chain(robot, *joints):
        text = "its rotors couple two joints of which neither is above the other, which MuJoCo cannot do"
        raise Refused(text, "give rotors that the joints feel alike, or none")
    return loaded


def _are_in_a_chain(robot: Robot, first: TransmissionJoint, second: TransmissionJoint) -> bool:
    above = {joint.child: joint for joint in robot.joints.values()}
    for start, end in ((first, second), (second, first)):
        joint = robot.joints.get(start.name)
        while joint is not None and joint.name != end.name:
            joint = above.get(joint.parent)
        if joint is not None:
            return True
    return False


def _in_roles(what: str, parts: Sequence[P]) -> tuple[P, ...]:
    roles = [f"{what}{number}" for number in range(1, len(parts) + 1)]
    if sorted(part.role for part in parts) != roles:
        given = listing([part.role or "none" for part in parts])
        raise Refused(f"the {what}s need the roles {' and '.join(roles)}, each once; given: {given}")
    return tuple(sorted(parts, key=lambda part: part.role))
