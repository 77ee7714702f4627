"""`<transmission>`, by the rules of ros_control's TransmissionParser.

What that parser drops with an error is dropped here with a notice. Reductions and offsets are read for the maths of
control/, and reported: simulated hardware works on the joint's side of the transmission.
"""

from __future__ import annotations

from collections.abc import Iterable

from slidectl.description import values
from slidectl.description.report import Report
from slidectl.description.robot import Joint, TransmissionActuator, TransmissionInfo, TransmissionJoint
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile

_PREFIX = "hardware_interface/"
SIMULATED_INTERFACES = tuple(
    _PREFIX + name for name in ("EffortJointInterface", "PositionJointInterface", "VelocityJointInterface")
)
"""What a transmission may ask for, as it is best written. `control.hardware_interface` says what each is."""
_TO_ADD = f"add <hardwareInterface>{SIMULATED_INTERFACES[0]}</hardwareInterface>"
_JOINT_CHILDREN = {"role", "hardwareInterface", "offset", "mechanicalReduction"}
_ACTUATOR_CHILDREN = {"role", "hardwareInterface", "mechanicalReduction"}


def is_simulated(interface: str) -> bool:
    """Whether simulated hardware has an interface, with or without its prefix."""
    return _prefixed(interface) in SIMULATED_INTERFACES


def interface_name(interface: str) -> str:
    """The name of an interface without any prefix."""
    return interface.rpartition("/")[2]


def _prefixed(interface: str) -> str:
    return _PREFIX + interface.removeprefix(_PREFIX)


def is_same_interface(first: str, second: str) -> bool:
    """Whether two interfaces are the same, with or without their prefix."""
    return first.removeprefix(_PREFIX) == second.removeprefix(_PREFIX)


def takes_positions(joint: TransmissionJoint) -> bool:
    """Whether a joint of a transmission takes commands by its position."""
    return is_same_interface(joint.hardware_interfaces[0], "PositionJointInterface")


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
            if is_same_interface(first, joint.hardware_interfaces[0]):
                found.append(transmission)
    return found


class _DroppedError(Exception):
    """The whole transmission is dropped; the notice is written already."""


