"""Converts the models of an SDF file or a Gazebo world to URDF: the surroundings of a robot.

Each part of a model that joints connect becomes one URDF document: unconnected links are separate bodies in Gazebo. A
static model is fixed to the link `world`. Pose elements nest as in SDF: model, link,
shape. Shapes, masses, friction, gravity and the joint types of URDF are converted; everything else is reported with its
line. Nothing is spawned here; the launch package reads the physics settings of worlds.

Source of the frames: the SDF 1.4 to 1.9 specification (`<pose>` is x y z roll pitch yaw in the parent's frame; a
joint's frame is given in its child's; `<axis>` is in the joint's frame since 1.5, in the model's before).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import unquote

from slidectl.description import install_rules, models, xml_tree
from slidectl.description.element_values import (
    LACKS_ANGLES,
    child_text,
    lacks_angles,
    parse_number,
    pose_numbers,
    text_numbers,
)
from slidectl.description.mesh_files import FORBIDDEN
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages, UnknownPackage, is_file, shown
from slidectl.description.robot import Notice, Verdict
from slidectl.description.xml_tree import Element, below
from slidectl.errors import NotThere, UsageError
from slidectl.rotations import ORIGIN, Pose, compose, conjugate, from_rpy, relative, rotate, to_rpy

SUFFIXES = (".sdf", ".world")
SCHEME = "model://"
GROUND_PLANE = "ground_plane"
SUN = "sun"
# Against: models that include each other.
_DEEPEST_INCLUDE = 10
_MOST_INCLUDES = 1000
_VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH")
_HOME = "~/.gazebo/models"

_JOINTS = ("revolute", "continuous", "prismatic", "fixed")
"""The joint types that URDF also has."""
_UNLIMITED = 1e16
NO_LIGHT = "has no effect: the light of pictures is that of the camera and the sun"
"""Said about lights other than the sun."""
_NOTHING_LIKE_IT = "has no effect: there is nothing like it here"
_QUIET = ("allow_auto_disable", "enable_wind", "kinematic", "must_be_base_link", "audio_source")
"""Tags without effect in a world of rigid bodies; they are not reported."""


@dataclass(frozen=True)
class SdfModel:
    """One connected part of a model: one robot."""

    name: str
    first: str
    """The name of the first part of its `<model>`."""
    xml: str
    """URDF with the note of its sources."""
    pose: Pose
    """The pose of the part's root link in the world."""
    is_static: bool
    file: str
    line: int


@dataclass
class Scene:
    """The models of a file, True if it has a ground plane, and notices about the rest."""

    models: list[SdfModel] = field(default_factory=list)
    has_ground: bool = False
    notices: list[Notice] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """The models, by the names of their first parts."""
        return list(dict.fromkeys(model.first for model in self.models))

    def named(self, name: str | None) -> list[SdfModel]:
        """The parts, with the model renamed to `name`. Further parts keep the suffix that they add to the first's name.

        Raises UsageError: a name is given, but there is not exactly one model.
        """
        if name is None:
            return self.models
        if len(self.names) != 1:
            raise UsageError(f"a name goes with one model, and there are {len(self.names)}", "leave the name out")
        return [replace(model, name=name + model.name.removeprefix(model.first), first=name) for model in self.models]


