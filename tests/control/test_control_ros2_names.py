"""Types of controllers as users of ROS 2 write them: what to write instead."""

from __future__ import annotations

import pytest

from slidectl.control import registry
from slidectl.control.ros2_names import OTHERS, NoCounterpart, refuse_others


def test_every_name_that_the_table_gives_is_a_type_here() -> None:
    words = [word for advice, _ in OTHERS.values() for word in advice.replace(",", " ").split() if "Controller" in word]
    assert set(words) <= set(registry.common.types()) | {"control_msgs/GripperCommand"}


def test_the_same_name_with_parameters_of_ros_1_is_left_alone() -> None:
    refuse_others("ackermann_steering_controller/AckermannSteeringController", {"rear_wheel": "r"})
    refuse_others("effort_controllers/JointPositionController", {})


@pytest.mark.parametrize(
    ("name", "parameters", "text"),
    [
        ("tricycle_controller/TricycleController", {}, "here: ackermann_steering_controller/Ackermann"),
        (
            "ackermann_steering_controller/AckermannSteeringController",
            {"traction_joints_names": ["a", "b"]},
            "one rear_wheel and one front_steer",
        ),
    ],
)
def test_what_means_something_else_is_refused_with_what_to_write(name: str, parameters: dict, text: str) -> None:
    with pytest.raises(NoCounterpart, match=text):
        refuse_others(name, parameters)


@pytest.mark.parametrize(
    ("parameters", "for_ros2", "expected"),
    [
        ({"left_wheel": "l"}, False, False),
        ({"left_wheel": "l"}, True, True),
        ({"left_wheel_names": ["l"]}, False, True),
    ],
)
def test_a_type_of_both_is_that_of_the_robot_or_of_the_parameters(
    parameters: dict, for_ros2: bool, expected: bool
) -> None:
    drive = "diff_drive_controller/DiffDriveController"
    assert registry.is_of_ros2(drive, parameters, for_ros2) is expected
    assert not registry.is_of_ros2("four_wheel_steering_controller/FourWheelSteeringController", parameters, for_ros2)
