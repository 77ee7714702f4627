"""Mesh files: where they are (`package://`, `model://`, `file://` and plain paths), and their triangles.

STL (binary and text), OBJ and DAE, with numpy alone, which is imported when a file is read: trimesh takes a second to
import, in each process that reads meshes. Files of others are read here, so all that a file can ask for has a bound.
Nothing is fetched from elsewhere, and no material, texture or normal is read. The scenes of a DAE are collada.py.
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import unquote

from slidectl.description.inertia import LEAST
from slidectl.description.packages import Packages, UnknownPackage, is_file
from slidectl.description.robot import Vector
from slidectl.errors import BadFile

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SUFFIXES = (".stl", ".obj", ".dae")
MOST_BYTES = 128 * 2**20
"""Of a file in a binary format."""
MOST_BYTES_OF_TEXT = 64 * 2**20
"""Of a file in a text format, which takes several times its size in memory while it is read."""
MOST_FACES = 2_000_000

_STL_HEADER = 84
_STL_FACET = 50
_LONGEST_NUMBER = 64
"""Bytes. numpy gives each text of an array the room of the longest."""
_VERTEX = re.compile(rb"\bvertex\s+(\S{1,64})\s+(\S{1,64})\s+(\S{1,64})(?!\S)", re.IGNORECASE)
_USABLE = "a path is relative to the robot's file, else it is absolute or begins with package://, model:// or file://"
_THINNEST = 1e-12
_FARTHEST = 1e12
_SMALLEST_BOX = 100 * LEAST
"""m³. MuJoCo refuses hulls of less volume than LEAST."""
FLAT = "it lies in one plane or is too small, and what is flat cannot collide; a thin <box> can"
"""What is wrong with a mesh that collides and `is_flat`."""


class MeshFiles:
    """Looks mesh files up; `base` is the folder of the robot's file, None when it came without one."""

    def __init__(self, packages: Packages, base: Path | None) -> None:
        self.packages = packages
        self.base = base

    def locate(self, uri: str, written_in: str) -> tuple[Path | None, str]:
        """The file (absolute) or None, and in words why not. `written_in` is the file that names the mesh.

        Relative paths are looked up beside that file, and then beside the robot's own.
        """
        try:
            candidates = self._candidates(uri.strip(), written_in)
        except UnknownPackage as error:
            return None, str(error)
        for path in candidates:
            if is_file(path):
                return path.absolute(), ""
        places = ", ".join(str(path) for path in dict.fromkeys(candidates))
        return None, f"no such file; looked for {places}" if candidates else f"cannot be found: {_USABLE}"

    def expected(self, uri: str, written_in: str) -> Path | None:
        """Where a file that is not there was looked for first; None where its package is not there either."""
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


class UnreadMeshes(MeshFiles):
    """For whoever reads a robot for its joints alone: every mesh is taken to be there."""

    def __init__(self) -> None:
        super().__init__(Packages(), None)

    def locate(self, uri: str, written_in: str) -> tuple[Path | None, str]:  # noqa: ARG002 - nothing is looked up
        return Path(uri), ""


class BadMesh(BadFile):
    """A mesh file that cannot be read, or that is over a bound; the message says which and over what."""

    def __init__(self, message: str, path: str | Path) -> None:
        super().__init__(message, str(path))


class Triangles(NamedTuple):
    """A triangulated surface."""

    vertices: NDArray[np.float64]
    """n x 3, m."""
    faces: NDArray[np.int32]
    """m x 3, indices of vertices, counter-clockwise seen from outside."""


def load(path: str | Path, scale: Vector = (1.0, 1.0, 1.0)) -> Triangles:
    """All triangles of a mesh file in one surface, in the file's own frame, times `scale`.

    Raises:
        BadMesh: of no known kind, unreadable, over a bound, or without a triangle.
    """
    import numpy as np

    path = Path(path)
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise BadMesh(f"is of no known kind of mesh; known: {', '.join(SUFFIXES)}", path)
    content = _content(path)
    try:
        vertices, faces = _stl(content, path) if kind == ".stl" else _text_kind(kind, content, path)
    except (ValueError, IndexError, OverflowError) as error:
        raise BadMesh(f"cannot read the mesh: {str(error).strip() or type(error).__name__}", path) from None
    except RecursionError:
        raise BadMesh("cannot read the mesh: it is nested too deep", path) from None
    except MemoryError:
        raise BadMesh("cannot read the mesh: it needs more memory than there is for it", path) from None
    if not len(faces):
        raise BadMesh("the mesh has no triangle", path)
    check_faces(len(faces), path)
    vertices, faces = used(vertices, faces, path)
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = vertices * np.asarray(scale)
    if not np.isfinite(vertices).all():
        raise BadMesh("the mesh has infinite coordinates", path)
    if np.abs(vertices).max() > _FARTHEST:
        raise BadMesh(f"the mesh has coordinates of more than {_FARTHEST:g} m", path)
    # Mirroring turns triangles inside out; turn them back.
    return Triangles(vertices, faces[:, ::-1].copy() if np.prod(scale) < 0 else faces)


