"""Checks a model: the effect of each tag and attribute, and whether the robot makes sense.

It reads the model once, as `slidectl spawn` does. A broken part is a finding, and the other parts are still read. The
robot as a whole (limits, masses, namespaces) is judged only when no part is broken.
"""

from __future__ import annotations

import contextlib
import io
import logging
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from slidectl import description, names
from slidectl.check import bodies
from slidectl.check.findings import Findings
from slidectl.check.tags import Tags, Trace, TracedElement, TracedReport, plain
from slidectl.control import registry
from slidectl.control.transmission_interface import load
from slidectl.description import interfaces, slips, xml_tree
from slidectl.description.document import Written
from slidectl.description.gazebo_tags import set_transmissions, transmissions_named
from slidectl.description.mesh_files import MeshFiles
from slidectl.description.packages import Packages, is_file
from slidectl.description.parser import parse_tree
from slidectl.description.report import Report
from slidectl.description.robot import (
    MOVING,
    ControlPlugin,
    Joint,
    Notice,
    Robot,
    TransmissionInfo,
    Verdict,
    WheelDrive,
)
from slidectl.description.transmissions import driving
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, BadName, SlidectlError, UnknownName

_PLUGIN = slips.PLUGIN
_TIMESTEP_S = 0.001  # the daemon's own
_EXPRESSION = re.compile(r"\$\{(.*?)\}", re.DOTALL)
_WORD = re.compile(r"[A-Za-z_]\w*")

TransmissionValues = Callable[[Robot], Iterator[object]]
"""Gives the values of TRANSMISSIONS in the robot's possible namespaces; None: not set. The first set value counts."""

# attribute -> (unit for a prismatic joint, unit for a turning one, effect)
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
_RANGES = ("lower", "upper", "soft_lower_limit", "soft_upper_limit")
_SOFT = ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")


@dataclass(frozen=True)
class Model:
    """A checked robot, for the checks of its parameters."""

    robot: Robot
    namespace: str
    sets_transmissions: bool = False
    """True when the model sets how its transmissions count: then the parameter has no effect."""

    @cached_property
    def driven(self) -> dict[str, list[str]]:
        """The joints that simulated hardware drives, each with the names of its command interfaces."""
        return driven_joints(self.robot)


def check(
    source: str | Path,
    arguments: Mapping[str, str],
    packages: Packages,
    findings: Findings,
    second_opinion: bool = False,
    title: str | None = None,
    strict: bool = False,
    transmissions: str | None = None,
    transmission_values: TransmissionValues | None = None,
) -> Model | None:
    """Add findings on a model (as description.load takes it). Returns the robot, or None when it cannot be read.

    Args:
        second_opinion: compare with yourdfpy too, which takes half a second.
        title: the name of a text in messages.
        strict: refuse impossible masses, inertias and shapes instead of correcting them, as `slidectl spawn --strict`.
        transmissions: how they count; overrides the model.
        transmission_values: gives the values of the parameter, which counts if the model sets nothing.

    Raises:
        BadFile: there is no such file. UnknownName: no such shipped model.
    """
    try:
        missing = findings.missing
        document = description.load(
            source, arguments, packages, all_meshes=missing.keeps_going, title=title, missing=missing
        )
    except BadFile as error:
        findings.fail("model", error)
        return None
    if not (isinstance(source, str) and (source == "-" or source.lstrip().startswith("<"))):
        written = description.written(source, packages)
        for name, element in written.arguments.items():
            default = f"{element.get('default') or ''!r}, by default"
            text = f"{arguments[name]!r}, as given" if name in arguments else default
            findings.add("used", f"argument {name}", text, element.file, element.line)
        if written.is_whole:
            _check_unused(written, findings)
    findings.extend(document.report)
    xml = document.xml
    if transmissions is not None:
        xml = description.with_transmissions(xml, transmissions, document.file)
    return check_text(xml, document.file, findings, second_opinion, packages, strict, transmission_values)


