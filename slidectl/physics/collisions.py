"""Rules for which links may collide (as in Gazebo, as bits of MuJoCo's geoms), and the present collisions.

Robots collide with each other and with the ground. Two links of one robot collide only when both have
`<selfCollide>true</selfCollide>` and no joint connects them. Links connected by fixed joints count as one.

Two geoms may collide when the contype of one and the conaffinity of the other share a bit. Each robot has a set of
`CHOSEN` of `BITS` bits as its contype, and the other bits as its conaffinity. A set never contains another set of the
same size, so a robot collides with every other robot and never with itself. The cost does not depend on the number of
links. MuJoCo's lists of excluded pairs grow with the square, and every change of the world copies and searches them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from slidectl.description.rigid_bodies import rigid_bodies
from slidectl.description.robot import Robot

BITS = 29
CHOSEN = 14
"""Bits in a set. There are 77 million sets."""

_EVERY = (1 << BITS) - 1
_SELF = 1 << BITS
_BASE = 1 << (BITS + 1)

Bits = tuple[int, int]
"""contype, conaffinity."""

ORDINARY: Bits = (1, 1)
"""The bits of a geom until `set_collision_bits`. Not 0: MuJoCo makes no hull of a mesh without bits."""


def self_colliding(robot: Robot) -> dict[str, Bits]:
    """The bits of links that collide with links of their own robot, by link.

    MuJoCo excludes links that a joint connects, except when the parent is fixed to the world; then bits exclude them.
    """
    links = [link.name for link in robot.links.values() if link.surface.self_collide]
    if not links:
        return {}
    group = {link: body.head for body in rigid_bodies(robot.root, robot.joints) for link in body.links}
    base = robot.root if robot.is_fixed_to_world else None
    on_base = {joint.child for joint in robot.joints.values() if group[joint.parent] == base}
    bits: dict[str, Bits] = {}
    for link in links:
        if group[link] == base:
            bits[link] = (_BASE, 0)
        elif group[link] in on_base:
            bits[link] = (_SELF, _SELF)
        else:
            bits[link] = (_SELF, _SELF | _BASE)
    return bits


def set_collision_bits(model: Any) -> None:
    """Set the bits of all geoms of a compiled model so that robots collide with each other and with the ground.

    A robot's set depends only on its place among the robots, so worlds with the same robots are equal. A geom that can
    collide with nothing else in the world gets none of these bits, so that steps do not check it.
    """
    roots = np.flatnonzero(model.body_rootid == np.arange(model.nbody))
    sets = np.array([_EVERY, *itertools.islice(_sets(), len(roots) - 1)], dtype=np.int32)
    robot = np.searchsorted(roots, model.body_rootid[model.geom_bodyid])
    moves = model.body_weldid[model.geom_bodyid] != 0
    colliding_robots, moving_robots = (
        np.bincount(robot, minlength=len(roots)) > 0,
        np.bincount(robot[moves], minlength=len(roots)) > 0,
    )
    # Moving geoms collide with all others, geoms that are fixed to the world only with moving ones.
    partners = np.where(
        moves, colliding_robots.sum() - colliding_robots[robot], moving_robots.sum() - moving_robots[robot]
    )
    chosen = np.where(partners > 0, sets[robot], 0)
    others = np.where(partners > 0, np.where(robot == 0, _EVERY, _EVERY & ~sets[robot]), 0)
    own = _SELF | _BASE
    model.geom_contype[:] = model.geom_contype & own | chosen
    model.geom_conaffinity[:] = model.geom_conaffinity & own | others
    model.body_contype[:] = model.body_conaffinity[:] = 0
    np.bitwise_or.at(model.body_contype, model.geom_bodyid, model.geom_contype)
    np.bitwise_or.at(model.body_conaffinity, model.geom_bodyid, model.geom_conaffinity)


def _sets() -> Iterator[int]:
    """The numbers with `CHOSEN` of `BITS` bits set, ascending (Gosper's hack)."""
    bits = (1 << CHOSEN) - 1
    while bits <= _EVERY:
        yield bits
        lowest = bits & -bits
        carried = bits + lowest
        bits = carried | ((bits ^ carried) >> 2) // lowest


def link_of(model: Any, geom: int, robot: str) -> str:
    """The link of a robot to which a geom belongs."""
    name: str = model.geom(geom).name
    return name[len(robot) + 1 :].rpartition("/")[0]


def depths(model: Any, data: Any, root: int) -> dict[tuple[int, int], float]:
    """The present penetration depths of a robot's geoms in others, m, by the pair (own geom, other geom).

    `root` is the robot's root body. It is computed in a copy, so that the world does not change.
    """
    copy = mujoco.MjData(model)
    copy.qpos[:] = data.qpos
    mujoco.mj_kinematics(model, copy)
    mujoco.mj_collision(model, copy)
    geoms = copy.contact.geom
    own = model.body_rootid[model.geom_bodyid[geoms]] == root
    found: dict[tuple[int, int], float] = {}
    for (first, second), (is_first, is_second), gap in zip(geoms.tolist(), own, copy.contact.dist, strict=True):
        if is_first != is_second:
            pair = (first, second) if is_first else (second, first)
            found[pair] = max(found.get(pair, 0.0), -float(gap))
    return found
