"""The files that an app may fetch: meshes named in the descriptions of the robots in the world, and their textures.

A URI is only looked up in a table of the named files, never converted to a path. So no URI gives access to other files.
"""

from __future__ import annotations

import asyncio
import os
import re
import stat
from posixpath import dirname, join, normpath

from slidectl.errors import Refused, UnknownName
from slidectl.gateways.daemon_connection import DaemonConnection

LARGEST = 64 * 1024 * 1024
"""The maximum size of a file in bytes."""
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".tga", ".tif", ".tiff")
_NAMED = re.compile(
    rb"<init_from>\s*(?:<ref>)?\s*([^<>]{1,500}?)\s*<|^\s*(?:mtllib|map_K[das])\s+(\S{1,500})", re.MULTILINE
)
"""Matches file names inside a DAE, OBJ or MTL file."""
_MOST_NAMED = 100


class RobotAssets:
    """The fetchable files of the robots of one daemon."""

    def __init__(self) -> None:
        self._robots: object = None
        """Names and serial numbers of the robots that `_files` was made from."""
        self._files: dict[str, str] = {}
        """URI -> path of the file."""

    async def update(self, daemon: DaemonConnection) -> None:
        """Read the descriptions again when the robots have changed. Raises as `call`."""
        scene = await daemon.call("/slidectl/scene")
        if self._robots != (robots := (scene["robots"], scene["serials"])):
            scene = await daemon.call("/slidectl/scene", {"descriptions": True})
            self._files = await asyncio.to_thread(_meshes_of_all, scene["descriptions"])
            self._robots = robots

    def read(self, uri: str) -> bytes:
        """The content of a file. Raises UnknownName: no robot names it. Refused: it is unreadable or too large."""
        path = self._files.get(uri)
        if path is None:
            raise UnknownName("asset", uri, list(self._files), "of a robot in the world")
        data = _read(path)
        for name in _named_in(path, data):
            self._files.setdefault(_beside(uri, name), normpath(join(dirname(path), name)))
        return data


def _meshes_of_all(descriptions: list[str]) -> dict[str, str]:
    return {uri: path for xml in descriptions if "<mesh" in xml for uri, path in _meshes(xml).items()}


def _meshes(xml: str) -> dict[str, str]:
    """URI in the description -> path, of its meshes."""
    from slidectl.description import xml_tree  # the package is slow to import, and most robots have no mesh
    from slidectl.description.mesh_files import SUFFIXES, MeshFiles
    from slidectl.description.packages import Packages

    files = MeshFiles(Packages(), None)
    found = {}
    for element in xml_tree.read(xml, "robot_description").walk():
        if element.tag == "mesh" and (file := element.get("filename")):
            path, _ = files.locate(file, "")
            if path is not None and path.suffix.lower() in SUFFIXES:
                found[element.mesh_name or file] = str(path)
    return found


def _read(path: str) -> bytes:
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise Refused(f"{path} is no file")
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise Refused(f"{path}: {error.strerror or error}") from None
    if len(data) > LARGEST:
        raise Refused(f"{path} is larger than {LARGEST} bytes")
    return data


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