class SdfFiles:
    """Finds `model://NAME` folders and the files named in SDF: by GAZEBO_MODEL_PATH, beside the file, by package."""

    def __init__(self, packages: Packages, base: Path | None) -> None:
        self.packages = packages
        self.base = base

    def folder(self, name: str, element: Element) -> Path:
        """Find the folder of a model. Raises NotThere."""
        looked = list(dict.fromkeys(self._folders(element)))
        for place in looked:
            if (place / name).is_dir():
                return place / name
        try:
            return self.packages.find(name)
        except UnknownPackage:
            shown = ", ".join(str(place) for place in looked)
            text = f"model {name!r} is not there; looked in {shown}"
            hint = f"set GAZEBO_MODEL_PATH to the folder that holds {name}/"
            raise NotThere(text, element.file, element.line, hint, f"model {name}") from None

    def model_file(self, uri: str, element: Element) -> Path:
        """Find the SDF file of an `<include>`. Raises NotThere."""
        place = self.resolve(uri, element)
        if not place.is_dir():
            return place
        return place / (_named_in_config(place / "model.config") or "model.sdf")

    def resolve(self, uri: str, element: Element) -> Path:
        """The file or folder of a uri. Raises NotThere."""
        scheme, separator, rest = uri.partition("://")
        if not separator:
            return install_rules.located(self._beside(element) / uri)
        if scheme == "file":
            path = Path(unquote(rest)) if rest.startswith("/") else self._beside(element) / unquote(rest)
            return install_rules.located(path)
        if scheme in ("model", "package"):
            name, _, inside = rest.partition("/")
            return install_rules.located(self.folder(unquote(name), element) / unquote(inside))
        raise NotThere(f"{uri!r} cannot be read from here; model://, file:// and paths can", element.file, element.line)

    def _beside(self, element: Element) -> Path:
        here = Path(element.file)
        return here.absolute().parent if is_file(here) else self.base or Path.cwd()

    def _folders(self, element: Element) -> Iterator[Path]:
        for variable in _VARIABLES:
            yield from (Path(os.path.expanduser(entry)) for entry in os.environ.get(variable, "").split(":") if entry)
        beside = self._beside(element)
        yield from (beside, beside / "models", beside.parent, beside.parent / "models")
        yield Path(os.path.expanduser(_HOME))


class ForbiddenFiles(SdfFiles):
    """For the SDF of clients that may name no files: nothing is looked up, so nothing is learned about the disk."""

    def __init__(self) -> None:
        super().__init__(Packages(), None)

    def model_file(self, uri: str, element: Element) -> Path:
        return self.resolve(uri, element)

    def resolve(self, uri: str, element: Element) -> Path:
        raise NotThere(f"{uri!r}: {FORBIDDEN}", element.file, element.line)


def is_scene(source: str) -> bool:
    """True when the text means SDF: a file with such a suffix, or `model://NAME`."""
    return source.startswith(SCHEME) or source.lower().endswith(SUFFIXES)


def is_urdf(text: str) -> bool:
    """True when the text is URDF. Raises BadFile: not XML."""
    return xml_tree.read(text, "model_xml").tag == "robot"


def find(source: str, packages: Packages | None = None) -> Path:
    """The file that `source` means. Raises NotThere."""
    if not source.startswith(SCHEME):
        return Path(os.path.expanduser(source))
    try:
        return SdfFiles(packages or Packages(start=Path.cwd()), Path.cwd()).model_file(
            source, Element("include", {}, "", 0)
        )
    except NotThere as error:
        raise NotThere(error.reason, hint=error.hint, thing=error.thing) from None


def read(path: Path, packages: Packages | None = None, missing: Missing | None = None) -> Scene:
    """The scene of an SDF or world file.

    `missing` collects the models and meshes that it names and that do not exist; these are left out.

    Raises BadFile: missing, not SDF, or broken (file, line). NotThere: a model or a mesh, without `missing`.
    """
    base = path.absolute().parent
    places = packages.starting_at(base) if packages is not None else None
    return parse(models.read_file(path), shown(path), places, base, missing)


