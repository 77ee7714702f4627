"""Arguments, conditions, groups, includes: what is seen where, and what goes wrong in them."""

from __future__ import annotations

import pytest
from launch_files import Workspace, notices

from slidectl.errors import BadFile, UsageError
from slidectl.extensions.launch import files, loader


def test_a_default_can_be_overridden_and_a_value_cannot(workspace: Workspace) -> None:
    content = '<arg name="a" default="1"/><arg name="b" value="2"/><param name="x" value="$(arg a)$(arg b)"/>'
    assert workspace.values(content) == {"/x": 12}
    assert workspace.values(content, a="7") == {"/x": 72}
    with pytest.raises(BadFile, match="the argument 'b' is constant and cannot be given"):
        workspace.plan(content, b="7")


def test_an_unknown_argument_on_the_command_line_is_an_error_with_the_closest(workspace: Workspace) -> None:
    with pytest.raises(UsageError, match=r"no argument 'pased' in .*test.launch. Did you mean 'paused'\?") as caught:
        workspace.plan('<arg name="paused" default="0"/><arg name="gui" default="0"/>', pased="1")
    assert "arguments: gui, paused" in str(caught.value)
    assert caught.value.exit_code == 2


def test_an_argument_of_a_group_can_be_given_from_outside(workspace: Workspace) -> None:
    content = '<group><arg name="side" default="left"/><param name="x" value="$(arg side)"/></group>'
    assert workspace.values(content, side="right") == {"/x": "right"}


def test_an_argument_given_twice_to_an_include_is_an_error(workspace: Workspace) -> None:
    workspace.launch_file('<arg name="a"/>', "inner.launch")
    with pytest.raises(BadFile, match=r"test.launch:1: <arg>: the argument 'a' is given twice"):
        workspace.plan(
            '<include file="$(dirname)/inner.launch"><arg name="a" value="1"/><arg name="a" value="2"/></include>'
        )


def test_of_several_remaps_of_a_name_the_last_counts(workspace: Workspace) -> None:
    node = workspace.node(
        '<remap from="a" to="b"/><remap from="x" to="y"/><remap from="a" to="c"/>'
        '<node pkg="demo" type="t" name="n"><remap from="x" to="z"/></node>'
    )
    assert [(remap.source, remap.target) for remap in node.remaps] == [("a", "c"), ("x", "z")]
    assert node.resolve("a") == "/c"


def test_several_files_share_the_arguments_of_the_command_line(workspace: Workspace) -> None:
    one = workspace.launch_file('<arg name="a"/><param name="one" value="$(arg a)"/>', "one.launch")
    two = workspace.launch_file('<arg name="b"/><param name="two" value="$(arg b)"/>', "two.launch")
    sources = [*files.find([str(one)], workspace.packages), *files.find([str(two)], workspace.packages)]
    plan = loader.load(sources, {"a": "1", "b": "2"}, workspace.packages)
    assert {name: value for name, (value, _) in plan.parameters().items()} == {"/one": 1, "/two": 2}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ('<arg name="a" default="1"/><arg name="a" default="2"/>', "the argument 'a' is declared twice"),
        ('<arg name="a" value="1"/><group><arg name="a" value="2"/></group>', "the argument 'a' is declared twice"),
        ('<arg name="a" default="1" value="2"/>', "'value' and 'default' exclude each other"),
        ("<arg/>", "the attribute 'name' is missing"),
        ('<param name="" value="1"/>', "the attribute 'name' is empty"),
        ('<group ns="a b"/>', "'a b' is not a legal name here"),
        ('<group clear_params="true"/>', "clear_params needs an ns"),
        ('<group clear_params="perhaps" ns="a"/>', "clear_params: 'perhaps' is neither true nor false"),
        ('<remap from="a"/>', "the attribute 'to' is missing"),
        ('<remap from="a b" to="c"/>', "from: 'a b' is not a legal name"),
        ('<remap from="a" to="2c"/>', "to: '2c' is not a legal name"),
        ('<param nam="a" value="1"/>', r"the attribute 'name' is missing \('nam' is there: did you mean 'name'\?\)"),
        ('<param name="a" valu="1"/>', r"a needs .* none is there \('valu' is there: did you mean 'value'\?\)"),
        ('<env name="a"/>', "the attribute 'value' is missing"),
        ('<env name="a=b" value="c"/>', "'a=b' cannot be the name of an environment variable"),
        ("<include/>", "the attribute 'file' is missing"),
    ],
)
def test_attributes_that_make_no_sense_are_refused_with_the_place(
    workspace: Workspace, content: str, reason: str
) -> None:
    with pytest.raises(BadFile, match=rf"test.launch:1: <\w+>: {reason}"):
        workspace.plan(content)


