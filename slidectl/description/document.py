"""A model made ready for the daemon: expanded by xacro, meshes found, one element per line, sources noted.

This is the client's side: it reads files, and evaluates what xacro evaluates. The result is plain URDF text.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from slidectl.description import models, xml_tree, xml_writer
from slidectl.description.mesh_files import MeshFiles
from slidectl.description.packages import Packages
from slidectl.description.robot import Notice
from slidectl.description.xml_tree import Element


@dataclass(frozen=True)
class Document:
    """`xml` is URDF; `source_map` leads from its lines to the places where they were written."""

    xml: str
    source_map: xml_writer.SourceMap
    file: str
    """The model's file, or `<stdin>` or `<text>`."""
    report: tuple[Notice, ...] = field(default=())
    """What xacro warned of, and arguments without effect. What URDF tags became of is in the parsed robot's report."""


def load(
    source: str | Path,
    arguments: Mapping[str, str] | None = None,
    packages: Packages | None = None,
    *,
    all_meshes: bool = True,
    title: str | None = None,
) -> Document:
    """The document of a model: a `.xacro` or `.urdf` path, a shipped model's name, `-` for stdin, or XML text.

    Meshes that collide have to be there, unless `all_meshes` is false: then the parser may say so. `title` is what to
    call a text in messages.

    Raises:
        BadFile: missing, broken, or refused by xacro. UnknownName: no shipped model of that name.
    """
    model = models.read(source)
    model = replace(model, file=title) if title is not None else model
    base = model.path.absolute().parent if model.path is not None else Path.cwd()
    packages = packages.starting_at(base) if packages is not None else Packages(start=base)
    root = xml_tree.read(model.text, model.file)
    notices: list[Notice] = []
    if _is_xacro(model, root):
        from slidectl.description import xacro_run

        root, notices = xacro_run.expand(root, model.path, arguments or {}, packages)
    else:
        notices = [_no_xacro(name, model.file) for name in arguments or {}]
    _make_meshes_absolute(root, MeshFiles(packages, base), all_meshes)
    xml, source_map = xml_writer.write(root)
    return Document(xml, source_map, model.file, tuple(notices))


def _is_xacro(model: models.Source, root: Element) -> bool:
    """By its suffix, or because it has tags or attributes of xacro."""
    if model.path is not None and model.path.suffix.lower() == ".xacro":
        return True
    return any(name.startswith("xacro:") for element in root.walk() for name in (element.tag, *element.attributes))


def _no_xacro(name: str, file: str) -> Notice:
    return Notice("ignored", f"{name}:=", "plain URDF takes no arguments", file, None)


def _make_meshes_absolute(root: Element, meshes: MeshFiles, all_meshes: bool) -> None:
    """Turn the names of meshes into `file://` ones, so that whoever reads the text needs no package path.

    Raises:
        BadFile: a mesh that collides is not there. One that is only looked at is left for the parser to report.
    """
    for shape in (element for element in root.walk() if element.tag in ("visual", "collision")):
        for element in (below for below in shape.walk() if below.tag == "mesh"):
            uri = element.get("filename") or ""
            path, why = meshes.locate(uri, element.file) if uri.strip() else (None, "")
            if path is not None:
                element.attributes["filename"] = path.as_uri()
            elif uri and shape.tag == "collision" and all_meshes:
                raise element.error(f"mesh {uri!r}: {why}")
            elif uri.strip() and (expected := meshes.expected(uri, element.file)) is not None:
                # Whoever reads the text has no package path, and would say that the package is missing.
                element.attributes["filename"] = expected.absolute().as_uri()


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
