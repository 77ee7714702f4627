"""The scene to draw: the triangles and colours of all links, the poses of the links, and the viewpoint.

It is made from the answer of /slidectl/scene, and reads mesh files. It knows no picture formats. Arrays are in m, in
world axes unless stated otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slidectl import description, rasteriser, rotations
from slidectl.description import link_colours, meshes
from slidectl.description.link_colours import Colour
from slidectl.description.meshes import BadMesh, Triangles
from slidectl.description.robot import Box, Cylinder, Geometry, Link, Robot, Shape, Sphere
from slidectl.description.sensors import Camera
from slidectl.errors import AmbiguousName, UnknownName
from slidectl.measures import Array
from slidectl.rasteriser import Viewpoint
from slidectl.rotations import Vector

if TYPE_CHECKING:
    from slidectl.msgs.typed import SceneResponseMsg

SKY = ((0.42, 0.58, 0.80), (0.86, 0.91, 0.96))
"""Colours of the sky straight above, and at the horizon, into which the far ground fades."""
TILES = ((0.80, 0.80, 0.80), (0.86, 0.86, 0.86))
"""Colours of the ground's tiles, which are 1 m wide."""
SUN = (-0.37, 0.46, -0.81)
"""The direction of sunlight."""
AMBIENT, FROM_EYE, FROM_SUN = 0.4, 0.2, 0.4
"""Parts of the reflected light; their sum is 1."""
_MISSING_M = 0.1
"""Edge length of the box drawn for an unreadable mesh."""
_FOLLOW = "follow:"
VIEWS: dict[str, Vector] = {
    "iso": (0.62, -0.66, 0.42),
    "front": (1.0, 0.0, 0.0),
    "top": (0.0, 0.0, 1.0),
    "side": (0.0, -1.0, 0.0),
}
"""Direction from the centre of the world to the viewpoint. In `side` x points right, in `top` y points up."""
_FIELD_OF_VIEW = math.radians(40.0)
_MARGIN = 1.05
_FARTHEST = 1000.0
"""The last depth that is drawn, in distances from the eye to the middle.

The slack with which OpenGL compares the depths of shadows grows with it: with less the ground shades itself.
"""


class ColouredSurface(NamedTuple):
    """The triangles of one colour on one link."""

    link: str
    """ROBOT::LINK."""
    vertices: Array
    """n x 3, in the link's frame."""
    faces: NDArray[np.int32]
    """m x 3."""
    colour: Colour


class DrawnScene:
    """Robots and ground; `place` sets the present poses."""

    def __init__(self, answer: SceneResponseMsg, collisions: bool = False) -> None:
        """`answer` is that of /slidectl/scene, with descriptions. `collisions`: draw collision shapes, not visuals."""
        self.ground = bool(answer["ground"])
        self.robots: dict[str, Robot] = {
            name: description.parse(xml, may_use_files=may_use_files)
            for name, xml, may_use_files in zip(
                answer["robots"], answer["descriptions"], answer["may_use_files"], strict=True
            )
        }
        self.notices: list[str] = []
        """Warnings about what is drawn differently than intended."""
        self.surfaces = [
            surface
            for name, robot in self.robots.items()
            for link in robot.links.values()
            for surface in self._surfaces(name, robot, link, collisions)
        ]
        self.place(answer)

    @property
    def cameras(self) -> dict[str, Camera]:
        """The cameras of the robots, by ROBOT::CAMERA."""
        sensors = [(name, sensor) for name, robot in self.robots.items() for sensor in robot.sensors]
        return {f"{name}::{sensor.name}": sensor for name, sensor in sensors if isinstance(sensor, Camera)}

    def place(self, answer: SceneResponseMsg) -> bool:
        """Set the present poses of the links. Returns False when the robots have changed: make a new scene."""
        if "poses" in vars(self) and answer["serials"] != self._serials:
            return False
        self._serials: list[int] = answer["serials"]
        self.time = float(answer["time"])
        """Simulated time, s."""
        self.poses: dict[str, rotations.Pose] = {f"{name}::world": rotations.ORIGIN for name in self.robots}
        """ROBOT::LINK -> pose, for all links."""
        for link, pose in zip(answer["links"], answer["poses"], strict=True):
            place, turn = pose["position"], pose["orientation"]
            self.poses[link] = ((place["x"], place["y"], place["z"]), (turn["x"], turn["y"], turn["z"], turn["w"]))
        return True

    def vertices(self, surface: ColouredSurface) -> Array:
        """The vertices of a surface in world axes, n x 3."""
        place, turn = self.poses[surface.link]
        vertices: Array = surface.vertices @ np.array(rotations.matrix(turn)).T + place
        return vertices

    def bounds(self, robot: str = "") -> tuple[Array, float]:
        """Centre and radius of a sphere around all surfaces of a robot, or of all robots."""
        seen = [
            self.vertices(surface) for surface in self.surfaces if surface.link.startswith(f"{robot}::" * bool(robot))
        ]
        if not seen:
            return np.zeros(3), 1.0
        low, high = np.min([one.min(axis=0) for one in seen], axis=0), np.max([one.max(axis=0) for one in seen], axis=0)
        return (low + high) / 2, max(_MISSING_M, float(np.linalg.norm(high - low)) / 2)

    def haze(self, view: Viewpoint) -> tuple[float, float]:
        """The depths (m, from the eye) where the haze of the far ground begins, behind all robots, and is complete."""
        centre, radius = self.bounds()
        begin = max(0.0, float((centre - view.eye) @ view.ahead)) + 3.0 * radius
        return begin, begin + 30.0 * radius

    def _surfaces(self, name: str, robot: Robot, link: Link, collisions: bool) -> Iterator[ColouredSurface]:
        """The visuals of a link; the collision shapes if the robot has no visuals, or with `collisions`."""
        has_visuals = not collisions and any(one.visuals for one in robot.links.values())
        parts: dict[Colour, list[Triangles]] = {}
        for shape in link.visuals if has_visuals else link.collisions:
            colour = link_colours.of_shape(link, shape)
            if colour[3] > 0.0:
                parts.setdefault(colour, []).append(self._triangles(f"{name}::{link.name}", shape))
        for colour, pieces in parts.items():
            starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
            faces = np.concatenate([piece.faces + start for piece, start in zip(pieces, starts, strict=False)])
            yield ColouredSurface(
                f"{name}::{link.name}",
                np.concatenate([piece.vertices for piece in pieces]),
                faces.astype(np.int32),
                colour,
            )

    def _triangles(self, link: str, shape: Shape) -> Triangles:
        """The triangles of a shape in the frame of its link."""
        try:
            vertices, faces = _triangles_of(shape.geometry)
        except BadMesh as error:
            self.notices.append(f"{link}: {error}; a box of {_MISSING_M} m is drawn in its place")
            vertices, faces = rasteriser.box((_MISSING_M,) * 3)
        turn = np.array(rotations.matrix(rotations.from_rpy(shape.origin.rpy)))
        return Triangles(vertices @ turn.T + shape.origin.xyz, faces)


