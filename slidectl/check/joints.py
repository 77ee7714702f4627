"""What each limit of a joint does, which joints nothing drives, and which nothing bounds.

Speaks for `<limit>`, `<safety_controller>` and `<dynamics>`, one finding an attribute, with units. Reads no XML.
"""

from __future__ import annotations

from collections.abc import Iterator

from slidectl.check.findings import Findings
from slidectl.check.traced import Trace, plain
from slidectl.description.robot import Joint, Notice, Robot
from slidectl.description.xml_tree import Element

_MOVING = ("revolute", "continuous", "prismatic")
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
    """The joints that simulated hardware drives, with the interface that each takes commands by."""
    found: dict[str, str] = {}
    for transmission in robot.transmissions:
        if len(transmission.joints) == 1:
            joint = transmission.joints[0]
            found[joint.name] = "hardware_interface/" + joint.hardware_interfaces[0].rpartition("/")[2]
    return found


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
                yield Notice("used", subject, self._meaning(joint, name, value), element.file, element.line)

    def _meaning(self, joint: Joint, name: str, value: str) -> str:
        sliding, turning, effect = _MEANINGS[name]
        if name in ("velocity", "effort") and joint.name not in self.driven:
            effect = "bounds forces from outside only, as no transmission drives the joint"
        return f"{value.strip()} {sliding if joint.type == 'prismatic' else turning}; {effect}"

    def tell(self, findings: Findings) -> None:
        """What is missing: limits, transmissions."""
        for joint in self.robot.joints.values():
            if joint.type in _MOVING:
                self._tell(joint, findings)

    def _tell(self, joint: Joint, findings: Findings) -> None:
        for text in self._missing(joint):
            findings.add("used", f"joint {joint.name!r}", f"note: {text}", joint.file or "", joint.line)

    def _missing(self, joint: Joint) -> Iterator[str]:
        if joint.limit is None:
            yield f"a {joint.type} joint without <limit>: neither its effort nor its velocity is bounded"
        if joint.mimic is not None and joint.name in self.driven:
            yield f"it has a transmission, and it follows {joint.mimic.joint!r}: two masters"
        elif joint.name not in self.driven and joint.mimic is None:
            yield "no transmission drives it: it moves freely, controllers and joint_states do not know it"
