"""Links of one robot pass through each other, unless both are told to collide; robots never do."""

from __future__ import annotations

import sys
from itertools import combinations
from types import FrameType
from typing import Any

import mujoco
import pytest
from hypothesis import given
from hypothesis import strategies as st
from physics_robots import at, block, box_inertial, box_shape, tree

from slidectl.description.robot import Joint, Limit, Link, Pose, Robot, Shape, Sphere, Surface
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
    for _ in range(1000):
        world.step()
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
    for _ in range(1000):
        world.step()
    assert world.data.ncon == 0
    assert world.joint_state("robot", "turn")[0] == pytest.approx(1.0)


def test_robots_collide_with_each_other() -> None:
    world = World()
    world.attach(two_carts(None, None), "robot")
    world.attach(block((0.2, 0.2, 0.2), mass=100.0, surface=Surface(turn_gravity_off=True)), "wall", at(0.4, 0.0, 1.0))
    assert where_the_left_cart_gets(world) < 0.5


def ball(name: str, number: int, collide: bool) -> Link:
    """A link whose shape overlaps those of all others that are made by this."""
    shape = Shape(Sphere(0.1), Pose((0.001 * number, 0.002 * number**2, 0.0)))
    return Link(name, box_inertial(1.0, CUBE), collisions=(shape,), surface=Surface(self_collide=collide))


@st.composite
def heaps(draw: st.DrawFn) -> Robot:
    """A robot of up to nine links, all in the same place, held by its root or free."""
    fixed = draw(st.booleans())
    root = "world" if fixed else "base"
    names = [root, *(f"link{i}" for i in range(draw(st.integers(1, 8))))]
    links = [ball(name, number, draw(st.booleans())) for number, name in enumerate(names)]
    joints = []
    for number, name in enumerate(names[1:], 1):
        parent = names[draw(st.integers(0, number - 1))]
        kind = draw(st.sampled_from(["fixed", "continuous", "floating"]))
        joints.append(Joint(f"to_{name}", kind, parent, name, axis=(0.0, 0.0, 1.0)))
    return tree(links, joints, root)


def welded(robot: Robot) -> dict[str, str]:
    """The topmost link to which fixed joints weld each link."""
    above = {joint.child: joint for joint in robot.joints.values()}

    def top(link: str) -> str:
        return top(above[link].parent) if link in above and above[link].type == "fixed" else link

    return {link: top(link) for link in robot.links}


def allowed(robot: Robot) -> set[frozenset[str]]:
    """The pairs of links of one robot that touch by Gazebo's rule."""
    group = welded(robot)
    joined = {frozenset((group[joint.parent], group[joint.child])) for joint in robot.joints.values()}
    pairs = set()
    for one, other in combinations(robot.links.values(), 2):
        groups = frozenset((group[one.name], group[other.name]))
        if len(groups) == 2 and groups not in joined and one.surface.self_collide and other.surface.self_collide:
            pairs.add(frozenset((one.name, other.name)))
    return pairs


def touching(world: World) -> set[frozenset[str]]:
    """The pairs of links that are in contact."""
    mujoco.mj_forward(world.model, world.data)
    names = [world.model.geom(index).name.rpartition("/")[0] for index in range(world.model.ngeom)]
    return {frozenset(names[geom] for geom in contact.geom) for contact in world.data.contact}


@given(heaps())
def test_the_links_of_one_robot_that_touch_are_those_of_gazebos_rule(robot: Robot) -> None:
    world = World(ground=False)
    world.attach(robot, "robot")
    assert touching(world) == {frozenset(f"robot/{link}" for link in pair) for pair in allowed(robot)}


@given(st.lists(heaps(), min_size=2, max_size=4))
def test_each_link_of_a_robot_touches_each_link_of_every_other(robots: list[Robot]) -> None:
    world = World(ground=False)
    for number, robot in enumerate(robots):
        world.attach(robot, f"robot{number}", at(0.0005 * number, 0.0, 0.0))
    expected = set()
    for one, other in combinations(range(len(robots)), 2):
        fixed = [robots[number].root if robots[number].root == "world" else None for number in (one, other)]
        groups = [welded(robots[number]) for number in (one, other)]
        for first in robots[one].links:
            for second in robots[other].links:
                if not (groups[0][first] == fixed[0] and groups[1][second] == fixed[1]):
                    expected.add(frozenset((f"robot{one}/{first}", f"robot{other}/{second}")))
    found = touching(world)
    assert {pair for pair in found if len({name.partition("/")[0] for name in pair}) == 2} == expected


def test_a_hundred_robots_touch_each_other_and_the_ground_and_not_themselves() -> None:
    world = World()
    for number in range(100):
        world.attach(
            tree([ball("a", 0, True), ball("b", 1, False)], [Joint("j", "floating", "a", "b")], "a"), f"{number}"
        )
    contype, conaffinity = world.model.geom_contype, world.model.geom_conaffinity
    meet = ((contype[:, None] & conaffinity[None, :]) | (contype[None, :] & conaffinity[:, None])) != 0
    owner = world.model.body_rootid[world.model.geom_bodyid]
    own = owner[:, None] == owner[None, :]
    assert meet[~own].all()
    selves = [world.model.geom(f"{number}/b/0").id for number in range(100)]
    assert not meet[selves, selves].any()


def bush(links: int) -> Robot:
    """A robot of so many links that all collide with each other: chains of ten."""
    made = [ball(f"link{i}", i, True) for i in range(links)]
    joints = [
        Joint(f"j{i}", "continuous", f"link{i - 1}" if i % 10 else "world", f"link{i}", axis=(0.0, 0.0, 1.0))
        for i in range(links)
    ]
    return tree(made, joints)


def work(links: int) -> int:
    """How many instructions of Python it takes to let such a robot come and go beside another."""
    count = 0

    def count_instructions(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal count
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        count += event == "opcode"
        return count_instructions

    world, robot = World(), bush(links)
    world.attach(block(), "other", at(0.0, 0.0, 1.0))
    before = sys.gettrace()
    sys.settrace(count_instructions)
    try:
        world.attach(robot, "bush")
        world.detach("bush")
    finally:
        sys.settrace(before)
    return count


def test_the_work_of_a_spawn_and_a_delete_grows_with_the_number_of_links_and_no_faster() -> None:
    assert work(160) < 2.2 * work(80)


def test_what_a_model_holds_grows_with_the_number_of_links_and_no_faster() -> None:
    world = World()
    world.attach(bush(200), "bush")
    assert world.model.nexclude == world.model.npair == 0
