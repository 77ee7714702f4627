"""rviz, rqt, gzclient and their like: windows that there are not; the texts name the commands that show the same."""

from __future__ import annotations

from slidectl.launch.task import LeftOut, Run

_SHOWS = {
    "rqt_plot": "slidectl echo -p TOPIC/FIELD prints the numbers as CSV",
    "rqt_publisher": "slidectl pub TOPIC -r 100 'sin(t)' publishes expressions",
    "rqt_reconfigure": "slidectl param set CONTROLLER/pid/p VALUE turns a running controller's gains",
    "rqt_controller_manager": "slidectl controller list, start and stop do the same",
    "rqt_graph": "slidectl topic list -v shows who publishes and who subscribes",
    "rqt_console": "slidectl echo /rosout shows the log",
    "rqt_tf_tree": "slidectl tf tree shows the frames",
}
_RQT = "in its place: slidectl pub -r (expressions), echo -p (numbers to plot) and param set (live gains)"
_ROBOT = "slidectl robots NAME, slidectl echo joint_states and slidectl tf tree show the robot"


class Viewer(LeftOut):
    """Nothing is shown, which is a warning."""

    @property
    def text(self) -> str:
        package = self.node.package
        instead = _SHOWS.get(package, _RQT) if package.startswith("rqt") else _ROBOT
        return f"left out: there are no windows here; {instead}"


class Window(LeftOut):
    """gzclient: there is no window, and launch files start it by default, so that is no warning."""

    @property
    def text(self) -> str:
        return "there is no window here; slidectl sim status, slidectl robots and slidectl echo show the world"

    def start(self, run: Run) -> str | None:
        self.settled(run, self.text)
        return None
