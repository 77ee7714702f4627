"""What `slidectl launch` prints without starting anything, and what it says about wrong command lines."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
import yaml
from command_line import CommandLine
from launch_runs import nothing_is_left

ASKED = ["--nodes", "--files", "--dump-params", "--ros-args", "--dry-run"]


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "test.launch"
    path.write_text(
        """<launch>
  <arg name="gain" default="1.5" doc="how much"/>
  <arg name="must" doc="give it"/>
  <include file="$(find rrbot_gazebo)/launch/rrbot_world.launch"/>
  <param name="who" command="whoami"/>
  <node pkg="rostopic" type="rostopic" name="late" args="pub /x std_msgs/Float64 $(arg gain)"/>
  <node pkg="controller_manager" type="spawner" name="control" ns="rrbot" args="joint_state_controller"/>
</launch>
"""
    )
    return str(path)


def test_nodes_and_files_are_listed_a_line_each(slidectl: CommandLine, file: str) -> None:
    assert slidectl.ok("launch", file, "must:=1", "--nodes") == "/gazebo\n/urdf_spawner\n/late\n/rrbot/control\n"
    files = slidectl.ok("launch", file, "must:=1", "--files").splitlines()
    assert [Path(line).name for line in files] == ["test.launch", "rrbot_world.launch", "empty_world.launch"]
    assert files[0] == file
    rows = [json.loads(line) for line in slidectl.ok("launch", file, "must:=1", "--nodes", "--json").splitlines()]
    assert rows[0] == {"node": "/gazebo"}


def test_parameters_are_dumped_as_yaml(slidectl: CommandLine, file: str) -> None:
    values = yaml.safe_load(slidectl.ok("launch", file, "must:=1", "--dump-params"))
    assert list(values) == ["/robot_description", "/use_sim_time", "/who"]
    assert values["/robot_description"].startswith("<?xml")
    assert values["/use_sim_time"] is True
    assert json.loads(slidectl.ok("launch", file, "must:=1", "--dump-params", "--json")) == values


def test_arguments_are_told_even_when_they_are_missing(slidectl: CommandLine, file: str) -> None:
    expected = 'Required Arguments:\n  must: give it\nOptional Arguments:\n  gain (default "1.5"): how much\n'
    assert slidectl.ok("launch", file, "--ros-args") == expected
    rows = [json.loads(line) for line in slidectl.ok("launch", file, "--ros-args", "--json").splitlines()]
    assert {"name": "gain", "default": "1.5", "doc": "how much"} in rows


def test_a_dry_run_prints_the_steps_with_their_places_and_runs_no_program(
    slidectl: CommandLine, file: str, tmp_path: Path
) -> None:
    path = Path(file)
    path.write_text(path.read_text().replace("whoami", f"touch {tmp_path}/ran"))
    lines = slidectl.ok("launch", file, "must:=1", "--dry-run").splitlines()
    assert any("/robot_description = <?xml" in line and "rrbot_world.launch:19" in line for line in lines)
    assert f"{file}:5: /who = what the command prints" in lines
    assert lines[-2] == f"{file}:7: /rrbot/control: load and start joint_state_controller in /rrbot"
    assert lines[-1] == f"{file}:6: /late: run rostopic pub /x std_msgs/Float64 1.5"
    assert not (tmp_path / "ran").exists()
    steps = [json.loads(line) for line in slidectl.ok("launch", file, "must:=1", "--dry-run", "--json").splitlines()]
    assert steps[-1] == {"step": "tool", "text": lines[-1].partition(":6: ")[2], "file": file, "line": 6}
    nothing_is_left(slidectl.runtime)


def test_the_command_line_of_a_node_and_the_file_that_defines_it(slidectl: CommandLine, file: str) -> None:
    text = slidectl.ok("launch", file, "must:=1", "--args", "/rrbot/control")
    assert text.startswith('ROS_NAMESPACE="/rrbot" controller_manager/spawner joint_state_controller')
    assert slidectl.ok("launch", file, "must:=1", "--find-node", "gazebo").endswith("empty_world.launch\n")
    for option in ("--args", "--find-node"):
        done = slidectl("launch", file, "must:=1", option, "/rrbot/contrl")
        assert done.returncode == 1
        assert "no node '/rrbot/contrl'" in done.stderr
        assert "Did you mean '/rrbot/control'?" in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        ([], 2, "which launch file?"),
        (["nofile.launch"], 2, "nofile.launch: no such launch file"),
        (["slidr"], 1, "Did you mean 'slider'?"),
        (["nopkg", "x.launch"], 1, "no package 'nopkg'"),
        (["slider", "pausd:=true"], 2, "no argument 'pausd' in"),
        (["slider", ":=true"], 2, "':=true' is not KEY:=VALUE"),
        (["slider", "--nodes", "--files"], 2, "--nodes and --files exclude each other"),
        (["slider", "--package", "x"], 2, "'x' is not KEY=VALUE"),
        (["slider", "--sigint-timeout", "0"], 2, "is not above 0"),
        (["slider", "model:=/no/such.xacro"], 2, "xacro: no such file: /no/such.xacro"),
    ],
)
def test_a_wrong_command_line_is_an_error_in_one_to_three_lines(
    slidectl: CommandLine, words: list[str], code: int, text: str
) -> None:
    done = slidectl("launch", *words)
    assert done.returncode == code
    assert text in done.stderr
    assert len(done.stderr.splitlines()) <= 4
    nothing_is_left(slidectl.runtime)


def test_a_package_can_be_given_by_its_path(slidectl: CommandLine, tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "a.launch").write_text('<launch><param name="x" value="$(find mine)"/></launch>')
    text = slidectl.ok("launch", "mine", "a.launch", "--package", f"mine={folder}", "--dump-params")
    assert text == f"/x: {folder}\n"


def test_what_is_wrong_in_the_files_is_said_beside_what_was_asked_for(slidectl: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "odd.launch"
    path.write_text('<launch>\n<parm name="y" value="1"/>\n<param name="x" value="1"/></launch>')
    done = slidectl("launch", str(path), "--dump-params")
    assert done.stdout == "/x: 1\n"
    assert "odd.launch:2" in done.stderr
    assert "did you mean <param>?" in done.stderr


@pytest.mark.parametrize("option", ASKED)
def test_asking_starts_nothing(slidectl: CommandLine, option: str) -> None:
    slidectl.ok("launch", "slider", option)
    nothing_is_left(slidectl.runtime)


def test_a_launch_file_may_come_through_a_pipe_of_the_shell(slidectl: CommandLine) -> None:
    line = '"$@" <(echo \'<launch><param name="a" value="1"/></launch>\')'
    command = ["bash", "-c", line, "bash", *slidectl.argv("launch", "--dump-params")]
    done = subprocess.run(command, env=slidectl.environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("/a: 1\n", "")


def test_of_many_unknown_tags_the_first_are_named_and_the_rest_is_counted(
    slidectl: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "odd.launch"
    path.write_text("<launch>\n" + "".join(f"<x{number}/>\n" for number in range(900)) + "</launch>\n")
    lines = slidectl("launch", str(path), "--dry-run").stderr.splitlines()
    assert len(lines) == 101
    assert lines[-1] == f"warning: {path}:102: <x100>: and 800 more of this kind, of which this is the first"
    lines = slidectl("check", str(path)).stdout.splitlines()
    assert sum("unknown in <launch>" in line for line in lines) == 100
    assert any("and 800 more of this kind" in line for line in lines)
    assert len(lines) < 250
