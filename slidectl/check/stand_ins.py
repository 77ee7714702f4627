"""Elements that stand in for broken ones: they have no line, and nobody speaks of them."""

from __future__ import annotations

from collections.abc import Mapping

from slidectl.description.xml_tree import Element

STAND_IN = 0
"""The line of what nobody wrote."""
STAND_IN_NAME = "(stand-in)"
_MOMENTS = {"ixx": "1", "ixy": "0", "ixz": "0", "iyy": "1", "iyz": "0", "izz": "1"}


def replace(above: Element, part: Element, by: Element | None = None) -> None:
    """Put another in a part's place, or nothing."""
    index = next(index for index, node in enumerate(above.content) if node is part)
    above.content[index : index + 1] = [] if by is None else [by]


def inertial() -> Element:
    """That of any body."""
    return element("inertial", {}, element("mass", {"value": "1"}), element("inertia", _MOMENTS))


def element(tag: str, attributes: Mapping[str, str], *content: Element) -> Element:
    """One that nobody wrote."""
    return Element(tag, dict(attributes), "", STAND_IN, list(content))
