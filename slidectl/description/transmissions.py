"""Reads `<transmission>` by the rules of ros_control's TransmissionParser.

What that parser drops with an error is dropped here with a notice. Without real transmissions only the interface of
the joint counts, and the rest is reported. The computation is in control/transmission_interface.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from slidectl.description import element_values, interfaces
from slidectl.description.element_values import child_text
from slidectl.description.report import Report
from slidectl.description.robot import MOVING, Joint, TransmissionActuator, TransmissionInfo, TransmissionJoint
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile

_TO_ADD = f"add <hardwareInterface>{interfaces.EFFORT.written}</hardwareInterface>"
_JOINT_CHILDREN = {"role", "hardwareInterface", "offset", "mechanicalReduction"}
_ACTUATOR_CHILDREN = {
    "role", "hardwareInterface", "mechanicalReduction", "limit", "rotorInertia", "drake:rotor_inertia",
}  # fmt: skip
_IF_REAL = "counts only with real transmissions: slidectl spawn --transmissions real"


def has_position_command(joint: TransmissionJoint) -> bool:
    """True when a transmission's joint takes position commands."""
    interface = interfaces.find(joint.hardware_interfaces[0])
    return interface is not None and interface.quantity == "position"


def driving(transmissions: Iterable[TransmissionInfo]) -> list[tuple[TransmissionInfo, TransmissionJoint]]:
    """The transmissions that drive joints of simulated hardware, each with a joint and the interfaces that count.

    All joints of real transmissions, with all their interfaces. Of the others, those with one joint: then only the
    first interface of the joint counts, within one transmission and among several. Several transmissions with the same
    interface all drive the joint.
    """
    counts: dict[str, str] = {}
    found: list[tuple[TransmissionInfo, TransmissionJoint]] = []
    for transmission in transmissions:
        if transmission.is_real:
            found += [(transmission, joint) for joint in transmission.joints]
        elif len(transmission.joints) == 1:
            joint = transmission.joints[0]
            first = counts.setdefault(joint.name, joint.hardware_interfaces[0])
            if interfaces.bare(first) == interfaces.bare(joint.hardware_interfaces[0]):
                found.append((transmission, replace(joint, hardware_interfaces=joint.hardware_interfaces[:1])))
    return found


class _DroppedError(Exception):
    """The whole transmission is dropped; the text is the reason."""


