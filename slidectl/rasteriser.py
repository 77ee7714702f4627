"""Pictures without OpenGL: shaded triangles and planes with a depth buffer, by numpy.

Triangles are filled by their edge functions in homogeneous coordinates (M. Olano, T. Greer: Triangle Scan Conversion
using 2D Homogeneous Coordinates, 1997), so that those behind the viewpoint need no clipping. Each triangle has one
shade; transparent ones are drawn opaque. It knows neither robots nor worlds. Arrays are in m, in world axes.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]
Indices = NDArray[np.int64]
Colour = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""
Light = Callable[[Any, Any], Any]
"""The light on surfaces at points (n, 3) with normals (n, 3), as a factor of each colour: shape (n, 1) or (n, 3).

It is called by several threads, and with arrays of single or double precision.
"""

SIDES = 24
"""Sides of the polygon that approximates a circle."""
_BAND = 1 << 16
"""Pixels of a band, which is drawn at once: what it needs fits a processor's cache."""
_LARGE = 1 << 12
"""Pixels of a triangle that is filled by itself, and not together with others."""
_MOST_KEPT = 1 << 22
"""Pixels of a picture, the planes and sky of which are kept for the next one."""
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


class Shadows(NamedTuple):
    """The shadows that lie on planes."""

    corners: Array
    """Triangles on the planes, shape (n, 3, 3)."""
    left: float
    """The part of the light that a plane has in them."""


class Haze(NamedTuple):
    """Planes fade into the colour of the horizon between these depths, m."""

    begin: float
    end: float


class SeenTriangles(NamedTuple):
    """Triangles as they are seen."""

    edges: Array
    """Inverse matrices of the corners, shape (n, 3, 3): for pixels, barycentric coordinates divided by depth."""
    low: Array
    """The first column and row of each, shape (n, 2)."""
    high: Array
    """The column and row behind the last ones."""
    shades: Array
    """Colours, shape (n, 3)."""


class Band(NamedTuple):
    """Some rows of a picture."""

    top: int
    """The first row."""
    pixels: NDArray[np.float32]
    """Colours, shape (3, rows, columns)."""
    nearness: Array
    """1 / depth, shape (rows, columns)."""
    on_plane: NDArray[np.bool_]
    """Where a plane is seen behind all triangles."""


