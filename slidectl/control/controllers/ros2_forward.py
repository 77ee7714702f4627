"""Controllers that pass commands on unchanged, after ros2_controllers' forward_command_controller.

Topic `~/commands` (std_msgs/Float64MultiArray): one value per joint or interface, in the order of the parameter.
Nothing is commanded before the first message after a start. No PID, no limits, no state topic.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import ClassVar

from slidectl import names
from slidectl.control import params
from slidectl.control.controller_interface import MissingInterface, MultiInterfaceController
from slidectl.control.hardware_interface import (
    COMMAND_INTERFACES,
    EffortJointInterface,
    JointCommands,
    JointHandle,
    PositionJointInterface,
    RobotHW,
    VelocityJointInterface,
)
from slidectl.control.joint_controller import CommandChecks, joint_names
from slidectl.control.node_handle import Message, NodeHandle
from slidectl.control.params import JOINT, JOINTS, TEXT, TEXTS, Parameter
from slidectl.control.registry import ros2_controller
from slidectl.control.ros2_controller import UPDATE_RATE, LogThrottle, Ros2Controller, fixed
from slidectl.errors import MessageRefused, Refused, listing

BY_NAME: dict[str, type[JointCommands]] = {
    "position": PositionJointInterface,
    "velocity": VelocityJointInterface,
    "effort": EffortJointInterface,
}
"""The interfaces by the names that ROS 2 has for them."""
THE_JOINT, THE_JOINTS = fixed(JOINT, JOINTS)
INTERFACE, INTERFACES = fixed(
    Parameter("interface_name", TEXT, "position, velocity or effort", required=True),
    Parameter(
        "interface_names", TEXTS, "the command interfaces of the joint, in the order of the values", required=True
    ),
)


class CommandForwarder(Ros2Controller, CommandChecks, MultiInterfaceController):
    """Base: each command = its value in the last message."""

    allow_optional_interfaces = True
    interface_types: ClassVar[tuple[type[JointCommands], ...]]
    _targets: tuple[tuple[JointHandle, str], ...]
    """The handle of each value, and the attribute that takes it."""

    def init_in_root(self, hw: RobotHW, root: NodeHandle, node: NodeHandle) -> None:
        """Raises SlidectlError: a parameter, a joint or an interface is missing."""
        self._targets = self._found(hw, node)
        self.commands: list[float] = []
        """The values of the last message since the start; empty: there was none, and nothing is commanded."""
        self._errors = LogThrottle(node)
        self._listen(node, "std_msgs/Float64MultiArray", self._receive, "commands")

    def _found(self, hw: RobotHW, node: NodeHandle) -> tuple[tuple[JointHandle, str], ...]:
        """The targets by the parameters. Raises SlidectlError."""
        raise NotImplementedError

    def starting(self, time_ns: int) -> None:
        super().starting(time_ns)
        self.commands = []

    def stopping(self, time_ns: int) -> None:
        self.commands = []

    def cycle(self, time_ns: int, period_s: float) -> None:
        if not self.commands:
            return
        if len(self.commands) != len(self._targets):
            self._errors.log("error", self._wrong_size())
            return
        for (handle, attribute), value in zip(self._targets, self.commands, strict=True):
            setattr(handle, attribute, value)

    def _wrong_size(self) -> str:
        count, wanted = len(self.commands), len(self._targets)
        return f"{self._node.namespace} commands {wanted} interfaces, and the command has {count} values: none is used"

    def _receive(self, message: Message) -> None:
        values: list[float] = list(message["data"])
        if not all(map(isfinite, values)):
            text = f"{self._node.namespace} refuses the command: it must have finite numbers, not nan or infinity"
            self._warn(text, "not finite")
            raise MessageRefused(text)
        if not self._is_running():
            return
        self.commands = values
        if values and len(values) != len(self._targets):
            self._errors.log("error", self._wrong_size())
        elif values:
            pairs = zip(self._targets, values, strict=True)
            self._check([(handle, value, _bounds(handle, attribute)) for (handle, attribute), value in pairs])


def _bounds(handle: JointHandle, attribute: str) -> tuple[float, float]:
    """The lowest and the highest command. Others are clipped to these."""
    return (handle.lowest, handle.highest) if attribute == "command" else (-inf, inf)


def _interface(hw: RobotHW, wanted: type[JointCommands]) -> JointCommands:
    """That interface of the robot. Raises MissingInterface."""
    interface: JointCommands | None = hw.get(wanted)
    if interface is None:
        raise MissingInterface(wanted.type_name, hw)
    return interface


def _joints(hw: RobotHW, node: NodeHandle, wanted: type[JointCommands]) -> tuple[tuple[JointHandle, str], ...]:
    """The command of each joint of `joints`. Raises SlidectlError: the parameter is wrong, or a joint is unknown."""
    interface = _interface(hw, wanted)
    found = joint_names(node)
    if len(set(found)) < len(found):
        raise Refused(f"parameter {names.join(node.namespace, JOINTS.name)} names a joint twice")
    return tuple((interface.get_handle(joint), "command") for joint in found)


@ros2_controller("forward_command_controller/ForwardCommandController")
class ForwardCommandController(CommandForwarder):
    """One command of each of several joints, through the interface `interface_name`."""

    interface_types = tuple(BY_NAME.values())
    parameters: ClassVar[tuple[Parameter, ...]] = (UPDATE_RATE, THE_JOINTS, INTERFACE)

    def _found(self, hw: RobotHW, node: NodeHandle) -> tuple[tuple[JointHandle, str], ...]:
        name: str = params.value_of(node, INTERFACE)
        if name not in BY_NAME:
            text = f"parameter {names.join(node.namespace, INTERFACE.name)} must be {listing(BY_NAME)}, not {name!r}"
            raise Refused(text, f"interfaces of this robot: {listing(hw.interface_names())}")
        return _joints(hw, node, BY_NAME[name])


@ros2_controller("forward_command_controller/MultiInterfaceForwardCommandController")
class MultiInterfaceForwardCommandController(CommandForwarder):
    """Several commands of one joint, through the interfaces `interface_names`."""

    interface_types = tuple(COMMAND_INTERFACES.values())
    parameters: ClassVar[tuple[Parameter, ...]] = (UPDATE_RATE, THE_JOINT, INTERFACES)

    def _found(self, hw: RobotHW, node: NodeHandle) -> tuple[tuple[JointHandle, str], ...]:
        wanted: list[str] = params.value_of(node, INTERFACES)
        for interface_type in self.interface_types:
            attributes = attributes_of(interface_type)
            if attributes.keys() == set(wanted) and len(attributes) == len(wanted):
                handle = _interface(hw, interface_type).get_handle(params.value_of(node, JOINT))
                return tuple((handle, attributes[name]) for name in wanted)
        known = " or ".join(str(list(attributes_of(each))) for each in self.interface_types)
        text = f"parameter {names.join(node.namespace, INTERFACES.name)} is {wanted}"
        raise Refused(f"{text}; a joint takes {known}", f"interfaces of this robot: {listing(hw.interface_names())}")


def attributes_of(interface_type: type[JointCommands]) -> dict[str, str]:
    """The attribute of a handle by the name that ROS 2 has for its command, as {"position": "command"}."""
    declared = interface_type.declared
    return {declared.quantity: "command", **{each.removeprefix("command_"): each for each in declared.beside}}


class GroupForwarder(CommandForwarder):
    """Base: one command of each of several joints, through the only interface of the class."""

    parameters: ClassVar[tuple[Parameter, ...]] = (UPDATE_RATE, THE_JOINTS)

    def _found(self, hw: RobotHW, node: NodeHandle) -> tuple[tuple[JointHandle, str], ...]:
        return _joints(hw, node, self.interface_types[0])


class RestingForwarder(GroupForwarder):
    """Base of those that command 0 when they stop."""

    def stopping(self, time_ns: int) -> None:
        super().stopping(time_ns)
        for handle, attribute in self._targets:
            setattr(handle, attribute, 0.0)


@ros2_controller("position_controllers/JointGroupPositionController")
class Ros2GroupPositionController(GroupForwarder):
    """Commands are positions, m or rad. The last ones stay when it stops."""

    interface_types = (PositionJointInterface,)


@ros2_controller("velocity_controllers/JointGroupVelocityController")
class Ros2GroupVelocityController(RestingForwarder):
    """Commands are velocities, m/s or rad/s. They are 0 when it stops."""

    interface_types = (VelocityJointInterface,)


@ros2_controller("effort_controllers/JointGroupEffortController")
class Ros2GroupEffortController(RestingForwarder):
    """Commands are efforts, N or N·m. They are 0 when it stops."""

    interface_types = (EffortJointInterface,)
