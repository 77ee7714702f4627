"""The types that are known: what they are made of, their md5 sums, and how they print."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from msgs_known_md5 import MESSAGES, SERVICES

import slidectl
from slidectl import msgs
from slidectl.errors import UnknownName
from slidectl.msgs.definitions import parse_action, parse_message, parse_service, rosbags_names, rosbags_text


def every_type() -> list[str]:
    services = msgs.service_names()
    return msgs.type_names() + [msgs.request_type(s) for s in services] + [msgs.response_type(s) for s in services]


@pytest.mark.parametrize(("name", "md5"), MESSAGES.items())
def test_a_message_has_the_md5_sum_of_ros_1(name: str, md5: str) -> None:
    assert msgs.md5(name) == md5


@pytest.mark.parametrize(("name", "md5"), SERVICES.items())
def test_a_service_has_the_md5_sum_of_ros_1(name: str, md5: str) -> None:
    assert msgs.service_md5(name) == md5


def test_every_definition_here_agrees_with_rosbags_where_both_have_it() -> None:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    assert len(rosbags_names()) > 150
    for name in rosbags_names():
        theirs = parse_message(rosbags_text(name) or "", name)
        assert (theirs.fields, theirs.constants) == (msgs.fields(name), msgs.constants(name))
        assert msgs.md5(name) == store.generate_msgdef(name.replace("/", "/msg/"))[1]


def test_every_type_can_be_built_checked_shown_and_summed() -> None:
    for name in every_type():
        message = msgs.default(name)
        assert list(message) == [field.name for field in msgs.fields(name)]
        assert msgs.check(name, message) == message
        assert len(msgs.md5(name)) == 32
        assert msgs.show(name).count("\n") + 1 >= len(msgs.fields(name))


def test_fields_have_a_name_a_type_and_an_array_length() -> None:
    header, name, *_ = msgs.fields("sensor_msgs/JointState")
    assert header == ("header", "std_msgs/Header", -1)
    assert name == ("name", "string", 0)
    covariance = msgs.fields("geometry_msgs/PoseWithCovariance")[1]
    assert covariance == ("covariance", "float64", 36)
    assert covariance.type_text == "float64[36]"


def test_constants_have_a_name_a_type_and_a_value() -> None:
    assert msgs.constants("controller_manager_msgs/SwitchControllerRequest") == (
        ("BEST_EFFORT", "int32", 1),
        ("STRICT", "int32", 2),
    )
    assert msgs.constants("rosgraph_msgs/Log")[-1] == ("FATAL", "byte", 16)


def test_an_action_becomes_the_seven_messages_of_actionlib() -> None:
    parts = ("Action", "ActionGoal", "ActionResult", "ActionFeedback", "Goal", "Result", "Feedback")
    for part in parts:
        assert msgs.exists(f"control_msgs/FollowJointTrajectory{part}")
        assert f"control_msgs/FollowJointTrajectory{part}" in msgs.type_names()
    names = [field.name for field in msgs.fields("control_msgs/FollowJointTrajectoryActionGoal")]
    assert names == ["header", "goal_id", "goal"]


def test_show_prints_as_rosmsg_show() -> None:
    assert msgs.show("sensor_msgs/JointState").splitlines() == [
        "std_msgs/Header header",
        "  uint32 seq",
        "  time stamp",
        "  string frame_id",
        "string[] name",
        "float64[] position",
        "float64[] velocity",
        "float64[] effort",
    ]


def test_show_puts_constants_first_as_name_equals_value() -> None:
    lines = msgs.show("control_msgs/FollowJointTrajectoryResult").splitlines()
    assert lines[0] == "int32 SUCCESSFUL=0"
    assert lines[-2:] == ["int32 error_code", "string error_string"]


def test_show_service_prints_as_rossrv_show() -> None:
    assert msgs.show_service("std_srvs/SetBool") == "bool data\n---\nbool success\nstring message"
    assert msgs.show_service("std_srvs/Trigger") == "---\nbool success\nstring message"
    assert msgs.show_service("std_srvs/Empty") == "---"


def test_the_definition_is_the_text_of_the_file() -> None:
    assert msgs.definition("geometry_msgs/Point") == "float64 x\nfloat64 y\nfloat64 z\n"
    assert msgs.definition("sensor_msgs/Range").splitlines()[0] == "uint8 ULTRASOUND=0"
    assert "---" in msgs.service_definition("std_srvs/Trigger")


def test_a_definition_read_again_is_the_same_type() -> None:
    for name in every_type():
        again = parse_message(msgs.definition(name), name)
        assert (again.fields, again.constants) == (msgs.fields(name), msgs.constants(name))


def test_an_unknown_type_names_the_closest_and_those_of_its_package() -> None:
    with pytest.raises(UnknownName) as error:
        msgs.check("std_msgs/Flaot64", {})
    assert "no message type 'std_msgs/Flaot64'. Did you mean 'std_msgs/Float64'?" in str(error.value)
    assert "std_msgs/Bool" in str(error.value)
    assert "geometry_msgs" not in str(error.value)


@pytest.mark.parametrize("name", ["Float64", "std_msgs/msg/Float64", "std_msg/Float64"])
def test_a_type_in_the_wrong_package_or_style_finds_its_namesake(name: str) -> None:
    with pytest.raises(UnknownName, match="Did you mean 'std_msgs/Float64'"):
        msgs.fields(name)


def test_an_unknown_service_type_names_the_closest() -> None:
    with pytest.raises(UnknownName, match="Did you mean 'std_srvs/Trigger'"):
        msgs.request_type("std_srvs/Triger")


@pytest.mark.parametrize(
    "name", ["", "/", "std_msgs/", "../std_msgs/Bool", "std_msgs/../std_msgs/Bool", "std_msgs/Bool\n"]
)
def test_a_name_that_is_no_type_name_reads_no_file(name: str) -> None:
    assert not msgs.exists(name)
    assert not msgs.service_exists(name)


def test_a_huge_name_makes_a_small_error() -> None:
    assert not msgs.exists("std_msgs/" + "x" * 1_000_000)
    with pytest.raises(UnknownName) as error:
        msgs.fields("std_msgs/" + "x" * 1_000_000)
    assert len(str(error.value)) < 2000


def test_requests_and_responses_are_message_types_of_their_own() -> None:
    assert msgs.request_type("std_srvs/SetBool") == "std_srvs/SetBoolRequest"
    assert msgs.response_type("std_srvs/SetBool") == "std_srvs/SetBoolResponse"
    assert msgs.check("std_srvs/SetBoolRequest", {"data": True}) == {"data": True}


def test_exists_tells_messages_from_services() -> None:
    assert msgs.exists("std_msgs/Float64")
    assert not msgs.exists("std_srvs/SetBool")
    assert msgs.service_exists("std_srvs/SetBool")
    assert not msgs.service_exists("std_msgs/Float64")
    assert not msgs.exists("float64")


def test_comments_blank_lines_and_a_hash_in_a_text_constant_are_read_as_genmsg_reads_them() -> None:
    text = "# about\n\nint32 X = 0x10 # sixteen\nstring GREETING=hi # there \nHeader header\nfloat64[3]  xyz#packed\n"
    found = parse_message(text, "some_pkg/Thing")
    assert found.constants == (("X", "int32", 16), ("GREETING", "string", "hi # there"))
    assert found.constant_texts == ("0x10", "hi # there")
    assert found.fields == (("header", "std_msgs/Header", -1), ("xyz", "float64", 3))


@pytest.mark.parametrize("text", ["float64", "float64 a b", "float64[x] a", "float64 1a"])
def test_a_line_that_is_no_field_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="neither a field nor a constant"):
        parse_message(text, "some_pkg/Thing")


def test_a_service_or_action_with_the_wrong_number_of_parts_is_refused() -> None:
    with pytest.raises(ValueError, match="1 lines `---` expected"):
        parse_service("float64 a\n", "some_pkg/Thing")
    with pytest.raises(ValueError, match="2 lines `---` expected"):
        parse_action("---\n", "some_pkg/Thing")


def run_python(code: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(Path(slidectl.__file__).parents[1])}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60).stdout


def test_what_a_daemon_speaks_needs_no_rosbags() -> None:
    code = """
import sys
from slidectl import msgs
from slidectl.errors import UnknownName
for name in ("std_msgs/Float64", "sensor_msgs/JointState", "gazebo_msgs/LinkStates", "tf2_msgs/TFMessage",
             "control_msgs/JointControllerState", "rosgraph_msgs/Log", "dynamic_reconfigure/ConfigDescription"):
    msgs.check(name, {})
msgs.exists("std_msgs/Nonsense"), msgs.exists("my_msgs/Nonsense"), msgs.service_exists("sensor_msgs/Nonsense")
try:
    msgs.fields("std_msgs/Nonsense")
except UnknownName:
    print("unknown")
for name in msgs.service_names():
    if not name.startswith(("nav_msgs/", "sensor_msgs/", "diagnostic_msgs/")):
        msgs.default(msgs.response_type(name))
print(sorted({name.partition(".")[0] for name in sys.modules} & {"rosbags", "numpy", "yaml"}))
"""
    assert run_python(code).split() == ["unknown", "[]"]
