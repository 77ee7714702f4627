"""The robot as controllers see it: handles of joints and sensors, interfaces that hold them, claims, and the hardware.

After ros_control's hardware_interface. RobotHW is the base of every robot, simulated or fake. It does not import
controllers, it only sees their claims. Nothing here moves a joint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from math import inf, isfinite
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar

from slidectl.control.laws import law
from slidectl.description import interfaces
from slidectl.description.interfaces import JointInterface
from slidectl.errors import UnknownName, listing, quoted
from slidectl.rotations import Quaternion, Vector


class JointStateHandle:
    """State of one joint: position (m or rad), velocity (m/s or rad/s), effort (N or N·m)."""

    __slots__ = ("effort", "name", "position", "velocity")

    def __init__(self, name: str, position: float = 0.0, velocity: float = 0.0, effort: float = 0.0) -> None:
        self.name = name
        self.position = position
        self.velocity = velocity
        self.effort = effort

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"


class JointHandle(JointStateHandle):
    """State and commands of one joint. The unit of `command` is that of the interface it is registered with."""

    __slots__ = ("command", "command_acceleration", "command_velocity", "highest", "lowest")

    def __init__(
        self, name: str, position: float = 0.0, velocity: float = 0.0, effort: float = 0.0, command: float = 0.0
    ) -> None:
        super().__init__(name, position, velocity, effort)
        self.command = command
        self.command_velocity = self.command_acceleration = 0.0
        """For interfaces with several commands, of which `command` is the position."""
        self.lowest = -inf
        """The hardware raises a command below this to it, and lowers a command above `highest`. Units of `command`."""
        self.highest = inf


JOINT_STATES = ("position", "velocity", "effort")
"""The names in ros2_control of the states of a joint."""


@law
def is_finite(joint: JointHandle) -> bool:
    """True when the command is finite, or is an infinity that the hardware clips to a finite bound."""
    command = joint.command
    if isfinite(command):
        return True
    return (command > 0.0 and isfinite(joint.highest)) or (command < 0.0 and isfinite(joint.lowest))


class ImuData(NamedTuple):
    """A measurement of an IMU, in its own frame; None: not measured. Covariances are 3 x 3, row by row."""

    orientation: Quaternion | None = None
    orientation_covariance: Sequence[float] | None = None
    angular_velocity: Vector | None = None
    """rad/s."""
    angular_velocity_covariance: Sequence[float] | None = None
    linear_acceleration: Vector | None = None
    """m/s²."""
    linear_acceleration_covariance: Sequence[float] | None = None


class ForceTorqueData(NamedTuple):
    """A measurement of a force and torque sensor, in its own frame: N and N·m."""

    force: Vector
    torque: Vector


D = TypeVar("D")


class SensorHandle(Generic[D]):
    """A sensor of the robot. `measure` returns the measurement of this cycle; it is computed only when called."""

    saved_attributes: ClassVar[None] = None

    def __init__(self, name: str, frame_id: str, measure: Callable[[], D]) -> None:
        self.name = name
        self.frame_id = frame_id
        self.measure = measure


class Handle(Protocol):
    """Anything with a name can be a resource."""

    name: str


H = TypeVar("H", bound=Handle)


class UnknownResource(UnknownName):
    """An interface has no handle of that name."""


@dataclass(frozen=True, slots=True)
class ClaimedResources:
    """The resources that one controller claims through one interface: names, sorted."""

    hardware_interface: str
    resources: tuple[str, ...] = ()


class ResourceManager(Generic[H]):
    """Handles of one interface by name. Subclasses define the type name and whether `get_handle` claims."""

    saved_attributes: ClassVar[None] = None

    type_name: ClassVar[str] = ""
    kind: ClassVar[str] = "joint"
    """The word for a resource in messages."""
    claims: ClassVar[bool] = False

    def __init__(self, handles: Iterable[H] = ()) -> None:
        self._handles: dict[str, H] = {}
        self._exported: dict[str, H] = {}
        """The handles of chainable controllers. They are none of the robot's joints or sensors."""
        self._claimed: set[str] = set()
        self._handed_out: dict[str, H] = {}
        for handle in handles:
            self.register_handle(handle)

    def register_handle(self, handle: H) -> None:
        """Register the handle under its name. It replaces another handle of that name."""
        self._handles[handle.name] = handle

    def names(self) -> list[str]:
        """The names of all handles of the robot, alphabetical."""
        return sorted(self._handles)

    def export(self, handle: H) -> None:
        """Register the handle of a chainable controller."""
        self._exported[handle.name] = handle

    def withdraw(self, name: str) -> None:
        """Forget the handle of a chainable controller, if it is there."""
        self._exported.pop(name, None)

    def exported(self) -> list[H]:
        """The handles of chainable controllers."""
        return list(self._exported.values())

    def get_handle(self, name: str) -> H:
        """The handle of that name, of the robot or of a chainable controller. An interface with `claims` records the
        claim.

        Raises:
            UnknownResource: there is no such handle; nothing is claimed.
        """
        handle = self._handles.get(name) or self._exported.get(name)
        if handle is None:
            known = [*self.names(), *sorted(self._exported)]
            raise UnknownResource(self.kind, name, known, f"in {self.type_name}")
        if self.claims:
            self._claimed.add(name)
        self._handed_out[name] = handle
        return handle

    def handles(self) -> list[H]:
        """All handles of the robot."""
        return list(self._handles.values())

    def pop_claims(self) -> tuple[str, ...]:
        """The names claimed since the last call, alphabetical; the record is then empty."""
        claimed = tuple(sorted(self._claimed))
        self._claimed.clear()
        return claimed

    def pop_handed_out(self) -> list[H]:
        """The handles that `get_handle` has returned since the last call; the record is then empty."""
        handed_out, self._handed_out = self._handed_out, {}
        return list(handed_out.values())