def parse(
    text: str | bytes,
    file: str = "<text>",
    packages: Packages | None = None,
    base: Path | None = None,
    missing: Missing | None = None,
    *,
    may_use_files: bool = True,
) -> Scene:
    """As read, for a text; `base` is the folder for relative paths. Without `may_use_files` all files are missing."""
    root = xml_tree.read(text, file)
    if root.tag not in ("sdf", "gazebo", "world", "model"):
        raise root.error(f"this is not SDF: its outermost element is <{root.tag}>, expected <sdf>")
    files = SdfFiles(packages or Packages(start=base), base) if may_use_files else ForbiddenFiles()
    reader = _SceneReader(files, missing)
    reader.read(root, root.get("version") or "1.6")
    is_empty = not reader.scene.models and not reader.scene.has_ground and not missing
    if is_empty and root.tag != "world" and root.find("world") is None:
        raise root.error("there is no <model> in it")
    return reader.scene


class _SceneReader:
    """Reads worlds, models and includes into a scene."""

    def __init__(self, files: SdfFiles, missing: Missing | None) -> None:
        self.files = files
        self.missing = missing
        self.scene = Scene()
        self.names: set[str] = set()
        self.depth = 0
        self.includes = 0

    def say(self, verdict: Verdict, element: Element, text: str) -> None:
        self.scene.notices.append(Notice(verdict, element.title, text, element.file, element.line))

    def say_unknown(self, element: Element, known: Collection[str]) -> None:
        """Report the children of an element that are not read."""
        for child in element.children:
            if child.tag not in known:
                self.say("ignored", child, f"has no effect in <{element.tag}>: there is nothing like it here")

    def absent(self, error: NotThere, loss: str) -> None:
        """Note a missing thing in `missing`, or raise the error without it."""
        if self.missing is None:
            raise error
        self.missing.note(error, loss)

    def read(self, root: Element, version: str) -> None:
        """Read the first world, and the models beside it."""
        if root.tag == "model":
            return self.model(root, version)
        worlds = [root] if root.tag == "world" else root.find_all("world")
        for extra in worlds[1:]:
            self.say("wrong", extra, "only the first world of a file is used")
        states = _states(worlds[0]) if worlds else {}
        for holder in dict.fromkeys((root, *worlds[:1])):
            for element in holder.children:
                try:
                    if element.tag == "model":
                        self.model(element, version, at=states.get(element.get("name") or ""))
                    elif element.tag == "include":
                        self.include(element, states)
                except NotThere as error:
                    self.absent(error, "the model is left out")
        return None

    def include(self, element: Element, states: dict[str, Pose]) -> None:
        """Read the model of an `<include>`, whose tags override the model's."""
        short = _short(child_text(element, "uri", ""))
        if short == SUN:
            return
        if short == GROUND_PLANE:
            self.scene.has_ground = True
            return
        pose, static = element.find("pose"), element.find("static")
        self.say_unknown(element, ("uri", "name", "pose", "static"))
        with self.included(element) as (model, version):
            name = child_text(element, "name", model.get("name") or short)
            at = states.get(name) or (_pose(pose) if pose is not None else None)
            self.model(model, version, name, at, static)

    @contextmanager
    def included(self, element: Element) -> Iterator[tuple[Element, str]]:
        """The `<model>` of an `<include>`, and its version of SDF. Raises BadFile, NotThere."""
        uri = child_text(element, "uri", "")
        if not uri:
            raise element.error("<include> lacks <uri>")
        self.includes += 1
        if self.depth >= _DEEPEST_INCLUDE:
            raise element.error(f"<include> is nested deeper than {_DEEPEST_INCLUDE}")
        if self.includes > _MOST_INCLUDES:
            raise element.error(f"there are more than {_MOST_INCLUDES} <include>")
        path = self.files.model_file(uri, element)
        root = xml_tree.read(models.read_file(path), str(path))
        model = root if root.tag == "model" else root.find("model")
        if model is None:
            raise root.error(f"there is no <model> in it; {element.file}:{element.line} includes it")
        self.depth += 1
        try:
            yield model, root.get("version") or "1.6"
        finally:
            self.depth -= 1

    def model(
        self,
        element: Element,
        version: str,
        name: str | None = None,
        at: Pose | None = None,
        static: Element | None = None,
    ) -> None:
        """Read one model: its links and joints, and those of nested models. `at` and `static` replace its own."""
        title = name or element.get("name") or "model"
        if title == GROUND_PLANE or is_ground(element):
            self.scene.has_ground = True
            return
        for pose in filter(lacks_angles, element.walk()):
            self.say("wrong", pose, LACKS_ANGLES)
        part = _ModelReader(self, title, element, version)
        part.read(element, ORIGIN, "")
        is_static = _truth(element.find("static") if static is None else static)
        # All parts, or none if a file is missing.
        self.scene.models += list(part.parts(_pose_of(element) if at is None else at, is_static))

    def free_name(self, wanted: str) -> str:
        """A legal and unused robot name, made from `wanted`."""
        base = re.sub(r"[^A-Za-z0-9_]+", "_", wanted).strip("_") or "model"
        base = base if not base[0].isdigit() else f"model_{base}"
        name, number = base, 1
        while name in self.names:
            number += 1
            name = f"{base}_{number}"
        self.names.add(name)
        return name


