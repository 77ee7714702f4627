"""Controller types of ROS 2 that slidectl does not have: the advice what to write when one is named.

The manager, checks and the documentation use this table. It refers to no controller classes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slidectl.description.parameter_trees import leaves
from slidectl.errors import Refused

_STEERS_ONE = (
    "ackermann_steering_controller/AckermannSteeringController has one rear_wheel and one front_steer,"
    " and takes angular.z as the angle of the steering"
)

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
    "pose_broadcaster/PoseBroadcaster": ("the pose of each link is on /tf and on /gazebo/link_states", ()),
    "range_sensor_broadcaster/RangeSensorBroadcaster": ("a laser scanner of the model publishes by itself", ()),
    "state_interfaces_broadcaster/StateInterfacesBroadcaster": (
        "joint_state_broadcaster/JointStateBroadcaster for joints, and the broadcasters of sensors",
        (),
    ),
}
"""The advice what to write here, and, for a type with the same name here, parameters that identify the ROS 2 type."""

IDENTIFIED_BY: dict[str, tuple[str, ...]] = {
    "diff_drive_controller/DiffDriveController": ("left_wheel_names", "right_wheel_names"),
}
"""By type that ros_controllers have as well: parameters that only ros2_controllers read."""


class NoCounterpart(Refused):
    """A type of ROS 2 that slidectl does not have."""


def has_parameters_of(type_name: str, parameters: Mapping[str, Any]) -> bool:
    """True when the parameters, nested or by full names, are those of the type of ros2_controllers."""
    names = {name for name, _ in leaves(parameters)}
    return any(name in names for name in IDENTIFIED_BY.get(type_name, ()))


def refuse_others(type_name: str, parameters: Mapping[str, Any]) -> None:
    """Raise NoCounterpart for a type of ROS 2 that is not here, with these parameters, nested or by full names.

    The hint says what to write.
    """
    advice, telling = OTHERS.get(type_name, ("", ()))
    if advice and (not telling or any(name in telling for name, _ in leaves(parameters))):
        text = f"{type_name} of ROS 2 is another controller" if telling else f"slidectl has no {type_name}"
        raise NoCounterpart(text, f"here: {advice}")
