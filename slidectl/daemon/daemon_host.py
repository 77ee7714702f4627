"""The host of a daemon's world, and the hosts of extensions around it: nothing here holds up the world or its clients.

Meshes are read and pictures are drawn in other processes while the world goes on, users' code has a limit of wall time,
and the log is a file.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from importlib import import_module

from slidectl.daemon.mesh_reader import MeshReader
from slidectl.daemon.options import DaemonOptions
from slidectl.daemon.time_limit import TimeLimit
from slidectl.description.sensors import Camera
from slidectl.errors import Refused
from slidectl.event_loop import READ, EventLoop
from slidectl.logfile import LogFile
from slidectl.physics import World
from slidectl.physics.hulls import MeshSource
from slidectl.physics.rendering import PictureRequest, RenderProcess
from slidectl.rotations import Pose
from slidectl.simulation.host import Host
from slidectl.simulation.pending import Pending

WRAPPERS = {
    "replay": ("slidectl.extensions.journal.journal_replay", "host_of"),
    "journal": ("slidectl.extensions.journal.journal", "host_of"),
}
"""Hosts of extensions that a daemon puts around its own: the start option, and the module and its function.

The function takes the daemon's host and options and returns a host around it.

A host that has a `simulation` already has made the world. Of two that are asked for, the first is used.
"""


class DaemonHost(Host):
    """Serves the world of a daemon through its loop. `unexpected` logs the exception that is being handled."""

    def __init__(self, loop: EventLoop, log: LogFile, unexpected: Callable[[str], None]) -> None:
        super().__init__(TimeLimit())
        self._log = log
        self._mesh_reader = MeshReader(loop, unexpected)
        self._pictures = PictureQueue(loop)

    def read_meshes(self, sources: Sequence[MeshSource]) -> Pending:
        return self._mesh_reader.read(sources)

    def render(self, world: World, camera: Camera, pose: Pose, seed: int) -> Pending:
        return self._pictures.render(world, camera, pose, seed)

    def drawn_by(self) -> str:
        return self._pictures.drawn_by()

    def log(self, severity: str, node: str, text: str, time_ns: int) -> None:
        self._log.write(severity, f"[{time_ns * 1e-9:.3f}] {node}: {text}")

    def close(self, why: str) -> None:
        super().close(why)
        self._mesh_reader.close()
        self._pictures.close()


def wrapped(host: Host, options: DaemonOptions) -> Host:
    """The host in the wrapper that the options ask for; itself without one. Raises as the wrapper's function."""
    for option, (module, function) in WRAPPERS.items():
        if getattr(options, option):
            made: Host = getattr(import_module(module), function)(host, options)
            return made
    return host


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
        self._waiting.append((pending, self._renderer.request(world, camera, pose, seed)))
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
                self._descriptor = self._renderer.start(frame)
            except Refused as error:
                pending.reject(error)
                continue
            self._current = pending
            self._loop.watch(self._descriptor, READ, self._receive)

    def _receive(self, _: int) -> None:
        pending = self._current
        assert pending is not None
        answer = Pending.attempt(self._renderer.receive)
        self._forget()
        pending.settle(answer.result)
        self._next()

    def _forget(self) -> None:
        if self._current is not None:
            self._loop.forget(self._descriptor)
            self._current = None
