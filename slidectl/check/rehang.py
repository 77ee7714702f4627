"""Hangs links and joints anew where they form no tree, so that the rest of the robot can be checked.

What is amiss is looked for in the order in which the parser does, so that each change answers the fault that it named.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

from slidectl.check.stand_ins import STAND_IN_NAME, element, inertial, replace
from slidectl.description.robot import JointType
from slidectl.description.xml_tree import Element
from slidectl.errors import closest

TYPES: tuple[str, ...] = get_args(JointType)


def hang_link(root: Element, link: Element) -> bool:
    """Take out a link without a name of its own, or fix one that hangs nowhere to the first; False for other faults."""
    tree = _Tree(root)
    name = link.get("name")
    if name is None or tree.links[name] is not link:
        replace(root, link)
        return True
    first, *others = tree.roots or [name]
    if name not in others:
        return False
    ends = element("parent", {"link": first}), element("child", {"link": name})
    root.content.append(element("joint", {"name": f"{STAND_IN_NAME} of {name}", "type": "fixed"}, *ends))
    return True


def name_joint(joint: Element) -> bool:
    """Give a joint a name and a type, if these are amiss; False when they are not."""
    kind = joint.get("type")
    if not joint.get("name"):
        joint.attributes["name"] = STAND_IN_NAME
    elif kind not in TYPES:
        joint.attributes["type"] = closest(kind or "", TYPES) or "fixed"
    else:
        return False
    return True


def hang_joint(root: Element, joint: Element) -> bool:
    """Give a joint a name and ends with which there is a tree; False when it is not that which is amiss."""
    tree = _Tree(root)
    parent, child = end(joint, "parent"), end(joint, "child")
    if parent is None or parent not in tree.links:
        _put_end(joint, "parent", closest(parent or "", tree.not_below(child)) or tree.other_root(child))
    elif child is None or child not in tree.links or tree.above[child] is not joint:
        _put_end(joint, "child", tree.loose_link(child or "", parent) or _add_link(root))
    elif child in tree.way_up(parent):
        other = tree.other_root(child)
        if other is None:
            replace(root, joint)
        else:
            _put_end(joint, "parent", other)
    else:
        return False
    return True


def is_second(root: Element, joint: Element) -> bool:
    """True for a joint whose name another one has already."""
    first = next(other for other in root.find_all("joint") if other.get("name") == joint.get("name"))
    return first is not joint


def end(joint: Element, tag: str) -> str | None:
    """The link at an end of a joint, as it is written."""
    found = joint.find(tag)
    return None if found is None else found.get("link")


def _put_end(joint: Element, tag: str, link: str | None) -> None:
    written = joint.find(tag)
    new = element(tag, {"link": link or STAND_IN_NAME})
    if written is None:
        joint.content.append(new)
    else:
        replace(joint, written, new)


def _add_link(root: Element) -> str:
    name = f"{STAND_IN_NAME} {len(root.content)}"
    root.content.append(element("link", {"name": name}, inertial()))
    return name


class _Tree:
    """What hangs on what; of two that claim a name or a link the first counts."""

    def __init__(self, root: Element) -> None:
        self.links: dict[str, Element] = {}
        for link in root.find_all("link"):
            self.links.setdefault(link.get("name") or "", link)
        self.above: dict[str, Element] = {}
        for joint in root.find_all("joint"):
            self.above.setdefault(end(joint, "child") or "", joint)
        self.roots = [name for name in self.links if name not in self.above]

    def way_up(self, link: str | None) -> Iterator[str]:
        """The link, the one above it and so on: to a root, or once around."""
        seen: set[str] = set()
        while link is not None and link not in seen:
            seen.add(link)
            yield link
            link = end(self.above[link], "parent") if link in self.above else None

    def not_below(self, link: str | None) -> list[str]:
        """The links that do not hang on this one."""
        return [name for name in self.links if link not in set(self.way_up(name))]

    def other_root(self, link: str | None) -> str | None:
        """The first root that is not above this link, else the first of all that do not hang on it."""
        free = self.not_below(link)
        return next((name for name in free if name in self.roots), free[0] if free else None)

    def loose_link(self, wanted: str, parent: str) -> str | None:
        """A link that hangs nowhere and may hang here: the one of the likest name, else the first."""
        taken = set(self.way_up(parent))
        loose = [name for name in self.roots if name not in taken]
        return closest(wanted, loose) or next(iter(loose), None)
