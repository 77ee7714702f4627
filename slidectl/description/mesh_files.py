"""Finds the files of meshes: `package://`, `model://`, `file://` and plain paths, absolute or relative.

The kind of a file is known by its suffix; meshes.py reads the files.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote

from slidectl.description import install_rules
from slidectl.description.packages import Packages, UnknownPackage, is_file
from slidectl.errors import BadFile
from slidectl.input_files import ReadInput, from_disk

SUFFIXES = (".stl", ".obj", ".dae")

FORBIDDEN = "the client that spawns this may not name files"
_USABLE = "a path is relative to the robot's file, else it is absolute or begins with package://, model:// or file://"


class MissingMesh(BadFile):
    """The mesh of a collision does not exist."""


class UnknownMesh(BadFile):
    """The mesh of a collision is of a kind that cannot be read."""


class MeshFiles:
    """Finds mesh files. `base` is the folder of the robot's file, None when the robot is not from a file."""

    def __init__(self, packages: Packages, base: Path | None, read: ReadInput = from_disk) -> None:
        self.packages = packages
        self.base = base
        self._read = read

    def locate(self, uri: str, written_in: str) -> tuple[Path | None, str]:
        """The absolute path of the file and "", or None and the reason. `written_in` is the file that names the mesh.

        A relative path is looked up beside that file, then beside the robot's file.
        """
        path, why = self._read(f"place of the mesh {uri}", lambda: self._find(uri.strip(), written_in))
        return Path(path) if path else None, why

    def _find(self, uri: str, written_in: str) -> tuple[str, str]:
        try:
            candidates = self._candidates(uri, written_in)
        except UnknownPackage as error:
            return "", str(error)
        for path in (*candidates, *map(install_rules.located, candidates)):
            if is_file(path):
                return str(path.absolute()), ""
        if not candidates:
            return "", f"cannot be found: {_USABLE}"
        places = ", ".join(str(path) for path in dict.fromkeys(candidates))
        remark = next(filter(None, map(install_rules.remark, candidates)), None)
        return "", f"no such file; looked for {places}" + (f"; {remark}" if remark else "")

    def expected(self, uri: str, written_in: str) -> Path | None:
        """The first place where a missing file was looked for; None when its package is missing too."""
        try:
            return next(iter(self._candidates(uri.strip(), written_in)), None)
        except UnknownPackage:
            return None

    def _candidates(self, uri: str, written_in: str) -> list[Path]:
        scheme, separator, rest = uri.partition("://")
        if scheme in ("package", "model") and separator:
            name, _, inside = rest.partition("/")
            folder = self.packages.find(unquote(name))
            return [folder / inside, folder / unquote(inside)]
        if scheme == "file" and separator:
            path = rest if rest.startswith("/") else "/" + rest.partition("/")[2]
            return [Path(path), Path(unquote(path))]
        if separator:
            return []
        if Path(uri).is_absolute():
            return [Path(uri)]
        folders = [Path(written_in).absolute().parent] if is_file(Path(written_in)) else []
        folders += [self.base] if self.base is not None else []
        return [folder / uri for folder in dict.fromkeys(folders)]


class ForbiddenMeshes(MeshFiles):
    """For robots of clients that may name no files: no mesh is looked up, so nothing is learned about the disk."""

    def __init__(self) -> None:
        super().__init__(Packages(), None)

    def locate(self, uri: str, written_in: str) -> tuple[Path | None, str]:  # noqa: ARG002 - nothing is looked up
        return None, FORBIDDEN

    def expected(self, uri: str, written_in: str) -> Path | None:  # noqa: ARG002
        return None


class UnreadMeshes(MeshFiles):
    """For readers that need only the joints of a robot: every mesh is assumed to exist."""

    def __init__(self) -> None:
        super().__init__(Packages(), None)

    def locate(self, uri: str, written_in: str) -> tuple[Path | None, str]:  # noqa: ARG002 - nothing is looked up
        return Path(uri), ""
