"""Pictures of cameras on links, rendered in a separate process: by MuJoCo with OpenGL, or by software.

A picture takes some milliseconds with a graphics card, and a quarter of a second without, so no cycle waits for one.
The process gets the model once and the poses of all shapes with each frame, and ends with its parent. It renders the
collision shapes, in the colours of their links. Where OpenGL (EGL or OSMesa) is missing or fails, software draws.
"""

from __future__ import annotations

import base64
import ctypes
import os
import pickle
import subprocess
import sys
from contextlib import suppress
from functools import lru_cache
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import mujoco
import numpy as np

from slidectl.description import link_colours
from slidectl.errors import Refused
from slidectl.operating_system import memory_file
from slidectl.physics.attached_robot import Array
from slidectl.physics.collisions import link_of
from slidectl.physics.software_pictures import SoftwareDrawer
from slidectl.rotations import Pose, rotate

if TYPE_CHECKING:
    from slidectl.description.sensors import Camera
    from slidectl.physics.world import World

INSTALL = "install OpenGL for programs without a screen: apt install libegl1 (with a driver: libgl1-mesa-dri)"
_LIBRARIES = {"egl": ("libEGL.so.1",), "osmesa": ("libOSMesa.so.8", "libOSMesa.so.6")}
BY_OPENGL, BY_SOFTWARE = "OpenGL", "software"
_PROCESSOR_DRIVERS = (b"llvmpipe", b"softpipe", b"swrast", b"software")
"""What Mesa's names of drivers without a graphics card contain."""
_GREY = np.array([0.299, 0.587, 0.114])
"""The parts of red, green and blue in a grey picture, as of ITU-R BT.601."""
_AMBIENT = 0.4
"""Ambient light, as in Gazebo's worlds."""


class PictureRequest(NamedTuple):
    """The data for one picture."""

    model: Any
    """The world's model. When sent to the process: in MuJoCo's binary form, or None if it has not changed."""
    colours: Array
    positions: Array
    """Positions of all shapes, m, shape (n, 3)."""
    matrices: Array
    """Rotation matrices of all shapes, shape (n, 9)."""
    camera: Camera
    pose: Pose
    seed: int
    """Seed of the noise."""


class _Answer(NamedTuple):
    """The pixels, in base64, or an error; and what drew them."""

    pixels: str
    error: str
    drawn_by: str


def gl_backend() -> str:
    """The installed OpenGL backend, by MuJoCo's name; empty for none."""
    for backend, files in _LIBRARIES.items():
        for file in files:
            with suppress(OSError):
                ctypes.CDLL(file)
                return backend
    return ""


