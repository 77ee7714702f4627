"""Pictures by OpenGL without a display: MuJoCo draws the triangles of a scene, each link as a mocap body."""

from __future__ import annotations

import importlib
from typing import Any

import mujoco
import numpy as np

from slidectl import rasteriser
from slidectl.errors import Refused
from slidectl.extensions.viewing import drawn_scene
from slidectl.extensions.viewing.drawn_scene import DrawnScene
from slidectl.extensions.viewing.picture_files import Pixels
from slidectl.physics import rendering
from slidectl.rasteriser import Viewpoint

_MOST_SHAPES = 10_000
_SHADOW_PIXELS = 2048
"""Width of the map of shadows. Without a graphics card one of 4096 takes as long as all else."""


class GlRenderer:
    """Draws scenes at one picture size."""

    name = "OpenGL"

    def __init__(self, size: tuple[int, int]) -> None:
        """Raises Refused: OpenGL is not usable."""
        backend = rendering.gl_backend()
        if not backend:
            raise Refused("there is no OpenGL", rendering.INSTALL)
        self._size = size
        try:
            self._context = importlib.import_module(f"mujoco.{backend}").GLContext(*size)
            self._context.make_current()
        except Exception as error:  # from the library, the driver or PyOpenGL
            raise Refused(f"OpenGL ({backend}) cannot be used: {error}", rendering.INSTALL) from None
        self._scene: DrawnScene | None = None

    def draw(self, scene: DrawnScene, view: Viewpoint) -> Pixels:
        """Draw a picture: RGB, shape (height, width, 3). Raises Refused."""
        if self._scene is not scene or self._reaches_fog(scene, view):
            self._take(scene, view)
        model, data = self._model, self._data
        for link, mocap in self._mocaps.items():
            data.mocap_pos[mocap], (x, y, z, w) = scene.poses[link]
            data.mocap_quat[mocap] = w, x, y, z
        data.mocap_pos[self._eye] = view.eye
        mujoco.mju_mat2Quat(data.mocap_quat[self._eye], np.column_stack((view.right, view.up, -view.ahead)).ravel())
        # Shadows reach as far as the robots do now.
        centre, radius = scene.bounds()
        model.light_pos[0], self._drawer.shadowClip = centre - 2.0 * radius * np.array(drawn_scene.SUN), 1.1 * radius
        model.cam_fovy[0] = np.degrees(view.field_of_view)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._drawn)
        box = mujoco.MjrRect(0, 0, *self._size)
        mujoco.mjr_render(box, self._drawn, self._drawer)
        pixels, depths = np.empty((self._size[1], self._size[0], 3), np.uint8), np.empty(self._size[::-1], np.float32)
        mujoco.mjr_readPixels(pixels, depths, box, self._drawer)
        end = (1.0 / view.near - 1.0 / model.vis.map.fogend) / (1.0 / view.near - 1.0 / view.far)
        pixels, is_sky = np.ascontiguousarray(pixels[::-1]), depths[::-1] >= end
        if is_sky.any():  # MuJoCo's fog hides its sky, too
            pixels[is_sky] = np.rint(255.0 * rasteriser.sky(self._size, view, drawn_scene.SKY)[is_sky])
        return pixels

    def _reaches_fog(self, scene: DrawnScene, view: Viewpoint) -> bool:
        """Whether robots have gone so far that the fog, whose place OpenGL keeps, would hide them."""
        centre, radius = scene.bounds()
        return float((centre - view.eye) @ view.ahead) + radius > float(self._model.vis.map.fogstart)

    def _take(self, scene: DrawnScene, view: Viewpoint) -> None:
        try:
            self._model = _spec(scene).compile()
        except (ValueError, mujoco.FatalError) as error:
            raise Refused(f"MuJoCo cannot draw the world: {error}") from None
        model = self._model
        lengths = model.vis.map  # times the extent, which is 1
        lengths.znear, lengths.zfar = view.near, view.far
        lengths.fogstart, lengths.fogend = scene.haze(view)
        model.vis.rgba.fog[:3] = drawn_scene.SKY[1]
        model.vis.quality.shadowsize = _SHADOW_PIXELS
        model.vis.global_.offwidth, model.vis.global_.offheight = self._size
        self._scene, self._data = scene, mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._mocaps = {link: int(model.body(link).mocapid[0]) for link in {one.link for one in scene.surfaces}}
        self._eye = int(model.body("eye").mocapid[0])
        self._option, self._drawn = mujoco.MjvOption(), mujoco.MjvScene(model, _MOST_SHAPES)
        self._drawn.flags[mujoco.mjtRndFlag.mjRND_HAZE] = False  # it begins where MuJoCo's plane ends: a fog does not
        self._drawn.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        self._camera = mujoco.MjvCamera()
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        self._drawer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawer)


def _spec(scene: DrawnScene) -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.stat.extent = 1.0
    head = spec.visual.headlight
    head.ambient, head.diffuse = [drawn_scene.AMBIENT] * 3, [drawn_scene.FROM_EYE] * 3
    head.specular = [0.0] * 3
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=drawn_scene.SUN, ambient=[0, 0, 0],
        diffuse=[drawn_scene.FROM_SUN] * 3, specular=[0, 0, 0],
    )  # fmt: skip
    spec.add_texture(  # edges are smoothed against it
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, width=8,
        height=48, rgb1=drawn_scene.SKY[1], rgb2=drawn_scene.SKY[1],
    )  # fmt: skip
    if scene.ground:
        spec.add_texture(
            name="tiles", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            width=256, height=256, rgb1=drawn_scene.TILES[1], rgb2=drawn_scene.TILES[0],
        )  # fmt: skip
        material = spec.add_material(name="tiles", texuniform=True, texrepeat=[1, 1], specular=0.0, reflectance=0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], material="tiles")
    bodies: dict[str, Any] = {}
    for number, one in enumerate(scene.surfaces):
        if one.link not in bodies:
            bodies[one.link] = spec.worldbody.add_body(name=one.link, mocap=True)
        # The inertia is that of the shell, because a flat or open mesh has no volume.
        spec.add_mesh(
            name=f"mesh{number}", uservert=one.vertices.ravel(), userface=one.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        bodies[one.link].add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"mesh{number}", rgba=one.colour, contype=0, conaffinity=0
        )
    spec.worldbody.add_body(name="eye", mocap=True).add_camera(name="eye")
    return spec
