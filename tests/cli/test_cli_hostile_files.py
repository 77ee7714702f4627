"""Every command that takes a file, given what is no regular file of a bounded size: it is refused, and never waits."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from command_line import ROOT, CommandLine
from daemon_fixture import running_daemon

from slidectl import description

SLIDER = "config/slider_control.yaml"
_LIMIT_S = 120
"""Wall time in which a command has ended on a busy machine; one that waits for a writer never does."""


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        before = Path.cwd()
        os.chdir(path.parent)  # a socket's path is short
        try:
            one.bind(path.name)
        finally:
            os.chdir(before)


def _endless(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


KINDS: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "pipe": (os.mkfifo, ("is a pipe, and only regular files are read",)),
    "device": (lambda path: path.symlink_to("/dev/zero"), ("is a device, and only regular files are read",)),
    "folder": (Path.mkdir, ("is a folder, and only regular files are read", "a folder, not a launch file", "no scen")),
    "socket": (_socket, ("is a socket, and only regular files are read",)),
    "large": (_endless, ("is larger than", "a line longer than", "is neither a bag", "does not appear to be a bag")),
}
"""How each is made, and what is said: a recording and a script are not read whole, so that they have no bound."""
COMMANDS = {
    "bag info": "bag info {}.bag",
    "bag reindex": "bag reindex {}.bag",
    "bag filter": "bag filter {}.bag never.mcap",
    "bag export": "bag export {}.mcap --csv -",
    "bag diff": "bag diff {0}.bag {0}.bag",
    "play": "play {}.bag",
    "plot a recording": "plot {}.bag joint_states/position",
    "plot a table": "plot {}.csv",
    "assert": "assert joint1 --near 1 --from {}.bag",
    "replay": "replay {}.journal",
    "replay --keep": "-i other replay {}.journal --keep",
    "test": "test {}.yaml",
    "test --list": "test --list {}.yaml",
    "check a model": "check {}.urdf",
    "check a world": "check {}.world",
    "check a launch file": "check {}.launch",
    "check controllers": "check {}.yaml",
    "check --controllers": "check slider --controllers {}.yaml",
    "check --import": "check slider --import {}.py",
    "urdf": "urdf {}.xacro",
    "launch": "launch {}.launch",
    "spawn": "spawn {}.urdf",
    "spawn a world": "spawn {}.sdf",
    "spawn --controllers": "spawn slider --controllers {}.yaml",
    "controller load --from": "controller load mine --from {}.py",
    "sim load --from": "sim load --from {}.snapshot",
    "param load": "param load {}.yaml",
    "param set --textfile": "param set /x --textfile {}.txt",
    "pub --file": "pub /x std_msgs/Float64 --allow-unheard --file {}.yaml",
    "trajectory send": "trajectory send arm_controller {}.csv",
    "shell": "shell {}.txt",
    "daemon start --import": "-i other daemon start --import {}.py",
    "gateway --token-file": "gateway websocket --host 0.0.0.0 --token-file {}.txt --port 0",
    "gateway --cert": "gateway foxglove --cert {}.pem --port 0",
    "rosparam load": "ros rosparam load {}.yaml",
    "rosparam set": "ros rosparam set /x -t {}.txt",
    "rosparam set --binfile": "ros rosparam set /x -b {}.txt",
    "rostopic pub": "ros rostopic pub /x std_msgs/Float64 -f {}.yaml",
    "rostopic echo": "ros rostopic echo -b {}.bag -a",
    "rosrun gazebo_ros spawn_model": "ros rosrun gazebo_ros spawn_model -file {}.urdf -urdf -model x",
}


WITH_ALL_KINDS = (
    "bag info", "plot a table", "replay", "test", "check a model", "launch", "spawn --controllers", "sim load --from",
    "controller load --from", "param load", "shell",
)  # fmt: skip
"""One of each reader; a pipe and a device are what every command is tried with, as these never end."""
AS_IN_ROS = {
    "rosparam load": ("does not exist",),
    "rosparam set": ("does not exist",),
    "rosparam set --binfile": ("does not exist",),
    "rosrun gazebo_ros spawn_model": ("no file",),
}


@pytest.fixture(scope="module")
def world() -> Iterator[CommandLine]:
    """A daemon with the arm."""
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        words = ["--controllers", "config/arm_control.yaml", "--start", "arm_controller"]
        slidectl.ok("spawn", "arm", *words)
        yield slidectl


CASES = [
    (command, kind) for command in COMMANDS for kind in KINDS if kind in ("pipe", "device") or command in WITH_ALL_KINDS
]


@pytest.mark.parametrize(("command", "kind"), CASES)
def test_a_command_refuses_what_is_no_regular_file(world: CommandLine, tmp_path: Path, command: str, kind: str) -> None:
    make, said = KINDS[kind]
    words = shlex.split(COMMANDS[command].format(tmp_path / "named"))
    [path] = {word for word in words if word.startswith(str(tmp_path))}
    make(Path(path))
    refused = world(*words)
    assert refused.returncode == (1 if command in ("rostopic pub", "rostopic echo", "rosparam load") else 2), (
        refused.stderr
    )
    # bag reindex names the file that a link leads to: it is the one that it would change
    assert path in refused.stderr or str(Path(path).resolve()) in refused.stderr or command == "rostopic echo"
    assert any(text in refused.stderr for text in (*said, *AS_IN_ROS.get(command, ()))), refused.stderr


def test_a_link_to_a_regular_file_is_as_good_as_the_file(world: CommandLine, tmp_path: Path) -> None:
    def link(target: str | Path, name: str) -> str:
        (tmp_path / name).symlink_to(ROOT / target)
        return str(tmp_path / name)

    (tmp_path / "robot").write_text(description.load("slider").urdf)
    (tmp_path / "steps").write_text("steps:\n  - spawn: slider\n")
    (tmp_path / "script").write_text("version\n")
    robot, controllers = link(tmp_path / "robot", "robot.urdf"), link(SLIDER, "controllers.yaml")
    world.ok("check", robot, "--controllers", controllers)
    world.ok("urdf", link("models/slider.xacro", "slider.xacro"))
    world.ok("spawn", robot, "-n", "linked", "--controllers", controllers)
    world.ok("delete", "linked")
    world.ok("param", "load", controllers, "/linked")
    world.ok("test", link(tmp_path / "steps", "steps.yaml"))
    world.ok("shell", link(tmp_path / "script", "script.txt"))


@pytest.mark.skipif(shutil.which("bash") is None, reason="the shell of <(...)")
def test_the_output_of_a_command_is_a_file_to_every_command_that_reads_one_whole(
    world: CommandLine, tmp_path: Path
) -> None:
    (tmp_path / "steps").write_text("steps:\n  - spawn: slider\n")
    slidectl = shlex.join(world.argv())
    lines = [
        f"{slidectl} spawn <({slidectl} urdf slider) -n piped --controllers <(cat {SLIDER})",
        f"{slidectl} delete piped",
        f"{slidectl} param load <(echo 'a: 5') /piped",
        f"{slidectl} check <({slidectl} urdf slider)",
        f"{slidectl} pub /piped std_msgs/Float64 -f <(echo 'data: 1') --allow-unheard",
        f"{slidectl} test <(cat {tmp_path}/steps)",
        f"{slidectl} shell <(echo version)",
        f"echo 'b: 6' | {slidectl} param load /dev/stdin /piped",
    ]
    for line in lines:
        done = subprocess.run(
            ["bash", "-c", line], env=world.environment, cwd=ROOT, capture_output=True, text=True, timeout=_LIMIT_S,
            check=False,
        )  # fmt: skip
        assert done.returncode == 0, (line, done.stderr)
    assert json.loads(world.ok("param", "get", "/piped", "--json"))["value"] == {"a": 5, "b": 6}
