"""Parses URDF text into a Robot: links, joints, materials, the tree of links, and the masses.

urdfdom's rules say what is mandatory, sdformat's what swapped limits mean. Nothing is evaluated, downloaded or
written. Against: a text that a client spawns. The robot's report lists what has no effect. `<transmission>` is in
transmissions.py, `<gazebo>` in gazebo_tags.py, masses and inertias are in rigid_bodies.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast, get_args

from slidectl.description import element_values, xml_tree
from slidectl.description.gazebo_tags import GazeboReader, control_plugins
from slidectl.description.mesh_files import SUFFIXES, ForbiddenMeshes, MeshFiles, MissingMesh, UnknownMesh
from slidectl.description.packages import Packages
from slidectl.description.report import Report, one_line
from slidectl.description.rigid_bodies import WORLD, InertiaCorrector
from slidectl.description.robot import (
    MOVING,
    Box,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    JointType,
    Limit,
    Link,
    Material,
    Mesh,
    Mimic,
    Pose,
    Robot,
    Safety,
    Shape,
    Sphere,
    Surface,
    TransmissionInfo,
    Vector,
)
from slidectl.description.ros2_control import TAG, Ros2Control, Ros2ControlReader, start_positions
from slidectl.description.transmissions import TransmissionReader, driving, has_position_command
from slidectl.description.xml_tree import Element
from slidectl.errors import listing
from slidectl.input_files import ReadInput, from_disk

DEEPEST = 1000
"""The most joints between the root and a link. MuJoCo allows a few more, and takes minutes to refuse a longer chain."""
TOO_DEEP = f"its child hangs more than {DEEPEST} joints below the root"
STARTS_OUTSIDE = "the joint starts at 0, outside of its limits"
"""The beginning of the notice for such a joint. A caller that spawns the joint at another position may drop it."""

_CHILDREN = {"link", "joint", "material", "transmission", "gazebo", TAG}
_GEOMETRIES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("filename", "scale")}
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_TYPES: tuple[str, ...] = get_args(JointType)
_WITH_AXIS = ("revolute", "continuous", "prismatic", "planar")
_WITH_RANGE = ("revolute", "prismatic")
_OF_JOINT = {"parent", "child", "origin", "axis", "limit", "dynamics", "safety_controller", "mimic", "calibration"}


def parse(
    xml: str | bytes,
    file: str = "robot_description",
    packages: Packages | None = None,
    base: Path | None = None,
    strict: bool = False,
    *,
    may_use_files: bool = True,
    read: ReadInput = from_disk,
) -> Robot:
    """Parse the robot that a URDF text describes.

    `file` is its name in messages, unless the text has a note of its sources. `packages` and `base` (the folder for
    relative paths) find meshes, through `read`; without `may_use_files` none is looked up, and all are missing.
    Impossible masses and inertias are corrected, and shapes without a size are left out, each with a notice; `strict`
    refuses them.

    Raises BadFile: with file and line, and the link or joint by name.
    """
    meshes = MeshFiles(packages or Packages(start=base), base, read) if may_use_files else ForbiddenMeshes()
    return parse_tree(xml_tree.read(xml, file), meshes, Report(), strict)


def parse_tree(root: Element, meshes: MeshFiles, report: Report, strict: bool = False) -> Robot:
    """Parse a tree of elements; notices are added to `report`.

    Raises BadFile: as parse. If the report collects faults, it has them all, and this is the first.
    """
    if root.tag != "robot":
        raise root.error(f"the outermost element is <{root.tag}>, expected <robot>")
    name = element_values.required(root, "name", "robot")
    report.unknown(root, {"name", "version"}, _CHILDREN)
    link_reader = _LinkReader(report, meshes, strict)
    for element in root.find_all("material"):
        report.attempt(link_reader.global_material, element)
    joint_reader = _JointReader(report)
    links, link_at = _named(root, "link", link_reader.read, report)
    joints, joint_at = _named(root, "joint", joint_reader.read, report)
    # If a part cannot be read, the tree has gaps, and checks of the structure would report errors that are none.
    is_whole = len(links) == len(root.find_all("link")) and len(joints) == len(root.find_all("joint"))
    structure = _Structure(links, joints, link_at, joint_at, report)
    base = structure.check(root) if is_whole else None
    if not report.faults and base is not None:
        if base == WORLD and (inertial := link_at[base].find("inertial")) is not None:
            report.ignored(inertial, "the world does not move", f"link {base!r}/<inertial>")
        links = InertiaCorrector(links, joints, link_at, report, strict).weigh(base)
    # Texts where only tags can be. What is inside of `<gazebo>` is read by others.
    for element in (root, *(inside for part in root.children if part.tag != "gazebo" for inside in part.walk())):
        if stray := element.stray_text:
            report.wrong(element, f"the text {stray!r} has no effect: is it a tag without its '<'?")
    known = dict.fromkeys(part.get("name") or "" for part in root.find_all("link"))
    ends = {part.get("name") or "": (_end(part, "parent"), _end(part, "child")) for part in root.find_all("joint")}
    of_ros2 = _read_ros2_control(root, joints, is_whole, report)
    for name in of_ros2.changed if is_whole else ():
        report.attempt(structure.check_mimic, joint_at[name])
    gazebo = GazeboReader(report, known, ends, of_ros2.sensors)
    for element in root.find_all("gazebo"):
        gazebo.read(element)
    of_ros2.check_sensors([sensor.name for sensor in gazebo.sensors.sensors])
    control = of_ros2.result(gazebo.ros2_plugin)
    if is_whole:
        _follow_plugins(gazebo, joints, report)
        for name in gazebo.drives.mimics:
            report.attempt(structure.check_mimic, joint_at[name])
    transmissions = _read_transmissions(root, gazebo, control, joints, is_whole, report)
    # A position joint moves to its command, which the limits bound, in the first steps.
    moved = {joint.name for _, joint in driving(transmissions) if has_position_command(joint)}
    moved |= set(_starts(control, joints, report, joint_at))
    for joint in joints.values():
        limit = joint.limit if joint.type in _WITH_RANGE and joint.name not in moved else None
        if limit is not None and limit.lower != limit.upper and not limit.lower <= 0 <= limit.upper:
            text = f"{STARTS_OUTSIDE} {limit.lower:g} to {limit.upper:g}"
            report.wrong(joint_at[joint.name].find("limit") or joint_at[joint.name], text, place_of_limit(joint.name))
    if report.faults or base is None:
        raise report.faults[0]
    links = {key: replace(link, surface=gazebo.surfaces.get(key, Surface())) for key, link in links.items()}
    sensors, drives = tuple(gazebo.sensors.sensors), tuple(gazebo.drives.drives)
    return Robot(
        name, links, joints, base, transmissions, gazebo.plugin, report.notices(root), sensors, drives, control
    )


def _read_ros2_control(root: Element, joints: dict[str, Joint], is_whole: bool, report: Report) -> Ros2ControlReader:
    """Read the `<ros2_control>` tags, which may change what joints follow. Those of a robot of ROS 1 have no effect."""
    reader = Ros2ControlReader(report, joints, is_whole)
    of_ros1 = bool(control_plugins(root))
    for element in root.find_all(TAG):
        if of_ros1:
            text = "has no effect: the robot has the plugin of gazebo_ros_control, and its <transmission>s drive it"
            report.ignored(element, text)
        else:
            report.attempt(reader.read, element)
    return reader


def _follow_plugins(gazebo: GazeboReader, joints: dict[str, Joint], report: Report) -> None:
    """Let joints follow others as plugins of the model say."""
    for follower, (mimic, plugin) in list(gazebo.drives.mimics.items()):
        if (kind := joints[follower].type) not in MOVING:
            report.wrong(plugin, f"joint {follower!r} is {kind} and cannot follow; the plugin has no effect")
            continue
        if joints[follower].mimic not in (None, mimic):
            text = f"the plugin overrides the <mimic> of joint {follower!r}, which differs, as in Gazebo"
            report.wrong(plugin, text)
        joints[follower] = replace(joints[follower], mimic=mimic)


def _read_transmissions(
    root: Element,
    gazebo: GazeboReader,
    control: Ros2Control | None,
    joints: dict[str, Joint],
    is_whole: bool,
    report: Report,
) -> tuple[TransmissionInfo, ...]:
    """Read the `<transmission>`s. Those of a robot of ROS 2 have no effect."""
    elements = root.find_all("transmission")
    if control is not None:
        for element in elements:
            report.ignored(element, f"is of ROS 1 and has no effect: joints are driven by <{TAG}>")
        return ()
    is_real = gazebo.plugin is not None and gazebo.plugin.transmissions == "real"
    reader = TransmissionReader(report, joints, is_whole, is_real)
    read = (report.attempt(reader.read, element) for element in elements)
    return tuple(info for info in read if info is not None)


def _starts(
    control: Ros2Control | None, joints: Mapping[str, Joint], report: Report, joint_at: Mapping[str, Element]
) -> dict[str, float]:
    """Where joints of ROS 2 start. One beyond its limits is reported, and starts at the limit."""
    starts = {} if control is None else start_positions(control, joints)
    for name, position in starts.items():
        asked = control.joints[name].start if control is not None else None
        if asked is not None and asked != position:
            text = f"initial_value {asked:g} is beyond the limits: the joint starts at {position:g}"
            report.converted(joint_at[name], text, f"joint {name!r}")
    return starts


def _named(
    root: Element, tag: str, read: Callable[[Element], Any], report: Report
) -> tuple[dict[str, Any], dict[str, Element]]:
    """Read the elements `tag`. Returns the readable parts and their elements by name."""
    parts: dict[str, Any] = {}
    places: dict[str, Element] = {}

    def add(element: Element) -> Any:
        part = read(element)
        if part.name in parts:
            first = places[part.name]
            raise element.error(f"duplicate {tag} {part.name!r}; the first is at {first.file}:{first.line}")
        parts[part.name], places[part.name] = part, element
        return part

    for element in root.find_all(tag):
        report.attempt(add, element)
    return parts, places


def _end(joint: Element, tag: str) -> str:
    """The name of the parent or child link of a joint; empty when it is missing."""
    element = joint.find(tag)
    return (element.get("link") or "") if element is not None else ""


def place_of_limit(joint: str) -> str:
    """The subject of notices about a joint's range."""
    return f"joint {joint!r}/<limit>"


