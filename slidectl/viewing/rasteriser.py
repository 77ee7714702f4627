"""Pictures without OpenGL: shaded triangles with a depth buffer, by numpy.

Triangles are filled by their edge functions in homogeneous coordinates (M. Olano, T. Greer: Triangle Scan Conversion
using 2D Homogeneous Coordinates, 1997), so that those behind the viewpoint need no clipping. Each triangle has one
shade; transparent ones are drawn opaque.
"""

from __future__ import annotations

import math

import numpy as np

from slidectl.measures import Array
from slidectl.viewing import drawn_scene
from slidectl.viewing.drawn_scene import DrawnScene, Viewpoint
from slidectl.viewing.picture_files import Pixels

_MOST_AT_ONCE = 1_000_000
"""Pixels of triangles processed together, some 100 bytes each."""
_FLAT = 1e-12


class Rasteriser:
    """Draws scenes at one picture size."""

    name = "software"

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._seen_from: tuple[bytes, bool] | None = None

    def draw(self, scene: DrawnScene, view: Viewpoint) -> Pixels:
        """Draw a picture: RGB, shape (height, width, 3)."""
        seen_from = (np.hstack(view).tobytes(), scene.ground)
        if self._seen_from != seen_from:  # in most videos the viewpoint does not move
            self._seen_from, self._behind = seen_from, self._background(scene, view)
        colours, nearness = self._behind[0].copy(), self._behind[1].copy()
        if scene.surfaces:
            corners = np.concatenate([scene.vertices(one)[one.faces] for one in scene.surfaces])
            bare = np.repeat([one.colour[:3] for one in scene.surfaces], [len(one.faces) for one in scene.surfaces], 0)
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
            # Back faces are not drawn, as in OpenGL: a camera may be inside its housing.
            front = np.einsum("ij,ij->i", normals, corners[:, 0] - view.eye) < 0
            shades = bare[front] * _light(normals[front], view)[:, None]
            self._fill(corners[front], shades, view, colours, nearness)
        width, height = self._size
        return np.rint(255.0 * colours.reshape(height, width, 3)).clip(0, 255).astype(np.uint8)

    def _background(self, scene: DrawnScene, view: Viewpoint) -> tuple[Array, Array]:
        """Colour, and 1 / depth, of the ground or the sky in each pixel, row by row from the top."""
        width, height = self._size
        across, down = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        length = _length(height, view)
        rays = (
            view.ahead
            + (across.ravel() - width / 2)[:, None] / length * view.right
            - (down.ravel() - height / 2)[:, None] / length * view.up
        )
        colours, nearness = np.tile(drawn_scene.SKY, (width * height, 1)), np.full(width * height, 1.0 / view.far)
        if scene.ground and view.eye[2] > 0:
            depths = np.divide(-view.eye[2], rays[:, 2], where=rays[:, 2] < 0, out=np.full(len(rays), np.inf))
            hit = depths < view.far
            tiles = np.floor(view.eye[:2] + depths[hit, None] * rays[hit, :2]).astype(int).sum(axis=1) % 2
            colours[hit] = np.array(drawn_scene.TILES)[tiles] * _light(np.array((0.0, 0.0, 1.0)), view)
            nearness[hit] = 1.0 / depths[hit]
        return colours, nearness

    def _fill(self, corners: Array, shades: Array, view: Viewpoint, colours: Array, nearness: Array) -> None:
        """Draw triangles with corners (n, 3, 3) and colours (n, 3) over the picture."""
        width, height = self._size
        length = _length(height, view)
        x, y, depth = np.moveaxis((corners - view.eye) @ np.column_stack((view.right, -view.up, view.ahead)), 2, 0)
        # One row per corner: its pixel coordinates times its depth, and its depth.
        places = np.stack((length * x + width / 2 * depth, length * y + height / 2 * depth, depth), axis=2)
        sizes = np.abs(places).max(axis=(1, 2)) ** 3
        drawn = (depth.max(axis=1) > view.near) & (np.abs(np.linalg.det(places)) > _FLAT * sizes)
        places, shades, depth = places[drawn], shades[drawn], depth[drawn]
        edges = np.linalg.inv(places)
        # The pixel box of each triangle: the whole picture for those that reach behind the viewpoint.
        is_ahead = depth.min(axis=1) > view.near
        limits = np.array((width, height))
        spots = places[is_ahead, :, :2] / depth[is_ahead, :, None]
        low, high = np.zeros((len(places), 2), int), np.tile(limits, (len(places), 1))
        low[is_ahead] = np.floor(spots.min(axis=1)).clip(0, limits)
        high[is_ahead] = np.ceil(spots.max(axis=1)).clip(0, limits)
        counts = (high - low).prod(axis=1)
        groups = np.cumsum(counts) // _MOST_AT_ONCE
        for group in np.unique(groups[counts > 0]):
            chosen = np.flatnonzero((groups == group) & (counts > 0))
            owner = np.repeat(chosen, counts[chosen])
            inside = np.arange(len(owner)) - np.repeat(np.cumsum(counts[chosen]) - counts[chosen], counts[chosen])
            row, column = np.divmod(inside, (high - low)[owner, 0])
            column, row = column + low[owner, 0], row + low[owner, 1]
            # Barycentric coordinates divided by depth; their sum is 1 / depth.
            parts = (column + 0.5)[:, None] * edges[owner, 0] + (row + 0.5)[:, None] * edges[owner, 1] + edges[owner, 2]
            near, pixels = parts.sum(axis=1), row * width + column
            seen = (parts >= 0).all(axis=1) & (near < 1.0 / view.near) & (near > nearness[pixels])
            seen = np.flatnonzero(seen)
            seen = seen[np.argsort(near[seen], kind="stable")]  # ascending: the nearest one is written last
            nearness[pixels[seen]], colours[pixels[seen]] = near[seen], shades[owner[seen]]


def _length(height: int, view: Viewpoint) -> float:
    """The focal length in pixels."""
    return height / 2 / math.tan(view.field_of_view / 2)


def _light(normals: Array, view: Viewpoint) -> Array:
    """The light on surfaces with these normals: ambient, from the viewpoint, and from the sun."""
    from_eye, from_sun = (-normals @ np.array(way) for way in (view.ahead, drawn_scene.SUN))
    light: Array = (
        drawn_scene.AMBIENT + drawn_scene.FROM_EYE * from_eye.clip(0) + drawn_scene.FROM_SUN * from_sun.clip(0)
    )
    return light
