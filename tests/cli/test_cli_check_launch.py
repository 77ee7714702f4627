"""`slidectl check` of launch files as a process: names of all forms, arguments, and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import CommandLine

SHIPPED = [("my_slider", "slider.launch"), ("my_slider",), ("rrbot_gazebo", "rrbot_world.launch"), ("rrbot_control",)]


@pytest.mark.parametrize("words", SHIPPED, ids=" ".join)
def test_the_samples_are_found_by_name_in_any_folder_and_have_nothing_wrong(
    slidectl: CommandLine, tmp_path: Path, words: tuple[str, ...]
) -> None:
    done = slidectl("check", *words, "--only", "wrong", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith(" 0 wrong\n")


def test_a_launch_file_is_checked_with_what_it_loads(slidectl: CommandLine) -> None:
    found = [json.loads(line) for line in slidectl.ok("check", "my_slider", "slider.launch", "--json").splitlines()]
    files = {Path(entry["file"]).name for entry in found}
    assert {"slider.launch", "slider.xacro", "slider_control.yaml"} <= files
    assert all(entry["line"] for entry in found)
    assert slidectl("check", "my_slider", "slider.launch", "--strict").returncode == 1


def test_arguments_reach_the_launch_file_and_misspelt_ones_are_wrong_usage(slidectl: CommandLine) -> None:
    assert "argument gui: 'true', as given" in slidectl.ok("check", "my_slider", "gui:=true")
    done = slidectl("check", "my_slider", "giu:=true")
    assert (done.returncode, done.stdout) == (2, "")
    assert "no argument 'giu'" in done.stderr
    assert "Did you mean 'gui'?" in done.stderr


def test_a_broken_launch_file_cannot_be_used(slidectl: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "x.launch"
    path.write_text('<launch>\n<param name="a" value="$(env NOT_SET_ANYWHERE)"/>\n</launch>')
    done = slidectl("check", str(path))
    assert done.returncode == 2
    assert f"{path}:2  wrong" in done.stdout
    assert done.stderr.startswith(f"error: {path}:2: <param>: value: environment variable")


def test_a_launch_file_may_come_on_stdin(slidectl: CommandLine) -> None:
    done = slidectl("check", "-", stdin="<launch>\n<nod/></launch>")
    assert done.returncode == 1
    assert "<stdin>:2  wrong" in done.stdout


def test_a_package_or_file_that_is_not_there_is_explained(slidectl: CommandLine) -> None:
    done = slidectl("check", "my_slidr", "slider.launch")
    assert (done.returncode, done.stdout) == (1, "")
    assert "no package 'my_slidr'. Did you mean 'my_slider'?" in done.stderr
    done = slidectl("check", "my_slider", "slidr.launch")
    assert "Did you mean 'slider.launch'?" in done.stderr


def test_models_and_controllers_are_found_in_packages(slidectl: CommandLine) -> None:
    assert "joint1" in slidectl.ok("check", "rrbot_description", "rrbot.xacro")
    assert "joint2_position_controller" in slidectl.ok("check", "rrbot_control", "rrbot_control.yaml")
    done = slidectl("check", "rrbot_control", "rrbot_contrl.yaml")
    assert done.returncode == 1
    assert "no file 'rrbot_contrl.yaml' in the package rrbot_control" in done.stderr
    assert "Did you mean 'rrbot_control.yaml'?" in done.stderr
    assert "no package 'rrbot_contrl'" in slidectl("check", "rrbot_contrl", "rrbot_control.yaml").stderr
