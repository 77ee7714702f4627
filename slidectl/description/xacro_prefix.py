"""Tags of xacro without their prefix, as files written before ROS Melodic have them: `<macro>` for `<xacro:macro>`.

xacro took both until Kinetic, and the one of Noetic is blind to the short ones. They are given their prefix here, one
notice a file. Runs nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

from slidectl.description.robot import Notice
from slidectl.description.xml_tree import Element

# By an attribute that such a tag must have, so that tags of other languages with the same names are left alone.
_NEEDS = {
    "macro": "name", "property": "name", "include": "filename", "if": "value", "unless": "value",
    "insert_block": "name",
}  # fmt: skip
PREFIX = "xacro:"


def give(root: Element, macros: set[str]) -> list[Notice]:
    """Give the tags of a file their prefixes, and add the names of such macros to `macros`, for their calls."""
    bare = list(_bare(root))
    for element in bare:
        if element.tag == "macro":
            macros.add(element.attributes["name"].removeprefix(PREFIX))
    names = sorted({element.tag for element in bare})
    for element in bare:
        element.tag = PREFIX + element.tag
    if not bare:
        return []
    shown = ", ".join(f"<{name}>" for name in names)
    text = f"{shown} without the prefix are taken as <{PREFIX}...>; xacro itself does so only until ROS Kinetic"
    return [Notice("wrong", "xacro", text, root.file, bare[0].line)]


def _bare(element: Element) -> Iterator[Element]:
    """Such tags in the order of the file. What is inside `<gazebo>` is another language, and may have the names too."""
    if _NEEDS.get(element.tag, "") in element.attributes:
        yield element
    for child in element.children if element.tag != "gazebo" else ():
        yield from _bare(child)
