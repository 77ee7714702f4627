"""Motion as closed forms have it: a pendulum's period, the torque of gravity, and energy that does not grow."""

from __future__ import annotations

import copy
import math

import mujoco
import pytest
from hypothesis import given
from hypothesis import strategies as st
from physics_robots import arm, box_inertial, one_joint

from slidectl.description.robot import Pose, Robot
from slidectl.physics import World

MASS, LENGTH, EDGE, G, STEP_S = 1.5, 0.6, 0.1, 9.8, 0.001
ABOUT_HINGE = MASS * (2 * EDGE**2 / 12 + LENGTH**2)
"""Moment of inertia in kg·m²."""


def pendulum(damping: float = 0.0) -> Robot:
    """A cube at the end of a massless rod, hanging at angle 0."""
    inertial = box_inertial(MASS, (EDGE, EDGE, EDGE), Pose((0.0, 0.0, -LENGTH)))
    return one_joint("continuous", axis=(0.0, 1.0, 0.0), inertial=inertial, damping=damping)


def swinging(robot: Robot, **positions: float) -> World:
    """The robot at rest in these positions, in a world without ground."""
    world = World(STEP_S, gravity=(0.0, 0.0, -G), ground=False)
    world.attach(robot, "robot")
    for joint, position in positions.items():
        world.set_joint("robot", joint, position, velocity=0.0)
    return world


def energy(world: World) -> float:
    """Kinetic and potential, in J."""
    data = copy.copy(world.data)
    mujoco.mj_forward(world.model, data)
    mujoco.mj_energyPos(world.model, data)
    mujoco.mj_energyVel(world.model, data)
    return float(data.energy.sum())


@pytest.mark.parametrize("amplitude", [0.01, 0.5, 1.5, 2.8])
def test_a_pendulum_has_the_period_of_its_elliptic_integral(amplitude: float) -> None:
    from scipy.special import ellipk  # heavy

    world = swinging(pendulum(), joint1=amplitude)
    crossings: list[float] = []
    before, time_s = amplitude, 0.0
    while len(crossings) < 9:
        world.step()
        time_s += STEP_S
        angle = world.joint_state("robot", "joint1")[0]
        if before * angle < 0:
            crossings.append(time_s - STEP_S * angle / (angle - before))
        before = angle
    expected = 4.0 * math.sqrt(ABOUT_HINGE / (MASS * G * LENGTH)) * ellipk(math.sin(amplitude / 2.0) ** 2)
    assert (crossings[-1] - crossings[0]) / 4.0 == pytest.approx(expected, rel=1e-4)


@given(st.floats(-3.1, 3.1))
def test_gravity_turns_a_pendulum_with_its_torque_and_the_opposite_effort_holds_it(angle: float) -> None:
    torque = -MASS * G * LENGTH * math.sin(angle)
    world = swinging(pendulum(), joint1=angle)
    world.step()
    assert world.joint_state("robot", "joint1")[1] == pytest.approx(STEP_S * torque / ABOUT_HINGE, rel=1e-9, abs=1e-15)
    world = swinging(pendulum(), joint1=angle)
    world.add_joint_force("robot", "joint1", -torque)
    world.step()
    assert world.joint_state("robot", "joint1")[1] == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_a_pendulum_decays_as_its_damping_says(damping: float) -> None:
    world = swinging(pendulum(damping), joint1=0.02)
    for _ in range(10_000):
        world.step()
    rate = damping / (2.0 * ABOUT_HINGE)
    frequency = math.sqrt(MASS * G * LENGTH / ABOUT_HINGE - rate**2)
    swing = math.cos(10.0 * frequency) + rate / frequency * math.sin(10.0 * frequency)
    expected = 0.02 * math.exp(-10.0 * rate) * swing
    assert world.joint_state("robot", "joint1")[0] == pytest.approx(expected, abs=2e-4)


def test_a_pendulum_without_damping_keeps_its_energy() -> None:
    world = swinging(pendulum(), joint1=2.8)
    at_first = energy(world)
    for _ in range(200):
        for _ in range(100):
            world.step()
        assert energy(world) == pytest.approx(at_first, abs=0.005 * 2.0 * MASS * G * LENGTH)


@given(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)), st.floats(0.3, 3.0))
def test_an_arm_with_damping_that_nobody_drives_has_ever_less_energy(
    start: tuple[float, float, float], damping: float
) -> None:
    world = swinging(arm(3, damping=damping), **{f"joint{k}": position for k, position in enumerate(start)})
    before = energy(world)
    for _ in range(20):
        for _ in range(100):
            world.step()
        now = energy(world)
        assert now <= before + 1e-9
        before = now
