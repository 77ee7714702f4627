"""`rosmsg` and `rossrv` in recorded sessions of the real tools. They need no daemon."""

from __future__ import annotations

import pytest
from cli_ros_world import Session, Shell, usage
from command_line import CommandLine

JOINT_STATE = """std_msgs/Header header
  uint32 seq
  time stamp
  string frame_id
string[] name
float64[] position
float64[] velocity
float64[] effort

"""
TWIST = """geometry_msgs/Vector3 linear
  float64 x
  float64 y
  float64 z
geometry_msgs/Vector3 angular
  float64 x
  float64 y
  float64 z

"""
SHOW = "rosmsg show [options] <message type>"
PLEASE = "Please refer to msg/srv types as 'package_name/Type'."
SESSIONS = [
    Session("rosmsg show std_msgs/Float64", "float64 data\n\n"),
    Session("rosmsg show sensor_msgs/JointState", JOINT_STATE),
    Session("rosmsg show JointState", f"[sensor_msgs/JointState]:\n{JOINT_STATE}"),
    Session("rosmsg show Float64", "[std_msgs/Float64]:\nfloat64 data\n\n"),
    Session("rosmsg show geometry_msgs/Twist", TWIST),
    Session("rosmsg show -r std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id\n\n"),
    Session("rossrv show -r std_srvs/Trigger", "---\nbool success\nstring message\n\n"),
    Session("rosmsg info std_msgs/Bool", "bool data\n\n"),
    Session("rosmsg show", "float64 data\n\n", stdin="std_msgs/Float64\n"),
    Session("rosmsg md5 std_msgs/Float64", "fdb28210bfa9d7c91146260178d9a584\n"),
    Session("rosmsg md5 Float64", "[std_msgs/Float64]: fdb28210bfa9d7c91146260178d9a584\n"),
    Session("rosmsg package std_srvs", "\n"),
    Session(
        "rosmsg package -s actionlib_msgs",
        "actionlib_msgs/GoalID actionlib_msgs/GoalStatus actionlib_msgs/GoalStatusArray\n",
    ),
    Session("rosmsg list | head -3", "actionlib/TestAction\nactionlib/TestActionFeedback\nactionlib/TestActionGoal\n"),
    Session("rosmsg package sensor_msgs | head -2", "sensor_msgs/BatteryState\nsensor_msgs/CameraInfo\n"),
    usage("rosmsg show a b", SHOW, "you may only specify one message type"),
    Session(
        "rosmsg show /std_msgs/Bool",
        "",
        f"Unable to load msg [/std_msgs/Bool]: invalid name [/std_msgs/Bool]\n{PLEASE}\n",
        1,
    ),
    Session("rosmsg md5 a/b/c", "", f"Invalid type: 'invalid name [a/b/c]'\n{PLEASE}\n", 64),
    usage("rosmsg show std_msgs.msg.Float64", SHOW, f"invalid message type 'std_msgs.msg.Float64'.\n{PLEASE}"),
    usage(
        "rosmsg show std_msgs::Float64",
        SHOW,
        f"rosmsg does not understand C++-style namespaces (i.e. '::').\n{PLEASE}",
    ),
    usage("rosmsg show < /dev/null", SHOW, "no message type given, and none on stdin"),
    Session("rossrv show std_srvs/SetBool", "bool data\n---\nbool success\nstring message\n\n"),
    Session("rossrv show Trigger", "[std_srvs/Trigger]:\n---\nbool success\nstring message\n\n"),
    Session("rossrv show std_srvs/Empty", "---\n\n"),
    Session("rossrv md5 std_srvs/SetBool", "09fb03525b03e7ea1fd3992bafd87e16\n"),
    Session("rossrv package std_srvs", "std_srvs/Empty\nstd_srvs/SetBool\nstd_srvs/Trigger\n"),
]
UNKNOWN = [
    (
        "rosmsg show std_msgs/Nope",
        "Unable to load msg [std_msgs/Nope]: Cannot locate message [Nope] in package [std_msgs]",
        1,
    ),
    (
        "rosmsg show nopkg/Nope",
        "Unable to load msg [nopkg/Nope]: Cannot locate message [Nope]: unknown package [nopkg]",
        1,
    ),
    ("rosmsg show Nope", "Could not find msg 'Nope'", 1),
    ("rossrv show std_srvs/Nope", "Unknown srv type [std_srvs/Nope]: Cannot locate message [Nope] in package", 1),
    ("rossrv show Nope", "Could not find srv 'Nope'", 1),
    ("rosmsg md5 std_msgs/Nope", "Cannot locate [std_msgs/Nope]", 1),
    ("rosmsg package nopkg", "Invalid package: nopkg\n", 64),
]


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    return Shell(CommandLine(tmp_path_factory.mktemp("nobody")))


@pytest.mark.parametrize("session", SESSIONS, ids=lambda session: session.line)
def test_the_line_prints_what_the_real_tool_prints(shell: Shell, session: Session) -> None:
    done = shell.run(session.line, session.stdin)
    assert (done.stdout, done.stderr, done.returncode) == (session.stdout, session.stderr, session.code)


@pytest.mark.parametrize(("line", "text", "code"), UNKNOWN, ids=[line for line, _, _ in UNKNOWN])
def test_an_unknown_type_is_said_in_the_tools_words(shell: Shell, line: str, text: str, code: int) -> None:
    done = shell.run(line)
    assert (done.stdout, done.returncode) == ("", code)
    assert done.stderr.startswith(text)


def test_packages_are_listed_on_one_line_or_each_on_its_own(shell: Shell) -> None:
    packages = shell.run("rosmsg packages -s").stdout.split()
    assert packages == shell.run("rosmsg packages").stdout.splitlines()
    assert {"std_msgs", "sensor_msgs", "controller_manager_msgs"} <= set(packages)


def test_without_a_verb(shell: Shell) -> None:
    for tool in ("rosmsg", "rossrv"):
        assert [shell.run(line).returncode for line in (tool, f"{tool} bogus")] == [0, 64]
        assert f"{tool} show" in shell.run(tool).stdout
