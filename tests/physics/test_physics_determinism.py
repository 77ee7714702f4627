"""The same again, to the bit: two runs, snapshots, resets, and robots that come and go elsewhere in the world."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from physics_robots import POSITION, arm, at, block, box_inertial, driven, state_of, tree

from slidectl.description.robot import Joint, Link, Mimic, Robot, Surface
from slidectl.errors import Refused
from slidectl.physics import MujocoRobotHW, World
from slidectl.rotations import Pose
from slidectl.simulation.graph import Graph

TILTED = ((0.0, 0.0, 1.0), (0.1, 0.2, 0.3, 0.9))


def weightless_arm() -> Robot:
    """An arm whose links feel no gravity."""
    robot = arm(3, damping=0.0)
    links = {name: replace(link, surface=Surface(turn_gravity_off=True)) for name, link in robot.links.items()}
    return replace(robot, links=links)


def coupled() -> Robot:
    """Two joints tied by a mimic."""
    links = [Link(name, box_inertial(1.0, (0.1, 0.2, 0.3))) for name in "ab"]
    joints = [
        Joint("joint0", "continuous", "world", "a", axis=(0.0, 1.0, 0.0)),
        Joint("joint1", "continuous", "a", "b", axis=(1.0, 0.0, 0.0), mimic=Mimic("joint0", -0.5, 0.1)),
    ]
    return tree(links, joints)


SUBJECTS: dict[str, tuple[Robot, Pose]] = {
    "an arm without damping": (arm(3, damping=0.0), at(0.0, 0.0, 2.0)),
    "an arm that falls to the ground": (arm(3), at(0.0, 0.0, 0.0)),
    "an arm with limits": (arm(3, reach=0.5), at(0.0, 0.0, 0.0)),
    "an arm with friction": (arm(3, friction=0.2), at(0.0, 0.0, 0.0)),
    "an arm without weight": (weightless_arm(), at(0.0, 0.0, 2.0)),
    "a mimic": (coupled(), at(0.0, 0.0, 2.0)),
    "a block that tumbles": (block(), TILTED),
    "a free arm": (arm(3, free=True, reach=0.8), ((0.0, 0.0, 0.5), (0.1, 0.0, 0.0, 1.0))),
}

GUESTS = [
    arm(2, free=True, reach=1.0),
    block(),
    arm(7, damping=0.0),
    arm(3, damping=0.5, friction=0.3),
    arm(12, free=True, reach=0.5),
    coupled(),
    weightless_arm(),
]


class Crowd:
    """Robots far away that come and go, by a fixed plan."""

    def __init__(self, seed: int) -> None:
        self.plan = random.Random(seed)
        self.present: list[str] = []
        self.count = 0

    def stir(self, world: World) -> None:
        """Somebody comes or goes."""
        if self.present and self.plan.random() < 0.45:
            world.detach(self.present.pop(self.plan.randrange(len(self.present))))
            return
        self.count += 1
        name = f"guest{self.count}"
        place = (10.0 + 3.0 * self.count, self.plan.random(), 0.5 + 0.3 * self.plan.random())
        world.attach(self.plan.choice(GUESTS), name, (place, (0.1, 0.2, 0.3, 0.8)))
        self.present.append(name)


def start(robot: Robot, pose: Pose) -> World:
    """The robot alone, swinging."""
    world = World()
    world.attach(robot, "subject", pose)
    for joint in world.robot("subject").joints:
        world.set_joint("subject", joint, 0.1, velocity=0.3)
    return world


def record(world: World, cycles: int, meanwhile: Callable[[int], None] = lambda _: None) -> list[bytes]:
    """The subject's state after each step; `meanwhile` is called before each."""
    states = []
    for cycle in range(cycles):
        meanwhile(cycle)
        world.step()
        states.append(state_of(world, "subject"))
    return states


@pytest.mark.parametrize("subject", SUBJECTS)
def test_two_runs_give_the_same_bits(subject: str) -> None:
    assert record(start(*SUBJECTS[subject]), 1500) == record(start(*SUBJECTS[subject]), 1500)


@pytest.mark.parametrize("subject", SUBJECTS)
def test_robots_that_come_and_go_elsewhere_change_not_one_bit(subject: str) -> None:
    alone = record(start(*SUBJECTS[subject]), 2000)
    world, crowd = start(*SUBJECTS[subject]), Crowd(seed=5)

    def stir(cycle: int) -> None:
        if cycle % 97 == 50:
            crowd.stir(world)

    among_others = record(world, 2000, stir)
    assert crowd.count > 8
    assert among_others == alone


def test_a_robot_that_comes_later_moves_as_if_it_were_the_only_one() -> None:
    robot, pose = SUBJECTS["a free arm"]
    alone = record(start(robot, pose), 1000)
    world = World()
    for number, guest in enumerate(GUESTS):
        world.attach(guest, f"guest{number}", at(10.0 + 3.0 * number, 0.0, 1.0))
    for _ in range(123):
        world.step()
    world.attach(robot, "subject", pose)
    for joint in world.robot("subject").joints:
        world.set_joint("subject", joint, 0.1, velocity=0.3)
    assert record(world, 1000) == alone


