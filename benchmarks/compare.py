"""The tools of ROS 1 beside ours, command by command, where they are installed; else it says what is missing.

    python -m benchmarks compare

Both sides answer about a running graph: a roscore there, a daemon with a slider here. Taken in turns, medians.
What the ROS of a machine cannot do (a message package that is not there) is told and left out.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.commands import interleaved
from benchmarks.harness import SLIDECTL, SLIDER_CONTROLLERS, Row, daemon

RUNS = 11
_START_LIMIT_S = 30.0

# What both have: the words of ROS, and ours. {launch} is a file with parameters and one node, whose end ends it.
PAIRS = (
    ("rostopic list", "topic list"),
    ("rostopic info /rosout", "topic info /rosout"),
    ("rostopic pub -1 /heard std_msgs/Float64 1.0", "pub /heard std_msgs/Float64 1.0 --allow-unheard"),
    ("rosservice list", "service list"),
    ("rosservice call /rosout/get_loggers {}", "service call list_controllers"),
    ("rosparam get /run_id", "param get joint1_position_controller/type"),
    ("rosparam list", "param list"),
    ("rosmsg show std_msgs/Header", "msg show std_msgs/Header"),
    ("roslaunch --dump-params {launch}", "launch --dump-params {launch}"),
    ("roslaunch {launch}", "launch {launch}"),
)
NEEDED = ("roscore", *dict.fromkeys(theirs.split()[0] for theirs, _ in PAIRS))

LAUNCH = """<launch>
  <arg name="gain" default="100.0"/>
  <rosparam>{joint1: {pid: {p: 1.0, i: 0.01, d: 10.0}}}</rosparam>
  <param name="gain" value="$(arg gain)"/>
  <node name="once" pkg="bench_package" type="once" required="true"/>
</launch>
"""


def measure() -> list[Row]:
    """A row for each pair; none, and the reason on stderr, when there is nothing to compare with."""
    missing = [tool for tool in NEEDED if shutil.which(tool) is None]
    if missing:
        _say(f"skipped: the ROS tools are not installed here (no {', '.join(missing)} on the PATH).")
        _say("Where ROS 1 is installed, source its setup.bash and run this again.")
        return []
    with roscore() as ros, daemon() as instance, package() as launch:
        instance.spawn("slider", SLIDER_CONTROLLERS)
        ours = {**instance.environment, "ROS_PACKAGE_PATH": str(launch.parent)}
        ros["ROS_PACKAGE_PATH"] = os.pathsep.join(filter(None, [str(launch.parent), ros.get("ROS_PACKAGE_PATH")]))
        return _compare(launch, ros, ours)


def _compare(launch: Path, ros: dict[str, str], ours: dict[str, str]) -> list[Row]:
    """One row a pair; each runs once first, which also says whether it can."""
    actions: dict[str, Callable[[], object]] = {}
    possible = []
    for pair in (tuple(side.replace("{launch}", str(launch)) for side in pair) for pair in PAIRS):
        both = {pair[0]: _run(pair[0].split(), ros), pair[1]: _run([SLIDECTL, *pair[1].split()], ours)}
        if _all_work(both):
            actions.update(both)
            possible.append(pair)
    medians = interleaved(actions, RUNS)
    return [_row(pair, medians, str(launch)) for pair in possible]


def _row(pair: tuple[str, ...], medians: dict[str, float], launch: str) -> Row:
    theirs, ours = (medians[name] for name in pair)
    names = [name.replace(launch, "FILE") for name in pair]
    note = f"{names[0]} of ROS: {1000 * theirs:.0f} ms, {theirs / ours:.1f} times as long"
    return Row(f"slidectl {names[1]}", 1000 * ours, "ms", note=note)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _all_work(actions: dict[str, Callable[[], object]]) -> bool:
    for name, action in actions.items():
        try:
            action()
        except subprocess.CalledProcessError as error:
            _say(f"left out: {name!r} ends with exit code {error.returncode} here")
            return False
    return True


def _run(words: list[str], environment: dict[str, str]) -> Callable[[], object]:
    silent = subprocess.DEVNULL
    return lambda: subprocess.run(words, env=environment, check=True, stdout=silent, stderr=silent)


@contextmanager
def package() -> Iterator[Path]:
    """A package with a launch file, whose path it gives, and an executable that ends at once."""
    with tempfile.TemporaryDirectory(prefix="slidectl-bench-", dir="/tmp") as folder:
        manifest = "<package><name>bench_package</name><version>0.0.0</version><description/></package>\n"
        Path(folder, "package.xml").write_text(manifest, encoding="utf-8")
        executable = Path(folder, "once")
        executable.write_text("#!/bin/sh\nexit 0\n", encoding="utf-8")
        executable.chmod(0o755)
        launch = Path(folder, "bench.launch")
        launch.write_text(LAUNCH, encoding="utf-8")
        yield launch


@contextmanager
def roscore() -> Iterator[dict[str, str]]:
    """A roscore of our own on a port of its own, once it answers. Gives the environment that leads to it.

    Raises:
        TimeoutError: it does not answer.
    """
    port = 21311
    environment = {**os.environ, "ROS_MASTER_URI": f"http://localhost:{port}"}
    silent = subprocess.DEVNULL
    process = subprocess.Popen(["roscore", "-p", str(port)], env=environment, stdout=silent, stderr=silent)
    try:
        limit = time.monotonic() + _START_LIMIT_S
        while subprocess.run(
            ["rostopic", "list"], env=environment, stdout=silent, stderr=silent, check=False
        ).returncode:
            if time.monotonic() > limit:
                raise TimeoutError(f"roscore does not answer within {_START_LIMIT_S:g} s")
        yield environment
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    from benchmarks.__main__ import main

    sys.exit(main(["compare", "--no-write"]))
