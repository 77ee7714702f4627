"""Forty slips of students of the two tutorials: what is typed, and what the answer must name.

An answer says what failed, what there is and what to type next, has the right exit code, and is no traceback. The lines
are typed against three daemons that all of them share: none runs (nobody), RRBot with one controller (rrbot), and the
slider as it is spawned without controllers (slider). No line changes what another one needs.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from command_line import ROOT, CommandLine
from daemon_fixture import running_daemon

SLIDER = (ROOT / "models" / "slider.xacro").read_text()
LAUNCH = (ROOT / "launch" / "my_slider" / "launch" / "slider.launch").read_text()
YAML = (ROOT / "config" / "slider_control.yaml").read_text()
TYPE = "std_msgs/Float64"
COMMAND = "/rrbot/joint1_position_controller/command"
MANAGER = "/rrbot/controller_manager"


class Slip(NamedTuple):
    """A line, the exit code, and the texts that the answer must have."""

    line: str
    code: int
    named: tuple[str, ...]


def slip(line: str, code: int, *named: str) -> Slip:
    return Slip(line, code, named)


FILES = {
    "unquoted.xacro": SLIDER.replace('effort="100"', "effort=100"),
    "curly.xacro": SLIDER.replace('name="slider"', "name=\u201cslider\u201d", 1),
    "bare_limit.xacro": SLIDER.replace("<limit effort", "limit effort"),
    "no_inertial.xacro": SLIDER.partition("<inertial>")[0] + SLIDER.partition("</inertial>")[2],
    "wrong_interface.xacro": SLIDER.replace("hardware_interface/Effort", "hardware interface/Effort"),
    "blank_type.xacro": SLIDER.replace("transmission_interface/Simple", "transmission interface/Simple"),
    "blank_tag.xacro": SLIDER.replace("hardwareInterface>", "hardware Interface>"),
    "no_transmission.xacro": SLIDER.partition("<transmission")[0] + SLIDER.partition("</transmission>")[2],
    "no_namespace.xacro": SLIDER.replace(' xmlns:xacro="http://www.ros.org/wiki/xacro"', ""),
    "tabs.yaml": YAML.replace("    joint:", "\tjoint:"),
    "blank_name.yaml": YAML.replace("joint1_position_controller", "joint1_position controller"),
    "no_blank.yaml": YAML.replace("joint: joint1", "joint:joint1"),
    "no_gains.yaml": "".join(line for line in YAML.splitlines(keepends=True) if "pid:" not in line),
    "position.yaml": YAML.replace("effort_controllers", "position_controllers"),
    "blank_param.launch": LAUNCH.replace("-param robot_description", "-param robot description"),
    "blank_file.launch": LAUNCH.replace("slider_control.yaml", "slider control.yaml"),
    "blank_find.launch": LAUNCH.replace("$(find my_slider)/config", "$(find my slider)/config"),
    "blank_spawner.launch": LAUNCH.replace('type="spawn_model"', 'type="spawn model"'),
    "bare_param.launch": LAUNCH.replace("<param name", "param name"),
}  # fmt: skip

NOBODY = [
    # No daemon, a wrong instance.
    slip(f"slidectl ros rostopic pub /slider/joint1_position_controller/command {TYPE} 'data: 1.0'", 3,
         "Unable to communicate with master", "start it with: slidectl", "daemon start"),
    slip("slidectl -i lab pub command 1.0", 3, "no daemon answers", "start it with: slidectl -i lab daemon start"),
    # Names of packages, files and arguments.
    slip("slidectl launch myslider slider.launch", 1, "no package 'myslider'", "Did you mean 'my_slider'?"),
    slip("slidectl ros roslaunch my slider slider.launch", 2, "type: my_slider slider.launch"),
    slip("slidectl launch my_slider slidr.launch", 1, "Did you mean 'slider.launch'?"),
    slip("slidectl launch my_slider/slider.launch", 2, "a file of a package is written: my_slider slider.launch"),
    slip("slidectl ros roslaunch my_slider slider.launch paused=true", 2, "an argument is written paused:=true"),
    # Words of other systems, and windows.
    slip("slidectl ros2 topic list", 2, "no command 'ros2'", "slidectl topic"),
    slip("slidectl rqt_plot /rrbot/joint_states/position[0]", 2,
         "slidectl view", "slidectl plot", "slidectl top", "plot '/rrbot/joint_states/position[0]'"),
    # The tutorial's files, as a printed page has them.
    slip("slidectl check unquoted.xacro", 2,
         'unquoted.xacro:58', 'the value of effort is not in quotation marks: effort="100"'),
    slip("slidectl check curly.xacro", 2, 'values stand in plain quotation marks'),
    slip("slidectl check bare_limit.xacro", 2, "lacks <limit>", "is it a tag without its '<'?"),
    slip("slidectl check blank_tag.xacro", 2, "that has no blank: <hardwareInterface>"),
    slip("slidectl check no_inertial.xacro", 1, "has no <inertial>", "give it an <inertial> with <mass> and <inertia>"),
    slip("slidectl check blank_type.xacro", 1, "did you mean 'transmission_interface/SimpleTransmission'?"),
    slip("slidectl check no_namespace.xacro", 1, "lacks xmlns:xacro"),
    slip("slidectl check no_transmission.xacro --controllers config/slider_control.yaml", 1, "no transmission"),
    slip("slidectl check slider --controllers position.yaml", 1, "PositionJointInterface", "EffortJointInterface"),
    slip("slidectl check slider --controllers no_gains.yaml", 1, "pid"),
    slip("slidectl launch blank_param.launch", 2,
         "does not understand 'description'", "did you mean -param robot_description?"),
    slip("slidectl launch blank_file.launch", 2,
         "no such file", "slider control.yaml", "did you mean", "slider_control.yaml?"),
    slip("slidectl launch blank_find.launch", 2, "names have no spaces: did you mean $(find my_slider)?"),
    slip("slidectl launch blank_spawner.launch --strict", 2, "no program 'spawn model'", "Did you mean 'spawn_model'?"),
    slip("slidectl launch bare_param.launch --dry-run", 0,
         "the text 'param name=\"robot_description\"", "a tag without its '<'?"),
]  # fmt: skip

RRBOT = [
    # Topics, types, values.
    slip(f"slidectl ros rostopic pub /rrbot/joint1_position_controller/comand {TYPE} 'data: 1.0'", 1,
         "no topic", f"Did you mean '{COMMAND}'?"),
    slip(f"slidectl ros rostopic pub /joint1_position_controller/command {TYPE} 'data: 1.0'", 1,
         f"Did you mean '{COMMAND}'?"),
    slip(f"slidectl ros rostopic pub {COMMAND} std_msgs/Flaot64 'data: 1.0'", 1,
         "invalid message type: std_msgs/Flaot64", "did you mean std_msgs/Float64?"),
    slip(f"slidectl ros rostopic pub {COMMAND} std_msgs/Float32 'data: 1.0'", 1,
         "do not match", f"type: rostopic pub {COMMAND} std_msgs/Float64 VALUE"),
    slip(f"slidectl ros rostopic pub {COMMAND} 'data: 1.0'", 1,
         "invalid topic type", f"type: rostopic pub {COMMAND} std_msgs/Float64"),
    slip(f"slidectl ros rostopic pub {COMMAND} {TYPE} data: 1.0", 1,
         "quote it", f"type: rostopic pub {COMMAND} {TYPE} 'data: 1.0'"),
    slip(f"slidectl ros rostopic pub {COMMAND} {TYPE} 'data:1.0'", 1,
         "must be float type", "write a space after the colon: 'data: 1.0'"),
    slip(f"slidectl ros rostopic pub {COMMAND} {TYPE} 'data: 1,5'", 1, "numbers have a point, not a comma: 1.5"),
    slip(f"slidectl ros rostopic pub {COMMAND} {TYPE} 'data: 90'", 0, "90 rad are 14.3 turns", "send 1.571"),
    slip("slidectl echo joint_states/postion -n 1", 1, "no field 'postion'", "Did you mean 'position'?"),
    # Controllers and their services.
    slip("slidectl controller load joint1_position_controler", 1, "Did you mean 'joint1_position_controller'?"),
    slip("slidectl controller load joint2_position_controller", 1, "is loaded already",
         "start it: slidectl controller start joint2_position_controller"),
    slip("slidectl pub joint2_position_controller/command 1.0", 0, "is not running",
         "start it: slidectl controller start joint2_position_controller"),
    slip("slidectl controller start rival", 1, "joint1 is claimed by",
         "slidectl controller switch --start rival --stop joint1_position_controller"),
    slip(f"slidectl ros rosservice call {MANAGER}/load_controler \"name: 'joint1_position_controller'\"", 2,
         "is not available", f"did you mean {MANAGER}/load_controller?"),
    slip(f"slidectl ros rosservice call {MANAGER}/load_controller \"name: 'joint1_position controller'\"", 1,
         "is not a legal name", "did you mean 'joint1_position_controller'?"),
    # Parameters.
    slip("slidectl ros rosparam set /rrbot/joint1_position_controller/pid/p abc", 1, "must be a number"),
    slip("slidectl ros rosparam set /rrbot/joint1_position_controler/pid/p 200", 0,
         "is new; did you mean /rrbot/joint1_position_controller/pid/p?"),
    slip("slidectl ros rosparam get /rrbot/joint1_position_controller/pid/pp", 1,
         "is not set", "did you mean /rrbot/joint1_position_controller/pid/p?"),
    # Programs, and things that are there twice.
    slip("slidectl ros rosrun controller_manager spwaner joint_state_controller", 3, "did you mean spawner?"),
    slip("slidectl spawn rrbot", 1, "there is a robot 'rrbot' already", "slidectl delete rrbot"),
    slip("slidectl ros roscore", 1, "roscore cannot run as another roscore/master is already running"),
]  # fmt: skip

BARE_SLIDER = [
    slip("slidectl pub command 1.0", 1, "no topic 'command'", "slidectl controller config FILE.yaml"),
    slip("slidectl controller spawn joint1_position_controller", 1,
         "no controller", "slidectl controller config FILE.yaml"),
    slip("slidectl echo joint_states -n 1", 1, "no topic", "slidectl controller config FILE.yaml"),
    slip("slidectl controller config tabs.yaml", 2, "tabs.yaml:8", "YAML allows no tabs: use spaces"),
    slip("slidectl controller config blank_name.yaml", 2, "did you mean '/slider/joint1_position_controller'?"),
    slip("slidectl controller config no_blank.yaml", 2, "a blank follows the colon: joint: joint1"),
    slip("slidectl controller config config/slider_contrl.yaml", 2, "no such file", "there is no folder config"),
    slip("slidectl spawn wrong_interface.xacro -n other", 1, "did you mean 'hardware_interface/EffortJointInterface'?"),
    slip("slidectl spawn slidr", 1, "Did you mean 'slider'?"),
]  # fmt: skip


def typed(slidectl: CommandLine, case: Slip, folder: Path) -> None:
    """Type the line in the folder, and look at the answer."""
    done = slidectl(*shlex.split(case.line)[1:], cwd=folder, SLIDECTL_PACKAGE_PATH=str(folder))
    answer = done.stdout + done.stderr
    assert done.returncode == case.code, answer
    for text in case.named:
        assert text in answer
    assert "Traceback" not in answer


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a student, with files that have slips."""
    path = tmp_path_factory.mktemp("student")
    for name, text in FILES.items():
        (path / name).write_text(text)
    return path


