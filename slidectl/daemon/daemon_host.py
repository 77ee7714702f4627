"""The host of a daemon's world: nothing that it does holds up the world or its clients.

Meshes are read and pictures are drawn in other processes while the world goes on, users' code has a limit of wall time,
and the log is a file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from slidectl.daemon.mesh_reader import MeshReader
from slidectl.daemon.picture_queue import PictureQueue
from slidectl.daemon.time_limit import TimeLimit
from slidectl.description.robot import Camera
from slidectl.event_loop import EventLoop
from slidectl.logfile import LogFile
from slidectl.physics import World
from slidectl.physics.hulls import MeshSource
from slidectl.rotations import Pose
from slidectl.simulation.host import Host
from slidectl.simulation.pending import Pending


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
