"""How links and joints hang together: one root, no cycle, nothing unknown, and no chain that is too long.

Works on the plain data of robot.py; places in errors come from the elements that it is given. Linear in the size.
"""

from __future__ import annotations

from collections.abc import Mapping

from slidectl.description.robot import Joint, Link
from slidectl.description.values import unknown
from slidectl.description.xml_tree import Element
from slidectl.errors import listing

DEEPEST = 1000
"""Joints between the root and a link. MuJoCo takes a few more, and looks at a longer chain for minutes to refuse it."""
TOO_DEEP = f"its child hangs more than {DEEPEST} joints below the root"

Elements = Mapping[str, Element]


class Structure:
    """The links and joints of one robot, and the elements that they were read from."""

    def __init__(
        self, links: Mapping[str, Link], joints: Mapping[str, Joint], link_at: Elements, joint_at: Elements
    ) -> None:
        self.links = links
        self.joints = joints
        self.link_at = link_at
        self.joint_at = joint_at
        self.above: dict[str, Joint] = {}

    def check(self, robot: Element) -> str:
        """The name of the root link.

        Raises:
            BadFile: the links form no tree, a mimic joint follows nobody, or a chain of joints is too long.
        """
        if not self.links:
            raise robot.error("the robot has no link")
        for joint in self.joints.values():
            self._take(joint)
        root = self._root()
        for joint in self.joints.values():
            self._check_mimic(joint)
        self._check_depth(root)
        return root

    def _take(self, joint: Joint) -> None:
        """Put a joint into the tree."""
        element = self.joint_at[joint.name]
        for role, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in self.links:
                raise unknown(element, f"joint {joint.name!r}: {role}", "link", name, self.links)
        first = self.above.setdefault(joint.child, joint)
        if first is not joint:
            raise element.error(f"link {joint.child!r} is the child of two joints, {first.name!r} and {joint.name!r}")

    def _root(self) -> str:
        clear: set[str] = set()
        for name in self.links:
            self._check_way_up(name, clear)
        roots = [name for name in self.links if name not in self.above]
        if len(roots) > 1:
            raise self.link_at[roots[1]].error(
                f"the robot has more than one root link: {listing(roots)}",
                "join them by joints; every link but one is the child of a joint",
            )
        return roots[0]

    def _check_way_up(self, link: str, clear: set[str]) -> None:
        """From `link` upwards there is an end. `clear` holds the links of which that is known."""
        way: dict[str, Joint] = {}
        while link in self.above and link not in clear:
            if link in way:
                circle = [link, *reversed(list(way)[list(way).index(link) + 1 :]), link]
                raise self.joint_at[way[link].name].error(f"links go round in a circle: {' - '.join(circle)}")
            way[link] = self.above[link]
            link = self.above[link].parent
        clear.update(way)

    def _check_mimic(self, joint: Joint) -> None:
        if joint.mimic is None:
            return
        element = self.joint_at[joint.name]
        master = self.joints.get(joint.mimic.joint)
        if master is None:
            raise unknown(element, f"joint {joint.name!r}: <mimic>", "joint", joint.mimic.joint, self.joints)
        if master.type in ("fixed", "floating", "planar"):
            raise element.error(f"joint {joint.name!r} cannot mimic {master.name!r}, which is {master.type}")
        self._check_mimic_ends(joint)

    def _check_mimic_ends(self, joint: Joint) -> None:
        seen = [joint.name]
        master = joint
        while master.mimic is not None and master.mimic.joint in self.joints:
            master = self.joints[master.mimic.joint]
            if master.name in seen:
                circle = " - ".join([*seen, master.name])
                raise self.joint_at[joint.name].error(f"mimic joints go round in a circle: {circle}")
            seen.append(master.name)

    def _check_depth(self, root: str) -> None:
        joint = too_deep(root, self.joints)
        if joint is not None:
            raise self.joint_at[joint.name].error(f"joint {joint.name!r}: {TOO_DEEP}")


def too_deep(root: str, joints: Mapping[str, Joint]) -> Joint | None:
    """A joint whose child hangs too far below the root for the simulation, or None."""
    below: dict[str, list[Joint]] = {}
    for joint in joints.values():
        below.setdefault(joint.parent, []).append(joint)
    level = [root]
    for _ in range(DEEPEST):
        level = [joint.child for link in level for joint in below.get(link, ())]
    return next((joint for link in level for joint in below.get(link, ())), None)