def is_flat(vertices: NDArray[np.float64]) -> bool:
    """Whether points lie in a plane, but for the rounding of their numbers, or in a box of next to no volume.

    The scale of an axis makes nothing flat: each axis is judged by its own length.
    """
    import numpy as np

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    with np.errstate(over="ignore"):
        if len(vertices) < 4 or float(np.prod(high - low)) < _SMALLEST_BOX:
            return True
    # Halves, as the difference of two finite numbers need not be finite.
    spread = (vertices / 2 - low / 2) / (high / 2 - low / 2)
    centred = spread - spread.mean(axis=0)
    # The singular values of the points are the roots of these eigenvalues, but for the rounding of a square: a body a
    # millionth as thick as it is wide needs the exact way.
    spans = np.linalg.eigvalsh(np.dot(centred.T, centred))
    if spans[0] > 1e-10 * spans[2]:
        return False
    exact = np.linalg.svd(centred, compute_uv=False)
    return bool(exact[2] <= _THINNEST * exact[0])


def check_faces(count: int, path: str | Path) -> None:
    """Raises BadMesh when a mesh has more triangles than may be."""
    if count > MOST_FACES:
        raise BadMesh(f"the mesh has {count} triangles, and more than {MOST_FACES} are refused", path)


def _content(path: Path) -> bytes:
    """All of a regular file of a size that may be. Never waits for one that is no file: a pipe, a device."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except (OSError, ValueError) as error:
        raise BadMesh(f"cannot read the mesh: {getattr(error, 'strerror', None) or error}", path) from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise BadMesh("is no file: a mesh is not read from a folder, a pipe or a device", path)
    with os.fdopen(descriptor, "rb") as stream:
        _check_size(status.st_size, MOST_BYTES, path)
        try:
            content = stream.read(MOST_BYTES + 1)
        except OSError as error:
            raise BadMesh(f"cannot read the mesh: {error.strerror}", path) from None
    _check_size(len(content), MOST_BYTES, path)  # it may have grown, or lie about its size as those of /proc do
    return content


def _check_size(size: int, most: int, path: Path) -> None:
    if size > most:
        raise BadMesh(f"the file has {size / 2**20:.0f} MiB, and more than {most // 2**20} MiB are refused", path)


def _text_kind(kind: str, content: bytes, path: Path) -> Triangles:
    _check_size(len(content), MOST_BYTES_OF_TEXT, path)
    if kind == ".obj":
        return _obj(content, path)
    from slidectl.description import collada

    return collada.read(content, path)


def _stl(content: bytes, path: Path) -> Triangles:
    """Binary when the size is what the header says: the text form begins with `solid`, but so do some binary ones."""
    import numpy as np

    count = int.from_bytes(content[80:_STL_HEADER], "little") if len(content) >= _STL_HEADER else 0
    if count and len(content) == _STL_HEADER + _STL_FACET * count:
        check_faces(count, path)
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(content, facet, count, _STL_HEADER)["corners"].reshape(-1, 3)
        return _merged(corners.astype(np.float64))
    _check_size(len(content), MOST_BYTES_OF_TEXT, path)
    if count and not content.lstrip()[:5].lower() == b"solid":
        raise BadMesh(f"cannot read the mesh: {len(content)} bytes are not those of {count} triangles", path)
    found = _VERTEX.findall(content)
    check_faces(len(found) // 3, path)
    corners = np.array(found, dtype=np.bytes_).astype(np.float64).reshape(-1, 3)
    return _merged(corners[: len(corners) // 3 * 3])


def _merged(corners: NDArray[np.float64]) -> Triangles:
    """Triangles from three corners each; corners at the same place become one vertex."""
    import numpy as np

    # Equal to the bit: sorting rows as wholes takes a tenth of the time of np.unique(axis=0).
    corners = np.ascontiguousarray(corners) + 0.0
    rows = corners.view([("x", "<f8"), ("y", "<f8"), ("z", "<f8")]).ravel()
    _, first, inverse = np.unique(rows, return_index=True, return_inverse=True)
    return Triangles(corners[first], inverse.reshape(-1, 3).astype(np.int32))


def _obj(content: bytes, path: Path) -> Triangles:
    """`v` and `f` lines; polygons are cut into fans. Negative numbers count back from the last vertex."""
    import numpy as np

    places: list[list[bytes]] = []
    faces: list[tuple[int, int, int]] = []
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            if len(words) < 4:
                raise BadMesh("cannot read the mesh: a vertex has three coordinates", path)
            if max(map(len, words[1:4])) > _LONGEST_NUMBER:
                raise BadMesh(f"cannot read the mesh: a number of more than {_LONGEST_NUMBER} letters", path)
            places.append(words[1:4])
        elif words[0] == b"f":
            corners = [_obj_index(word, len(places)) for word in words[1:]]
            faces += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
            check_faces(len(faces), path)
    vertices = np.array(places, dtype=np.bytes_).astype(np.float64).reshape(-1, 3)
    return Triangles(vertices, np.array(faces, np.int32).reshape(-1, 3))


def _obj_index(word: bytes, count: int) -> int:
    number = int(word.partition(b"/")[0])
    index = number - 1 if number > 0 else count + number
    if number == 0 or index < 0:
        raise ValueError(f"there is no vertex {number}")
    return index


def used(vertices: NDArray[np.float64], faces: NDArray[np.int32], path: Path) -> Triangles:
    """Only the vertices that a triangle has. Raises BadMesh for triangles with others than there are."""
    import numpy as np

    if faces.min() < 0 or faces.max() >= len(vertices):
        text = f"a triangle has the vertex {max(faces.max(), -faces.min())} of {len(vertices)}"
        raise BadMesh(f"cannot read the mesh: {text}", path)
    is_used = np.zeros(len(vertices), bool)
    is_used[faces.ravel()] = True
    return Triangles(vertices[is_used], (np.cumsum(is_used) - 1)[faces].astype(np.int32))
