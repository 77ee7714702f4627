"""Friction: no value of it adds energy or lets a body sink or creep; between two bodies the smaller one counts."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from physics_robots import at, block, box_inertial, tree

from slidectl.description import parse
from slidectl.description.robot import Cylinder, Geometry, Link, Robot, Shape, Sphere, Surface
from slidectl.physics import World
from slidectl.rotations import matrix, normalized

Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
EVERY = (0.0, 1e-300, 1e-10, 1e-5, 1e-3, 0.1, 1.0, 10.0, 100.0, 1e5, 1e14, 1e300, math.inf)
SLOPE = (3.0, 0.0, -9.3)
"""m/s², gravity on a slope of 18 degrees."""

frictions = st.one_of(st.none(), st.sampled_from(EVERY), st.floats(0.0, 2.0), st.floats(0.0, math.inf))
lengths = st.floats(0.01, 10.0)
attitudes = st.one_of(
    st.just(UPRIGHT),
    st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.1).map(normalized),
)


def rise(robot: Robot, height: float, attitude: Quaternion, timestep: float) -> float:
    """How far the robot's root gets above its start within two seconds, m."""
    world = World(timestep)
    world.attach(robot, "robot", ((0.0, 0.0, height), attitude))
    highest = -math.inf
    for _ in range(min(2000, math.ceil(2.0 / timestep))):
        world.step()
        highest = max(highest, world.link_pose("robot", "base")[0][2])
    assert math.isfinite(highest)
    return highest - height


def half_height(size: tuple[float, float, float], attitude: Quaternion) -> float:
    """How far a box of this size reaches below its middle."""
    return sum(abs(part) * edge / 2 for part, edge in zip(matrix(attitude)[2], size, strict=True))


def rests(friction: float, gravity: tuple[float, float, float]) -> tuple[float, float]:
    """How far a block has moved sideways and sunk from its first to its eleventh second, m."""
    world = World(gravity=gravity)
    world.attach(block((0.4, 0.4, 0.1), 5.0, Surface(mu1=friction)), "block", at(0.0, 0.0, 0.05))
    for _ in range(1000):
        world.step()
    before = world.link_pose("block", "base")[0]
    for _ in range(10_000):
        world.step()
    after = world.link_pose("block", "base")[0]
    return math.hypot(after[0] - before[0], after[1] - before[1]), 0.05 - after[2]


@given(
    mu1=frictions, mu2=frictions, mass=st.floats(1e-4, 1e4), size=st.tuples(lengths, lengths, lengths),
    gap=st.one_of(st.just(0.0), st.floats(0.0, 10.0)), attitude=attitudes, timestep=st.floats(2e-4, 0.02),
)  # fmt: skip
@example(mu1=0.0, mu2=0.0, mass=10.0, size=(0.4, 0.4, 0.2), gap=0.01, attitude=UPRIGHT, timestep=0.001)
@example(mu1=0.0, mu2=1.0, mass=0.001, size=(0.4, 0.4, 0.2), gap=0.01, attitude=UPRIGHT, timestep=0.001)
@example(mu1=0.0, mu2=0.0, mass=1.0, size=(0.2, 0.3, 0.4), gap=0.3, attitude=(0.1, 0.2, 0.3, 0.9), timestep=0.001)
@example(mu1=1e-5, mu2=None, mass=1.0, size=(0.2, 0.3, 0.4), gap=0.3, attitude=UPRIGHT, timestep=0.01)
def test_no_friction_throws_a_dropped_box_above_where_it_was(
    mu1: float | None,
    mu2: float | None,
    mass: float,
    size: tuple[float, float, float],
    gap: float,
    attitude: Quaternion,
    timestep: float,
) -> None:
    height = half_height(size, normalized(attitude)) + gap
    robot = block(size, mass, Surface(mu1=mu1, mu2=mu2))
    assert rise(robot, height, normalized(attitude), timestep) <= 1e-9


