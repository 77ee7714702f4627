"""One joint as DefaultRobotHWSim registers it: its handle, its interface, and the limits that count for it.

Rules of gazebo_ros_control's initSim and registerJointLimits. How the joint is driven is in `drives.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointCommandInterface,
    JointHandle,
    command_interface,
)
from slidectl.control.limits import (
    LARGEST,
    NO_LIMITS,
    LimitHandle,
    limit_handle,
    limits_from_joint,
    limits_from_parameters,
    soft_limits_from_joint,
)
from slidectl.control.node_handle import NodeHandle
from slidectl.description.robot import Joint, TransmissionInfo, TransmissionJoint
from slidectl.description.transmissions import SIMULATED_INTERFACES, driving
from slidectl.errors import Refused, SlidectlError, listing
from slidectl.physics.body import Body
from slidectl.physics.effort import EffortTruncation
from slidectl.physics.parts import BadPart

INITIAL_POSITION = 1.0
INITIAL_EFFORT = 1.0
"""What a handle holds before the first read, as in DefaultRobotHWSim; angles are unwrapped from there."""


class BadTransmission(BadPart, Refused):
    """A transmission that simulated hardware cannot do."""

    kind = "transmission"


class UnsupportedInterface(BadTransmission):
    """A transmission asks for an interface that simulated hardware has not."""

    def __init__(self, robot: str, transmission: TransmissionInfo, joint: TransmissionJoint) -> None:
        asked = joint.hardware_interfaces[0]
        trouble = f"joint {joint.name!r} asks for {asked!r}, which simulated hardware has not"
        super().__init__(robot, transmission, trouble, f"it has: {', '.join(SIMULATED_INTERFACES)}")


class MissingJoint(BadTransmission):
    """A transmission drives a joint that the robot has not, or that has no one position."""

    def __init__(self, body: Body, transmission: TransmissionInfo, joint: str) -> None:
        super().__init__(
            body.name, transmission, f"no joint {joint!r} that moves", f"such joints: {listing(body.joints)}"
        )


@dataclass(slots=True)
class Bounds:
    """What PID modes and motors need of the limits: m or rad, N or N·m; the largest float where there is none."""

    lower: float = -LARGEST
    upper: float = LARGEST
    effort: float = LARGEST


class HardwareJoint:
    """A driven joint: where it is in the world, its handle, the interface it takes commands by, and its bounds."""

    __slots__ = ("bounds", "handle", "interface", "joint", "limit", "name")

    def __init__(self, joint: Joint, interface: type[JointCommandInterface]) -> None:
        self.name = joint.name
        self.joint = joint
        self.interface = interface
        self.handle = JointHandle(joint.name)
        self.bounds = Bounds()
        self.limit: LimitHandle | None = None
        self.reset()

    def reset(self) -> None:
        """As on the first day."""
        handle = self.handle
        handle.position, handle.velocity, handle.effort, handle.command = INITIAL_POSITION, 0.0, INITIAL_EFFORT, 0.0
        if self.limit is not None:
            self.limit.reset()

    def register_limits(self, node: NodeHandle) -> None:
        """Take limits from `<limit>`, then from the parameters `joint_limits/<joint>`, which win field by field.

        Soft limits, where there are some, stand in for the saturation. Without any limits there is neither.

        Raises:
            SlidectlError: the limits lack one that the interface needs.
        """
        written = limits_from_joint(self.joint)
        limits = limits_from_parameters(node, self.name, written or NO_LIMITS) or written
        if limits is None:
            return
        if limits.has_position_limits:
            self.bounds.lower, self.bounds.upper = limits.min_position, limits.max_position
        if limits.has_effort_limits:
            self.bounds.effort = limits.max_effort
        soft = soft_limits_from_joint(self.joint)
        self.limit = limit_handle(self.interface, self.handle, limits, soft)
        self.handle.lowest, self.handle.highest = self.limit.command_bounds()
        if self.interface is EffortJointInterface:  # Gazebo cuts by the URDF, whatever the parameters say
            most = EffortTruncation.of(self.joint).effort
            self.handle.lowest, self.handle.highest = max(self.handle.lowest, -most), min(self.handle.highest, most)


def hardware_joints(body: Body) -> list[HardwareJoint]:
    """The joints that the transmissions drive, in the order of the file; those with several joints are passed over.

    Of several interfaces of a joint the first counts, with or without its prefix.

    Raises:
        UnsupportedInterface, MissingJoint.
    """
    found = driving(body.robot.transmissions)
    return [_hardware_joint(body, transmission, transmission.joints[0]) for transmission in found]


def _hardware_joint(body: Body, transmission: TransmissionInfo, driven: TransmissionJoint) -> HardwareJoint:
    interface = command_interface(driven.hardware_interfaces[0])
    if interface is None:
        raise UnsupportedInterface(body.name, transmission, driven)
    try:
        return HardwareJoint(body.place(driven.name).joint, interface)
    except SlidectlError as error:
        raise MissingJoint(body, transmission, driven.name) from error
