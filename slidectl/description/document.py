"""A model made ready for the daemon: expanded by xacro, meshes found, one element per line, sources noted.

This is the client's side: it reads files, and evaluates what xacro evaluates. The result is plain URDF text.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from slidectl.description import models, source_note, xml_tree, xml_writer
from slidectl.description.gazebo_tags import leave_out_hardware
from slidectl.description.mesh_files import MeshFiles
from slidectl.description.missing import Missing
from slidectl.description.packages import Packages
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import Element
from slidectl.errors import NotThere


@dataclass(frozen=True)
class Document:
    """`xml` is URDF with the note of its sources; `source_map` leads from its lines to where they were written."""

    xml: str
    source_map: xml_writer.SourceMap
    file: str
    """The model's file, or `<stdin>` or `<text>`."""
    report: tuple[Notice, ...] = field(default=())
    """What xacro warned of, and arguments without effect. What URDF tags became of is in the parsed robot's report."""

    @property
    def urdf(self) -> str:
        """The URDF alone, as any reader takes it: what is shown and stored."""
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
    """The document of a model: a `.xacro` or `.urdf` path, a shipped model's name, `-` for stdin, or XML text.

    Meshes that collide have to be there, unless `all_meshes` is false: then the parser may say so. `title` is what to
    call a text in messages. `missing` takes in what the files name and is not there; without it that is an error.
    `as_written`: the files of meshes are not looked for.

    Raises:
        BadFile: missing, broken, or refused by xacro. UnknownName: no shipped model of that name.
    """
    absences = Missing() if missing is None else missing
    model = models.read(source)
    model = replace(model, file=title) if title is not None else model
    base = model.path.absolute().parent if model.path is not None else Path.cwd()
    packages = packages.starting_at(base) if packages is not None else Packages(start=base)
    root = xml_tree.read(model.text, model.file)
    notices: list[Notice] = []
    if _is_xacro(model, root):
        from slidectl.description import xacro_run

        root, notices = xacro_run.expand(root, model.path, arguments or {}, packages, absences)
    else:
        notices = [_no_xacro(name, model.file) for name in arguments or {}]
    if as_written:
        absences.refuse()
    else:
        _find_meshes(root, MeshFiles(packages, base), absences if all_meshes else None)
        if missing is None:
            absences.refuse()
        else:
            leave_out_hardware(root, missing)
    xml, source_map = xml_writer.write(root)
    return Document(xml, source_map, model.file, tuple(notices))


def _is_xacro(model: models.Source, root: Element) -> bool:
    """By its suffix, or because it has tags or attributes of xacro."""
    if model.path is not None and model.path.suffix.lower() == ".xacro":
        return True
    return any(name.startswith("xacro:") for element in root.walk() for name in (element.tag, *element.attributes))


def _no_xacro(name: str, file: str) -> Notice:
    return Notice("ignored", f"{name}:=", "plain URDF takes no arguments", file, None)


def _find_meshes(root: Element, meshes: MeshFiles, missing: Missing | None) -> None:
    """Find the files of meshes, for the note of the text: whoever reads the text with it needs no package path.

    A `<collision>` whose mesh is not there is left out and noted in `missing`; without that, and where a mesh is only
    looked at, the name stays, for the parser to report.
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
                    package = uri.partition("://")[2].partition("/")[0]  # of one that is not there, many may be missing
                    thing = f"package {package}" if hint else f"mesh {uri}"
                    error = NotThere(f"mesh {uri!r}: {reason}", element.file, element.line, hint or None, thing)
                    missing.note(error, "the <collision> is left out")
                    above.content[:] = [node for node in above.content if node is not shape]
                elif uri.strip() and (expected := meshes.expected(uri, element.file)) is not None:
                    # Whoever reads the text has no package path, and would say that the package is missing.
                    element.set_mesh(expected.absolute().as_uri())


def declared_arguments(source: str | Path, packages: Packages | None = None) -> dict[str, str]:
    """The `<xacro:arg>` of a model and of the files that it includes by plain names, with their defaults.

    Raises:
        BadFile, UnknownName: as load.
    """
    found = declaring_elements(source, packages)
    return {name: element.get("default") or "" for name, element in found.items()}


def declaring_elements(source: str | Path, packages: Packages | None = None) -> dict[str, Element]:
    """The same `<xacro:arg>` as elements, which know where they were written."""
    from slidectl.description import xacro_arguments

    return xacro_arguments.declared(*_unexpanded(source, packages))


def written_trees(source: str | Path, packages: Packages | None = None) -> list[Element] | None:
    """A model and all that it includes as they are written; None when only xacro can tell what it includes.

    Raises:
        BadFile, UnknownName: as load.
    """
    from slidectl.description import xacro_arguments

    return xacro_arguments.trees(*_unexpanded(source, packages))


def _unexpanded(source: str | Path, packages: Packages | None) -> tuple[Element, Path, Packages]:
    """The tree of a model, the folder that it is in, and where packages are."""
    model = models.read(source)
    base = model.path.absolute().parent if model.path is not None else Path.cwd()
    packages = packages.starting_at(base) if packages is not None else Packages(start=base)
    return xml_tree.read(model.text, model.file), base, packages