@dataclass
class _SdfLink:
    element: Element
    pose: Pose
    """The link's pose in the model's frame."""


@dataclass
class _SdfJoint:
    element: Element
    name: str
    parent: str
    child: str
    frame: Pose
    """The joint's pose in the child's frame."""


class _ModelReader:
    """Reads the links and joints of one model, including nested ones, and makes the URDF of its parts."""

    def __init__(self, scene: _SceneReader, name: str, element: Element, version: str) -> None:
        self.scene = scene
        self.name = name
        self.element = element
        self.axis_in_model = _version(version) < (1, 5)
        self.links: dict[str, _SdfLink] = {}
        self.joints: dict[str, _SdfJoint] = {}
        self.first = ""
        """The name of the first part."""

    # --- reading -----------------------------------------------------------------------------------------------------

    def read(self, model: Element, frame: Pose, prefix: str) -> None:
        """Read the links and joints of a model whose pose is `frame`; names in nested models begin with `prefix`."""
        for element in model.children:
            if element.tag == "link":
                name = prefix + (element.get("name") or "link")
                if name in self.links:
                    raise element.error(f"model {self.name!r}: duplicate link {name!r}")
                self.links[name] = _SdfLink(element, compose(frame, _pose_of(element)))
            elif element.tag == "joint":
                self._joint(element, prefix)
            elif element.tag == "model":
                inner = compose(frame, _pose_of(element))
                self.read(element, inner, f"{prefix}{element.get('name') or 'model'}::")
            elif element.tag == "include":
                self.scene.say_unknown(element, ("uri", "name", "pose"))
                with self.scene.included(element) as (inside, _):
                    placed = _pose_of(element if element.find("pose") is not None else inside)
                    name = child_text(element, "name", inside.get("name") or "model")
                    self.read(inside, compose(frame, placed), f"{prefix}{name}::")
            elif element.tag == "plugin":
                self.scene.say("wrong", element, "plugins of Gazebo have no effect")
            elif element.tag not in ("pose", "static", "self_collide", *_QUIET):
                self.scene.say("ignored", element, _NOTHING_LIKE_IT)

    def _joint(self, element: Element, prefix: str) -> None:
        name = prefix + (element.get("name") or "joint")
        self.scene.say_unknown(element, ("parent", "child", "pose", "axis"))
        ends = {}
        for end in ("parent", "child"):
            written = child_text(element, end, "")
            if not written:
                raise element.error(f"joint {name!r} lacks <{end}>")
            ends[end] = written if written == "world" else prefix + written
        if ends["child"] == "world":
            raise element.error(f"joint {name!r}: the world cannot be the child of a joint")
        if name in self.joints:
            raise element.error(f"model {self.name!r}: duplicate joint {name!r}")
        self.joints[name] = _SdfJoint(element, name, ends["parent"], ends["child"], _pose_of(element))

    # --- parts -------------------------------------------------------------------------------------------------------

    def parts(self, place: Pose, is_static: bool) -> Iterator[SdfModel]:
        """The parts of the model, with poses in the world; `place` is the pose of the model's frame."""
        if not self.links:
            raise self.element.error(f"model {self.name!r} has no <link>")
        above = self._above()
        if is_static:
            yield self._static(place)
            return
        groups: dict[str, list[str]] = {}
        for link in self.links:
            groups.setdefault(_root(link, above), []).append(link)
        loose = [root for root in groups if root != "world"]
        if len(loose) > 1:
            text = f"has links without a joint between them: {', '.join(loose)}; each becomes a robot of its own"
            self.scene.say("converted", self.element, text)
        for index, (root, members) in enumerate(groups.items()):
            name = self.name if index == 0 else f"{self.name}_{root}"
            yield self._part(name, root, members, above, place)

    def _above(self) -> dict[str, _SdfJoint]:
        """The parent joint of each link. Raises BadFile: unknown links, loops, or a link with two parent joints."""
        above: dict[str, _SdfJoint] = {}
        for joint in self.joints.values():
            for link in (joint.parent, joint.child):
                if link not in self.links and link != "world":
                    known = ", ".join(self.links)
                    raise joint.element.error(f"joint {joint.name!r}: no link {link!r}", f"links: {known}")
            if joint.child in above:
                text = f"link {joint.child!r} is the child of two joints: {above[joint.child].name} and {joint.name}"
                raise joint.element.error(text, "a robot here is a tree; remove one of them")
            above[joint.child] = joint
        for link in above:
            _root(link, above)
        return above

    def _static(self, place: Pose) -> SdfModel:
        """The model with all links fixed to the world: joints of a static model do not move."""
        urdf = self._urdf(self.name)
        urdf.content.append(_made("link", self.element, name="world"))
        for name, link in self.links.items():
            at = link.element
            ends = _made("parent", at, link="world"), _made("child", at, link=name)
            urdf.content.extend(self._link(name, link, ORIGIN))
            urdf.content.append(
                _made("joint", at, _origin(link.pose, at), *ends, name=f"world_to_{name}", type="fixed")
            )
        return self._model(urdf, place, is_static=True)

    def _part(self, name: str, root: str, members: list[str], above: dict[str, _SdfJoint], place: Pose) -> SdfModel:
        urdf = self._urdf(name)
        if root == "world":
            urdf.content.append(_made("link", self.element, name="world"))
        frames = {"world": ORIGIN}
        for link in members:
            pose = self.links[link].pose
            frames[link] = compose(pose, above[link].frame) if link in above else pose
        for link in members:
            shift = relative(self.links[link].pose, frames[link])
            urdf.content.extend(self._link(link, self.links[link], shift))
        for link in members:
            if link in above:
                urdf.content.append(self._urdf_joint(above[link], frames))
        return self._model(urdf, compose(place, frames[root]), is_static=False)

    def _model(self, urdf: Element, pose: Pose, *, is_static: bool) -> SdfModel:
        name = urdf.attributes["name"]
        self.first = self.first or name
        return SdfModel(name, self.first, xml_tree.write(urdf), pose, is_static, self.element.file, self.element.line)

    def _urdf(self, name: str) -> Element:
        return _made("robot", self.element, name=self.scene.free_name(name))

    # --- URDF --------------------------------------------------------------------------------------------------------

    def _link(self, name: str, link: _SdfLink, shift: Pose) -> Iterator[Element]:
        """The URDF link and its `<gazebo>`; `shift` is the pose of SDF's link frame in URDF's link frame."""
        made = _made("link", link.element, self._inertial(link.element, shift), name=name)
        gazebo = _made("gazebo", link.element, reference=name)
        for element in link.element.children:
            if element.tag in ("collision", "visual"):
                shape = self._shape(element, shift)
                if shape is not None:
                    made.content.append(shape)
                if element.tag == "collision":
                    gazebo.content += self._friction(element)
                    text = "has no effect: contacts here do not bounce"
                    self._report_unless_zero(below(element, "surface", "bounce"), ("restitution_coefficient",), text)
            elif element.tag == "gravity":
                gazebo.content.append(_made("turnGravityOff", element, "false" if _truth(element) else "true"))
            elif element.tag == "self_collide":
                gazebo.content.append(_made("selfCollide", element, "true" if _truth(element) else "false"))
            elif element.tag == "velocity_decay":
                text = "has no effect: bodies here have no damping of their own, joints have"
                self._report_unless_zero(element, ("linear", "angular"), text)
            elif element.tag == "light":
                self.scene.say("ignored", element, NO_LIGHT)
            elif element.tag == "sensor":
                self.scene.say("wrong", element, "sensors of a world's models have no effect")
            elif element.tag not in ("pose", "inertial", *_QUIET):
                self.scene.say("ignored", element, _NOTHING_LIKE_IT)
        yield made
        if gazebo.content:
            yield gazebo

    def _report_unless_zero(self, element: Element | None, tags: Collection[str], text: str) -> None:
        """Report an element without effect if one of its children `tags` has another number than 0."""
        if element is not None and any(child.tag in tags and _number(child) for child in element.children):
            self.scene.say("ignored", element, text)

    def _inertial(self, link: Element, shift: Pose) -> Element:
        """The `<inertial>`; defaults are SDF's, 1 kg and moments of 1 kg·m²."""
        inertial = link.find("inertial")
        element = inertial or link
        pose = _pose_of(inertial) if inertial is not None else ORIGIN
        mass, tensor = below(inertial, "mass"), below(inertial, "inertia")
        moments = {"ixx": "1", "ixy": "0", "ixz": "0", "iyy": "1", "iyz": "0", "izz": "1"}
        for moment in tensor.children if tensor is not None else []:
            if moment.tag in moments:
                moments[moment.tag] = repr(_number(moment))
        return _made(
            "inertial",
            element,
            _origin(compose(shift, pose), element),
            _made("mass", mass or element, value=repr(_number(mass)) if mass is not None else "1"),
            _made("inertia", element, **moments),
        )

    def _shape(self, element: Element, shift: Pose) -> Element | None:
        """A `<visual>` or `<collision>`; None when URDF has no such shape."""
        geometry = element.find("geometry")
        found = geometry.children[0] if geometry is not None and geometry.children else None
        if found is None or found.tag == "empty":
            return None
        try:
            made_shape = self._geometry(found)
        except NotThere as error:
            if element.tag == "collision":
                self.scene.absent(error, "the <collision> is left out")
            else:
                self.scene.say("ignored", found, f"is left out: {error.reason}")
            return None
        if made_shape is None:
            known = "box, sphere, cylinder and mesh"
            self.scene.say("wrong", found, f"is left out: the shapes here are {known}")
            return None
        origin = _origin(compose(shift, _pose_of(element)), element)
        name = element.get("name") or element.tag
        made = _made(element.tag, element, origin, _made("geometry", found, made_shape), name=name)
        colour = _colour(element.find("material"))
        if element.tag == "visual" and colour:
            inside = _made("color", element, rgba=colour)
            made.content.append(_made("material", element, inside, name=f"{element.get('name')}_material"))
        return made

    def _geometry(self, shape: Element) -> Element | None:
        if shape.tag == "box":
            return _made("box", shape, size=_numbers(_values(_child(shape, "size"), 3)))
        if shape.tag == "sphere":
            return _made("sphere", shape, radius=repr(_number(_child(shape, "radius"))))
        if shape.tag == "cylinder":
            radius, length = (repr(_number(_child(shape, name))) for name in ("radius", "length"))
            return _made("cylinder", shape, radius=radius, length=length)
        if shape.tag == "mesh":
            uri = _child(shape, "uri")
            path = self.scene.files.resolve(uri.first_text, uri)
            if not is_file(path):
                text = f"mesh {uri.first_text!r}: no such file; looked for {path}"
                raise NotThere(text, uri.file, uri.line, None, f"mesh {uri.first_text}")
            made = _made("mesh", shape, filename=uri.first_text)
            made.set_mesh(path.absolute().as_uri())
            scale = shape.find("scale")
            if scale is not None:
                made.attributes["scale"] = _numbers(_values(scale, 3))
            if shape.find("submesh") is not None:
                self.scene.say("ignored", shape, "<submesh> has no effect: the whole mesh is used")
            return made
        return None

    def _friction(self, collision: Element) -> list[Element]:
        """The `<mu1>` and `<mu2>` for mu and mu2 of `surface/friction/ode`."""
        found = below(collision, "surface", "friction", "ode")
        if found is None:
            return []
        names = {"mu": "mu1", "mu2": "mu2"}
        return [_made(names[child.tag], child, child.first_text) for child in found.children if child.tag in names]

    def _urdf_joint(self, joint: _SdfJoint, frames: dict[str, Pose]) -> Element:
        element = joint.element
        kind = element.get("type") or ""
        if kind not in _JOINTS:
            text = f"joint {joint.name!r} is of type {kind!r}, which is not supported"
            raise element.error(text, f"types: {', '.join(_JOINTS)}")
        axis = element.find("axis")
        limit, dynamics = below(axis, "limit"), below(axis, "dynamics")
        lower, upper = _limit(limit, "lower", -_UNLIMITED), _limit(limit, "upper", _UNLIMITED)
        if kind == "revolute" and (lower <= -_UNLIMITED or upper >= _UNLIMITED):
            kind = "continuous"
        origin = _origin(relative(frames[joint.child], frames[joint.parent]), element)
        ends = _made("parent", element, link=joint.parent), _made("child", element, link=joint.child)
        made = _made("joint", element, origin, *ends, name=joint.name, type=kind)
        if kind == "fixed":
            return made
        made.content.append(_made("axis", axis or element, xyz=_numbers(self._axis(axis, frames[joint.child]))))
        effort, velocity = _limit(limit, "effort", -1.0), _limit(limit, "velocity", -1.0)
        bounds = {"effort": repr(effort if effort >= 0 else _UNLIMITED)}
        bounds["velocity"] = repr(velocity if velocity >= 0 else _UNLIMITED)
        if kind != "continuous":
            bounds |= {"lower": repr(lower), "upper": repr(upper)}
        made.content.append(_made("limit", limit or element, **bounds))
        if dynamics is not None:
            known = [child for child in dynamics.children if child.tag in ("damping", "friction")]
            made.content.append(_made("dynamics", dynamics, **{child.tag: repr(_number(child)) for child in known}))
        return made

    def _axis(self, axis: Element | None, joint_frame: Pose) -> tuple[float, ...]:
        """The axis as a vector in the joint's frame."""
        element = below(axis, "xyz")
        if axis is None or element is None:
            return (0.0, 0.0, 1.0)
        x, y, z = _values(element, 3)
        written = axis.find("use_parent_model_frame")
        in_model = self.axis_in_model if written is None else _truth(written)
        if in_model or element.get("expressed_in") == "__model__":
            return rotate(conjugate(joint_frame[1]), (x, y, z))
        return (x, y, z)