@pytest.fixture(scope="module")
def nobody(tmp_path_factory: pytest.TempPathFactory) -> CommandLine:
    return CommandLine(tmp_path_factory.mktemp("nobody"))


@pytest.fixture(scope="module")
def rrbot(folder: Path) -> Iterator[CommandLine]:
    """RRBot: joint 1 is driven, the controller of joint 2 is loaded, and another one wants joint 1."""
    with running_daemon() as runtime:
        line = CommandLine(runtime.folder)
        words = ("--controllers", "config/rrbot_control.yaml", "--start", "joint_state_controller")
        line.ok("spawn", "rrbot", *words, "joint1_position_controller")
        rival = folder / "rival.yaml"
        rival.write_text("rrbot: {rival: {type: effort_controllers/JointEffortController, joint: joint1}}\n")
        line.ok("controller", "config", str(rival))
        line.ok("controller", "load", "joint2_position_controller", "rival")
        yield line


@pytest.fixture(scope="module")
def slider() -> Iterator[CommandLine]:
    with running_daemon() as runtime:
        line = CommandLine(runtime.folder)
        line.ok("spawn", "slider")
        yield line


@pytest.mark.parametrize("case", NOBODY, ids=lambda case: case.line)
def test_without_a_daemon(nobody: CommandLine, case: Slip, folder: Path) -> None:
    typed(nobody, case, folder)


@pytest.mark.parametrize("case", RRBOT, ids=lambda case: case.line)
def test_with_rrbot(rrbot: CommandLine, case: Slip, folder: Path) -> None:
    typed(rrbot, case, folder)


@pytest.mark.parametrize("case", BARE_SLIDER, ids=lambda case: case.line)
def test_with_a_slider_without_controllers(slider: CommandLine, case: Slip, folder: Path) -> None:
    typed(slider, case, folder)