class RenderProcess:
    """The client of the rendering process. The first frame starts the process, which renders one frame at a time."""

    def __init__(self) -> None:
        self.drawn_by = ""
        """What drew the last picture: OpenGL, or software with the reason; empty before the first one."""
        self._breaks = ""
        """The OpenGL that ended the process before the first picture."""
        self._process: subprocess.Popen[bytes] | None = None
        self._model: Any = None
        """The model that the process has."""
        self._coloured: Any = None
        self._colours: Array = np.zeros(0)
        self._answers: Connection[Any, Any] | None = None
        self._request: BinaryIO | None = None
        """Memory file that the process reads after it receives a byte. A pipe would block: it holds 64 KB, and is not
        read while the process starts."""

    def request(self, world: World, camera: Camera, pose: Pose, seed: int) -> PictureRequest:
        """The request for a picture of the present moment, for `start`."""
        if self._coloured is not world.model:
            self._coloured, self._colours = world.model, _colours(world)
        data = world.present()
        return PictureRequest(
            world.model, self._colours, data.geom_xpos.copy(), data.geom_xmat.copy(), camera, pose, seed
        )

    def start(self, frame: PictureRequest) -> int:
        """Start a picture. Returns the file descriptor of the answer. Raises Refused: the process cannot be used."""
        if self._process is not None and self._process.poll() is not None:
            self.close()
        try:
            process = self._process or self._begin()
            assert process.stdin is not None
            assert self._answers is not None
            assert self._request is not None
            is_same, self._model = self._model is frame.model, frame.model
            self._request.seek(0)
            self._request.truncate()
            binary = None if is_same else np.empty(mujoco.mj_sizeModel(frame.model), np.uint8)
            if binary is not None:
                mujoco.mj_saveModel(frame.model, None, binary)
            pickle.dump(frame._replace(model=binary), self._request)
            self._request.flush()
            process.stdin.write(b"\n")
        except OSError as error:
            self.close()
            raise Refused(f"the process that renders pictures cannot be used: {error.strerror}") from None
        return self._answers.fileno()

    def receive(self) -> str:
        """The pixels, in base64. Blocks until they are there. Raises Refused: there is no picture."""
        assert self._process is not None
        assert self._answers is not None
        try:
            answer = _Answer(*self._answers.recv())  # not the class itself: that of the process is in `__main__`
        except (EOFError, OSError):  # `start` closes the pipes, since the caller may still poll this one
            self._process.kill()
            self._process.wait()
            if not self.drawn_by:
                self._breaks = gl_backend()
            raise Refused("the process that renders pictures has ended") from None
        self.drawn_by = answer.drawn_by
        if answer.error:
            self._model = None  # the process may not have the model
            raise Refused(f"no picture: {answer.error}")
        return answer.pixels

    def close(self) -> None:
        """End the process."""
        process, self._process, self._model = self._process, None, None
        for pipe in (self._request, self._answers):
            if pipe is not None:
                pipe.close()
        self._request = self._answers = None
        if process is not None:
            process.kill()
            with process:  # waits for it, and closes its pipes
                pass

    def _begin(self) -> subprocess.Popen[bytes]:
        backend = gl_backend()
        if not backend:
            why = "there is no OpenGL"
        elif backend == self._breaks:
            why = f"OpenGL ({backend}) ends the process that uses it"
        else:
            why = ""
        environment = {**os.environ, "MUJOCO_GL": "disable" if why else backend}
        self._request, path = memory_file("request")
        self._answers, answers = Pipe(duplex=False)
        with answers:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "slidectl.physics.rendering", path, str(answers.fileno()), why],
                bufsize=0,  # no unwritten data remains when the process has ended
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[self._request.fileno(), answers.fileno()],
                env=environment,
                start_new_session=True,
            )
        return self._process


def _colours(world: World) -> Array:
    """Red, green, blue and alpha of each shape, by its link. Shape (n, 4)."""
    model = world.model
    robots = {world.robot(name).root_id: world.robot(name) for name in world.names()}
    colours = np.tile(np.array(link_colours.PLAIN), (model.ngeom, 1))
    for geom in range(model.ngeom):
        robot = robots.get(int(model.body_rootid[model.geom_bodyid[geom]]))
        link = robot.description.links.get(link_of(model, geom, robot.name)) if robot is not None else None
        if link is not None:
            colours[geom] = link_colours.of_link(link)
    return colours


# --- the process ------------------------------------------------------------------------------------------------------


class _CameraPictures:
    """The state of the rendering process: the model, and what draws it."""

    def __init__(self, why: str) -> None:
        """`why`: the reason to draw by software, empty for OpenGL."""
        self._why = why
        self._model: Any = None
        self._drawer: _OpenGlDrawer | SoftwareDrawer | None = None

    @property
    def drawn_by(self) -> str:
        """What draws: OpenGL, or software with the reason."""
        return f"{BY_SOFTWARE}: {self._why}" if self._why else BY_OPENGL

    def render(self, frame: PictureRequest) -> bytes:
        """The pixels, row by row from the top."""
        if frame.model is not None:
            self._set_model(frame)
        camera = frame.camera
        pixels = self._draw(frame)
        if camera.encoding == "mono8":
            pixels = np.rint(pixels @ _GREY).astype(np.uint8)
        elif camera.encoding == "bgr8":
            pixels = pixels[:, :, ::-1]
        if camera.noise > 0.0 or camera.mean:
            drawn = np.random.default_rng(frame.seed).integers(1 << 16, size=pixels.shape, dtype=np.uint16)
            pixels = (pixels + _noise_levels(camera.mean, camera.noise)[drawn]).clip(0, 255).astype(np.uint8)
        content: bytes = pixels.tobytes()
        return content

    def _draw(self, frame: PictureRequest) -> Any:
        """RGB, shape (height, width, 3)."""
        if not self._why:
            try:
                self._drawer = self._drawer or _OpenGlDrawer(self._model)
                return self._drawer.draw(frame.positions, frame.matrices, frame.camera, frame.pose)
            except Exception as error:  # from the library, the driver or PyOpenGL
                self._why, self._drawer = f"OpenGL cannot be used: {type(error).__name__}: {error}", None
        self._drawer = self._drawer or SoftwareDrawer(self._model)
        return self._drawer.draw(frame.positions, frame.matrices, frame.camera, frame.pose)

    def _set_model(self, frame: PictureRequest) -> None:
        if self._drawer is not None:
            self._drawer.close()
            self._drawer = None
        self._model = mujoco.MjModel.from_binary_path("world.mjb", {"world.mjb": frame.model.tobytes()})
        self._model.geom_rgba[:] = frame.colours
        self._model.vis.headlight.ambient[:] = _AMBIENT
        self._model.vis.headlight.specular[:] = 0.0