def _made(tag: str, at: Element, *content: Element | str, **attributes: str) -> Element:
    """Make a URDF element with the file and line of `at`."""
    return Element(tag, attributes, at.file, at.line, list(content))


def _origin(pose: Pose, at: Element) -> Element:
    return _made("origin", at, xyz=_numbers(pose[0]), rpy=_numbers(to_rpy(pose[1])))


def _root(link: str, above: dict[str, _SdfJoint]) -> str:
    """The topmost link above a link. Raises BadFile for a loop."""
    seen = set()
    while link in above:
        if link in seen:
            joint = above[link]
            raise joint.element.error(f"joint {joint.name!r} is part of a loop of joints", "a robot here is a tree")
        seen.add(link)
        link = above[link].parent
    return link


def _states(world: Element) -> dict[str, Pose]:
    """The poses of models in the first `<state>` of a world; they override the poses of the models."""
    state = world.find("state")
    if state is None:
        return {}
    found = {model.get("name") or "": model.find("pose") for model in state.find_all("model")}
    return {name: _pose(pose) for name, pose in found.items() if pose is not None}


def is_ground(element: Element) -> bool:
    """True for a `<model>` or `<include>` of the ground plane by its name, and for a `<model>` with planes only."""
    if element.tag == "include":
        return _short(child_text(element, "uri", "")) == GROUND_PLANE
    shapes = [shape for inner in element.walk() if inner.tag == "geometry" for shape in inner.children]
    return element.get("name") == GROUND_PLANE or bool(shapes and all(shape.tag == "plane" for shape in shapes))


