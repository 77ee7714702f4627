"""Interfaces, claims, the robot's hardware and its conflict check, by the rules of hardware_interface."""

import pytest

from slidectl.control.hardware_interface import (
    ClaimedResources,
    Conflict,
    ControllerInfo,
    EffortJointInterface,
    JointHandle,
    JointStateHandle,
    JointStateInterface,
    PositionJointInterface,
    RobotHW,
    SwitchState,
    UnknownResource,
    VelocityJointInterface,
)

COMMANDING = [EffortJointInterface, VelocityJointInterface, PositionJointInterface]


@pytest.mark.parametrize("kind", [JointStateInterface, *COMMANDING])
def test_handles_are_found_by_name_and_listed_in_alphabetical_order(kind):
    first, second = JointHandle("b"), JointHandle("a", 1.0, 2.0, 3.0, 4.0)
    interface = kind([first, second])
    assert interface.names() == ["a", "b"]
    assert interface.get_handle("a") is second
    assert (second.position, second.velocity, second.effort, second.command) == (1.0, 2.0, 3.0, 4.0)


def test_an_unknown_joint_is_refused_by_naming_those_that_exist():
    interface = EffortJointInterface([JointHandle("joint1"), JointHandle("joint2")])
    with pytest.raises(UnknownResource) as refusal:
        interface.get_handle("jiont1")
    assert "hardware_interface::EffortJointInterface" in str(refusal.value)
    assert "Did you mean 'joint1'?" in str(refusal.value)
    assert "joint1, joint2" in str(refusal.value)
    assert interface.pop_claims() == ()


def test_the_last_handle_of_a_name_replaces_the_others():
    old, new = JointStateHandle("joint1"), JointStateHandle("joint1")
    interface = JointStateInterface([old])
    interface.register_handle(new)
    assert interface.get_handle("joint1") is new


@pytest.mark.parametrize("kind", COMMANDING)
def test_command_interfaces_note_each_claim_once_in_alphabetical_order(kind):
    interface = kind([JointHandle("a"), JointHandle("b"), JointHandle("c")])
    for name in ("b", "a", "b"):
        interface.get_handle(name)
    assert interface.pop_claims() == ("a", "b")
    assert interface.pop_claims() == ()


def test_reading_states_claims_nothing():
    interface = JointStateInterface([JointStateHandle("a")])
    interface.get_handle("a")
    assert interface.pop_claims() == ()


def test_a_robot_finds_its_interfaces_by_type():
    robot = RobotHW()
    states, efforts = JointStateInterface([JointHandle("a")]), EffortJointInterface([JointHandle("a")])
    robot.register_interface(states)
    robot.register_interface(efforts)
    assert robot.get(JointStateInterface) is states
    assert robot.get(EffortJointInterface) is efforts
    assert robot.get(VelocityJointInterface) is None
    assert robot.interface_names() == [
        "hardware_interface::EffortJointInterface",
        "hardware_interface::JointStateInterface",
    ]


def test_the_last_interface_of_a_type_replaces_the_others():
    robot = RobotHW()
    old, new = EffortJointInterface(), EffortJointInterface()
    robot.register_interface(old)
    robot.register_interface(new)
    assert robot.get(EffortJointInterface) is new


def info(name, **claims):
    claimed = (ClaimedResources(f"hardware_interface::{kind}", tuple(joints)) for kind, joints in claims.items())
    return ControllerInfo(name, "type", tuple(claimed))


@pytest.mark.parametrize(
    "infos",
    [
        [],
        [info("a")],
        [info("a", Effort=["j1"])],
        [info("a", Effort=["j1"]), info("b", Effort=["j2"])],
        [info("a", State=[]), info("b", State=[])],
    ],
)
def test_controllers_of_different_joints_do_not_conflict(infos):
    assert RobotHW().check_for_conflict(infos) == []


def test_two_controllers_of_one_joint_conflict_even_through_different_interfaces():
    conflicts = RobotHW().check_for_conflict([info("a", Effort=["j1", "j2"]), info("b", Velocity=["j2"])])
    assert conflicts == [Conflict("j2", ("a", "b"))]
    assert str(conflicts[0]) == "j2 is claimed by a and b"


def test_a_controller_may_conflict_with_itself():
    conflicts = RobotHW().check_for_conflict([info("a", Effort=["j1"], Velocity=["j1"])])
    assert conflicts == [Conflict("j1", ("a", "a"))]


def test_hardware_that_says_nothing_of_switching_agrees_at_once():
    robot = RobotHW()
    assert robot.prepare_switch([], [])
    robot.do_switch([], [])
    assert robot.switch_result() is SwitchState.DONE
    assert robot.switch_result(info("a")) is SwitchState.DONE
