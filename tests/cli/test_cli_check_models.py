"""`slidectl check` as a process: what it prints, in which form, and its exit codes. No daemon runs."""

from __future__ import annotations

import json
import shlex
import subprocess
from pathlib import Path

import pytest
from command_line import CommandLine

ROBOT = """<robot name="bot">
  <link name="world"/>
  <link name="cart"><inertial><mass value="1"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="slide" type="prismatic"><parent link="world"/><child link="cart"/>
    <limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
  EXTRA
</robot>
"""
SOUND = ROBOT.replace("EXTRA", "")
WITH_IGNORED = ROBOT.replace("EXTRA", '<gazebo reference="cart"><kp>1</kp></gazebo>')
WITH_WRONG = ROBOT.replace("EXTRA", '<gazebo reference="crat"/>')
BROKEN = ROBOT.replace("EXTRA", '<gazebo reference="cart"><mu1>x</mu1></gazebo>')

CONTROLLERS = """bot:
  c:
    type: effort_controllers/JointPositionController
    joint: slyde
    pid: {p: 1.0}
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "bot.urdf"
    path.write_text(SOUND)
    return path


CASES = [
    (SOUND, 0, 0),
    (WITH_IGNORED, 0, 1),
    (WITH_WRONG, 1, 1),
    (BROKEN, 2, 2),
    ("<robot", 2, 2),
    ("<sdf/>", 2, 2),
]


@pytest.mark.parametrize(("text", "code", "strict_code"), CASES)
def test_the_exit_code_says_how_bad_it_is(
    slidectl: CommandLine, robot: Path, text: str, code: int, strict_code: int
) -> None:
    robot.write_text(text)
    assert slidectl("check", str(robot)).returncode == code
    assert slidectl("check", str(robot), "--strict").returncode == strict_code


def test_a_broken_file_has_its_findings_on_stdout_and_the_reason_on_stderr(slidectl: CommandLine, robot: Path) -> None:
    robot.write_text(BROKEN)
    done = slidectl("check", str(robot))
    assert f"{robot}:7  wrong      <mu1>: link 'cart': <mu1> is 'x', which is not a number\n" in done.stdout
    assert "link 'cart'/<inertial>/<mass>" in done.stdout
    assert done.stderr == f"error: {robot}:7: link 'cart': <mu1> is 'x', which is not a number\n"


def test_text_is_in_columns_a_group_a_file_with_a_summary(slidectl: CommandLine, robot: Path, tmp_path: Path) -> None:
    control = tmp_path / "control.yaml"
    control.write_text(CONTROLLERS)
    done = slidectl("check", str(robot), "--controllers", str(control))
    model, parameters, summary = done.stdout.split("\n\n")
    assert done.returncode == 1
    assert all(line.startswith(f"{robot}:") for line in model.splitlines())
    assert all(line.startswith(f"{control}:") for line in parameters.splitlines())
    assert f"{robot}:3  used       link 'cart'/<inertial>/<mass>: value=\"1\"\n" in model
    assert f"{control}:4  wrong      /bot/c/joint: the robot has no joint 'slyde'; did you mean 'slide'?" in parameters
    assert summary.endswith(" used, 0 converted, 0 ignored, 1 wrong\n")


def test_json_is_one_object_a_finding_with_stable_keys(slidectl: CommandLine, robot: Path) -> None:
    found = [json.loads(line) for line in slidectl.ok("check", str(robot), "--json").splitlines()]
    assert {tuple(entry) for entry in found} == {("file", "line", "verdict", "subject", "text")}
    mass = {"file": str(robot), "line": 3, "verdict": "used"}
    assert {**mass, "subject": "link 'cart'/<inertial>/<mass>", "text": 'value="1"'} in found


def test_only_what_is_asked_for_is_printed_and_all_is_counted(slidectl: CommandLine, robot: Path) -> None:
    robot.write_text(WITH_IGNORED)
    lines = slidectl.ok("check", str(robot), "--only", "ignored", "--only", "wrong").splitlines()
    assert len(lines) == 3
    assert lines[0].startswith(f'{robot}:7  ignored    <gazebo reference="cart">/<kp>')
    assert ", 1 ignored, 0 wrong" in lines[2]


def test_a_model_may_come_on_stdin(slidectl: CommandLine) -> None:
    done = slidectl("check", "-", stdin=WITH_WRONG)
    assert done.returncode == 1
    assert "<stdin>:7  wrong " in done.stdout
    assert "there is no link or joint 'crat'" in done.stdout


@pytest.mark.parametrize("text", [SOUND, CONTROLLERS.replace("slyde", "slide"), "<launch/>"])
def test_a_file_may_be_a_pipe_that_can_be_read_once(slidectl: CommandLine, tmp_path: Path, text: str) -> None:
    (tmp_path / "text").write_text(text)
    line = shlex.join(slidectl.argv("check")) + f" <(cat {shlex.quote(str(tmp_path / 'text'))})"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=slidectl.environment, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith(" 0 wrong\n")


def test_controllers_may_come_on_stdin(slidectl: CommandLine) -> None:
    done = slidectl("check", "-", stdin=CONTROLLERS)
    assert done.returncode == 0
    assert "<stdin>:4  used       /bot/c/joint: slyde" in done.stdout


def test_shipped_files_go_by_their_names_in_any_folder(slidectl: CommandLine, tmp_path: Path) -> None:
    done = slidectl("check", "slider", "--controllers", "config/slider_control.yaml", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "0.01 has no effect without i_clamp" in done.stdout
    assert slidectl("check", "config/rrbot_control.yaml", cwd=tmp_path).returncode == 0


def test_another_reader_is_asked_on_demand_only(slidectl: CommandLine, robot: Path) -> None:
    assert "yourdfpy" not in slidectl.ok("check", str(robot))
    assert "note: yourdfpy reads the same tree" in slidectl.ok("check", str(robot), "--second-opinion")


def test_all_faults_of_a_model_are_told_in_one_run(slidectl: CommandLine, robot: Path) -> None:
    robot.write_text(BROKEN.replace('mass value="1"', 'mass value="0"').replace('effort="10"', ""))
    done = slidectl("check", str(robot), "--only", "wrong", "--json")
    assert done.returncode == 2
    assert [json.loads(line)["line"] for line in done.stdout.splitlines()] == [6, 7]


WRONG_USAGE = [
    (("slidr",), 1, "Did you mean 'slider'?"),
    (("none.urdf",), 2, "none.urdf: no such file"),
    (("none.yaml",), 2, "none.yaml: no such file"),
    (("~nosuch/none.urdf",), 2, "none.urdf: no such file"),
    (("~nosuch/none.sdf",), 2, "none.sdf: no such file"),
    (("slider", "oops"), 2, "'oops' is not KEY:=VALUE"),
    (("config/slider_control.yaml", "a:=1"), 2, "a:= has no meaning"),
    (("config/slider_control.yaml", "--controllers", "config/slider_control.yaml"), 2, "goes with a model"),
    (("slider", "--controllers", "none.yaml"), 2, "none.yaml: no such file"),
    (("slider", "--controllers", "~nosuch/none.yaml"), 2, "none.yaml: no such file"),
]


@pytest.mark.parametrize(("words", "code", "reason"), WRONG_USAGE)
def test_wrong_usage_is_explained(slidectl: CommandLine, words: tuple[str, ...], code: int, reason: str) -> None:
    done = slidectl("check", *words)
    assert (done.returncode, done.stdout) == (code, "")
    assert reason in done.stderr


def test_colours_are_for_terminals(slidectl: CommandLine, robot: Path) -> None:
    robot.write_text(WITH_WRONG)
    assert "\x1b" not in slidectl("check", str(robot)).stdout
    assert b"\x1b[31mwrong" in slidectl.on_a_terminal("check", str(robot), "--only", "wrong")
