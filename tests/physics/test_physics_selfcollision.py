"""Links of one robot pass through each other, unless both are told to collide."""

from __future__ import annotations

import pytest
from physics_robots import at, block, box_inertial, box_shape, tree

from slidectl.description.robot import Joint, Limit, Link, Pose, Robot, Surface
from slidectl.physics import World

CUBE = (0.1, 0.1, 0.1)


def two_carts(left: bool | None, right: bool | None) -> Robot:
    """Two cubes on one rail, 0.5 m apart."""
    links = [
        Link(name, box_inertial(1.0, CUBE), collisions=(box_shape(CUBE),), surface=Surface(self_collide=collide))
        for name, collide in (("left", left), ("right", right))
    ]
    rail = Limit(-5.0, 5.0, 100.0, 100.0)
    joints = [
        Joint("left_joint", "prismatic", "world", "left", Pose((0.0, 0.0, 1.0)), (1.0, 0.0, 0.0), rail),
        Joint("right_joint", "prismatic", "world", "right", Pose((0.5, 0.0, 1.0)), (1.0, 0.0, 0.0), rail),
    ]
    return tree(links, joints)


def where_the_left_cart_gets(world: World) -> float:
    """Pushed to the right for a second."""
    world.set_joint("robot", "left_joint", 0.0, velocity=1.0)
    world.step_n(1000)
    return world.joint_state("robot", "left_joint")[0]


@pytest.mark.parametrize(("left", "right"), [(None, None), (True, None), (None, True), (True, False)])
def test_links_of_a_robot_pass_through_each_other(left: bool | None, right: bool | None) -> None:
    world = World()
    world.attach(two_carts(left, right), "robot")
    assert where_the_left_cart_gets(world) == pytest.approx(1.0)


def test_links_collide_when_both_say_self_collide() -> None:
    world = World()
    world.attach(two_carts(True, True), "robot")
    assert where_the_left_cart_gets(world) < 0.9


def test_links_joined_by_a_joint_do_not_collide_even_then() -> None:
    size = (0.3, 0.3, 0.3)
    surface = Surface(self_collide=True)
    links = [
        Link(name, box_inertial(1.0, size), collisions=(box_shape(size),) if name != "plate" else (), surface=surface)
        for name in ("base", "plate", "tip")
    ]
    joints = [
        Joint("weld", "fixed", "base", "plate"),
        Joint("turn", "continuous", "plate", "tip", axis=(0.0, 0.0, 1.0)),
    ]
    world = World(gravity=(0.0, 0.0, 0.0), ground=False)
    world.attach(tree(links, joints, "base"), "robot")
    world.set_joint("robot", "turn", 0.0, velocity=1.0)
    world.step_n(1000)
    assert world.data.ncon == 0
    assert world.joint_state("robot", "turn")[0] == pytest.approx(1.0)


def test_robots_collide_with_each_other() -> None:
    world = World()
    world.attach(two_carts(None, None), "robot")
    world.attach(block((0.2, 0.2, 0.2), mass=100.0, surface=Surface(turn_gravity_off=True)), "wall", at(0.4, 0.0, 1.0))
    assert where_the_left_cart_gets(world) < 0.5
