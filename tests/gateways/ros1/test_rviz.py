"""The real RViz: a launch starts it where the ROS 1 gateway runs, and it draws the robot where the robot is."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from daemon_fixture import ROOT, Runtime, running_daemon, shown
from PIL import ImageGrab
from running_gateway import running_gateway
from waiting import eventually

Picture = npt.NDArray[np.uint8]

BACKGROUND = (48, 48, 48)
"""Of the shipped configurations."""
DRAWN_S = 240.0
"""How long RViz may take to draw: OpenGL is software here, and the machine may be loaded."""
STEADY_S = 3.0
JOINTS = ("joint1_position_controller", "joint2_position_controller")
MOST_UNLIKE = 30
"""How much darker or lighter than the background a channel of what counts as drawn is."""


@contextmanager
def screen(folder: Path) -> Iterator[dict[str, str]]:
    """An X server without a screen of its own; what a program needs to be shown by it."""
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1000x700x24", "-nolisten", "tcp", "-noreset"]
    with (folder / "xvfb.log").open("wb") as log:
        server = subprocess.Popen(command, pass_fds=[writing], stdout=log, stderr=log)
    os.close(writing)
    try:
        with os.fdopen(reading) as pipe:
            number = pipe.readline().strip()
        assert number, (folder / "xvfb.log").read_text("utf-8", "replace")
        (folder / "home").mkdir()
        yield {
            "DISPLAY": f":{number}",
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "HOME": str(folder / "home"),
            "ROS_HOME": str(folder / "home"),
        }
    finally:
        server.terminate()
        server.wait()


def view(display: str) -> Picture:
    """What RViz has drawn: the part of the screen in which its background is, empty when there is none."""
    pixels = np.asarray(ImageGrab.grab(xdisplay=display).convert("RGB"))
    is_background = (pixels == BACKGROUND).all(axis=2)
    # A few such pixels are in the letters of the window, too.
    rows, columns = (np.nonzero(is_background.sum(axis=axis) > 50)[0] for axis in (1, 0))
    if not len(rows) or not len(columns):
        return pixels[:0, :0]
    return pixels[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]


class Steady:
    """Whether the picture shows a robot and has been the same for some seconds: windows are laid out in many steps."""

    def __init__(self, display: str) -> None:
        self.display = display
        self.picture = np.zeros((0, 0, 3), np.uint8)
        self.since = time.monotonic()

    def __call__(self) -> bool:
        now = view(self.display)
        if now.shape != self.picture.shape or differing(self.picture, now).any():
            self.picture, self.since = now, time.monotonic()
        return int(orange(now).sum()) > 300 and time.monotonic() > self.since + STEADY_S


def orange(picture: Picture) -> npt.NDArray[np.bool_]:
    """Where it has the colour of the part of both robots that stands."""
    red, green, blue = (picture[:, :, channel].astype(int) for channel in range(3))
    return (red > 100) & (red > 2 * green) & (green > 2 * blue)


def differing(one: Picture, other: Picture) -> npt.NDArray[np.bool_]:
    """Where two pictures are not the same."""
    return (np.abs(one.astype(int) - other.astype(int)) > MOST_UNLIKE).any(axis=2)


def run(runtime: Runtime, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command of slidectl, with both streams in its `stdout`."""
    command, env = [sys.executable, "-m", "slidectl", *words], {**runtime.env, **environment}
    return subprocess.run(
        command, env=env, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )


def done(runtime: Runtime, *words: str) -> None:
    """The same, which must succeed."""
    ended = run(runtime, *words)
    assert ended.returncode == 0, ended.stdout


needs_rviz = pytest.mark.skipif(
    not os.environ.get("CI") and not (shutil.which("rviz") and shutil.which("Xvfb")),
    reason="RViz or Xvfb is not installed: apt install rviz xvfb",
)


@needs_rviz
@pytest.mark.parametrize(
    ("words", "topic", "there"),
    [
        (("my_slider", "slider.launch", "rviz:=true"), "/slider/joint1_position_controller/command", 1.0),
        (("rrbot_description", "rrbot_rviz.launch"), "/rrbot/joint1_position_controller/command", 1.5),
    ],
)
def test_rviz_draws_the_robot_where_a_command_has_moved_it(
    words: tuple[str, ...], topic: str, there: float, tmp_path: Path
) -> None:
    """RViz itself sometimes ends by a fault in its own memory while it starts; it is started again then."""
    for attempt in range(3):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        try:
            return watch_the_robot_move(words, topic, there, folder)
        except RVizCrashed as crash:
            last = crash
    raise last


