"""Fixing a robot to the world, or freeing it: a root link called `world` put in or taken away.

Works on URDF text and keeps the note of where its elements were written.
"""

from __future__ import annotations

from slidectl.description import values, xml_tree, xml_writer
from slidectl.description.rigid_bodies import WORLD
from slidectl.description.xml_tree import Element
from slidectl.errors import listing

_JOINT = "world_to_root"


def with_root_fixed(xml: str, file: str = "robot_description") -> str:
    """The robot with its root fixed to a link called `world`; one that is so already stays as it is.

    Raises:
        BadFile: broken XML, no single root, or a link called `world` that is not the root.
    """
    robot = xml_tree.read(xml, file)
    root = _root_name(robot)
    if root == WORLD:
        return xml
    if WORLD in _link_names(robot):
        raise robot.error(f"cannot fix the robot: a link {WORLD!r} is there and is not the root")
    robot.content.extend(_fixture(robot, root))
    return xml_writer.write(robot)[0]


def with_root_free(xml: str, file: str = "robot_description") -> str:
    """The robot without its root link `world` and the fixed joint below it; a free one stays as it is.

    The link below takes the root's place, so the joint's origin is gone: the pose of spawning says where it stands.

    Raises:
        BadFile: broken XML, no single root, or a `world` that holds the robot by anything but one fixed joint.
    """
    robot = xml_tree.read(xml, file)
    if _root_name(robot) != WORLD:
        return xml
    below = [joint for joint in robot.find_all("joint") if _end(joint, "parent") == WORLD]
    if len(below) != 1 or below[0].get("type") != "fixed":
        names = listing([joint.get("name") or "?" for joint in below])
        raise robot.error(
            f"cannot free the robot: its link {WORLD!r} must hold it by one fixed joint alone; joints there: {names}"
        )
    robot.content[:] = [node for node in robot.content if not _is_link(node, WORLD) and node is not below[0]]
    return xml_writer.write(robot)[0]


def _is_link(node: Element | str, name: str) -> bool:
    return isinstance(node, Element) and node.tag == "link" and node.get("name") == name


def _link_names(robot: Element) -> list[str]:
    return [values.required(link, "name", "link") for link in robot.find_all("link")]


def _end(joint: Element, tag: str) -> str | None:
    end = joint.find(tag)
    return end.get("link") if end is not None else None


def _root_name(robot: Element) -> str:
    children = {_end(joint, "child") for joint in robot.find_all("joint")}
    roots = [name for name in _link_names(robot) if name not in children]
    if len(roots) != 1:
        raise robot.error(f"the robot needs one root link; it has: {listing(roots)}")
    return roots[0]


def _fixture(robot: Element, root: str) -> list[Element]:
    """The link `world` and the joint to the root, placed where `<robot>` is."""

    def element(tag: str, attributes: dict[str, str], *content: Element) -> Element:
        return Element(tag, attributes, robot.file, robot.line, list(content))

    taken = {joint.get("name") for joint in robot.find_all("joint")}
    name = next(name for name in (_JOINT + "_" * count for count in range(len(taken) + 1)) if name not in taken)
    parent, child = element("parent", {"link": WORLD}), element("child", {"link": root})
    return [element("link", {"name": WORLD}), element("joint", {"name": name, "type": "fixed"}, parent, child)]