@pytest.mark.parametrize(
    ("condition", "applies"),
    [('if="1"', True), ('if="true"', True), ('if="True"', True), ('if="0"', False), ('if="false"', False),
     ('unless="0"', True), ('unless="$(arg on)"', False), ('if="$(eval on and 2 > 1)"', True)],
)  # fmt: skip
@pytest.mark.parametrize("tag", ["param", "group", "node", "include", "arg", "rosparam", "remap"])
def test_every_tag_takes_a_condition(workspace: Workspace, condition: str, applies: bool, tag: str) -> None:
    workspace.launch_file('<param name="x" value="1"/>', "inner.launch")
    tags = {
        "param": f'<param name="x" value="1" {condition}/>',
        "group": f'<group {condition}><param name="x" value="1"/></group>',
        "node": f'<node pkg="rviz" type="rviz" name="n" {condition}><param name="x" value="1"/></node>',
        "include": f'<include file="$(dirname)/inner.launch" {condition}/>',
        "arg": f'<arg name="a" value="1" {condition}/><param name="x" value="$(eval arg(\'a\'))" {condition}/>',
        "rosparam": f"<rosparam {condition}>x: 1</rosparam>",
        "remap": f'<remap from="a" to="b" {condition}/><node pkg="rviz" type="rviz" name="n"/>',
    }
    plan = workspace.plan(f'<arg name="on" default="true"/>{tags[tag]}')
    found = bool(plan.nodes[0].remaps) if tag == "remap" else bool(plan.parameters())
    assert found is applies


def test_what_does_not_apply_is_not_looked_into(workspace: Workspace) -> None:
    plan = workspace.plan(
        '<include file="/no/such.launch" if="false"/><node pkg="a" type="b" name="$(arg nope)" unless="1"/>'
        '<machine name="m" address="far" if="0"/>'
    )
    assert plan.nodes == []


def test_namespaces_nest_and_absolute_ones_begin_anew(workspace: Workspace) -> None:
    plan = workspace.plan(
        """<group ns="a">
        <group ns="b/c"><param name="x" value="1"/><node pkg="rviz" type="rviz" name="n" ns="d"/></group>
        <group ns="/top"><param name="x" value="2"/></group><param name="/root" value="3"/>
        <node pkg="rviz" type="rviz" name="m" ns="/slider"/></group>"""
    )
    assert set(plan.parameters()) == {"/a/b/c/x", "/top/x", "/root"}
    assert [node.full_name for node in plan.nodes] == ["/a/b/c/d/n", "/slider/m"]


def test_remaps_environment_and_private_parameters_hold_for_later_nodes_of_their_group(workspace: Workspace) -> None:
    plan = workspace.plan(
        """<node pkg="rviz" type="rviz" name="before"/>
        <group><remap from="a" to="b"/><env name="E" value="1"/><param name="~p" value="1"/>
          <node pkg="rviz" type="rviz" name="inside"><remap from="c" to="d"/><param name="~own" value="2"/></node>
          <group><param name="~p" value="9"/><node pkg="rviz" type="rviz" name="deeper"/></group>
          <node pkg="rviz" type="rviz" name="next"/></group>
        <node pkg="rviz" type="rviz" name="after"/>"""
    )
    remaps = {node.name: [(remap.source, remap.target) for remap in node.remaps] for node in plan.nodes}
    assert remaps == {"before": [], "inside": [("a", "b"), ("c", "d")], "deeper": [("a", "b")], "next": [("a", "b")],
                      "after": []}  # fmt: skip
    assert [node.name for node in plan.nodes if node.environment] == ["inside", "deeper", "next"]
    values = {name: value for name, (value, _) in plan.parameters().items()}
    assert values == {"/inside/p": 1, "/inside/own": 2, "/deeper/p": 9, "/next/p": 1}


