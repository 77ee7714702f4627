"""What each limit of a joint does, which joints nothing drives, and which nothing bounds.

Speaks for `<limit>`, `<safety_controller>` and `<dynamics>`, one finding an attribute, with units. Reads no XML.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from slidectl.check.findings import Findings
from slidectl.check.traced import Trace, plain
from slidectl.control.hardware_interface import (
    EffortJointInterface,
    PositionJointInterface,
    VelocityJointInterface,
)
from slidectl.description.robot import Joint, Limit, Notice, Robot, Verdict
from slidectl.description.transmissions import driving, interface_name
from slidectl.description.xml_tree import Element

_MOVING = ("revolute", "continuous", "prismatic")
_SOFT = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")
_RANGES = ("lower", "upper", "soft_lower_limit", "soft_upper_limit")

# attribute -> (unit of a joint that slides, unit of one that turns, what it does)
_MEANINGS = {
    "lower": ("m", "rad", "where the joint stops"),
    "upper": ("m", "rad", "where the joint stops"),
    "velocity": ("m/s", "rad/s", "nothing pushes the joint beyond this"),
    "effort": ("N", "N·m", "bounds what pushes the joint"),
    "damping": ("N·s/m", "N·m·s/rad", "acts against the velocity"),
    "friction": ("N", "N·m", "holds the joint at rest, and acts against its motion"),
    "soft_lower_limit": ("m", "rad", "the velocity is bounded before it"),
    "soft_upper_limit": ("m", "rad", "the velocity is bounded before it"),
    "k_position": ("1/s", "1/s", "velocity allowed per distance to the soft limit"),
    "k_velocity": ("N·s/m", "N·m·s/rad", "effort allowed per velocity left"),
}


def driven_joints(robot: Robot) -> dict[str, str]:
    """The joints that simulated hardware drives, with the name of the interface that each takes commands by."""
    found: dict[str, str] = {}
    for transmission in driving(robot.transmissions):
        joint = transmission.joints[0]
        found[joint.name] = interface_name(joint.hardware_interfaces[0])
    return found


def _looks_like_degrees(limit: Limit) -> bool:
    """Whole numbers of 15 degrees or more, and no more than some turns."""
    bounds = (limit.lower, limit.upper)
    return all(bound % 5 == 0 and abs(bound) <= 720 for bound in bounds) and max(map(abs, bounds)) >= 15


class Joints:
    """The joints of one robot; `explain` speaks for the tags of their limits."""

    def __init__(self, robot: Robot, trace: Trace) -> None:
        self.robot = robot
        self.trace = trace
        self.driven = driven_joints(robot)

    def explain(self, element: Element, owner: str) -> Iterator[Notice] | None:
        """The findings of a `<limit>`, `<safety_controller>` or `<dynamics>` of the joint `owner`; None of others."""
        joint = self.robot.joints.get(owner)
        if element.tag not in ("limit", "safety_controller", "dynamics") or joint is None:
            return None
        return self._attributes(element, joint)

    def _attributes(self, element: Element, joint: Joint) -> Iterator[Notice]:
        said = {attribute for attribute, _ in self.trace.said.get(id(element), [])}
        for name, value in plain(element).attributes.items():
            # What was said of the whole tag was said of its range.
            if name not in said and not (None in said and name in _RANGES):
                subject = f"joint {joint.name!r}/<{element.tag}>, {name}"
                verdict, effect = self._effect(joint, name)
                sliding, turning, _ = _MEANINGS[name]
                text = f"{value.strip()} {sliding if joint.type == 'prismatic' else turning}; {effect}"
                yield Notice(verdict, subject, text, element.file, element.line)

    def _effect(self, joint: Joint, name: str) -> tuple[Verdict, str]:
        """What a limit does, which is for the interface to say that the joint takes commands by."""
        interface = self.driven.get(joint.name)
        if not interface and name in ("velocity", "effort"):
            return "used", "bounds forces from outside only, as no transmission drives the joint"
        if not interface and name in _SOFT:
            return "ignored", "has no effect, as no transmission drives the joint"
        if joint.type == "continuous" and name in _SOFT and name != "k_velocity":
            return "ignored", "has no effect without position limits, which a continuous joint has not"
        if interface == PositionJointInterface.__name__ and name == "effort":
            return "used", "counts only with gains in gazebo_ros_control/pid_gains"
        if interface in (PositionJointInterface.__name__, VelocityJointInterface.__name__) and name == "k_velocity":
            return "ignored", f"only an {EffortJointInterface.__name__} has a use for it, the joint's is a {interface}"
        return "used", _MEANINGS[name][2]

    def tell(self, findings: Findings) -> None:
        """What is missing, limits and transmissions, and limits that look like degrees."""
        for joint in self.robot.joints.values():
            if joint.type in _MOVING:
                self._tell(joint, findings)

    def _tell(self, joint: Joint, findings: Findings) -> None:
        for text in self._missing(joint):
            findings.add("used", f"joint {joint.name!r}", f"note: {text}", joint.file or "", joint.line)

    def _missing(self, joint: Joint) -> Iterator[str]:
        if joint.type == "revolute" and joint.limit is not None and _looks_like_degrees(joint.limit):
            turns = (joint.limit.upper - joint.limit.lower) / math.tau
            yield f"its limits are {turns:.3g} turns apart; angles are in rad: 90 degrees are 1.5708"
        if joint.limit is None:
            yield f"a {joint.type} joint without <limit>: neither its effort nor its velocity is bounded"
        if joint.mimic is not None and joint.name in self.driven:
            yield f"it has a transmission, and it follows {joint.mimic.joint!r}: two masters"
        elif joint.name not in self.driven and joint.mimic is None:
            yield "no transmission drives it: it moves freely, controllers and joint_states do not know it"
