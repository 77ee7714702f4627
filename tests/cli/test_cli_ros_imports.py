"""What the everyday ROS commands import: start-up is most of their time."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest
from cli_graph_world import COMMAND, JOINT_STATES, World, slider_world

HEAVY = {
    "yaml",
    "rosbags",
    "numpy",
    "mujoco",
    "rich",
    "asyncio",
    "argparse",
    "pathlib",
    "ast",
    "importlib.metadata",
}
EVERYDAY = [
    ("rostopic", "pub", "-1", COMMAND, "std_msgs/Float64", "data: 1.0"),
    ("rostopic", "pub", COMMAND, "std_msgs/Float64", "1.0"),
    ("rostopic", "list"),
    ("rostopic", "info", JOINT_STATES),
    ("rosservice", "call", "/slider/controller_manager/list_controllers"),
    ("rosservice", "call", "/slider/controller_manager/load_controller", "name: 'joint1_position_controller'"),
    ("rosnode", "list"),
    ("rosparam", "get", "/slider/joint1_position_controller/pid/p"),
    ("rosparam", "list"),
    ("rosmsg", "show", "std_msgs/Float64"),
]
SHOW_MODULES = """
import os, sys
import slidectl.cli
def leave(code):
    print("MODULES", *sys.modules, file=sys.stderr)
    sys.stderr.flush()
    os._exit(code)
slidectl.cli.leave = leave
slidectl.cli.entry()
"""
FLOOR = "import sys, click, json, socket; print(*sys.modules)"


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with slider_world() as world:
        yield world


@pytest.fixture(scope="module")
def floor() -> set[str]:
    """What click, json and socket bring along."""
    done = subprocess.run([sys.executable, "-c", FLOOR], capture_output=True, text=True, timeout=60, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize("words", EVERYDAY, ids=" ".join)
def test_an_everyday_command_imports_nothing_heavy(world: World, floor: set[str], words: tuple[str, ...]) -> None:
    argv = [sys.executable, "-c", SHOW_MODULES, "ros", *words]
    done = subprocess.run(
        argv,
        capture_output=True,
        text=True,
        env=world.slidectl.environment,
        timeout=60,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    loaded = set(done.stderr.partition("MODULES")[2].split()) - floor
    assert "slidectl.cli.ros.command" in loaded
    assert not loaded & HEAVY
    rooms = {name.split(".")[1] for name in loaded if name.startswith("slidectl.")}
    assert not rooms & {"description", "daemon", "launch", "check", "physics", "simulation", "control"}
