"""Nodes without any task here. Their text says why, and what to use instead.

rviz, rqt and gzclient are windows, which do not exist here; node_kinds decides when RViz is run as a program. A
joint_state_publisher would contradict the simulated joints.
"""

from __future__ import annotations

from slidectl import open_page
from slidectl.extensions.launch.plan import LaunchPlan, Node
from slidectl.extensions.launch.task import Run, Task
from slidectl.paths import InstancePaths

_SERVED = "the page takes its place"


class LeftOut(Task):
    """A node without a task; `text` is printed as a warning."""

    family = "notice"
    keeps_running = False
    is_missed = True
    """False when nothing of the launch is missing without it."""

    @property
    def text(self) -> str:
        return f"left out: {'; '.join(self.why())}"

    def why(self, paths: InstancePaths | None = None) -> list[str]:
        """Why there is no such node, and what serves in its place with the daemon of `paths`, in lines."""
        raise NotImplementedError

    def start(self, run: Run) -> str | None:
        self.warn(run, f"left out: {'; '.join(self.why(run.client.paths))}")
        return None


class Viewer(LeftOut):
    """A window of rviz or rqt; leaving it out is a warning, unless the page is open in its place."""

    def why(self, paths: InstancePaths | None = None) -> list[str]:
        return open_page.instead_of_window(self.node.package, self.node.words, paths)

    def start(self, run: Run) -> str | None:
        if run.has_page:
            self.is_missed = False
            self.settled(run, _SERVED)
            return None
        return super().start(run)


class Window(LeftOut):
    """gzclient. Launch files start it by default, so leaving it out is no warning."""

    is_missed = False

    @property
    def text(self) -> str:
        return "; ".join(self.why())

    def why(self, paths: InstancePaths | None = None) -> list[str]:
        return open_page.instead_of_window(self.node.package, (), paths)

    def start(self, run: Run) -> str | None:
        self.settled(run, _SERVED if run.has_page else "; ".join(self.why(run.client.paths)))
        return None


class JointStatePublisher(LeftOut):
    """A joint_state_publisher. It would contradict the world's joint states, so it is left out with a warning."""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self._is_launched = bool(plan.files)
        self._has_robot = any(other.type in ("spawn_model", "spawn_model.py") for other in plan.nodes)
        self.is_missed = not self._has_robot

    def why(self, paths: InstancePaths | None = None) -> list[str]:  # noqa: ARG002
        if self._has_robot:
            return [
                "the joints of a simulated robot are where the world has them",
                "its joint_state_controller publishes them",
            ]
        none = ", and this launch spawns none" if self._is_launched else ""
        return [
            f"joints are those of a robot in the world here{none}",
            "spawn it (slidectl spawn MODEL) with a joint_state_controller, and move it with slidectl pub",
        ]
