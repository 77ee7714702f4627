"""The tools of ROS 1 beside ours, command by command, where they are installed; else it says what is missing.

    python -m benchmarks.compare

Both sides answer about a running graph: a roscore there, a daemon with a slider here. Taken in turns, medians.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from benchmarks.commands import interleaved
from benchmarks.harness import SLIDECTL, SLIDER_CONTROLLERS, daemon

RUNS = 11
_START_LIMIT_S = 30.0

# What both have: the words of ROS, and ours.
PAIRS = (
    ("rostopic list", "topic list"),
    ("rostopic info /rosout", "topic info /rosout"),
    ("rostopic pub -1 /heard std_msgs/Float64 1.0", "pub /heard std_msgs/Float64 1.0 --allow-unheard"),
    ("rosservice list", "service list"),
    ("rosservice call /rosout/get_loggers {}", "service call list_controllers"),
    ("rosparam get /run_id", "param get joint1_position_controller/type"),
    ("rosparam list", "param list"),
    ("rosmsg show sensor_msgs/JointState", "msg show sensor_msgs/JointState"),
)
NEEDED = ("roscore", *dict.fromkeys(theirs.split()[0] for theirs, _ in PAIRS))


def main() -> int:
    """Print the comparison; exit code 0 also when there is nothing to compare with."""
    missing = [tool for tool in NEEDED if shutil.which(tool) is None]
    if missing:
        print(f"skipped: the ROS tools are not installed here (no {', '.join(missing)} on the PATH).")
        print("Where ROS 1 is installed, source its setup.bash and run this again.")
        return 0
    with roscore() as environment, daemon() as instance:
        instance.spawn("slider", SLIDER_CONTROLLERS)
        actions: dict[str, Callable[[], object]] = {}
        for theirs, ours in PAIRS:
            actions[theirs] = _run(theirs.split(), environment)
            actions[ours] = _run([SLIDECTL, *ours.split()], instance.environment)
        medians = interleaved(actions, RUNS)
    print("| ROS | | slidectl | | times faster |\n| --- | ---: | --- | ---: | ---: |")
    for theirs, ours in PAIRS:
        one, other = medians[theirs], medians[ours]
        print(f"| {theirs} | {1000 * one:.0f} ms | slidectl {ours} | {1000 * other:.0f} ms | {one / other:.1f} |")
    return 0


def _run(words: list[str], environment: dict[str, str]) -> Callable[[], object]:
    return lambda: subprocess.run(words, env=environment, check=True, stdout=subprocess.DEVNULL)


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
    sys.exit(main())
