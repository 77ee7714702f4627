"""Mesh files as triangles: STL, OBJ and DAE, by trimesh, which is imported on the first use only.

Units of a DAE file count, its `<up_axis>` does not: Gazebo and RViz pay no heed to it, and robots are drawn for them.
Nothing is fetched from elsewhere, and no material or texture is read.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl.description.mesh_files import SUFFIXES
from slidectl.description.robot import Vector
from slidectl.errors import BadFile

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Triangles(NamedTuple):
    """A triangulated surface."""

    vertices: NDArray[np.float64]
    """n x 3, m."""
    faces: NDArray[np.int32]
    """m x 3, indices of vertices, counter-clockwise seen from outside."""


def load(path: str | Path, scale: Vector = (1.0, 1.0, 1.0)) -> Triangles:
    """All triangles of a mesh file in one surface, in the file's own frame, times `scale`.

    Raises:
        BadFile: of no known kind, unreadable, or without a triangle.
    """
    import numpy as np

    mesh = _mesh(Path(path))
    vertices = np.asarray(mesh.vertices, np.float64) * np.asarray(scale)
    faces = np.asarray(mesh.faces, np.int32)
    if not len(faces) or not np.isfinite(vertices).all():
        raise BadFile("the mesh has no triangle" if not len(faces) else "the mesh has infinite coordinates", str(path))
    # Mirroring turns triangles inside out; turn them back.
    return Triangles(vertices, faces[:, ::-1].copy() if np.prod(scale) < 0 else faces)


def _mesh(path: Path) -> Any:
    """The scene of a file with its nodes' transforms applied, as one trimesh mesh in metres."""
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise BadFile(f"is of no known kind of mesh; known: {', '.join(SUFFIXES)}", str(path))
    import trimesh

    try:
        with path.open("rb") as stream:
            scene = trimesh.load_scene(stream, file_type=kind[1:], skip_materials=True)
        mesh = scene.to_mesh()
        mesh.apply_scale(_metres(scene))
    except OSError as error:
        raise BadFile(f"cannot read the mesh: {error.strerror}", str(path)) from None
    except Exception as error:  # its loaders raise whatever their parsers do
        raise BadFile(f"cannot read the mesh: {str(error).strip() or type(error).__name__}", str(path)) from error
    return mesh


def _metres(scene: Any) -> float:
    """What one unit of the file is in metres; trimesh notes a DAE's as `0.01 * meters` on its geometries."""
    for geometry in scene.geometry.values():
        factor, star, _ = str(geometry.metadata.get("units", "")).partition("*")
        if star:
            return float(factor)
    return 1.0