def check_text(
    xml: str,
    file: str,
    findings: Findings,
    second_opinion: bool = False,
    packages: Packages | None = None,
    strict: bool = False,
    transmission_values: TransmissionValues | None = None,
) -> Model | None:
    """As check, for plain URDF text; `file` is its name in findings, unless the text has a note of its sources."""
    try:
        root = xml_tree.read(xml, file)
    except BadFile as error:
        findings.fail("model", error)
        return None
    base = Path(file).absolute().parent if is_file(Path(file)) else None
    packages = packages or Packages()
    meshes = MeshFiles(packages.starting_at(base) if base is not None else packages, base)
    is_applied = transmission_values is not None and _apply_transmissions(root, meshes, transmission_values)
    trace = Trace()
    report = TracedReport(trace)
    traced = TracedElement(root, trace)
    robot, has_stopped = None, False
    try:
        robot = parse_tree(traced, meshes, report, strict)
    except BadFile as error:
        has_stopped = error not in report.faults
        report.collect(error)
    for fault in report.faults:
        findings.refuse(fault)
    if robot is None:
        Tags(trace, findings, lambda *_: None, not has_stopped).classify(traced)
        text = "note: limits, masses and transmissions are not judged together while a part is broken"
        findings.add("used", root.title, text, root.file, root.line)
        return None
    _report_converted(robot, traced, report)
    joints = _Joints(robot, trace)
    Tags(trace, findings, joints.explain).classify(traced)
    joints.check(findings)
    sets_transmissions = robot.plugin is not None and robot.plugin.transmissions is not None and not is_applied
    model = Model(robot, _namespace(robot, root, findings), sets_transmissions)
    _check_whole(robot, root, model.namespace, findings)
    bodies.check(robot, findings)
    if second_opinion:
        _compare_with_yourdfpy(xml, robot, root, findings)
    return model


def _apply_transmissions(root: Element, meshes: MeshFiles, transmission_values: TransmissionValues) -> bool:
    """Apply the parameter TRANSMISSIONS to the plugin, if the plugin sets nothing. Returns True when it was applied."""
    with contextlib.suppress(SlidectlError):  # errors are reported when the model is checked
        robot = parse_tree(root, meshes, Report())
        how = next((value for value in transmission_values(robot) if value is not None), None)
        if how is not None and (robot.plugin is None or robot.plugin.transmissions is None):
            set_transmissions(root, transmissions_named(str(how)))
            return True
    return False


def _namespace(robot: Robot, root: Element, findings: Findings) -> str:
    """The namespace of the robot's controllers when it is spawned under its own name."""
    if remark := names.remark_on_robot(robot.name):
        findings.add("converted", f"robot {robot.name!r}", remark, root.file, root.line)
    try:
        return description.namespace_of(robot, robot.name)
    except BadName as error:
        text = f"{error.message}; spawn it with -n NAME"
        findings.add("wrong", f"robot {robot.name!r}", text, root.file, root.line)
        return f"/{robot.name}"


def _check_unused(written: Written, findings: Findings) -> None:
    """Find unused properties and macros of the model's own file, which have no effect on the robot."""
    used: set[str] = set()
    for element in written.elements:
        used.add(element.tag)
        if element.tag == "xacro:insert_block":
            used.add(element.get("name") or "")
        elif element.tag == "xacro:call":
            used.add(f"xacro:{element.get('macro')}")
        elif element.tag == "xacro:macro":
            used.update(_WORD.findall(element.get("params") or ""))
        for text in (*element.attributes.values(), element.text):
            used.update(word for expression in _EXPRESSION.findall(text) for word in _WORD.findall(expression))
    for element in written.root.walk():
        name = (element.get("name") or "").removeprefix("xacro:")
        if element.tag == "xacro:property" and name not in used:
            findings.add("ignored", element.title, "no expression uses it", element.file, element.line)
        elif element.tag == "xacro:macro" and f"xacro:{name}" not in used:
            findings.add("ignored", element.title, "is never called", element.file, element.line)


# --- joints -----------------------------------------------------------------------------------------------------------


