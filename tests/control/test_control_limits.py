"""What limit handles make of commands: the cases of joint_limits_interface."""

from functools import partial
from math import inf, nan

import pytest

from slidectl.control.hardware_interface import (
    EffortJointInterface,
    JointHandle,
    PositionJointInterface,
    VelocityJointInterface,
)
from slidectl.control.limits import (
    LIMIT_KINDS,
    JointLimits,
    LimitHandle,
    SoftJointLimits,
    bounded,
    in_order,
    limit_handle,
)
from slidectl.errors import Refused

(
    EffortJointSaturation,
    EffortJointSoftLimits,
    PositionJointSaturation,
    PositionJointSoftLimits,
    VelocityJointSaturation,
    VelocityJointSoftLimits,
) = (partial(LimitHandle, kind) for kind in range(len(LIMIT_KINDS)))

PERIOD = 0.1
LIMITS = JointLimits(
    has_position_limits=True,
    min_position=-1.0,
    max_position=1.0,
    has_velocity_limits=True,
    max_velocity=2.0,
    has_effort_limits=True,
    max_effort=8.0,
)
SOFT = SoftJointLimits(min_position=-0.8, max_position=0.8, k_position=20.0, k_velocity=40.0)
VELOCITY_ONLY = JointLimits(has_velocity_limits=True, max_velocity=2.0)
EFFORT_ONLY = JointLimits(has_effort_limits=True, max_effort=8.0)


@pytest.fixture
def joint():
    return JointHandle("joint1")


def let_through(handle, command, period=PERIOD):
    handle.handle.command = command
    handle.enforce(period)
    return handle.handle.command


@pytest.mark.parametrize(("value", "expected"), [(-2, -1), (-1, -1), (-0.5, -0.5), (0, 0), (1, 1), (2, 1)])
def test_bounds_hold_and_their_ends_belong_to_them(value, expected):
    assert bounded(value, -1, 1) == expected


def test_bounds_the_wrong_way_round_give_the_upper_one():
    assert bounded(0.0, 1.0, -1.0) == -1.0


@pytest.mark.parametrize("kind", [EffortJointSaturation, EffortJointSoftLimits])
@pytest.mark.parametrize(("limits", "missing"), [(VELOCITY_ONLY, "effort"), (EFFORT_ONLY, "velocity")])
def test_effort_handles_need_velocity_and_effort_limits(joint, kind, limits, missing):
    arguments = (SOFT,) if kind is EffortJointSoftLimits else ()
    with pytest.raises(Refused, match=f"'joint1' has no {missing} limit"):
        kind(joint, limits, *arguments)


def test_soft_position_limits_and_velocity_saturation_need_a_velocity_limit(joint):
    with pytest.raises(Refused):
        PositionJointSoftLimits(joint, EFFORT_ONLY, SOFT)
    with pytest.raises(Refused):
        VelocityJointSaturation(joint, EFFORT_ONLY)


def test_position_saturation_and_soft_velocity_limits_need_nothing(joint):
    assert let_through(PositionJointSaturation(joint, JointLimits()), 1e300) == 1e300
    assert let_through(VelocityJointSoftLimits(joint, JointLimits(), SOFT), 1e300) == 1e300


class TestEffortSaturation:
    @pytest.mark.parametrize(("command", "expected"), [(4.0, 4.0), (8.0, 8.0), (9.0, 8.0), (-9.0, -8.0)])
    def test_effort_is_clipped(self, joint, command, expected):
        assert let_through(EffortJointSaturation(joint, LIMITS), command) == expected

    @pytest.mark.parametrize(("position", "forward", "back"), [(1.01, 0.0, -5.0), (-1.01, 5.0, 0.0)])
    def test_no_effort_pushes_further_beyond_a_position_limit(self, joint, position, forward, back):
        joint.position = position
        handle = EffortJointSaturation(joint, LIMITS)
        assert let_through(handle, 5.0) == forward
        assert let_through(handle, -5.0) == back

    @pytest.mark.parametrize(("velocity", "forward", "back"), [(2.01, 0.0, -5.0), (-2.01, 5.0, 0.0)])
    def test_no_effort_speeds_up_beyond_the_velocity_limit(self, joint, velocity, forward, back):
        joint.velocity = velocity
        handle = EffortJointSaturation(joint, LIMITS)
        assert let_through(handle, 5.0) == forward
        assert let_through(handle, -5.0) == back

    def test_too_high_and_too_fast_downwards_leaves_no_effort_at_all(self, joint):
        joint.position, joint.velocity = 1.1, -2.1
        handle = EffortJointSaturation(joint, LIMITS)
        assert let_through(handle, 5.0) == let_through(handle, -5.0) == 0.0

    def test_without_position_limits_the_place_does_not_matter(self, joint):
        joint.position = 1e6
        limits = JointLimits(has_velocity_limits=True, max_velocity=2.0, has_effort_limits=True, max_effort=8.0)
        assert let_through(EffortJointSaturation(joint, limits), 9.0) == 8.0


