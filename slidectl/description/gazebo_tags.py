"""`<gazebo>`: the control plugin, and what is said of links. All else in there is reported as ignored.

Texts are read as sdformat reads them: an attribute `value` goes before the text. Later tags win over earlier ones.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from slidectl import names
from slidectl.description import values
from slidectl.description.report import Report
from slidectl.description.robot import ControlPlugin, Surface
from slidectl.description.xml_tree import Element

_CONTROL_PLUGIN = "libgazebo_ros_control"
_SIM_TYPE = "gazebo_ros_control/DefaultRobotHWSim"
_PARAMETERS = {"robotNamespace", "robotParam", "robotSimType", "controlPeriod", "eStopTopic", "legacyModeNS"}
_YES = ("true", "yes", "1")
_NO = ("false", "no", "0")


class GazeboReader:
    """Reads the `<gazebo>` elements of one robot."""

    def __init__(self, report: Report, links: Collection[str], joints: Collection[str]) -> None:
        self.report = report
        self.links = links
        self.joints = joints
        self.plugin: ControlPlugin | None = None
        self.surfaces: dict[str, Surface] = {}

    def read(self, element: Element) -> None:
        """Take one `<gazebo>` in.

        Raises:
            BadFile: a malformed number or an impossible name.
        """
        self.report.unknown(element, {"reference"}, [child.tag for child in element.children])
        reference = element.get("reference")
        if not reference:
            self._of_model(element)
        elif reference in self.links:
            for child in element.children:
                self._of_link(reference, child, element)
        elif reference in self.joints:
            self._ignore_all(element, "tags of joints have no effect here")
        else:
            self.report.wrong(element, f"there is no link or joint {reference!r}; the tag has no effect")

    def _ignore_all(self, element: Element, why: str) -> None:
        for child in element.children:
            self.report.ignored(child, why, f"{element.title}/{child.title}")

    def _of_model(self, element: Element) -> None:
        for child in element.children:
            if child.tag == "plugin":
                self._plugin(child)
            else:
                hint = "; use --fixed to hold the robot" if child.tag == "static" else ""
                self.report.ignored(child, f"has no effect here{hint}", f"<gazebo>/{child.title}")

    def _plugin(self, element: Element) -> None:
        filename = (element.get("filename") or "").strip()
        place = f'<plugin name="{element.get("name") or ""}">'
        if filename.rpartition("/")[2].removesuffix(".so") != _CONTROL_PLUGIN:
            self.report.ignored(element, f"Gazebo plugins are not loaded: {filename or 'no filename'}", place)
        elif self.plugin is not None:
            self.report.ignored(element, f"only the first {_CONTROL_PLUGIN}.so counts, line {self.plugin.line}", place)
        else:
            self.plugin = self._control(element, place)

    def _control(self, element: Element, place: str) -> ControlPlugin:
        self.report.unknown(element, {"name", "filename"}, _PARAMETERS, place)
        found = {tag: child for tag in _PARAMETERS if (child := self.report.only(element, tag)) is not None}
        texts = {tag: _text(child) for tag, child in found.items()}
        sim_type = texts.get("robotSimType", _SIM_TYPE)
        if sim_type != _SIM_TYPE:
            text = f"robotSimType {sim_type} is unknown; there is {_SIM_TYPE} only"
            self.report.wrong(found["robotSimType"], text, place)
        if "legacyModeNS" in texts:
            self.report.ignored(found["legacyModeNS"], "legacyModeNS has no effect, as since ROS Melodic", place)
        return ControlPlugin(
            _namespace(element, texts.get("robotNamespace")),
            texts.get("robotParam") or "robot_description",
            sim_type,
            _period(element, texts.get("controlPeriod")),
            texts.get("eStopTopic") or None,
            element.line,
            element.file,
        )

    def _of_link(self, link: str, child: Element, element: Element) -> None:
        place = f"{element.title}/{child.title}"
        if child.tag in ("mu1", "mu2"):
            self._set(link, **{child.tag: self._friction(child, link)})
        elif child.tag in ("turnGravityOff", "selfCollide"):
            field = "turn_gravity_off" if child.tag == "turnGravityOff" else "self_collide"
            self._set(link, **{field: self._truth(child, place)})
        elif child.tag == "material":
            self._set(link, material=_text(child) or None)
        else:
            self.report.ignored(child, "has no effect here", place)

    def _set(self, link: str, **fields: Any) -> None:
        self.surfaces[link] = replace(self.surfaces.get(link, Surface()), **fields)

    def _friction(self, child: Element, link: str) -> float:
        value = values.parse_number(_text(child), child, f"link {link!r}: <{child.tag}>")
        if value < 0:
            raise child.error(f"link {link!r}: <{child.tag}> is {value:g}; it must not be negative")
        return value

    def _truth(self, child: Element, place: str) -> bool:
        text = _text(child).lower()
        if text not in _YES + _NO:
            self.report.wrong(child, f"{text!r} is neither true nor false and counts as false", place)
        return text in _YES


def _text(element: Element) -> str:
    value = element.get("value")
    return value.strip() if value is not None else element.first_text


def _namespace(plugin: Element, text: str | None) -> str | None:
    """The namespace as written; only a legal graph name will do. An empty one means the root."""
    if text is None:
        return None
    absolute = "/" + text.strip("/")
    if not names.is_legal(absolute):
        place = plugin.find("robotNamespace") or plugin
        raise place.error(f"robotNamespace {text!r} is not a legal name (letters, digits, '_' and '/')")
    return text


def _period(plugin: Element, text: str | None) -> float | None:
    if text is None:
        return None
    place = plugin.find("controlPeriod") or plugin
    period = values.parse_number(text, place, "controlPeriod")
    if period <= 0:
        raise place.error(f"controlPeriod is {period:g} s; it must be above 0")
    return period
