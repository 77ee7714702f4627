"""Small URDF texts for the tests of the description room."""

from __future__ import annotations

from urdf_parts import INERTIAL, LIMIT

TRANSMISSION = """<transmission name="tran1">
  <type>transmission_interface/SimpleTransmission</type>
  <joint name="slide"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
  <actuator name="motor1"><mechanicalReduction>1</mechanicalReduction></actuator>
</transmission>"""


def link(name: str, inside: str = INERTIAL) -> str:
    """A link; with mass unless told otherwise."""
    return f'<link name="{name}">{inside}</link>'


def joint(
    name: str = "slide", kind: str = "prismatic", parent: str = "world", child: str = "cart", inside: str = LIMIT
) -> str:
    """A joint with its limits."""
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def robot(*parts: str) -> str:
    """A robot of these parts, each on a line of its own: the first in line 2."""
    return "\n".join(['<robot name="bot">', *parts, "</robot>"])


def cart(*more: str, joint_inside: str = LIMIT, link_inside: str = INERTIAL) -> str:
    """World, a cart, the joint between them in line 4, and whatever follows from line 5 on."""
    return robot('<link name="world"/>', link("cart", link_inside), joint(inside=joint_inside), *more)
