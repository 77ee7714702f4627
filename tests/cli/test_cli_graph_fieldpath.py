"""Field paths: what they select, and what is said about one that selects nothing."""

from __future__ import annotations

import pytest
from cli_graph_types import schema

from slidectl.errors import UnknownName, UsageError
from slidectl.msgs.field_path import NoElement, Selection, select
from slidectl.msgs.schema import Schema

JOINT_STATE = schema("sensor_msgs/JointState")
POSES = schema("geometry_msgs/PoseArray")


def selected(types: Schema, path: str) -> Selection:
    return select(types.fields, types.root, path)


@pytest.mark.parametrize(
    ("path", "type_name", "depth"),
    [
        ("", "sensor_msgs/JointState", 0),
        ("position", "float64", 1),
        ("position[0]", "float64", 0),
        ("position[0:1]", "float64", 1),
        ("position[ 0 ]", "float64", 0),
        ("header/stamp", "time", 0),
        ("header.stamp.nsecs", "uint32", 0),
    ],
)
def test_a_path_knows_the_type_it_leads_to(path: str, type_name: str, depth: int) -> None:
    selection = selected(JOINT_STATE, path)
    assert (selection.type, selection.depth) == (type_name, depth)


def test_an_unknown_field_lists_the_fields_and_suggests_one() -> None:
    with pytest.raises(UnknownName) as caught:
        selected(JOINT_STATE, "positon[0]")
    assert "Did you mean 'position'?" in str(caught.value)
    assert "effort, header, name, position, velocity" in str(caught.value)


def test_a_field_of_a_nested_message_is_looked_for_in_its_type() -> None:
    with pytest.raises(UnknownName, match="in geometry_msgs/Point"):
        selected(POSES, "poses[0]/position/w")


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("position[x]", "an index is a number or a slice"),
        ("position[0", "']' is missing"),
        ("position[]", "an index is a number or a slice"),
        ("position[::0]", "step of a slice cannot be 0"),
        ("position[1:2:3:4]", "an index is a number or a slice"),
        ("position[0][1]", "no element position"),
        ("header[0]", "is std_msgs/Header, which has no element"),
        ("position[0]/x", "float64 has no fields"),
        ("position//x", "is not a field"),
    ],
)
def test_text_that_is_no_path_is_refused_with_the_reason(path: str, reason: str) -> None:
    with pytest.raises(UsageError) as caught:
        selected(JOINT_STATE, path)
    assert reason in str(caught.value)


def test_an_index_out_of_range_says_how_long_the_array_is() -> None:
    selection = selected(JOINT_STATE, "position[7]")
    with pytest.raises(NoElement, match=r"position\[7\], but the message has 2 there"):
        selection.read({"position": [1.0, 2.0]})