class JointStateInterface(ResourceManager[JointStateHandle]):
    """Position, velocity and effort of joints, to read only."""

    type_name = "hardware_interface::JointStateInterface"


class JointCommands(ResourceManager[JointHandle]):
    """Base of the interfaces whose joints take commands, which are those of `description.interfaces`."""

    claims = True
    declared: ClassVar[JointInterface]

    @classmethod
    def commands_of(cls, handle: JointHandle) -> list[tuple[JointHandle, str]]:
        """For each command of a handle of this interface: the handle and the name of the attribute."""
        return [(handle, attribute) for attribute in ("command", *cls.declared.beside)]


class JointCommandInterface(JointCommands):
    """Base of the interfaces whose joints take one command."""


class EffortJointInterface(JointCommandInterface):
    """Commands in N or N·m."""

    declared = interfaces.EFFORT
    type_name = declared.type_name


class VelocityJointInterface(JointCommandInterface):
    """Commands in m/s or rad/s."""

    declared = interfaces.VELOCITY
    type_name = declared.type_name


class PositionJointInterface(JointCommandInterface):
    """Commands in m or rad."""

    declared = interfaces.POSITION
    type_name = declared.type_name


class PosVelJointInterface(JointCommands):
    """Commands of position and velocity."""

    declared = interfaces.POS_VEL
    type_name = declared.type_name


class PosVelAccJointInterface(JointCommands):
    """Commands of position, velocity and acceleration."""

    declared = interfaces.POS_VEL_ACC
    type_name = declared.type_name


class ImuSensorInterface(ResourceManager[SensorHandle[ImuData]]):
    """IMUs, to read only."""

    type_name = "hardware_interface::ImuSensorInterface"
    kind = "sensor"


class ForceTorqueSensorInterface(ResourceManager[SensorHandle[ForceTorqueData]]):
    """Sensors of the forces and torques in joints, to read only."""

    type_name = "hardware_interface::ForceTorqueSensorInterface"
    kind = "sensor"


