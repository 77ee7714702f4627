"""Launch files made at random: a plan or an error with its place, never anything else, and never without end."""

from __future__ import annotations

import string
import tempfile
from pathlib import Path

from hypothesis import example, given, settings
from hypothesis import strategies as st

from slidectl.description.missing import Missing
from slidectl.description.packages import Packages
from slidectl.errors import SlidectlError
from slidectl.extensions.launch import loader, node_kinds
from slidectl.extensions.launch.files import LaunchFile
from slidectl.extensions.launch.nodes.gazebo import read_world
from slidectl.extensions.launch.substitution import EvalError, evaluate

TAGS = ["launch", "arg", "param", "rosparam", "include", "group", "node", "remap", "env", "test", "machine", "master",
        "frob"]  # fmt: skip
ATTRIBUTES = [
    "name", "value", "default", "doc", "type", "command", "textfile", "binfile", "file", "ns", "if", "unless", "pkg",
    "args", "output", "respawn", "respawn_delay", "required", "cwd", "launch-prefix", "clear_params", "from", "to",
    "pass_all_args", "subst_value", "param", "bogus", "machine",
]  # fmt: skip
VALUES = [
    "a", "b", "/a/b", "~p", "1", "1.5", "true", "false", "$(arg a)", "$(eval 1+1)", "$(eval a)", "$(dirname)",
    "$(find my_slider)/urdf/slider.xacro", "$(env HOME)", "$(optenv NOPE x y)", "$(anon id)", "$(find nope)", "$(",
    "yaml", "auto", "load", "delete", "rviz", "gazebo_ros", "spawn_model", "controller_manager", "spawner", "screen",
    "-urdf -model m -param d", "'", "&lt;", "{a: [1", "$(eval 'x' * 3)", "--stopped a", "",
]  # fmt: skip

value = st.one_of(st.sampled_from(VALUES), st.text(string.printable, max_size=12))
attributes = st.dictionaries(st.sampled_from(ATTRIBUTES), value, max_size=5)


def escaped(text: str) -> str:
    clean = "".join(letter for letter in text if letter >= " " or letter in "\t\n")
    return clean.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def tag(name: str, given_attributes: dict[str, str], content: str) -> str:
    written = "".join(f' {key}="{escaped(text)}"' for key, text in given_attributes.items())
    return f"<{name}{written}>{content}</{name}>"


element = st.recursive(
    st.builds(tag, st.sampled_from(TAGS), attributes, st.one_of(st.just(""), value.map(escaped))),
    lambda inner: st.builds(tag, st.sampled_from(TAGS), attributes, st.lists(inner, max_size=4).map("".join)),
    max_leaves=12,
)


def plan_or_error(text: str) -> None:
    """Everything that happens before something is started."""
    path = Path("/tmp/fuzz.launch")
    source = LaunchFile(path, text.encode(), "fuzz.launch")
    try:
        plan = loader.load([source], {}, Packages(start="/"), run_commands=False, missing=Missing("all"))
        node_kinds.tasks(plan, Packages(start="/"))
        plan.parameters()
    except SlidectlError as error:
        said(error)


def said(error: Exception, file: str = "") -> None:
    """An error has something to say, and says where."""
    assert str(error)
    assert file in str(error)


@settings(max_examples=120)
@given(st.lists(element, max_size=6))
def test_tags_in_any_order_with_any_attributes(elements: list[str]) -> None:
    plan_or_error(f"<launch>{''.join(elements)}</launch>")


word = st.one_of(
    st.sampled_from(["-urdf", "-model", "m", "-param", "d", "-x", "1", "-J", "nan", "--stopped", "--timeout", "-b",
                     "-1", "--namespace", "a:=b", "list", "load", "switch", "worlds/empty.world", "-e", "--wait-for",
                     "/t", "--timeout=x", "=", "-", "--", "''", "spawn", "0", "1e400"]),
    st.text(string.printable, max_size=5),
)  # fmt: skip


@settings(max_examples=200)
@given(st.sampled_from(list(node_kinds.COUNTERPARTS)), st.lists(word, max_size=10))
def test_any_arguments_of_a_node_that_has_a_counterpart(kind: tuple[str, str], words: list[str]) -> None:
    given_attributes = {"pkg": kind[0], "type": kind[1], "name": "n", "args": " ".join(words)}
    plan_or_error(f"<launch>{tag('node', given_attributes, '')}</launch>")


@settings(max_examples=150)
@given(st.binary(max_size=200))
def test_bytes_that_are_no_launch_file(data: bytes) -> None:
    source = LaunchFile(Path("/tmp/fuzz.launch"), data, "fuzz.launch")
    try:
        loader.load([source], {}, Packages(start="/"), run_commands=False, missing=Missing("all"))
    except SlidectlError as error:
        said(error, "fuzz.launch")


@settings(max_examples=300)
@given(st.text(st.sampled_from("$()argevlfindo '\"+*/-.0123456789[]{},:=<>!&|^%~_ \n"), max_size=40))
@example("$(eval " + "(" * 90 + ")" * 90 + ")")
@example("$(eval [[x for x in [1]] for y in [1]])")
@example("$(eval {1: 2}[1])")
@example("$(eval '%(a)s' % {'a': 1})")
@example("$(eval -'a')")
@example("$(eval {[]: 1})")
def test_any_text_as_a_value(text: str) -> None:
    plan_or_error(f'<launch><arg name="a" value="1"/><param name="x" value="{escaped(text)}"/></launch>')


@settings(max_examples=300)
@given(st.text(st.sampled_from("abx 'ij\"+*/-.0123456789[](){},:=<>!&|^%~ orandnotifelsein\n"), max_size=40))
def test_any_expression(text: str) -> None:
    try:
        evaluate(text, {"a": 1, "b": "two"})
    except EvalError as error:
        said(error)


@settings(max_examples=200)
@given(st.text(st.sampled_from("ab:[]{}-#&*!|>'\"%@`, \n\t0123.~<?"), max_size=60))
def test_any_text_as_yaml(text: str) -> None:
    plan_or_error(f"<launch><rosparam>{escaped(text)}</rosparam></launch>")


world_tag = st.sampled_from(["gravity", "physics", "max_step_size", "real_time_factor", "real_time_update_rate",
                             "include", "uri", "model", "plugin", "light", "geometry", "plane"])  # fmt: skip
world_element = st.recursive(
    st.builds(lambda name, text: tag(name, {}, escaped(text)), world_tag, st.one_of(value, st.just("0 0 -1"))),
    lambda inner: st.builds(lambda name, parts: tag(name, {}, "".join(parts)), world_tag, st.lists(inner, max_size=3)),
    max_leaves=8,
)


@settings(max_examples=150)
@given(st.lists(world_element, max_size=5))
def test_any_world_file(elements: list[str]) -> None:
    with tempfile.NamedTemporaryFile("w", suffix=".world", encoding="utf-8") as file:
        file.write(f'<sdf version="1.6"><world name="w">{"".join(elements)}</world></sdf>')
        file.flush()
        try:
            read_world(Path(file.name))
        except SlidectlError as error:
            said(error, file.name)
