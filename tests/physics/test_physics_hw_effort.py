"""Effort joints as DefaultRobotHWSim has them: handles, limits, truncation, read-back, emergency stop."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import pytest
from physics_hardware import Bench
from physics_robots import EFFORT, POSITION, VELOCITY, arm, driven, one_joint, transmission

from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointStateInterface,
    PositionJointInterface,
    VelocityJointInterface,
)
from slidectl.description.robot import Joint, Limit, Mimic, Robot, Safety, TransmissionActuator, TransmissionInfo
from slidectl.errors import Refused


def cart(limit: Limit | None = None, **more: object) -> Robot:
    """A cart of 1 kg, driven by effort."""
    return driven(one_joint(limit=limit, **more), EFFORT)  # type: ignore[arg-type]


def test_a_handle_holds_one_zero_one_before_the_first_read(bench: Bench) -> None:
    bench.take(cart())
    handle = bench.handle()
    assert (handle.position, handle.velocity, handle.effort, handle.command) == (1.0, 0.0, 1.0, 0.0)


def test_all_four_interfaces_exist_even_for_a_robot_without_transmissions(bench: Bench) -> None:
    hardware = bench.take(one_joint())
    for kind in (JointStateInterface, EffortJointInterface, PositionJointInterface, VelocityJointInterface):
        interface = hardware.get(kind)
        assert interface is not None
        assert interface.names() == []


def test_only_joints_with_a_transmission_have_handles(bench: Bench) -> None:
    hardware = bench.take(driven(arm(3), {"joint2": EFFORT, "joint0": EFFORT}))
    states, efforts = hardware.get(JointStateInterface), hardware.get(EffortJointInterface)
    assert states is not None
    assert efforts is not None
    assert states.names() == efforts.names() == ["joint0", "joint2"]


def test_an_effort_moves_the_joint_and_is_read_back(bench: Bench) -> None:
    bench.take(cart())
    bench.cycle(joint1=2.0)
    handle = bench.handle()
    assert (handle.position, handle.velocity, handle.effort) == pytest.approx((2e-6, 2e-3, 2.0))


def test_an_effort_joint_is_free_until_a_command_comes(bench: Bench) -> None:
    bench.take(cart())
    bench.world.set_joint("robot", "joint1", 0.0, velocity=0.5)
    bench.cycle(100)
    assert bench.handle().velocity == 0.5
    assert bench.handle().effort == 0.0


def test_angles_are_unwrapped_from_one_radian(bench: Bench) -> None:
    bench.take(driven(one_joint("continuous"), EFFORT))
    bench.world.set_joint("robot", "joint1", -2.5)
    bench.hardware.read(0, 0.001)
    assert bench.handle().position == pytest.approx(2 * pi - 2.5)


def test_angles_count_turns(bench: Bench) -> None:
    bench.take(driven(one_joint("continuous"), EFFORT))
    bench.world.set_joint("robot", "joint1", 0.0, velocity=20.0)
    bench.cycle(1000)
    assert bench.handle().position == pytest.approx(20.0)


def test_lengths_are_not_unwrapped(bench: Bench) -> None:
    bench.take(cart(Limit(-50.0, 50.0, 100.0, 100.0)))
    bench.world.set_joint("robot", "joint1", -20.0)
    bench.hardware.read(0, 0.001)
    assert bench.handle().position == -20.0


def test_an_infinite_angle_is_read_as_not_a_number(bench: Bench) -> None:
    bench.take(driven(one_joint("continuous"), EFFORT))
    bench.world.data.qpos[:] = float("inf")
    bench.hardware.read(0, 0.001)
    assert bench.handle().position != bench.handle().position


def test_the_effort_limit_bounds_command_and_effort(bench: Bench) -> None:
    bench.take(cart(Limit(-5.0, 5.0, velocity=100.0, effort=3.0)))
    bench.cycle(joint1=50.0)
    assert bench.handle().effort == 3.0
    assert bench.handle().command == 3.0, "controllers see what became of their command"
    bench.cycle(joint1=-50.0)
    assert bench.handle().effort == -3.0


def test_no_effort_pushes_further_beyond_the_velocity_limit(bench: Bench) -> None:
    bench.take(cart(Limit(-5.0, 5.0, velocity=0.1, effort=100.0)))
    for velocity, effort, applied in ((0.2, 5.0, 0.0), (0.2, -5.0, -5.0), (-0.2, -5.0, 0.0), (-0.2, 5.0, 5.0)):
        bench.world.set_joint("robot", "joint1", 0.0, velocity)
        bench.cycle(joint1=effort)
        assert bench.handle().effort == applied


def test_without_limit_element_nothing_is_cut(bench: Bench) -> None:
    bench.take(driven(one_joint("continuous"), EFFORT))
    bench.world.set_joint("robot", "joint1", 0.0, velocity=1e3)
    bench.cycle(joint1=1e6)
    assert bench.handle().effort == 1e6


def test_an_effort_limit_of_zero_holds_for_ever(bench: Bench) -> None:
    bench.take(cart(Limit(-5.0, 5.0, velocity=1.0, effort=0.0)))
    bench.cycle(10, joint1=10.0)
    assert bench.handle().position == 0.0


def test_the_truncation_goes_by_the_urdf_even_when_parameters_widen_the_limits(bench: Bench) -> None:
    wide = {"has_effort_limits": True, "max_effort": 50.0}
    bench.take(cart(Limit(-5.0, 5.0, velocity=100.0, effort=3.0)), joint_limits={"joint1": wide})
    bench.cycle(joint1=40.0)
    assert bench.handle().command == 40.0
    assert bench.handle().effort == 3.0
    assert (bench.handle().lowest, bench.handle().highest) == (-3.0, 3.0)


def test_parameters_can_tighten_the_limits_and_give_them_to_joints_that_have_none(bench: Bench) -> None:
    tight = {"has_effort_limits": True, "max_effort": 2.0, "has_velocity_limits": True, "max_velocity": 1.0}
    bench.take(driven(one_joint("continuous"), EFFORT), joint_limits={"joint1": tight})
    bench.cycle(joint1=40.0)
    assert bench.handle().effort == 2.0
    assert (bench.handle().lowest, bench.handle().highest) == (-2.0, 2.0)


def test_soft_limits_stand_in_for_the_saturation(bench: Bench) -> None:
    safety = Safety(soft_lower_limit=-0.5, soft_upper_limit=0.5, k_position=10.0, k_velocity=20.0)
    bench.take(cart(Limit(-1.0, 1.0, velocity=1.0, effort=100.0), safety=safety))
    bench.world.set_joint("robot", "joint1", 0.45, velocity=0.2)
    bench.cycle(joint1=50.0)
    assert bench.handle().effort == pytest.approx(-20.0 * (0.2 - -10.0 * (0.45 - 0.5)))


def test_limits_that_no_handle_takes_refuse_the_robot(bench: Bench) -> None:
    with pytest.raises(Refused, match="joint 'joint1' has no velocity limit"):
        bench.take(cart(), joint_limits={"joint1": {"has_velocity_limits": False}})


def test_the_short_name_of_an_interface_is_taken_and_of_several_the_first(bench: Bench) -> None:
    robot = replace(arm(2), transmissions=(transmission("joint0", "EffortJointInterface", VELOCITY),))
    hardware = bench.take(robot)
    efforts, velocities = hardware.get(EffortJointInterface), hardware.get(VelocityJointInterface)
    assert efforts is not None
    assert velocities is not None
    assert efforts.names() == ["joint0"]
    assert velocities.names() == []


@pytest.mark.parametrize("name", ["hardware_interface::EffortJointInterface", "hardware_interface/JointStateInterface"])
def test_an_interface_that_is_not_simulated_refuses_the_robot(bench: Bench, name: str) -> None:
    robot = replace(one_joint(), transmissions=(transmission("joint1", name),))
    with pytest.raises(Refused) as caught:
        bench.take(robot)
    assert "transmission 'tran_joint1' of robot 'robot': joint 'joint1' requires" in str(caught.value)
    assert name in str(caught.value)
    assert f"it has: {EFFORT}" in str(caught.value)


def test_a_transmission_to_a_joint_that_does_not_move_refuses_the_robot(bench: Bench) -> None:
    robot = replace(one_joint(), transmissions=(transmission("joint2", EFFORT),))
    with pytest.raises(Refused, match="no joint 'joint2' that moves"):
        bench.take(robot)


def test_a_transmission_of_several_joints_is_passed_over(bench: Bench) -> None:
    one, other = transmission("joint0", EFFORT), transmission("joint1", EFFORT)
    both = TransmissionInfo("both", one.type, (*one.joints, *other.joints), (TransmissionActuator("a"),))
    hardware = bench.take(replace(arm(3), transmissions=(both, transmission("joint2", EFFORT))))
    states = hardware.get(JointStateInterface)
    assert states is not None
    assert states.names() == ["joint2"]
    bench.cycle(joint2=1.0)
    assert bench.handle("joint2").effort == 1.0


def test_efforts_of_two_transmissions_on_one_joint_add_up(bench: Bench) -> None:
    hardware = bench.take(replace(one_joint(), transmissions=(transmission("joint1", EFFORT),) * 2))
    bench.cycle(joint1=3.0)
    assert bench.handle().effort == 3.0
    for joint in hardware._joints:
        joint.handle.command = 2.0
    hardware.write(0, 0.001)
    hardware.read(0, 0.001)
    assert bench.handle().effort == 4.0


def test_efforts_from_outside_are_read_back_with_those_of_the_controllers(bench: Bench) -> None:
    bench.take(cart())
    bench.world.add_joint_force("robot", "joint1", 0.5, duration_ns=2_000_000)
    bench.cycle(joint1=2.0)
    assert bench.handle().effort == 2.5
    bench.cycle(5, joint1=2.0)
    assert bench.handle().effort == 2.0


def test_handles_go_on_working_when_other_robots_come_and_go(bench: Bench) -> None:
    bench.world.attach(arm(2), "before")
    bench.take(cart())
    bench.cycle(10, joint1=1.0)
    bench.world.attach(arm(5), "after")
    bench.cycle(10, joint1=1.0)
    bench.world.detach("before")
    bench.cycle(10, joint1=1.0)
    assert bench.handle().velocity == pytest.approx(0.030)
    assert bench.handle().effort == 1.0


def test_in_an_emergency_stop_no_effort_is_applied_whatever_controllers_say(bench: Bench) -> None:
    hardware = bench.take(cart())
    bench.cycle(joint1=1.0)
    hardware.estop = True
    bench.cycle(10, joint1=1.0)
    assert bench.handle().effort == 0.0
    assert bench.handle().velocity == pytest.approx(0.001)
    hardware.estop = False
    bench.cycle(joint1=1.0)
    assert bench.handle().effort == 1.0


def test_a_reset_forgets_turns_and_commands(bench: Bench) -> None:
    hardware = bench.take(driven(one_joint("continuous"), EFFORT))
    bench.world.set_joint("robot", "joint1", 0.0, velocity=20.0)
    bench.cycle(1000, joint1=0.5)
    bench.world.reset()
    hardware.reset()
    handle = bench.handle()
    assert (handle.position, handle.velocity, handle.effort, handle.command) == (0.0, 0.0, 0.0, 0.0)


def test_a_driven_mimic_joint_is_driven_like_any_other(bench: Bench) -> None:
    robot = arm(2)
    joints = dict(robot.joints)
    joints["joint1"] = replace(joints["joint1"], mimic=Mimic("joint0"))
    assert isinstance(joints["joint1"], Joint)
    bench.take(driven(replace(robot, joints=joints), EFFORT))
    bench.cycle(200, joint0=0.1, joint1=0.1)
    assert bench.handle("joint0").position == pytest.approx(bench.handle("joint1").position, abs=1e-3)


def test_position_and_velocity_interfaces_hold_their_joints(bench: Bench) -> None:
    hardware = bench.take(driven(arm(2), {"joint0": POSITION, "joint1": VELOCITY}))
    positions, velocities = hardware.get(PositionJointInterface), hardware.get(VelocityJointInterface)
    assert positions is not None
    assert velocities is not None
    assert (positions.names(), velocities.names()) == (["joint0"], ["joint1"])