@pytest.mark.parametrize("geometry", [Sphere(0.1), Cylinder(0.1, 0.3)], ids=str)
@pytest.mark.parametrize("friction", EVERY)
def test_neither_does_it_throw_round_things(geometry: Geometry, friction: float) -> None:
    shape = Shape(geometry)
    link = Link("base", box_inertial(1.0, (0.2, 0.2, 0.2)), collisions=(shape,), surface=Surface(mu1=friction))
    robot = tree([link], [], "base")
    assert rise(robot, 0.3, normalized((0.3, 0.1, 0.0, 0.9)), 0.001) <= 0.0


@pytest.mark.parametrize("friction", [2.0, *EVERY[7:]])
def test_a_box_with_friction_enough_stays_on_a_slope_and_does_not_sink(friction: float) -> None:
    moved, sunk = rests(friction, SLOPE)
    assert moved < 1e-5
    assert abs(sunk) < 1e-3


@pytest.mark.parametrize("friction", EVERY)
def test_a_box_that_nobody_pushes_stays_where_it_is(friction: float) -> None:
    moved, sunk = rests(friction, (0.0, 0.0, -9.8))
    assert moved < 1e-9
    assert abs(sunk) < 1e-3


@pytest.mark.parametrize("surface", [Surface(mu1=3.0, mu2=0.1), Surface(mu1=0.1, mu2=3.0), Surface(mu2=0.1)], ids=str)
def test_of_two_coefficients_of_a_link_the_smaller_one_counts(surface: Surface) -> None:
    world = World(gravity=(3.0, 0.0, -9.81))
    world.attach(block((0.4, 0.4, 0.1), 5.0, surface), "block", at(0.0, 0.0, 0.05))
    for _ in range(1000):
        world.step()
    assert world.link_pose("block", "base")[0][0] == pytest.approx((3.0 - 0.981) / 2.0, rel=0.1)


def test_without_friction_a_box_slides_as_if_nothing_held_it() -> None:
    world = World(gravity=SLOPE)
    world.attach(block((0.4, 0.4, 0.1), 5.0, Surface(mu1=0.0)), "block", at(0.0, 0.0, 0.05))
    for _ in range(1000):
        world.step()
    assert world.link_pose("block", "base")[0][0] == pytest.approx(0.5 * 3.0, rel=1e-2)


@pytest.mark.parametrize(("below", "above"), [(1.0, 0.0), (0.0, 1.0), (math.inf, 0.05), (0.05, 1e14)])
def test_between_two_robots_the_smaller_friction_counts(below: float, above: float) -> None:
    world = World(gravity=SLOPE)
    plate = block((20.0, 1.0, 0.1), 1000.0, Surface(mu1=below))
    link = plate.links["base"]
    world.attach(tree([Link("world", None, (), link.collisions, link.surface)], []), "plate", at(0.0, 0.0, 0.05))
    world.attach(block((0.4, 0.4, 0.1), 5.0, Surface(mu1=above)), "box", at(0.0, 0.0, 0.15))
    for _ in range(1000):
        world.step()
    travelled = world.link_pose("box", "base")[0][0]
    assert travelled == pytest.approx(0.5 * (3.0 - min(below, above) * 9.3), rel=0.02)


@pytest.mark.parametrize("text", ["Inf", "inf", "infinity", "+INF", "1e999", "-1", "-inf", "1e14"])
def test_the_largest_friction_can_be_written_in_many_ways(text: str) -> None:
    robot = parse(
        '<robot name="box"><link name="base"><inertial><mass value="5"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><geometry><box size="0.4 0.4 0.1"/></geometry></collision></link>'
        f'<gazebo reference="base"><mu1>{text}</mu1><mu2>{text}</mu2></gazebo></robot>'
    )
    world = World(gravity=(20.0, 0.0, -9.8))
    world.attach(robot, "box", at(0.0, 0.0, 0.05))
    for _ in range(1000):
        world.step()
    assert world.link_pose("box", "base")[0][0] < 1e-3, "5 m is how far it would slide with a friction of 1"
