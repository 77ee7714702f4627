"""Types of controllers as users of ROS 2 write them: what each is here, and what to write where none is the same.

One table; the manager, checks and the documentation read it. It knows no controller classes.
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
_RATE = {"publish_rate": 100.0}
_STEERS_ONE = (
    "ackermann_steering_controller/AckermannSteeringController has one rear_wheel and one front_steer,"
    " and takes angular.z as the angle of the steering"
)


class Ros2Type(NamedTuple):
    """One type of ROS 2."""

    here: Mapping[tuple[str, ...], str] | str
    """Its name here; or its names by the interfaces that it commands."""
    note: str = ""
    """What is still different."""
    interfaces: str = ""
    """The parameter that names the interfaces."""
    renamed: Mapping[str, str] = {}
    """Parameters that have another name here; `*` stands for any name."""
    defaults: Mapping[str, Any] = {}
    """Parameters that need not be set in ROS 2."""
    told_by: tuple[str, ...] = ()
    """The type has the same name here: parameters that only ROS 2 has."""


NAMES: dict[str, Ros2Type] = {
    "joint_state_broadcaster/JointStateBroadcaster": Ros2Type(
        "joint_state_controller/JointStateController", defaults=_RATE
    ),
    "joint_trajectory_controller/JointTrajectoryController": Ros2Type(
        {names: f"{family}/JointTrajectoryController" for names, family in _BY_INTERFACE.items()},
        "trajectories go to `command`, states come on `state`",
        "command_interfaces",
        {"gains/*/ff_velocity_scale": "velocity_ff/*"},
    ),
    "forward_command_controller/ForwardCommandController": Ros2Type(
        {
            names: f"{family}/JointGroup{names[0].title()}Controller"
            for names, family in _BY_INTERFACE.items()
            if len(names) == 1
        },
        "commands go to `command`",
        "interface_name",
    ),
    "diff_drive_controller/DiffDriveController": Ros2Type(
        "diff_drive_controller/DiffDriveController",
        "commands are geometry_msgs/Twist, and a limit counts with its has_..._limits",
        renamed={
            "left_wheel_names": "left_wheel",
            "right_wheel_names": "right_wheel",
            "publish_limited_velocity": "publish_cmd",
        },
        defaults={f"{what}_covariance_diagonal": [0.0] * 6 for what in ("pose", "twist")},
        told_by=("left_wheel_names", "right_wheel_names"),
    ),
    "imu_sensor_broadcaster/IMUSensorBroadcaster": Ros2Type(
        "imu_sensor_controller/ImuSensorController", "each IMU is published on its name", defaults=_RATE
    ),
    "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster": Ros2Type(
        "force_torque_sensor_controller/ForceTorqueSensorController",
        "each sensor is published on its name",
        defaults=_RATE,
    ),
}
"""What means the same."""

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
    "forward_command_controller/MultiInterfaceForwardCommandController": (
        "one of position_controllers/JointGroupPositionController, velocity_controllers/JointGroupVelocityController"
        " and effort_controllers/JointGroupEffortController for each interface",
        (),
    ),
    "parallel_gripper_action_controller/GripperActionController": (
        "position_controllers/GripperActionController, whose goals are control_msgs/GripperCommand",
        (),
    ),
    "pid_controller/PidController": (
        "effort_controllers/JointPositionController, or one of its family, with pid/p, pid/i and pid/d for each joint",
        (),
    ),
}
"""What means something else: what to write here. Types of the same name here are told by the parameters behind it."""


class Counterpart(NamedTuple):
    """What a controller of ROS 2 is here."""

    type: str
    remark: str
    values: Mapping[str, Any]
    """Parameters to set: new names, and defaults that ROS 2 has."""
    understood: Mapping[str, str]
    """Parameters of ROS 2 that have done their part, with what became of each."""


class NoCounterpart(Refused):
    """A type of ROS 2 that means something else here, or of which the parameters do not say enough."""


def counterpart(type_name: str, parameters: Mapping[str, Any]) -> Counterpart | None:
    """What a type with these parameters, nested or by full names, is here; None: it is not one of ROS 2 alone.

    Raises:
        NoCounterpart: nothing here means the same; the hint says what to write.
    """
    values = dict(leaves(parameters))
    if type_name in OTHERS:
        advice, telling = OTHERS[type_name]
        if not telling or any(name in values for name in telling):
            raise NoCounterpart(f"{type_name} of ROS 2 is another controller", f"here: {advice}")
        return None
    found = NAMES.get(type_name)
    if found is None or (found.told_by and not any(name in values for name in found.told_by)):
        return None
    here = found.here if isinstance(found.here, str) else _chosen(type_name, found, values)
    understood = {found.interfaces: f"makes it {here}"} if found.interfaces else {}
    if "state_interfaces" in values:
        understood["state_interfaces"] = "is not needed: states are always there"
    more = {name: value for name, value in found.defaults.items() if name not in values}
    remark = f"{type_name} is {here} here" if here != type_name else f"{type_name} has parameters of ROS 2"
    remark += "".join(f", with {name} {value}" for name, value in more.items())
    for old, new in found.renamed.items():
        pattern = re.compile(re.escape(old).replace(r"\*", "([^/]+)"))
        for name in values:
            if match := pattern.fullmatch(name):
                target = new.replace("*", "".join(match.groups()))
                understood[name] = f"is {target} here"
                more.setdefault(target, values[name])
    return Counterpart(here, f"{remark}; {found.note}" if found.note else remark, more, understood)


def _chosen(type_name: str, found: Ros2Type, values: Mapping[str, Any]) -> str:
    """The name by the interfaces that the parameters ask for. Raises NoCounterpart."""
    assert not isinstance(found.here, str)
    asked = values.get(found.interfaces)
    given = {asked} if isinstance(asked, str) else set(map(str, asked)) if isinstance(asked, list) else set()
    for names, here in found.here.items():
        if given == set(names):
            return here
    known = " or ".join(str(list(names)) if found.interfaces.endswith("s") else names[0] for names in found.here)
    value = "not set" if asked is None else repr(asked)
    raise NoCounterpart(
        f"{type_name} is another one here for each interface, and {found.interfaces} is {value}",
        f"set {found.interfaces} to {known}, or the type to {' or '.join(found.here.values())}",
    )