class TestEffortSoftLimits:
    def test_effort_is_free_far_from_the_soft_limits(self, joint):
        assert let_through(EffortJointSoftLimits(joint, LIMITS, SOFT), 5.0) == 5.0

    def test_effort_at_a_soft_limit_only_brakes(self, joint):
        joint.position = 0.8
        handle = EffortJointSoftLimits(joint, LIMITS, SOFT)
        assert let_through(handle, 5.0) == 0.0
        joint.velocity = 0.1
        assert let_through(handle, 5.0) == pytest.approx(-4.0)

    def test_soft_limits_without_hard_ones_bound_only_the_velocity(self, joint):
        joint.position = 5.0
        limits = JointLimits(has_velocity_limits=True, max_velocity=2.0, has_effort_limits=True, max_effort=8.0)
        assert let_through(EffortJointSoftLimits(joint, limits, SOFT), 5.0) == 5.0


class TestPositionSaturation:
    def test_the_first_step_is_from_where_the_joint_is(self, joint):
        joint.position = 0.5
        assert let_through(PositionJointSaturation(joint, LIMITS), -1.0) == pytest.approx(0.3)

    def test_later_steps_are_from_the_last_command(self, joint):
        handle = PositionJointSaturation(joint, LIMITS)
        assert [let_through(handle, 0.5) for _ in range(4)] == pytest.approx([0.2, 0.4, 0.5, 0.5])

    def test_position_limits_hold(self, joint):
        joint.position = 0.95
        assert let_through(PositionJointSaturation(joint, LIMITS), 3.0) == 1.0

    def test_a_joint_far_outside_is_sent_towards_the_upper_bound_of_the_step(self, joint):
        joint.position = -5.0
        assert let_through(PositionJointSaturation(joint, LIMITS), 0.0) == pytest.approx(-4.8)

    def test_after_a_reset_steps_are_from_where_the_joint_is(self, joint):
        handle = PositionJointSaturation(joint, LIMITS)
        let_through(handle, 0.2)
        joint.position = -0.5
        handle.reset()
        assert let_through(handle, 1.0) == pytest.approx(-0.3)

    def test_without_a_velocity_limit_only_the_position_counts(self, joint):
        limits = JointLimits(has_position_limits=True, min_position=-1.0, max_position=1.0)
        assert let_through(PositionJointSaturation(joint, limits), 0.9) == 0.9
        assert let_through(PositionJointSaturation(joint, limits), -7.0) == -1.0


