"""rviz, rqt and their like: windows that there are not; a warning names the commands that show the same."""

from __future__ import annotations

from slidectl.launch.task import Run, Task

_SHOWS = {
    "rqt_plot": "slidectl echo -p TOPIC/FIELD prints the numbers as CSV",
    "rqt_publisher": "slidectl pub TOPIC -r 100 'sin(t)' publishes expressions",
    "rqt_reconfigure": "slidectl param set CONTROLLER/pid/p VALUE turns a running controller's gains",
    "rqt_controller_manager": "slidectl controller list, start and stop do the same",
    "rqt_graph": "slidectl topic list -v shows who publishes and who subscribes",
    "rqt_console": "slidectl echo /rosout shows the log",
    "rqt_tf_tree": "slidectl tf tree shows the frames",
}
_RQT = "slidectl pub -r (expressions), slidectl echo -p (numbers to plot) and slidectl param set (live gains)"
_ROBOT = "slidectl robots NAME, slidectl echo joint_states and slidectl tf tree show the robot"


class Viewer(Task):
    """Nothing is shown, which is a warning."""

    family = "notice"
    keeps_running = False

    @property
    def instead(self) -> str:
        """What shows the same here."""
        if self.node.package.startswith("rqt"):
            return _SHOWS.get(self.node.package) or f"in its place: {_RQT}"
        return _ROBOT

    @property
    def text(self) -> str:
        return f"left out: there are no windows here; {self.instead}"

    def start(self, run: Run) -> str | None:
        self.warn(run, self.text)
        return None
