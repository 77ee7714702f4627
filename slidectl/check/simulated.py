"""How the simulation takes a robot: its root, its control plugin, its transmissions, its friction.

What the parser cannot say because it does not know the world. It leaves no trace in traced elements.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from slidectl.check.findings import Findings
from slidectl.check.joints import driven_joints
from slidectl.check.traced import plain
from slidectl.description.gazebo_tags import SIM_TYPES
from slidectl.description.report import Report
from slidectl.description.robot import ControlPlugin, Link, Robot, TransmissionInfo
from slidectl.description.transmissions import is_simulated
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile

TIMESTEP = 0.001
"""The daemon's own, s."""
_PLUGIN = "libgazebo_ros_control.so"


def say(robot: Robot, root: Element, report: Report) -> None:
    """What the world makes of single tags otherwise than written, for the report of the tree that they are in."""
    plugin = robot.plugin or ControlPlugin()
    if plugin.control_period is not None:
        _say_period(plugin.control_period, root, report)
    if plugin.robot_param != ControlPlugin.robot_param:
        text = f"{plugin.robot_param} is not looked for: the robot is what is spawned, and NAMESPACE/robot_description"
        report.converted(_first(root, "robotParam"), text)
    for transmission in robot.transmissions:
        _say_actuators(transmission, root, report)
    for link in robot.links.values():
        _say_friction(link, root, report)


def tell(robot: Robot, root: Element, namespace: str, findings: Findings) -> None:
    """Findings on the robot as a whole."""
    if not robot.is_fixed_to_world:
        link = robot.links[robot.root]
        text = "note: the root is free and falls to the ground; a root link called 'world', or --fixed, holds a robot"
        findings.add("used", f"link {link.name!r}", text, link.file or "", link.line)
        if not any(link.collisions for link in robot.links.values()):
            text = "note: no link has a <collision>: it falls through the ground"
            findings.add("used", f"robot {robot.name!r}", text, root.file, root.line)
    _tell_plugin(robot, root, namespace, findings)
    _tell_refusals(robot, findings)


def _tell_refusals(robot: Robot, findings: Findings) -> None:
    """What the parser lets pass with a remark, and the simulation does not let in."""
    plugin = robot.plugin
    if plugin is not None and plugin.robot_sim_type not in SIM_TYPES:
        text = f"robotSimType {plugin.robot_sim_type} is unknown"
        findings.refuse(BadFile(text, plugin.file, plugin.line, f"there is {SIM_TYPES[0]}"))
    for transmission in robot.transmissions:
        interface = transmission.joints[0].hardware_interfaces[0]
        if len(transmission.joints) == 1 and not is_simulated(interface):
            text = f"transmission {transmission.name!r}: {interface} is no interface of simulated joints"
            findings.refuse(BadFile(text, transmission.file, transmission.line))


def _tell_plugin(robot: Robot, root: Element, namespace: str, findings: Findings) -> None:
    plugin = robot.plugin
    driven = driven_joints(robot)
    if plugin is not None:
        subject, file = f"plugin {_PLUGIN}", plugin.file or ""
        findings.add("used", subject, f"note: controllers live in the namespace {namespace}", file, plugin.line)
        if not driven:
            findings.add("used", subject, "note: without a transmission it drives no joint", file, plugin.line)
    elif driven:
        text = f"has transmissions but no {_PLUGIN}; here it is driven all the same, in the namespace {namespace}"
        findings.add("converted", f"robot {robot.name!r}", text, root.file, root.line)


def _say_period(period: float, root: Element, report: Report) -> None:
    steps = max(1, math.ceil(period / TIMESTEP - 1e-6))
    if not math.isclose(steps * TIMESTEP, period, rel_tol=1e-6):
        text = f"{period:g} s is no whole number of the simulation's steps of {TIMESTEP:g} s"
        report.converted(_first(root, "controlPeriod"), f"{text}; controllers run every {steps * TIMESTEP:g} s")


def _say_actuators(transmission: TransmissionInfo, root: Element, report: Report) -> None:
    """The interface that counts is the joint's; an actuator may say the same, or nothing."""
    counts = transmission.joints[0].hardware_interfaces[0]
    whole = (tag for tag in _inside(root, "transmission") if _is_of(tag, transmission))
    for actuator in (actuator for tag in whole for actuator in _inside(tag, "actuator")):
        for place in _inside(actuator, "hardwareInterface"):
            written = plain(place).first_text
            if written and written.rpartition("/")[2] != counts.rpartition("/")[2]:
                text = f"{written} has no effect: the joint's interface counts, {counts}"
                report.ignored(place, text, f"transmission {transmission.name!r}/{actuator.title}")


def _is_of(tag: Element, transmission: TransmissionInfo) -> bool:
    """Whether a transmission was read from this tag: all those that a macro makes are in the same line."""
    if (tag.file, tag.line) != (transmission.file, transmission.line):
        return False
    if (plain(tag).get("name") or "").strip() != transmission.name:
        return False
    joint = transmission.joints[0]
    own = (child for child in _inside(tag, "joint") if (plain(child).get("name") or "").strip() == joint.name)
    interfaces = [plain(place).first_text for child in own for place in _inside(child, "hardwareInterface")]
    return joint.hardware_interfaces[0] in interfaces


def _say_friction(link: Link, root: Element, report: Report) -> None:
    first, second = link.surface.mu1, link.surface.mu2
    if first is None or second is None or first == second:
        return
    tags = [tag for tag in _inside(root, "gazebo") if plain(tag).get("reference") == link.name]
    for place in [tag for above in tags for tag in _inside(above, "mu2")]:
        text = f"has no effect: friction is the same in all directions here, and mu1 counts, {first:g}"
        report.ignored(place, text, f"link {link.name!r}/<mu2>")


def _inside(element: Element, tag: str) -> list[Element]:
    return plain(element).find_all(tag)


def _first(root: Element, tag: str) -> Element:
    """The first tag of that name, which is there."""
    return next(element for element in _walk(root) if element.tag == tag)


def _walk(element: Element) -> Iterator[Element]:
    for child in plain(element).children:
        yield child
        yield from _walk(child)
