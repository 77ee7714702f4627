"""Takes a broken part out of a robot, or puts a sound one in its place, so that the rest can be checked.

What is broken is the parser's word.
"""

from __future__ import annotations

from slidectl.check.rehang import hang_joint, hang_link, is_second, name_joint
from slidectl.check.stand_ins import element, inertial, replace
from slidectl.description.xml_tree import Element

# Parts without which the rest of a robot can still be read.
_SPARE = ("transmission", "gazebo", "material")
_LIMITED = ("revolute", "prismatic")
_BOUNDS = {"lower": "-1e9", "upper": "1e9", "effort": "1e9", "velocity": "1e9"}


def repair(root: Element, traced: Element, culprit: Element | None) -> bool:
    """Change `root` where `traced`, a tree of the same shape, has the culprit; False when that is beyond repair."""
    place = _place(traced, culprit) if culprit is not None else None
    if not place:
        return False
    part = root.children[place[0]]
    inner = part.children[place[1]] if len(place) > 1 else None
    if part.tag == "gazebo" and inner is not None:
        replace(part, inner)
        return True
    if part.tag in _SPARE:
        replace(root, part)
        return True
    if part.tag == "link":
        return _repair_link(root, part, inner)
    return part.tag == "joint" and _repair_joint(root, part, inner)


def _repair_link(root: Element, link: Element, inner: Element | None) -> bool:
    if inner is not None:
        replace(link, inner, inertial() if inner.tag == "inertial" else None)
    elif hang_link(root, link):
        pass
    elif link.find("inertial") is None:
        link.content.append(inertial())
    else:
        return False
    return True


def _repair_joint(root: Element, joint: Element, inner: Element | None) -> bool:
    """Without an inner part it is one of several faults: the first of them, in the parser's order."""
    mimic = joint.find("mimic")
    if inner is not None:
        if inner.tag in ("parent", "child"):
            return hang_joint(root, joint)
        replace(joint, inner, element("limit", _BOUNDS) if inner.tag == "limit" else None)
    elif name_joint(joint):
        pass
    elif joint.find("limit") is None and joint.get("type") in _LIMITED:
        joint.content.append(element("limit", _BOUNDS))
    elif is_second(root, joint):
        joint.attributes["name"] = f"{joint.get('name')} (again)"
    elif hang_joint(root, joint):
        pass
    elif mimic is not None:
        replace(joint, mimic)
    else:
        return False
    return True


def _place(above: Element, wanted: Element) -> list[int] | None:
    """Which child of which child an element is."""
    for index, child in enumerate(above.children):
        below = [] if child is wanted else _place(child, wanted)
        if below is not None:
            return [index, *below]
    return None
