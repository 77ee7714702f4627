"""What a command imports: start-up is most of the time of an everyday command."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from cli_graph_world import COMMAND, JOINT_STATES
from command_line import CommandLine
from fake_daemon import FakeDaemon

from slidectl.cli.command_table import COMMANDS

# Beyond click, json and socket and what these import themselves.
ALLOWED = {"_struct", "binascii", "difflib", "gc", "heapq", "_heapq", "locale", "_locale", "signal", "struct"}
# click's help writer asks for the width of the terminal and wraps text.
ALLOWED_FOR_HELP = {
    "shutil",
    "fnmatch",
    "locale",
    "_locale",
    "textwrap",
    "zlib",
    "bz2",
    "lzma",
    "_bz2",
    "_lzma",
    "_compression",
    "click._textwrap",
}
HEAVY = {"yaml", "rosbags", "numpy", "mujoco", "rich", "asyncio", "argparse", "pathlib", "ast", "importlib.metadata"}
"""What no everyday ROS command imports; optparse and what it brings are theirs."""

SHOW_MODULES = """
import os, sys
import slidectl.cli
target = sys.argv.pop(1)
def leave(code):
    with open(target, "w") as file:
        file.write("\\n".join([str(code), *sys.modules]))
    os._exit(0)
slidectl.cli.leave = leave
slidectl.cli.entry()
"""
FLOOR = "import sys, click, json, socket; print(*sys.modules)"
METADATA = "import sys, importlib.metadata; list(importlib.metadata.distributions()); print(*sys.modules)"

SLIDER = {
    "name": "slider", "namespace": "/slider", "kind": "robot", "fixed": True,
    "links": ["base_link"], "joints": [], "controllers": [],
    "pose": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "report": [], "estop": False, "frozen": False,
}  # fmt: skip
STATUS = {
    "version": "0", "pid": 1, "instance": "default", "time": 1.0, "cycles": 1000, "paused": False, "speed": 1.0,
    "speed_reached": 1.0, "timestep": 0.001, "cycle_mean": 1e-6, "cycle_p99": 1e-6, "cycle_worst": 1e-6,
    "engine": "plain", "pictures": "", "cameras": [], "cameras_asked": [], "cameras_reached": [],
    "cameras_advice": [], "frozen": [],
    "lateness_p50": 1e-6, "lateness_p99": 1e-6, "overruns": 0, "robots": ["slider"], "estop": [], "controllers": 1,
    "controllers_running": 1, "connections": 1, "memory": 1, "uptime": 1.0, "log": "", "lockstep": [],
    "trouble": "", "holders": [], "faults": [], "journal": "", "journal_trouble": "",
}  # fmt: skip
CONTROLLER = {"name": "c", "state": "running", "type": "t", "claimed_resources": []}


def modules(slidectl: CommandLine, tmp_path: Path, *words: str, codes: Sequence[str] = ("0",)) -> set[str]:
    """The modules that are loaded when the command leaves, which it must do with one of these exit codes."""
    listing = tmp_path / "modules"
    argv = [sys.executable, "-c", SHOW_MODULES, str(listing), *words]
    done = subprocess.run(argv, capture_output=True, text=True, env=slidectl.environment, timeout=60, check=True)
    code, *names = listing.read_text().split()
    assert code in codes, done.stderr
    return set(names)


def floor(code: str = FLOOR) -> set[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    return set(done.stdout.split())


def foreign(loaded: set[str]) -> set[str]:
    return {name for name in loaded - floor() if name.split(".")[0] != "slidectl"}


@pytest.fixture
def slider(fake: FakeDaemon) -> FakeDaemon:
    """A scripted daemon with a slider that has one controller."""
    fake.answers |= {
        "/slidectl/list_robots": {"robots": [SLIDER]},
        "/slidectl/status": STATUS,
        "/rosapi/services_for_type": {"services": ["/slider/controller_manager/list_controllers"]},
        "/slider/controller_manager/list_controllers": {"controller": [CONTROLLER]},
        "/rosapi/topics": {"topics": ["/clock"], "types": ["rosgraph_msgs/Clock"]},
        "/slidectl/resolve": {
            "name": "/clock",
            "field": "clock",
            "type": "rosgraph_msgs/Clock",
            "typedefs": [],
            "nodes": ["/gazebo"],
        },
        "/slidectl/wait": {"success": True, "message": "", "last": "1.0", "closest": "1.0", "time": 1.0},
    }
    return fake


EVERYDAY = [
    ("version",),
    ("robots",),
    ("robots", "slider", "--json"),
    ("controller", "list"),
    ("controller", "list", "--json"),
    ("sim", "status"),
    ("wait", "clock", "--near", "1"),
]


@pytest.mark.usefixtures("slider")
@pytest.mark.parametrize("words", EVERYDAY, ids=" ".join)
def test_an_everyday_command_imports_only_what_is_allowed(
    slidectl: CommandLine, tmp_path: Path, words: tuple[str, ...]
) -> None:
    loaded = modules(slidectl, tmp_path, *words)
    assert "slidectl.cli.main" in loaded
    assert "importlib.metadata" not in loaded  # what packages add is looked up for other names only
    assert foreign(loaded) <= ALLOWED
    rooms = {name.split(".")[1] for name in loaded if name.startswith("slidectl.")}
    known = {
        "cli",
        "command_steps",
        "client",
        "entry_points",
        "errors",
        "input_files",
        "msgs",
        "names",
        "operating_system",
        "paths",
        "typed_values",
        "wire",
        "writing",
    }
    assert rooms <= known


@pytest.fixture
def moving(world: CommandLine) -> Iterator[CommandLine]:
    """A real daemon with a slider under control, time running."""
    controllers = ("joint_state_controller", "joint1_position_controller")
    world.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", "--start", *controllers)
    world.ok("sim", "resume")
    yield world
    world.ok("sim", "pause")
    world.ok("delete", "slider")


HEADLINES = [
    ("pub", "command", "1.0"),
    ("pub", "/slider/joint1_position_controller/command", "std_msgs/Float64", "data: 1.0"),
    ("echo", "joint_states", "-n", "1"),
    ("service", "call", "list_controllers"),
    ("topic", "list"),
]


@pytest.mark.parametrize("words", HEADLINES, ids=" ".join)
def test_a_command_of_the_tutorial_imports_only_what_is_allowed(
    moving: CommandLine, tmp_path: Path, words: tuple[str, ...]
) -> None:
    loaded = modules(moving, tmp_path, *words)
    assert foreign(loaded) <= ALLOWED
    assert not {name for name in loaded if name.startswith(("slidectl.description", "slidectl.daemon"))}


ROS_HEADLINES = [
    ("rostopic", "pub", "-1", COMMAND, "std_msgs/Float64", "data: 1.0"),
    ("rostopic", "pub", COMMAND, "std_msgs/Float64", "1.0"),
    ("rostopic", "list"),
    ("rostopic", "info", JOINT_STATES),
    ("rosservice", "call", "/slider/controller_manager/list_controllers"),
    # It is loaded already, which is refused.
    ("rosservice", "call", "/slider/controller_manager/load_controller", "name: 'joint1_position_controller'"),
    ("rosnode", "list"),
    ("rosparam", "get", "/slider/joint1_position_controller/pid/p"),
    ("rosparam", "list"),
    ("rosmsg", "show", "std_msgs/Float64"),
]


@pytest.mark.parametrize("words", ROS_HEADLINES, ids=" ".join)
def test_an_everyday_ros_command_imports_nothing_heavy(
    moving: CommandLine, tmp_path: Path, words: tuple[str, ...]
) -> None:
    loaded = modules(moving, tmp_path, "ros", *words, codes=("0", "1"))
    assert "slidectl.extensions.ros_commands.command" in loaded
    assert foreign(loaded) & HEAVY == set()
    rooms = {name.split(".")[1] for name in loaded if name.startswith("slidectl.")}
    assert not rooms & {"description", "daemon", "launch", "check", "physics", "simulation", "control"}


@pytest.mark.parametrize("model", ["rrbot", "slider"])
def test_a_check_imports_no_physics_and_no_other_reader(slidectl: CommandLine, tmp_path: Path, model: str) -> None:
    loaded = modules(slidectl, tmp_path, "check", model, "--controllers", f"config/{model}_control.yaml")
    assert not {"mujoco", "numpy", "trimesh", "yourdfpy", "scipy", "rosbags"} & loaded


def test_the_help_imports_no_command_and_no_client(slidectl: CommandLine, tmp_path: Path) -> None:
    loaded = modules(slidectl, tmp_path, "--help")
    assert not {entry.module for entry in COMMANDS.values()} & loaded
    assert "slidectl.client" not in loaded
    assert foreign(loaded) <= ALLOWED | ALLOWED_FOR_HELP | floor(METADATA)  # the help names installed packages


@pytest.mark.usefixtures("slider")
def test_an_everyday_command_imports_only_its_own_module(slidectl: CommandLine, tmp_path: Path) -> None:
    loaded = modules(slidectl, tmp_path, "sim", "status")
    others = {entry.module for entry in COMMANDS.values()} - {"slidectl.cli.completion"}
    assert others & loaded == {"slidectl.cli.sim"}  # which completes the names of snapshots
