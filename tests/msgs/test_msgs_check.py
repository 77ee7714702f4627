"""Completing and checking messages: what is taken, what is refused, and how the refusal reads."""

from __future__ import annotations

import base64
import math
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slidectl import msgs
from slidectl.errors import EXIT_USAGE, BadMessage


def refusal(type_name: str, value: Any) -> BadMessage:
    with pytest.raises(BadMessage) as error:
        msgs.check(type_name, value)
    return error.value


def test_a_default_message_is_complete_and_fresh() -> None:
    first = msgs.default("sensor_msgs/JointState")
    assert first == {
        "header": {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""},
        "name": [],
        "position": [],
        "velocity": [],
        "effort": [],
    }
    first["name"].append("joint1")
    first["header"]["stamp"]["secs"] = 5
    assert msgs.default("sensor_msgs/JointState")["name"] == []
    assert msgs.default("sensor_msgs/JointState")["header"]["stamp"]["secs"] == 0


def test_fixed_arrays_begin_with_all_their_elements() -> None:
    assert msgs.default("geometry_msgs/PoseWithCovariance")["covariance"] == [0.0] * 36
    assert msgs.default("shape_msgs/MeshTriangle") == {"vertex_indices": [0, 0, 0]}


def test_missing_fields_get_their_default_at_every_depth() -> None:
    message = msgs.check("geometry_msgs/PoseStamped", {"pose": {"position": {"x": 1}}})
    assert message["pose"] == {"position": {"x": 1.0, "y": 0.0, "z": 0.0}, "orientation": dict.fromkeys("xyzw", 0.0)}
    assert message["header"]["frame_id"] == ""


def test_what_was_given_is_not_changed_nor_shared() -> None:
    given_message = {"name": ["joint1"], "position": [1]}
    message = msgs.check("sensor_msgs/JointState", given_message)
    message["name"].append("joint2")
    message["velocity"].append(0.0)
    assert given_message == {"name": ["joint1"], "position": [1]}
    assert msgs.check("sensor_msgs/JointState", {})["velocity"] == []


def test_lists_of_floats_are_copied() -> None:
    positions = [1.0, 2.0]
    message = msgs.check("sensor_msgs/JointState", {"position": positions})
    positions[0] = 9.0
    assert message["position"] == [1.0, 2.0]


def test_integers_become_floats() -> None:
    data = msgs.check("std_msgs/Float64", {"data": 1})["data"]
    assert type(data) is float
    assert data == 1.0
    assert [type(x) for x in msgs.check("sensor_msgs/JointState", {"position": [1, 2.5]})["position"]] == [float, float]


def test_null_is_not_a_number_for_floats_only() -> None:
    assert math.isnan(msgs.check("std_msgs/Float64", {"data": None})["data"])
    assert math.isnan(msgs.check("sensor_msgs/JointState", {"position": [1.0, None]})["position"][1])
    assert "must be an integer (int32), not null" in str(refusal("std_msgs/Int32", {"data": None}))
    assert "must be text (string), not null" in str(refusal("std_msgs/String", {"data": None}))


def test_infinities_and_nan_pass_as_floats_but_not_as_text() -> None:
    assert msgs.check("std_msgs/Float64", {"data": math.inf})["data"] == math.inf
    for text in ("nan", "inf", "-inf", "1.0"):
        assert f"not the text '{text}'" in str(refusal("std_msgs/Float64", {"data": text}))


@pytest.mark.parametrize(
    ("type_name", "lowest", "highest"),
    [
        ("Int8", -128, 127),
        ("UInt8", 0, 255),
        ("Byte", -128, 127),
        ("Char", 0, 255),
        ("Int16", -(2**15), 2**15 - 1),
        ("UInt16", 0, 2**16 - 1),
        ("Int32", -(2**31), 2**31 - 1),
        ("UInt32", 0, 2**32 - 1),
        ("Int64", -(2**63), 2**63 - 1),
        ("UInt64", 0, 2**64 - 1),
    ],
)
def test_integers_keep_to_their_range(type_name: str, lowest: int, highest: int) -> None:
    for value in (lowest, highest):
        assert msgs.check(f"std_msgs/{type_name}", {"data": value}) == {"data": value}
    for value in (lowest - 1, highest + 1):
        assert f"({lowest} to {highest}), not the number {value}" in str(
            refusal(f"std_msgs/{type_name}", {"data": value})
        )


@pytest.mark.parametrize("value", [1.0, 1.5, True, "1", [1], {"data": 1}])
def test_an_integer_field_takes_integers_only(value: Any) -> None:
    assert "data must be an integer (int32)" in str(refusal("std_msgs/Int32", {"data": value}))


@pytest.mark.parametrize("value", [True, "1", [1.0], {}])
def test_a_float_field_takes_numbers_only(value: Any) -> None:
    assert "data must be a number (float64)" in str(refusal("std_msgs/Float64", {"data": value}))


