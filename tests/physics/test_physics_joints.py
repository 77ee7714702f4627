"""Joints: where they are, which way they move, what resists and stops them."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import numpy as np
import pytest
from physics_robots import at, box_inertial, one_joint, tree

from slidectl.description.robot import Joint, Limit, Link, Mimic, Pose, Robot
from slidectl.errors import SlidectlError, UnknownName
from slidectl.physics import World

SMALL = box_inertial(1.0, (0.1, 0.1, 0.1))
WEIGHTLESS = (0.0, 0.0, 0.0)


def chain(*joints: Joint) -> Robot:
    """Links `a`, `b`, `c` ... one behind the other."""
    return tree([Link(joint.child, SMALL) for joint in joints], joints)


def test_axis_and_origin_are_those_of_the_joint_frame() -> None:
    robot = chain(
        Joint("turn", "continuous", "world", "a", Pose((1.0, 0.0, 0.0), (0.0, 0.0, pi / 2)), (0.0, 0.0, 2.0)),
        Joint(
            "slide",
            "prismatic",
            "a",
            "b",
            Pose((0.0, 1.0, 0.0), (pi / 2, 0.0, 0.0)),
            (0.0, 1.0, 0.0),
            Limit(-2, 2, 1, 1),
        ),
    )
    world = World(gravity=WEIGHTLESS)
    world.attach(robot, "robot")
    world.set_joint("robot", "turn", 0.3)
    world.set_joint("robot", "slide", 0.7)
    position, _ = world.link_pose("robot", "b")
    assert position == pytest.approx((1.0 - cos(0.3), -sin(0.3), 0.7))


def test_link_poses_are_those_that_yourdfpy_computes(tmp_path) -> None:  # type: ignore[no-untyped-def]
    yourdfpy = pytest.importorskip("yourdfpy")
    origins = [
        ((0.1, 0.2, 0.3), (0.4, -0.5, 0.6)),
        ((-0.3, 0.1, 0.2), (-1.2, 0.3, 2.0)),
        ((0.0, 0.5, 0.1), (2.5, 1.0, -0.7)),
    ]
    axes = [(1.0, 2.0, 3.0), (0.0, -1.0, 0.5), (0.2, 0.3, -0.9)]
    kinds = ["continuous", "prismatic", "revolute"]
    names = ["world", "a", "b", "c"]
    joints = [
        Joint(f"j{i}", kind, parent, child, Pose(*origin), axis, Limit(-3.0, 3.0, 1.0, 1.0))  # type: ignore[arg-type]
        for i, (kind, origin, axis, (parent, child)) in enumerate(
            zip(kinds, origins, axes, pairwise(names), strict=True)
        )
    ]
    world = World()
    world.attach(chain(*joints), "robot")
    (tmp_path / "robot.urdf").write_text(_urdf(joints), encoding="utf-8")
    oracle = yourdfpy.URDF.load(str(tmp_path / "robot.urdf"), load_meshes=False)
    for joint, position in zip(joints, (0.7, -1.1, 2.0), strict=True):
        world.set_joint("robot", joint.name, position)
        oracle.update_cfg({joint.name: position})
    for link in "abc":
        expected = oracle.get_transform(link, "world")
        assert world.link_pose("robot", link)[0] == pytest.approx(tuple(expected[:3, 3]), abs=1e-12)
        x, y, z, w = world.link_pose("robot", link)[1]
        assert [1 - 2 * (y * y + z * z), 2 * (x * y - z * w)] == pytest.approx(list(expected[0, :2]), abs=1e-12)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_a_joint_is_stopped_at_its_limits(kind: str) -> None:
    world = World(gravity=WEIGHTLESS)
    world.attach(one_joint(kind, limit=Limit(-0.5, 1.5, 100.0, 100.0)), "one")
    for effort, end in ((1.0, 1.5), (-1.0, -0.5)):
        world.add_joint_force("one", "joint1", effort * (1.0 if kind == "prismatic" else 0.01))
        for _ in range(8000):
            world.step()
        world.clear_joint_forces("one", "joint1")
        assert world.joint_state("one", "joint1")[0] == pytest.approx(end, abs=0.02)


def test_a_continuous_joint_turns_for_ever() -> None:
    world = World(gravity=WEIGHTLESS)
    world.attach(one_joint("continuous", limit=Limit(0.0, 0.0, 1.0, 100.0)), "one")
    world.set_joint("one", "joint1", 0.0, velocity=10.0)
    for _ in range(2000):
        world.step()
    assert world.joint_state("one", "joint1")[0] == pytest.approx(20.0)


def test_equal_limits_lock_a_joint() -> None:
    world = World()
    world.attach(one_joint("prismatic", limit=Limit(0.2, 0.2, 100.0, 100.0)), "one")
    for _ in range(2000):
        world.step()
    assert world.joint_state("one", "joint1")[0] == pytest.approx(0.2, abs=0.01)


def test_damping_is_implicit_as_euler_has_it() -> None:
    world = World(gravity=WEIGHTLESS)
    world.attach(one_joint(mass=2.0, damping=3.0), "one")
    world.set_joint("one", "joint1", 0.0, velocity=1.0)
    world.step()
    assert world.joint_state("one", "joint1")[1] == pytest.approx(2.0 / (2.0 + 0.001 * 3.0), rel=1e-14)


def test_a_joint_without_damping_keeps_its_velocity_to_the_bit() -> None:
    world = World(gravity=WEIGHTLESS)
    world.attach(one_joint(), "one")
    world.set_joint("one", "joint1", 0.0, velocity=0.3)
    for _ in range(1000):
        world.step()
    assert world.joint_state("one", "joint1")[1] == 0.3


def test_friction_holds_a_joint_until_it_is_overcome() -> None:
    world = World(gravity=WEIGHTLESS)
    world.attach(one_joint(friction=2.0), "one")
    for effort, acceleration in ((1.5, 0.0), (3.0, 1.0)):
        world.add_joint_force("one", "joint1", effort)
        before = world.joint_state("one", "joint1")[1]
        for _ in range(1000):
            world.step()
        world.clear_joint_forces("one", "joint1")
        assert world.joint_state("one", "joint1")[1] - before == pytest.approx(acceleration, abs=0.02)


def test_a_mimic_joint_follows_its_leader() -> None:
    leader = Joint("leader", "prismatic", "world", "a", limit=Limit(-2, 2, 9, 9), damping=1.0)
    follower = Joint(
        "follower",
        "revolute",
        "a",
        "b",
        axis=(0.0, 0.0, 1.0),
        limit=Limit(-9, 9, 9, 9),
        mimic=Mimic("leader", -2.0, 0.25),
    )
    world = World(gravity=WEIGHTLESS)
    world.attach(chain(leader, follower), "robot")
    assert world.joint_state("robot", "follower")[0] == 0.25
    world.add_joint_force("robot", "leader", 1.0, duration_ns=500_000_000)
    for _ in range(1000):
        world.step()
    position = world.joint_state("robot", "leader")[0]
    assert position > 0.05
    assert world.joint_state("robot", "follower")[0] == pytest.approx(0.25 - 2.0 * position, abs=1e-3)


def test_a_mimic_of_a_mimic_starts_where_both_say() -> None:
    joints = [
        Joint("first", "continuous", "world", "a", mimic=Mimic("second", 2.0, 0.1)),
        Joint("second", "continuous", "a", "b", mimic=Mimic("third", 3.0, 0.5)),
        Joint("third", "continuous", "b", "c"),
    ]
    world = World()
    world.attach(chain(*joints), "robot")
    assert world.joint_state("robot", "first")[0] == pytest.approx(0.1 + 2.0 * 0.5)
    assert world.joint_state("robot", "second")[0] == 0.5


def test_a_planar_joint_moves_in_its_plane_only() -> None:
    robot = chain(Joint("plane", "planar", "world", "a", Pose((0.0, 0.0, 1.0)), (0.0, 0.0, 1.0)))
    world = World()
    world.attach(robot, "robot")
    world.add_wrench("robot", "a", (1.0, 2.0, 5.0), (0.0, 0.0, 0.001))
    for _ in range(1000):
        world.step()
    (x, y, z), attitude = world.link_pose("robot", "a")
    assert (x, y, z) == pytest.approx((0.5, 1.0, 1.0), abs=0.01)
    assert attitude[:2] == pytest.approx((0.0, 0.0))
    assert attitude[2] > 0.1


def test_a_floating_joint_lets_its_link_go() -> None:
    robot = chain(
        Joint("slide", "prismatic", "world", "a", axis=(1.0, 0.0, 0.0), limit=Limit(-9, 9, 9, 9)),
        Joint("loose", "floating", "a", "b", Pose((0.0, 0.0, 2.0))),
    )
    world = World(ground=False)
    world.attach(robot, "robot")
    for _ in range(1000):
        world.step()
    assert world.link_pose("robot", "b")[0] == pytest.approx((0.0, 0.0, 2.0 - 4.9), abs=0.01)


def test_only_joints_with_one_position_have_a_state() -> None:
    robot = chain(Joint("plane", "planar", "world", "a"), Joint("weld", "fixed", "a", "b"))
    world = World()
    world.attach(robot, "robot")
    for joint in ("plane", "weld"):
        with pytest.raises(UnknownName):
            world.joint_state("robot", joint)


@pytest.mark.parametrize(
    ("joint", "trouble"),
    [
        (Joint("j", "continuous", "world", "a", axis=(0.0, 0.0, 0.0)), "axis .* has no direction"),
        (Joint("j", "continuous", "world", "a", axis=(float("nan"), 0.0, 0.0)), "axis .* has no direction"),
        (Joint("j", "continuous", "world", "a", damping=-1.0), "damping -1 must be 0 or more"),
        (Joint("j", "continuous", "world", "a", friction=float("inf")), "friction inf must be 0 or more"),
        (Joint("j", "continuous", "world", "a", mimic=Mimic("k")), "it cannot mimic 'k'"),
        (Joint("j", "continuous", "world", "a", mimic=Mimic("j")), "it cannot mimic 'j'"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_impossible_joints_are_refused_by_name(joint: Joint, trouble: str) -> None:
    with pytest.raises(SlidectlError, match=f"joint 'j' of robot 'mine': {trouble}"):
        World().attach(chain(joint), "mine")


def test_looking_at_poses_and_twists_changes_nothing() -> None:
    seen, unseen = World(), World()
    for world in (seen, unseen):
        world.attach(one_joint("continuous", (0.0, 1.0, 0.0), damping=0.2), "one", at(0.0, 0.0, 1.0))
        world.set_joint("one", "joint1", 0.4, velocity=1.0)
    for _ in range(100):
        seen.link_twist("one", "cart")
        seen.link_pose("one", "cart")
        seen.step()
        unseen.step()
    assert seen.joint_state("one", "joint1") == unseen.joint_state("one", "joint1")
    assert np.array_equal(seen.data.qacc, unseen.data.qacc)


def _urdf(joints: list[Joint]) -> str:
    def numbers(values: tuple[float, ...]) -> str:
        return " ".join(repr(float(value)) for value in values)

    links = "".join(f'<link name="{name}"/>' for name in ["world", *(joint.child for joint in joints)])
    made = "".join(
        f'<joint name="{j.name}" type="{j.type}"><parent link="{j.parent}"/><child link="{j.child}"/>'
        f'<origin xyz="{numbers(j.origin.xyz)}" rpy="{numbers(j.origin.rpy)}"/>'
        f'<axis xyz="{numbers(tuple(np.array(j.axis) / np.linalg.norm(j.axis)))}"/>'
        f'<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        for j in joints
    )
    return f'<robot name="robot">{links}{made}</robot>'


def test_a_chain_that_is_too_long_is_refused_before_it_takes_minutes() -> None:
    names = ["world", *(f"link{number}" for number in range(3000))]
    links = [Link(name, box_inertial(1.0, (0.1, 0.1, 0.1))) for name in reversed(names)]
    joints = [Joint(f"to_{child}", "continuous", parent, child) for parent, child in pairwise(names)]
    with pytest.raises(SlidectlError, match=r"joint 'to_link1000' of robot 'chain': .* more than 1000 joints below"):
        World().attach(tree(links, joints), "chain")
