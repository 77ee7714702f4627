"""Pictures without OpenGL: the triangles of a scene, drawn by numpy."""

from __future__ import annotations

from functools import partial

import numpy as np

from slidectl.extensions.viewing import drawn_scene
from slidectl.extensions.viewing.drawn_scene import DrawnScene
from slidectl.extensions.viewing.picture_files import Pixels
from slidectl.measures import Array
from slidectl.rasteriser import Haze, Light, Plane, Rasteriser, Shadows, Viewpoint

_GROUND = Plane(np.zeros(3), np.eye(3), drawn_scene.TILES)
_SAMPLES = 2
"""Samples of a pixel from side to side, so that edges are smooth."""


class SoftwareRenderer:
    """Draws scenes at one picture size."""

    name = "software"

    def __init__(self, size: tuple[int, int]) -> None:
        self._rasteriser = Rasteriser(size, drawn_scene.SKY, _SAMPLES)
        self._scene: DrawnScene | None = None
        self._haze = Haze(0.0, 0.0)

    def draw(self, scene: DrawnScene, view: Viewpoint) -> Pixels:
        """Draw a picture: RGB, shape (height, width, 3)."""
        if self._scene is not scene:  # the haze stays where it is, and with it the picture of the ground
            self._scene, self._haze = scene, Haze(*scene.haze(view))
        surfaces = scene.surfaces
        corners = np.concatenate([np.zeros((0, 3, 3)), *(scene.vertices(one)[one.faces] for one in surfaces)])
        of_surfaces = np.array([one.colour[:3] for one in surfaces]).reshape(-1, 3)
        colours = np.repeat(of_surfaces, [len(one.faces) for one in surfaces], axis=0)
        light = partial(_light, view.ahead)
        planes, shadows = [], None
        if scene.ground:
            planes, shadows = [_GROUND], _shadows(corners, light)
        return self._rasteriser.draw(corners, colours, planes, light, view, shadows, self._haze)


def _light(ahead: Array, _: Array, normals: Array) -> Array:
    """The light on surfaces with these normals: ambient, from the viewpoint, and from the sun."""
    from_eye, from_sun = (-normals @ np.array(way) for way in (ahead, drawn_scene.SUN))
    light: Array = (
        drawn_scene.AMBIENT + drawn_scene.FROM_EYE * from_eye.clip(0) + drawn_scene.FROM_SUN * from_sun.clip(0)
    )
    return light[:, None]


def _shadows(corners: Array, light: Light) -> Shadows:
    """The shadows of triangles with corners (n, 3, 3) on the ground."""
    up, sun = np.array([[0.0, 0.0, 1.0]]), np.array(drawn_scene.SUN)
    casting = corners[(corners[:, :, 2] > 0.0).any(axis=1)].copy()
    casting[:, :, 2] = casting[:, :, 2].clip(0.0)
    lit = float(light(np.zeros((1, 3)), up)[0, 0])
    return Shadows(casting - casting[:, :, 2:] / sun[2] * sun, 1.0 + drawn_scene.FROM_SUN * float(sun[2]) / lit)