def _short(uri: str) -> str:
    """The folder name of a model in a uri, normalised: Fuel has `Ground Plane`."""
    return uri.rstrip("/").rpartition("/")[2].lower().replace(" ", "_")


def _named_in_config(path: Path) -> str | None:
    """The SDF file that a model.config names, the newest version of several; None when it names none."""
    if not is_file(path):
        return None
    root = xml_tree.read(models.read_file(path), str(path))
    named = sorted(root.find_all("sdf"), key=lambda element: _version(element.get("version") or "0"))
    return named[-1].first_text or None if named else None


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text)[:2])


def _child(element: Element, tag: str) -> Element:
    child = element.find(tag)
    if child is None:
        raise element.error(f"<{element.tag}> lacks <{tag}>")
    return child


def _truth(element: Element | None) -> bool:
    if element is None:
        return False
    text = element.first_text.lower()
    if text not in ("1", "0", "true", "false"):
        raise element.error(f"<{element.tag}> is {text!r}, expected true or false")
    return text in ("1", "true")


def _number(element: Element) -> float:
    return parse_number(element.first_text, element, f"<{element.tag}>")


def _limit(limit: Element | None, tag: str, default: float) -> float:
    """A bound of a joint; SDF uses 1e16 or `inf` for no bound."""
    element = below(limit, tag)
    if element is None:
        return default
    return max(-_UNLIMITED, min(_UNLIMITED, parse_number(element.first_text, element, f"<{tag}>", finite=False)))