def driven_joints(robot: Robot) -> dict[str, list[str]]:
    """The names of the interfaces by which each joint takes commands."""
    if robot.ros2_control is not None:
        found = {name: one.interfaces() for name, one in robot.ros2_control.joints.items()}
        return {name: [interface.name for interface in one] for name, one in found.items() if one}
    joints = (joint for _, joint in driving(robot.transmissions))
    return {joint.name: list(map(interfaces.bare, joint.hardware_interfaces)) for joint in joints}


class _Joints:
    """Adds a finding for each limit of a joint, and for joints that are not driven or not bounded."""

    def __init__(self, robot: Robot, trace: Trace) -> None:
        self.robot = robot
        self.trace = trace
        self.driven = driven_joints(robot)
        self.driver = "transmission" if robot.ros2_control is None else "command_interface"
        self.measured = frozenset(robot.ros2_control.joints) if robot.ros2_control is not None else frozenset()

    def explain(self, element: Element, owner: str) -> Iterator[Notice] | None:
        """The findings on a `<limit>`, `<safety_controller>` or `<dynamics>` of the joint `owner`; None for others."""
        joint = self.robot.joints.get(owner)
        if element.tag not in ("limit", "safety_controller", "dynamics") or joint is None:
            return None
        return self._attributes(element, joint)

    def _attributes(self, element: Element, joint: Joint) -> Iterator[Notice]:
        said = {attribute for attribute, _ in self.trace.notices.get(id(element), [])}
        for name, value in plain(element).attributes.items():
            # Notices about the whole tag are about its range.
            if name not in said and not (None in said and name in _RANGES):
                subject = f"joint {joint.name!r}/<{element.tag}>, {name}"
                verdict, effect = self._effect(joint, name)
                unit = _MEANINGS[name][0 if joint.type == "prismatic" else 1]
                yield Notice(verdict, subject, f"{value.strip()} {unit}; {effect}", element.file, element.line)

    def _effect(self, joint: Joint, name: str) -> tuple[Verdict, str]:
        """The effect of a limit, which depends on the command interfaces of the joint."""
        written = self.driven.get(joint.name, [])
        found = [interface for interface in map(interfaces.find, written) if interface is not None]
        if not written and name in ("velocity", "effort"):
            return "used", f"bounds forces from outside only, as no {self.driver} drives the joint"
        if not written and name in _SOFT:
            return "ignored", f"has no effect, as no {self.driver} drives the joint"
        if joint.type == "continuous" and name in _SOFT and name != "k_velocity":
            return "ignored", "has no effect without position limits, which a continuous joint does not have"
        if found and all(interface.quantity == "position" for interface in found) and name == "effort":
            return "used", "counts only with gains in gazebo_ros_control/pid_gains"
        if found and interfaces.EFFORT not in found and name == "k_velocity":
            own = " and a ".join(written)
            return "ignored", f"only an {interfaces.EFFORT.name} has a use for it, the joint's is a {own}"
        return "used", _MEANINGS[name][2]

    def check(self, findings: Findings) -> None:
        """Add findings on missing limits and transmissions, and on limits that look like degrees."""
        for joint in self.robot.joints.values():
            for text in self._missing(joint) if joint.type in MOVING else ():
                findings.add("used", f"joint {joint.name!r}", f"note: {text}", joint.file or "", joint.line)

    def _missing(self, joint: Joint) -> Iterator[str]:
        limit = joint.limit
        if (text := slips.degrees(joint)) is not None:
            yield text
        if limit is None:
            yield f"a {joint.type} joint without <limit>: neither its effort nor its velocity is bounded"
        if joint.mimic is not None and joint.name in self.driven:
            yield f"it has a {self.driver}, and it follows {joint.mimic.joint!r}: two masters"
        wheels = [drive for drive in self.robot.drives if isinstance(drive, WheelDrive)]
        turning = next((drive for drive in wheels if joint.name in (*drive.left, *drive.right)), None)
        if turning is not None and joint.name in self.driven:
            yield f"it has a {self.driver}, and the plugin {turning.name!r} turns it: two masters"
        elif joint.name not in self.driven and joint.mimic is None and turning is None:
            rest = "" if joint.name in self.measured else ", controllers and joint_states do not know it"
            yield f"no {self.driver} drives it: it moves freely{rest}"


