"""Control: joint handles and interfaces, PID, limits, transmissions, controllers and their manager.

After ros_control, ros_controllers and control_toolbox (ROS 1 Noetic), whose arithmetic it keeps to the bit.
A controller sees handles and a node; nothing here knows the physics, sockets or the command line.

It exports the names that authors of controllers import, as in `from slidectl.control import Controller`.
"""

from __future__ import annotations

from slidectl.control.controller_interface import Compiled, Controller, Member, MultiInterfaceController, Parts
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    ForceTorqueSensorInterface,
    ImuSensorInterface,
    JointHandle,
    JointStateHandle,
    JointStateInterface,
    PositionJointInterface,
    PosVelAccJointInterface,
    PosVelJointInterface,
    RobotHW,
    VelocityJointInterface,
)
from slidectl.control.laws import LEAVE, PUBLISH, Columns, LawTables, law
from slidectl.control.node_handle import Message, NodeHandle, Publisher
from slidectl.control.params import BOOLEAN, INTEGER, NUMBER, NUMBERS, TEXT, TEXTS, Parameter
from slidectl.control.pid import Gains, Pid
from slidectl.control.registry import controller
from slidectl.errors import MessageRefused, Refused

__all__ = [
    "BOOLEAN",
    "INTEGER",
    "LEAVE",
    "NUMBER",
    "NUMBERS",
    "PUBLISH",
    "TEXT",
    "TEXTS",
    "Columns",
    "Compiled",
    "Controller",
    "EffortJointInterface",
    "ForceTorqueSensorInterface",
    "Gains",
    "ImuSensorInterface",
    "JointHandle",
    "JointStateHandle",
    "JointStateInterface",
    "LawTables",
    "Member",
    "Message",
    "MessageRefused",
    "MultiInterfaceController",
    "NodeHandle",
    "Parameter",
    "Parts",
    "Pid",
    "PosVelAccJointInterface",
    "PosVelJointInterface",
    "PositionJointInterface",
    "Publisher",
    "Refused",
    "RobotHW",
    "VelocityJointInterface",
    "controller",
    "law",
]
