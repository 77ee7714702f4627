"""What never ends, or comes to more than any robot has, is refused with its file and line; small files stay so."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from launch_files import Workspace, notices

from slidectl import description
from slidectl.description import controllers_file, xacro_adapter
from slidectl.errors import BadFile
from slidectl.extensions.launch import substitution, tag

XACRO = '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'


def macros(levels: int) -> str:
    """Macros that each call the one before twice."""
    text = "<xacro:macro name='m0'><z/></xacro:macro>"
    text += "".join(
        f"\n<xacro:macro name='m{n}'><xacro:m{n - 1}/><xacro:m{n - 1}/></xacro:macro>" for n in range(1, levels)
    )
    return XACRO.format(f"{text}<xacro:m{levels - 1}/>")


def arguments(levels: int) -> str:
    """Arguments that each hold the one before ten times."""
    text = '<arg name="a0" value="xxxxxxxxxx"/>'
    return text + "".join(f'\n<arg name="a{n}" value="{f"$(arg a{n - 1})" * 10}"/>' for n in range(1, levels))


def test_macros_that_unfold_without_end_are_refused(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    path = workspace.write("urdf/bomb.xacro", macros(40))
    monkeypatch.setattr(xacro_adapter, "LIMITS", replace(xacro_adapter.LIMITS, cpu_s=1))
    with pytest.raises(BadFile, match=r"bomb.xacro:\d+: it takes more than 1 s to expand \(in macro 'm"):
        description.load(path, {}, workspace.packages)
    description.load(workspace.write("urdf/small.xacro", macros(5)), {}, workspace.packages)


def test_arguments_that_unfold_without_end_are_refused(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match=r"test.launch:\d: <arg>: value: comes to more than 4096 KiB of text"):
        workspace.plan(arguments(12))
    assert len(workspace.plan(arguments(5)).files) == 1


@pytest.mark.parametrize(("value", "place"), [("{}$(arg n)", "part.launch:1: <param>: value: "), ("{}", "<include>: ")])
def test_long_texts_are_counted_with_what_is_not_substituted(workspace: Workspace, value: str, place: str) -> None:
    text = f'<arg name="n"/><param name="p$(arg n)" value="{value.format("x" * 2**22)}"/>'
    workspace.write("launch/part.launch", f"<launch>{text}</launch>")
    part = '<include file="$(dirname)/part.launch"><arg name="n" value="{}"/></include>'
    with pytest.raises(BadFile, match=f"{place}the launch expands to more than 65536 KiB of text"):
        workspace.plan("".join(map(part.format, range(40))))


def test_of_many_unknown_attributes_the_first_are_named_and_the_rest_is_counted(workspace: Workspace) -> None:
    attributes = " ".join(f'a{number}="1"' for number in range(1500))
    lines = notices(workspace.plan(f'<arg name="x" value="1" {attributes}/>'))
    assert len(lines) == 101
    assert "and 1400 more unknown attributes have no effect" in lines[100]


def test_a_text_with_many_missing_packages_is_refused_soon(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match=r"test.launch:1: <param>: value: comes to more than 10000 substitutions"):
        workspace.plan(f'<param name="x" value="{"$(find nosuchpkg)" * 200_000}"/>')


@pytest.mark.parametrize("start", ['<node name="n" pkg="p" type="t" args=', '<param name="x" command='])
def test_a_text_that_is_split_into_words_is_short(workspace: Workspace, start: str) -> None:
    with pytest.raises(BadFile, match=r"test.launch:1: <\w+>: \w+: comes to more than 64 KiB of text"):
        workspace.plan(f'{start}"{"x" * 2**20}"/>')


def test_the_bounds_of_a_launch_are_those_of_text_of_substitutions_and_of_time(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace.plan(arguments(3))
    monkeypatch.setattr(substitution, "MOST_TEXT", 900)
    with pytest.raises(BadFile, match=r"test.launch:3: <arg>: value: comes to more than 0 KiB"):
        workspace.plan(arguments(3))
    monkeypatch.undo()
    monkeypatch.setattr(substitution, "MOST_SUBSTITUTIONS", 9)
    with pytest.raises(BadFile, match=r"test.launch:2: <arg>: value: comes to more than 9 substitutions"):
        workspace.plan(arguments(3))
    monkeypatch.undo()
    monkeypatch.setattr(tag, "MOST_TEXT", 1000)
    with pytest.raises(BadFile, match=r"test.launch:3: <arg>: value: the launch expands to more than 0 KiB of text"):
        workspace.plan(arguments(3))
    with pytest.raises(BadFile, match=r"test.launch:1: <rosparam>: the launch expands to more than 0 KiB of text"):
        workspace.values('<arg name="a" value="{}"/><rosparam subst_value="true">x: {}</rosparam>'.format(
            "x" * 50, "$(arg a)" * 30
        ))  # fmt: skip
    monkeypatch.undo()
    monkeypatch.setattr(tag, "MOST_SECONDS", -1.0)
    with pytest.raises(BadFile, match=r"test.launch:1: <launch>: the launch takes more than -1 s to read"):
        workspace.plan(arguments(3))


def fifo(path: Path) -> None:
    os.mkfifo(path)


def bound_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        here = Path.cwd()
        os.chdir(path.parent)  # the paths of sockets are short
        server.bind(path.name)
        os.chdir(here)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


KINDS = [(fifo, "a pipe"), (bound_socket, "a socket"), (device, "a device")]
PLACES = [
    '<include file="{}"/>',
    '<param name="x" textfile="{}"/>',
    '<param name="x" binfile="{}"/>',
    '<rosparam file="{}"/>',
]


@pytest.mark.parametrize(("make", "kind"), KINDS)
@pytest.mark.parametrize("place", PLACES)
def test_a_launch_reads_regular_files_only(
    workspace: Workspace, make: Callable[[Path], None], kind: str, place: str
) -> None:
    path = workspace.package / "thing"
    make(path)
    with pytest.raises(BadFile, match=rf"test.launch:2: .*is {kind}, and only regular files are read"):
        workspace.values("\n" + place.format(path))


@pytest.mark.parametrize(("make", "kind"), KINDS)
@pytest.mark.parametrize("place", ['<xacro:include filename="{}"/>', "<link name=\"${{xacro.load_yaml('{}')}}\"/>"])
def test_a_xacro_reads_regular_files_only(
    workspace: Workspace, make: Callable[[Path], None], kind: str, place: str
) -> None:
    path = workspace.package / "thing.yaml"
    make(path)
    robot = workspace.write("robot.xacro", XACRO.format("\n" + place.format(path)))
    with pytest.raises(BadFile, match=rf"robot.xacro:\d: .*thing.yaml: is {kind}, and only regular files are read"):
        description.load(robot, {}, workspace.packages)
    description.written(robot, workspace.packages)


@pytest.mark.parametrize(("make", "kind"), KINDS[1:])
def test_what_a_user_names_is_no_socket_and_no_device(
    workspace: Workspace, make: Callable[[Path], None], kind: str
) -> None:
    path = workspace.package / "thing.yaml"
    make(path)
    with pytest.raises(BadFile, match=rf"thing.yaml: is {kind}"):
        description.load(path)
    with pytest.raises(BadFile, match=rf"thing.yaml: is {kind}"):
        controllers_file.read(path)
