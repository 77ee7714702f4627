"""From where the world is seen: fixed views of all of it, one that goes with a link, and the cameras of the robots."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slidectl import rotations
from slidectl.description.robot import Camera
from slidectl.errors import AmbiguousName, UnknownName
from slidectl.rotations import Vector
from slidectl.viewing.drawn_scene import Array, DrawnScene

FOLLOW = "follow:"
VIEWS: dict[str, Vector] = {
    "iso": (0.62, -0.66, 0.42),
    "front": (1.0, 0.0, 0.0),
    "top": (0.0, 0.0, 1.0),
    "side": (0.0, -1.0, 0.0),
}
"""From the middle of the world to the eye. In `side` x goes to the right, in `top` y goes up."""
_FIELD_OF_VIEW = math.radians(40.0)
_MARGIN = 1.05


class Viewpoint(NamedTuple):
    """An eye; the axes are unit vectors."""

    eye: Array
    right: Array
    up: Array
    ahead: Array
    field_of_view: float
    """From the bottom of the picture to its top, rad."""
    near: float
    """m."""
    far: float


class ViewpointChoice:
    """What `--camera` names, for pictures of one size. A fixed view stays as it was for the first picture."""

    def __init__(self, scene: DrawnScene, camera: str, size: tuple[int, int]) -> None:
        """Raises UnknownName, AmbiguousName."""
        self._aspect = size[0] / size[1]
        self._link = self._camera = ""
        if camera.startswith(FOLLOW):
            self._link = _one("link", camera.removeprefix(FOLLOW), list(scene.poses), list(scene.poses))
        elif camera not in VIEWS:
            self._camera = _one("camera", camera, list(scene.cameras), [*VIEWS, f"{FOLLOW}LINK", *scene.cameras])
        self._direction = np.array(VIEWS.get(camera, VIEWS["iso"])) / np.linalg.norm(VIEWS.get(camera, VIEWS["iso"]))
        self._centre, radius = scene.bounds(self._link.partition("::")[0])
        narrowest = math.atan(math.tan(_FIELD_OF_VIEW / 2) * min(1.0, self._aspect))
        self._distance = _MARGIN * radius / math.sin(narrowest)

    def of(self, scene: DrawnScene) -> Viewpoint:
        """The eye now."""
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
        return Viewpoint(eye, right, np.cross(right, ahead), ahead, _FIELD_OF_VIEW, 0.01 * distance, 100.0 * distance)

    def _of_model(self, scene: DrawnScene, camera: Camera) -> Viewpoint:
        """It looks along its x axis; its field of view is from side to side."""
        link = scene.poses[f"{self._camera.partition('::')[0]}::{camera.link}"]
        place, turn = rotations.compose(link, (camera.origin.xyz, rotations.from_rpy(camera.origin.rpy)))
        ahead, left, up = np.array(rotations.matrix(turn)).T
        field = 2 * math.atan(math.tan(camera.field_of_view / 2) / self._aspect)
        return Viewpoint(np.array(place), -left, up, ahead, field, camera.near, camera.far)


def _one(kind: str, name: str, names: list[str], known: list[str]) -> str:
    """The one that a full name, or the part behind the robot's, means."""
    found = [full for full in names if name in (full, full.partition("::")[2])]
    if not found:
        raise UnknownName(kind, name, known)
    if len(found) > 1:
        raise AmbiguousName(kind, name, found, "write the full name: ROBOT::NAME")
    return found[0]
