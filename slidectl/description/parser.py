"""URDF text into a Robot: reads the parts in order and lets structure.py check how they hang together.

Safe for texts from anybody: nothing is evaluated, fetched or written. What has no effect is in the robot's report.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypeVar

from slidectl.description import values, xml_tree
from slidectl.description.gazebo_tags import GazeboReader
from slidectl.description.joints import JointReader, tell_starts
from slidectl.description.links import LinkReader
from slidectl.description.materials import Materials
from slidectl.description.mesh_files import MeshFiles
from slidectl.description.packages import Packages
from slidectl.description.report import Report
from slidectl.description.rigid_bodies import WORLD, Weigher
from slidectl.description.robot import Robot, Surface, TransmissionInfo
from slidectl.description.structure import Elements, Structure
from slidectl.description.transmissions import TransmissionReader, driving, takes_positions
from slidectl.description.xml_tree import Element

_CHILDREN = {"link", "joint", "material", "transmission", "gazebo"}


class _Named(Protocol):
    @property
    def name(self) -> str: ...


Part = TypeVar("Part", bound=_Named)


def parse(
    xml: str | bytes,
    file: str = "robot_description",
    packages: Packages | None = None,
    base: Path | None = None,
    strict: bool = False,
) -> Robot:
    """The robot that a URDF text describes.

    `file` is the name in messages, unless the text carries a note of its sources. `packages` and `base` (the folder
    for relative paths) find meshes. Impossible masses and inertias, and shapes without a size, are mended or left out,
    with a notice; `strict` refuses them.

    Raises:
        BadFile: with file and line, and the link or joint by name.
    """
    return parse_tree(xml_tree.read(xml, file), MeshFiles(packages or Packages(start=base), base), Report(), strict)


def parse_tree(root: Element, meshes: MeshFiles, report: Report, strict: bool = False) -> Robot:
    """The robot of a tree of elements; what becomes of them is written into `report` on the way.

    Raises:
        BadFile: as parse; the report then holds what was said before.
    """
    if root.tag != "robot":
        raise root.error(f"the outermost element is <{root.tag}>, expected <robot>")
    return _RobotReader(root, meshes, report, strict).read()


class _RobotReader:
    def __init__(self, root: Element, meshes: MeshFiles, report: Report, strict: bool) -> None:
        self.root = root
        self.report = report
        self.materials = Materials(report)
        self.meshes = meshes
        self.strict = strict

    def read(self) -> Robot:
        root, report = self.root, self.report
        name = values.required(root, "name", "robot")
        report.unknown(root, {"name", "version"}, _CHILDREN)
        self.materials.read_global(root.find_all("material"))
        reader = LinkReader(report, self.materials, self.meshes, self.strict)
        links, link_at = _named(root.find_all("link"), reader.read)
        joints, joint_at = _named(root.find_all("joint"), JointReader(report).read)
        base = Structure(links, joints, link_at, joint_at).check(root)
        self._check_world(base, link_at)
        links = Weigher(links, joints, link_at, report, self.strict).weigh(base)
        transmissions = self._transmissions(TransmissionReader(report, joints))
        # A position joint goes to its command, which is bounded by the limits, in the first steps.
        driven = (info.joints[0] for info in driving(transmissions))
        tell_starts(joints, joint_at, {joint.name for joint in driven if takes_positions(joint)}, report)
        gazebo = GazeboReader(report, links, joints)
        for element in root.find_all("gazebo"):
            gazebo.read(element)
        links = {key: replace(link, surface=gazebo.surfaces.get(key, Surface())) for key, link in links.items()}
        sensors = tuple(gazebo.sensors.sensors)
        return Robot(name, links, joints, base, transmissions, gazebo.plugin, report.notices(root), sensors)

    def _check_world(self, base: str, link_at: Elements) -> None:
        inertial = link_at[base].find("inertial") if base == WORLD else None
        if inertial is not None:
            self.report.ignored(inertial, "the world does not move", f"link {base!r}/<inertial>")

    def _transmissions(self, reader: TransmissionReader) -> tuple[TransmissionInfo, ...]:
        read = (reader.read(element) for element in self.root.find_all("transmission"))
        return tuple(info for info in read if info is not None)


def _named(elements: Iterable[Element], read: Callable[[Element], Part]) -> tuple[dict[str, Part], dict[str, Element]]:
    """The parts by name, and their elements by name.

    Raises:
        BadFile: two of one name.
    """
    parts: dict[str, Part] = {}
    places: dict[str, Element] = {}
    for element in elements:
        part = read(element)
        if part.name in parts:
            first = places[part.name]
            other = f"{first.file}:{first.line}"
            raise element.error(f"{element.tag} {part.name!r} is there twice; the other is at {other}")
        parts[part.name] = part
        places[part.name] = element
    return parts, places
