"""`<transmission>`, by the rules of ros_control's TransmissionParser.

What that parser drops with an error is dropped here with a notice. Reductions and offsets are read for the maths of
control/, and reported: simulated hardware works on the joint's side of the transmission.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from slidectl.description import element_values, interfaces
from slidectl.description.report import Report
from slidectl.description.robot import Joint, TransmissionActuator, TransmissionInfo, TransmissionJoint
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile

_TO_ADD = f"add <hardwareInterface>{interfaces.EFFORT.written}</hardwareInterface>"
_JOINT_CHILDREN = {"role", "hardwareInterface", "offset", "mechanicalReduction"}
_ACTUATOR_CHILDREN = {"role", "hardwareInterface", "mechanicalReduction"}


def takes_positions(joint: TransmissionJoint) -> bool:
    """Whether a joint of a transmission takes commands by its position."""
    interface = interfaces.find(joint.hardware_interfaces[0])
    return interface is not None and interface.quantity == "position"


def driving(transmissions: Iterable[TransmissionInfo]) -> list[TransmissionInfo]:
    """The transmissions that simulated hardware makes use of: those of one joint, by the joint's first interface.

    Of several interfaces of one joint the first counts, in one transmission as in several. Several transmissions by the
    same interface all drive the joint.
    """
    counts: dict[str, str] = {}
    found = []
    for transmission in transmissions:
        if len(transmission.joints) == 1:
            joint = transmission.joints[0]
            first = counts.setdefault(joint.name, joint.hardware_interfaces[0])
            if interfaces.bare(first) == interfaces.bare(joint.hardware_interfaces[0]):
                found.append(transmission)
    return found


class _DroppedError(Exception):
    """The whole transmission is dropped; the text says why."""


class TransmissionReader:
    """Reads the `<transmission>` elements of one robot, in the order of the file.

    `knows_all`: whether a joint that is not among `joints` is not there at all.
    """

    def __init__(self, report: Report, joints: dict[str, Joint], knows_all: bool = True) -> None:
        self.report = report
        self.joints = joints
        self.knows_all = knows_all
        self.driven: dict[str, tuple[Element, str]] = {}

    def read(self, element: Element) -> TransmissionInfo | None:
        """One transmission, or None when the parser of ros_control would drop it.

        Raises:
            BadFile: it drives a joint that is not there, or that cannot move. Those of several joints drive none.
        """
        try:
            info = self._info(element)
        except _DroppedError as error:
            self.report.wrong(element, f"the transmission is dropped: {error}")
            return None
        if len(info.joints) > 1:
            self.report.ignored(element, "simulated hardware takes transmissions with one joint only; this has more")
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
            # The older files of PR2 had it as an attribute.
            hint = "; an attribute does not do" if "type" in element.attributes else ""
            text = f"<type> is missing{hint}; add <type>transmission_interface/SimpleTransmission</type>"
            raise _DroppedError(text)
        if not kind.first_text:
            raise _DroppedError(f"<type> is empty{' (a comment before its text hides it)' if kind.content else ''}")
        joints = tuple(self._children(element, "joint", "a", self._joint))
        actuators = tuple(self._children(element, "actuator", "an", self._actuator))
        return TransmissionInfo(name, kind.first_text, joints, actuators, element.line, element.file)

    def _children(
        self, element: Element, tag: str, article: str, read: Callable[[Element, str, str], Any]
    ) -> list[Any]:
        """What is read of the children of that name that are valid; there is one at least."""
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
        reduction = 1.0 if reduction is None else reduction
        return TransmissionJoint(name, interfaces, _role(child), offset or 0.0, reduction)

    def _actuator(self, child: Element, name: str, place: str) -> TransmissionActuator:
        self.report.unknown(child, {"name"}, _ACTUATOR_CHILDREN, place)
        reduction = self._number(child, "mechanicalReduction", place)
        return TransmissionActuator(name, _interfaces(child), reduction, _role(child))

    def _number(self, child: Element, tag: str, place: str) -> float | None:
        """An optional number that changes nothing in simulation: reported when it says anything but "none"."""
        found = self.report.only(child, tag)
        if found is None:
            return None
        try:
            value = element_values.parse_number(found.first_text, found, f"<{tag}>")
        except BadFile as error:
            self.report.wrong(found, error.reason, f"{place}/<{tag}>")
            return None
        if value != (0.0 if tag == "offset" else 1.0):
            text = f"{value:g} has no effect: simulated hardware commands and measures the joint itself"
            self.report.ignored(found, text, f"{place}/<{tag}>")
        return value

    def _check_simulated(self, element: Element, info: TransmissionInfo) -> None:
        """What gazebo_ros_control makes of a transmission of one joint that its parser has accepted."""
        (joint,) = info.joints
        place = f"transmission {element.attributes['name']!r}"
        child = next(child for child in element.find_all("joint") if child.attributes["name"].strip() == joint.name)
        on_paper = self.joints.get(joint.name)
        if on_paper is None:
            if self.knows_all:
                raise element_values.unknown(child, place, "joint", joint.name, self.joints)
            return
        if on_paper.type in ("fixed", "floating", "planar"):
            raise child.error(f"{place}: joint {joint.name!r} is {on_paper.type} and cannot be driven")
        first = joint.hardware_interfaces[0]
        before, counts = self.driven.setdefault(joint.name, (element, first))
        if before is not element:
            text = f"joint {joint.name!r} is driven by {before.title} already (line {before.line})"
            if interfaces.bare(counts) != interfaces.bare(first):
                text = f"{text}, by {counts}: this one is dropped, and no controller finds its interface"
            self.report.wrong(element, text)
        if info.type.rpartition("/")[2] != "SimpleTransmission":
            text = (
                f"{info.type} has no effect: simulated hardware takes every transmission of one joint as a simple one"
            )
            self.report.ignored(element.find("type") or element, text, f"{element.title}/<type>")
        self._check_interface(element, joint)
        # A position joint is moved without an effort, unless it has gains: these are in other files.
        limits = {"effort": on_paper.limit.effort, "velocity": on_paper.limit.velocity} if on_paper.limit else {}
        for what, value in limits.items():
            if value == 0 and not (what == "effort" and takes_positions(joint)):
                text = f"the {what} limit of joint {joint.name!r} is 0, which is a limit: it cannot be driven"
                self.report.wrong(element, text)

    def _check_interface(self, element: Element, joint: TransmissionJoint) -> None:
        place = f'{element.title}/<joint name="{joint.name}">'
        # The tags of the one joint that was not skipped.
        joints = [child for child in element.find_all("joint") if (child.get("name") or "").strip() == joint.name]
        tags = ([tag for tag in child.find_all("hardwareInterface") if tag.first_text] for child in joints)
        written, *others = next(filter(None, tags))
        first = joint.hardware_interfaces[0]
        for other in others:
            self.report.ignored(other, f"of several hardware interfaces only the first counts, {first}", place)
        interface = interfaces.find(first)
        if interface is None:
            text = f"{first} is no interface of simulated joints; known: {interfaces.KNOWN}"
            self.report.wrong(written, text, place)
        elif first != interface.written:
            self.report.converted(written, f"{first} is read as {interface.written}", place)


def _interfaces(element: Element) -> tuple[str, ...]:
    return tuple(text for child in element.find_all("hardwareInterface") if (text := child.first_text))


def _role(element: Element) -> str:
    role = element.find("role")
    return role.first_text if role is not None else ""
