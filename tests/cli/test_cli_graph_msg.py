"""`slidectl msg` and `slidectl srv`: no daemon is needed."""

from __future__ import annotations

import json

import pytest
from command_line import CommandLine

JOINT_STATE = (
    "std_msgs/Header header\n  uint32 seq\n  time stamp\n  string frame_id\nstring[] name\nfloat64[] position\n"
    "float64[] velocity\nfloat64[] effort\n\n"
)


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        (["msg", "show", "std_msgs/Float64"], "float64 data\n\n"),
        (["msg", "show", "std_msgs/Empty"], "\n"),
        (["msg", "show", "sensor_msgs/JointState"], JOINT_STATE),
        (["msg", "show", "JointState"], "[sensor_msgs/JointState]:\n" + JOINT_STATE),
        (["msg", "md5", "std_msgs/Float64"], "fdb28210bfa9d7c91146260178d9a584\n"),
        (["msg", "md5", "Float64"], "[std_msgs/Float64]: fdb28210bfa9d7c91146260178d9a584\n"),
        (["srv", "show", "std_srvs/SetBool"], "bool data\n---\nbool success\nstring message\n\n"),
        (["srv", "show", "std_srvs/Empty"], "---\n\n"),
        (["srv", "show", "Trigger"], "[std_srvs/Trigger]:\n---\nbool success\nstring message\n\n"),
        (["srv", "md5", "std_srvs/SetBool"], "09fb03525b03e7ea1fd3992bafd87e16\n"),
        (["srv", "list", "std_srvs"], "std_srvs/Empty\nstd_srvs/SetBool\nstd_srvs/Trigger\n"),
    ],
)
def test_types_print_as_rosmsg_and_rossrv_print_them(slidectl: CommandLine, words: list[str], printed: str) -> None:
    assert slidectl.ok(*words) == printed


def test_raw_shows_the_definition_as_written(slidectl: CommandLine) -> None:
    assert slidectl.ok("srv", "show", "-r", "slidectl/Step").count("---") == 1


def test_the_type_may_come_from_stdin(slidectl: CommandLine) -> None:
    assert slidectl("msg", "show", stdin="std_msgs/Bool\n").stdout == "bool data\n\n"


def test_list_knows_the_types_of_the_tutorials(slidectl: CommandLine) -> None:
    names = slidectl.ok("msg", "list").splitlines()
    assert names == sorted(names)
    assert {"std_msgs/Float64", "control_msgs/JointControllerState", "controller_manager_msgs/ControllerState"} <= set(
        names
    )
    assert json.loads(slidectl.ok("msg", "list", "rosgraph_msgs", "--json").splitlines()[0]) == {
        "type": "rosgraph_msgs/Clock"
    }


def test_json_has_the_md5_and_the_definition(slidectl: CommandLine) -> None:
    record = json.loads(slidectl.ok("msg", "show", "std_msgs/Bool", "--json"))
    assert (record["type"], record["md5"]) == ("std_msgs/Bool", "8b94c1b53db61fb6aed406028ad6332a")
    assert "bool data" in record["definition"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["msg", "show", "std_msgs/Flaot64"], 1, "Did you mean 'std_msgs/Float64'?"),
        (["msg", "show", "Jointstate"], 1, "Did you mean 'sensor_msgs/JointState'?"),
        (["msg", "md5", "std_msgs/Nope"], 1, "no message type 'std_msgs/Nope'"),
        (["srv", "show", "std_srvs/Nope"], 1, "no service type 'std_srvs/Nope'"),
        (["msg", "list", "nopkg"], 1, "no package 'nopkg'"),
        (["msg", "show", "std_msgs::Float64"], 2, "write it as package/Type"),
        (["msg", "show", "std_msgs.msg.Float64"], 2, "write it as package/Type"),
        (["msg", "show"], 2, "no TYPE given"),
        (["msg"], 2, "Commands"),
        (["srv", "bogus"], 2, "no command 'bogus'"),
    ],
)
def test_errors_say_what_is_wrong(slidectl: CommandLine, words: list[str], code: int, said: str) -> None:
    done = slidectl(*words)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert done.stdout == ""
