"""Pictures without OpenGL: shaded triangles and planes with a depth buffer, by numpy.

Triangles are filled by their edge functions in homogeneous coordinates (M. Olano, T. Greer: Triangle Scan Conversion
using 2D Homogeneous Coordinates, 1997), so that those behind the viewpoint need no clipping. Each triangle has one
shade; transparent ones are drawn opaque. It knows neither robots nor worlds. Arrays are in m, in world axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]
Colour = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""
Light = Callable[[Array, Array], Array]
"""The light on surfaces at points (n, 3) with normals (n, 3), as a factor of each colour: shape (n, 1) or (n, 3)."""

SIDES = 24
"""Sides of the polygon that approximates a circle."""
_MOST_AT_ONCE = 1_000_000
"""Pixels of triangles processed together, some 100 bytes each."""
_FLAT = 1e-12


class Viewpoint(NamedTuple):
    """A viewpoint; the axes are unit vectors."""

    eye: Array
    right: Array
    up: Array
    ahead: Array
    field_of_view: float
    """Vertical angle, rad."""
    near: float
    """m."""
    far: float


class Plane(NamedTuple):
    """An infinite plane, which is seen from the side to which its normal points."""

    place: Array
    axes: Array
    """Shape (3, 3): the columns are two axes in the plane, and its normal."""
    tiles: tuple[Colour, Colour]
    """The two colours of its tiles, which are 1 m wide."""


class Rasteriser:
    """Draws pictures of one size."""

    def __init__(self, size: tuple[int, int], sky: Colour) -> None:
        """`size`: width and height in pixels. `sky`: the colour where nothing is."""
        self._size = size
        self._sky = sky
        self._seen_from = b""

    def draw(
        self, corners: Array, colours: Array, planes: Sequence[Plane], light: Light, view: Viewpoint
    ) -> NDArray[np.uint8]:
        """Draw triangles with corners (n, 3, 3) and colours (n, 3), and planes: RGB, shape (height, width, 3)."""
        # In most videos, and for a camera that is fixed to the world, the viewpoint does not move.
        seen_from = np.hstack([*view, *(np.hstack((one.place, one.axes.ravel(), *one.tiles)) for one in planes)])
        if self._seen_from != seen_from.tobytes():
            self._seen_from, self._behind = seen_from.tobytes(), self._background(planes, light, view)
        pixels, nearness = self._behind[0].copy(), self._behind[1].copy()
        if len(corners):
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
            # Back faces are not drawn, as in OpenGL: a camera may be inside its housing.
            front = np.einsum("ij,ij->i", normals, corners[:, 0] - view.eye) < 0
            shades = colours[front] * light(corners[front].mean(axis=1), normals[front])
            self._fill(corners[front], shades, view, pixels, nearness)
        width, height = self._size
        return np.rint(255.0 * pixels.reshape(height, width, 3).clip(0, 1)).astype(np.uint8)

    def _background(self, planes: Sequence[Plane], light: Light, view: Viewpoint) -> tuple[Array, Array]:
        """Colour, and 1 / depth, of a plane or the sky in each pixel, row by row from the top."""
        width, height = self._size
        across, down = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        length = _length(height, view)
        rays = (
            view.ahead
            + (across.ravel() - width / 2)[:, None] / length * view.right
            - (down.ravel() - height / 2)[:, None] / length * view.up
        )
        colours, nearness = np.tile(self._sky, (width * height, 1)), np.full(width * height, 1.0 / view.far)
        for plane in planes:
            normal = plane.axes[:, 2]
            above, slope = float((view.eye - plane.place) @ normal), rays @ normal
            if above <= 0:
                continue
            depths = np.divide(-above, slope, where=slope < 0, out=np.full(len(rays), np.inf))
            hit = np.flatnonzero(1.0 / depths > nearness)
            points = view.eye + depths[hit, None] * rays[hit]
            tiles = np.floor((points - plane.place) @ plane.axes[:, :2]).astype(int).sum(axis=1) % 2
            colours[hit] = np.array(plane.tiles)[tiles] * light(points, np.tile(normal, (len(hit), 1)))
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


# --- triangles of shapes ----------------------------------------------------------------------------------------------


def box(size: Sequence[float]) -> tuple[Array, Faces]:
    """Vertices and faces of a box with these edge lengths, m, about its centre."""
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return corners, np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))], dtype=np.int32)


def cylinder(radius: float, length: float) -> tuple[Array, Faces]:
    """Vertices and faces of a cylinder about its centre and along z."""
    half = length / 2
    return _turned([(0.0, -half), (radius, -half), (radius, half), (0.0, half)])


def sphere(radius: float) -> tuple[Array, Faces]:
    """Vertices and faces of a sphere about its centre."""
    angles = [math.pi * (step / (SIDES // 2) - 0.5) for step in range(SIDES // 2 + 1)]
    return _turned([(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles])


def _turned(outline: list[tuple[float, float]]) -> tuple[Array, Faces]:
    """The solid of revolution of an outline (radius, height), listed from its lowest point, about the z axis."""
    angles = np.arange(SIDES) * (2 * math.pi / SIDES)
    rings = [np.column_stack((r * np.cos(angles), r * np.sin(angles), np.full(SIDES, z))) for r, z in outline]
    now, after = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
    faces = []
    for ring in range(len(outline) - 1):
        low, high = ring * SIDES, (ring + 1) * SIDES
        faces.append(np.column_stack((low + now, low + after, high + after)))
        faces.append(np.column_stack((low + now, high + after, high + now)))
    return np.concatenate(rings), np.concatenate(faces).astype(np.int32)