@dataclass
class TransmissionReader:
    """Reads the `<transmission>` elements of one robot, in the order of the file."""

    report: Report
    joints: dict[str, Joint]
    knows_all: bool
    """True: a joint that is not in `joints` does not exist."""
    is_real: bool
    driven: dict[str, tuple[Element, str]] = field(default_factory=dict)
    """By joint: its first transmission, and the interface that counts."""

    def read(self, element: Element) -> TransmissionInfo | None:
        """Read one transmission; None when the parser of ros_control would drop it.

        Raises:
            BadFile: the joint does not exist or cannot move. A transmission with several joints drives none, unless it
            is real; then malformed numbers, and a joint with two transmissions, are errors too.
        """
        try:
            info = self._info(element)
        except _DroppedError as error:
            self.report.wrong(element, f"the transmission is dropped: {error}")
            return None
        if self.is_real:
            for joint in info.joints:
                self._check_real(element, joint)
        elif len(info.joints) > 1:
            self.report.ignored(
                element, f"simulated hardware takes transmissions with one joint only; one with more {_IF_REAL}"
            )
        else:
            self._check_simulated(element, info)
        return info

    def _info(self, element: Element) -> TransmissionInfo:
        name = (element.get("name") or "").strip()
        if not name:
            raise _DroppedError("it has no name")
        self.report.unknown(element, {"name", "type"}, {"type", "joint", "actuator"})
        kind = self.report.only(element, "type")
        if kind is None:
            # The older files of PR2 have the type as an attribute.
            hint = "; an attribute does not count" if "type" in element.attributes else ""
            text = f"<type> is missing{hint}; add <type>transmission_interface/SimpleTransmission</type>"
            raise _DroppedError(text)
        if not kind.first_text:
            raise _DroppedError(f"<type> is empty{' (a comment before its text hides it)' if kind.content else ''}")
        if " " in kind.first_text:
            meant = "_".join(kind.first_text.split())
            text = f"{kind.first_text!r} has a blank: did you mean {meant!r}?"
            self.report.wrong(kind, text, f"{element.title}/<type>")
        joints = tuple(self._children(element, "joint", "a", self._joint))
        actuators = tuple(self._children(element, "actuator", "an", self._actuator))
        return TransmissionInfo(name, kind.first_text, joints, actuators, element.line, element.file, self.is_real)

    def _children(
        self, element: Element, tag: str, article: str, read: Callable[[Element, str, str], Any]
    ) -> list[Any]:
        """Read the valid children `tag`. Raises _DroppedError when none is left."""
        found = element.find_all(tag)
        if any("name" not in child.attributes for child in found):
            raise _DroppedError(f"{article} <{tag}> has no name")
        parts = []
        for child in found:
            if name := child.attributes["name"].strip():
                parts.append(read(child, name, f"{element.title}/{child.title}"))
            else:
                self.report.wrong(child, "is skipped: its name is empty", f"{element.title}/<{tag}>")
        valid = [part for part in parts if part is not None]
        if not valid:
            raise _DroppedError(f"no valid <{tag}> is left" if found else f"it has no <{tag}>")
        return valid

    def _joint(self, child: Element, name: str, place: str) -> TransmissionJoint | None:
        self.report.unknown(child, {"name"}, _JOINT_CHILDREN, place)
        interfaces = _interfaces(child)
        if not interfaces:
            self.report.wrong(child, f"is skipped: it has no <hardwareInterface> with a text; {_TO_ADD}", place)
            return None
        reduction = self._number(child, "mechanicalReduction", place)
        offset = self._number(child, "offset", place)
        role = child_text(child, "role", "")
        return TransmissionJoint(name, interfaces, role, offset or 0.0, 1.0 if reduction is None else reduction)

    def _actuator(self, child: Element, name: str, place: str) -> TransmissionActuator:
        self.report.unknown(child, {"name"}, _ACTUATOR_CHILDREN, place)
        reduction = self._number(child, "mechanicalReduction", place)
        effort = math.inf
        if (limit := self._if_real(child, "limit", place)) is not None:
            self.report.unknown(limit, {"effort"}, (), f"{place}/<limit>")
            effort = element_values.not_negative(limit, "effort", place)
        inertia = self._rotor_inertia(child, place)
        return TransmissionActuator(name, _interfaces(child), reduction, child_text(child, "role", ""), effort, inertia)

    def _rotor_inertia(self, actuator: Element, place: str) -> float:
        """The rotor inertia: the text of `<rotorInertia>`, or Drake's attribute."""
        text = self._if_real(actuator, "rotorInertia", place)
        drake = self._if_real(actuator, "drake:rotor_inertia", place)
        if text is None:
            return 0.0 if drake is None else element_values.not_negative(drake, "value", place)
        value = element_values.parse_number(text.first_text, text, f"{place}/<rotorInertia>")
        if value < 0:
            raise text.error(f"{place}/<rotorInertia> is {value:g}; it must not be negative")
        return value

    def _if_real(self, child: Element, tag: str, place: str) -> Element | None:
        found = self.report.only(child, tag)
        if found is None or self.is_real:
            return found
        self.report.ignored(found, _IF_REAL, f"{place}/<{tag}>")
        return None

    def _number(self, child: Element, tag: str, place: str) -> float | None:
        """An optional number. Without real transmissions it has no effect, and is reported unless it is the default."""
        found = self.report.only(child, tag)
        if found is None:
            return None
        try:
            value = element_values.parse_number(found.first_text, found, f"<{tag}>")
        except BadFile as error:
            if self.is_real:
                raise
            self.report.wrong(found, error.reason, f"{place}/<{tag}>")
            return None
        if not self.is_real and value != (0.0 if tag == "offset" else 1.0):
            text = f"{value:g} has no effect: simulated hardware commands and measures the joint itself"
            self.report.ignored(found, text, f"{place}/<{tag}>")
        return value

    def _check_simulated(self, element: Element, info: TransmissionInfo) -> None:
        """Report how gazebo_ros_control treats a valid transmission with one joint."""
        (joint,) = info.joints
        described = self._described_joint(element, joint)
        if described is None:
            return
        first = joint.hardware_interfaces[0]
        before, counts = self.driven.setdefault(joint.name, (element, first))
        if before is not element:
            text = f"joint {joint.name!r} is already driven by {before.title} (line {before.line})"
            if interfaces.bare(counts) != interfaces.bare(first):
                text = f"{text}, by {counts}: this one is dropped, and no controller finds its interface"
            self.report.wrong(element, text)
        if info.type.rpartition("/")[2] != "SimpleTransmission":
            text = (
                f"{info.type} has no effect: simulated hardware takes every transmission of one joint as a simple one"
            )
            self.report.ignored(element.find("type") or element, text, f"{element.title}/<type>")
        self._check_interface(element, joint)
        # A position joint moves without an effort, unless it has gains; these are in other files.
        limits = {"effort": described.limit.effort, "velocity": described.limit.velocity} if described.limit else {}
        for what, value in limits.items():
            if value == 0 and not (what == "effort" and has_position_command(joint)):
                text = f"the {what} limit of joint {joint.name!r} is 0, which is a limit: it cannot be driven"
                self.report.wrong(element, text)

    def _described_joint(self, element: Element, joint: TransmissionJoint) -> Joint | None:
        """The joint of the robot; None when it could not be read. Raises BadFile: it does not exist or cannot move."""
        place = f"transmission {element.attributes['name']!r}"
        child = next(child for child in element.find_all("joint") if child.attributes["name"].strip() == joint.name)
        described = self.joints.get(joint.name)
        if described is None and self.knows_all:
            raise element_values.unknown(child, place, "joint", joint.name, self.joints)
        if described is not None and described.type not in MOVING:
            raise child.error(f"{place}: joint {joint.name!r} is {described.type} and cannot be driven")
        return described

    def _check_real(self, element: Element, joint: TransmissionJoint) -> None:
        """Check a joint of a real transmission, as far as this needs no computation."""
        self._described_joint(element, joint)
        first, _ = self.driven.setdefault(joint.name, (element, ""))
        if first is not element:
            raise element.error(f"joint {joint.name!r} is already driven by {first.title} (line {first.line})")
        for written in joint.hardware_interfaces:
            if interfaces.find(written) is None:
                text = f"{written} is not an interface of simulated joints and is skipped; known: {interfaces.KNOWN}"
                self.report.wrong(element, text)

    def _check_interface(self, element: Element, joint: TransmissionJoint) -> None:
        place = f'{element.title}/<joint name="{joint.name}">'
        # The tags of the one joint that was valid.
        joints = [child for child in element.find_all("joint") if (child.get("name") or "").strip() == joint.name]
        tags = ([tag for tag in child.find_all("hardwareInterface") if tag.first_text] for child in joints)
        written, *others = next(filter(None, tags))
        first = joint.hardware_interfaces[0]
        for other in others:
            self.report.ignored(other, f"of several hardware interfaces only the first counts, {first}", place)
        interface = interfaces.find(first)
        if interface is None:
            text = f"{first} is not an interface of simulated joints; known: {interfaces.KNOWN}"
            self.report.wrong(written, text, place)
        elif first != interface.written:
            self.report.converted(written, f"{first} is read as {interface.written}", place)


def _interfaces(element: Element) -> tuple[str, ...]:
    return tuple(text for child in element.find_all("hardwareInterface") if (text := child.first_text))