# --- what the simulation makes of it ----------------------------------------------------------------------------------


def _report_converted(robot: Robot, root: Element, report: Report) -> None:
    """Report single tags that the simulation changes or ignores. This does not count as reading the elements."""
    plugin = robot.plugin or ControlPlugin()
    tags = {element.tag: element for element in reversed(list(root.walk()))}
    if plugin.control_period is not None:
        steps = max(1, math.ceil(plugin.control_period / _TIMESTEP_S - 1e-6))
        if not math.isclose(steps * _TIMESTEP_S, plugin.control_period, rel_tol=1e-6):
            text = f"{plugin.control_period:g} s is not a whole number of the simulation's steps of {_TIMESTEP_S:g} s"
            report.converted(tags["controlPeriod"], f"{text}; controllers run every {steps * _TIMESTEP_S:g} s")
    if plugin.robot_param != ControlPlugin.robot_param:
        text = f"{plugin.robot_param} is not read: the model is the spawned one, as NAMESPACE/robot_description"
        report.converted(tags["robotParam"], text)
    for transmission in robot.transmissions:
        _report_actuators(transmission, root, report)
    for tag in _inside(root, "gazebo"):
        link = robot.links.get(plain(tag).get("reference") or "")
        if link is None or None in (link.surface.mu1, link.surface.mu2) or link.surface.mu1 == link.surface.mu2:
            continue
        for place in _inside(tag, "mu2"):
            text = f"has no effect: friction is the same in all directions here, and mu1 counts, {link.surface.mu1:g}"
            report.ignored(place, text, f"link {link.name!r}/<mu2>")


def _report_actuators(transmission: TransmissionInfo, root: Element, report: Report) -> None:
    """Report interfaces of actuators that differ from the joint's, which counts."""
    counts = transmission.joints[0].hardware_interfaces[0]
    whole = (tag for tag in _inside(root, "transmission") if _is_of(tag, transmission))
    for actuator in (actuator for tag in whole for actuator in _inside(tag, "actuator")):
        for place in _inside(actuator, "hardwareInterface"):
            written = plain(place).first_text
            if written and interfaces.bare(written) != interfaces.bare(counts):
                text = f"{written} has no effect: the joint's interface counts, {counts}"
                report.ignored(place, text, f"transmission {transmission.name!r}/{actuator.title}")


def _is_of(tag: Element, transmission: TransmissionInfo) -> bool:
    """True when a transmission was read from this tag. All those that a macro makes have the same line."""
    joint = transmission.joints[0]
    own = [child for child in _inside(tag, "joint") if (plain(child).get("name") or "").strip() == joint.name]
    written = [plain(place).first_text for child in own for place in _inside(child, "hardwareInterface")]
    return (
        (tag.file, tag.line) == (transmission.file, transmission.line)
        and (plain(tag).get("name") or "").strip() == transmission.name
        and joint.hardware_interfaces[0] in written
    )


def _inside(element: Element, tag: str) -> list[Element]:
    """The children called `tag`; it does not count as reading them."""
    return plain(element).find_all(tag)


