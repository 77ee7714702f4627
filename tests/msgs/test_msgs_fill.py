"""Messages from the values of a command line, by name and by position."""

from __future__ import annotations

import datetime
from typing import Any

import pytest

from slidectl import msgs
from slidectl.errors import EXIT_USAGE, BadMessage
from slidectl.msgs.fill import field_paths, fill
from slidectl.msgs.schema import from_typedefs

NOW = (12, 500)
STAMP = {"secs": 12, "nsecs": 500}


def filled(type_name: str, *args: Any) -> dict[str, Any]:
    return msgs.check(type_name, fill(msgs.fields, type_name, args, NOW))


def refusal(type_name: str, *args: Any) -> BadMessage:
    with pytest.raises(BadMessage) as error:
        fill(msgs.fields, type_name, args, NOW)
    assert error.value.exit_code == EXIT_USAGE
    return error.value


def test_one_mapping_is_by_name_and_may_be_partial() -> None:
    assert fill(msgs.fields, "geometry_msgs/Point", [{"x": 1.0}]) == {"x": 1.0}
    twist = filled("geometry_msgs/Twist", {"linear": {"x": 1}, "angular": {"z": 0.5}})
    assert twist == {"linear": {"x": 1.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.5}}


def test_a_bare_value_fills_a_message_of_one_field() -> None:
    assert filled("std_msgs/Float64", 1) == {"data": 1.0}
    assert filled("std_msgs/String", "hello") == {"data": "hello"}
    assert filled("std_msgs/Int32", 16) == {"data": 16}
    assert filled("std_msgs/Bool", 1) == {"data": True}


def test_one_value_per_field_fills_by_position() -> None:
    assert filled("geometry_msgs/Point", 1, 2, 3) == {"x": 1.0, "y": 2.0, "z": 3.0}


def test_nested_messages_are_lists_by_position() -> None:
    twist = filled("geometry_msgs/Twist", [1, 0, 0], [0, 0, 0.5])
    assert twist["linear"]["x"] == 1.0
    assert twist["angular"]["z"] == 0.5


def test_no_value_fills_a_message_without_fields() -> None:
    assert filled("std_msgs/Empty") == {}
    assert filled("std_msgs/Empty", {}) == {}


def test_auto_makes_a_header_of_now() -> None:
    by_name = filled("sensor_msgs/JointState", {"header": "auto", "name": ["slide"], "position": [0.1]})
    by_position = filled("sensor_msgs/JointState", "auto", ["slide"], [0.1], [], [])
    assert by_name == by_position
    assert by_name["header"] == {"seq": 0, "stamp": STAMP, "frame_id": ""}


def test_now_is_a_time_at_any_depth() -> None:
    assert filled("std_msgs/Time", "now") == {"data": STAMP}
    assert filled("std_msgs/Time", {"data": "now"}) == {"data": STAMP}
    pose = filled("geometry_msgs/PoseStamped", {"header": {"stamp": "now", "frame_id": "base"}})
    assert pose["header"] == {"seq": 0, "stamp": STAMP, "frame_id": "base"}
    transforms = filled("tf2_msgs/TFMessage", [{"header": "auto"}])["transforms"]
    assert transforms[0]["header"]["stamp"] == STAMP


def test_now_is_plain_text_in_a_text_field() -> None:
    assert filled("std_msgs/String", "now") == {"data": "now"}
    assert filled("std_msgs/Header", {"frame_id": "auto"})["frame_id"] == "auto"


def test_now_needs_a_clock_and_no_duration() -> None:
    with pytest.raises(BadMessage, match="no clock"):
        fill(msgs.fields, "std_msgs/Time", ["now"])
    assert "data must be {secs, nsecs} or nanoseconds (a duration)" in str(refusal("std_msgs/Duration", "now"))


@pytest.mark.parametrize(
    ("value", "meant"),
    [
        (1_500_000_000, {"secs": 1, "nsecs": 500_000_000}),
        ({"secs": 12, "nsecs": 5}, {"secs": 12, "nsecs": 5}),
        ([12, 5], {"secs": 12, "nsecs": 5}),
        ({"secs": 2}, {"secs": 2, "nsecs": 0}),
        (-1, {"secs": -1, "nsecs": 999_999_999}),
    ],
)
def test_a_duration_is_nanoseconds_or_seconds_with_nanoseconds(value: Any, meant: dict[str, int]) -> None:
    assert filled("std_msgs/Duration", {"data": value}) == {"data": meant}


def test_seconds_with_a_fraction_are_no_time() -> None:
    assert "data must be 'now', {secs, nsecs} or nanoseconds (a time), not the number 1.5" in str(
        refusal("std_msgs/Time", 1.5)
    )


def test_numbers_alone_fill_a_multi_array() -> None:
    assert filled("std_msgs/Float64MultiArray", [1, 2]) == {"layout": {"dim": [], "data_offset": 0}, "data": [1.0, 2.0]}
    assert filled("std_msgs/Float64MultiArray", {"data": [1.0]})["data"] == [1.0]
    assert filled("std_msgs/UInt8MultiArray", [1, 2, 255])["data"] == "AQL/"
    assert refusal("std_msgs/Float64MultiArray", [1, "a"]).path == "data[1]"


