"""Joint limits from a robot on paper and from parameters, by the tables of joint_limits_interface."""

from dataclasses import replace

import pytest

from slidectl.control.limits import (
    NO_LIMITS,
    JointLimits,
    SoftJointLimits,
    limits_from_joint,
    limits_from_parameters,
    soft_limits_from_joint,
    soft_limits_from_parameters,
)
from slidectl.description.robot import Joint, Limit, Safety

FULL = JointLimits(
    has_position_limits=True,
    min_position=0.0,
    max_position=1.0,
    has_velocity_limits=True,
    max_velocity=2.0,
    has_acceleration_limits=True,
    max_acceleration=5.0,
    has_jerk_limits=True,
    max_jerk=100.0,
    has_effort_limits=True,
    max_effort=20.0,
)


LIMIT = Limit(lower=-0.5, upper=0.7, velocity=3.0, effort=4.0)


def joint(kind, limit=LIMIT, safety=None):
    return Joint("joint1", kind, "base", "tip", limit=limit, safety=safety)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_joints_with_ends_get_position_velocity_and_effort_limits(kind):
    limits = limits_from_joint(joint(kind))
    assert limits == JointLimits(
        has_position_limits=True,
        min_position=-0.5,
        max_position=0.7,
        has_velocity_limits=True,
        max_velocity=3.0,
        has_effort_limits=True,
        max_effort=4.0,
    )


def test_a_continuous_joint_wraps_around_and_has_no_position_limits():
    limits = limits_from_joint(joint("continuous"))
    assert not limits.has_position_limits
    assert limits.angle_wraparound
    assert (limits.max_velocity, limits.max_effort) == (3.0, 4.0)


def test_an_effort_limit_of_zero_is_a_limit():
    limits = limits_from_joint(joint("revolute", Limit(0.0, 0.0, 0.0, 0.0)))
    assert limits.has_effort_limits
    assert limits.max_effort == 0.0


def test_a_joint_without_limit_has_none():
    assert limits_from_joint(joint("continuous", limit=None)) is None


def test_what_a_joint_says_nothing_of_stays():
    limits = limits_from_joint(joint("revolute"), FULL)
    assert limits.has_jerk_limits
    assert limits.max_jerk == 100.0
    assert not limits.has_acceleration_limits


def test_soft_limits_are_those_of_the_safety_controller():
    assert soft_limits_from_joint(joint("revolute")) is None
    assert soft_limits_from_joint(joint("revolute", safety=Safety(-0.1, 0.2, 10.0, 20.0))) == SoftJointLimits(
        -0.1, 0.2, 10.0, 20.0
    )


def from_parameters(graph, values, base=NO_LIMITS):
    graph.set("/bot/joint_limits/joint1", values)
    return limits_from_parameters(graph.node("/bot"), "joint1", base)


def test_without_parameters_there_are_no_limits_from_them(graph):
    assert limits_from_parameters(graph.node("/bot"), "joint1") is None
    assert limits_from_parameters(graph.node("/bot"), "no-legal-name") is None


def test_a_full_set_of_parameters_gives_all_limits(graph):
    values = {
        "has_position_limits": True,
        "min_position": 0.0,
        "max_position": 1.0,
        "has_velocity_limits": True,
        "max_velocity": 2.0,
        "has_acceleration_limits": True,
        "max_acceleration": 5.0,
        "has_jerk_limits": True,
        "max_jerk": 100.0,
        "has_effort_limits": True,
        "max_effort": 20,
    }
    assert from_parameters(graph, values) == FULL


def test_values_without_their_flag_change_nothing(graph):
    assert from_parameters(graph, {"max_velocity": 9.0, "min_position": 1.0, "angle_wraparound": True}) == JointLimits()


@pytest.mark.parametrize(
    "values",
    [
        {"has_position_limits": True, "min_position": -9.0},
        {"has_position_limits": True, "max_position": 9.0},
        {"has_velocity_limits": True},
        {"has_effort_limits": 1, "max_effort": 9.0},
        {"has_velocity_limits": True, "max_velocity": "fast"},
    ],
)
def test_a_flag_without_its_values_changes_nothing(graph, values):
    assert from_parameters(graph, values, FULL) == FULL


@pytest.mark.parametrize("group", ["position", "velocity", "acceleration", "jerk", "effort"])
def test_a_false_flag_switches_a_limit_off(graph, group):
    flag = f"has_{group}_limits"
    assert from_parameters(graph, {flag: False}, FULL) == replace(FULL, **{flag: False})


def test_a_joint_without_position_limits_may_wrap_around(graph):
    limits = from_parameters(graph, {"has_position_limits": False, "angle_wraparound": True}, FULL)
    assert limits == replace(FULL, has_position_limits=False, angle_wraparound=True)
    limits = from_parameters(graph, {"has_position_limits": True, "angle_wraparound": True}, FULL)
    assert not limits.angle_wraparound


SOFT = {"soft_lower_limit": 0.1, "soft_upper_limit": 0.9, "k_position": 10.0, "k_velocity": 20.0}


def test_soft_limits_need_their_flag_and_all_four_values(graph):
    def read(values):
        graph.set("/bot/joint_limits/joint1", values)
        return soft_limits_from_parameters(graph.node("/bot"), "joint1")

    assert read({"has_soft_limits": True, **SOFT}) == SoftJointLimits(0.1, 0.9, 10.0, 20.0)
    assert read(SOFT) is None
    assert read({"has_soft_limits": False, **SOFT}) is None
    for missing in SOFT:
        values = {name: value for name, value in SOFT.items() if name != missing}
        assert read({"has_soft_limits": True, **values}) is None
