"""Takes a broken part out of a robot, or puts a sound one in its place, so that the rest can be checked.

What is broken is the parser's word. What stands in for it has no line, and nobody speaks of it.
"""

from __future__ import annotations

from collections.abc import Mapping

from slidectl.description.xml_tree import Element

STAND_IN = 0
"""The line of what nobody wrote."""

# Parts without which the rest of a robot can still be read.
_SPARE = ("transmission", "gazebo", "material")
_LIMITED = ("revolute", "prismatic")
_BOUNDS = {"lower": "-1e9", "upper": "1e9", "effort": "1e9", "velocity": "1e9"}
_MOMENTS = {"ixx": "1", "ixy": "0", "ixz": "0", "iyy": "1", "iyz": "0", "izz": "1"}


def repair(root: Element, traced: Element, culprit: Element | None) -> bool:
    """Change `root` where `traced`, a tree of the same shape, has the culprit; False when that is beyond repair."""
    place = _place(traced, culprit) if culprit is not None else None
    if not place:
        return False
    part = root.children[place[0]]
    if part.tag in _SPARE:
        _replace(root, part)
        return True
    inner = part.children[place[1]] if len(place) > 1 else None
    if part.tag == "link":
        return _repair_link(part, inner)
    return part.tag == "joint" and _repair_joint(part, inner)


def _repair_link(link: Element, inner: Element | None) -> bool:
    if inner is not None:
        _replace(link, inner, _inertial() if inner.tag == "inertial" else None)
    elif link.find("inertial") is None:
        link.content.append(_inertial())
    else:
        return False
    return True


def _repair_joint(joint: Element, inner: Element | None) -> bool:
    mimic = joint.find("mimic")
    if inner is not None and inner.tag not in ("parent", "child"):
        _replace(joint, inner, _element("limit", _BOUNDS) if inner.tag == "limit" else None)
    elif inner is None and joint.find("limit") is None and joint.get("type") in _LIMITED:
        joint.content.append(_element("limit", _BOUNDS))
    elif inner is None and mimic is not None:
        _replace(joint, mimic)
    else:
        return False
    return True


def _replace(above: Element, element: Element, by: Element | None = None) -> None:
    index = next(index for index, node in enumerate(above.content) if node is element)
    above.content[index : index + 1] = [] if by is None else [by]


def _inertial() -> Element:
    return _element("inertial", {}, _element("mass", {"value": "1"}), _element("inertia", _MOMENTS))


def _element(tag: str, attributes: Mapping[str, str], *content: Element) -> Element:
    return Element(tag, dict(attributes), "", STAND_IN, list(content))


def _place(element: Element, wanted: Element) -> list[int] | None:
    """Which child of which child an element is."""
    for index, child in enumerate(element.children):
        below = [] if child is wanted else _place(child, wanted)
        if below is not None:
            return [index, *below]
    return None
