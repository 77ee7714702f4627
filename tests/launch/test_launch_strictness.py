"""What roslaunch itself (ros_comm 1.15, Noetic) takes and what it refuses, recorded tag by tag."""

from __future__ import annotations

import pytest
from launch_files import Workspace

from slidectl.errors import BadFile

NODE = '<node pkg="rviz" type="rviz" name="n" {}/>'
INCLUDE = '<include file="$(dirname)/inner.launch" {}/>'
TEST = '<test pkg="p" type="t" test-name="x" {}/>'
MACHINE = '<machine name="m" address="localhost"/>'

TAKEN = [
    NODE.format('respawn="TRUE"'), NODE.format('clear_params=""'), NODE.format('cwd="ros_home"'),
    NODE.format('machine="localhost"'), MACHINE + NODE.format('machine="m"'), MACHINE + MACHINE,
    INCLUDE.format('ns="a//b" clear_params=""'), INCLUDE.format('pass_all_args="$(eval 1 == 1)"'),
    '<group clear_params=""/>', '<group if=" true "/>', '<group if="$(eval 1)"/>', '<remap from="a//b" to="c/"/>',
    TEST.format('time-limit="1.5" retry="2" required="true"'), TEST.format('time-limit="" retry=""'),
    TEST.format("") * 2,
]  # fmt: skip
REFUSED = [
    NODE.format('respawn="1"'), NODE.format('required=" true"'), NODE.format('respawn=""'), NODE.format('ns=""'),
    NODE.format('output="SCREEN"'), NODE.format('output=""'), NODE.format('cwd="NODE"'), NODE.format('cwd=""'),
    NODE.format('machine="m"'), '<machine name="m"/>', '<machine name="m" address="far.away"/>',
    INCLUDE.format('ns=""'), INCLUDE.format('clear_params="1" ns="a"'), INCLUDE.format('pass_all_args="1"'),
    '<include file=" $(dirname)/inner.launch"/>', '<include file="~/inner.launch"/>', '<include file="inner.launch"/>',
    '<include file="$(dirname)/inner.launch"><arg name="a" value="1"/><arg name="a" value="1"/></include>',
    '<include file="$(dirname)/inner.launch"><arg name="a" value="1" default="1"/></include>',
    '<group ns=""/>', '<group if=""/>', '<group if="yes"/>', '<remap from=" a" to="b"/>', '<remap from="a-b" to="b"/>',
    '<rosparam subst_value="1">a: 1</rosparam>', '<rosparam command="LOAD">a: 1</rosparam>', "<launch/>",
    '<param name="x" value="1" type="$(optenv NOT_SET int)"/>', '<arg name="a" default="1" doc="$(env NOT_SET)"/>',
    '<test pkg="p" type="t"/>', TEST.format('name="a/b"'),
]  # fmt: skip


def plan(workspace: Workspace, content: str) -> None:
    workspace.launch_file('<arg name="a" default="0"/>', "inner.launch")
    workspace.plan(content)


@pytest.mark.parametrize("content", TAKEN)
def test_what_is_taken_there_is_taken_here(workspace: Workspace, content: str) -> None:
    plan(workspace, content)


@pytest.mark.parametrize("content", REFUSED)
def test_what_is_refused_there_is_refused_here_with_the_place(workspace: Workspace, content: str) -> None:
    with pytest.raises(BadFile, match=r"test.launch:1: <\w+>: "):
        plan(workspace, content)


def test_a_test_starts_nothing_and_its_parameters_are_set(workspace: Workspace) -> None:
    content = (
        '<param name="~all" value="0"/><test pkg="p" type="t" test-name="x" name="own" ns="g" clear_params="true">'
        '<param name="a" value="1"/><rosparam>b: 2</rosparam></test><test pkg="p" type="t" test-name="x"/>'
    )
    found = workspace.plan(content)
    values = {name: value for name, (value, _) in found.parameters().items()}
    assert values == {"/g/own/all": 0, "/g/own/a": 1, "/g/own/b": 2, "/x/all": 0}
    assert [namespace for namespace, _ in found.clear] == ["/g/own"]
    assert found.nodes == []
