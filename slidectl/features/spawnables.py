"""Resources for the services of simulation_interfaces: read by URI or as text, and lists of those that exist.

A resource is read in one call, which blocks the world: some tens of milliseconds for xacro. This module knows no world.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from slidectl import description
from slidectl.control.node_handle import Message
from slidectl.description import models, sdf, xml_tree
from slidectl.description.document import has_xacro
from slidectl.description.mesh_files import MeshFiles, MissingMesh, UnknownMesh
from slidectl.effects import Effect, NotPermitted
from slidectl.errors import BadFile, NotThere, SlidectlError, UnknownName, listing, quoted
from slidectl.features.entities import check_size
from slidectl.physics.builder import BadShape
from slidectl.rotations import ORIGIN, Pose
from slidectl.simulation.host import Host

FORMATS = ("urdf", "sdf", "xacro")
_OF_SCENES = ("sdf", "world", "gazebo", "model")
"""Root elements of SDF."""
_SUFFIXES = (*models.SUFFIXES, *sdf.SUFFIXES)
_LISTED = tuple(suffix for suffix in _SUFFIXES if suffix != ".xml")
_MOST_FILES = 10_000
"""The most files of a package that are searched for spawnable ones."""


class SpawnFailure(SlidectlError):
    """An entity cannot be spawned. `reason` is the name of a constant of simulation_interfaces/SpawnResult."""

    def __init__(self, reason: str, message: str, hint: str | None = None) -> None:
        super().__init__(message, hint)
        self.reason = reason


class ResourcePart(NamedTuple):
    """A robot or model in a resource: URDF with the note of its sources, and its pose in the whole."""

    xml: str
    name: str
    pose: Pose
    is_model: bool
    """True when it came as SDF."""


def read(
    resource: Message, name: str, named: Callable[[str], str], permitted: Collection[Effect], host: Host
) -> list[ResourcePart]:
    """The parts of a simulation_interfaces/Resource; URDF has one.

    Args:
        resource: its `uri` has precedence over its `resource_string`.
        name: the requested name; empty for the name in the resource.
        named: returns the name to use.
        permitted: what the caller may do.
        host: reads the files.

    Raises SpawnFailure.
    """
    uri, text = resource["uri"].strip(), resource["resource_string"]
    if not uri and not text.strip():
        raise SpawnFailure("NO_RESOURCE", "neither uri nor resource_string is set")

    may_use_files = Effect.FILES in permitted
    if uri and uri not in models.shipped() and not may_use_files:
        raise failure(NotPermitted(f"spawning {quoted(uri)}", Effect.FILES, permitted))

    def parts_in_file() -> list[Any]:
        try:
            return _of_file(uri, name, named) if uri else _of_text(text, name, named, may_use_files)
        except SlidectlError as error:
            raise failure(error) from None

    parts = host.read_or_raise(f"resource {uri or 'given as text'}", parts_in_file)
    return [ResourcePart(xml, part, (tuple(xyz), tuple(turn)), is_model) for xml, part, (xyz, turn), is_model in parts]


def failure(error: SlidectlError) -> SpawnFailure:
    """An error of reading or spawning as SpawnFailure, with the constant for its kind."""
    kinds = (
        ((BadShape, UnknownMesh), "UNSUPPORTED_ASSETS"),
        ((MissingMesh, NotThere), "MISSING_ASSETS"),
        (BadFile, "RESOURCE_PARSE_ERROR"),
    )
    reason = next((name for kind, name in kinds if isinstance(error, kind)), "RESULT_OPERATION_FAILED")
    return error if isinstance(error, SpawnFailure) else SpawnFailure(reason, error.message, error.hint)


def _of_text(text: str, name: str, named: Callable[[str], str], may_use_files: bool) -> list[Any]:
    check_size("resource_string", text)
    root = xml_tree.read(text, "resource_string")
    if root.tag in _OF_SCENES:
        return _of_scene(sdf.parse(text, "resource_string", may_use_files=may_use_files), name, named)
    if root.tag != "robot":
        raise _unsupported(f"the outermost element is <{root.tag}>")
    if has_xacro(root):
        raise _unsupported("it is xacro, which slidectl expands only in a file")
    return [(text, named(name or root.get("name") or ""), ORIGIN, False)]


def _of_file(uri: str, name: str, named: Callable[[str], str]) -> list[Any]:
    path = _file(uri)
    if path.suffix.lower() in sdf.SUFFIXES:
        return _of_scene(sdf.read(path), name, named)
    from slidectl.client import spawning  # late import: a daemon needs the client for nothing else

    if not name:
        name = xml_tree.read(spawning.document(str(path), {}, None).xml, str(path)).get("name") or ""
    name = named(name)
    return [(spawning.document(str(path), {}, name).xml, name, ORIGIN, False)]


def _of_scene(scene: sdf.Scene, name: str, named: Callable[[str], str]) -> list[Any]:
    name = named(name or (scene.names[0] if len(scene.names) == 1 else ""))
    return [(model.xml, model.name, model.pose, True) for model in scene.named(name)]


def _file(uri: str) -> Path:
    """The file for a URI. Raises SpawnFailure."""
    known = models.shipped()
    if uri in known:
        return known[uri]
    if not uri.startswith("/") and "://" not in uri:
        raise SpawnFailure("RESULT_NOT_FOUND", str(UnknownName("shipped model", uri, sorted(known))))
    scheme = uri.partition("://")[0] if "://" in uri else "file"
    if scheme not in ("file", "package", "model"):
        raise _unsupported(f"the scheme {scheme}:// is not supported")
    path, why = MeshFiles(description.Packages(start=Path.cwd()), None).locate(uri, "")
    if path is None and scheme == "model":
        path = sdf.find(uri)
    if path is None or not path.is_file():
        raise SpawnFailure("RESULT_NOT_FOUND", f"no resource {quoted(uri)}: {why}")
    if path.suffix.lower() not in _SUFFIXES:
        raise _unsupported(f"the file is {path.name}")
    return path


def _unsupported(why: str) -> SpawnFailure:
    return SpawnFailure("UNSUPPORTED_FORMAT", f"{why}; what can be read: {', '.join(FORMATS)}")


# Lists of spawnables


def spawnables(sources: list[str]) -> tuple[list[Message], str]:
    """simulation_interfaces/Spawnable for the shipped models and the packages in `sources`, and a text about unknown
    packages.

    A source is a package, by its name or as package://NAME.
    """
    packages = description.Packages(start=Path.cwd())
    found = [_spawnable(path.as_uri(), f"{name}, a model of slidectl") for name, path in models.shipped().items()]
    unknown: list[str] = []
    for source in dict.fromkeys(sources):
        name = source.removeprefix("package://").rstrip("/")
        folders = packages.candidates(name) if name and "/" not in name else []
        if not folders:
            unknown.append(source)
        for folder in folders[:1]:
            paths = (path.relative_to(folder).as_posix() for path in _files(folder) if path.suffix.lower() in _LISTED)
            found += [_spawnable(f"package://{name}/{path}", f"of the package {name}") for path in paths]
    return found, f"no such packages: {listing(unknown)}" if unknown else ""


def _files(folder: Path) -> Iterator[Path]:
    walked = (Path(here) / file for here, _, files in os.walk(folder) for file in sorted(files))
    return islice(walked, _MOST_FILES)


def _spawnable(uri: str, text: str) -> Message:
    return {"entity_resource": {"uri": uri}, "description": text}
