"""What roslaunch itself printed for these files, recorded from the real one (ros_comm 1.15, Noetic)."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from launch_files import Workspace, notices

from slidectl.errors import BadFile, SlidectlError
from slidectl.extensions.launch import files, loader, node_kinds
from slidectl.extensions.launch.commands import launch_text

ALL = """<launch>
  <arg name="who" default="left" doc="which slide"/>
  <arg name="sim" default="true" doc="simulate"/>
  <arg name="gain" default="1.5"/>
  <param name="name" value="$(arg who)"/>
  <param name="i" value="10"/>
  <param name="f" value="1.0"/>
  <param name="f2" value="1e3"/>
  <param name="s" value="hello"/>
  <param name="si" value="10" type="str"/>
  <param name="b" value="true"/>
  <param name="di" value="10" type="double"/>
  <param name="y" value="[1, {a: 2}]" type="yaml"/>
  <param name="txt" textfile="$(find slide_demo)/config/pid.yaml"/>
  <param name="cmd" command="$(dirname)/../scripts/generate $(arg who)"/>
  <param name="dir" value="$(dirname)"/>
  <param name="e1" value="$(env HERE)"/>
  <param name="e2" value="$(optenv NOT_SET fallback words)"/>
  <param name="e3" value="$(optenv NOT_SET)"/>
  <param name="ev" value="$(eval 10.0 if arg('who') == 'left' else 5 + 6)"/>
  <param name="ev2" value="$(eval sim)"/>
  <param name="ev3" value="$(eval sin(pi/2))"/>
  <param if="$(arg sim)" name="only_if" value="1"/>
  <param unless="$(arg sim)" name="only_unless" value="1"/>
  <rosparam>
    lst: [1, 2.5, x]
    blk: {a: 1, b: {c: 2}}
  </rosparam>
  <rosparam file="$(find slide_demo)/config/pid.yaml" command="load"/>
  <rosparam param="name">left</rosparam>
  <param name="name" value="$(arg who)"/>
  <include file="$(find slide_demo)/launch/inc.launch" ns="incns">
    <arg name="who" value="$(arg who)"/>
  </include>
  <group ns="$(arg who)">
    <param name="in_group" value="1"/>
    <param name="~priv" value="group_private"/>
    <remap from="pos" to="position"/>
    <env name="X" value="x_$(arg who)"/>
    <node pkg="slide_demo" type="talk.py" name="talk" args="one 'two words' --three" output="screen">
      <param name="gain" value="$(arg gain)"/>
      <rosparam>extra: {k: 1}</rosparam>
    </node>
  </group>
</launch>
"""
INC = """<launch>
  <arg name="who"/>
  <arg name="level" value="3"/>
  <param name="inc_who" value="$(arg who)"/>
  <param name="inc_level" value="$(arg level)"/>
</launch>
"""

LEFT = """
/b: true
/blk/a: 1
/blk/b/c: 2
/cmd: 'generated left

  '
/di: 10.0
/dir: DIRECTORY
/e1: home
/e2: fallback words
/e3: ''
/ev: 10.0
/ev2: true
/ev3: 1.0
/f: 1.0
/f2: 1e3
/i: 10
/incns/inc_level: 3
/incns/inc_who: left
/left/in_group: 1
/left/talk/extra/k: 1
/left/talk/gain: 1.5
/left/talk/priv: group_private
/lst:
- 1
- 2.5
- x
/name: left
/only_if: 1
/pid/d: 10.0
/pid/i: 0.01
/pid/p: 100.0
/s: hello
/si: '10'
/txt: 'pid: {p: 100.0, i: 0.01, d: 10.0}

  '
