"""What never ends, or comes to more than any robot has, is refused with its file and line; small files stay so."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from launch_files import Workspace

from slidectl import description
from slidectl.description import controllers_file, xacro_adapter
from slidectl.errors import BadFile
from slidectl.extensions.launch import tag

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
    with pytest.raises(
        BadFile, match=r"test.launch:\d: <arg>: value: the launch expands to more than 65536 KiB of text"
    ):
        workspace.plan(arguments(12))
    assert len(workspace.plan(arguments(5)).files) == 1


def test_the_bounds_of_a_launch_are_those_of_text_and_of_time(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace.plan(arguments(3))
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
    description.declared_arguments(robot, workspace.packages)


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