def test_an_include_passes_what_it_says_and_nothing_else(workspace: Workspace) -> None:
    workspace.launch_file(
        '<arg name="a"/><arg name="b" default="0"/><param name="x" value="$(arg a)$(arg b)"/>', "inner.launch"
    )
    include = '<arg name="b" default="5"/><include file="$(dirname)/inner.launch" ns="{ns}">{args}</include>'
    assert workspace.values(include.format(ns="in", args='<arg name="a" value="1"/>')) == {"/in/x": 10}
    given = '<arg name="a" value="1"/><arg name="b" value="$(arg b)"/>'
    assert workspace.values(include.format(ns="/", args=given)) == {"/x": 15}
    with pytest.raises(BadFile, match=r"inner.launch:1: <arg>: the included file requires the argument 'a'") as caught:
        workspace.plan(include.format(ns="in", args=""))
    assert "included from demo/launch/test.launch:1" in str(caught.value)
    with pytest.raises(BadFile, match=r"test.launch:1: <arg>: no argument 'aa' in .*inner.launch. Did you mean 'a'\?"):
        workspace.plan(include.format(ns="in", args='<arg name="a" value="1"/><arg name="aa" value="2"/>'))


def test_pass_all_args_passes_all_and_forgives_what_is_not_wanted(workspace: Workspace) -> None:
    workspace.launch_file(
        '<arg name="a"/><arg name="c" value="3"/><param name="x" value="$(arg a)$(arg c)"/>', "in.launch"
    )
    content = '<arg name="a" default="1"/><arg name="b" default="2"/><arg name="c" default="9"/>{}'
    include = '<include file="$(dirname)/in.launch" pass_all_args="true">{}</include>'
    assert workspace.values(content.format(include.format(""))) == {"/x": 13}
    assert workspace.values(content.format(include.format('<arg name="a" value="7"/>'))) == {"/x": 73}
    assert workspace.values(content.format(include.format('<arg name="z" value="7"/>'))) == {"/x": 13}


def test_pass_all_args_passes_on_what_an_include_of_an_include_needs(workspace: Workspace) -> None:
    all_args = '<include file="$(dirname)/{}.launch" pass_all_args="true">{}</include>'
    workspace.launch_file('<param name="p" value="$(arg t)"/>', "inner.launch")
    workspace.launch_file(all_args.format("inner", ""), "middle.launch")
    content = '<arg name="t" default="x"/>'
    assert workspace.values(content + all_args.format("middle", "")) == {"/p": "x"}
    assert workspace.values(content + all_args.format("middle", '<arg name="t" value="y"/>')) == {"/p": "y"}
    assert workspace.values(content + all_args.format("middle", '<arg name="t" default="y"/>')) == {"/p": "x"}
    assert workspace.values(all_args.format("middle", '<arg name="t" default="y"/>')) == {"/p": "y"}
    workspace.launch_file('<include file="$(dirname)/inner.launch"/>', "middle.launch")
    with pytest.raises(BadFile, match="there is no argument 't' here"):
        workspace.plan(content + all_args.format("middle", ""))


def test_an_arg_that_the_included_file_uses_and_does_not_declare_is_refused_at_the_include(
    workspace: Workspace,
) -> None:
    workspace.launch_file('<param name="p" value="$(arg t)"/>', "inner.launch")
    with pytest.raises(BadFile, match=r"test.launch:1: <arg>: no argument 't' in .*inner.launch"):
        workspace.plan('<include file="$(dirname)/inner.launch"><arg name="t" value="3"/></include>')
    with pytest.raises(UsageError, match=r"no argument 't' in .*test.launch"):
        workspace.plan('<param name="p" value="$(arg t)"/>', t="3")