COMMAND_INTERFACES: dict[JointInterface, type[JointCommands]] = {
    kind.declared: kind
    for kind in (
        EffortJointInterface,
        PositionJointInterface,
        VelocityJointInterface,
        PosVelJointInterface,
        PosVelAccJointInterface,
    )
}
"""The class of each interface through which a simulated joint takes commands."""


I = TypeVar("I", bound=ResourceManager[Any])  # noqa: E741 - the field's letter for an interface
AnyInterface = ResourceManager[Any]


class SwitchState(Enum):
    """The progress of the hardware with a change of interfaces."""

    DONE = "done"
    ONGOING = "ongoing"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class ControllerInfo:
    """A loaded controller as the hardware sees it."""

    name: str
    type: str
    claimed_resources: tuple[ClaimedResources, ...] = ()


@dataclass(frozen=True, slots=True)
class Conflict:
    """A resource that is claimed more than once, with the claiming controllers (one may occur twice)."""

    resource: str
    controllers: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.resource} is claimed by {' and '.join(self.controllers)}"


class CommandAttribute(NamedTuple):
    """One command of a joint: the handle, and the name of the attribute. `holds`: `command` is a position."""

    handle: JointHandle
    attribute: str
    holds: bool

    def error_text(self) -> str:
        """What is wrong when the command is not finite, in words; empty when it is."""
        value = getattr(self.handle, self.attribute)
        if is_finite(self.handle) if self.attribute == "command" else isfinite(value):
            return ""
        what = f"{self.attribute.replace('_', ' ')} of joint {self.handle.name!r}"
        return f"its {what} is {value}: a number in its computation is too large"

    def rest(self) -> None:
        """Set the command that moves the joint least: its position, or 0."""
        is_position = self.holds and self.attribute == "command"
        setattr(self.handle, self.attribute, self.handle.position if is_position else 0.0)


@dataclass(frozen=True, slots=True)
class HardwareComponent:
    """A part of the hardware as ros2_control lists it: a block `<ros2_control>`. Interfaces are as `joint1/effort`."""

    name: str
    kind: str
    """`system`, `actuator` or `sensor`."""
    plugin: str
    command_interfaces: tuple[str, ...] = ()
    state_interfaces: tuple[str, ...] = ()


