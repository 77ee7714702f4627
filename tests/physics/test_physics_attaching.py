"""A world to which robots are added one by one is the same, number by number, as one that is built at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_robots import arm, at, block, box_inertial, box_shape, one_joint, tree

from slidectl.description.robot import Joint, Link, Mesh, Mimic, Robot, Shape
from slidectl.errors import SlidectlError
from slidectl.physics import World
from slidectl.physics.attached_robot import AttachedRobot
from slidectl.physics.world_spec import Settings, WorldSpec

ROBOTS: dict[str, Robot] = {"arm": arm(2), "block": block(), "one": one_joint("revolute"), "more": arm(3)}


def numbers(model: Any) -> dict[str, Any]:
    """Every array of a model by name."""
    every = ((name, getattr(model, name)) for name in dir(model) if not name.startswith("_"))
    return {name: value for name, value in every if isinstance(value, np.ndarray)}


def at_once(names: list[str], gravity: float = -9.8) -> Any:
    """The model of these robots, built in one go, with the weights that they have when they are alone."""
    settings = Settings(0.001, (0.0, 0.0, gravity), True)
    bodies = [AttachedRobot(name, ROBOTS[name], at(float(place), 0.0, 1.0), {}) for place, name in enumerate(names)]
    for body in bodies:
        body.bind(WorldSpec(settings, (body,)).compile(), None)
    model = WorldSpec(settings, bodies).compile()
    for body in bodies:
        body.bind(model, None)
    return model


def grown(names: list[str], world: World | None = None) -> World:
    world = world or World()
    for place, name in enumerate(names):
        if name not in world.names():
            world.attach(ROBOTS[name], name, at(float(place), 0.0, 1.0))
    return world


def assert_same(model: Any, other: Any) -> None:
    ours, theirs = numbers(model), numbers(other)
    assert ours.keys() == theirs.keys()
    assert len(ours) > 100
    for name, array in ours.items():
        np.testing.assert_array_equal(array, theirs[name], err_msg=name)


@pytest.mark.parametrize("count", range(1, len(ROBOTS) + 1))
def test_a_world_that_grew_has_the_model_of_one_built_at_once(count: int) -> None:
    names = list(ROBOTS)[:count]
    assert_same(grown(names).model, at_once(names))


def test_a_world_grows_on_after_a_robot_has_left() -> None:
    world = grown(["arm", "block", "one"])
    world.detach("block")
    world.attach(ROBOTS["more"], "more", at(3.0, 0.0, 1.0))
    fresh = World()
    for name, place in (("arm", 0.0), ("one", 2.0), ("more", 3.0)):
        fresh.attach(ROBOTS[name], name, at(place, 0.0, 1.0))
    assert_same(world.model, fresh.model)


@pytest.fixture
def mesh(tmp_path: Path) -> Mesh:
    import trimesh  # heavy

    path = tmp_path / "box.stl"
    path.write_bytes(trimesh.creation.box((0.2, 0.2, 0.2)).export(file_type="stl"))
    return Mesh(f"file://{path}", str(path))


def gripper(mesh: Mesh) -> Robot:
    """Of all that a robot may put into a model: meshes, links kept apart, and a joint that mimics another."""
    shapes = {"palm": Shape(mesh), "left": box_shape((0.1, 0.1, 0.1)), "right": Shape(mesh)}
    links = [Link(name, box_inertial(1.0, (0.1, 0.1, 0.1)), collisions=(shape,)) for name, shape in shapes.items()]
    joints = [
        Joint("lead", "continuous", "palm", "left", axis=(1.0, 0.0, 0.0)),
        Joint("follow", "continuous", "palm", "right", axis=(1.0, 0.0, 0.0), mimic=Mimic("lead", -1.0)),
    ]
    return tree(links, joints, root="palm")


@pytest.mark.parametrize("leaving", range(6))
def test_a_world_that_a_robot_left_has_the_model_of_one_that_it_never_was_in(leaving: int, mesh: Mesh) -> None:
    robots = {"grip0": gripper(mesh), **ROBOTS, "grip1": gripper(mesh)}
    left, never = World(), World()
    for place, (name, robot) in enumerate(robots.items()):
        left.attach(robot, name, at(float(place), 0.0, 1.0))
        if place != leaving:
            never.attach(robot, name, at(float(place), 0.0, 1.0))
    left.detach(list(robots)[leaving])
    assert_same(left.model, never.model)
    assert left.model.names == never.model.names
    left.attach(gripper(mesh), list(robots)[leaving])
    never.attach(gripper(mesh), list(robots)[leaving])
    assert_same(left.model, never.model)


def test_a_robot_that_cannot_be_simulated_leaves_nothing_behind() -> None:
    world = grown(["arm", "block"])
    broken = replace(ROBOTS["one"], joints={k: replace(j, damping=-1.0) for k, j in ROBOTS["one"].joints.items()})
    with pytest.raises(SlidectlError):
        world.attach(broken, "one")
    assert_same(grown(["arm", "block", "one"], world).model, at_once(["arm", "block", "one"]))


def test_a_new_gravity_holds_for_robots_that_come_later() -> None:
    world = grown(["arm", "block"])
    world.set_gravity((0.0, 0.0, -1.6))
    assert list(grown(["arm", "block", "one"], world).model.opt.gravity) == [0.0, 0.0, -1.6]
