"""The host of a world: all that reaches it from outside, beside the calls and messages of its users.

A world reads files, imports users' code, gets meshes and pictures, and writes its log through this one object. So a
host that records all answers (see docs/journal.md) makes a world repeatable, and one that answers from the record
repeats it. A world reads no wall time; what wall time decides reaches it through `let_go` and the limit on users' code.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from slidectl.control.node_handle import Message
from slidectl.control.user_modules import CodeHost, CodeLimit
from slidectl.description.sensors import Camera
from slidectl.errors import Refused, SlidectlError
from slidectl.physics import World, hulls
from slidectl.physics.hulls import MeshSource
from slidectl.physics.rendering import RenderProcess
from slidectl.rotations import Pose
from slidectl.simulation.pending import Pending

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

_KEPT_LINES = 200


class InputRecorder(Protocol):
    """Records what clients do to a world."""

    def record(self, session: Any, line: bytes, message: Message) -> None:
        """A client, known by its session, has sent a line. Called before it is handled, with the decoded message."""

    def record_end(self, session: Any) -> None:
        """The client of the session has disconnected."""


class Host(CodeHost):
    """The host of a plain script: files are read and pictures drawn in the call that needs them, and block it.

    Derive from it, or from HostWrapper to change one thing of another host. A host serves one world.
    """

    def __init__(self, limit: CodeLimit | None = None) -> None:
        """`limit` is the context in which users' code runs; without one it may run as long as it likes."""
        super().__init__(limit)
        self.simulation: Simulation | None = None
        """The world that it serves, once it is made."""
        self.recorder: InputRecorder | None = None
        """Records what clients do; None: it is not recorded."""
        self.reports: list[Callable[[], dict[str, Any]]] = []
        """Functions that return fields of `/slidectl/status`: wall times, connections, memory. Drivers add theirs."""
        self.lines: deque[str] = deque(maxlen=_KEPT_LINES)
        """The last lines of the log, each with severity, simulated time and node."""
        self._renderer: RenderProcess | None = None

    def attach(self, simulation: Simulation) -> None:
        """Serve this world, which is complete now. Called once, before its first cycle."""
        self.simulation = simulation

    # --- files --------------------------------------------------------------------------------------------------

    def read_or_raise(self, what: str, look: Callable[[], Any]) -> Any:
        """As `read`, for a `look` that may raise a SlidectlError; from a record comes a Refused with its text.

        `look` must read the disk itself: reads through the host inside it would be recorded twice.
        """
        raised: list[SlidectlError] = []

        def attempt() -> tuple[Any, str]:
            try:
                return look(), ""
            except SlidectlError as error:
                raised.append(error)
                return None, str(error)

        found, trouble = self.read(what, attempt)
        if trouble:
            raise raised[0] if raised else Refused(trouble)
        return found

    def read_meshes(self, sources: Sequence[MeshSource]) -> Pending:
        """Read mesh files. Resolved, now or in a later turn, with their convex hulls (physics.hulls.Hulls).

        A mesh that cannot be read has a BadMesh in it. Rejected with Refused: none can be read now.
        """
        return Pending.of({source: hulls.read(source) for source in sources})

    # --- pictures -----------------------------------------------------------------------------------------------

    def render(self, world: World, camera: Camera, pose: Pose, seed: int) -> Pending:
        """Draw what a camera sees now. Resolved, now or in a later turn, with its pixels, row by row, in base64.

        Args:
            world: the world, whose present state is drawn.
            pose: the camera's, m and a quaternion x y z w, in the world.
            seed: the seed of the camera's noise.

        Rejected with Refused: there is no picture, with the reason.
        """
        renderer = self._renderer = self._renderer or RenderProcess()

        def render() -> str:
            renderer.start(renderer.request(world, camera, pose, seed))
            return renderer.receive()

        return Pending.attempt(render)

    def drawn_by(self) -> str:
        """What drew the last picture: OpenGL, or software with the reason; empty before the first one."""
        return self._renderer.drawn_by if self._renderer else ""

    # --- log, status, time --------------------------------------------------------------------------------------

    def log(self, severity: str, node: str, text: str, time_ns: int) -> None:
        """Write a line of the log. `severity` is debug, info, warn, error or fatal; `time_ns` simulated time, ns."""
        self.lines.append(f"{severity:<5} [{time_ns * 1e-9:.3f}] {node}: {text}")

    def status(self) -> dict[str, Any]:
        """The fields that are added to `/slidectl/status`."""
        return {name: value for report in self.reports for name, value in report().items()}

    def let_go(self, node: str) -> None:
        """Called before a lock-step member is removed that has held the world for too long by wall time."""

    # --- beginning and end --------------------------------------------------------------------------------------

    def begin(self, publications: Any, unexpected: Callable[[str], None]) -> Iterable[tuple[str, str]]:  # noqa: ARG002
        """Do what comes before the first client, such as a replay. Called by the daemon, once.

        Args:
            publications: daemon.outbox.Publications of the world's clients.
            unexpected: logs the exception that is being handled.

        Returns lines for the log: severity and text.
        """
        return ()

    def abandon(self) -> None:
        """Undo what was begun: the world could not be made."""

    def close(self, why: str) -> None:  # noqa: ARG002 - a record ends with it
        """End what serves the world. `why` is the reason for its end."""
        self.limit.close()
        if self._renderer is not None:
            self._renderer.close()


class HostWrapper(Host):
    """Passes everything on to another host. Derived classes change or record a part of it."""

    def __init__(self, inner: Host) -> None:
        super().__init__(inner.limit)
        self.inner = inner
        self.given, self.recorder = inner.given, inner.recorder
        self.reports, self.lines = inner.reports, inner.lines

    def attach(self, simulation: Simulation) -> None:
        super().attach(simulation)
        self.inner.attach(simulation)


def _passed_on(name: str) -> Callable[..., Any]:
    def call(self: HostWrapper, *arguments: Any) -> Any:
        return getattr(self.inner, name)(*arguments)

    return call


for _name in (
    "read", "imported", "read_meshes", "render", "drawn_by", "log", "let_go", "begin", "abandon", "close",
):  # fmt: skip
    setattr(HostWrapper, _name, _passed_on(_name))