class TransmissionReader:
    """Reads the `<transmission>` elements of one robot, in the order of the file."""

    def __init__(self, report: Report, joints: dict[str, Joint]) -> None:
        self.report = report
        self.joints = joints
        self.driven: dict[str, tuple[Element, str]] = {}

    def read(self, element: Element) -> TransmissionInfo | None:
        """One transmission, or None when the parser of ros_control would drop it.

        Raises:
            BadFile: it drives a joint that is not there, or that cannot move. Those of several joints drive none.
        """
        try:
            info = self._info(element)
        except _DroppedError:
            return None
        self._check_simulated(element, info)
        return info

    def _drop(self, element: Element, why: str) -> _DroppedError:
        self.report.wrong(element, f"the transmission is dropped: {why}")
        return _DroppedError()

    def _info(self, element: Element) -> TransmissionInfo:
        name = (element.get("name") or "").strip()
        if not name:
            raise self._drop(element, "it has no name")
        self.report.unknown(element, {"name", "type"}, {"type", "joint", "actuator"})
        kind = self.report.only(element, "type")
        if kind is None or not kind.first_text:
            raise self._drop(element, _typeless(element, kind))
        joints = self._joints(element)
        actuators = self._actuators(element)
        return TransmissionInfo(name, kind.first_text, joints, actuators, element.line, element.file)

    def _joints(self, element: Element) -> tuple[TransmissionJoint, ...]:
        found = element.find_all("joint")
        if any("name" not in joint.attributes for joint in found):
            raise self._drop(element, "a <joint> has no name")
        joints = tuple(joint for child in found if (joint := self._joint(element, child)) is not None)
        if not joints:
            raise self._drop(element, "no valid <joint> is left" if found else "it has no <joint>")
        return joints

    def _joint(self, element: Element, child: Element) -> TransmissionJoint | None:
        name = child.attributes["name"].strip()
        if not name:
            self.report.wrong(child, "is skipped: its name is empty", f"{element.title}/<joint>")
            return None
        place = f"{element.title}/{child.title}"
        self.report.unknown(child, {"name"}, _JOINT_CHILDREN, place)
        interfaces = _interfaces(child)
        if not interfaces:
            self.report.wrong(child, f"is skipped: it has no <hardwareInterface> with a text; {_TO_ADD}", place)
            return None
        reduction = self._number(child, "mechanicalReduction", place)
        offset = self._number(child, "offset", place)
        reduction = 1.0 if reduction is None else reduction
        return TransmissionJoint(name, interfaces, _role(child), offset or 0.0, reduction)

    def _actuators(self, element: Element) -> tuple[TransmissionActuator, ...]:
        found = element.find_all("actuator")
        if any("name" not in actuator.attributes for actuator in found):
            raise self._drop(element, "an <actuator> has no name")
        actuators = tuple(actuator for child in found if (actuator := self._actuator(element, child)) is not None)
        if not actuators:
            raise self._drop(element, "no valid <actuator> is left" if found else "it has no <actuator>")
        return actuators

    def _actuator(self, element: Element, child: Element) -> TransmissionActuator | None:
        name = child.attributes["name"].strip()
        if not name:
            self.report.wrong(child, "is skipped: its name is empty", f"{element.title}/<actuator>")
            return None
        place = f"{element.title}/{child.title}"
        self.report.unknown(child, {"name"}, _ACTUATOR_CHILDREN, place)
        reduction = self._number(child, "mechanicalReduction", place)
        return TransmissionActuator(name, _interfaces(child), reduction, _role(child))

    def _number(self, child: Element, tag: str, place: str) -> float | None:
        """An optional number that changes nothing in simulation: reported when it says anything but "none"."""
        found = self.report.only(child, tag)
        if found is None:
            return None
        try:
            value = values.parse_number(found.first_text, found, f"<{tag}>")
        except BadFile as error:
            self.report.wrong(found, error.reason, f"{place}/<{tag}>")
            return None
        if value != (0.0 if tag == "offset" else 1.0):
            text = f"{value:g} has no effect: simulated hardware commands and measures the joint itself"
            self.report.ignored(found, text, f"{place}/<{tag}>")
        return value

    def _check_exists(self, element: Element, name: str) -> None:
        place = f"transmission {element.attributes['name']!r}"
        child = next(child for child in element.find_all("joint") if child.attributes["name"].strip() == name)
        joint = self.joints.get(name)
        if joint is None:
            raise values.unknown(child, place, "joint", name, self.joints)
        if joint.type in ("fixed", "floating", "planar"):
            raise child.error(f"{place}: joint {name!r} is {joint.type} and cannot be driven")

    def _check_simulated(self, element: Element, info: TransmissionInfo) -> None:
        """What gazebo_ros_control makes of a transmission that its parser has accepted."""
        if len(info.joints) > 1:
            self.report.ignored(element, "simulated hardware takes transmissions with one joint only; this has more")
            return
        joint = info.joints[0]
        self._check_exists(element, joint.name)
        before, counts = self.driven.setdefault(joint.name, (element, joint.hardware_interfaces[0]))
        if before is not element:
            text = f"joint {joint.name!r} is driven by {before.title} already (line {before.line})"
            if not is_same_interface(counts, joint.hardware_interfaces[0]):
                text = f"{text}, by {counts}: this one is dropped, and no controller finds its interface"
            self.report.wrong(element, text)
        self._check_type(element, info.type)
        self._check_interface(element, joint)
        self._check_limit(element, joint)

    def _check_type(self, element: Element, name: str) -> None:
        if name.rpartition("/")[2] != "SimpleTransmission":
            kind = element.find("type")
            text = f"{name} has no effect: simulated hardware takes every transmission of one joint as a simple one"
            self.report.ignored(kind or element, text, f"{element.title}/<type>")

    def _check_limit(self, element: Element, joint: TransmissionJoint) -> None:
        """A position joint is moved without an effort, unless it has gains: these are in other files."""
        limit = self.joints[joint.name].limit
        is_position = takes_positions(joint)
        for value, what in ((limit.effort, "effort"), (limit.velocity, "velocity")) if limit is not None else ():
            if value == 0 and not (is_position and what == "effort"):
                self.report.wrong(
                    element, f"the {what} limit of joint {joint.name!r} is 0, which is a limit: it cannot be driven"
                )

    def _check_interface(self, element: Element, joint: TransmissionJoint) -> None:
        place = f'{element.title}/<joint name="{joint.name}">'
        written, *others = _interface_elements(element, joint.name)
        first = joint.hardware_interfaces[0]
        for other in others:
            self.report.ignored(other, f"of several hardware interfaces only the first counts, {first}", place)
        if not is_simulated(first):
            text = f"{first} is no interface of simulated joints; known: {', '.join(SIMULATED_INTERFACES)}"
            self.report.wrong(written, text, place)
        elif first != _prefixed(first):
            self.report.converted(written, f"{first} is read as {_prefixed(first)}", place)


def _interfaces(element: Element) -> tuple[str, ...]:
    return tuple(text for child in element.find_all("hardwareInterface") if (text := child.first_text))


def _interface_elements(transmission: Element, joint: str) -> list[Element]:
    """The tags that name the interfaces of the one joint that was not skipped."""
    joints = [child for child in transmission.find_all("joint") if (child.get("name") or "").strip() == joint]
    return next(
        found for child in joints if (found := [e for e in child.find_all("hardwareInterface") if e.first_text])
    )


def _role(element: Element) -> str:
    role = element.find("role")
    return role.first_text if role is not None else ""


def _typeless(transmission: Element, kind: Element | None) -> str:
    """Why a transmission has no type; the older files of PR2 had it as an attribute."""
    if kind is not None:
        return f"<type> is {_emptiness(kind)}"
    hint = "; an attribute does not do" if "type" in transmission.attributes else ""
    return f"<type> is missing{hint}; add <type>transmission_interface/SimpleTransmission</type>"


def _emptiness(element: Element) -> str:
    return "empty (a comment before its text hides it)" if element.content else "empty"
