"""Which links are one body in the physics: those that fixed joints hold together, with their frames in that body.

MuJoCo then computes one body instead of many. Nothing is built here.
"""

from __future__ import annotations

from dataclasses import dataclass

from slidectl.description.rigid_bodies import rigid_bodies
from slidectl.description.robot import Joint, Link, Robot
from slidectl.physics.frames import compose
from slidectl.physics.rotation import ORIGIN, Pose
from slidectl.rotations import from_rpy


@dataclass(slots=True)
class Lump:
    """Links that are one body. Its frame is that of its first link, the head."""

    head: str
    joint: Joint | None
    """Between the head and its parent; None at the root."""
    moves: bool
    """False for what is fixed to the world."""
    frames: dict[str, Pose]
    """By link, each behind its parent: its constant pose in the head's frame."""
    has_gravity: bool | None = None
    """None until a link of the lump weighs something."""

    def takes(self, link: Link) -> bool:
        """Whether the link can be part of this body. MuJoCo knows gravity by body, not by link."""
        has_gravity = _has_gravity(link)
        return not self.moves or None in (has_gravity, self.has_gravity) or has_gravity == self.has_gravity

    def add(self, link: Link, pose: Pose) -> None:
        """Make the link, with its pose in the head's frame, part of this body."""
        self.frames[link.name] = pose
        if self.has_gravity is None:
            self.has_gravity = _has_gravity(link)


def lumps(robot: Robot) -> list[Lump]:
    """The bodies of a robot, the root's first and each behind its parent.

    Links that a fixed joint holds are one body, unless both weigh something and only one of them feels gravity.
    """
    moves = {link: body.moves for body in rigid_bodies(robot.root, robot.joints) for link in body.links}
    made = [Lump(robot.root, None, moves[robot.root], {})]
    made[0].add(robot.links[robot.root], ORIGIN)
    lump_of = {robot.root: made[0]}
    waiting = [robot.root]
    for parent in waiting:
        for joint in robot.children_of(parent):
            link, lump, pose = robot.links[joint.child], lump_of[parent], ORIGIN
            if joint.type == "fixed" and lump.takes(link):
                pose = compose(lump.frames[parent], (joint.origin.xyz, from_rpy(joint.origin.rpy)))
            else:
                lump = Lump(joint.child, joint, moves[joint.child], {})
                made.append(lump)
            lump.add(link, pose)
            lump_of[joint.child] = lump
            waiting.append(joint.child)
    return made


def _has_gravity(link: Link) -> bool | None:
    return None if link.inertial is None else not link.surface.turn_gravity_off
