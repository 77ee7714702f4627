"""The joint that a controller drives, as the robot's description on the parameter server has it.

Looks for `robot_description` from the controller's namespace upwards. Reads and parses, nothing else.
"""

from __future__ import annotations

from functools import lru_cache

from slidectl.control.node_handle import NodeHandle
from slidectl.description import xml_tree
from slidectl.description.meshes import UnreadMeshes
from slidectl.description.parser import parse_tree
from slidectl.description.report import Report
from slidectl.description.robot import Joint, Robot
from slidectl.errors import Refused, UnknownName

PARAMETER = "robot_description"


def joint_on_paper(node: NodeHandle, name: str) -> Joint:
    """The joint `name` of the robot whose description is nearest above `node`.

    Raises:
        Refused: there is no description, or it is no text. BadFile: it is no URDF. UnknownName: no such joint.
    """
    where = node.search_param(PARAMETER)
    if where is None:
        raise Refused(f"no parameter {PARAMETER} in {node.namespace} or above it")
    xml = node.get_param(where)
    if not isinstance(xml, str):
        raise Refused(f"parameter {where} is no robot description: it is not a text")
    joints = _robot(xml).joints
    if name not in joints:
        raise UnknownName("joint", name, list(joints), f"in {where}")
    return joints[name]


@lru_cache(maxsize=8)
def _robot(xml: str) -> Robot:
    """Every controller of a robot asks for the same text. Where its meshes are is not in the text, nor asked for."""
    return parse_tree(xml_tree.read(xml, PARAMETER), UnreadMeshes(), Report())