class Rasteriser:
    """Draws pictures of one size."""

    def __init__(self, size: tuple[int, int], sky: tuple[Colour, Colour], samples: int = 1) -> None:
        """`size`: width and height in pixels. `sky`: its colours straight above (z), and at the horizon and below it.

        `samples`: each pixel is the mean of so many samples from side to side, and from top to bottom.
        """
        self._size = size[0] * samples, size[1] * samples
        self._sky, self._has_gradient = np.array(sky), sky[0] != sky[1]
        self._samples = samples
        self._rows = max(samples, _BAND // self._size[0] // samples * samples)
        # numpy lets other threads run while it computes. Bands are drawn in any order, with the same result.
        self._pool = ThreadPoolExecutor(os.cpu_count())
        self._seen_from = b""
        self._behind: dict[int, Band] = {}
        """The first row of each band, and its planes and sky."""

    def draw(
        self,
        corners: Array,
        colours: Array,
        planes: Sequence[Plane],
        light: Light,
        view: Viewpoint,
        shadows: Shadows | None = None,
        haze: Haze | None = None,
    ) -> NDArray[np.uint8]:
        """Draw triangles with corners (n, 3, 3) and colours (n, 3), and planes: RGB, shape (height, width, 3)."""
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        # Back faces are not drawn, as in OpenGL: a camera may be inside its housing.
        front = np.einsum("ij,ij->i", normals, corners[:, 0] - view.eye) < 0
        shades = (colours[front] * light(corners[front].mean(axis=1), normals[front])).clip(0.0, 1.0)
        seen = self._seen(corners[front], shades, view)
        shaded = None if shadows is None else self._seen(shadows.corners, np.zeros((len(shadows.corners), 3)), view)
        # In most videos, and for a camera that is fixed to the world, the viewpoint does not move.
        of_planes = (np.hstack((one.place, one.axes.ravel(), *one.tiles)) for one in planes)
        fixed = np.hstack([*view, *(haze or ()), *of_planes]).tobytes()
        is_kept = math.prod(self._size) <= _MOST_KEPT
        if self._seen_from != fixed:
            self._seen_from, self._behind = fixed if is_kept else b"", {}
        (width, height), samples = self._size, self._samples
        picture = np.empty((height // samples, width // samples, 3), np.uint8)

        def draw_band(top: int) -> None:
            band = self._behind.get(top)
            if band is None:
                band = self._background(top, min(self._rows, height - top), planes, light, view, haze)
                if is_kept:
                    self._behind[top] = band
            band = band._replace(pixels=band.pixels.copy(), nearness=band.nearness.copy())
            if shadows is not None and shaded is not None:
                covered = np.zeros(band.nearness.shape, bool)
                _cover(band, shaded, covered)
                band.pixels[:, covered & band.on_plane] *= np.float32(shadows.left)
            _fill(band, seen, view)
            rows = band.nearness.shape[0] // samples
            mean = band.pixels[:, ::samples, ::samples].copy()
            for number in range(1, samples**2):
                mean += band.pixels[:, number // samples :: samples, number % samples :: samples]
            mean *= np.float32(1.0 / samples**2)
            below = picture[top // samples : top // samples + rows]
            below[:] = np.moveaxis(np.rint(255.0 * mean.clip(0, 1)), 0, 2)

        for _ in self._pool.map(draw_band, range(0, height, self._rows)):
            pass  # raises what was raised
        return picture

    def _background(
        self, top: int, rows: int, planes: Sequence[Plane], light: Light, view: Viewpoint, haze: Haze | None
    ) -> Band:
        """Planes and sky of some rows."""
        across, down = _rays(self._size, view, top, rows)
        pixels = np.empty((3, rows, self._size[0]), np.float32)
        upwards = _upwards(view, across, down) if self._has_gradient else np.zeros((1, 1))
        pixels[:] = self._sky[1][:, None, None] + upwards * (self._sky[0] - self._sky[1])[:, None, None]
        band = Band(top, pixels, np.full(pixels.shape[1:], 1.0 / view.far), np.zeros(pixels.shape[1:], bool))
        for plane in planes:
            normal = plane.axes[:, 2]
            above = float((view.eye - plane.place) @ normal)
            if above <= 0:
                continue
            nearness = _along(view, across, down, normal) / -above
            hit = nearness > band.nearness
            # Half the digits take half the time, and place the tiles within a hundredth of a millimetre at 100 m.
            depths = (1.0 / nearness[hit]).astype(np.float32)
            spots = np.empty((len(depths), 3), np.float32)
            odd = np.zeros(len(depths), np.int32)
            for number, axis in enumerate(np.eye(3)):
                spots[:, number] = _along(view, across, down, axis)[hit] * depths + np.float32(view.eye[number])
            for axis in plane.axes.T[:2]:
                along = _along(view, across, down, axis)[hit] * depths + np.float32((view.eye - plane.place) @ axis)
                odd += np.floor(along).astype(np.int32)
            shades = light(spots, np.broadcast_to(normal.astype(np.float32), spots.shape))
            shades = shades * np.array(plane.tiles, np.float32)[odd & 1]
            if haze is not None:
                clear = ((haze.end - depths) / (haze.end - haze.begin)).clip(0.0, 1.0)[:, None]
                shades = clear * shades + (1.0 - clear) * self._sky[1].astype(np.float32)
            band.pixels[:, hit] = shades.T
            band.nearness[hit] = nearness[hit]
            band.on_plane[hit] = True
        return band

    def _seen(self, corners: Array, shades: Array, view: Viewpoint) -> SeenTriangles:
        """Those of the triangles with corners (n, 3, 3) and colours (n, 3) that may be seen."""
        width, height = self._size
        length = _length(height, view)
        x, y, depth = np.moveaxis((corners - view.eye) @ np.column_stack((view.right, -view.up, view.ahead)), 2, 0)
        # One row per corner: its pixel coordinates times its depth, and its depth.
        places = np.stack((length * x + width / 2 * depth, length * y + height / 2 * depth, depth), axis=2)
        sizes = np.abs(places).max(axis=(1, 2), initial=0.0) ** 3
        drawn = (depth.max(axis=1, initial=0.0) > view.near) & (np.abs(np.linalg.det(places)) > _FLAT * sizes)
        places, shades, depth = places[drawn], shades[drawn], depth[drawn]
        # The pixel box of each triangle: the whole picture for those that reach behind the viewpoint.
        is_ahead = (depth > view.near).all(axis=1)
        limits = np.array((width, height))
        spots = places[is_ahead, :, :2] / depth[is_ahead, :, None]
        low, high = np.zeros((len(places), 2), int), np.tile(limits, (len(places), 1))
        low[is_ahead] = np.floor(spots.min(axis=1)).clip(0, limits)
        high[is_ahead] = np.ceil(spots.max(axis=1)).clip(0, limits)
        return SeenTriangles(np.linalg.inv(places), low, high, shades)


def sky(size: tuple[int, int], view: Viewpoint, colours: tuple[Colour, Colour]) -> Array:
    """The sky in each pixel: from the colour at the horizon, and below it, to the one straight above (z).

    `size`: width and height. `colours`: straight above, and at the horizon. Shape (height, width, 3).
    """
    above, horizon = np.array(colours)
    sky: Array = horizon + _upwards(view, *_rays(size, view, 0, size[1]))[:, :, None] * (above - horizon)
    return sky


def _rays(size: tuple[int, int], view: Viewpoint, top: int, rows: int) -> tuple[Array, Array]:
    """How far the rays of some rows go to the right, shape (1, width), and down, (rows, 1), while they go 1 m ahead."""
    width, height = size
    length = _length(height, view)
    across = (np.arange(width, dtype=np.float64) + 0.5 - width / 2) / length
    down = (np.arange(top, top + rows, dtype=np.float64) + 0.5 - height / 2) / length
    return across[None, :], down[:, None]


def _upwards(view: Viewpoint, across: Array, down: Array) -> Array:
    """The sines of the angles of rays above the horizon; 0 below it."""
    upwards: Array = _along(view, across, down, np.array((0.0, 0.0, 1.0))).clip(0.0) / np.sqrt(
        1.0 + across**2 + down**2
    )
    return upwards


def _along(view: Viewpoint, across: Array, down: Array, axis: Array) -> Array:
    """The part along an axis of the way of a ray while it goes 1 m ahead, for all pixels."""
    way: Array = (float(view.ahead @ axis) + across * float(view.right @ axis)) - down * float(view.up @ axis)
    return way


def _of_band(band: Band, triangles: SeenTriangles) -> tuple[Indices, Indices, Indices]:
    """The triangles with pixels in a band: their numbers, their first rows in it, and the rows behind their last."""
    rows = band.nearness.shape[0]
    low, high = (triangles.low[:, 1] - band.top).clip(0, rows), (triangles.high[:, 1] - band.top).clip(0, rows)
    inside = np.flatnonzero((low < high) & (triangles.low[:, 0] < triangles.high[:, 0]))
    return inside, low[inside], high[inside]


def _box_parts(band: Band, triangles: SeenTriangles, number: int, low: int, high: int) -> tuple[Any, list[Array]]:
    """The box of a triangle in a band, and the barycentric coordinates divided by depth of its pixels."""
    left, right = triangles.low[number, 0], triangles.high[number, 0]
    columns, rows = np.arange(left, right) + 0.5, np.arange(band.top + low, band.top + high) + 0.5
    edges = triangles.edges[number]
    parts = [edges[0, part] * columns + (edges[1, part] * rows + edges[2, part])[:, None] for part in range(3)]
    return (slice(low, high), slice(left, right)), parts


def _large_parts(band: Band, triangles: SeenTriangles) -> Iterator[tuple[int, Any, list[Array]]]:
    """Each large triangle with pixels in a band: its number, and what `_box_parts` returns."""
    numbers, low, high = _of_band(band, triangles)
    is_large = _counts(triangles, numbers, low, high) > _LARGE
    for number, first, last in zip(numbers[is_large], low[is_large], high[is_large], strict=True):
        yield number, *_box_parts(band, triangles, number, first, last)


def _small_parts(band: Band, triangles: SeenTriangles) -> Iterator[tuple[Indices, Indices, Indices, Array]]:
    """The pixels of the boxes of many small triangles of a band at a time.

    Their triangles, rows, columns, and barycentric coordinates divided by depth, shape (n, 3).
    """
    numbers, low, high = _of_band(band, triangles)
    counts = _counts(triangles, numbers, low, high)
    is_small = counts <= _LARGE
    small, counts, low = numbers[is_small], counts[is_small], low[is_small]
    groups = np.cumsum(counts) // _BAND
    for group in np.unique(groups):
        here = np.flatnonzero(groups == group)
        owner = np.repeat(here, counts[here])
        inside = np.arange(len(owner)) - np.repeat(np.cumsum(counts[here]) - counts[here], counts[here])
        number = small[owner]
        first = triangles.low[number, 0]
        row, column = np.divmod(inside, triangles.high[number, 0] - first)
        row, column = row + low[owner], column + first
        edges = triangles.edges[number]
        parts = (column + 0.5)[:, None] * edges[:, 0] + (row + band.top + 0.5)[:, None] * edges[:, 1] + edges[:, 2]
        yield number, row, column, parts


def _counts(triangles: SeenTriangles, numbers: Indices, low: Indices, high: Indices) -> Indices:
    """The pixels in the box of each triangle, between its rows `low` and `high`."""
    counts: Indices = (high - low) * (triangles.high[numbers, 0] - triangles.low[numbers, 0])
    return counts


def _cover(band: Band, triangles: SeenTriangles, covered: NDArray[np.bool_]) -> None:
    """Set where a triangle is."""
    for _, box, parts in _large_parts(band, triangles):
        covered[box] |= (parts[0] >= 0) & (parts[1] >= 0) & (parts[2] >= 0)
    for _, row, column, of_pixels in _small_parts(band, triangles):
        inside = (of_pixels >= 0).all(axis=1)
        covered[row[inside], column[inside]] = True


def _fill(band: Band, triangles: SeenTriangles, view: Viewpoint) -> None:
    """Draw triangles over a band."""
    for number, box, parts in _large_parts(band, triangles):
        near = parts[0] + parts[1] + parts[2]
        is_seen = (parts[0] >= 0) & (parts[1] >= 0) & (parts[2] >= 0)
        is_seen &= (near < 1.0 / view.near) & (near > band.nearness[box])
        np.copyto(band.nearness[box], near, where=is_seen)
        for channel, shade in zip(band.pixels, triangles.shades[number], strict=True):
            np.copyto(channel[box], np.float32(shade), where=is_seen)
    for owners, row, column, of_pixels in _small_parts(band, triangles):
        near = of_pixels.sum(axis=1)
        is_seen = (of_pixels >= 0).all(axis=1) & (near < 1.0 / view.near) & (near > band.nearness[row, column])
        seen = np.flatnonzero(is_seen)
        seen = seen[np.argsort(near[seen], kind="stable")]  # ascending: the nearest one is written last
        band.nearness[row[seen], column[seen]] = near[seen]
        band.pixels[:, row[seen], column[seen]] = triangles.shades[owners[seen]].T


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