class TestPositionSoftLimits:
    @pytest.mark.parametrize("direction", [1.0, -1.0])
    @pytest.mark.parametrize(("command", "expected"), [(0.1, 0.1), (0.2, 0.2), (0.3, 0.2)])
    def test_a_step_is_at_most_the_velocity_limit(self, joint, direction, command, expected):
        handle = PositionJointSoftLimits(joint, LIMITS, SOFT)
        assert let_through(handle, direction * command) == pytest.approx(direction * expected)

    def test_the_soft_limit_is_approached_and_not_crossed(self, joint):
        joint.position = 0.5
        handle = PositionJointSoftLimits(joint, LIMITS, SOFT)
        reached = [let_through(handle, 1.0, period=0.01) for _ in range(200)]
        assert reached == sorted(reached)
        assert reached[-1] == pytest.approx(0.8)

    def test_a_joint_beyond_its_soft_limit_comes_back(self, joint):
        joint.position = 0.9
        handle = PositionJointSoftLimits(joint, LIMITS, SOFT)
        assert let_through(handle, 1.0) == pytest.approx(0.7)

    def test_soft_limits_outside_the_hard_ones_do_not_count(self, joint):
        joint.position = 0.9
        wide = SoftJointLimits(min_position=-3.0, max_position=3.0, k_position=20.0, k_velocity=40.0)
        assert let_through(PositionJointSoftLimits(joint, LIMITS, wide), 2.0) == 1.0

    def test_after_a_reset_steps_are_from_where_the_joint_is(self, joint):
        handle = PositionJointSoftLimits(joint, LIMITS, SOFT)
        let_through(handle, 0.2)
        joint.position = -0.5
        handle.reset()
        assert let_through(handle, 1.0) == pytest.approx(-0.3)

    def test_without_position_limits_only_the_velocity_counts(self, joint):
        handle = PositionJointSoftLimits(joint, VELOCITY_ONLY, SOFT)
        joint.position = 7.0
        assert let_through(handle, 9.0) == pytest.approx(7.2)


class TestVelocitySaturation:
    @pytest.mark.parametrize(("command", "expected"), [(1.0, 1.0), (2.0, 2.0), (2.5, 2.0), (-2.5, -2.0)])
    def test_velocity_is_clipped(self, joint, command, expected):
        assert let_through(VelocityJointSaturation(joint, LIMITS), command) == expected

    def test_acceleration_is_limited_from_the_last_command(self, joint):
        limits = JointLimits(
            has_velocity_limits=True, max_velocity=2.0, has_acceleration_limits=True, max_acceleration=5.0
        )
        handle = VelocityJointSaturation(joint, limits)
        assert [let_through(handle, 9.0) for _ in range(5)] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.0])
        assert let_through(handle, -9.0) == pytest.approx(1.5)
        handle.reset()
        assert let_through(handle, -9.0) == pytest.approx(-0.5)


class TestVelocitySoftLimits:
    def test_the_velocity_falls_towards_the_soft_limit(self, joint):
        handle = VelocityJointSoftLimits(joint, LIMITS, SOFT)
        assert let_through(handle, 3.0) == 2.0
        joint.position = 0.75
        assert let_through(handle, 3.0) == pytest.approx(1.0)
        joint.position = 0.9
        assert let_through(handle, 3.0) == pytest.approx(-2.0)

    def test_acceleration_is_limited_from_the_measured_velocity(self, joint):
        limits = JointLimits(
            has_velocity_limits=True, max_velocity=2.0, has_acceleration_limits=True, max_acceleration=5.0
        )
        joint.velocity = 1.0
        assert let_through(VelocityJointSoftLimits(joint, limits, SOFT), 9.0) == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("interface", "saturation", "soft"),
    [
        (EffortJointInterface, EffortJointSaturation, EffortJointSoftLimits),
        (PositionJointInterface, PositionJointSaturation, PositionJointSoftLimits),
        (VelocityJointInterface, VelocityJointSaturation, VelocityJointSoftLimits),
    ],
)
def test_soft_limits_take_the_place_of_saturation(joint, interface, saturation, soft):
    assert limit_handle(interface, joint, LIMITS).kind == saturation(joint, LIMITS).kind
    assert limit_handle(interface, joint, LIMITS, SOFT).kind == soft(joint, LIMITS, SOFT).kind


def test_limits_are_enforced_efforts_first_and_joints_in_alphabetical_order():
    a, b = JointHandle("a"), JointHandle("b")
    handles = [
        VelocityJointSaturation(a, LIMITS),
        EffortJointSoftLimits(a, LIMITS, SOFT),
        EffortJointSaturation(b, LIMITS),
        EffortJointSaturation(a, LIMITS),
        PositionJointSaturation(a, LIMITS),
    ]
    assert in_order(handles) == [handles[3], handles[2], handles[1], handles[4], handles[0]]


def test_a_command_that_is_no_number_stays_one_and_an_infinite_one_is_clipped(joint):
    handle = EffortJointSaturation(joint, LIMITS)
    result = let_through(handle, nan)
    assert result != result
    assert let_through(handle, inf) == 8.0