@lru_cache
def _noise_levels(mean: float, deviation: float) -> Any:
    """65536 values of equal probability of a normal distribution, of which the whole range of a pixel is 1.

    Pixels are whole numbers, and so are these: nothing is lost, and a picture has its noise in a fifth of the time.
    """
    normal = NormalDist(mean, deviation) if deviation > 0.0 else None
    parts = (np.arange(1 << 16) + 0.5) / (1 << 16)
    values = np.array([normal.inv_cdf(part) for part in parts]) if normal else np.full(1 << 16, mean)
    return np.rint(255.0 * values).clip(-255, 255).astype(np.int16)


class _OpenGlDrawer:
    """Draws a model by MuJoCo, with a renderer for each size.

    Without a graphics card OpenGL computes shadows on the processor, in three quarters of the time of a picture: there
    are none then, so that cameras keep their rates.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._renderers: dict[tuple[int, int], Any] = {}

    def draw(self, positions: Array, matrices: Array, camera: Camera, pose: Pose) -> Any:
        """RGB, shape (height, width, 3)."""
        data = self._data
        data.geom_xpos[:], data.geom_xmat[:] = positions, matrices
        size = (camera.height, camera.width)
        if size not in self._renderers:
            screen = self._model.vis.global_
            screen.offheight, screen.offwidth = size  # the size of the renderer's buffers
            made = self._renderers[size] = mujoco.Renderer(self._model, *size)
            made.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = not _is_without_card()
        renderer = self._renderers[size]
        renderer.update_scene(data)
        top = camera.near * np.tan(camera.field_of_view / 2) * camera.height / camera.width
        ahead, up = (rotate(pose[1], axis) for axis in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
        for light in renderer.scene.lights[: renderer.scene.nlight]:
            if light.headlight:
                light.pos[:], light.dir[:] = pose[0], ahead
        for view in renderer.scene.camera:
            view.pos[:], view.forward[:], view.up[:] = pose[0], ahead, up
            view.frustum_center = view.frustum_width = 0.0
            view.frustum_bottom, view.frustum_top = -top, top
            view.frustum_near, view.frustum_far = camera.near, camera.far
        return renderer.render()

    def close(self) -> None:
        """Free what the renderers hold."""
        for renderer in self._renderers.values():
            renderer.close()


def _is_without_card() -> bool:
    """Whether the OpenGL of the current context computes on the processor."""
    from OpenGL import GL

    name = GL.glGetString(GL.GL_RENDERER) or b""
    return any(software in name.lower() for software in _PROCESSOR_DRIVERS)


def main(request: str, answers: str, why: str) -> None:
    """For each byte from the standard input, render the request in a file, and send the answer to a descriptor."""
    target, pictures = Connection(int(answers)), _CameraPictures(why)
    while sys.stdin.buffer.read(1):
        with open(request, "rb") as file:
            frame = pickle.load(file)
        pixels = trouble = ""
        try:
            pixels = base64.b64encode(pictures.render(frame)).decode()
        except Exception as error:
            trouble = f"{type(error).__name__}: {error}"
        target.send(tuple(_Answer(pixels, trouble, pictures.drawn_by)))


if __name__ == "__main__":
    os.nice(10)  # the cycles of the world have priority
    main(*sys.argv[1:])
