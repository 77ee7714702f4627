"""Pictures of cameras without OpenGL: the shapes of a MuJoCo model as triangles, drawn by numpy.

Light is as MuJoCo's: from the camera, and from the world's spotlight. Shadows, gloss, haze and transparency are not
drawn.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from slidectl import rasteriser
from slidectl.physics.attached_robot import Array
from slidectl.rasteriser import Plane, Rasteriser, Viewpoint
from slidectl.rotations import Pose, matrix

if TYPE_CHECKING:
    from slidectl.description.sensors import Camera

_NOTHING = ((0.0, 0.0, 0.0),) * 2
"""The colours where nothing is, as by MuJoCo."""


class SoftwareDrawer:
    """Draws a model, with a rasteriser for each size."""

    def __init__(self, model: Any) -> None:
        self._model = model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        self._head = model.vis.headlight
        self._light_of_world = _Spotlight(model, data)
        solid = [geom for geom in range(model.ngeom) if model.geom_rgba[geom, 3] > 0.0]
        self._planes = [geom for geom in solid if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE]
        shapes = {geom: _triangles(model, geom) for geom in solid if geom not in self._planes}
        self._corners = np.concatenate([np.zeros((0, 3, 3)), *shapes.values()])
        """In the frames of their shapes."""
        self._owners = np.repeat(list(shapes), [len(corners) for corners in shapes.values()]).astype(int)
        """The shape of each triangle."""
        self._rasterisers: dict[tuple[int, int], Rasteriser] = {}

    def draw(self, positions: Array, matrices: Array, camera: Camera, pose: Pose) -> Any:
        """RGB, shape (height, width, 3), of shapes at positions (n, 3), turned by matrices (n, 9)."""
        size = (camera.width, camera.height)
        if size not in self._rasterisers:
            self._rasterisers[size] = Rasteriser(size, _NOTHING)
        ahead, left, up = np.array(matrix(pose[1])).T
        height = np.arctan(np.tan(camera.field_of_view / 2) * camera.height / camera.width)
        view = Viewpoint(np.array(pose[0]), -left, up, ahead, 2.0 * float(height), camera.near, camera.far)
        turns, owners, colours = matrices.reshape(-1, 3, 3), self._owners, self._model.geom_rgba[:, :3].astype(float)
        corners = np.einsum("nij,nkj->nki", turns[owners], self._corners) + positions[owners, None, :]
        planes = [Plane(positions[geom], turns[geom], (tuple(colours[geom]),) * 2) for geom in self._planes]
        light = partial(self._light, ahead)
        return self._rasterisers[size].draw(corners, colours[owners], planes, light, view)

    def close(self) -> None:
        """Nothing is held."""

    def _light(self, ahead: Array, points: Array, normals: Array) -> Array:
        ambient, diffuse = (_without_colour(part) for part in (self._head.ambient, self._head.diffuse))
        cosines = (-normals @ ahead.astype(normals.dtype)).clip(0.0)
        light: Array = ambient + cosines[:, None] * diffuse
        return light + self._light_of_world.on(points, normals)


class _Spotlight:
    """The light of the world, as OpenGL's fixed functions compute it, in single precision for points in that."""

    def __init__(self, model: Any, data: Any) -> None:
        self._place, self._direction = (row[0].astype(np.float32) for row in (data.light_xpos, data.light_xdir))
        self._diffuse, self._ambient = _without_colour(model.light_diffuse[0]), _without_colour(model.light_ambient[0])
        self._attenuation = [float(factor) for factor in model.light_attenuation[0]]
        self._widest = math.cos(math.radians(model.light_cutoff[0]))
        self._exponent = float(model.light_exponent[0])

    def on(self, points: Array, normals: Array) -> Array:
        """The light on surfaces at points (n, 3) with normals (n, 3): shape (n, 1), or (n, 3) of a coloured light."""
        towards = self._place - points
        distances = np.sqrt(np.einsum("ij,ij->i", towards, towards)).clip(1e-9)
        ahead = -(towards @ self._direction) / distances
        light = np.zeros((len(points), max(len(self._ambient), len(self._diffuse))), points.dtype)
        lit = np.flatnonzero(ahead >= self._widest)
        far, (constant, linear, quadratic) = distances[lit], self._attenuation
        strength = ahead[lit].clip(0.0) ** self._exponent / (constant + far * (linear + far * quadratic))
        cosines = (np.einsum("ij,ij->i", normals[lit], towards[lit]) / far).clip(0.0)
        light[lit] = strength[:, None] * (self._ambient + cosines[:, None] * self._diffuse)
        return light


def _without_colour(light: Array) -> Array:
    """One number for white light, which takes a third of the time, else red, green and blue."""
    return light[:1].copy() if (light == light[0]).all() else light.copy()


def _triangles(model: Any, geom: int) -> Array:
    """The corners of a shape's triangles in its frame, shape (n, 3, 3)."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        vertices, faces = rasteriser.box(2.0 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        vertices, faces = rasteriser.cylinder(float(size[0]), 2.0 * float(size[1]))
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        vertices, faces = rasteriser.sphere(float(size[0]))
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        vertices, faces = rasteriser.sphere(1.0)
        vertices = vertices * size
    else:  # builder.py makes no others
        assert kind == mujoco.mjtGeom.mjGEOM_MESH, kind
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        vertices = model.mesh_vert[first : first + count].astype(float)
        first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        faces = model.mesh_face[first : first + count]
    corners: Array = vertices[faces]
    return corners
