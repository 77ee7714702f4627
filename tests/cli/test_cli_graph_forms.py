"""Messages print exactly as rostopic prints them: YAML and CSV against outputs of the real tool."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from cli_graph_types import schema
from hypothesis import given
from hypothesis import strategies as st

from slidectl import msgs
from slidectl.msgs.field_path import select
from slidectl.msgs.message_text import CsvForm, YamlForm, quoted
from slidectl.msgs.schema import from_typedefs

HEADER = {"seq": 1, "stamp": {"secs": 1795219421, "nsecs": 932599067}, "frame_id": "base"}
JOINTS = {
    "header": {"seq": 308, "stamp": {"secs": 1795219463, "nsecs": 550504922}, "frame_id": ""},
    "name": ["slide", "latch"],
    "position": [-0.4992525430837464, 0.25],
    "velocity": [-0.02732943878699243, 0.0],
    "effort": [1.5, -2.0],
}
FORCES = {"layout": {"dim": [{"label": "f", "size": 3, "stride": 3}], "data_offset": 0}, "data": [1.0, -2.5, 1e-09]}
IDENTITY = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
POSES = {
    "header": HEADER,
    "poses": [
        {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": IDENTITY},
        {"position": {"x": 4.0, "y": 5.0, "z": 6.0}, "orientation": IDENTITY},
    ],
}
RAW = {"layout": {"dim": [], "data_offset": 0}, "data": "AEH/"}
JOINT_STATE = "sensor_msgs/JointState"


def yaml_of(type_name: str, message: Any, path: str = "", **options: Any) -> str:
    types = schema(type_name)
    selection = select(types.fields, type_name, path)
    form = YamlForm(types, **options)
    return form.printer(selection.type, selection.depth)(selection.read(msgs.check(type_name, message)))


def csv_of(type_name: str, message: Any, path: str = "", **options: Any) -> list[str]:
    types = schema(type_name)
    selection = select(types.fields, type_name, path)
    row = CsvForm(types, **options).row(selection.read(message), selection.type, selection.depth, 1795219463550504922)
    return list(row)


@pytest.mark.parametrize(
    ("type_name", "message", "text"),
    [
        ("std_msgs/Float64", {"data": 0.0}, "data: 0.0"),
        ("std_msgs/Float64", {"data": None}, "data: nan"),
        ("std_msgs/Bool", {"data": True}, "data: True"),
        ("std_msgs/Empty", {}, ""),
        ("std_msgs/String", {"data": 'ok: "moving"'}, 'data: "ok: \\"moving\\""'),
        ("std_msgs/String", {"data": ""}, "data: ''"),
        ("std_msgs/String", {"data": "é"}, 'data: "\\xE9"'),
        (
            "std_msgs/String",
            {"data": '<robot name="slide">\n  <link name="base"/>\n</robot>'},
            'data: "<robot name=\\"slide\\">\\n  <link name=\\"base\\"/>\\n</robot>"',
        ),
        (
            "std_msgs/Float64MultiArray",
            FORCES,
            'layout: \n  dim: \n    - \n      label: "f"\n      size: 3\n      stride: 3\n  data_offset: 0\n'
            "data: [1.0, -2.5, 1e-09]",
        ),
        ("std_msgs/UInt8MultiArray", RAW, "layout: \n  dim: []\n  data_offset: 0\ndata: [0, 65, 255]"),
        ("std_msgs/Time", {"data": {"secs": 12, "nsecs": 5}}, "data: \n  secs: 12\n  nsecs:         5"),
        (
            "std_msgs/Header",
            {"seq": 0, "stamp": {"secs": 1795219987, "nsecs": 122513055}, "frame_id": "base"},
            'seq: 0\nstamp: \n  secs: 1795219987\n  nsecs: 122513055\nframe_id: "base"',
        ),
    ],
)
def test_a_message_prints_as_the_yaml_of_rostopic(type_name: str, message: Any, text: str) -> None:
    assert yaml_of(type_name, message) == text


def test_a_joint_state_prints_its_names_as_a_block_and_its_numbers_inline() -> None:
    assert yaml_of(JOINT_STATE, JOINTS) == (
        "header: \n  seq: 308\n  stamp: \n    secs: 1795219463\n    nsecs: 550504922\n  frame_id: ''\n"
        "name: \n  - slide\n  - latch\nposition: [-0.4992525430837464, 0.25]\n"
        "velocity: [-0.02732943878699243, 0.0]\neffort: [1.5, -2.0]"
    )


def test_a_list_of_messages_prints_a_dash_on_a_line_of_its_own() -> None:
    pose = (
        "  - \n    position: \n      x: {0}\n      y: {1}\n      z: {2}\n"
        "    orientation: \n      x: 0.0\n      y: 0.0\n      z: 0.0\n      w: 1.0\n"
    )
    assert yaml_of("geometry_msgs/PoseArray", POSES) + "\n" == (
        'header: \n  seq: 1\n  stamp: \n    secs: 1795219421\n    nsecs: 932599067\n  frame_id: "base"\nposes: \n'
        + pose.format(1.0, 2.0, 3.0)
        + pose.format(4.0, 5.0, 6.0)
    )


@pytest.mark.parametrize(
    ("type_name", "message", "path", "text"),
    [
        ("std_msgs/Float64", {"data": 0.0}, "data", "0.0"),
        (JOINT_STATE, JOINTS, "position", "[-0.4992525430837464, 0.25]"),
        (JOINT_STATE, JOINTS, "position[0]", "-0.4992525430837464"),
        (JOINT_STATE, JOINTS, "position[::2]", "[-0.4992525430837464]"),
        (JOINT_STATE, JOINTS, "name[1]", '"latch"'),
        (JOINT_STATE, JOINTS, "name", "\n- slide\n- latch"),
        (JOINT_STATE, JOINTS, "header/stamp", "\nsecs: 1795219463\nnsecs: 550504922"),
        ("geometry_msgs/PoseArray", POSES, "poses[0]/position", "x: 1.0\ny: 2.0\nz: 3.0"),
        ("geometry_msgs/PoseArray", POSES, "poses[:]/position/x", "[1.0, 4.0]"),
        (
            "geometry_msgs/PoseArray",
            POSES,
            "poses[0:1]",
            "\n- \n  position: \n    x: 1.0\n    y: 2.0\n    z: 3.0\n"
            "  orientation: \n    x: 0.0\n    y: 0.0\n    z: 0.0\n    w: 1.0",
        ),
        ("std_msgs/UInt8MultiArray", RAW, "data", "[0, 65, 255]"),
    ],
)
def test_a_selected_field_prints_alone(type_name: str, message: Any, path: str, text: str) -> None:
    assert yaml_of(type_name, message, path) == text


@pytest.mark.parametrize(
    ("path", "options", "text"),
    [
        ("position", {"arrays": False}, '"<array type: float64, length: 2>"'),
        ("name", {"strings": False}, '"<array type: string, length: 2>"'),
        ("header/frame_id", {"strings": False}, '"<string length: 0>"'),
        ("position", {"strings": False}, "[-0.4992525430837464, 0.25]"),
        ("position", {"width": 6}, "[-0.499, 0.2500]"),
        ("effort[0]", {"width": 2}, "1."),
        ("header/seq", {"width": 6}, "   308"),
    ],
)
def test_arrays_strings_and_digits_can_be_left_out(path: str, options: dict[str, Any], text: str) -> None:
    assert yaml_of(JOINT_STATE, JOINTS, path, **options) == text


def test_an_array_of_fixed_length_is_named_as_rostopic_does_with_one_bracket() -> None:
    pose = {"pose": {"position": {}, "orientation": IDENTITY}, "covariance": [0.0] * 36}
    text = yaml_of("geometry_msgs/PoseWithCovariance", pose, arrays=False)
    assert text.endswith('covariance: "<array type: float64[36, length: 36>"')


def test_what_is_in_a_list_that_is_printed_is_there_in_full() -> None:
    layout = {"dim": [{"label": "rows", "size": 2, "stride": 6}], "data_offset": 0}
    printed = yaml_of("std_msgs/UInt8MultiArray", {"layout": layout, "data": ""}, strings=False)
    assert '      label: "rows"' in printed


@pytest.mark.parametrize(("path", "cells"), [("name", "slide,latch"), ("name[1]", "latch"), ("header/frame_id", "")])
def test_options_of_csv_are_for_what_is_in_the_chosen_field(path: str, cells: str) -> None:
    _, line = csv_of(JOINT_STATE, JOINTS, path, arrays=False, strings=False)
    assert line == f"1795219463550504922,{cells}"


def test_an_offset_makes_times_relative() -> None:
    types = schema("std_msgs/Header")
    form = YamlForm(types)
    form.offset_ns = 10 * 10**9 + 556946
    text = form.printer("std_msgs/Header")({"seq": 1, "stamp": {"secs": 10, "nsecs": 0}, "frame_id": ""})
    assert text == "seq: 1\nstamp: \n  secs: -1\n  nsecs: 999443054\nframe_id: ''"


@given(st.text(max_size=300))
def test_any_string_is_written_as_pyyaml_writes_it(text: str) -> None:
    text = text.replace("\ufeff", "")
    assert quoted(text) == (yaml.dump(text, default_style='"').rstrip("\n") if text else "''")


@given(st.lists(st.text(max_size=30) | st.sampled_from(["no", "Null", "1", "a_b", "/x/y", "~", "- a"]), min_size=1))
def test_any_list_of_strings_is_written_as_pyyaml_writes_it(texts: list[str]) -> None:
    form = YamlForm(schema(JOINT_STATE))
    lines = yaml.dump(texts).rstrip("\n").splitlines()
    assert form.printer("string", 1)(texts) == "".join(f"\n{line}" for line in lines)


CSV_HEADER = "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.name0,field.name1,field.position0,"


@pytest.mark.parametrize(
    ("type_name", "message", "path", "options", "rows"),
    [
        (
            JOINT_STATE,
            JOINTS,
            "",
            {},
            [
                CSV_HEADER + "field.position1,field.velocity0,field.velocity1,field.effort0,field.effort1",
                "1795219463550504922,308,1795219463550504922,,slide,latch,-0.4992525430837464,0.25,"
                "-0.02732943878699243,0.0,1.5,-2.0",
            ],
        ),
        ("std_msgs/Float64", {"data": 0.0}, "", {}, ["%time,field.data", "1795219463550504922,0.0"]),
        ("std_msgs/Float64", {"data": 0.0}, "data", {}, ["%time,field", "1795219463550504922,0.0"]),
        ("std_msgs/Bool", {"data": True}, "", {}, ["%time,field.data", "1795219463550504922,1"]),
        (
            "std_msgs/Float64MultiArray",
            FORCES,
            "",
            {},
            [
                "%time,field.layout.dim0.label,field.layout.dim0.size,field.layout.dim0.stride,"
                "field.layout.data_offset,field.data0,field.data1,field.data2",
                "1795219463550504922,f,3,3,0,1.0,-2.5,1e-09",
            ],
        ),
        ("std_msgs/String", {"data": 'ok: "moving"'}, "", {}, ["%time,field.data", '1795219463550504922,ok: "moving"']),
        ("std_msgs/String", {"data": 'a,"b"'}, "", {}, ["%time,field.data", '1795219463550504922,"a,""b"""']),
        (JOINT_STATE, JOINTS, "position", {}, ["%time,field0,field1", "1795219463550504922,-0.4992525430837464,0.25"]),
        (JOINT_STATE, JOINTS, "position[1]", {}, ["%time,field", "1795219463550504922,0.25"]),
        (
            JOINT_STATE,
            JOINTS,
            "",
            {"strings": False},
            [
                "%time,field.header.seq,field.header.stamp,field.position0,field.position1,field.velocity0,"
                "field.velocity1,field.effort0,field.effort1",
                "1795219463550504922,308,1795219463550504922,-0.4992525430837464,0.25,-0.02732943878699243,0.0,1.5,-2.0",
            ],
        ),
        (
            JOINT_STATE,
            JOINTS,
            "",
            {"arrays": False},
            [
                "%time,field.header.seq,field.header.stamp,field.header.frame_id",
                "1795219463550504922,308,1795219463550504922,",
            ],
        ),
        ("std_msgs/String", {"data": "x"}, "", {"arrays": False, "strings": False}, ["%time,", "1795219463550504922,"]),
        ("std_msgs/UInt8MultiArray", RAW, "", {}, ["%time,field.layout.data_offset", "1795219463550504922,0"]),
        (
            "geometry_msgs/PoseArray",
            POSES,
            "poses[:]/position",
            {},
            [
                "%time,field0.x,field0.y,field0.z,field1.x,field1.y,field1.z",
                "1795219463550504922,1.0,2.0,3.0,4.0,5.0,6.0",
            ],
        ),
    ],
)
def test_a_message_prints_as_the_csv_of_rostopic(
    type_name: str, message: Any, path: str, options: dict[str, Any], rows: list[str]
) -> None:
    assert csv_of(type_name, message, path, **options) == rows


def test_an_offset_makes_the_times_of_csv_relative() -> None:
    form = CsvForm(schema("std_msgs/Header"))
    form.offset_ns = 1_000_878_096
    row = form.row({"seq": 42, "stamp": {"secs": 1, "nsecs": 0}, "frame_id": "base"}, "std_msgs/Header", 0, 10**9)
    assert row.line == "-878096,42,-878096,base"


def test_a_schema_is_read_from_the_answer_of_the_daemon() -> None:
    typedefs = [
        {
            "type": "a/B",
            "fieldnames": ["x", "h"],
            "fieldtypes": ["float64", "std_msgs/Header"],
            "fieldarraylen": [3, -1],
        },
        {"type": "std_msgs/Header", "fieldnames": ["seq"], "fieldtypes": ["uint32"], "fieldarraylen": [-1]},
    ]
    types = from_typedefs(typedefs)
    assert types.root == "a/B"
    assert [field.type_text for field in types.fields("a/B")] == ["float64[3]", "std_msgs/Header"]
    assert not types.has_header
