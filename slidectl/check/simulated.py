"""How the simulation takes a robot: its root, its control plugin, its transmissions, its friction.

What the parser cannot say because it does not know the world. Reads no XML but for the places of tags.
"""

from __future__ import annotations

import math

from slidectl.check.findings import Findings
from slidectl.check.joints import driven_joints
from slidectl.check.traced import plain
from slidectl.description.robot import Link, Robot, TransmissionInfo
from slidectl.description.xml_tree import Element

TIMESTEP = 0.001
"""The daemon's own, s."""
_PLUGIN = "libgazebo_ros_control.so"


def tell(robot: Robot, root: Element, namespace: str, findings: Findings) -> None:
    """Findings on the robot as a whole; `root` is the tree that it was read from."""
    _tell_root(robot, findings)
    _tell_plugin(robot, root, namespace, findings)
    for transmission in robot.transmissions:
        _tell_actuators(transmission, root, findings)
    for link in robot.links.values():
        _tell_friction(link, root, findings)


def _tell_root(robot: Robot, findings: Findings) -> None:
    if not robot.is_fixed_to_world:
        link = robot.links[robot.root]
        text = "note: the root is free and falls to the ground; a root link called 'world', or --fixed, holds a robot"
        findings.add("used", f"link {link.name!r}", text, link.file or "", link.line)


def _tell_plugin(robot: Robot, root: Element, namespace: str, findings: Findings) -> None:
    plugin = robot.plugin
    driven = driven_joints(robot)
    if plugin is None:
        if driven:
            text = f"has transmissions but no {_PLUGIN}; here it is driven all the same, in the namespace {namespace}"
            findings.add("converted", f"robot {robot.name!r}", text, root.file, root.line)
        return
    subject, file = f"plugin {_PLUGIN}", plugin.file or ""
    findings.add("used", subject, f"note: controllers live in the namespace {namespace}", file, plugin.line)
    if not driven:
        findings.add("used", subject, "note: there is no transmission, so it has no joint to drive", file, plugin.line)
    if plugin.control_period is not None:
        _tell_period(plugin.control_period, root, findings)


def _tell_period(period: float, root: Element, findings: Findings) -> None:
    steps = max(1, math.ceil(period / TIMESTEP - 1e-6))
    if not math.isclose(steps * TIMESTEP, period, rel_tol=1e-6):
        text = f"{period:g} s is no whole number of the simulation's steps of {TIMESTEP:g} s; controllers run every"
        place = _first(root, "controlPeriod") or root
        findings.add("converted", "<controlPeriod>", f"{text} {steps * TIMESTEP:g} s", place.file, place.line)


def _tell_actuators(transmission: TransmissionInfo, root: Element, findings: Findings) -> None:
    """The interface that counts is the joint's; an actuator may say the same, or nothing."""
    counts = transmission.joints[0].hardware_interfaces[0]
    for actuator in transmission.actuators:
        for interface in actuator.hardware_interfaces:
            if interface.rpartition("/")[2] != counts.rpartition("/")[2]:
                subject = f'transmission {transmission.name!r}/<actuator name="{actuator.name}">'
                text = f"its {interface} has no effect: the joint's interface counts, {counts}"
                place = _interface_of(root, transmission, actuator.name) or root
                findings.add("ignored", subject, text, place.file, place.line)


def _interface_of(root: Element, transmission: TransmissionInfo, actuator: str) -> Element | None:
    places = [tag for tag in root.children if (tag.file, tag.line) == (transmission.file, transmission.line)]
    inside = [tag for place in places for tag in place.children if tag.tag == "actuator"]
    named = [tag for tag in inside if plain(tag).get("name") == actuator]
    return next((interface for tag in named if (interface := _first(tag, "hardwareInterface"))), None)


def _tell_friction(link: Link, root: Element, findings: Findings) -> None:
    first, second = link.surface.mu1, link.surface.mu2
    if first is None or second is None or first == second:
        return
    tags = [tag for tag in root.children if tag.tag == "gazebo" and plain(tag).get("reference") == link.name]
    for place in [child for tag in tags for child in tag.children if child.tag == "mu2"][-1:]:
        text = f"has no effect: friction is the same in all directions here, and mu1 counts, {first:g}"
        findings.add("ignored", f"link {link.name!r}, mu2", text, place.file, place.line)


def _first(element: Element, tag: str) -> Element | None:
    return next((below for below in element.walk() if below.tag == tag), None)