class RVizCrashed(Exception):
    """A signal of a fault in memory has ended RViz."""


def watch_the_robot_move(words: tuple[str, ...], topic: str, there: float, tmp_path: Path) -> None:
    with running_daemon() as runtime, running_gateway(runtime, "ros1"), screen(tmp_path) as display:
        if "rrbot" in topic:
            done(runtime, "spawn", "rrbot", "--controllers", "config/rrbot_control.yaml")
            done(runtime, "controller", "spawn", "joint_state_controller", *JOINTS)
        command = [sys.executable, "-m", "slidectl", "launch", *words]
        output = tmp_path / "launch.log"
        with output.open("wb") as log:
            launch = subprocess.Popen(command, env={**runtime.env, **display}, cwd=ROOT, stdout=log, stderr=log)
        try:
            steady = Steady(display["DISPLAY"])

            def has_drawn() -> bool:
                if re.search("/rviz: died: by SIG(ABRT|SEGV|BUS)", output.read_text("utf-8")):
                    raise RVizCrashed(output.read_text("utf-8"))
                assert launch.poll() is None, output.read_text("utf-8")
                return steady()

            eventually(has_drawn, f"no robot was drawn; see {output}", DRAWN_S)
            before = steady.picture
            done(runtime, "pub", topic, str(there))

            def has_moved() -> bool:
                return steady() and int(differing(before, steady.picture).sum()) > 500

            eventually(has_moved, f"the robot was not drawn elsewhere; see {output}", DRAWN_S)
            after = steady.picture
        finally:
            launch.send_signal(signal.SIGINT)
            code = launch.wait(60)
        columns = np.nonzero(orange(before).any(axis=0))[0]
        moved = np.nonzero(differing(before, after).any(axis=0))[0]
        assert moved.min() < columns.max() + 40, "it is the robot that has moved"
        assert moved.max() > columns.min() - 40
        assert not differing(before[:, :20], after[:, :20]).any(), "and nothing else"
        said = output.read_text("utf-8")
        assert code == 130
        assert "/rviz: started, process" in said
        assert "[ERROR]" not in said
        assert "[FATAL]" not in said


def test_a_launch_gives_rviz_the_gateway_as_its_master_and_leaves_it_out_where_there_is_none(tmp_path: Path) -> None:
    """An RViz of a few words: which file it was given, and which master."""
    program = tmp_path / "rviz"
    program.write_text('#!/bin/sh\necho "master $ROS_MASTER_URI shows $2"\n')
    program.chmod(0o755)
    ours = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "ROS_MASTER_URI": "http://elsewhere:1"}
    words = ("launch", "rrbot_description", "rrbot_rviz.launch")
    with running_daemon() as runtime:
        left_out = run(runtime, *words, **ours)
        assert left_out.returncode == 0
        assert "/rviz: left out: there are no windows here" in left_out.stdout
        assert "slidectl gateway ros1 start" in left_out.stdout
        with running_gateway(runtime, "ros1") as master:
            *_, launch_slider, launch_rrbot, empty = [line[1:] for line in shown("seeing.md", "rosrun rviz")]
            printed = run(runtime, *launch_slider, "--detach", **ours).stdout
            assert f"master {master} shows " in printed
            assert "my_slider/rviz/slider.rviz" in printed
            for line in (launch_rrbot, words):
                printed = run(runtime, *line, **ours).stdout
                assert f"master {master} shows " in printed
                assert "rrbot_description/rviz/rrbot.rviz" in printed
                assert "left out" not in printed
            assert f"master {master} shows" in run(runtime, *empty, **ours).stdout
            missing = tmp_path / "missing.launch"
            missing.write_text('<launch><node name="v" pkg="rviz" type="rviz" args="-d $(find no_such)/x"/></launch>')
            assert "left out: there are no windows" in run(runtime, "launch", str(missing), **ours).stdout
