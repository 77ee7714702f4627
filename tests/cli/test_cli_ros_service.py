"""`rosservice` in recorded sessions of the real tool."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator

import pytest
from cli_ros_world import Session, SlideWorld, slide_world, usage
from daemon_fixture import send

from slidectl.client import Client


@pytest.fixture(scope="module")
def slide() -> Iterator[SlideWorld]:
    with slide_world() as world:
        yield world


BELOW = "".join(f"/slide/{name}\n" for name in ("boom", "enable", "refuse", "reset", "stop"))
DONE = 'success: True\nmessage: "reset done"\n'
ENABLED = 'success: True\nmessage: "enabled"\n'
LOGGERS = (
    'loggers: \n  - \n    name: "rosgraph.network"\n    level: "INFO"\n  - \n    name: "rospy"\n    level: "DEBUG"\n'
)
CALL = "rosservice call /service [args...]"
SET_BOOL = "\n\nsrv file:\nbool data\n---\nbool success\nstring message\n"
SET_LEVEL = "\n\nsrv file:\nstring logger\nstring level\n---\n"
WRONG_TYPE = "ERROR: Unable to send request. One of the fields has an incorrect type:\n  "
MISFIT = "ERROR: Incompatible arguments to call service:\n"

SESSIONS = [
    Session("rosservice list /slide", BELOW),
    Session("rosservice list slide", BELOW),
    Session("rosservice list -n /slide/stop", "/slide/stop <node>\n"),
    Session("rosservice list /nope"),
    usage("rosservice list a b", "rosservice list [/namespace]", "you may only specify one input namespace"),
    Session("rosservice info /slide/reset", "Node: <node>\nURI: <uri>\nType: std_srvs/Trigger\nArgs: \n"),
    Session("rosservice info /slide/enable", "Node: <node>\nURI: <uri>\nType: std_srvs/SetBool\nArgs: data\n"),
    Session("rosservice info /nope", "", "ERROR: unknown service\n", 1),
    usage("rosservice info", "rosservice info /service", "you must specify a service name"),
    usage("rosservice info a b", "rosservice info /service", "you may only specify one service"),
    usage("rosservice args a b", "rosservice args /service", "you may only specify one input service"),
    Session("rosservice type /slide/reset", "std_srvs/Trigger\n"),
    Session("rosservice type /nope", "", "Unknown service [/nope]\n", 1),
    usage("rosservice type", "rosservice type /service", "service must be specified"),
    Session("rosservice type /slide/reset | rossrv show", "---\nbool success\nstring message\n\n"),
    Session("rosservice uri /slide/reset", "<uri>\n"),
    Session("rosservice uri /nope", "", "Unknown service: /nope\n", 1),
    usage("rosservice uri", "rosservice uri /service", "service must be specified"),
    Session("rosservice args /slide/enable", "data\n"),
    Session("rosservice args /slide/reset", "\n"),
    Session("rosservice args /sim/set_logger_level", "logger level\n"),
    Session("rosservice args /nope", "", "ERROR: Service [/nope] is not available.\n", 2),
    usage("rosservice args", "rosservice args /service", "service must be specified"),
    Session("rosservice find std_srvs/Trigger", "/slide/boom\n/slide/refuse\n/slide/reset\n"),
    Session("rosservice find std_srvs/SetBool", "/slide/enable\n"),
    Session("rosservice find std_srvs/Nope", "\n"),
    Session("rosservice find garbage", "\n"),
    usage("rosservice find", "rosservice find msg-type", "please specify a message type"),
    Session("rosservice node /slide/reset", "<node>\n"),
    Session("rosservice node /nope", "", "Unknown service: /nope\n", 1),
    # calls
    Session("rosservice call /slide/reset", DONE),
    Session("rosservice call slide/reset", DONE),
    Session("ROS_NAMESPACE=slide rosservice call reset", DONE),
    Session('rosservice call /slide/reset "{}"', DONE),
    Session("rosservice call -v /slide/reset", f"\n---\n{DONE}"),
    Session("rosservice call --wait /slide/reset", DONE),
    Session("rosservice call /slide/stop", "\n"),
    Session("rosservice call -v /slide/enable true", f"data: True\n---\n{ENABLED}"),
    Session("rosservice call /slide/enable true", ENABLED),
    Session("rosservice call /slide/enable 'data: true'", ENABLED),
    Session("rosservice call /slide/enable '{data: true}'", ENABLED),
    Session("rosservice call /slide/enable 1", ENABLED),
    Session("rosservice call /slide/enable yes", ENABLED),
    Session("rosservice call /slide/enable", ENABLED * 2, stdin="data: true\n---\ndata: true\n---\n"),
    Session("rosservice call /slide/enable < /dev/null"),
    Session("rosservice call /sim/get_loggers", LOGGERS),
    Session("rosservice call /sim/get_loggers | head -n 1; echo ${PIPESTATUS[@]}", "loggers: \n0 0\n"),
    Session("rosservice call /sim/set_logger_level rosout debug", "\n"),
    Session('rosservice call /sim/set_logger_level "{logger: rosout, level: info}"', "\n"),
    Session("rosservice call /sim/set_logger_level 'logger: rosout'", "\n"),
    Session("rosservice call /slide/enable abc", "", f"{WRONG_TYPE}field data is not a bool{SET_BOOL}", 2),
    Session("rosservice call /slide/enable 7", "", f"{WRONG_TYPE}field data is not a bool{SET_BOOL}", 2),
    Session("rosservice call /slide/enable ''", "", f"{WRONG_TYPE}field data is not a bool{SET_BOOL}", 2),
    Session(
        "rosservice call /slide/enable 'value: true'",
        "",
        f"{MISFIT}No field name [value]\nProvided arguments are:\n * {{'value': True}} (type dict)\n\n"
        "Service arguments are: [data]\n",
        2,
    ),
    Session(
        "rosservice call /slide/enable true false",
        "",
        f"{MISFIT}Too many arguments:\n * Given: [True, False]\n * Expected: ['data']\nProvided arguments are:\n"
        " * True (type bool)\n * False (type bool)\n\nService arguments are: [data]\n",
        2,
    ),
    Session(
        "rosservice call /slide/reset 1",
        "",
        f"{MISFIT}Too many arguments:\n * Given: [1]\n * Expected: []\nProvided arguments are:\n * 1 (type int)\n\n"
        "Service arguments are: []\n",
        2,
    ),
    Session(
        "rosservice call /sim/set_logger_level rosout",
        "",
        f"{MISFIT}Not enough arguments:\n * Given: ['rosout']\n * Expected: ['logger', 'level']\n"
        "Provided arguments are:\n * rosout (type str)\n\nService arguments are: [logger level]\n",
        2,
    ),
    Session(
        "rosservice call /sim/set_logger_level rosout 5",
        "",
        f"{WRONG_TYPE}field level must be of type bytes or an ascii string{SET_LEVEL}",
        2,
    ),
    Session(
        "rosservice call /slide/boom",
        "",
        "ERROR: service [/slide/boom] responded with an error: b'error processing request: motor is on fire'\n",
        2,
    ),
    Session("rosservice call /nope", "", "ERROR: Service [/nope] is not available.\n", 2),
    usage("rosservice call", CALL, "service must be specified"),
]


@pytest.mark.parametrize("session", SESSIONS, ids=lambda session: session.line)
def test_the_line_prints_what_the_real_tool_prints(slide: SlideWorld, session: Session) -> None:
    done = slide(session.line, stdin=session.stdin)
    assert done.stdout == session.stdout.replace("<node>", slide.node.name).replace("<uri>", slide.uri)
    assert done.stderr == session.stderr
    assert done.returncode == session.code


def test_a_response_that_says_no_is_printed_and_its_code_is_1(slide: SlideWorld) -> None:
    done = slide("rosservice call /slide/refuse")
    assert (done.stdout, done.returncode) == ('success: False\nmessage: "limit switch is active"\n', 1)
    assert done.stderr == "ERROR: /slide/refuse answered success: false\n  limit switch is active\n"


def test_a_value_that_is_no_yaml_is_wrong_usage(slide: SlideWorld) -> None:
    done = slide("rosservice call /slide/enable 'data: [1'")
    assert (done.stdout, done.returncode) == ("", 2)
    assert "rosservice: error: Argument error: while parsing a flow sequence\n" in done.stderr


def test_without_a_verb_the_list_of_verbs_goes_to_stdout_with_exit_code_64(slide: SlideWorld) -> None:
    for line in ("rosservice", "rosservice bogus", "rosservice -h"):
        done = slide(line)
        assert (done.returncode, done.stderr) == (64, "")
        for verb in ("args", "call", "find", "info", "list", "type", "uri"):
            assert f"rosservice {verb}" in done.stdout


def called(slide: SlideWorld, provider: Client) -> subprocess.Popen[str]:
    """A `rosservice call` whose request has reached the provider, which does not answer."""
    send(provider, op="advertise_service", service="/slide/slow", type="std_srvs/Empty")
    provider.flush()
    calling = slide.shell.slidectl.start("ros", "rosservice", "call", "/slide/slow")
    assert any(wire.get("op") == "call_service" for wire in provider.events(20.0))
    return calling


def test_ctrl_c_ends_a_call_that_takes_long(slide: SlideWorld) -> None:
    with slide.daemon.client() as provider:
        calling = called(slide, provider)
        calling.send_signal(signal.SIGINT)
        assert calling.communicate(timeout=30) == ("", "")
    assert calling.returncode == 130


def test_a_provider_that_goes_away_fails_the_call(slide: SlideWorld) -> None:
    with slide.daemon.client() as provider:
        calling = called(slide, provider)
    stdout, stderr = calling.communicate(timeout=30)
    assert (stdout, calling.returncode) == ("", 2)
    assert stderr.startswith("ERROR: service [/slide/slow] responded with an error: b'")


def test_wait_waits_for_a_service_that_comes_later(slide: SlideWorld) -> None:
    waiting = slide.shell.slidectl.start("ros", "rosservice", "call", "--wait", "/slide/later")
    with slide.daemon.client() as provider:
        send(provider, op="advertise_service", service="/slide/later", type="std_srvs/Empty")
        for wire in provider.events(20.0):
            if wire.get("op") == "call_service":
                send(provider, op="service_response", id=wire["id"], service=wire["service"], values={}, result=True)
                break
        assert waiting.communicate(timeout=30) == ("\n", "")
    assert waiting.returncode == 0


def test_a_wait_may_be_limited(slide: SlideWorld) -> None:
    done = slide.shell.slidectl("--timeout", "0.2", "ros", "rosservice", "call", "--wait", "/not/yet")
    assert (done.stdout, done.returncode) == ("", 4)


def test_no_values_on_a_terminal_are_wrong_usage(slide: SlideWorld) -> None:
    output = slide.shell.slidectl.on_a_terminal("ros", "rosservice", "call", "/slide/enable").decode()
    assert "rosservice: error: Please specify service arguments" in output


def test_without_a_daemon_the_code_is_3(slide: SlideWorld) -> None:
    for words in (
        "list",
        "info /s",
        "type /s",
        "uri /s",
        "args /s",
        "node /s",
        "find t/T",
        "call /s",
        "call --wait /s",
    ):
        done = slide.shell.slidectl("-i", "nobody", "ros", "rosservice", *words.split())
        assert (done.returncode, done.stdout) == (3, "")
        assert done.stderr.splitlines()[0] == "ERROR: Unable to communicate with master!"
