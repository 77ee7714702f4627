"""Files of controllers are read as rosparam reads them, and put where the robot looks for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from slidectl.description import controllers_file, yaml_tree
from slidectl.description.robot import Notice
from slidectl.errors import EXIT_USAGE, BadFile

Write = Callable[[str, str], Path]


def read(text: str) -> dict[str, Any]:
    return yaml_tree.read(text, "c.yaml")


def test_a_file_is_a_tree_of_parameters(write: Write) -> None:
    path = write("süd/c.yaml", "slider:\n  joint1:\n    type: a/B\n    pid: {p: 100.0, i: 0.01}\n    on: [1, 2.5, x]\n")
    with pytest.raises(BadFile, match=r"c.yaml:5: on is not a name"):
        controllers_file.read(path)
    path = write("c.yaml", "slider:\n  joint1:\n    type: a/B\n    pid: {p: 100.0, i: 1}\n    list: [yes, 2.5, x]\n")
    tree = controllers_file.read(path)
    assert tree == {"slider": {"joint1": {"type": "a/B", "pid": {"p": 100.0, "i": 1}, "list": [True, 2.5, "x"]}}}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("deg(90)", math.pi / 2),
        ("deg(3)", 0.05235987755982988),
        ("rad(pi/4)", math.pi / 4),
        ("!radians 2*(1+1)**2", 8.0),
        ("rad(2*(1+1)**2)", "rad(2*(1+1)**2)"),
        ("!degrees 180", math.pi),
        ("!radians pi", math.pi),
        ("010", 8),
        ("12:30", 750),
        ("1_000", 1000),
        ("no", False),
        ("1.0e-3", 0.001),
        (".inf", math.inf),
        ("'deg(90)'", "deg(90)"),
    ],
)
def test_values_are_those_of_yaml_1_1_with_angles(text: str, value: object) -> None:
    assert read(f"a: {text}") == {"a": value}


def test_several_documents_and_their_namespaces_are_merged() -> None:
    assert read("_ns: /x\na: {b: 1}\n---\nx: {a: {c: 2}}\n---\n") == {"x": {"a": {"b": 1, "c": 2}}}


def test_names_with_slashes_are_paths() -> None:
    assert read("/a/b: 1\na: {c/d: 2}") == {"a": {"b": 1, "c": {"d": 2}}}


def test_merge_keys_give_way_to_what_is_written() -> None:
    text = "a: &a {p: 1, q: 2}\nb: &b {p: 3}\nc: {<<: [*b, *a], q: 5}"
    assert read(text)["c"] == {"p": 3, "q": 5}


def test_an_empty_file_has_no_parameters() -> None:
    assert read("# nothing\n") == {}


FAULTS = [
    ("a:\n  b: [1", 2, "not YAML"),
    ("a: 1\n\tb: 2", 2, "not YAML"),
    ("a: 1\nb:", 2, "'b' has no value"),
    ("a: 1\nb: ~", 2, "'b' has no value"),
    ("a: 1\nb: 2020-01-01", 2, "is a date"),
    ("a: 1\n2: 3", 2, "2 is not a name"),
    ("a: 1\n[1]: 3", 2, "is not a name"),
    ("- 1", 1, "expected names with values"),
    ("hello", 1, "expected names with values"),
    ("a: !!python/object/apply:os.system [x]", 1, "a list or mapping cannot be tag:yaml.org,2002:python"),
    ("a: !!set {x}", 1, "a list or mapping cannot be"),
    ("a: !!python/name:os.system x", 1, "could not determine a constructor"),
    ("a: !!binary aGk=", 1, "is binary"),
    ("a: *b", 1, "undefined alias"),
    ("a: &a [*a]", 1, "nested deeper than"),
    ("a: {<<: 3}", 1, "merges mappings only"),
    ("a: !radians __import__('os')", 1, "is not an angle"),
    ("a: !radians 9**9**9", 1, "is not an angle"),
    ("a: deg(180/2)", 1, "expected one number of degrees"),
    ("a: !radians (-1)**0.5", 1, "is not an angle"),
    ("a: rad(1/0)", 1, "is not an angle"),
    ("a: \x00", None, "not YAML"),
    ("a: " + "[" * 5000, None, "nested too deeply"),
]


@pytest.mark.parametrize(("text", "line", "reason"), FAULTS, ids=[reason for *_, reason in FAULTS])
def test_a_fault_is_named_with_file_and_line(text: str, line: int | None, reason: str) -> None:
    with pytest.raises(BadFile) as caught:
        read(text)
    assert reason in str(caught.value)
    assert (caught.value.file, caught.value.line) == ("c.yaml", line)
    assert caught.value.exit_code == EXIT_USAGE


def test_a_bomb_of_aliases_is_refused() -> None:
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    lines += [f"{after}: &{after} [{', '.join(['*' + before] * 9)}]" for before, after in pairwise("abcdefghi")]
    with pytest.raises(BadFile, match="more than 200000 values"):
        read("\n".join(lines))


def test_a_bomb_of_merges_costs_no_more_than_its_names() -> None:
    lines = ["a: &a {x: 1}"]
    names = "abcdefghijklmnop"
    lines += [
        f"{after}: &{after} {{<<: [{', '.join(['*' + before] * 9)}], k{after}: 1}}" for before, after in pairwise(names)
    ]
    assert len(read("\n".join(lines))["p"]) == len(names)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("p: 1\np: 2", "duplicate key, also in line 1; the last one counts"),
        ("a: 1\na/b: 2", "is both a value and a namespace of values"),
        ("a/b: 1\na: 2", "is both a value and a namespace of values"),
        ("a: 1\nb: 1e-3", "is text in YAML 1.1, not a number"),
        ("a: 1\nb: inf", "is text in YAML 1.1, not a number"),
    ],
)
def test_what_reads_differently_from_what_it_looks_like_is_a_notice(text: str, reason: str) -> None:
    notices: list[Notice] = []
    yaml_tree.read(text, "c.yaml", notices)
    (notice,) = notices
    assert reason in notice.text
    assert notice.where == "c.yaml:2"


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"no.yaml: no such file"):
        controllers_file.read(tmp_path / "no.yaml")


def test_one_value_is_read_as_a_parameter_of_any_shape() -> None:
    assert yaml_tree.read_value("[1, deg(180)]", "value") == [1, math.pi]
    assert yaml_tree.read_value("{p: 1.0}", "value") == {"p": 1.0}
    assert yaml_tree.read_value("", "value") is None


CONTROLLERS = {"joint1": {"type": "effort_controllers/JointPositionController"}}


def test_a_file_that_names_the_namespace_is_loaded_as_it_stands() -> None:
    tree = {"slider": CONTROLLERS, "rrbot": CONTROLLERS}
    assert controllers_file.retarget(tree, "/slider") == (tree, None)


def test_a_file_for_a_nested_namespace_is_loaded_as_it_stands() -> None:
    tree = {"robots": {"slider": CONTROLLERS}}
    assert controllers_file.retarget(tree, "/robots/slider") == (tree, None)


def test_a_file_for_another_robot_is_moved_and_says_so() -> None:
    tree, notice = controllers_file.retarget({"slider": CONTROLLERS}, "/left")
    assert tree == {"left": CONTROLLERS}
    assert notice == "the file's controllers are for /slider; they are loaded under /left"


def test_a_file_of_bare_controllers_goes_under_the_namespace() -> None:
    assert controllers_file.retarget(CONTROLLERS, "/a/b") == ({"a": {"b": CONTROLLERS}}, None)


def test_a_file_without_controllers_is_loaded_as_it_stands_and_says_so() -> None:
    tree = {"gains": {"p": 1}, "more": 2}
    loaded, notice = controllers_file.retarget(tree, "/left")
    assert loaded == tree
    assert notice == "no controllers for /left in the file; it is loaded as it stands"


def test_the_root_may_be_a_robots_namespace() -> None:
    assert controllers_file.retarget(CONTROLLERS, "/") == (CONTROLLERS, None)
    assert controllers_file.retarget({}, "/") == ({}, None)


@pytest.mark.parametrize("name", ["slider", "rrbot"])
def test_the_shipped_files_are_for_their_robots(name: str) -> None:
    from slidectl import paths

    tree = controllers_file.read(paths.share("config") / f"{name}_control.yaml")
    assert controllers_file.retarget(tree, f"/{name}") == (tree, None)
    position = tree[name]["joint1_position_controller"]
    assert position["pid"] == {"p": 100.0, "i": 0.01, "d": 10.0}
    assert tree[name]["joint_state_controller"]["publish_rate"] == 50


def test_every_value_has_a_line_however_it_came_into_the_tree() -> None:
    text = "_ns: bot\na: &a {p: 1, q: [1, {name: z}]}\nb/c:\n  <<: *a\n  d: 2\n"
    lines = yaml_tree.places(text, "f.yaml")
    assert (lines["/bot/a/p"], lines["/bot/a/q[1]/name"]) == (2, 2)
    assert (lines["/bot/b"], lines["/bot/b/c"], lines["/bot/b/c/d"], lines["/bot/b/c/p"]) == (3, 3, 5, 2)


@pytest.mark.parametrize("text", ["/: 3", '"": [1]', "a: {/: x}"])
def test_a_value_needs_a_name(text: str) -> None:
    with pytest.raises(BadFile, match="is not a name"):
        yaml_tree.read(text, "f.yaml")


def test_nan_in_a_file_of_ros2_is_a_parameter_that_is_not_set(tmp_path: Path) -> None:
    file = tmp_path / "base.yaml"
    file.write_text("base:\n  ros__parameters:\n    linear.x: {max_velocity: 1.0, max_jerk: .NAN}\n")
    assert controllers_file.read(file) == {"base": {"linear": {"x": {"max_velocity": 1.0}}}}
    file.write_text("base: {max_jerk: .NAN}\n")
    assert math.isnan(controllers_file.read(file)["base"]["max_jerk"])


@pytest.mark.parametrize("key", ["/**/fwd", "/*/fwd", "/fwd", "fwd"])
def test_a_node_of_ros2_in_any_namespace_is_the_controller(tmp_path: Path, key: str) -> None:
    file = tmp_path / "fwd.yaml"
    file.write_text(f'"{key}":\n  ros__parameters: {{joints: [j1]}}\n')
    assert controllers_file.read(file) == {"fwd": {"joints": ["j1"]}}
