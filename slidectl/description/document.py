"""Prepares a model for the daemon: expands xacro, finds meshes, fixes or frees the root, notes the sources.

This runs in the client, which reads files; xacro evaluates expressions in a process of its own. The result is plain
URDF text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from slidectl.description import install_rules, models, source_note, xml_tree
from slidectl.description.gazebo_tags import leave_out_hardware, set_transmissions, transmissions_named
from slidectl.description.mesh_files import MeshFiles
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages, shown
from slidectl.description.rigid_bodies import WORLD
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import Element
from slidectl.errors import NotThere, SlidectlError, listing

_FIND = re.compile(r"\$\(find\s+([^\s)]+)\s*\)")
_NAMESPACE = re.compile(r"\$[({][^)}]*\bnamespace\b")
"""A use of the argument or property of that name."""
_JOINT = "world_to_root"


@dataclass(frozen=True)
class Document:
    """A loaded model. `xml` is URDF with the note of its sources."""

    xml: str
    file: str
    """The model's file, or `<stdin>` or `<text>`."""
    report: tuple[Notice, ...] = field(default=())
    """Warnings of xacro, and arguments without effect. The effects of URDF tags are in the parsed robot's report."""

    @property
    def urdf(self) -> str:
        """The URDF without the note, as any reader takes it: for showing and storing."""
        return source_note.split(self.xml)[0]


def load(
    source: str | Path,
    arguments: Mapping[str, str] | None = None,
    packages: Packages | None = None,
    *,
    all_meshes: bool = True,
    title: str | None = None,
    missing: Missing | None = None,
    as_written: bool = False,
) -> Document:
    """Load a model: a `.xacro` or `.urdf` path, a shipped model's name, `-` for stdin, or XML text.

    Args:
        all_meshes: False: the mesh of a collision may be missing; the parser then reports it.
        title: the name of a text in messages.
        missing: collects things that the files name and that do not exist; without it they are errors.
        as_written: do not look for the files of meshes.

    Raises BadFile: missing, broken, or refused by xacro. UnknownName: no shipped model of that name.
    """
    absences = Missing() if missing is None else missing
    model, root, base, packages = _opened(source, packages, title)
    suffixes = model.path.suffixes if model.path is not None else []
    if ".xacro" in map(str.lower, suffixes) or has_xacro(root):  # gz_ros2_control's demos are `.xacro.urdf`
        from slidectl.description import xacro_adapter

        root, notices = xacro_adapter.expand(root, model.path, arguments or {}, packages, absences)
    else:
        text = "plain URDF takes no arguments"
        notices = [Notice("ignored", f"{name}:=", text, model.file, None) for name in arguments or {}]
    if as_written:
        absences.refuse()
    else:
        _find_meshes(root, MeshFiles(packages, base), absences if all_meshes else None)
        if missing is None:
            absences.refuse()
        else:
            leave_out_hardware(root, missing)
    return Document(xml_tree.write(root), model.file, tuple(notices))


def _opened(
    source: str | Path, packages: Packages | None, title: str | None = None
) -> tuple[models.ModelText, Element, Path, Packages]:
    """The model, its unexpanded tree, its folder, and the lookup of packages that starts there."""
    model = models.read(source)
    model = replace(model, file=title) if title is not None else model
    base = model.path.absolute().parent if model.path is not None else Path.cwd()
    packages = packages.starting_at(base) if packages is not None else Packages(start=base)
    return model, xml_tree.read(model.text, model.file), base, packages


def has_xacro(root: Element) -> bool:
    """True when the tree has tags or attributes of xacro."""
    return any(name.startswith("xacro:") for element in root.walk() for name in (element.tag, *element.attributes))


def _find_meshes(root: Element, meshes: MeshFiles, missing: Missing | None) -> None:
    """Find the files of meshes and put them into the elements, so that the text can be read without a package path.

    A `<collision>` with a missing mesh is removed and noted in `missing`. Without `missing`, and for visuals, the name
    stays, and the parser reports it.
    """
    for above in list(root.walk()):
        for shape in (child for child in above.children if child.tag in ("visual", "collision")):
            for element in (below for below in shape.walk() if below.tag == "mesh"):
                uri = element.get("filename") or ""
                path, why = meshes.locate(uri, element.file) if uri.strip() else (None, "")
                if path is not None:
                    element.set_mesh(path.as_uri())
                elif uri and shape.tag == "collision" and missing is not None:
                    reason, _, hint = why.partition("\n")
                    package = uri.partition("://")[2].partition("/")[0]  # one absence for all its meshes
                    thing = f"package {package}" if hint else f"mesh {uri}"
                    error = NotThere(f"mesh {uri!r}: {reason}", element.file, element.line, hint or None, thing)
                    missing.note(error, "the <collision> is left out")
                    above.remove(shape)
                elif uri.strip() and (expected := meshes.expected(uri, element.file)) is not None:
                    # The reader of the text has no package path, and would report a missing package.
                    element.set_mesh(expected.absolute().as_uri())