def test_numbers_too_large_for_a_float_are_refused() -> None:
    assert "must be a number that fits float64" in str(refusal("std_msgs/Float64", {"data": 10**400}))
    assert "must be float32" in str(refusal("std_msgs/Float32", {"data": 1e39}))
    assert msgs.check("std_msgs/Float32", {"data": math.inf}) == {"data": math.inf}


def test_a_small_float_has_its_own_precision() -> None:
    assert msgs.check("std_msgs/Float32", {"data": 1.1}) == {"data": 1.100000023841858}  # as its readers in ROS see it
    assert msgs.check("sensor_msgs/LaserScan", {"ranges": [0.5, 0.1]})["ranges"] == [0.5, 0.10000000149011612]


def test_an_integer_of_thousands_of_digits_makes_a_short_error() -> None:
    for value in (10**5000, -(10**5000)):
        assert len(str(refusal("std_msgs/Int32", {"data": value}))) < 300
        assert len(str(refusal("std_msgs/Time", {"data": {"secs": value}}))) < 300


@pytest.mark.parametrize(("value", "meant"), [(True, True), (False, False), (1, True), (0, False)])
def test_a_bool_takes_true_false_one_and_zero(value: Any, meant: bool) -> None:
    assert msgs.check("std_msgs/Bool", {"data": value})["data"] is meant


@pytest.mark.parametrize("value", [7, "true", None, 1.0])
def test_a_bool_takes_nothing_else(value: Any) -> None:
    assert "data must be true or false" in str(refusal("std_msgs/Bool", {"data": value}))


def test_text_may_be_any_unicode_but_no_broken_surrogate() -> None:
    assert msgs.check("std_msgs/String", {"data": "é 滑"})["data"] == "é 滑"
    assert "surrogate" in str(refusal("std_msgs/String", {"data": "\ud800"}))


@pytest.mark.parametrize("value", [5, 1.5, True, ["a"], {}])
def test_a_text_field_takes_text_only(value: Any) -> None:
    assert "data must be text (string)" in str(refusal("std_msgs/String", {"data": value}))


def test_times_are_brought_to_less_than_a_second_of_nanoseconds() -> None:
    def stamp(secs: int, nsecs: int) -> Any:
        return msgs.check("std_msgs/Duration", {"data": {"secs": secs, "nsecs": nsecs}})["data"]

    assert stamp(1, 500) == {"secs": 1, "nsecs": 500}
    assert stamp(1, 2_500_000_000) == {"secs": 3, "nsecs": 500_000_000}
    assert stamp(-1, 0) == {"secs": -1, "nsecs": 0}
    assert stamp(0, -1) == {"secs": -1, "nsecs": 999_999_999}


def test_a_time_may_be_partial_and_is_never_negative() -> None:
    assert msgs.check("std_msgs/Time", {"data": {"secs": 3}}) == {"data": {"secs": 3, "nsecs": 0}}
    assert "time of 0 to 4294967295 seconds" in str(refusal("std_msgs/Time", {"data": {"secs": -1, "nsecs": 0}}))


def test_a_time_of_wrong_shape_says_what_a_time_is() -> None:
    assert "data must be a time {secs, nsecs}, not the number 1.5" in str(refusal("std_msgs/Time", {"data": 1.5}))
    error = refusal("std_msgs/Time", {"data": {"sec": 1}})
    assert "no field 'data.sec'. Did you mean 'data.secs'?" in str(error)
    assert refusal("std_msgs/Time", {"data": {"secs": "x"}}).path == "data.secs"


def test_bytes_become_base64_text() -> None:
    text = base64.b64encode(bytes([1, 2, 255])).decode()
    for value in ([1, 2, 255], bytes([1, 2, 255]), bytearray([1, 2, 255]), (1, 2, 255), text):
        assert msgs.check("std_msgs/UInt8MultiArray", {"data": value})["data"] == text
    assert msgs.check("std_msgs/UInt8MultiArray", {})["data"] == ""


def test_bytes_that_are_none_are_refused_with_their_index() -> None:
    assert refusal("std_msgs/UInt8MultiArray", {"data": [1, 256]}).path == "data[1]"
    for value in ("no base64!", "AAA", 5, None):
        assert "data must be base64 text or a list of integers" in str(
            refusal("std_msgs/UInt8MultiArray", {"data": value})
        )


def test_signed_bytes_stay_a_list_of_integers() -> None:
    assert msgs.check("std_msgs/Int8MultiArray", {"data": [-1, 2]})["data"] == [-1, 2]
    assert msgs.check("std_msgs/ByteMultiArray", {"data": [-1, 2]})["data"] == [-1, 2]


