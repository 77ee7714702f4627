"""Types of controllers as users of ROS 2 write them: what each is here, or what to write instead."""

from __future__ import annotations

import pytest

from slidectl.control import registry
from slidectl.control.ros2_names import NAMES, OTHERS, NoCounterpart, counterpart

TRAJECTORY = "joint_trajectory_controller/JointTrajectoryController"


@pytest.mark.parametrize(
    ("name", "parameters", "here"),
    [
        (TRAJECTORY, {"command_interfaces": ["position"]}, "position_controllers/JointTrajectoryController"),
        (TRAJECTORY, {"command_interfaces": ["effort"]}, "effort_controllers/JointTrajectoryController"),
        (TRAJECTORY, {"command_interfaces": ["velocity", "position"]}, "pos_vel_controllers/JointTrajectoryController"),
    ],
)
def test_a_type_of_the_same_meaning_is_understood(name: str, parameters: dict, here: str) -> None:
    found = counterpart(name, parameters)
    assert found is not None
    assert found.type == here
    assert found.remark.startswith(f"{name} is {here} here")


def test_every_name_that_the_table_gives_is_a_type_here() -> None:
    given = [known.here for known in NAMES.values()]
    types = [name for here in given for name in ([here] if isinstance(here, str) else here.values())]
    words = [word for advice, _ in OTHERS.values() for word in advice.replace(",", " ").split() if "Controller" in word]
    assert set(types + words) <= set(registry.common.types()) | {"control_msgs/GripperCommand"}


def test_parameters_of_other_names_are_handed_on() -> None:
    gains = {"gains": {"a": {"p": 1.0, "ff_velocity_scale": 0.5}}, "command_interfaces": ["effort"]}
    trajectory = counterpart(TRAJECTORY, gains)
    assert trajectory is not None
    assert trajectory.values == {"velocity_ff/a": 0.5}


def test_the_same_name_with_parameters_of_ros_1_is_left_alone() -> None:
    assert counterpart("ackermann_steering_controller/AckermannSteeringController", {"rear_wheel": "r"}) is None
    assert counterpart("effort_controllers/JointPositionController", {}) is None


@pytest.mark.parametrize(
    ("name", "parameters", "text"),
    [
        (TRAJECTORY, {}, "command_interfaces is not set"),
        (TRAJECTORY, {"command_interfaces": ["position", "effort"]}, r"set command_interfaces to \['position'\] or"),
        (TRAJECTORY, {"command_interfaces": [["position"]]}, r"command_interfaces is \[\['position'\]\]"),
        ("tricycle_controller/TricycleController", {}, "here: ackermann_steering_controller/Ackermann"),
        ("range_sensor_broadcaster/RangeSensorBroadcaster", {}, "slidectl has no range_sensor_broadcaster/Range"),
        (
            "ackermann_steering_controller/AckermannSteeringController",
            {"traction_joints_names": ["a", "b"]},
            "one rear_wheel and one front_steer",
        ),
    ],
)
def test_what_means_something_else_is_refused_with_what_to_write(name: str, parameters: dict, text: str) -> None:
    with pytest.raises(NoCounterpart, match=text):
        counterpart(name, parameters)


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
