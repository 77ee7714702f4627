"""`rosrun`: the scripts of controller_manager and others with the lines that they print, and programs of the user's."""

from __future__ import annotations

import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_graph_world import CONTROLLERS, World, slider_world
from cli_ros_world import Session, Shell
from command_line import CommandLine

POSITION = "joint1_position_controller"
NOTE = "warning: /slider/joint1_position_controller/pid: i = 0.01 has no effect without i_clamp\n"
LISTED = (
    "'joint_state_controller' - 'hardware_interface::JointStateInterface' ( running )\n"
    "'joint1_position_controller' - 'hardware_interface::EffortJointInterface' ( running )\n"
)


@pytest.fixture(scope="module")
def slider() -> Iterator[World]:
    with slider_world() as world:
        yield world


@pytest.fixture(scope="module")
def shell(slider: World) -> Shell:
    return Shell(slider.slidectl)


MANAGER = "ROS_NAMESPACE=/slider rosrun controller_manager controller_manager"
# They build on each other.
SCRIPT = [
    Session(f"{MANAGER} list", LISTED),
    Session("rosrun controller_manager controller_manager lc __ns:=/slider", LISTED),
    Session(f"{MANAGER} stop {POSITION}", f"Stopped ['{POSITION}'] successfully\n"),
    Session(f"{MANAGER} start {POSITION}", f"Started ['{POSITION}'] successfully\n"),
    Session(f"{MANAGER} kill {POSITION}", f"Stopped ['{POSITION}'] successfully\nUnloaded '{POSITION}' successfully\n"),
    Session(f"{MANAGER} load {POSITION}", f"Loaded '{POSITION}'\n", NOTE),
    Session(f"{MANAGER} unload {POSITION}", f"Unloaded '{POSITION}' successfully\n"),
    Session(f"{MANAGER} sp {POSITION}", f"Loaded '{POSITION}'\nStarted ['{POSITION}'] successfully\n", NOTE),
    Session(
        f"{MANAGER} reload-libraries --restore",
        "Restore: True\nSuccessfully reloaded libraries\nLoaded 'joint_state_controller'\n"
        f"Loaded '{POSITION}'\nControllers restored to original state\n",
        NOTE,
    ),
    Session(f"{MANAGER} list", LISTED),
]


def test_the_script_of_the_controller_manager_prints_its_lines(shell: Shell) -> None:
    for session in SCRIPT:
        done = shell.run(session.line)
        assert (session.line, done.stdout, done.stderr) == (session.line, session.stdout, session.stderr)
        assert (session.line, done.returncode) == (session.line, 0)


def test_an_operation_that_fails_does_not_keep_the_next_one_away(shell: Shell) -> None:
    done = shell.run(f"{MANAGER} load nope; {MANAGER} stop nope {POSITION}")
    assert done.stdout == (
        "Error when loading 'nope'\nError when starting [] and stopping ['nope']\n"
        f"Stopped ['{POSITION}'] successfully\n"
    )
    assert done.returncode == 1
    assert "/slider/nope/type is not set" in done.stderr
    assert shell.run(f"{MANAGER} start {POSITION}").returncode == 0


def test_the_script_lists_the_types(shell: Shell) -> None:
    assert "effort_controllers/JointPositionController\n" in shell.run(f"{MANAGER} list-types").stdout


def test_usages_and_their_codes(shell: Shell) -> None:
    for line, text, code in (
        ("rosrun", "Usage: rosrun ", 0),
        ("rosrun -h", "Usage: rosrun ", 0),
        ("rosrun tf", "Usage: rosrun ", 0),
        ("rosrun controller_manager controller_manager", "Usage: controller_manager ", 0),
        ("rosrun controller_manager controller_manager bogus", "Usage: controller_manager ", 1),
        ("rosrun controller_manager unspawner", "Usage: unspawner ", 1),
        ("rosrun controller_manager spawner --help", "usage: spawner ", 0),
        ("rosrun controller_manager spawner", "", 2),
        ("rosrun gazebo_ros spawn_model -h", "usage: spawn_model ", 0),
        ("rosrun xacro xacro --help", "Usage: rosrun xacro xacro ", 0),
        ("rosrun tf tf_echo", "tf_echo source_frame target_frame ", 255),
        ("rosrun tf static_transform_publisher", "Publishes the transform from ", 255),
        ("rosrun tf2_ros static_transform_publisher 1 2 3", "Publishes the transform from ", 255),
        ("rosrun tf dir/", "Invalid filename:  dir/\n", 1),
        ("rosrun tf nofile", "[rosrun] Couldn't find executable named nofile below tf\n", 3),
    ):
        done = shell.run(line)
        assert (line, done.returncode) == (line, code)
        assert done.stdout.startswith(text)


