"""Nodes without any task here. Their text says why, and what to use instead.

rviz, rqt and gzclient are windows, which do not exist here; node_kinds decides when RViz is run as a program. A
joint_state_publisher would contradict the simulated joints.
"""

from __future__ import annotations

from slidectl.launch.plan import LaunchPlan, Node
from slidectl.launch.task import Run, Task

_SHOWS = {
    "rqt_plot": "slidectl plot TOPIC/FIELD draws the numbers",
    "rqt_publisher": "slidectl pub TOPIC -r 100 'sin(t)' publishes expressions",
    "rqt_reconfigure": "slidectl param set CONTROLLER/pid/p VALUE turns a running controller's gains",
    "rqt_controller_manager": "slidectl top shows the controllers, starts and stops them",
    "rqt_graph": "slidectl graph shows who publishes and who subscribes",
    "rqt_console": "slidectl echo /rosout shows the log",
    "rqt_tf_tree": "slidectl tf tree shows the frames",
}
_RQT = "also: slidectl pub -r (expressions), slidectl echo -p (numbers) and slidectl param set (live gains)"
_FIRST = (
    "slidectl view shows robots, plots and gains in a browser (http://127.0.0.1:8080), slidectl plot draws curves, "
    "slidectl top shows joints and controllers"
)
"""What takes the place of any window."""
_ROBOT = (
    "slidectl robots NAME, slidectl echo joint_states and slidectl tf tree show the robot;"
    " RViz is started where it is installed and the ROS 1 gateway runs: slidectl gateway ros1 start"
)


class LeftOut(Task):
    """A node without a task; `text` is printed as a warning."""

    family = "notice"
    keeps_running = False
    is_missed = True
    """False when nothing of the launch is missing without it."""

    @property
    def text(self) -> str:
        return f"left out: {self.why}"

    @property
    def why(self) -> str:
        """Why there is no such node, and what serves in its place."""
        raise NotImplementedError

    def start(self, run: Run) -> str | None:
        self.warn(run, self.text)
        return None


class Viewer(LeftOut):
    """A window of rviz or rqt; leaving it out is a warning."""

    @property
    def why(self) -> str:
        package = self.node.package
        instead = _SHOWS.get(package, _RQT) if package.startswith("rqt") else _ROBOT
        return f"there are no windows here; {_FIRST}; {instead}"


class Window(LeftOut):
    """gzclient. Launch files start it by default, so leaving it out is no warning."""

    is_missed = False

    @property
    def text(self) -> str:
        return self.why

    @property
    def why(self) -> str:
        return f"there is no window here; {_FIRST}"

    def start(self, run: Run) -> str | None:
        self.settled(run, self.text)
        return None


class JointStatePublisher(LeftOut):
    """A joint_state_publisher. It would contradict the world's joint states, so it is left out with a warning."""

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self._is_launched = bool(plan.files)
        self._has_robot = any(other.type in ("spawn_model", "spawn_model.py") for other in plan.nodes)
        self.is_missed = not self._has_robot

    @property
    def why(self) -> str:
        if self._has_robot:
            return (
                "the joints of a simulated robot are where the world has them, and its joint_state_controller says so"
            )
        none = ", and this launch spawns none" if self._is_launched else ""
        return (
            f"joints are those of a robot in the world here{none};"
            " spawn it (slidectl spawn MODEL) with a joint_state_controller, and move it with slidectl pub"
        )
