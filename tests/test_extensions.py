"""The extensions: each uses public faces only, and the rest works without it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from test_floors import EXTENSIONS, PACKAGE, REACHES, imported, modules

IMPORT_ALL = """
import importlib, pkgutil, slidectl
for module in pkgutil.walk_packages(slidectl.__path__, "slidectl."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
print(slidectl.__file__)
"""

# What anybody builds on: whole rooms, and the faces of the others.
FACES = {
    "client", "command_steps", "confined", "description", "effects", "entry_points", "errors", "expressions",
    "fault_kinds", "input_files", "logfile", "measures", "msgs", "names", "open_page", "operating_system", "paths",
    "processes", "rasteriser", "rotations", "supervision", "traces", "transform_tree", "typed_values", "web_access",
    "wire", "writing",
    "cli.commands", "cli.completion", "cli.context", "cli.detached", "cli.output", "cli.topic_streams",
    "check.controllers", "check.file_kinds", "check.findings", "check.model", "check.scenes", "check.tags",
    "daemon.in_process", "daemon.lifecycle", "daemon.options", "daemon.time_limit",
    "simulation.clock", "simulation.feature", "simulation.host", "simulation.pending", "simulation.sensor_kinds",
    "simulation.simulation",
}  # fmt: skip
# What an extension uses beyond that, and why.
INSIDE = {
    ("journal", "cli.daemon"): "`replay --to` starts a daemon, and prints what `daemon start` prints",
    ("journal", "cli.robots"): "`replay` prints the robots as `robots` does",
    ("journal", "control.duration"): "seconds become nanoseconds as in controllers",
    ("journal", "control.node_handle"): "the type of a message",
    ("journal", "control.user_modules"): "the code of users is a part of the record",
    ("journal", "daemon.outbox"): "the clients of the record get their messages from nobody",
    ("journal", "daemon.session"): "the lines of the record go through the daemon's own sessions",
    ("journal", "physics.hulls"): "meshes that were read are a part of the record",
    ("journal", "physics.rendering"): "pictures for users' code are drawn again",
    ("journal", "simulation.loop"): "a replay stops where the loop stopped",
    ("journal", "simulation.topics"): "a replay is recorded without a client",
    ("launch", "cli.spawn"): "the remarks on a robot are those of `spawn`",
    ("launch", "control.registry"): "a spawner knows the types of controllers",
    ("launch", "control.ros2_names"): "and their names in ROS 2",
    ("ros_commands", "cli.command_table"): "names that the ROS commands share with slidectl's",
    ("ros_commands", "cli.daemon"): "a ROS command is one of slidectl's in other words: these are the others too",
    ("ros_commands", "cli.echo"): "rostopic echo",
    ("ros_commands", "cli.msg"): "rosmsg",
    ("ros_commands", "cli.param"): "rosparam",
    ("ros_commands", "cli.pub"): "rostopic pub",
    ("ros_commands", "cli.service"): "rosservice",
    ("ros_commands", "cli.spawn"): "rosrun gazebo_ros spawn_model",
    ("ros_commands", "cli.tf"): "tf_echo",
    ("ros_commands", "cli.topic_measure"): "rostopic hz, bw and delay",
    ("scenarios", "cli.command_table"): "steps are commands",
    ("scenarios", "cli.daemon"): "the fixture of pytest starts a daemon",
    ("scenarios", "cli.installed_commands"): "steps are commands of installed packages too",
    ("scenarios", "cli.main"): "a step runs as a command line does",
    ("scenarios", "simulation.compiled.object_file"): "the cycle is compiled once for all cases",
    ("viewing", "physics.rendering"): "`render` draws with the OpenGL of the cameras",
}


def test_an_extension_uses_public_faces_only() -> None:
    names = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in modules()}
    used = {
        (name.split(".")[1], one.removeprefix("slidectl."))
        for name, path in names.items()
        if name.startswith("extensions.")
        for one in imported(path)
        if one.removeprefix("slidectl.") in names
    }
    beyond = {
        (extension, name)
        for extension, name in used
        if not name.startswith("extensions.") and not FACES & {name, name.split(".")[0]}
    }
    assert beyond == INSIDE.keys()


def dependents(extension: str) -> set[str]:
    """The extension and those that cannot be without it, by the table of reaches."""
    found = {extension}
    while more := {user for user, used in REACHES if used in found and user in EXTENSIONS} - found:
        found |= more
    return found


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize("extension", sorted(EXTENSIONS))
def test_without_an_extension_the_rest_is_imported_and_runs_a_robot(extension: str, tmp_path: Path) -> None:
    gone = dependents(extension)
    shutil.copytree(
        PACKAGE,
        tmp_path / "slidectl",
        ignore=lambda folder, names: gone & set(names) if Path(folder).name == "extensions" else {"__pycache__"},
    )
    with tempfile.TemporaryDirectory(prefix="slidectl-", dir="/tmp") as runtime:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path), "XDG_RUNTIME_DIR": runtime}

        def run(*words: str) -> str:
            done = subprocess.run(
                [sys.executable, *words], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120
            )
            assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
            return done.stdout

        def slidectl(*words: str) -> str:
            return run("-m", "slidectl", *words)

        assert run("-c", IMPORT_ALL).strip() == str(tmp_path / "slidectl" / "__init__.py")
        assert "spawn" in slidectl("--help")
        slidectl("doctor")
        model, config = (str(PACKAGE.parent / file) for file in ("models/slider.xacro", "config/slider_control.yaml"))
        slidectl("daemon", "start", "--paused")
        try:
            slidectl("spawn", model, "--controllers", config, "--start", "joint1_position_controller")
            slidectl("pub", "command", "0.5")
            slidectl("sim", "step", "10s")
            slidectl("assert", "joint1", "--near", "0.5")
            assert "running" in slidectl("controller", "list")
            assert "slider" in slidectl("robots")
        finally:
            slidectl("daemon", "stop")


def test_a_command_of_an_extension_that_is_not_there_is_unknown(tmp_path: Path) -> None:
    """Its line in the table of commands is passed over, in the help too."""
    shutil.copytree(PACKAGE, tmp_path / "slidectl", ignore=shutil.ignore_patterns("viewing", "__pycache__"))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "slidectl", "view"], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "no command 'view'" in done.stderr
    done = subprocess.run(
        [sys.executable, "-m", "slidectl", "--help"], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert "  view " not in done.stdout
    assert "  spawn " in done.stdout