def is_moved_inside(subject: str, text: str, joints: Collection[str]) -> bool:
    """True for the notice that one of `joints` starts outside of its limits. These joints are spawned at positions in
    their limits, as other positions are refused."""
    return text.startswith(STARTS_OUTSIDE) and subject in map(place_of_limit, joints)


def _origin(report: Report, element: Element, owner: str) -> Pose:
    origin = report.only(element, "origin")
    if origin is not None:
        report.unknown(origin, {"xyz", "rpy"}, (), f"{owner}/<origin>")
    return element_values.pose(origin, owner)


# --- links ------------------------------------------------------------------------------------------------------------


class _LinkReader:
    """Reads `<link>` and `<material>` elements of one robot. `strict` refuses shapes without a size.

    As in urdfdom, a visual that names a material without defining it uses the global one, and a definition inside a
    visual becomes global if there is none of that name yet.
    """

    def __init__(self, report: Report, meshes: MeshFiles, strict: bool) -> None:
        self.report = report
        self.meshes = meshes
        self.strict = strict
        self.materials: dict[str, Material] = {}

    def read(self, element: Element) -> Link:
        name = element_values.required(element, "name", "link")
        owner = f"link {name!r}"
        self.report.unknown(element, {"name"}, {"inertial", "visual", "collision"})
        inertial = self.report.only(element, "inertial")
        return Link(
            name,
            self.report.attempt(self._inertial, inertial, owner) if inertial is not None else None,
            self._shapes(element, "visual", owner),
            self._shapes(element, "collision", owner),
            line=element.line,
            file=element.file,
        )

    def _inertial(self, element: Element, owner: str) -> Inertial:
        self.report.unknown(element, (), {"origin", "mass", "inertia"}, f"{owner}/<inertial>")
        mass = element_values.number(self._child(element, "mass", owner), "value", owner)
        origin = _origin(self.report, element, owner)
        tensor = self.report.only(element, "inertia")
        if tensor is None and not self.strict:
            text = "lacks <inertia>: it is read as zeros, which are then corrected"
            self.report.wrong(element, text, f"{owner}/<inertial>")
            return Inertial(origin, mass, (0.0,) * 6, element.line)
        tensor = self._child(element, "inertia", owner)
        self.report.unknown(tensor, _MOMENTS, (), f"{owner}/<inertia>")
        ixx, ixy, ixz, iyy, iyz, izz = (element_values.number(tensor, name, owner) for name in _MOMENTS)
        return Inertial(origin, mass, (ixx, ixy, ixz, iyy, iyz, izz), element.line)

    def _child(self, element: Element, tag: str, owner: str) -> Element:
        child = self.report.only(element, tag)
        if child is None:
            raise element.error(f"{owner}: <{element.tag}> lacks <{tag}>")
        return child

    def _shapes(self, link: Element, tag: str, owner: str) -> tuple[Shape, ...]:
        shapes = (self.report.attempt(self._shape, element, owner) for element in link.find_all(tag))
        return tuple(shape for shape in shapes if shape is not None)

    def _shape(self, element: Element, owner: str) -> Shape | None:
        """Read a visual or a collision; None when it has no size."""
        is_visual = element.tag == "visual"
        known = {"origin", "geometry", "material"} if is_visual else {"origin", "geometry"}
        self.report.unknown(element, {"name"}, known, f"{owner}/<{element.tag}>")
        inside = self.report.only(element, "geometry")
        if inside is None:
            self._leave_out(element, owner, f"<{element.tag}> lacks <geometry>")
        geometry = self._geometry(inside, owner, needed=not is_visual) if inside is not None else None
        material = self._material_of(element, owner) if is_visual else None
        origin = _origin(self.report, element, owner)
        if geometry is None:
            return None
        return Shape(geometry, origin, element.get("name"), material, element.line, element.file)

    def _leave_out(self, element: Element, owner: str, why: str) -> None:
        """Report a shape without a size, or raise BadFile."""
        if self.strict:
            raise element.error(f"{owner}: {why}")
        self.report.converted(element, f"{why}; the shape is left out", f"{owner}/{element.title}")

    def _geometry(self, element: Element, owner: str, *, needed: bool) -> Geometry | None:
        shapes = [child for child in element.children if child.tag in _GEOMETRIES]
        if not shapes:
            there = ", ".join(child.tag for child in element.children) or "nothing"
            why = f"<geometry> holds {there}; known shapes: {', '.join(_GEOMETRIES)}"
            if element.children:
                raise element.error(f"{owner}: {why}")
            self._leave_out(element, owner, why)
            return None
        self.report.unknown(element, (), _GEOMETRIES, f"{owner}/<geometry>")
        for extra in shapes[1:]:
            self.report.ignored(extra, "only the first shape of a <geometry> counts", f"{owner}/{extra.title}")
        shape = shapes[0]
        self.report.unknown(shape, _GEOMETRIES[shape.tag], (), f"{owner}/<{shape.tag}>")
        return self._mesh(shape, owner, needed) if shape.tag == "mesh" else self._primitive(shape, owner)

    def _primitive(self, shape: Element, owner: str) -> Geometry | None:
        made: Box | Sphere | Cylinder
        attributes = _GEOMETRIES[shape.tag]
        if shape.tag == "box":
            sizes: tuple[float, ...] = element_values.vector(shape, "size", owner)
            if min(sizes) < 0:
                raise shape.error(f"{owner}: edges of a <box> must be above 0, not {shape.get('size')!r}")
            made = Box((sizes[0], sizes[1], sizes[2]))
        else:
            sizes = tuple(element_values.not_negative(shape, name, owner) for name in attributes)
            made = Sphere(*sizes) if shape.tag == "sphere" else Cylinder(*sizes)
        # The physics uses half lengths, and half of the smallest float is 0.
        if min(sizes) / 2 == 0.0:
            written = ", ".join(f"{name} {shape.get(name)!r}" for name in attributes)
            self._leave_out(shape, owner, f"<{shape.tag}> with {written} has no volume")
            return None
        return made

    def _mesh(self, shape: Element, owner: str, needed: bool) -> Mesh | None:
        """Read a mesh. The file of a visual may be missing (it does not affect motion), that of a collision may not."""
        filename = shape.get("filename")
        if filename is not None and not filename.strip():
            self._leave_out(shape, owner, "attribute 'filename' of <mesh> is empty")
            return None
        uri = element_values.required(shape, "filename", owner)
        scale = element_values.vector(shape, "scale", owner) if "scale" in shape.attributes else (1.0, 1.0, 1.0)
        if 0.0 in scale:
            self._leave_out(shape, owner, f"<mesh> with scale {shape.get('scale')!r} has no volume")
            return None
        path, why = self.meshes.locate(uri, shape.file)
        trouble: type[MissingMesh | UnknownMesh] = MissingMesh
        if path is not None and not uri.strip().lower().endswith(SUFFIXES):
            path, why, trouble = None, f"is not of a known kind; known: {', '.join(SUFFIXES)}", UnknownMesh
        if path is None and needed:
            raise shape.error(f"{owner}: mesh {uri!r}: {why}", kind=trouble)
        if path is None:
            self.report.wrong(shape, f"{owner} is not drawn: {one_line(why)}")
        return Mesh(uri, str(path) if path is not None else None, scale)

    def global_material(self, element: Element) -> Material:
        """Read a `<material>` child of `<robot>`."""
        material = self._material(element, element_values.required(element, "name", "material"))
        if material.name in self.materials:
            self.report.wrong(element, "is defined twice; the first one counts")
        elif material.rgba is None and material.texture is None:
            self.report.wrong(element, "has neither <color> nor <texture>")
        return self.materials.setdefault(material.name, material)

    def _material_of(self, visual: Element, owner: str) -> Material | None:
        element = self.report.only(visual, "material")
        if element is None:
            return None
        material = self._material(element, element.get("name") or "")
        if material.rgba is not None or material.texture is not None:
            self.materials.setdefault(material.name, material)
            return material
        if material.name not in self.materials:
            self.report.wrong(element, f"{owner}: no material of that name is defined")
        return self.materials.get(material.name, material)

    def _material(self, element: Element, name: str) -> Material:
        self.report.unknown(element, {"name"}, {"color", "texture"})
        color = self.report.only(element, "color")
        texture = self.report.only(element, "texture")
        if texture is not None:
            self.report.unknown(texture, {"filename"}, ())
            self.report.ignored(texture, "textures are not drawn", f"{element.title}/{texture.title}")
        rgba = None
        if color is not None:
            self.report.unknown(color, {"rgba"}, ())
            red, green, blue, alpha = element_values.numbers(color, "rgba", 4, f"material {name!r}")
            rgba = red, green, blue, alpha
            if not all(0 <= part <= 1 for part in rgba):
                self.report.wrong(color, f"material {name!r}: parts of a colour lie between 0 and 1")
        return Material(name, rgba, texture.get("filename") if texture is not None else None)


