"""Links on fixed joints are part of their parent's body, and nobody who asks by their names can tell."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from physics_robots import arm, at, block, box_inertial, box_shape, tree

from slidectl.description.robot import Inertial, Joint, Link, Pose, Robot, Surface
from slidectl.physics import World
from slidectl.rotations import from_rpy, matrix


def weighed(choice: random.Random) -> Inertial:
    """What a link weighs: anything possible, anywhere, with products of inertia."""
    ixx, iyy, izz = (choice.uniform(0.02, 0.03) for _ in range(3))
    ixy = choice.choice([0.0, 0.002])
    return Inertial(placed(choice), choice.uniform(0.5, 2.0), (ixx, ixy, 0.0, iyy, 0.0, izz))


def placed(choice: random.Random) -> Pose:
    """Anywhere near."""
    x, y, z = (choice.uniform(-0.3, 0.3) for _ in range(3))
    roll, pitch, yaw = (choice.uniform(-3.0, 3.0) for _ in range(3))
    return Pose((x, y, z), (roll, pitch, yaw))


def skewed(seed: int) -> Robot:
    """A robot of many links, more of them fixed than moving; some weigh nothing, some feel no gravity."""
    choice = random.Random(seed)
    root = choice.choice(["world", "base"])
    links = [Link(root, weighed(choice) if root == "base" else None)]
    joints: list[Joint] = []
    for number in range(choice.randint(2, 8)):
        kind = choice.choice(["fixed", "fixed", "continuous"])
        weightless = kind == "fixed" and choice.random() < 0.4
        surface = Surface(turn_gravity_off=choice.random() < 0.3)
        links.append(Link(f"link{number}", None if weightless else weighed(choice), surface=surface))
        parent = choice.choice(links[:-1]).name
        axis = choice.choice([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
        joints.append(Joint(f"joint{number}", kind, parent, f"link{number}", placed(choice), axis, damping=0.1))
    return tree(links, joints, root)


class Separate:
    """The same robot with a body for each link, built by MuJoCo alone."""

    def __init__(self, robot: Robot, gravity: float) -> None:
        self.root = robot.root
        spec = mujoco.MjSpec()
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        spec.option.timestep, spec.option.gravity = 0.001, [0.0, 0.0, gravity]
        bodies = {robot.root: spec.worldbody.add_body(name="root")}
        if not robot.is_fixed_to_world:
            bodies[robot.root].add_freejoint()
        waiting = [robot.root]
        for link in waiting:
            self._weigh(bodies[link], robot.links[link])
            for joint in robot.children_of(link):
                body = bodies[link].add_body(name=joint.child, pos=joint.origin.xyz, quat=turn(joint.origin))
                if joint.type != "fixed":
                    made = body.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
                    made.damping = joint.damping if isinstance(made.damping, float) else [joint.damping, 0.0, 0.0]
                bodies[joint.child] = body
                waiting.append(joint.child)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    @staticmethod
    def _weigh(body: Any, link: Link) -> None:
        body.explicitinertial = True
        body.ipos = (0.0, 0.0, 0.0)  # MuJoCo gives a body without mass another one
        body.gravcomp = float(link.surface.turn_gravity_off)
        if link.inertial is not None:
            ixx, ixy, ixz, iyy, iyz, izz = link.inertial.inertia
            axes = np.array(matrix(from_rpy(link.inertial.origin.rpy)))
            tensor = axes @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ axes.T
            body.mass, body.ipos = link.inertial.mass, link.inertial.origin.xyz
            body.fullinertia = [tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]

    def body(self, link: str) -> int:
        return int(self.model.body("root" if link == self.root else link).id)

    def push(self, link: str, force: tuple[float, ...], torque: tuple[float, ...]) -> None:
        self.data.xfrc_applied[self.body(link)] = [*force, *torque]

    def place(self, link: str) -> list[float]:
        return [*self.data.xpos[self.body(link)].tolist(), *self.data.xmat[self.body(link)].tolist()]

    def twist(self, link: str) -> list[float]:
        found = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self.model, self.data, kind, self.body(link), found, 0)
        return [*found[3:].tolist(), *found[:3].tolist()]


def turn(origin: Pose) -> tuple[float, ...]:
    x, y, z, w = from_rpy(origin.rpy)
    return (w, x, y, z)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_robots_move_as_if_each_link_had_a_body_of_its_own(seed: int) -> None:
    robot = skewed(seed)
    world, separate = World(gravity=(0.0, 0.0, -9.8), ground=False), Separate(robot, -9.8)
    world.attach(robot, "robot")
    pushed, force, torque = random.Random(seed).choice(list(robot.links)), (1.0, -2.0, 3.0), (0.1, 0.2, -0.3)
    world.add_wrench("robot", pushed, force, torque)
    separate.push(pushed, force, torque)
    for _ in range(100):
        world.step()
    mujoco.mj_step(separate.model, separate.data, nstep=100)
    mujoco.mj_forward(separate.model, separate.data)
    for link in robot.links:
        place, attitude = world.link_pose("robot", link)
        linear, angular = world.link_twist("robot", link)
        turned = [part for row in matrix(attitude) for part in row]
        assert [*place, *turned] == pytest.approx(separate.place(link), abs=1e-8)
        assert [*linear, *angular] == pytest.approx(separate.twist(link), abs=1e-6)


def test_a_moving_body_and_all_that_is_fixed_to_it_is_one_body() -> None:
    world = World(ground=False)
    robot = arm(2)
    sensors = [Link(f"sensor{i}", box_inertial(0.1, (0.1, 0.1, 0.1))) for i in range(3)]
    mounts = [Joint(f"mount{i}", "fixed", "link1", f"sensor{i}", Pose((0.0, 0.0, 0.1 * i))) for i in range(3)]
    joints = [*robot.joints.values(), *mounts]
    world.attach(tree([*robot.links.values(), *sensors], joints), "robot")
    assert world.model.nbody == 1 + 3
    assert set(world.robot("robot").links) == {"world", "link0", "link1", "sensor0", "sensor1", "sensor2"}


def test_an_overlap_has_the_name_of_the_link_on_a_fixed_joint() -> None:
    world = World()
    tip = Link("tip", collisions=(box_shape((0.2, 0.2, 0.2)),))
    post = tree([Link("post"), tip], [
        Joint("foot", "fixed", "world", "post", Pose((0.0, 0.0, 1.0))),
        Joint("mount", "fixed", "post", "tip", Pose((1.0, 0.0, 0.0))),
    ])  # fmt: skip
    world.attach(post, "post")
    world.attach(block((0.2, 0.2, 0.2)), "block", at(1.0, 0.0, 1.15))
    (found,) = world.overlaps("block", 0.01)
    assert (found.link, found.robot, found.other) == ("base", "post", "tip")
    (found,) = world.overlaps("post", 0.01)
    assert (found.link, found.robot, found.other) == ("tip", "block", "base")
    assert found.depth == pytest.approx(0.05)


def test_a_link_on_a_fixed_joint_keeps_its_own_friction() -> None:
    sole = Link("sole", collisions=(box_shape((0.2, 0.2, 0.02)),), surface=Surface(mu1=0.05, mu2=0.05))
    sledge = tree([replace(block().links["base"], collisions=()), sole], [
        Joint("mount", "fixed", "base", "sole", Pose((0.0, 0.0, -0.1))),
    ], "base")  # fmt: skip
    world = World()
    world.attach(sledge, "sledge", at(0.0, 0.0, 0.11))
    for _ in range(200):
        world.step()
    world.set_pose("sledge", world.link_pose("sledge", "base"), ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    for _ in range(100):
        world.step()
    assert world.link_twist("sledge", "sole")[0][0] == pytest.approx(1.0 - 0.05 * 9.8 * 0.1, abs=0.01)


def test_shapes_that_can_touch_nothing_are_not_asked_for_contacts_until_something_comes() -> None:
    wall = tree([Link("wall", collisions=(box_shape((1.0, 1.0, 1.0)),))], [Joint("hold", "fixed", "world", "wall")])
    world = World(ground=True)
    world.attach(wall, "wall", at(0.0, 0.0, 0.5))
    assert not world.model.geom_contype.any()
    assert not world.model.body_contype.any()
    world.attach(block((0.2, 0.2, 0.2)), "block", at(0.0, 0.0, 1.1))
    assert world.model.geom_contype.all()
    for _ in range(500):
        world.step()
    assert world.link_pose("block", "base")[0][2] == pytest.approx(1.1, abs=0.01)
    world.detach("block")
    assert not world.model.geom_contype.any()
