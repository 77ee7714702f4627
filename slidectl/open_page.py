"""The page that `slidectl view` serves for a daemon: whether it is open, and where; what replaces other windows.

The process that serves it holds a lock, whose file has the address. Of several pages the first one holds it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from shlex import quote

from slidectl import processes
from slidectl.paths import InstancePaths, command, install_command, instance

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


def address_of(paths: InstancePaths) -> str | None:
    """The address of the page that is open for this daemon now, or None."""
    found = processes.listening(paths.page)
    return found.address or None if found is not None else None


@contextmanager
def announced(paths: InstancePaths, address: str) -> Iterator[None]:
    """Other commands name the page by its address in this context, unless another one is open already."""
    held = processes.lock(paths.page)
    if held is None:
        yield
        return
    try:
        os.write(held, address.encode())
        yield
    finally:
        paths.page.unlink(missing_ok=True)
        os.close(held)


def has_page() -> bool:
    """True when the library that draws the page is installed."""
    return find_spec("viser") is not None


def instead_of_window(package: str, words: Sequence[str], paths: InstancePaths | None) -> list[str]:
    """What to type in place of a window of that package (`gazebo_ros`: Gazebo's), in lines.

    Args:
        words: its arguments. paths: of the daemon; by default of the one that the environment chooses.
    """
    paths = instance() if paths is None else paths
    address = address_of(paths)
    view, plot, top = (command(paths, name) for name in ("view", "plot", "top"))
    if address is not None:
        seen = f"{view} shows robots, plots and gains in a browser, and is open: {address}"
    else:
        seen = f"{view} shows robots, plots and gains in a browser ({_PAGE}; slidectl launch opens it with --view)"
        seen += "" if has_page() else f", after {install_command('view')}"
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