# --- joints -----------------------------------------------------------------------------------------------------------


class _JointReader:
    """Reads `<joint>` elements of one robot."""

    def __init__(self, report: Report) -> None:
        self.report = report

    def read(self, element: Element) -> Joint:
        name = element_values.required(element, "name", "joint")
        owner = f"joint {name!r}"
        self.report.unknown(element, {"name", "type"}, _OF_JOINT)
        written = element_values.required(element, "type", owner)
        if written not in _TYPES:
            raise element_values.unknown(element, owner, "joint type", written, _TYPES)
        kind = cast(JointType, written)
        limit = self._part(element, "limit", self._limit, kind, owner)
        if limit is None and kind in _WITH_RANGE and element.find("limit") is None:
            stray = element.stray_text
            lost = f"there is a text {stray!r}: is it a tag without its '<'?" if stray else None
            hint = lost or "add <limit lower upper effort velocity/>"
            raise element.error(f"{owner} is {kind} and lacks <limit>", hint)
        damping, friction = self._part(element, "dynamics", self._dynamics, kind, owner) or (0.0, 0.0)
        for calibration in element.find_all("calibration"):
            self.report.ignored(calibration, "simulated joints need no calibration", f"{owner}/<calibration>")
        return Joint(
            name,
            kind,
            self._link(element, "parent", owner),
            self._link(element, "child", owner),
            _origin(self.report, element, owner),
            self._part(element, "axis", self._axis, kind, owner) or (1.0, 0.0, 0.0),
            limit,
            damping,
            friction,
            self._part(element, "safety_controller", self._safety, kind, owner, limit),
            self._part(element, "mimic", self._mimic, kind, owner),
            element.line,
            element.file,
        )

    def _part(self, element: Element, tag: str, read: Callable[..., Any], *values: Any) -> Any:
        """Read the child `tag` by calling `read`; None when there is no such child."""
        child = self.report.only(element, tag)
        return None if child is None else self.report.attempt(read, child, *values)

    def _ignore(self, element: Element, owner: str, why: str) -> None:
        self.report.ignored(element, why, f"{owner}/<{element.tag}>")

    def _link(self, element: Element, tag: str, owner: str) -> str:
        child = self.report.only(element, tag)
        if child is None:
            raise element.error(f"{owner} lacks <{tag}>")
        self.report.unknown(child, {"link"}, (), f"{owner}/<{tag}>")
        return element_values.required(child, "link", owner)

    def _axis(self, axis: Element, kind: JointType, owner: str) -> Vector | None:
        if kind not in _WITH_AXIS:
            self._ignore(axis, owner, f"a {kind} joint has no axis")
            return None
        self.report.unknown(axis, {"xyz"}, (), f"{owner}/<axis>")
        x, y, z = element_values.vector(axis, "xyz", owner)
        length = math.hypot(x, y, z)
        if not 0.0 < length < math.inf:
            raise axis.error(f"{owner}: <axis> is {axis.get('xyz')!r}, which is not a direction")
        if abs(length - 1.0) <= 1e-9:
            # Left as written: if the length is 1 within rounding errors, dividing would only change the last digit.
            return x, y, z
        self.report.converted(axis, f"made a unit vector; its length is {length:g}", f"{owner}/<axis>")
        return x / length, y / length, z / length

    def _limit(self, limit: Element, kind: JointType, owner: str) -> Limit | None:
        if kind not in MOVING:
            self._ignore(limit, owner, f"a {kind} joint has no limits")
            return None
        self.report.unknown(limit, {"lower", "upper", "effort", "velocity"}, (), f"{owner}/<limit>")
        effort = element_values.not_negative(limit, "effort", owner)
        velocity = element_values.not_negative(limit, "velocity", owner)
        lower, upper = self._range(limit, kind, owner)
        return Limit(lower, upper, velocity, effort, limit.line)

    def _range(self, limit: Element, kind: JointType, owner: str) -> tuple[float, float]:
        place = f"{owner}/<limit>"
        if kind == "continuous":
            for name in ("lower", "upper"):
                if name in limit.attributes:
                    self.report.ignored(limit, f"a continuous joint has no {name!r}", place, name)
            return 0.0, 0.0
        lower = element_values.number(limit, "lower", owner, 0.0)
        upper = element_values.number(limit, "upper", owner, 0.0)
        if lower > upper:
            self.report.converted(limit, f"lower {lower:g} is above upper {upper:g}; they are swapped", place)
            return upper, lower
        if lower == upper:
            self.report.wrong(limit, f"lower and upper are both {lower:g}: the joint cannot move", place)
        return lower, upper

    def _dynamics(self, dynamics: Element, kind: JointType, owner: str) -> tuple[float, float] | None:
        if kind == "fixed":
            self._ignore(dynamics, owner, "a fixed joint does not move")
            return None
        self.report.unknown(dynamics, {"damping", "friction"}, (), f"{owner}/<dynamics>")
        damping = element_values.not_negative(dynamics, "damping", owner, 0.0)
        return damping, element_values.not_negative(dynamics, "friction", owner, 0.0)

    def _safety(self, safety: Element, kind: JointType, owner: str, limit: Limit | None) -> Safety | None:
        place = f"{owner}/<safety_controller>"
        known = ("soft_lower_limit", "soft_upper_limit", "k_position")
        self.report.unknown(safety, {*known, "k_velocity"}, (), place)
        if limit is None:
            self._ignore(safety, owner, "the joint has no <limit>")
            return None
        lower, upper, k_position = (element_values.number(safety, name, owner, 0.0) for name in known)
        if kind in _WITH_RANGE:
            if lower > upper:
                self.report.wrong(safety, "soft_lower_limit is above soft_upper_limit", place)
            if lower < limit.lower or upper > limit.upper:
                hard = f"the hard ones, {limit.lower:g} to {limit.upper:g}"
                self.report.wrong(safety, f"soft limits {lower:g} to {upper:g} lie outside of {hard}", place)
            if k_position == 0.0:
                text = "with k_position 0 the soft limits allow no velocity at all"
                self.report.add("wrong", safety, text, place, "k_position")
        return Safety(lower, upper, k_position, element_values.number(safety, "k_velocity", owner))

    def _mimic(self, mimic: Element, kind: JointType, owner: str) -> Mimic | None:
        if kind not in MOVING:
            self._ignore(mimic, owner, f"a {kind} joint cannot follow another")
            return None
        self.report.unknown(mimic, {"joint", "multiplier", "offset"}, (), f"{owner}/<mimic>")
        multiplier, offset = (
            element_values.number(mimic, name, owner, default)
            for name, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        return Mimic(element_values.required(mimic, "joint", owner), multiplier, offset)


# --- the tree of links ------------------------------------------------------------------------------------------------


@dataclass
class _Structure:
    """Checks the links and joints of one robot, and knows their elements. Takes time linear in the size."""

    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    link_at: Mapping[str, Element]
    joint_at: Mapping[str, Element]
    report: Report
    above: dict[str, Joint] = field(default_factory=dict)
    """The joint above each link."""

    def check(self, robot: Element) -> str | None:
        """Check the structure. Returns the name of the root link; None when the report has collected an error.

        Raises BadFile: the links are no tree, a mimic joint follows a missing joint, or a chain of joints is too long.
        """
        if not self.links:
            raise robot.error("the robot has no link")
        elements = [self.joint_at[name] for name in self.joints]
        placed = [self.report.attempt(self._add_to_tree, element) for element in elements]
        root = self.report.attempt(self._root, robot) if all(placed) else None
        for element in elements:
            self.report.attempt(self.check_mimic, element)
        if root is not None and (joint := too_deep(root, self.joints)) is not None:
            raise self.joint_at[joint.name].error(f"joint {joint.name!r}: {TOO_DEEP}")
        return root

    def _add_to_tree(self, element: Element) -> bool:
        """Add a joint to the tree."""
        joint = self.joints[element.attributes["name"]]
        for role, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in self.links:
                raise element_values.unknown(element, f"joint {joint.name!r}: {role}", "link", name, self.links)
        first = self.above.setdefault(joint.child, joint)
        if first is not joint:
            raise element.error(f"link {joint.child!r} is the child of two joints, {first.name!r} and {joint.name!r}")
        return True

    def _root(self, _: Element) -> str:
        clear: set[str] = set()
        for name in self.links:
            self._check_way_up(name, clear)
        roots = [name for name in self.links if name not in self.above]
        if len(roots) > 1:
            raise self.link_at[roots[1]].error(
                f"the robot has more than one root link: {listing(roots)}",
                "join them by joints; every link but one is the child of a joint",
            )
        return roots[0]

    def _check_way_up(self, link: str, clear: set[str]) -> None:
        """Raise BadFile for a loop above `link`. `clear` holds the links that are known to have no loop above them."""
        way: dict[str, Joint] = {}
        while link in self.above and link not in clear:
            if link in way:
                circle = [link, *reversed(list(way)[list(way).index(link) + 1 :]), link]
                raise self.joint_at[way[link].name].error(f"links go round in a circle: {' - '.join(circle)}")
            way[link] = self.above[link]
            link = self.above[link].parent
        clear.update(way)

    def check_mimic(self, element: Element) -> bool:
        """Check that the mimic joint of this element follows an existing joint that moves. Raises BadFile."""
        joint = self.joints[element.attributes["name"]]
        if joint.mimic is None:
            return True
        master = self.joints.get(joint.mimic.joint)
        if master is None:
            raise element_values.unknown(
                element, f"joint {joint.name!r}: <mimic>", "joint", joint.mimic.joint, self.joints
            )
        if master.type not in MOVING:
            raise element.error(f"joint {joint.name!r} cannot mimic {master.name!r}, which is {master.type}")
        seen = [joint.name]
        while joint.mimic is not None and joint.mimic.joint in self.joints:
            joint = self.joints[joint.mimic.joint]
            if joint.name in seen:
                raise element.error(f"mimic joints go round in a circle: {' - '.join([*seen, joint.name])}")
            seen.append(joint.name)
        return True


def too_deep(root: str, joints: Mapping[str, Joint]) -> Joint | None:
    """A joint whose child is more than DEEPEST joints below the root, or None."""
    below: dict[str, list[Joint]] = {}
    for joint in joints.values():
        below.setdefault(joint.parent, []).append(joint)
    level = [root]
    for _ in range(DEEPEST):
        level = [joint.child for link in level for joint in below.get(link, ())]
    return next((joint for link in level for joint in below.get(link, ())), None)