def _check_whole(robot: Robot, root: Element, namespace: str, findings: Findings) -> None:
    """Add findings on the root, the plugin, and on what the parser accepts with a notice and the simulation refuses."""
    if not robot.is_fixed_to_world:
        link = robot.links[robot.root]
        text = "note: the root is free and falls to the ground; a root link called 'world', or --fixed, holds a robot"
        findings.add("used", f"link {link.name!r}", text, link.file or "", link.line)
        if not any(link.collisions for link in robot.links.values()):
            text = "note: no link has a <collision>: it falls through the ground"
            findings.add("used", f"robot {robot.name!r}", text, root.file, root.line)
    is_moving = any(joint.type in MOVING for joint in robot.joints.values())
    if is_moving and (slip := slips.millimetres(robot)) is not None:
        where, _, what = slip.partition(": ")
        line = where.rpartition(":")[2]
        findings.add("used", "sizes", f"note: {what}", where.rpartition(":")[0], int(line) if line.isdigit() else None)
    plugin = robot.plugin
    is_driven = bool(driven_joints(robot))
    if plugin is not None:
        subject, file = f"plugin {_PLUGIN}", plugin.file or ""
        findings.add("used", subject, f"note: controllers live in the namespace {namespace}", file, plugin.line)
        if not is_driven:
            findings.add("used", subject, "note: without a transmission it drives no joint", file, plugin.line)
        try:
            registry.common.hardware.check_known(plugin.robot_sim_type)
        except UnknownName as error:
            findings.refuse(BadFile(error.message, plugin.file, plugin.line, error.hint))
    elif robot.ros2_control is not None:
        text = f"note: a robot of ROS 2; controllers live in the namespace {namespace}"
        findings.add("used", f"robot {robot.name!r}", text, root.file, root.line)
    elif is_driven:
        text = f"has transmissions but no {_PLUGIN}; here it is driven all the same, in the namespace {namespace}"
        findings.add("converted", f"robot {robot.name!r}", text, root.file, root.line)
    for transmission in robot.transmissions:
        if transmission.is_real:
            try:
                load(transmission, robot)
            except SlidectlError as error:
                text = f"transmission {transmission.name!r}: {error.message}"
                findings.refuse(BadFile(text, transmission.file, transmission.line, error.hint))
    for transmission, joint in driving(robot.transmissions):
        if not any(map(interfaces.find, joint.hardware_interfaces)):
            written = ", ".join(joint.hardware_interfaces)
            text = f"transmission {transmission.name!r}: {written} is not an interface of simulated joints"
            findings.refuse(BadFile(text, transmission.file, transmission.line))


# --- a second opinion -------------------------------------------------------------------------------------------------


def _compare_with_yourdfpy(xml: str, robot: Robot, root: Element, findings: Findings) -> None:
    """Add a remark for each difference to the reading of yourdfpy, an independent parser, or one that there is none.

    It compares the tree, masses and limits. `xml` is the text that `root` was read from.
    """
    whole = f"robot {robot.name!r}"
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)  # yourdfpy logs, and it prints
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            remarks = list(_differences_to_yourdfpy(robot, xml, whole))
    except Exception as error:  # any exception of its parsers means that it cannot read the file
        remarks = [(whole, f"cannot read it: {' '.join(str(error).split()) or type(error).__name__}")]
    finally:
        logging.disable(before)
    for subject, text in remarks or [(whole, "reads the same tree, masses and limits")]:
        findings.add("used", subject, f"note: yourdfpy {text}", root.file, root.line)


def _differences_to_yourdfpy(robot: Robot, xml: str, whole: str) -> Iterator[tuple[str, str]]:
    """Subject and text of each difference between the two readings."""
    import yourdfpy  # a heavy import

    other = yourdfpy.URDF.load(io.BytesIO(xml.encode()), load_meshes=False)
    if other.base_link != robot.root:
        yield whole, f"takes {other.base_link!r} for the root, not {robot.root!r}"
    for error in other.errors if not other.validate() else ():
        yield whole, f"says: {error}"
    for link in robot.links.values():
        theirs = other.link_map.get(link.name)
        mass = theirs.inertial.mass if theirs is not None and theirs.inertial is not None else None
        if mass != (link.inertial.mass if link.inertial is not None else None):
            yield f"link {link.name!r}", f"reads a mass of {mass}"
    for joint in robot.joints.values():
        theirs = other.joint_map.get(joint.name)
        if theirs is None or (theirs.parent, theirs.child, theirs.type) != (joint.parent, joint.child, joint.type):
            yield f"joint {joint.name!r}", f"does not read it as a {joint.type} joint of the same two links"
        elif joint.limit is not None and joint.type != "continuous":
            pair = (theirs.limit.lower or 0.0, theirs.limit.upper or 0.0)
            if sorted(pair) != [joint.limit.lower, joint.limit.upper]:
                yield f"joint {joint.name!r}", f"reads the limits {pair[0]:g} and {pair[1]:g}"
