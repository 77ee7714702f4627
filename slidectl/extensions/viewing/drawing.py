"""Pictures of the present world of a daemon."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from slidectl.client import Client
from slidectl.errors import Refused
from slidectl.extensions.viewing.drawn_scene import DrawnScene, ViewpointChoice
from slidectl.extensions.viewing.picture_files import Pixels
from slidectl.extensions.viewing.software_renderer import SoftwareRenderer

if TYPE_CHECKING:
    from slidectl.extensions.viewing.gl_renderer import GlRenderer


class WorldView:
    """Draws the world of a daemon from one camera, by OpenGL or, if that is not usable, by software."""

    def __init__(
        self, client: Client, camera: str, size: tuple[int, int], software: bool, tell: Callable[[str], None]
    ) -> None:
        """`tell` takes warnings about what is drawn differently than intended. Raises UnknownName, AmbiguousName."""
        self._client = client
        self._size = size
        self._tell = tell
        self.scene = self._new_scene()
        self._choice = ViewpointChoice(self.scene, camera, size)
        self.drawer: GlRenderer | SoftwareRenderer = SoftwareRenderer(size)
        if not software:
            try:
                from slidectl import physics  # noqa: F401 - MuJoCo, which may not be usable
                from slidectl.extensions.viewing.gl_renderer import GlRenderer

                self.drawer = GlRenderer(size)
            except Refused as error:
                self._tell_of_software(error)

    def draw(self) -> Pixels:
        """Draw the present world. Raises NoDaemon. UnknownName: the camera or its link no longer exists."""
        if not self.scene.place(self._client.call("/slidectl/scene")):
            self.scene = self._new_scene()
        view = self._choice.of(self.scene)
        try:
            return self.drawer.draw(self.scene, view)
        except Refused as error:
            self._tell_of_software(error)
            self.drawer = SoftwareRenderer(self._size)
            return self.drawer.draw(self.scene, view)

    def _new_scene(self) -> DrawnScene:
        scene = DrawnScene(self._client.call("/slidectl/scene", {"descriptions": True}))
        for notice in scene.notices:
            self._tell(notice)
        return scene

    def _tell_of_software(self, error: Refused) -> None:
        self._tell(f"drawn by software: {error.message}" + (f"; {error.hint}" if error.hint else ""))