/y:
- 1
- a: 2
"""


@pytest.fixture
def demo(workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    shutil.rmtree(workspace.package)
    demo = Workspace(tmp_path, "slide_demo")
    monkeypatch.setenv("HERE", "home")
    demo.write("config/pid.yaml", "pid: {p: 100.0, i: 0.01, d: 10.0}\n")
    demo.write("launch/all.launch", ALL)
    demo.write("launch/inc.launch", INC)
    for name, text in {"generate": 'echo "generated $1"', "talk.py": "exit 0"}.items():
        demo.write(f"scripts/{name}", f"#!/bin/sh\n{text}\n").chmod(0o755)
    return demo


def plan(demo: Workspace, **arguments: str) -> Any:
    return loader.load(files.find(["slide_demo", "all.launch"], demo.packages), arguments, demo.packages)


def test_parameters_are_those_of_the_real_one(demo: Workspace) -> None:
    directory = str(demo.package / "launch")
    assert launch_text.as_yaml(plan(demo)) == LEFT.lstrip().replace("DIRECTORY", directory)


def test_arguments_change_what_they_changed_there(demo: Workspace) -> None:
    values = yaml.safe_load(launch_text.as_yaml(plan(demo, who="right", sim="false", gain="2")))
    assert values["/ev"] == 11
    assert values["/ev2"] is False
    assert values["/right/talk/gain"] == 2
    assert values["/only_unless"] == 1
    assert "/only_if" not in values
    assert values["/cmd"] == "generated right\n"


def test_nodes_files_and_arguments_are_listed_as_there(demo: Workspace) -> None:
    assert [node.full_name for node in plan(demo).nodes] == ["/left/talk"]
    assert [Path(path).name for path in plan(demo).files] == ["all.launch", "inc.launch"]
    source = files.find(["slide_demo", "all.launch"], demo.packages)
    only = loader.load(source, {}, demo.packages, arguments_only=True)
    assert launch_text.arguments(only) == (
        "Optional Arguments:\n"
        '  gain (default "1.5"): undocumented\n'
        '  sim (default "true"): simulate\n'
        '  who (default "left"): which slide'
    )


def test_the_command_line_of_a_node_is_the_same(demo: Workspace) -> None:
    made = plan(demo)
    [task] = node_kinds.tasks(made, demo.packages)
    program = demo.package / "scripts" / "talk.py"
    assert launch_text.command_line(task) == (
        f'ROS_NAMESPACE="/left" X="x_left" {program} one \'two words\' --three pos:=position __name:=talk'
    )
    with pytest.raises(SlidectlError, match="no node '/nope'"):
        launch_text.find_node(made, "/nope")


def test_arguments_without_a_default_are_required(workspace: Workspace) -> None:
    path = workspace.launch_file('<arg name="must" doc="give me"/><param name="x" value="$(arg must)"/>')
    only = loader.load(files.find([str(path)], workspace.packages), {}, arguments_only=True)
    assert launch_text.arguments(only) == "Required Arguments:\n  must: give me"
    content = (
        '<arg name="a"/><arg name="b" default="$(arg a)/x" doc="$(eval 1 + 1)"/><arg name="c" default="1" if="0"/>'
    )
    lacking = loader.load(
        files.find([str(workspace.launch_file(content))], workspace.packages), {}, arguments_only=True
    )
    assert launch_text.arguments(lacking).splitlines()[-1] == '  b (default "$(arg a)/x"): 2'
    none = loader.load(files.find([str(workspace.launch_file(""))], workspace.packages), {}, arguments_only=True)
    assert launch_text.arguments(none) == "No arguments."


# The file, and what must be said about it. Those that the real one refuses are refused, with file and line.
REFUSED = {
    "noarg": ('<arg name="must" doc="give me"/>', r"test.launch:1: <arg>: the argument 'must' is required"),
    "undef": ('<param name="x" value="$(arg nothere)"/>', "there is no argument 'nothere' here"),
    "nofind": ('<param name="x" textfile="$(find nopkg)/x"/>', "no package 'nopkg'"),
    "notext": ('<param name="x" textfile="/no/file"/>', "/no/file: no such file or directory"),
    "badcmd": ('<param name="x" command="/no/such/cmd"/>', "cannot run '/no/such/cmd'"),
    "failcmd": ('<param name="x" command="false"/>', "the command ended with code 1"),
    "badif": ('<param name="x" value="1" if="maybe"/>', "'maybe' is neither true nor false"),
    "bothif": ('<param name="x" value="1" if="1" unless="0"/>', "'if' and 'unless' exclude each other"),
    "badsub": ('<param name="x" value="$(foo bar)"/>', r"unknown substitution \$\(foo bar\)"),
    "noenv": ('<param name="x" value="$(env NOT_SET)"/>', "environment variable 'NOT_SET' is not set"),
    "badeval": ('<param name="x" value="$(eval 1 +)"/>', r"\$\(eval 1 \+\) is not valid: invalid syntax"),
    "eval2": (
        """<param name="x" value="$(eval __import__('os').getcwd())"/>""",
        "may not contain double underscores",
    ),
    "evalmid": ('<param name="x" value="a$(eval 1+1)"/>', r"\$\(eval\) must be the whole value"),
    "dupnode": (
        '<node pkg="rviz" type="rviz" name="t"/><node pkg="rviz" type="rviz" name="t"/>',
        "duplicate node /t; the first is at .*test.launch:1",
    ),
    "reqresp": (
        '<node pkg="rviz" type="rviz" name="t" required="true" respawn="true"/>',
        "respawn and required exclude each other",
    ),
    "incnofile": ('<include file="/no/file.launch"/>', "/no/file.launch: no such file or directory"),
    "badyaml": ("<rosparam>{a: [1}</rosparam>", "not YAML: .*expected ',' or ']', but got '}'"),
    "scalar": ("<rosparam>3</rosparam>", "expected names with values"),
    "plainattr": ('<node pkg="rviz" type="rviz" name="a/b"/>', "cannot hold a namespace"),
    "badout": ('<node pkg="rviz" type="rviz" name="a" output="both"/>', "output is one of log, screen, not 'both'"),
    "machine": ('<machine name="m" address="far"/>', "there are no other machines here"),
}


def test_a_misspelt_argument_is_named_where_the_one_that_was_meant_is_missing(workspace: Workspace) -> None:
    file = workspace.launch_file('<arg name="speed"/>')
    with pytest.raises(BadFile, match="'speed' is required") as caught:
        loader.load(files.find([str(file)], workspace.packages), {"sped": "3", "other": "1"})
    assert caught.value.hint == "give speed:=VALUE; was sped:=3 meant to be that?"


def read_wholly(workspace: Workspace, content: str) -> None:
    """Everything that happens before something is started."""
    plan = workspace.plan(content)
    node_kinds.tasks(plan, workspace.packages)
    plan.parameters()


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_real_one_refuses_is_refused_with_the_place(workspace: Workspace, name: str) -> None:
    content, text = REFUSED[name]
    with pytest.raises(SlidectlError, match=text) as caught:
        read_wholly(workspace, content)
    assert re.match(r"demo/launch/test.launch:1: ", str(caught.value)), caught.value
    assert caught.value.exit_code == 2


def test_a_package_that_is_not_there_says_where_was_looked(workspace: Workspace) -> None:
    with pytest.raises(
        SlidectlError, match=r"no package 'nopkg'.*\nlooked in: .* and the folders above it; the packages shipped"
    ):
        workspace.plan('<param name="x" value="$(find nopkg)"/>')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<launch><param name="x" value="1"></launch>', "test.launch:1: not well-formed XML: mismatched tag"),
        ("<nope/>", "test.launch:1: <nope>: the root of a launch file is <launch>"),
        ("", "test.launch:1: not well-formed XML: no element found"),
        ('<!DOCTYPE l [<!ENTITY a "b">]><launch/>', "declares the XML entity 'a'"),
    ],
)
def test_xml_that_is_none_is_refused_with_its_line(workspace: Workspace, text: str, message: str) -> None:
    with pytest.raises(SlidectlError, match=message):
        workspace.load(workspace.write("launch/test.launch", text))


def test_what_the_real_one_warns_of_is_pointed_out_with_the_place(workspace: Workspace) -> None:
    text = '\n<param name="x" value="1" bogus="2"/>\n<frobnicate/>\n<parm name="y" value="1"/>'
    assert notices(workspace.plan(text)) == [
        "demo/launch/test.launch:2: <param name=\"x\">: attribute 'bogus' is unknown and has no effect",
        "demo/launch/test.launch:3: <frobnicate>: is unknown in <launch> and has no effect",
        'demo/launch/test.launch:4: <parm name="y">: is unknown in <launch> and has no effect; did you mean <param>?',
    ]
    path = workspace.write("launch/test.launch", '<launch if="false"><param name="x" value="1"/></launch>')
    plan = workspace.load(path)
    assert list(plan.parameters()) == ["/x"]
    assert "attribute 'if' is unknown" in notices(plan)[0]
    path = workspace.write("launch/test.launch", '<launch deprecated="use all.launch"/>')
    assert "is deprecated: use all.launch" in notices(workspace.load(path))[0]
    assert "is not run" in notices(workspace.plan('<test test-name="t" pkg="a" type="b"/>'))[0]
    assert "obsolete" in notices(workspace.plan('<master auto="start"/>'))[0]