def _triangles_of(geometry: Geometry) -> Triangles:
    """The triangles of a geometry. Raises BadMesh."""
    if isinstance(geometry, Box):
        return Triangles(*rasteriser.box(geometry.size))
    if isinstance(geometry, Cylinder):
        return Triangles(*rasteriser.cylinder(geometry.radius, geometry.length))
    if isinstance(geometry, Sphere):
        return Triangles(*rasteriser.sphere(geometry.radius))
    if geometry.path is None:
        raise BadMesh("the mesh is not there", geometry.uri)
    return meshes.load(geometry.path, geometry.scale)


# --- from where it is seen --------------------------------------------------------------------------------------------


class ViewpointChoice:
    """The viewpoint named by `--camera`, for pictures of one size. A fixed view is computed once."""

    def __init__(self, scene: DrawnScene, camera: str, size: tuple[int, int]) -> None:
        """Raises UnknownName, AmbiguousName."""
        self._aspect = size[0] / size[1]
        self._link = self._camera = ""
        if camera.startswith(_FOLLOW):
            self._link = _one("link", camera.removeprefix(_FOLLOW), list(scene.poses), list(scene.poses))
        elif camera not in VIEWS:
            self._camera = _one("camera", camera, list(scene.cameras), [*VIEWS, f"{_FOLLOW}LINK", *scene.cameras])
        self._direction = np.array(VIEWS.get(camera, VIEWS["iso"])) / np.linalg.norm(VIEWS.get(camera, VIEWS["iso"]))
        self._centre, radius = scene.bounds(self._link.partition("::")[0])
        narrowest = math.atan(math.tan(_FIELD_OF_VIEW / 2) * min(1.0, self._aspect))
        self._distance = _MARGIN * radius / math.sin(narrowest)

    def of(self, scene: DrawnScene) -> Viewpoint:
        """The present viewpoint. Raises UnknownName."""
        if self._camera:
            if self._camera not in scene.cameras:
                raise UnknownName("camera", self._camera, list(scene.cameras))
            return self._of_model(scene, scene.cameras[self._camera])
        if self._link:
            if self._link not in scene.poses:
                raise UnknownName("link", self._link, list(scene.poses))
            self._centre = np.array(scene.poses[self._link][0])
        distance, ahead = self._distance, -self._direction
        right = np.cross(ahead, (0.0, 1.0, 0.0) if abs(ahead[2]) > 0.99 else (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        eye = self._centre - distance * ahead
        near, far = 0.01 * distance, _FARTHEST * distance
        return Viewpoint(eye, right, np.cross(right, ahead), ahead, _FIELD_OF_VIEW, near, far)

    def _of_model(self, scene: DrawnScene, camera: Camera) -> Viewpoint:
        """The viewpoint of a robot's camera. It looks along its x axis; its own field of view is horizontal."""
        link = scene.poses[f"{self._camera.partition('::')[0]}::{camera.link}"]
        place, turn = rotations.compose(link, (camera.origin.xyz, rotations.from_rpy(camera.origin.rpy)))
        ahead, left, up = np.array(rotations.matrix(turn)).T
        field = 2 * math.atan(math.tan(camera.field_of_view / 2) / self._aspect)
        return Viewpoint(np.array(place), -left, up, ahead, field, camera.near, camera.far)


def _one(kind: str, name: str, names: list[str], known: list[str]) -> str:
    """Find a full name, or the part behind the robot's name. Raises UnknownName, AmbiguousName."""
    found = [full for full in names if name in (full, full.partition("::")[2])]
    if not found:
        raise UnknownName(kind, name, known)
    if len(found) > 1:
        raise AmbiguousName(kind, name, found, "write the full name: ROBOT::NAME")
    return found[0]
