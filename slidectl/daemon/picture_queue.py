"""The queue of camera pictures: one is rendered at a time, while the world goes on.

A process renders them, see physics/rendering.py. This module knows no topics.
"""

from __future__ import annotations

from collections import deque

from slidectl.description.robot import Camera
from slidectl.errors import Refused
from slidectl.event_loop import READ, EventLoop
from slidectl.physics import World
from slidectl.physics.rendering import PictureRequest, RenderProcess
from slidectl.rotations import Pose
from slidectl.simulation.pending import Pending


class PictureQueue:
    """Requests one picture after the other from a render process, and receives them through `loop`."""

    def __init__(self, loop: EventLoop) -> None:
        self._loop = loop
        self._renderer = RenderProcess()
        self._waiting: deque[tuple[Pending, PictureRequest]] = deque()
        self._current: Pending | None = None
        self._descriptor = -1

    def render(self, world: World, camera: Camera, pose: Pose, seed: int) -> Pending:
        """Request a picture of the world's present state. Resolved with the pixels (base64)."""
        pending = Pending()
        self._waiting.append((pending, self._renderer.look(world, camera, pose, seed)))
        self._next()
        return pending

    def drawn_by(self) -> str:
        """What drew the last picture: OpenGL, or software with the reason; empty before the first one."""
        return self._renderer.drawn_by

    def close(self) -> None:
        """End the process; open requests get no picture."""
        self._waiting.clear()
        self._forget()
        self._renderer.close()

    def _next(self) -> None:
        while self._waiting and self._current is None:
            pending, frame = self._waiting.popleft()
            try:
                self._descriptor = self._renderer.ask(frame)
            except Refused as error:
                pending.reject(error)
                continue
            self._current = pending
            self._loop.watch(self._descriptor, READ, self._receive)

    def _receive(self, _: int) -> None:
        pending = self._current
        assert pending is not None
        try:
            picture = self._renderer.take()
        except Refused as error:
            self._forget()
            pending.reject(error)
        else:
            if picture is None:
                return
            self._forget()
            pending.resolve(picture)
        self._next()

    def _forget(self) -> None:
        if self._current is not None:
            self._loop.forget(self._descriptor)
            self._current = None