# --- the model before xacro -------------------------------------------------------------------------------------------


@dataclass
class Written:
    """A model before xacro. `is_whole` is False when only xacro can find out what it includes."""

    root: Element
    elements: list[Element] = field(default_factory=list)
    """The elements of the model and of files that it includes by plain names or `$(find)`, in the order of xacro."""
    is_whole: bool = True

    @property
    def arguments(self) -> dict[str, Element]:
        """The `<xacro:arg>` elements by name; as in xacro, the first one of a name counts."""
        found: dict[str, Element] = {}
        for element in self.elements:
            if element.tag == "xacro:arg" and (name := element.get("name")):
                found.setdefault(name, element)
        return found


def written(source: str | Path, packages: Packages | None = None) -> Written:
    """Read a model without evaluating it. Raises BadFile and UnknownName as load does, but not for includes."""
    _, root, base, packages = _opened(source, packages)
    found = Written(root)
    seen: set[Path] = set()

    def collect(element: Element, folder: Path) -> None:
        for inner in element.walk():
            found.elements.append(inner)
            if inner.tag != "xacro:include":
                continue
            try:
                name = _FIND.sub(lambda match: str(packages.find(match.group(1))), inner.get("filename") or "$")
                path = install_rules.located(folder / name)
                if "$" in name or path in seen:
                    found.is_whole &= "$" not in name
                    continue
                seen.add(path)
                included = xml_tree.read(models.read_file(path), shown(path))
            except (OSError, SlidectlError):
                found.is_whole = False
            else:
                collect(included, path.parent)

    collect(root, base)
    return found


def takes_namespace(source: str | Path, packages: Packages | None = None) -> bool:
    """True for a model with an argument `namespace` which is one of the graph: no part of a link's or joint's name.

    TurtleBot3's models for ROS 2 put theirs, `NAME/` or nothing, before each such name. Raises: as load.
    """
    found = written(source, packages)
    names = (element.get("name") or "" for element in found.elements if element.tag in ("link", "joint"))
    return "namespace" in found.arguments and not any(_NAMESPACE.search(name) for name in names)


# --- the root link ---------------------------------------------------------------------------------------------------


def with_root_fixed(xml: str, file: str = "robot_description") -> str:
    """The robot with its root fixed to a link called `world`; unchanged if the root is `world` already.

    Raises BadFile: broken XML, no single root, or a link called `world` that is not the root.
    """
    robot = xml_tree.read(xml, file)
    root = _root_name(robot)
    if root == WORLD:
        return xml
    if any(link.get("name") == WORLD for link in robot.find_all("link")):
        raise robot.error(f"cannot fix the robot: a link {WORLD!r} is there and is not the root")

    def element(tag: str, attributes: dict[str, str], *content: Element) -> Element:
        return Element(tag, attributes, robot.file, robot.line, list(content))

    name = _JOINT
    while any(joint.get("name") == name for joint in robot.find_all("joint")):
        name += "_"
    ends = element("parent", {"link": WORLD}), element("child", {"link": root})
    robot.content += [element("link", {"name": WORLD}), element("joint", {"name": name, "type": "fixed"}, *ends)]
    return xml_tree.write(robot)


def with_root_free(xml: str, file: str = "robot_description") -> str:
    """The robot without its root link `world` and the fixed joint below it; unchanged if its root is not `world`.

    The link below becomes the root. The joint's origin is lost: the pose of the spawn replaces it.

    Raises BadFile: broken XML, no single root, or `world` has other joints than one fixed joint.
    """
    robot = xml_tree.read(xml, file)
    if _root_name(robot) != WORLD:
        return xml
    below = [joint for joint in robot.find_all("joint") if _end(joint, "parent") == WORLD]
    if len(below) != 1 or below[0].get("type") != "fixed":
        names = listing([joint.get("name") or "?" for joint in below])
        raise robot.error(
            f"cannot free the robot: its link {WORLD!r} must hold it by one fixed joint alone; joints there: {names}"
        )
    robot.remove(below[0], *(link for link in robot.find_all("link") if link.get("name") == WORLD))
    return xml_tree.write(robot)


def with_transmissions(xml: str, how: str, file: str = "robot_description") -> str:
    """Set `transmissions` of the control plugin to `how`. Raises BadFile: broken XML. Refused: unknown `how`."""
    robot = xml_tree.read(xml, file)
    set_transmissions(robot, transmissions_named(how))
    return xml_tree.write(robot)


def _end(joint: Element, tag: str) -> str | None:
    end = joint.find(tag)
    return end.get("link") if end is not None else None


def _root_name(robot: Element) -> str:
    children = {_end(joint, "child") for joint in robot.find_all("joint")}
    roots = [link.get("name") for link in robot.find_all("link") if link.get("name") not in children]
    if len(roots) != 1 or not roots[0]:
        raise robot.error(f"the robot needs one root link; it has: {listing([name or '?' for name in roots])}")
    return roots[0]