def _values(element: Element, count: int) -> tuple[float, ...]:
    return text_numbers(element, count, f"<{element.tag}>")


def _pose_of(element: Element) -> Pose:
    """The `<pose>` of an element; the identity when there is none."""
    pose = element.find("pose")
    return _pose(pose) if pose is not None else ORIGIN


def _pose(element: Element) -> Pose:
    name = element.get("relative_to") or element.get("frame") or ""
    if name not in ("", "__model__", "world"):
        raise element.error(f"<pose> is relative to {name!r}: frames by name are not read", "write it in its parent's")
    if not element.first_text:
        return ORIGIN
    (x, y, z), angles = pose_numbers(element, "<pose>")
    if element.get("degrees") in ("1", "true"):
        angles = (math.radians(angles[0]), math.radians(angles[1]), math.radians(angles[2]))
    return (x, y, z), from_rpy(angles)


def _colour(material: Element | None) -> str:
    """`r g b a` of the diffuse colour, else of the ambient colour; empty when neither exists."""
    for tag in ("diffuse", "ambient"):
        element = below(material, tag)
        if element is not None and element.first_text:
            parts = _values(element, len(element.first_text.split()))
            return _numbers((*parts, 1.0) if len(parts) == 3 else parts)
    return ""


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(value) for value in values)
