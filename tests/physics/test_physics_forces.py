"""Forces from outside: when they act, what they do, and that nothing of them stays."""

from __future__ import annotations

import pytest
from physics_robots import at, block, one_joint, state_of

from slidectl.description.robot import Limit
from slidectl.errors import Refused, UnknownName
from slidectl.physics import World

MS = 1_000_000


def weightless(limit: Limit | None = None) -> World:
    """A cart of 1 kg on a rail, nothing else."""
    world = World(gravity=(0.0, 0.0, 0.0))
    world.attach(one_joint(limit=limit), "one")
    return world


def velocity(world: World) -> float:
    """Of the cart."""
    return world.joint_state("one", "joint1")[1]


def test_a_force_acts_from_its_start_for_its_duration() -> None:
    world = weightless()
    world.add_joint_force("one", "joint1", 10.0, start_ns=100 * MS, duration_ns=49 * MS)
    for _ in range(99):
        world.step()
    assert velocity(world) == 0.0
    for _ in range(200):
        world.step()
    assert velocity(world) == pytest.approx(10.0 * 0.050)


def test_a_force_without_end_acts_until_it_is_cleared() -> None:
    world = weightless()
    world.add_joint_force("one", "joint1", 10.0)
    for _ in range(500):
        world.step()
    assert velocity(world) == pytest.approx(5.0)
    assert world.joint_state("one", "joint1")[2] == 10.0
    world.clear_joint_forces("one", "joint1")
    for _ in range(500):
        world.step()
    assert velocity(world) == pytest.approx(5.0)
    assert world.joint_state("one", "joint1")[2] == 0.0


def test_forces_add_up_and_the_clock_of_the_world_is_the_one_that_counts() -> None:
    world = weightless()
    now = [0]
    world.clock = lambda: now[0]
    world.add_joint_force("one", "joint1", 1.0, start_ns=5, duration_ns=0)
    world.add_joint_force("one", "joint1", 2.0, start_ns=5, duration_ns=10)
    world.step()
    assert velocity(world) == 0.0
    now[0] = 5
    world.step()
    assert velocity(world) == pytest.approx(0.003)
    now[0] = 15
    world.step()
    assert velocity(world) == pytest.approx(0.005)
    now[0] = 16
    world.step()
    assert velocity(world) == pytest.approx(0.005)


def test_efforts_from_outside_are_cut_by_the_limits_of_the_joint() -> None:
    world = weightless(Limit(-5.0, 5.0, velocity=0.5, effort=4.0))
    world.add_joint_force("one", "joint1", 10.0)
    for _ in range(100):
        world.step()
    assert velocity(world) == pytest.approx(0.4)
    for _ in range(1000):
        world.step()
    assert velocity(world) == pytest.approx(0.5, abs=0.005)


def test_a_wrench_pushes_and_turns_a_link_in_the_axes_of_the_world() -> None:
    world = World(gravity=(0.0, 0.0, 0.0))
    turned = (0.5, 0.5, 0.5, 0.5)
    world.attach(block((0.2, 0.2, 0.2), mass=2.0), "block", ((0.0, 0.0, 5.0), turned))
    world.add_wrench("block", "base", (1.0, 2.0, 3.0), (0.0, 0.004, 0.0), duration_ns=1000 * MS)
    for _ in range(2000):
        world.step()
    linear, angular = world.link_twist("block", "base")
    assert linear == pytest.approx((0.5, 1.0, 1.5))
    assert angular == pytest.approx((0.0, 0.004 / (2.0 * 0.08 / 12), 0.0), abs=1e-9)


def test_a_wrench_can_be_cleared() -> None:
    world = World(gravity=(0.0, 0.0, 0.0))
    world.attach(block(), "block", at(0.0, 0.0, 5.0))
    world.add_wrench("block", "base", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    world.clear_wrenches("block", "base")
    for _ in range(10):
        world.step()
    assert world.link_twist("block", "base")[0] == (0.0, 0.0, 0.0)


def test_forces_go_with_their_robot_and_stay_with_the_others() -> None:
    world = weightless()
    world.attach(one_joint(), "two")
    world.add_joint_force("one", "joint1", 10.0)
    world.add_joint_force("two", "joint1", 20.0)
    world.detach("two")
    for _ in range(100):
        world.step()
    assert velocity(world) == pytest.approx(1.0)
    world.attach(one_joint(), "two")
    for _ in range(100):
        world.step()
    assert velocity(world) == pytest.approx(2.0)
    assert world.joint_state("two", "joint1")[1] == 0.0


def test_what_the_hardware_applies_is_untouched_by_forces_from_outside() -> None:
    world = weightless()
    place = world.robot("one").place("joint1")
    world.data.qfrc_applied[place.dof] = 0.1
    world.add_joint_force("one", "joint1", 0.2, duration_ns=10 * MS)
    for _ in range(5):
        world.step()
    assert world.data.qfrc_applied[place.dof] == 0.1
    assert velocity(world) == pytest.approx(0.3 * 0.005)


def test_when_forces_are_over_a_step_is_a_bare_step_again() -> None:
    world = weightless()
    bare, told = world.step, []
    world.on_rebuild(lambda: told.append(world.step))
    world.add_joint_force("one", "joint1", 1.0, duration_ns=3 * MS)
    assert world.step != bare
    for _ in range(5):
        world.step()
    assert world.step == bare
    assert len(told) == 2


def test_many_steps_at_once_are_the_same_as_one_by_one() -> None:
    one, other = weightless(), weightless()
    for world in (one, other):
        world.add_joint_force("one", "joint1", 1.0, start_ns=20 * MS, duration_ns=30 * MS)
    for _ in range(100):
        one.step()
    for _ in range(100):
        other.step()
    assert state_of(one, "one") == state_of(other, "one")


def test_a_reset_ends_all_forces() -> None:
    world = weightless()
    world.add_joint_force("one", "joint1", 1.0)
    world.add_wrench("one", "cart", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    for _ in range(10):
        world.step()
    world.reset()
    for _ in range(10):
        world.step()
    assert world.joint_state("one", "joint1") == (0.0, 0.0, 0.0)


def test_forces_on_what_does_not_exist_are_refused() -> None:
    world = weightless()
    with pytest.raises(UnknownName):
        world.add_joint_force("one", "joint2", 1.0)
    with pytest.raises(UnknownName):
        world.add_wrench("one", "carriage", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    with pytest.raises(UnknownName):
        world.clear_joint_forces("two", "joint1")
    with pytest.raises(UnknownName):
        world.clear_wrenches("one", "carriage")
    with pytest.raises(Refused):
        world.add_joint_force("one", "joint1", float("nan"))
