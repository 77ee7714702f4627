"""Which links may touch each other (Gazebo's rule, as bits of MuJoCo's geoms), and which do at one moment.

Robots touch each other and the ground. Two links of one robot touch only when both say
`<selfCollide>true</selfCollide>` and no joint connects them; links that fixed joints weld together are one here.

Two geoms may touch when the contype of one and the conaffinity of the other share a bit. Each robot has a set of
`CHOSEN` of `BITS` bits as its contype, and all others as its conaffinity. Sets of one size never hold one another, so
a robot touches every other robot and never itself. The cost is the same for any number of links; pairs of bodies to
be left out, which MuJoCo also knows, grow with the square and are copied and searched in every change of the world.
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
"""There are 77 million sets."""

_EVERY = (1 << BITS) - 1
_SELF = 1 << BITS
_BASE = 1 << (BITS + 1)

Bits = tuple[int, int]
"""contype, conaffinity."""

ORDINARY: Bits = (1, 1)
"""Of a geom until `put_robots` gives it those of its robot. Not 0: a mesh that touches nothing gets no hull."""


def self_colliding(robot: Robot) -> dict[str, Bits]:
    """What links that collide with links of their own robot need besides `ORDINARY`, by link.

    MuJoCo leaves out links that a joint connects, except where the parent is welded to the world: bits do it there.
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


def put_robots(model: Any) -> None:
    """Give the geoms of each robot of a compiled model, and of the world, the bits by which robots touch.

    A robot's set follows from its place among the robots alone, so worlds with the same robots are the same. A geom
    that can touch nothing else in the world keeps none of these bits, so that no step asks for it.
    """
    roots = np.flatnonzero(model.body_rootid == np.arange(model.nbody))
    sets = np.array([_EVERY, *itertools.islice(_sets(), len(roots) - 1)], dtype=np.int32)
    robot = np.searchsorted(roots, model.body_rootid[model.geom_bodyid])
    moves = model.body_weldid[model.geom_bodyid] != 0
    colliding_robots, moving_robots = (
        np.bincount(robot, minlength=len(roots)) > 0,
        np.bincount(robot[moves], minlength=len(roots)) > 0,
    )
    # What moves touches all others, and what is fixed to the world only those that move.
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
    """The link of a robot that a geom is a collision shape of."""
    name: str = model.geom(geom).name
    return name[len(robot) + 1 :].rpartition("/")[0]


def depths(model: Any, data: Any, root: int) -> dict[tuple[int, int], float]:
    """How deep geoms of the robot with this root body are in others now, m, by the pair (own geom, other geom).

    It looks at a copy, so that the world goes on as if nobody had looked.
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