def test_what_is_not_here_says_what_is(shell: Shell) -> None:
    done = shell.run("rosrun map_server map_server")
    assert (done.stdout, done.returncode) == ("", 2)
    assert done.stderr.startswith("[rospack] Error: package 'map_server' not found\nROS_PACKAGE_PATH names ")
    assert "\navailable: controller_manager " in done.stderr
    assert "slidectl provides for tf: static_transform_publisher, tf_echo" in shell.run("rosrun tf nofile").stderr


def test_a_prefix_gets_the_command_line(shell: Shell) -> None:
    done = shell.run('rosrun --prefix "echo" tf tf_echo a b')
    assert done.stdout.endswith(" ros rosrun tf tf_echo a b\n")
    done = shell.slidectl("-i", "other", "--ns", "/left", "ros", "rosrun", "--prefix", "echo", "tf", "tf_echo", "a")
    assert done.stdout.endswith(" --instance other --ns /left ros rosrun tf tf_echo a\n")


# --- spawners ---------------------------------------------------------------------------------------------------------


def start(shell: Shell, line: str) -> subprocess.Popen[str]:
    """A node in the foreground of a shell of its own, which it replaces, so that signals reach it."""
    return shell.slidectl.start("ros", *line.split())


def test_a_spawner_stays_and_takes_its_controllers_along(slider: World, shell: Shell) -> None:
    slider.slidectl.ok("controller", "unspawn", *CONTROLLERS)
    node = start(shell, f"rosrun controller_manager spawner {' '.join(CONTROLLERS)} __ns:=/slider")
    assert node.stdout is not None
    assert node.stdout.readline() == f"joint_state_controller, {POSITION} running in /slider\n"
    assert shell.run(f"{MANAGER} list").stdout == LISTED
    node.send_signal(signal.SIGINT)
    stdout, _ = node.communicate(timeout=30)
    assert stdout == f"{POSITION}, joint_state_controller stopped and unloaded\n"
    assert node.returncode == 130
    assert shell.run(f"{MANAGER} list").stdout == "No controllers are loaded in mechanism control\n"
    slider.slidectl.ok("controller", "spawn", *CONTROLLERS)


def test_a_spawner_with_its_own_namespace_option_may_only_load(slider: World, shell: Shell) -> None:
    slider.slidectl.ok("controller", "unspawn", POSITION)
    node = start(shell, f"rosrun controller_manager spawner --stopped --namespace /slider {POSITION}")
    assert node.stdout is not None
    assert node.stdout.readline() == f"{POSITION} loaded in /slider\n"
    node.send_signal(signal.SIGTERM)
    node.communicate(timeout=30)
    assert node.returncode == 0
    slider.slidectl.ok("controller", "spawn", POSITION)


def test_a_spawner_waits_for_its_controller_manager_no_longer_than_it_is_told(shell: Shell) -> None:
    done = shell.run(f"rosrun controller_manager spawner --timeout 0.3 {POSITION} __ns:=/nobody")
    assert done.returncode == 1
    assert "there was no /nobody/controller_manager" in done.stderr


def test_an_unspawner_starts_again_what_it_has_stopped(shell: Shell) -> None:
    node = start(shell, f"rosrun controller_manager unspawner {POSITION} __ns:=/slider")
    assert node.stdout is not None
    assert node.stdout.readline() == f"stopped {POSITION}\n"
    assert "( stopped )" in shell.run(f"{MANAGER} list").stdout
    node.send_signal(signal.SIGINT)
    node.communicate(timeout=30)
    assert shell.run(f"{MANAGER} list").stdout == LISTED


def test_a_robot_is_spawned_from_a_parameter(slider: World, shell: Shell) -> None:
    line = (
        "rosrun xacro xacro --inorder models/slider.xacro namespace:=/two > $XDG_RUNTIME_DIR/two.urdf"
        " && rosparam set -t $XDG_RUNTIME_DIR/two.urdf /two_description"
        " && rosrun gazebo_ros spawn_model -urdf -param two_description -model two -x 3"
    )
    done = shell.run(line)
    assert (done.stderr, done.returncode) == ("", 0)
    assert done.stdout.startswith("two spawned in /two, joints: joint1")
    assert "two" in slider.slidectl.ok("robots")
    done = shell.run("rosrun gazebo_ros spawn_model -urdf -param two_description -model two")
    assert done.returncode == 1
    assert "two" in done.stderr
    slider.slidectl.ok("delete", "two")


def test_a_gazebo_brings_its_world_along(tmp_path: Path) -> None:
    shell = Shell(CommandLine(tmp_path))
    node = start(shell, "rosrun gazebo_ros gzserver -u")
    assert node.stdout is not None
    assert node.stdout.readline() == "the world: step 0.001 s, paused\n"
    assert "/clock" in shell.run("rostopic list").stdout
    node.send_signal(signal.SIGINT)
    node.communicate(timeout=30)
    assert shell.run("rostopic list").returncode == 3