def test_steps_taken_at_once_are_the_same_as_steps_one_by_one() -> None:
    one, other = (start(*SUBJECTS["a free arm"]) for _ in range(2))
    for _ in range(777):
        one.step()
    for _ in range(7):
        for _ in range(111):
            other.step()
    assert state_of(one, "subject") == state_of(other, "subject")


@pytest.mark.parametrize("subject", SUBJECTS)
def test_a_snapshot_brings_the_same_future_again(subject: str) -> None:
    world = start(*SUBJECTS[subject])
    world.add_joint_force("subject", "joint0", 0.5, duration_ns=700_000_000) if world.robot("subject").joints else None
    for _ in range(400):
        world.step()
    snapshot = world.snapshot()
    first = record(world, 600)
    world.restore(snapshot)
    assert record(world, 600) == first


def test_a_snapshot_is_of_its_robots_only() -> None:
    world = start(*SUBJECTS["a block that tumbles"])
    snapshot = world.snapshot()
    world.attach(block(), "other", at(3.0, 0.0, 1.0))
    with pytest.raises(Refused, match="the snapshot is of other robots: subject"):
        world.restore(snapshot)
    world.detach("other")
    world.restore(snapshot)
    before = state_of(world, "subject")
    world.detach("subject")
    world.attach(block(), "subject")
    world.restore(snapshot)
    assert state_of(world, "subject") == before


@pytest.mark.parametrize("subject", SUBJECTS)
def test_a_reset_begins_exactly_as_the_first_time_and_as_often_as_one_likes(subject: str) -> None:
    world = World()
    world.attach(SUBJECTS[subject][0], "subject", SUBJECTS[subject][1])
    first = record(world, 500)
    for _ in range(3):
        world.reset()
        assert record(world, 500) == first


def test_a_reset_puts_everything_back_that_was_moved() -> None:
    world = World()
    world.attach(arm(2), "fixed", at(1.0, 0.0, 0.0))
    world.attach(block(), "free", at(0.0, 0.0, 1.0))
    world.set_pose("fixed", at(2.0, 0.0, 0.0))
    world.set_pose("free", at(0.0, 0.0, 3.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    world.set_joint("fixed", "joint0", 1.0, velocity=1.0)
    world.reset()
    assert world.link_pose("fixed", "world")[0] == (1.0, 0.0, 0.0)
    assert world.link_pose("free", "base")[0] == (0.0, 0.0, 1.0)
    assert world.link_twist("free", "base") == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert world.joint_state("fixed", "joint0") == (0.0, 0.0, 0.0)


def test_everything_about_the_robots_that_stay_is_kept_when_one_goes() -> None:
    world = World()
    for name, robot, x in (("first", arm(3, reach=1.0), 0.0), ("goes", arm(5), 5.0), ("last", arm(2, free=True), 10.0)):
        world.attach(robot, name, at(x, 0.0, 0.5))
    world.set_pose("first", at(0.5, 0.0, 0.5))
    world.data.qfrc_applied[:] = np.linspace(0.1, 1.0, world.model.nv)
    for _ in range(500):
        world.step()
    kinds = {"qpos": "qpos", "qvel": "dof", "qacc_warmstart": "dof", "qfrc_applied": "dof", "xfrc_applied": "body"}

    def kept() -> list[bytes]:
        data = world.snapshot()["data"]
        return [data[array][world.robot(name).part(kind)].tobytes() for name in stay for array, kind in kinds.items()]

    stay = ("first", "last")
    before = kept()
    world.detach("goes")
    assert kept() == before


def test_motors_are_as_deterministic_as_everything_else() -> None:
    def swinging(crowd: Crowd | None) -> list[bytes]:
        robot = driven(arm(3, free=True, reach=1.0), POSITION)
        world = World()
        body = world.attach(robot, "subject", at(0.0, 0.0, 0.06))
        hardware = MujocoRobotHW(world, body, robot, Graph().node("/subject"), "/subject")
        handles = [joint.handle for joint in hardware._joints]

        def control(cycle: int) -> None:
            if crowd and cycle % 97 == 50:
                crowd.stir(world)
            hardware.read(0, 0.001)
            for number, handle in enumerate(handles):
                handle.command = 0.3 * float(np.sin(0.01 * cycle + number))
            hardware.write(0, 0.001)

        return record(world, 600, control)

    alone = swinging(None)
    assert swinging(None) == alone
    assert swinging(Crowd(seed=7)) == alone


def test_the_guests_of_these_tests_do_something_worth_resisting() -> None:
    """The tests above would pass for guests without constraints; see that these have many."""
    world, crowd = World(), Crowd(seed=5)
    most = 0
    for _ in range(20):
        crowd.stir(world)
        for _ in range(100):
            world.step()
        most = max(most, world.data.nefc)
    assert most >= 8
