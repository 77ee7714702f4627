"""Which links of one robot never touch each other: Gazebo's rule.

Two links of a model collide only when both say `<selfCollide>true</selfCollide>` and no joint connects them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from slidectl.description.robot import Link, Robot


def pairs_apart(robot: Robot) -> Iterator[tuple[str, str]]:
    """The pairs of links with collision shapes that must be kept from colliding; welded ones never do anyway."""
    group = weld_groups(robot)
    touching = {frozenset((group[joint.parent], group[joint.child])) for joint in robot.joints.values()}
    solid = [link for link in robot.links.values() if link.collisions]
    for first, second in combinations(solid, 2):
        groups = frozenset((group[first.name], group[second.name]))
        if len(groups) == 2 and (groups in touching or not _both_collide(first, second)):
            yield first.name, second.name


def weld_groups(robot: Robot) -> dict[str, str]:
    """Link to the topmost link that it is welded to by fixed joints."""
    head: dict[str, str] = {robot.root: robot.root}
    waiting = [robot.root]
    for link in waiting:
        for joint in robot.children_of(link):
            head[joint.child] = head[link] if joint.type == "fixed" else joint.child
            waiting.append(joint.child)
    return head


def _both_collide(first: Link, second: Link) -> bool:
    return bool(first.surface.self_collide) and bool(second.surface.self_collide)