# --- frames -----------------------------------------------------------------------------------------------------------

POSE = (
    r"- Translation: \[0\.000, 0\.100, \d\.\d{3}\]\n- Rotation: in Quaternion \[0\.000, 0\.000, 0\.000, 1\.000\]\n"
    r"            in RPY \(radian\) \[0\.000, -0\.000, 0\.000\]\n"
    r"            in RPY \(degree\) \[0\.000, -0\.000, 0\.000\]\n"
)


def test_tf_echo_prints_the_pose_until_it_is_interrupted(shell: Shell) -> None:
    node = start(shell, "rosrun tf tf_echo base_link link2 20")
    assert node.stdout is not None
    text = "".join(node.stdout.readline() for _ in range(10))
    node.send_signal(signal.SIGINT)
    node.communicate(timeout=30)
    assert node.returncode == 130
    assert re.fullmatch(rf"(At time \d+\.\d{{3}}\n{POSE}){{2}}", text)


def test_tf_echo_of_an_unknown_frame_lists_the_frames(shell: Shell) -> None:
    for frames, name, role in (("base_link nope", "nope", "source_frame"), ("nope base_link", "nope", "target_frame")):
        node = start(shell, f"rosrun tf tf_echo {frames} 20")
        assert node.stdout is not None
        lines = [node.stdout.readline() for _ in range(6)]
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=30)
        assert re.fullmatch(r"Failure at \d+\.\d{9}\n", lines[0])
        assert "".join(lines[1:]) == (
            f'Exception thrown:"{name}" passed to lookupTransform argument {role} does not exist. \n'
            "The current list of frames is:\nFrame base_link exists with parent world.\n"
            "Frame link2 exists with parent base_link.\n\n"
        )


def test_tf_echo_needs_a_rate_above_zero(shell: Shell) -> None:
    done = shell.run("rosrun tf tf_echo base_link link2 0")
    assert (done.stdout, done.stderr, done.returncode) == ("", "Echo rate must be > 0.0\n", 255)


def test_echo_py_ends_at_its_limit(shell: Shell) -> None:
    done = shell.run("rosrun tf2_tools echo.py base_link link2 -l 2 -r 20")
    assert (done.stderr, done.returncode) == ("", 0)
    assert re.fullmatch(rf"(At time \d+\.\d+, \(current time \d+\.\d+\)\n{POSE}){{2}}", done.stdout)
    done = shell.run("rosrun tf2_tools echo.py base_link nope -l 1")
    assert (done.stdout, done.returncode) == ("", 1)
    assert '"nope" passed to lookupTransform argument source_frame does not exist. ' in done.stderr


def test_a_static_transform_is_there_as_long_as_its_node(shell: Shell) -> None:
    node = start(shell, "rosrun tf2_ros static_transform_publisher 0 0 1 0 0 0 link2 camera")
    assert node.stdout is not None
    assert node.stdout.readline() == "the frame camera in link2, on /tf_static\n"
    assert shell.run("rosrun tf2_tools echo.py link2 camera -l 1").stdout.splitlines()[1] == (
        "- Translation: [0.000, 0.000, 1.000]"
    )
    node.send_signal(signal.SIGINT)
    node.communicate(timeout=30)


# --- the user's own ---------------------------------------------------------------------------------------------------


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "my package é"
    (folder / "scripts").mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>mine</name></package>")
    script = folder / "scripts" / "hello"
    script.write_text('#!/bin/sh\necho "hello $*"\nexit 7\n')
    script.chmod(0o755)
    (folder / "scripts" / "plain").write_text("no program")
    return tmp_path


def test_a_program_of_the_users_own_is_run_in_its_place(shell: Shell, package: Path) -> None:
    done = shell.run("rosrun mine hello one 'two words'", ROS_PACKAGE_PATH=str(package))
    assert (done.stdout, done.stderr, done.returncode) == ("hello one two words\n", "", 7)


def test_a_program_that_is_not_there_or_may_not_be_run(shell: Shell, package: Path) -> None:
    for name in ("nofile", "plain"):
        done = shell.run(f"rosrun mine {name}", ROS_PACKAGE_PATH=str(package))
        assert done.returncode == 3
        assert done.stdout.startswith(f"[rosrun] Couldn't find executable named {name} below {package}")


def test_xacro_writes_into_a_file(shell: Shell, tmp_path: Path) -> None:
    done = shell.run(f"rosrun xacro xacro models/slider.xacro -o {tmp_path}/slider.urdf")
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)
    assert (tmp_path / "slider.urdf").read_text().startswith("<?xml")
    assert shell.run("rosrun xacro xacro nofile.xacro").returncode == 2