def test_lists_of_messages_take_mappings_and_lists() -> None:
    trajectory = filled("trajectory_msgs/JointTrajectory", {"joint_names": ["a"], "points": [{"positions": [1]}]})
    assert trajectory["points"][0]["positions"] == [1.0]
    polygon = filled("geometry_msgs/Polygon", {"points": [[1, 2, 3], {"x": 4}]})
    assert polygon["points"][1] == {"x": 4.0, "y": 0.0, "z": 0.0}


def test_an_empty_argument_is_an_empty_text() -> None:
    assert filled("std_msgs/String", None) == {"data": ""}
    assert filled("rosapi/SetParamRequest", "/speed", None) == {"name": "/speed", "value": ""}


def test_an_unknown_field_names_its_path_and_those_that_exist() -> None:
    error = refusal("geometry_msgs/PoseStamped", {"pose": {"position": {"q": 1.0}}})
    assert "geometry_msgs/PoseStamped: no field 'pose.position.q'" in str(error)
    assert "geometry_msgs/Point has the fields x, y, z" in str(error)
    assert "Did you mean 'data'" in str(refusal("std_msgs/Float64", {"date": 1.0}))


@pytest.mark.parametrize(
    ("type_name", "args", "text"),
    [
        ("geometry_msgs/Point", (1, 2), "geometry_msgs/Point: not enough arguments: 2 given, 3 expected"),
        ("geometry_msgs/Point", ([1, 2, 3],), "geometry_msgs/Point: not enough arguments: 1 given, 3 expected"),
        ("std_msgs/Float64", (1.0, 2.0), "std_msgs/Float64: too many arguments: 2 given, 1 expected"),
        ("std_msgs/Empty", (1,), "std_msgs/Empty: too many arguments: 1 given, 0 expected\nit has no fields"),
        ("std_msgs/Header", ("auto",), "std_msgs/Header: not enough arguments: 1 given, 3 expected"),
        ("geometry_msgs/Twist", ([1, 2], [0, 0, 0]), "linear: not enough arguments: 2 given, 3 expected"),
    ],
)
def test_a_wrong_number_of_values_says_how_many_and_which(type_name: str, args: tuple[Any, ...], text: str) -> None:
    assert text in str(refusal(type_name, *args))


def test_too_few_values_list_the_fields() -> None:
    assert refusal("geometry_msgs/Point", 1).hint == "one value for each of: x, y, z; or by name: {x: ...}"


def test_a_list_field_refuses_a_single_value() -> None:
    assert "name must be a list (string[]), not the text 'slide'" in str(
        refusal("sensor_msgs/JointState", {"name": "slide"})
    )


def test_a_wrong_keyword_says_what_a_header_takes() -> None:
    error = refusal("geometry_msgs/PoseStamped", {"header": "foo"})
    assert "header must be 'auto', a mapping or a list (a std_msgs/Header), not the text 'foo'" in str(error)


@pytest.mark.parametrize("value", ["abc", "1e", True, None, [1.0], {"a": 1}])
def test_a_value_of_the_wrong_kind_is_found_before_it_is_sent(value: Any) -> None:
    assert refusal("std_msgs/Float64", {"data": value}).path == "data"


@pytest.mark.parametrize("value", [5, 1.5, True, 750, datetime.date(2020, 1, 1)])
def test_what_yaml_does_not_read_as_text_wants_quotes(value: Any) -> None:
    error = refusal("std_msgs/String", value)
    assert "data must be text (string), and YAML reads this as" in str(error)
    assert "quote it" in str(error)


def test_values_out_of_range_and_arrays_of_the_wrong_length_are_refused() -> None:
    assert "uint8 (0 to 255)" in str(refusal("std_msgs/UInt8", 300))
    assert "exactly 3 (uint32[3]), not of 2" in str(refusal("shape_msgs/MeshTriangle", {"vertex_indices": [1, 2]}))
    assert refusal("sensor_msgs/JointState", {"position": [0.1, "b"]}).path == "position[1]"


def test_the_fields_may_come_from_the_answer_of_rosapi() -> None:
    typedefs = [
        {
            "type": "geometry_msgs/PoseStamped",
            "fieldnames": ["header", "pose"],
            "fieldtypes": ["std_msgs/Header", "geometry_msgs/Pose"],
            "fieldarraylen": [-1, -1],
        },
        {
            "type": "std_msgs/Header",
            "fieldnames": ["seq", "stamp", "frame_id"],
            "fieldtypes": ["uint32", "time", "string"],
            "fieldarraylen": [-1, -1, -1],
        },
    ]
    message = fill(from_typedefs(typedefs).fields, "geometry_msgs/PoseStamped", [{"header": {"stamp": "now"}}], NOW)
    assert message == {"header": {"stamp": STAMP}}


def test_field_paths_are_what_rosservice_args_prints() -> None:
    assert field_paths(msgs.fields, "geometry_msgs/PoseStamped")[:4] == [
        "header.seq",
        "header.stamp",
        "header.frame_id",
        "pose.position.x",
    ]
    assert field_paths(msgs.fields, "sensor_msgs/JointState")[-1] == "effort"
    assert field_paths(msgs.fields, "std_srvs/EmptyRequest") == []
