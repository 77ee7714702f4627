"""`<gazebo>` elements: plugins of the model, and properties of links. Everything else is reported as ignored.

Texts are read as by sdformat: an attribute `value` overrides the text. Later tags override earlier ones.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import chain
from typing import Any, cast, get_args

from slidectl import names
from slidectl.description import drives, element_values, interfaces, ros2_control
from slidectl.description.missing import Missing
from slidectl.description.report import Report
from slidectl.description.robot import ControlPlugin, Surface, Transmissions
from slidectl.description.sensors import OF_MODEL, SensorReader, library
from slidectl.description.xml_tree import Element
from slidectl.entry_points import Part, Registry
from slidectl.errors import NotThere, Refused, listing, quoted

_CONTROL_PLUGIN = "libgazebo_ros_control"
SIM_TYPES = (ControlPlugin.robot_sim_type, "DefaultRobotHWSim")
"""The names of the default simulated hardware."""
HARDWARE = Registry("slidectl.robot_hw", "robotSimType", lambda: SIM_TYPES)
"""Simulated hardware of installed packages: a type, and `module:Class`."""
TRANSMISSIONS = "gazebo_ros_control/transmissions"
"""The parameter in a robot's namespace that sets how transmissions count, unless the model's plugin sets it."""
_PARAMETERS = (
    "robotNamespace", "robotParam", "robotSimType", "controlPeriod", "eStopTopic", "legacyModeNS", "transmissions",
)  # fmt: skip
_OF_LINK = ("mu1", "mu2", "material", "selfCollide", "turnGravityOff")
_YES = ("true", "yes", "1")
_NO = ("false", "no", "0")


class GazeboReader:
    """Reads the `<gazebo>` elements of one robot. `joints` has the parent link and the child link of each joint."""

    def __init__(
        self,
        report: Report,
        links: Collection[str],
        joints: Mapping[str, tuple[str, str]],
        of_ros2: Collection[str] = (),
    ) -> None:
        """`of_ros2`: the sensors of a `<ros2_control>`, which controllers read."""
        self.report = report
        self.links = links
        self.joints = joints
        self.plugin: ControlPlugin | None = None
        self.ros2_plugin: Element | None = None
        """The first plugin with a controller manager of ROS 2."""
        self.surfaces: dict[str, Surface] = {}
        self.sensors = SensorReader(report, links, joints, of_ros2)
        self.drives = drives.DriveReader(report, joints)

    def read(self, element: Element) -> None:
        """Read one `<gazebo>` element. Raises BadFile: a malformed number or an impossible name."""
        self.report.unknown(element, {"reference"}, [child.tag for child in element.children])
        reference = element.get("reference") or ""
        if reference and reference not in self.links and reference not in self.joints:
            hint = self.report.meant(reference, chain(self.links, self.joints))
            self.report.wrong(element, f"there is no link or joint {reference!r}; the tag has no effect{hint}")
            return
        for child in element.children:
            if reference and reference in self.links:
                self.report.attempt(self._of_link, child, reference, element)
            elif reference:
                self.report.attempt(self._of_joint, child, reference, element)
            elif child.tag == "plugin":
                self.report.attempt(self._plugin, child)
            else:
                hint = "; use --fixed to hold the robot" if child.tag == "static" else ""
                self.report.ignored(child, f"has no effect here{hint}", f"<gazebo>/{child.title}")

    def _plugin(self, element: Element) -> bool:
        """Read a supported plugin; others are ignored. A file name close to the control plugin's is reported as a
        typing error."""
        filename = (element.get("filename") or "").strip()
        place = f'<plugin name="{element.get("name") or ""}">'
        if library(element) in OF_MODEL:
            self.sensors.of_model(element, place)
        elif library(element) in drives.DRIVES:
            self.drives.read_drive(element, library(element), place)
        elif library(element) in drives.MIMIC:
            self.drives.read_mimic(element, place)
        elif library(element) in ros2_control.PLUGINS:
            if self.ros2_plugin is not None:
                line = self.ros2_plugin.line
                self.report.ignored(element, f"only the first plugin of its kind counts, line {line}", place)
            else:
                self.ros2_plugin = element
        elif not _is_control(element):
            from difflib import get_close_matches

            # All plugins of gazebo_ros have similar names, so the cutoff is higher than for usual suggestions.
            if get_close_matches(filename, [_CONTROL_PLUGIN + ".so"], cutoff=0.85):
                self.report.wrong(element, f"there is no plugin {filename}; did you mean {_CONTROL_PLUGIN}.so?", place)
            else:
                self.report.ignored(element, f"Gazebo plugins are not loaded: {filename or 'no filename'}", place)
        elif self.plugin is not None:
            self.report.ignored(element, f"only the first {_CONTROL_PLUGIN}.so counts, line {self.plugin.line}", place)
        else:
            if library(element) != _CONTROL_PLUGIN:
                self.report.wrong(element, f"{filename} is read as {_CONTROL_PLUGIN}.so, on which it is based", place)
            self.plugin = self._control(element, place)
        return True

    def _control(self, element: Element, place: str) -> ControlPlugin:
        self.report.unknown(element, {"name", "filename"}, _PARAMETERS, place)
        found = {tag: child for tag in _PARAMETERS if (child := self.report.only(element, tag)) is not None}
        texts = {tag: _text(child) for tag, child in found.items()}
        if "legacyModeNS" in texts:
            self.report.ignored(found["legacyModeNS"], "legacyModeNS has no effect, as since ROS Melodic", place)
        namespace = texts.get("robotNamespace")
        if namespace is not None and not names.is_legal("/" + namespace.strip("/")):
            text = f"robotNamespace {namespace!r} is not a legal name (letters, digits, '_' and '/')"
            raise found["robotNamespace"].error(text)
        try:
            how = transmissions_named(texts["transmissions"]) if "transmissions" in texts else None
        except Refused as error:
            raise found["transmissions"].error(error.message) from None
        return ControlPlugin(
            namespace,
            texts.get("robotParam") or "robot_description",
            texts.get("robotSimType") or ControlPlugin.robot_sim_type,
            _period(found["controlPeriod"]) if "controlPeriod" in found else None,
            texts.get("eStopTopic") or None,
            element.line,
            element.file,
            how,
        )

    def _of_link(self, child: Element, link: str, element: Element) -> bool:
        place = f"{element.title}/{child.title}"
        if child.tag in ("mu1", "mu2"):
            self._set(link, **{child.tag: self._friction(child, f"link {link!r}: <{child.tag}>")})
        elif child.tag in ("turnGravityOff", "selfCollide"):
            field = "turn_gravity_off" if child.tag == "turnGravityOff" else "self_collide"
            self._set(link, **{field: self._truth(child, place)})
        elif child.tag == "sensor":
            self.sensors.of_link(link, child, place)
        elif child.tag == "material":
            self._set(link, material=_text(child) or None)
        elif child.tag == "plugin" and _is_control(child):
            self.report.wrong(child, "has no effect in here: it belongs in a <gazebo> without a reference", place)
        else:
            self.report.ignored(child, f"has no effect here{self.report.meant(child.tag, _OF_LINK, '<{}>')}", place)
        return True

    def _of_joint(self, child: Element, joint: str, element: Element) -> bool:
        place = f"{element.title}/{child.title}"
        if child.tag == "sensor":
            self.sensors.of_joint(joint, child, place)
        elif child.tag == "provideFeedback":
            self._truth(child, place)  # read for its notices: sensors measure in any case
        else:
            self.report.ignored(child, "tags of joints have no effect here, but <sensor>", place)
        return True

    def _set(self, link: str, **fields: Any) -> None:
        self.surfaces[link] = replace(self.surfaces.get(link, Surface()), **fields)

    def _friction(self, child: Element, place: str) -> float:
        """The friction coefficient. `Inf` is legal, and a negative value also means infinite, as in Gazebo."""
        value = element_values.parse_number(_text(child), child, place, finite=False)
        if value < 0:
            self.report.converted(child, f"{value:g} is below 0 and counts as infinite, as in Gazebo", place)
            return math.inf
        return value

    def _truth(self, child: Element, place: str) -> bool:
        text = _text(child).lower()
        if text not in _YES + _NO:
            self.report.wrong(child, f"{text!r} is neither true nor false and counts as false", place)
        return text in _YES


def leave_out_hardware(root: Element, missing: Missing) -> None:
    """Remove `<robotSimType>` tags with unknown simulated hardware, so that the default is used, and note each.

    Interfaces of transmissions that only the unknown hardware may have go with them.

    Not when nothing is missing and nothing may be, nor for a daemon that runs already: it may have imported more.
    """
    if missing.forgiven != "all" and (missing.world_decides or (not missing and not missing.keeps_going)):
        return
    for plugin in control_plugins(root):
        for kind in plugin.find_all("robotSimType"):
            known = (*SIM_TYPES, *installed_hardware())
            if _text(kind) in known:
                continue
            text = f"<robotSimType> {_text(kind)!r} is not simulated hardware; known: {listing(known)}"
            error = NotThere(text, kind.file, kind.line, thing=f"robotSimType {_text(kind)}")
            missing.note(error, "the default is used")
            plugin.remove(kind)
            _leave_out_interfaces(root, missing)


def _leave_out_interfaces(root: Element, missing: Missing) -> None:
    """Remove the interfaces of joints that the default hardware does not have, and transmissions without any other.

    All transmissions are one note, at the first of them.
    """
    left_out: list[Element] = []
    for transmission in root.find_all("transmission"):
        joints = transmission.find_all("joint")
        tags = [tag for joint in joints for tag in joint.find_all("hardwareInterface") if tag.first_text]
        unknown = [tag for tag in tags if interfaces.find(tag.first_text) is None]
        if unknown and len(unknown) == len(tags):
            left_out.append(transmission)
        for joint in joints:
            joint.remove(*unknown)
    root.remove(*left_out)
    if left_out:
        first = left_out[0]
        text = f"{first.title} has no interface of the default hardware"
        others = f", and {len(left_out) - 1} others have none either" if left_out[1:] else ""
        error = NotThere(f"{text}{others}", first.file, first.line, thing="transmissions of robotSimType")
        missing.note(error, "left out")


def installed_hardware() -> dict[str, Part]:
    """The simulated hardware in installed packages, by type."""
    return HARDWARE.parts()


def set_transmissions(root: Element, how: Transmissions) -> None:
    """Set `transmissions` of the control plugin; a robot without the plugin gets one."""
    plugin = next(iter(control_plugins(root)), None)
    if plugin is None:
        attributes = {"name": "gazebo_ros_control", "filename": f"{_CONTROL_PLUGIN}.so"}
        plugin = Element("plugin", attributes, root.file, root.line, [])
        root.content.append(Element("gazebo", {}, root.file, root.line, [plugin]))
    plugin.remove(*plugin.find_all("transmissions"))
    plugin.content.append(Element("transmissions", {}, plugin.file, plugin.line, [how]))


def control_plugins(root: Element) -> list[Element]:
    """The control plugins of the model; those inside a `<gazebo>` of a link or joint do not count."""
    models = (gazebo for gazebo in root.find_all("gazebo") if not gazebo.get("reference"))
    plugins = (plugin for gazebo in models for plugin in gazebo.find_all("plugin"))
    return [plugin for plugin in plugins if _is_control(plugin)]


def _is_control(plugin: Element) -> bool:
    """True for gazebo_ros_control, and for what a robot's makers have derived from it: `libNAME_gazebo_ros_control`."""
    name = library(plugin)
    return name == _CONTROL_PLUGIN or (name.startswith("lib") and name.endswith(f"_{_CONTROL_PLUGIN[3:]}"))


def _text(element: Element) -> str:
    value = element.get("value")
    return value.strip() if value is not None else element.first_text


def transmissions_named(text: str) -> Transmissions:
    """Check the value of `transmissions`. Raises Refused."""
    if text not in get_args(Transmissions):
        raise Refused(f"transmissions are {' or '.join(get_args(Transmissions))}, not {quoted(text)}")
    return cast(Transmissions, text)


def _period(element: Element) -> float:
    period = element_values.parse_number(_text(element), element, "controlPeriod")
    if not 0 < period <= element_values.LONGEST_PERIOD_S:
        bounds = f"above 0 and at most {element_values.LONGEST_PERIOD_S} s, the longest duration of ROS"
        raise element.error(f"controlPeriod is {period:g} s; it must be {bounds}")
    return period