class RobotHW:
    """The interfaces of a robot by type. `read` and `write` are called once per cycle."""

    is_of_ros2 = False
    """True for a robot with a `<ros2_control>` tag: its controllers behave as in ros2_controllers."""

    def __init__(self) -> None:
        self._interfaces: dict[str, AnyInterface] = {}

    def register_interface(self, interface: AnyInterface) -> None:
        """Register the interface under its type name. It replaces another interface of that type."""
        self._interfaces[interface.type_name] = interface

    def get(self, interface_type: type[I]) -> I | None:
        """The interface of that type; None when the robot has none."""
        interface = self._interfaces.get(interface_type.type_name)
        return interface if isinstance(interface, interface_type) else None

    def joint_handles(self, *, only_new: bool) -> tuple[list[JointStateHandle], list[tuple[JointHandle, str]]]:
        """All joint handles, also of chainable controllers, and for each of their commands the handle and the name of
        the attribute. With `only_new`, only those that were got since the last such call. A handle that stands in two
        interfaces occurs once."""
        handles: dict[int, JointStateHandle] = {}
        commands: dict[tuple[int, str], tuple[JointHandle, str]] = {}
        for interface in self._interfaces.values():
            for handle in interface.pop_handed_out() if only_new else (*interface.handles(), *interface.exported()):
                if isinstance(handle, JointStateHandle):
                    handles[id(handle)] = handle
                if isinstance(handle, JointHandle):
                    found = interface.commands_of(handle) if isinstance(interface, JointCommands) else []
                    commands.update({(id(handle), name): (one, name) for one, name in (*found, (handle, "command"))})
        return list(handles.values()), list(commands.values())

    def export(self, interface_type: type[ResourceManager[H]], handle: H) -> None:
        """Add a handle of a chainable controller to the interface of that type, which is made if there is none."""
        interface: ResourceManager[H] | None = self.get(interface_type)
        if interface is None:
            interface = interface_type()
            self.register_interface(interface)
        interface.export(handle)

    def withdraw(self, names: Iterable[str]) -> None:
        """Remove these handles of chainable controllers from all interfaces."""
        for name in names:
            for interface in self._interfaces.values():
                interface.withdraw(name)

    def commands_of(self, claims: Iterable[ClaimedResources]) -> list[CommandAttribute]:
        """The commands of the robot's joints that are claimed."""
        found = []
        for claim in claims:
            interface = self._interfaces.get(claim.hardware_interface)
            if isinstance(interface, JointCommands):
                holds = interface.declared.quantity == "position"
                handles = [handle for handle in interface.handles() if handle.name in claim.resources]
                found += [CommandAttribute(*one, holds) for handle in handles for one in interface.commands_of(handle)]
        return found

    def components(self) -> list[HardwareComponent]:
        """The components of a robot of ROS 2. Unless a subclass knows them, all joints are those of one."""
        commands: dict[str, None] = {}
        for interface in self._interfaces.values():
            if isinstance(interface, JointCommands):
                commands |= dict.fromkeys(interfaces.ros2_commands(interface.type_name, interface.names()))
        states = self.get(JointStateInterface)
        read = [f"{joint}/{state}" for joint in (states.names() if states else ()) for state in JOINT_STATES]
        return [HardwareComponent("hardware", "system", type(self).__name__, tuple(commands), tuple(read))]

    def interface_names(self) -> list[str]:
        """The type names of all interfaces, alphabetical."""
        return sorted(self._interfaces)

    def about_joint(self, name: str) -> str:
        """How controllers can command that joint: its interfaces, or that it has none."""
        found = [kind.type_name.rpartition("::")[2] for kind in COMMAND_INTERFACES.values() if self._has(kind, name)]
        if found:
            return f"{quoted(name)} has {listing(found)}"
        return f"no interface has a command for {quoted(name)}"

    def _has(self, kind: type[AnyInterface], name: str) -> bool:
        interface = self._interfaces.get(kind.type_name)
        return interface is not None and name in interface.names()

    def check_for_conflict(self, infos: Sequence[ControllerInfo]) -> list[Conflict]:
        """Resources claimed more than once if these controllers ran together, over all interfaces.

        Those of chainable controllers are claimed by interface: a controller may have one for the position and one for
        the velocity of the same name.
        """
        claimants: dict[str, list[str]] = {}
        for info in infos:
            for claimed in info.claimed_resources:
                for name in claimed.resources:
                    resource = self._resource(claimed.hardware_interface, name)
                    claimants.setdefault(resource, []).append(info.name)
        return [Conflict(name, tuple(who)) for name, who in sorted(claimants.items()) if len(who) > 1]

    def _resource(self, type_name: str, name: str) -> str:
        """The name of a claimed resource; of one that a controller exports, with the quantity behind it."""
        interface = self._interfaces.get(type_name)
        if isinstance(interface, JointCommands) and any(handle.name == name for handle in interface.exported()):
            return f"{name}/{interface.declared.quantity}"
        return name

    def prepare_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> bool:  # noqa: ARG002
        """True when these controllers can start and stop in one switch. False refuses the switch."""
        return True

    def do_switch(self, start: Sequence[ControllerInfo], stop: Sequence[ControllerInfo]) -> None:
        """Begin the change of interfaces, in the cycle of the switch."""

    def release_unclaimed(self, running: Sequence[ControllerInfo]) -> None:
        """Called when controllers have come, gone or failed: joints that none of these claims may be released."""

    def switch_result(self, info: ControllerInfo | None = None) -> SwitchState:  # noqa: ARG002
        """The progress of the change, for one controller or (None) for all."""
        return SwitchState.DONE

    def read(self, time_ns: int, period_s: float) -> None:
        """Copy the state of all joints into their handles."""

    def write(self, time_ns: int, period_s: float) -> None:
        """Copy the commands of all handles to the joints."""
