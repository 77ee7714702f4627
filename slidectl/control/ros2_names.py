"""Controller types of ROS 2: the equivalent type here, or the advice what to write when there is none.

The manager, checks and the documentation use this table. It refers to no controller classes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from slidectl.description.parameter_trees import leaves
from slidectl.errors import Refused

_RATE = {"publish_rate": 100.0}
_STEERS_ONE = (
    "ackermann_steering_controller/AckermannSteeringController has one rear_wheel and one front_steer,"
    " and takes angular.z as the angle of the steering"
)


class Ros2Type(NamedTuple):
    """One type of ROS 2."""

    here: str
    """The type here."""
    note: str = ""
    """The remaining differences."""
    defaults: Mapping[str, Any] = {}
    """Values of parameters that are optional in ROS 2 and required here."""


NAMES: dict[str, Ros2Type] = {
    "imu_sensor_broadcaster/IMUSensorBroadcaster": Ros2Type(
        "imu_sensor_controller/ImuSensorController", "each IMU is published on its name", defaults=_RATE
    ),
    "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster": Ros2Type(
        "force_torque_sensor_controller/ForceTorqueSensorController",
        "each sensor is published on its name",
        defaults=_RATE,
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
}
"""Types of ROS 2 without an equivalent: the advice what to write here, and, for a type with the same name here,
parameters that identify the ROS 2 type."""


class Counterpart(NamedTuple):
    """The equivalent here of a controller of ROS 2."""

    type: str
    remark: str
    values: Mapping[str, Any]
    """Parameters to set: defaults of ROS 2."""


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
            raise NoCounterpart(f"{type_name} of ROS 2 is another controller", f"here: {advice}")
        return None
    found = NAMES.get(type_name)
    if found is None:
        return None
    more = {name: value for name, value in found.defaults.items() if name not in values}
    remark = f"{type_name} is {found.here} here"
    remark += "".join(f", with {name} {value}" for name, value in more.items())
    return Counterpart(found.here, f"{remark}; {found.note}" if found.note else remark, more)
