"""What takes the place of a window of ROS or Gazebo: the commands to type, with the user's own topics.

It only makes texts.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from shlex import quote

from slidectl.paths import InstancePaths, command, install_command

_PAGE = "http://localhost:8080/"
"""Where the page opens unless that port is taken."""

_SHOWS = {
    "rqt_publisher": "slidectl pub TOPIC -r 100 'sin(t)' publishes expressions",
    "rqt_reconfigure": "slidectl param set CONTROLLER/pid/p VALUE turns a running controller's gains",
    "rqt_controller_manager": "slidectl top shows the controllers, starts and stops them",
    "rqt_graph": "slidectl graph shows who publishes and who subscribes",
    "rqt_console": "slidectl echo /rosout shows the log",
    "rqt_bag": "slidectl plot FILE.bag TOPIC/FIELD draws what a recording has, slidectl bag info lists it",
    "rqt_tf_tree": "slidectl tf tree shows the frames",
}
_RQT = "also: slidectl pub -r (expressions), slidectl echo -p (numbers) and slidectl param set (live gains)"
_ROBOT = (
    "slidectl robots NAME, slidectl echo joint_states and slidectl tf tree show the robot;"
    " RViz is started where it is installed and the ROS 1 gateway runs: slidectl gateway ros1 start"
)


def instead(package: str, words: Sequence[str], paths: InstancePaths, address: str | None, has_page: bool) -> list[str]:
    """What to type in place of a window of that package (`gazebo_ros`: Gazebo's), in lines.

    Args:
        words: its arguments. paths: of the daemon.
        address: of the open page, or None. has_page: whether the page can be opened here.
    """
    view, plot, top = (command(paths, name) for name in ("view", "plot", "top"))
    if address is not None:
        seen = f"{view} shows robots, plots and gains in a browser, and is open: {address}"
    else:
        seen = f"{view} shows robots, plots and gains in a browser ({_PAGE}; slidectl launch opens it with --view)"
        seen += "" if has_page else f", after {install_command('view')}"
    first = f"there are no windows here; {seen}, {plot} draws curves, {top} shows joints and controllers"
    if package == "rqt_plot":
        return [first, *_plots(words, plot, address or _PAGE)]
    if package.startswith("rqt"):
        return [first, _SHOWS.get(package, _RQT)]
    return [first, _ROBOT] if package == "rviz" else [first]


def _plots(words: Sequence[str], plot: str, address: str) -> list[str]:
    """The commands that draw what rqt_plot would, with its fields: `/topic/a:b` are two fields of one topic."""
    from urllib.parse import quote as in_url

    fields = []
    for word in words:
        if word.startswith("-") or ":=" in word:
            continue
        first, *more = word.split(":")
        fields += [first, *(f"{first.rpartition('/')[0]}/{field}" for field in more)]
    if not fields:
        return [f"{plot} TOPIC/FIELD draws the numbers"]
    typed = " ".join(field if re.fullmatch(r"[\w/]+", field) else quote(field) for field in fields)
    asked = "&".join(f"plot={in_url(field, safe='/[]')}" for field in fields)
    return [f"type: {plot} {typed}", f"on the page: {address}?{asked}"]
