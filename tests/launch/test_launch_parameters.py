"""Parameters: their types, their sources, and those that get in each other's way."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from launch_files import Workspace, notices

from slidectl.description import source_note
from slidectl.errors import BadFile


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ('value="10"', 10),
        ('value="-3"', -3),
        ('value="1.0"', 1.0),
        ('value="1.5e3"', 1500.0),
        ('value="1e3"', "1e3"),
        ('value="1_000"', "1_000"),
        ('value="true"', True),
        ('value="False"', False),
        ('value="yes"', "yes"),
        ('value=""', ""),
        ('value="a b"', "a b"),
        ('value="1.2.3"', "1.2.3"),
        ('value="10" type="str"', "10"),
        ('value="10" type="string"', "10"),
        ('value="10" type="double"', 10.0),
        ('value="10" type="INT"', 10),
        ('value="1" type="bool"', True),
        ('value="0" type="boolean"', False),
        ('value="[1, {a: b}]" type="yaml"', [1, {"a": "b"}]),
        ('value="deg(90)" type="yaml"', pytest.approx(1.57079633)),
        ('value="{a: {b: 1}}" type="yaml"', {"a": {"b": 1}}),
    ],
)
def test_a_value_is_typed_as_roslaunch_types_it(workspace: Workspace, attributes: str, expected: Any) -> None:
    found = workspace.values(f'<param name="x" {attributes}/>')
    if expected is None:
        assert found == {"/x/a/b": 1}
        return
    assert found["/x"] == expected
    assert isinstance(found["/x"], type(expected)) or not isinstance(expected, bool | int | float | str)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ('<param name="x"/>', "x needs exactly one of value, textfile, binfile, command, and none is there"),
        ('<param name="x" value="1" command="true"/>', "x needs exactly one of .*, not 2 of them"),
        ('<param name="x" value="a" type="int"/>', "its value is not of type int"),
        ('<param name="x" value="a" type="double"/>', "its value is not of type double"),
        ('<param name="x" value="nan" type="double"/>', "its value is nan, and parameters hold only finite numbers"),
        ('<param name="x" value="1.0e999"/>', "its value is inf, and parameters hold only finite numbers"),
        (
            '<param name="x" value="maybe" type="bool"/>',
            "its value is not of type bool: 'maybe' is neither true nor false",
        ),
        ('<param name="x" value="[1" type="yaml"/>', "its value is not YAML"),
        ('<param name="x" value="" type="yaml"/>', "its value is empty"),
        ('<param name="x" value="1" type="complex"/>', "unknown type 'complex'; known: auto, str"),
        ('<param name="a b" value="1"/>', "'a b' is not a legal name here"),
        ('<param name="x" command=""/>', "the attribute 'command' is empty"),
        ('<param name="x" command="echo \'a"/>', "command: no closing quotation"),
        ('<rosparam command="delete"/>', "delete needs a param or an ns"),
        ('<rosparam command="dump" param="a"/>', "the attribute 'file' is missing"),
        ('<rosparam command="lod" file="x"/>', "unknown command 'lod'; known: load, dump, delete"),
        ('<rosparam file="">a: 1</rosparam>', "the attribute 'file' is empty"),
        ('<rosparam command="delete" param="a" file="x"/>', "delete takes no file"),
        ('<rosparam param="/">1</rosparam>', "expected names with values"),
        ('<param name="/" value="1"/>', "'/' is not a parameter name"),
        ('<rosparam file="/no/such.yaml"/>', "/no/such.yaml: no such file or directory"),
    ],
)
def test_what_no_parameter_can_be_is_refused_with_the_place(workspace: Workspace, content: str, reason: str) -> None:
    with pytest.raises(BadFile, match=rf"test.launch:1: <\w+>: {reason}"):
        workspace.plan(content).parameters()


def test_yaml_in_the_file_has_the_lines_of_the_file(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match=r"test.launch:4: 'b' has no value"):
        workspace.values("\n<rosparam>\n  a: 1\n  b:\n</rosparam>")
    plan = workspace.plan("\n<rosparam>\n  a: 1\n  a: 2\n</rosparam>")
    assert plan.parameters()["/a"][0] == 2
    assert notices(plan)[0].startswith("demo/launch/test.launch:4: a: duplicate key")


def test_files_give_text_bytes_and_trees(workspace: Workspace) -> None:
    workspace.write("a.txt", "größe\n")
    workspace.write("p.yaml", "pid: {p: 1.0, i: 0.5}\nlist: [a]\n")
    found = workspace.values(
        '<param name="t" textfile="$(find demo)/a.txt"/><param name="b" binfile="$(find demo)/a.txt"/>'
        '<rosparam file="$(find demo)/p.yaml" ns="left"/>'
    )
    assert found == {"/t": "größe\n", "/b": "Z3LDtsOfZQo=", "/left/pid/p": 1.0, "/left/pid/i": 0.5, "/left/list": ["a"]}


def test_a_list_or_a_single_value_needs_a_name(workspace: Workspace) -> None:
    assert workspace.values('<rosparam param="l">[1, two]</rosparam>') == {"/l": [1, "two"]}
    assert workspace.values('<rosparam param="x" ns="a">3</rosparam>') == {"/a/x": 3}
    assert workspace.values('<rosparam param="x">{a: 1}</rosparam>') == {"/x/a": 1}
    with pytest.raises(BadFile, match="expected names with values"):
        workspace.values("<rosparam>[1, 2]</rosparam>")


def test_later_parameters_replace_earlier_ones_and_trees_are_merged(workspace: Workspace) -> None:
    content = '<rosparam>a: {x: 1, y: 1}</rosparam><rosparam>a: {y: 2, z: 2}</rosparam><param name="a/z" value="3"/>'
    assert workspace.values(content) == {"/a/x": 1, "/a/y": 2, "/a/z": 3}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ('<param name="a" value="1"/><param name="a/b" value="2"/>', {"/a/b": 2}),
        ('<param name="a/b" value="2"/><param name="a" value="1"/>', {"/a": 1}),
        ('<param name="a" value="1"/><param name="a/b" value="2"/><param name="a" value="3"/>', {"/a/b": 2}),
        ('<param name="a/b" value="2"/><param name="a" value="{c: 1}" type="yaml"/>', {"/a": {"c": 1}}),
    ],
)
def test_of_a_value_and_names_below_it_the_later_one_counts_and_a_notice_says_so(
    workspace: Workspace, content: str, expected: dict[str, Any]
) -> None:
    plan = workspace.plan(content)
    assert {name: value for name, (value, _) in plan.parameters().items()} == expected
    [notice] = notices(plan)
    assert "conflicts with /a" in notice


def test_a_mapping_as_one_value_has_room_for_names_below_it(workspace: Workspace) -> None:
    content = '<param name="a" value="{c: 1}" type="yaml"/><param name="a/b" value="2"/>'
    assert workspace.values(content) == {"/a": {"c": 1}, "/a/b": 2}


@pytest.mark.parametrize("content", ["a: {}", "{}", "a: {b: {}}", "null", ""])
def test_empty_mappings_in_a_rosparam_set_nothing(workspace: Workspace, content: str) -> None:
    assert workspace.values(f'<rosparam param="x">{content}</rosparam>') == {}
    if content != "null":
        assert workspace.values(f"<rosparam>{content}</rosparam>") == {}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("x: {/a: 1, b: 2}", {"/a": 1, "/n/x/b": 2}),
        ("/a/b: {c: 1}", {"/a/b/c": 1}),
        ("/: {c: 1}", {"/c": 1}),
        ("a//b/: 1", {"/n/a/b": 1}),
        ("_ns: q", {"/n/_ns": "q"}),
        ("a: deg(180)\nb: deg(1) + deg(2)", {"/n/a": pytest.approx(3.14159265), "/n/b": "deg(1) + deg(2)"}),
    ],
)
def test_names_and_values_in_a_rosparam(workspace: Workspace, content: str, expected: dict[str, Any]) -> None:
    assert workspace.values(f'<rosparam ns="n">{content}</rosparam>') == expected
    workspace.write("p.yaml", content)
    assert workspace.values('<rosparam ns="n" file="$(find demo)/p.yaml"/>') == expected


def test_the_text_of_a_rosparam_can_be_one_expression(workspace: Workspace) -> None:
    assert workspace.values('\n<rosparam subst_value="true">$(eval {"a": 1 + 1})</rosparam>') == {"/a": 2}


def test_a_rosparam_holds_one_document(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match=r"test.launch:4: a second document, where there can be only one"):
        workspace.values("<rosparam>\na: 1\n---\nb: 2</rosparam>")


def test_of_a_file_and_a_text_the_file_counts(workspace: Workspace) -> None:
    workspace.write("p.yaml", "a: 1\n")
    plan = workspace.plan('<rosparam file="$(find demo)/p.yaml">b: 2</rosparam>')
    assert list(plan.parameters()) == ["/a"]
    assert "the text is ignored" in notices(plan)[0]


def test_an_empty_rosparam_is_pointed_out(workspace: Workspace) -> None:
    plan = workspace.plan("<rosparam/>")
    assert plan.parameters() == {}
    assert "holds no parameters" in notices(plan)[0]


def test_a_nodes_own_parameters_are_below_it(workspace: Workspace) -> None:
    content = """<group ns="g"><node pkg="rviz" type="rviz" name="n">
      <param name="a" value="1"/><param name="~b" value="2"/><param name="/c" value="3"/>
      <rosparam param="d" ns="e">4</rosparam><rosparam>f: 5</rosparam></node></group>"""
    values = {f"/g/n/{key}": value for key, value in {"a": 1, "b": 2, "c": 3, "e/d": 4, "f": 5}.items()}
    assert workspace.values(content) == values


@pytest.mark.parametrize(
    ("around", "inside", "expected"),
    [
        ("", '<param name="q" value="1"/><rosparam>q: 2</rosparam>', 1),
        ("", '<rosparam>q: 2</rosparam><param name="q" value="1"/>', 1),
        ('<param name="~q" value="0"/>', "<rosparam>q: 2</rosparam>", 0),
        ('<param name="~q" value="0"/>', '<param name="q" value="1"/><rosparam>q: 2</rosparam>', 1),
        ('<param name="n/q" value="3"/>', "<rosparam>q: 2</rosparam>", 2),
    ],
)
def test_in_a_node_a_param_counts_more_than_one_from_around_and_that_more_than_a_rosparam(
    workspace: Workspace, around: str, inside: str, expected: int
) -> None:
    assert workspace.values(f'{around}<node pkg="rviz" type="rviz" name="n">{inside}</node>') == {"/n/q": expected}


def test_rosparam_commands_are_kept_for_before_the_parameters(workspace: Workspace) -> None:
    plan = workspace.plan(
        '<group ns="g"><rosparam command="delete" param="old"/><rosparam command="dump" file="/tmp/x.yaml"/></group>'
        '<rosparam command="delete" ns="all"/>'
    )
    assert [(command.verb, command.name, command.file) for command in plan.commands] == [
        ("delete", "/g/old", ""),
        ("dump", "/g", "/tmp/x.yaml"),
        ("delete", "/all", ""),
    ]


def test_nothing_is_read_or_run_before_the_values_are_asked_for(workspace: Workspace) -> None:
    mark = workspace.folder / "ran"
    plan = workspace.plan(f'<param name="x" command="touch {mark}"/><rosparam file="/no/such.yaml"/>')
    assert not mark.exists()
    with pytest.raises(BadFile):
        plan.parameters()
    assert mark.exists()


def test_a_command_gives_its_output_as_it_is(workspace: Workspace) -> None:
    found = workspace.values(
        """<param name="x" command="printf '%s|' one 'two words' $HOME"/><param name="n" command="echo 5" type="int"/>
        <param name="y" command="echo '{a: [1, 2]}'" type="yaml"/>"""
    )
    assert found == {"/x": "one|two words|$HOME|", "/n": 5, "/y": {"a": [1, 2]}}


def test_texts_of_files_and_commands_are_typed_as_values_are_and_only_values_lose_their_blanks(
    workspace: Workspace,
) -> None:
    workspace.write("n.txt", " 1.5\r\n")
    (workspace.package / "t.txt").write_bytes(b" a\r\nb\r")
    found = workspace.values(
        """<param name="n" textfile="$(find demo)/n.txt"/><param name="t" textfile="$(find demo)/t.txt"/>
        <param name="c" command="echo 5"/><param name="s" command="echo 5" type="str"/>
        <param name="b" command="echo true"/>
        <param name="v" value=" true "/><param name="w" type="str" value=" 1 "/>"""
    )
    assert found == {"/n": 1.5, "/t": " a\nb\n", "/c": 5, "/s": "5\n", "/b": "true\n", "/v": True, "/w": "1"}


def test_commands_can_be_refused_but_not_our_own_xacro(workspace: Workspace) -> None:
    path = workspace.launch_file('<param name="x" command="echo 1"/>')
    with pytest.raises(BadFile, match=r"runs the program 'echo'\nthat is refused by --no-commands"):
        workspace.load(path, run_commands=False)
    model = '<param name="x" command="$(find xacro)/xacro $(find my_slider)/urdf/slider.xacro"/>'
    plan = workspace.load(workspace.launch_file(model), run_commands=False)
    assert "<robot" in plan.parameters()["/x"][0]
    assert not plan.settings[0].runs_command


def test_an_argument_that_the_model_does_not_have_is_pointed_out_at_the_command(workspace: Workspace) -> None:
    plan = workspace.plan('\n<param name="x" command="xacro $(find my_slider)/urdf/slider.xacro namspace:=/left"/>')
    plan.parameters()
    (notice,) = [notice for notice in plan.notices if notice.subject == "namspace:="]
    assert (Path(notice.file).name, notice.line) == ("test.launch", 2)
    assert "no such argument" in notice.text
    assert "slider.xacro" in notice.text


@pytest.mark.parametrize(
    "command",
    [
        "$(find xacro)/xacro --inorder '$(arg file)' namespace:=/left",
        "$(find xacro)/xacro.py $(arg file) namespace:=/left",
        "python3 $(find xacro)/xacro.py $(arg file) namespace:=/left",
        "xacro -i $(arg file) namespace:=/left",
        "rosrun xacro xacro $(arg file) namespace:=/left",
        "/opt/ros/noetic/bin/xacro --inorder $(arg file) namespace:=/left",
    ],
)
def test_xacro_runs_by_our_own_however_it_is_called(workspace: Workspace, command: str) -> None:
    content = f'<arg name="file" value="$(find my_slider)/urdf/slider.xacro"/><param name="x" command="{command}"/>'
    xml = workspace.values(content)["/x"]
    assert "<robotNamespace>/left</robotNamespace>" in xml
    assert "xacro:" not in xml


def test_an_argument_of_xacro_without_a_value_leaves_the_default_of_the_model(workspace: Workspace) -> None:
    declared = '<robot name="r" xmlns:xacro="x"><xacro:arg name="limited" default="true"/>'
    workspace.write("urdf/limits.xacro", f'{declared}<link name="$(arg limited)"/></robot>')
    for words, link in (("limited:=", "true"), ("'limited := '", "true"), ("'limited := no'", "no")):
        plan = workspace.plan(f"""<param name="x" command="xacro $(find demo)/urdf/limits.xacro {words}"/>""")
        assert f'<link name="{link}"/>' in str(plan.parameters()["/x"][0])
        told = [notice.text for notice in plan.notices if "has no value: the model's default is used" in notice.text]
        assert bool(told) is (link == "true")


def test_what_xacro_takes_for_a_parameter_of_a_node_is_no_argument(workspace: Workspace) -> None:
    plan = workspace.plan('<param name="x" command="xacro $(find my_slider)/urdf/slider.xacro _namespace:=/left"/>')
    assert "<robotNamespace>/slider</robotNamespace>" in str(plan.parameters()["/x"][0])
    with pytest.raises(BadFile, match="'a:=b:=c' assigns twice"):
        workspace.plan('<param name="x" command="xacro $(find my_slider)/urdf/slider.xacro a:=b:=c"/>')


@pytest.mark.parametrize("name", ["xacro", "xacro.py"])
def test_xacro_is_a_program_that_can_be_called_by_its_path(workspace: Workspace, name: str) -> None:
    path = workspace.value(f"$(find xacro)/{name}")
    assert os.access(path, os.X_OK)
    model = "$(find my_slider)/urdf/slider.xacro namespace:=/left"
    called, ours = (
        workspace.values(f'<param name="x" command="{command} {model}"/>')["/x"]
        for command in (f"env PATH=/usr/bin:/bin $(find xacro)/{name}", "xacro")
    )
    assert called == source_note.split(ours)[0]
    assert "/left" in called


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("/no/such.xacro", "xacro: no such file: /no/such.xacro"),
        ("--frobnicate $(find my_slider)/urdf/slider.xacro", "xacro's option '--frobnicate' is not understood here"),
        ("a b", "xacro takes one file, not 2"),
        ("", "xacro takes one file, not 0"),
    ],
)
def test_a_call_of_xacro_that_makes_no_sense_is_refused_when_it_is_read(
    workspace: Workspace, words: str, reason: str
) -> None:
    with pytest.raises(BadFile, match=rf"test.launch:1: <param>: {reason}"):
        workspace.plan(f'<param name="x" command="$(find xacro)/xacro {words}"/>')


def test_a_fault_in_the_model_has_the_models_place_and_an_unused_argument_is_pointed_out(workspace: Workspace) -> None:
    workspace.write("urdf/bad.xacro", '<robot name="r" xmlns:xacro="x">\n<link name="${nope}"/>\n</robot>')
    with pytest.raises(BadFile, match=r"urdf/bad.xacro:2: .*nope"):
        workspace.values('<param name="x" command="$(find xacro)/xacro $(find demo)/urdf/bad.xacro"/>')
    plan = workspace.plan(
        '<param name="x" command="$(find xacro)/xacro $(find my_slider)/urdf/slider.xacro colour:=red"/>'
    )
    plan.parameters()
    assert "colour:=: the file has no such argument" in notices(plan)[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ('<rosparam command="delete"/>', "delete needs a param or an ns: this would delete all"),
        ('<rosparam command="delete" param="a" file="b"/>', "delete takes no file"),
        ("<rosparam>3</rosparam>", "a list or a single value needs param=NAME"),
        ("<rosparam>[1, 2]</rosparam>", "a list or a single value needs param=NAME"),
        ('<param name="a" value="0x10" type="int"/>', "its value is not of type int: '0x10'"),
        ('<param name="a" value="1,5" type="double"/>', "its value is not of type double: '1,5'"),
    ],
)
def test_what_is_wrong_with_a_parameter_is_said_in_the_words_of_the_file(
    workspace: Workspace, content: str, reason: str
) -> None:
    with pytest.raises(BadFile) as caught:
        workspace.plan(content).parameters()
    assert reason in str(caught.value)
    assert "test.launch:1" in str(caught.value)


def test_delete_in_a_group_means_the_groups_namespace(workspace: Workspace) -> None:
    [command] = workspace.plan('<group ns="arm"><rosparam command="delete"/></group>').commands
    assert (command.verb, command.name) == ("delete", "/arm")


@pytest.mark.parametrize("source", ["textfile", "binfile"])
def test_a_file_that_is_too_large_for_a_parameter_is_refused(workspace: Workspace, source: str) -> None:
    path = workspace.write("large", "")
    os.truncate(path, 40 * 2**30)  # a sparse file
    with pytest.raises(BadFile, match="large: is larger than 16 MiB"):
        workspace.plan(f'<param name="x" {source}="{path}"/>').parameters()


def test_a_command_that_prints_without_end_is_ended(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match=r"test.launch:1: <param>: the command prints more than 16 MiB"):
        workspace.plan('<param name="x" command="yes"/>').parameters()
