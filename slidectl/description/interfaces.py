"""The interfaces by which joints of simulated hardware take commands: one row each, for all who read or drive one.

Facts only. `control/hardware_interface.py` has the class of each row. The quantity of a row chooses the limits
(`control/limits.py`) and the drive (`physics/robot_hw.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Quantity = Literal["effort", "position", "velocity"]

_PREFIX = "hardware_interface/"


@dataclass(frozen=True)
class JointInterface:
    """One interface. Commands are in N or N·m, m or rad, and per s."""

    name: str
    """As in `hardware_interface::NAME`, and in a transmission as `hardware_interface/NAME` or NAME."""
    quantity: Quantity
    """What `command` of its handles is: what limits act on, and what drives the joint."""
    phrase: str
    """The quantity before a number."""
    beside: tuple[str, ...] = ()
    """The attributes of its handles that are commands beside `command`."""

    @property
    def type_name(self) -> str:
        """As controllers and the manager's services name it."""
        return f"hardware_interface::{self.name}"

    @property
    def written(self) -> str:
        """As it is best written in a transmission."""
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
"""What a transmission may ask for."""


def bare(written: str) -> str:
    """The name of an interface without its prefix."""
    return written.removeprefix(_PREFIX)


def find(written: str) -> JointInterface | None:
    """The interface that a transmission asks for, with or without its prefix; None: simulated hardware has it not."""
    return next((interface for interface in ALL if interface.name == bare(written)), None)
