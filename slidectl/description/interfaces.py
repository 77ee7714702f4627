"""The table of interfaces by which joints of simulated hardware take commands. All readers and drivers use it.

Data only. `control/hardware_interface.py` has the class of each row. The quantity of a row chooses the limits
(`control/limits.py`) and the drive (`physics/robot_hw.py`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Quantity = Literal["effort", "position", "velocity"]

_PREFIX = "hardware_interface/"


@dataclass(frozen=True)
class JointInterface:
    """One hardware interface. Commands are in N or N·m, m or rad, and these per s or s²."""

    name: str
    """NAME in `hardware_interface::NAME`; a transmission has `hardware_interface/NAME` or NAME."""
    quantity: Quantity
    """The quantity of the handles' `command`: the limits act on it, and it drives the joint."""
    phrase: str
    """The quantity before a number, in messages."""
    beside: tuple[str, ...] = ()
    """Further attributes of its handles that are commands."""

    @property
    def type_name(self) -> str:
        """The name in controllers and in the services of the controller manager."""
        return f"hardware_interface::{self.name}"

    @property
    def ros2_names(self) -> tuple[str, ...]:
        """The names of its commands in ros2_control, where each is an interface of its own."""
        return (self.quantity, *(name.removeprefix("command_") for name in self.beside))

    @property
    def written(self) -> str:
        """The preferred name in a transmission."""
        return _PREFIX + self.name


EFFORT = JointInterface("EffortJointInterface", "effort", "an effort of")
POSITION = JointInterface("PositionJointInterface", "position", "the position")
VELOCITY = JointInterface("VelocityJointInterface", "velocity", "a velocity of")
POS_VEL = JointInterface("PosVelJointInterface", "position", "the position", ("command_velocity",))
POS_VEL_ACC = JointInterface(
    "PosVelAccJointInterface", "position", "the position", ("command_velocity", "command_acceleration")
)

ALL = (EFFORT, POSITION, VELOCITY, POS_VEL, POS_VEL_ACC)
KNOWN = ", ".join(interface.written for interface in ALL)
"""The names that a transmission may use, as one text."""


def bare(written: str) -> str:
    """The name of an interface without its prefix."""
    return written.removeprefix(_PREFIX)


def ros2_commands(type_name: str, resources: Iterable[str]) -> list[str]:
    """The names in ros2_control of all commands of these resources of an interface, as `joint1/effort`."""
    commands = next((one.ros2_names for one in ALL if one.type_name == type_name), (type_name,))
    return [f"{resource}/{command}" for resource in resources for command in commands]


def find(written: str) -> JointInterface | None:
    """The interface of a transmission, with or without its prefix; None when simulated hardware does not have it."""
    return next((interface for interface in ALL if interface.name == bare(written)), None)