def test_groups_beside_each_other_may_have_args_of_one_name(workspace: Workspace) -> None:
    group = '<group><arg name="a" default="{0}"/><param name="p{0}" value="$(arg a)"/></group>'
    content = group.format(1) + group.format(2)
    assert workspace.values(content) == {"/p1": 1, "/p2": 2}
    assert workspace.load(workspace.launch_file(content), a="7").parameters()["/p2"][0] == 7
    workspace.launch_file(content, "inner.launch")
    with pytest.raises(BadFile, match="no argument 'a'"):
        workspace.plan('<include file="$(dirname)/inner.launch"><arg name="a" value="1"/></include>')
    with pytest.raises(BadFile, match="declared twice"):
        workspace.plan('<arg name="a" default="1"/>' + content)


def test_the_surroundings_of_an_include_reach_into_it_and_nothing_comes_back(workspace: Workspace) -> None:
    workspace.launch_file(
        '<arg name="mine" value="1"/><remap from="x" to="y"/><node pkg="rviz" type="rviz" name="inside"/>',
        "inner.launch",
    )
    plan = workspace.plan(
        '<remap from="a" to="b"/><include file="$(dirname)/inner.launch"><env name="E" value="1"/></include>'
        '<node pkg="rviz" type="rviz" name="outside"/>'
    )
    inside, outside = plan.nodes
    assert [remap.source for remap in inside.remaps] == ["a", "x"]
    assert inside.environment == (("E", "1"),)
    assert [remap.source for remap in outside.remaps] == ["a"]
    assert outside.environment == ()
    with pytest.raises(BadFile, match="there is no argument 'mine' here"):
        workspace.plan('<include file="$(dirname)/inner.launch"/><param name="x" value="$(arg mine)"/>')


def test_a_file_that_includes_itself_is_refused_and_one_that_counts_down_is_not(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match=r"test.launch includes itself"):
        workspace.plan('<include file="$(dirname)/test.launch"/>')
    workspace.launch_file('<include file="$(dirname)/test.launch"/>', "other.launch")
    with pytest.raises(BadFile, match=r"includes itself"):
        workspace.plan('<include file="$(dirname)/other.launch"/>')
    plan = workspace.plan(
        '<arg name="n" default="3"/><param name="p$(arg n)" value="1"/>'
        '<include file="$(dirname)/test.launch" if="$(eval n > 0)"><arg name="n" value="$(eval n - 1)"/></include>'
    )
    assert set(plan.parameters()) == {"/p3", "/p2", "/p1", "/p0"}


def test_includes_without_an_end_are_refused_however_they_change_their_arguments(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match="nested deeper than"):
        workspace.plan(
            '<arg name="n" default="0"/>'
            '<include file="$(dirname)/test.launch"><arg name="n" value="$(eval n + 1)"/></include>'
        )
    twice = '<include file="$(dirname)/test.launch"><arg name="n" value="$(eval n + 1)"/></include>'
    with pytest.raises(BadFile, match="expands to more than"):
        workspace.plan(f'<arg name="n" default="0"/><group if="$(eval n &lt; 40)">{twice}{twice}</group>')


def test_clear_params_of_groups_includes_and_nodes_are_kept_in_order(workspace: Workspace) -> None:
    workspace.launch_file("", "inner.launch")
    plan = workspace.plan(
        '<group ns="g" clear_params="true"><node pkg="rviz" type="rviz" name="n" clear_params="true"/></group>'
        '<include file="$(dirname)/inner.launch" ns="i" clear_params="true"/>'
    )
    assert [namespace for namespace, _ in plan.clear] == ["/g", "/g/n", "/i"]


def test_an_include_is_found_from_the_working_folder_only(workspace: Workspace) -> None:
    workspace.launch_file('<param name="x" value="1"/>', "inner.launch")
    with pytest.raises(BadFile) as caught:
        workspace.values('<include file="inner.launch"/>')
    assert 'there is one beside this file: file="$(dirname)/inner.launch"' in str(caught.value)
    (workspace.folder / "inner.launch").write_text('<launch><param name="x" value="2"/></launch>')
    assert workspace.values('<include file="inner.launch"/>') == {"/x": 2}


def test_nothing_is_said_about_files_that_are_right(workspace: Workspace) -> None:
    plan = workspace.plan(
        '<arg name="a" default="1" doc="one"/><group ns="g"><param name="x" value="$(arg a)"/></group>'
    )
    assert notices(plan) == []
