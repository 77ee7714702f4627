"""The robot and the joints that a controller drives, from the description on the parameter server.

This module only reads and parses.
"""

from __future__ import annotations

from functools import lru_cache

from slidectl import names
from slidectl.control.node_handle import NodeHandle
from slidectl.description import xml_tree
from slidectl.description.mesh_files import UnreadMeshes
from slidectl.description.parser import parse_tree
from slidectl.description.report import Report
from slidectl.description.robot import Joint, Robot
from slidectl.errors import Refused, UnknownName

PARAMETER = "robot_description"


def joint_of_model(node: NodeHandle, name: str) -> Joint:
    """The joint `name` of the robot whose description is in the namespace of `node`, or in the nearest one above it.

    Raises:
        Refused: there is no description, or it is not a string. BadFile: it is not a URDF. UnknownName: no such joint.
    """
    where = node.search_param(PARAMETER)
    if where is None:
        raise Refused(f"no parameter {PARAMETER} in {node.namespace} or above it")
    return find_joint(robot_of_model(node, where), name, where)


def robot_of_model(node: NodeHandle, where: str = PARAMETER) -> Robot:
    """The robot that the parameter `where` of `node` describes.

    Raises:
        Refused: there is no description, or it is not a string. BadFile: it is not a URDF.
    """
    xml = node.get_param(where, None)
    full = names.join(node.namespace, where)
    if xml is None:
        raise Refused(f"parameter {full} is not set")
    if not isinstance(xml, str):
        raise Refused(f"parameter {full} is not a robot description: it is not a string")
    return _robot(xml)


def find_joint(robot: Robot, name: str, where: str = PARAMETER) -> Joint:
    """The joint of that name. Raises UnknownName, whose text names the parameter `where`."""
    if name not in robot.joints:
        raise UnknownName("joint", name, list(robot.joints), f"in {where}")
    return robot.joints[name]


@lru_cache(maxsize=8)
def _robot(xml: str) -> Robot:
    """Parse the text, with a cache: all controllers of a robot pass the same text. Mesh files are not read."""
    return parse_tree(xml_tree.read(xml, PARAMETER), UnreadMeshes(), Report())