def test_a_fixed_array_has_exactly_its_length() -> None:
    assert msgs.check("shape_msgs/MeshTriangle", {"vertex_indices": [1, 2, 3]}) == {"vertex_indices": [1, 2, 3]}
    error = refusal("shape_msgs/MeshTriangle", {"vertex_indices": [1, 2]})
    assert "vertex_indices must be a list of exactly 3 (uint32[3]), not of 2" in str(error)
    covariance = refusal("geometry_msgs/PoseWithCovariance", {"covariance": [0.0] * 35})
    assert "exactly 36 (float64[36]), not of 35" in str(covariance)


def test_a_list_field_takes_lists_and_tuples_only() -> None:
    assert msgs.check("sensor_msgs/JointState", {"name": ("a", "b"), "position": (1, 2)})["position"] == [1.0, 2.0]
    for value in ("slide", 1, None, {"a": 1}):
        assert "name must be a list (string[])" in str(refusal("sensor_msgs/JointState", {"name": value}))


def test_numbers_and_arrays_of_numpy_are_taken_from_scripts() -> None:
    message = msgs.check("sensor_msgs/JointState", {"position": np.array([1.0, 2.0]), "velocity": [np.float32(0.5)]})
    assert message["position"] == [1.0, 2.0]
    assert [type(x) for x in message["position"] + message["velocity"]] == [float] * 3
    assert type(msgs.check("std_msgs/Int32", {"data": np.int64(7)})["data"]) is int
    assert type(msgs.check("std_msgs/Float64", {"data": np.float64(7)})["data"]) is float


def test_any_mapping_may_be_a_message() -> None:
    assert msgs.check("std_msgs/Float64", MappingProxyType({"data": 2})) == {"data": 2.0}


@pytest.mark.parametrize("value", [None, 1.0, "data", [1.0], True])
def test_a_message_that_is_no_object_is_refused(value: Any) -> None:
    error = refusal("std_msgs/Float64", value)
    assert "the message must be an object (a std_msgs/Float64)" in str(error)
    assert "std_msgs/Float64 has the fields float64 data" in str(error)
    assert error.path == ""


def test_an_unknown_field_names_its_path_the_closest_and_those_that_exist() -> None:
    error = refusal("geometry_msgs/PoseStamped", {"pose": {"postion": {"x": 1.0}}})
    assert str(error).splitlines() == [
        "geometry_msgs/PoseStamped: no field 'pose.postion'. Did you mean 'pose.position'?",
        "geometry_msgs/Pose has the fields position, orientation",
    ]
    assert error.path == "pose.postion"
    assert error.exit_code == EXIT_USAGE


def test_an_unknown_field_beside_all_known_ones_is_found_too() -> None:
    assert refusal("std_msgs/Float64", {"data": 1.0, "extra": 2}).path == "extra"
    assert "no field 'x'\nstd_msgs/Empty has no fields" in str(refusal("std_msgs/Empty", {"x": 1}))


def test_the_path_leads_through_lists_and_nested_messages() -> None:
    points = [{"positions": [0.0]}, {"positions": [0.0, "b"]}]
    error = refusal("trajectory_msgs/JointTrajectory", {"joint_names": ["joint1"], "points": points})
    assert error.path == "points[1].positions[1]"
    assert str(error).startswith(
        "trajectory_msgs/JointTrajectory: points[1].positions[1] must be a number (float64), not the text 'b'\n"
        "trajectory_msgs/JointTrajectoryPoint has the fields float64[] positions"
    )
    assert refusal("trajectory_msgs/JointTrajectory", {"points": [{}, 5]}).path == "points[1]"


def test_huge_wrong_values_make_short_errors() -> None:
    for value in ("x" * 10_000_000, {"k" * 1_000_000: 1}, dict.fromkeys(map(str, range(100_000))), [0] * 1_000_000):
        assert len(str(refusal("std_msgs/Float64", {"data": value}))) < 400
    assert len(str(refusal("std_msgs/Float64", {"k" * 1_000_000: 1}))) < 400


def test_keys_that_are_no_text_are_unknown_fields() -> None:
    assert "no field '1'" in str(refusal("std_msgs/Float64", {1: 2}))


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("abxyz"), inner, max_size=4),
    max_leaves=12,
)


@settings(database=None, deadline=None, max_examples=300)
@given(st.sampled_from(msgs.type_names()), st.data())
def test_any_value_is_either_refused_as_a_bad_message_or_becomes_a_complete_one(type_name: str, data: Any) -> None:
    names = [field.name for field in msgs.fields(type_name)]
    value = data.draw(st.dictionaries(st.sampled_from([*names, "other"]), json_values, max_size=4) | json_values)
    try:
        message = msgs.check(type_name, value)
    except BadMessage:
        return
    assert list(message) == names
    assert repr(msgs.check(type_name, message)) == repr(message)
