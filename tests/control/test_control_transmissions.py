"""Transmissions: white-box cases of transmission_interface, and that there and back is the identity."""

import pytest

from slidectl.control.transmission_interface import (
    DifferentialTransmission,
    FourBarLinkageTransmission,
    SimpleTransmission,
)
from slidectl.errors import Refused

TWO_DOF = [DifferentialTransmission, FourBarLinkageTransmission]


@pytest.mark.parametrize("reduction", [0.0, -0.0, 0])
def test_a_simple_transmission_needs_a_reduction(reduction):
    with pytest.raises(Refused, match="must not be 0"):
        SimpleTransmission(reduction)


@pytest.mark.parametrize("kind", TWO_DOF)
@pytest.mark.parametrize(
    "arguments",
    [
        ([0.0, 1.0],),
        ([1.0, 0.0],),
        ([1.0, 1.0], [0.0, 1.0]),
        ([1.0, 1.0], [1.0, 0.0]),
        ([1.0],),
        ([1.0, 1.0], [1.0, 1.0, 1.0]),
        ([1.0, 1.0], [1.0, 1.0], [0.0]),
    ],
)
def test_two_degrees_of_freedom_need_two_reductions_each_and_none_of_zero(kind, arguments):
    with pytest.raises(Refused):
        kind(*arguments)


def test_a_simple_reduction_multiplies_effort_and_divides_motion():
    gear = SimpleTransmission(10.0, 1.0)
    assert gear.joint_effort([1.0]) == [10.0]
    assert gear.joint_velocity([1.0]) == [0.1]
    assert gear.joint_position([1.0]) == [1.1]


def test_a_negative_reduction_turns_the_direction_round():
    assert SimpleTransmission(-2.0).joint_velocity([1.0]) == [-0.5]


DIFFERENTIAL = DifferentialTransmission([10.0, 10.0], [2.0, 2.0])
LINKAGE = FourBarLinkageTransmission([10.0, 10.0], [2.0, 2.0])
MIXED = ([10.0, -20.0], [-2.0, 4.0], [-2.0, 4.0])


@pytest.mark.parametrize("kind", TWO_DOF)
def test_actuators_that_stand_still_leave_the_joints_at_their_offsets(kind):
    gear = kind([10.0, 10.0], [2.0, 2.0], [1.0, 2.0])
    assert gear.joint_effort([0.0, 0.0]) == [0.0, 0.0]
    assert gear.joint_velocity([0.0, 0.0]) == [0.0, 0.0]
    assert gear.joint_position([0.0, 0.0]) == [1.0, 2.0]


@pytest.mark.parametrize(
    ("actuators", "effort", "velocity"),
    [([10.0, 10.0], [400.0, 0.0], [0.5, 0.0]), ([10.0, -10.0], [0.0, 400.0], [0.0, 0.5])],
)
def test_a_differential_moves_one_joint_by_the_sum_and_one_by_the_difference(actuators, effort, velocity):
    assert DIFFERENTIAL.joint_effort(actuators) == effort
    assert DIFFERENTIAL.joint_velocity(actuators) == velocity
    assert DIFFERENTIAL.joint_position(actuators) == velocity


def test_a_differential_moves_both_joints():
    gear = DifferentialTransmission(*MIXED)
    assert gear.joint_effort([3.0, 5.0]) == pytest.approx([140.0, 520.0])
    assert gear.joint_velocity([3.0, 5.0]) == pytest.approx([-0.0125, 0.06875])
    assert gear.joint_position([3.0, 5.0]) == pytest.approx([-2.0125, 4.06875])


def test_a_linkage_moves_each_joint_alone_or_both():
    assert LINKAGE.joint_effort([5.0, 10.0]) == [100.0, 0.0]
    assert LINKAGE.joint_velocity([10.0, 5.0]) == [0.5, 0.0]
    assert LINKAGE.joint_effort([0.0, 10.0]) == [0.0, 200.0]
    assert LINKAGE.joint_velocity([0.0, 10.0]) == [0.0, 0.5]
    gear = FourBarLinkageTransmission(*MIXED)
    assert gear.joint_effort([3.0, 5.0]) == pytest.approx([-60.0, -160.0])
    assert gear.joint_velocity([3.0, 5.0]) == pytest.approx([-0.15, -0.025])
    assert gear.joint_position([3.0, 5.0]) == pytest.approx([-2.15, 3.975])


@pytest.mark.parametrize(
    "gear", [SimpleTransmission(-7.0, 0.3), DifferentialTransmission(*MIXED), FourBarLinkageTransmission(*MIXED)]
)
@pytest.mark.parametrize("quantity", ["effort", "velocity", "position"])
def test_there_and_back_is_where_it_began(gear, quantity):
    actuators = [3.0, -5.0][: gear.size]
    joints = getattr(gear, f"joint_{quantity}")(actuators)
    assert getattr(gear, f"actuator_{quantity}")(joints) == pytest.approx(actuators)


def test_absolute_encoders_map_as_positions_and_torque_sensors_as_efforts():
    gear = FourBarLinkageTransmission(*MIXED)
    assert gear.joint_absolute_position([3.0, 5.0]) == gear.joint_position([3.0, 5.0])
    assert gear.joint_torque_sensor([3.0, 5.0]) == gear.joint_effort([3.0, 5.0])


def test_encoders_on_a_differentials_joints_are_read_crosswise():
    gear = DifferentialTransmission(*MIXED, ignore_absolute_encoders=True)
    assert gear.joint_absolute_position([3.0, 5.0]) == [5.0, 3.0]
