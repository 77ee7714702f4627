"""Controller types of ROS 2: the equivalent type here, or the advice what to write when there is none.

The manager, checks and the documentation use this table. It refers to no controller classes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from slidectl.description.parameter_trees import leaves
from slidectl.errors import Refused

_BY_INTERFACE = {
    ("position",): "position_controllers",
    ("velocity",): "velocity_controllers",
    ("effort",): "effort_controllers",
    ("position", "velocity"): "pos_vel_controllers",
    ("position", "velocity", "acceleration"): "pos_vel_acc_controllers",
}
_STEERS_ONE = (
    "ackermann_steering_controller/AckermannSteeringController has one rear_wheel and one front_steer,"
    " and takes angular.z as the angle of the steering"
)


class Ros2Type(NamedTuple):
    """One type of ROS 2."""

    here: Mapping[tuple[str, ...], str] | str
    """The type here; or the types here by the interfaces that the controller commands."""
    note: str = ""
    """The remaining differences."""
    interfaces: str = ""
    """The parameter that names the interfaces."""
    renamed: Mapping[str, str] = {}
    """New name of each parameter that is named differently here; `*` stands for any name."""


NAMES: dict[str, Ros2Type] = {
    "joint_trajectory_controller/JointTrajectoryController": Ros2Type(
        {names: f"{family}/JointTrajectoryController" for names, family in _BY_INTERFACE.items()},
        "trajectories go to `command`, states come on `state`",
        "command_interfaces",
        {"gains/*/ff_velocity_scale": "velocity_ff/*"},
    ),
}
"""Types of ROS 2 with an equivalent here."""

OTHERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "ackermann_steering_controller/AckermannSteeringController": (
        _STEERS_ONE,
        (
            *("traction_joints_names", "steering_joints_names", "rear_wheels_names", "front_wheels_names"),
            *("wheelbase", "front_steering"),
        ),
    ),
    "bicycle_steering_controller/BicycleSteeringController": (_STEERS_ONE, ()),
    "tricycle_controller/TricycleController": (_STEERS_ONE, ()),
    "tricycle_steering_controller/TricycleSteeringController": (_STEERS_ONE, ()),
    "parallel_gripper_action_controller/GripperActionController": (
        "position_controllers/GripperActionController, whose goals are control_msgs/GripperCommand",
        (),
    ),
    "pose_broadcaster/PoseBroadcaster": ("the pose of each link is on /tf and on /gazebo/link_states", ()),
    "range_sensor_broadcaster/RangeSensorBroadcaster": ("a laser scanner of the model publishes by itself", ()),
    "state_interfaces_broadcaster/StateInterfacesBroadcaster": (
        "joint_state_broadcaster/JointStateBroadcaster for joints, and the broadcasters of sensors",
        (),
    ),
    "pid_controller/PidController": (
        "effort_controllers/JointPositionController, or one of its family, with pid/p, pid/i and pid/d for each joint",
        (),
    ),
}
"""Types of ROS 2 without an equivalent: the advice what to write here, and, for a type with the same name here,
parameters that identify the ROS 2 type."""


class Counterpart(NamedTuple):
    """The equivalent here of a controller of ROS 2."""

    type: str
    remark: str
    values: Mapping[str, Any]
    """Parameters to set: renamed ones."""
    understood: Mapping[str, str]
    """Parameters of ROS 2 that were used, with a text about the use of each."""


class NoCounterpart(Refused):
    """A type of ROS 2 without an equivalent here, or whose parameters do not determine the equivalent."""


IDENTIFIED_BY: dict[str, tuple[str, ...]] = {
    "diff_drive_controller/DiffDriveController": ("left_wheel_names", "right_wheel_names"),
}
"""By type that ros_controllers have as well: parameters that only ros2_controllers read."""


def has_parameters_of(type_name: str, parameters: Mapping[str, Any]) -> bool:
    """True when the parameters, nested or by full names, are those of the type of ros2_controllers."""
    names = {name for name, _ in leaves(parameters)}
    return any(name in names for name in IDENTIFIED_BY.get(type_name, ()))


def counterpart(type_name: str, parameters: Mapping[str, Any]) -> Counterpart | None:
    """The equivalent of a type with these parameters, nested or by full names; None: not a type of ROS 2 only.

    Raises:
        NoCounterpart: there is no equivalent; the hint says what to write.
    """
    values = dict(leaves(parameters))
    if type_name in OTHERS:
        advice, telling = OTHERS[type_name]
        if not telling or any(name in values for name in telling):
            text = f"{type_name} of ROS 2 is another controller" if telling else f"slidectl has no {type_name}"
            raise NoCounterpart(text, f"here: {advice}")
        return None
    found = NAMES.get(type_name)
    if found is None:
        return None
    here = found.here if isinstance(found.here, str) else _chosen(type_name, found, values)
    understood = {found.interfaces: f"makes it {here}"} if found.interfaces else {}
    if "state_interfaces" in values:
        understood["state_interfaces"] = "is not needed: states are always there"
    more: dict[str, Any] = {}
    remark = f"{type_name} is {here} here"
    for old, new in found.renamed.items():
        pattern = re.compile(re.escape(old).replace(r"\*", "([^/]+)"))
        for name in values:
            if match := pattern.fullmatch(name):
                target = new.replace("*", "".join(match.groups()))
                understood[name] = f"is {target} here"
                more.setdefault(target, values[name])
    return Counterpart(here, f"{remark}; {found.note}" if found.note else remark, more, understood)


def _chosen(type_name: str, found: Ros2Type, values: Mapping[str, Any]) -> str:
    """The type here for the interfaces that the parameters ask for. Raises NoCounterpart."""
    assert not isinstance(found.here, str)
    requested = values.get(found.interfaces)
    given = (
        {requested}
        if isinstance(requested, str)
        else set(map(str, requested))
        if isinstance(requested, list)
        else set()
    )
    for names, here in found.here.items():
        if given == set(names):
            return here
    known = " or ".join(str(list(names)) if found.interfaces.endswith("s") else names[0] for names in found.here)
    value = "not set" if requested is None else repr(requested)
    raise NoCounterpart(
        f"{type_name} is another one here for each interface, and {found.interfaces} is {value}",
        f"set {found.interfaces} to {known}, or the type to {' or '.join(found.here.values())}",
    )
