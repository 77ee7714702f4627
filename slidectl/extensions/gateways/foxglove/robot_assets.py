"""The files that an app may fetch: meshes named in the descriptions of the robots in the world, and their textures.

A URI is only looked up in a table of the named files, never converted to a path. A file is in the table when it is
inside the folder of the robot's model or inside a package, with all links resolved. Robots of clients that may not name
files have none.
"""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from posixpath import dirname, join, normpath
from typing import NamedTuple

from slidectl import input_files
from slidectl.errors import BadFile, Refused, UnknownName
from slidectl.extensions.gateways.daemon_connection import DaemonConnection

LARGEST = 64 * 1024 * 1024
"""The maximum size of a file in bytes."""
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".tga", ".tif", ".tiff")
_NAMED = re.compile(
    rb"<init_from>\s*(?:<ref>)?\s*([^<>]{1,500}?)\s*<|^\s*(?:mtllib|map_K[das])\s+(\S{1,500})", re.MULTILINE
)
"""Matches file names inside a DAE, OBJ or MTL file."""
_MOST_NAMED = 100


class Asset(NamedTuple):
    """A file, with all links resolved, and the folders that it and the files which it names must be in."""

    path: str
    folders: tuple[Path, ...]


class RobotAssets:
    """The fetchable files of the robots of one daemon."""

    def __init__(self) -> None:
        self._robots: object = None
        """Names and serial numbers of the robots that `_files` was made from."""
        self._files: dict[str, Asset] = {}
        """Files by URI."""

    async def update(self, daemon: DaemonConnection) -> None:
        """Read the descriptions again when the robots have changed. Raises as `call`."""
        scene = await daemon.call("/slidectl/scene")
        if self._robots != (robots := (scene["robots"], scene["serials"])):
            scene = await daemon.call("/slidectl/scene", {"descriptions": True})
            own = zip(scene["descriptions"], scene["may_use_files"], strict=True)
            self._files = await asyncio.to_thread(_meshes_of_all, [xml for xml, may_use_files in own if may_use_files])
            self._robots = robots

    def read(self, uri: str) -> bytes:
        """The content of a file. Raises UnknownName: no robot names it. Refused: it is unreadable or too large."""
        asset = self._files.get(uri)
        if asset is None:
            raise UnknownName("asset", uri, list(self._files), "of a robot in the world")
        data = _read(asset.path)
        for name in _named_in(asset.path, data):
            companion = _inside(join(dirname(asset.path), name), asset.folders)
            if companion is not None:
                self._files.setdefault(_beside(uri, name), companion)
        return data


def _meshes_of_all(descriptions: list[str]) -> dict[str, Asset]:
    return {uri: asset for xml in descriptions if "<mesh" in xml for uri, asset in _meshes(xml).items()}


def _meshes(xml: str) -> dict[str, Asset]:
    """The meshes of a description that may be served, by their URI in it."""
    from slidectl.description import xml_tree  # the package is slow to import, and most robots have no mesh
    from slidectl.description.mesh_files import SUFFIXES, MeshFiles
    from slidectl.description.packages import Packages, package_of

    files = MeshFiles(Packages(), None)
    root = xml_tree.read(xml, "robot_description")
    model = [Path(root.folder)] if root.folder else []
    model += [package for folder in model if (package := package_of(folder / "model")) is not None]
    found = {}
    for element in root.walk():
        if element.tag == "mesh" and (file := element.get("filename")):
            path, _ = files.locate(file, "")
            if path is not None and path.suffix.lower() in SUFFIXES:
                package = package_of(path)
                asset = _inside(str(path), (*model, *([package] if package is not None else [])))
                if asset is not None:
                    found[element.mesh_name or file] = asset
    return found


def _inside(path: str, folders: tuple[Path, ...]) -> Asset | None:
    """The file at `path` with all links resolved, when it is inside one of the folders; else None."""
    try:
        real = Path(path).resolve()
        holding = tuple(folder for folder in (each.resolve() for each in folders) if real.is_relative_to(folder))
    except (OSError, ValueError, RuntimeError):  # links in a circle, a null character
        return None
    return Asset(str(real), holding) if holding else None


def _read(path: str) -> bytes:
    """Read a file. `path` was resolved: a link there now has been put in its place since."""
    try:
        return input_files.read_bytes(path, LARGEST, links=False)
    except BadFile as error:
        raise Refused(error.message) from None


def _named_in(path: str, data: bytes) -> list[str]:
    """Relative names of textures and material files in a mesh file."""
    if not path.lower().endswith((".dae", ".obj", ".mtl")):
        return []
    found = [(match[1] or match[2]).decode("utf-8", "replace") for match in _NAMED.finditer(data)][:_MOST_NAMED]
    is_beside = (name for name in found if "://" not in name and not name.startswith("/"))
    return [name for name in is_beside if name.lower().endswith((*_PICTURES, ".mtl"))]


def _beside(uri: str, name: str) -> str:
    """The URI of a file that the file at `uri` names relative to itself."""
    scheme, separator, path = uri.partition("://")
    return scheme + separator + normpath(join(dirname(path), name))
