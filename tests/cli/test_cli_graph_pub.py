"""`slidectl pub` at a real daemon: what arrives, what is refused, and how it ends."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cli_graph_world import COMMAND, World, slider_world

from slidectl.client import Subscription

HEARD = {
    "/f": "std_msgs/Float64",
    "/i": "std_msgs/Int32",
    "/u8": "std_msgs/UInt8",
    "/s": "std_msgs/String",
    "/b": "std_msgs/Bool",
    "/e": "std_msgs/Empty",
    "/pt": "geometry_msgs/Point",
    "/tw": "geometry_msgs/Twist",
    "/js": "sensor_msgs/JointState",
    "/ps": "geometry_msgs/PoseStamped",
    "/tm": "std_msgs/Time",
    "/a": "std_msgs/Float64MultiArray",
    "/bytes": "std_msgs/UInt8MultiArray",
}
ZERO = {"x": 0.0, "y": 0.0, "z": 0.0}


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with slider_world() as made:
        yield made


@pytest.fixture(scope="module")
def ears(world: World) -> dict[str, Subscription]:
    """A subscriber on a topic of each type."""
    return {topic: world.client.subscribe(topic, kind) for topic, kind in HEARD.items()}


def heard(ears: dict[str, Subscription], topic: str) -> list[dict[str, Any]]:
    """What has arrived on a topic and was not asked for before; publishing is over."""
    ear = ears[topic]
    ear._client.call("/rosapi/get_time")
    return [ear.get() for _ in range(len(ear))]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["/f", "1.5"], {"data": 1.5}),
        (["f", "-5.0"], {"data": -5.0}),
        (["/f", "-1"], {"data": -1.0}),
        (["/f", "std_msgs/Float64", "data: 1.0"], {"data": 1.0}),
        (["-1", "/f", "std_msgs/Float64", "2"], {"data": 2.0}),
        (["/f", "--once", "2"], {"data": 2.0}),
        (["/f", "2", "-1"], {"data": 2.0}),
        (["/f", "--", "-7"], {"data": -7.0}),
        (["/s", "hello"], {"data": "hello"}),
        (["/s", "data: 'a b'"], {"data": "a b"}),
        (["/s", ""], {"data": ""}),
        (["/s", "some_pkg/Thing"], {"data": "some_pkg/Thing"}),
        (["/s", '"5"'], {"data": "5"}),
        (["/b", "true"], {"data": True}),
        (["/e"], {}),
        (["/e", "-1"], {}),
        (["/pt", "1", "2", "3"], {"x": 1.0, "y": 2.0, "z": 3.0}),
        (["/pt", "1", "-2", "-1"], {"x": 1.0, "y": -2.0, "z": -1.0}),
        (["/pt", "x: 1.0", "-1"], {**ZERO, "x": 1.0}),
        (["/tw", "[1,0,0]", "[0,0,0.5]"], {"linear": {**ZERO, "x": 1.0}, "angular": {**ZERO, "z": 0.5}}),
        (["/tw", "{linear: {x: 1.0}}", "-1"], {"linear": {**ZERO, "x": 1.0}, "angular": ZERO}),
        (["/tm", "1500000000"], {"data": {"secs": 1, "nsecs": 500000000}}),
        (["/a", "[1.0, 2, 3.5]"], {"layout": {"dim": [], "data_offset": 0}, "data": [1.0, 2.0, 3.5]}),
        (["/bytes", "{data: [1, 2, 255]}"], {"layout": {"dim": [], "data_offset": 0}, "data": "AQL/"}),
    ],
)
def test_a_value_arrives_as_it_was_meant(
    world: World, ears: dict[str, Subscription], words: list[str], message: dict[str, Any]
) -> None:
    topic = next(word for word in words if word in HEARD or "/" + word in HEARD)
    heard(ears, "/" + topic.lstrip("/"))
    assert world.slidectl.ok("pub", *words) == ""
    assert heard(ears, "/" + topic.lstrip("/")) == [message]


def test_now_and_auto_are_the_simulated_time(world: World, ears: dict[str, Subscription]) -> None:
    world.slidectl.ok("pub", "/js", "auto", "[slide]", "[0.1]", "[]", "[]")
    world.slidectl.ok("pub", "/ps", "{header: {stamp: now, frame_id: base}}")
    world.slidectl.ok("pub", "/tm", "now")
    (joints,), (pose,), (time,) = (heard(ears, topic) for topic in ("/js", "/ps", "/tm"))
    now = world.client.call("/rosapi/get_time")["time"]
    assert (joints["name"], joints["position"], joints["header"]["frame_id"]) == (["slide"], [0.1], "")
    assert pose["header"]["frame_id"] == "base"
    for stamp in (joints["header"]["stamp"], pose["header"]["stamp"], time["data"]):
        assert (0, 0) < (stamp["secs"], stamp["nsecs"]) <= (now["secs"], now["nsecs"])


def test_a_command_moves_the_set_point_and_returns_when_it_has(world: World) -> None:
    world.slidectl.ok("pub", "command", "0.25")
    state = json.loads(world.slidectl.ok("echo", "joint1_position_controller/state", "-n", "1", "--json"))
    assert state["set_point"] == 0.25


def test_json_says_who_got_it(world: World) -> None:
    record = json.loads(world.slidectl.ok("pub", "command", "0.5", "--json"))
    assert record == {"topic": COMMAND, "type": "std_msgs/Float64", "published": 1, "subscribers": ["/gazebo"]}


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["comand", "1.0"], 1, f"no topic 'comand'. Did you mean '{COMMAND}'?"),
        (["joint_states", "1.0"], 1, "nobody subscribes to /slider/joint_states"),
        (["/new/topic", "std_msgs/Float64", "1.0"], 1, "--allow-unheard"),
        (["/new/topic", "1.0", "--allow-unheard"], 2, "give its TYPE"),
        (["/new/topic", "std_msgs/Nope", "1.0", "--allow-unheard"], 1, "std_msgs/Nope"),
        (["command", ".nan"], 1, "it must be a finite number, not nan"),
        (["command", "abc"], 2, "data must be a number (float64), not the text 'abc'"),
        (["command", "value: 1.0"], 2, "no field 'value'"),
        (["command", "1.0", "2.0"], 2, "too many arguments: 2 given, 1 expected"),
        (["/pt", "1", "2"], 2, "not enough arguments: 2 given, 3 expected"),
        (["/ps", "{pose: {position: {q: 1.0}}}"], 2, "no field 'pose.position.q'"),
        (["/js", "{name: slide}"], 2, "name must be a list (string[])"),
        (["/u8", "300"], 2, "data must be"),
        (["/s", "5"], 2, "data must be text (string)"),
        (["/e", "1"], 2, "too many arguments"),
        (["command", "data: [1"], 2, "not valid YAML"),
        (["command", "std_msgs/String", "hello"], 2, f"{COMMAND} has the type std_msgs/Float64, not std_msgs/String"),
        (["command"], 2, "it has the fields: data"),
        (["command", "-1", "-r", "5", "1.0"], 2, "-1 and -r exclude each other"),
        (["command", "-r", "0", "1.0"], 2, "0 is not above 0"),
        (["command", "-n", "0", "1.0"], 2, "0 is not in the range"),
        (["command", "-r", "10", "sin(q)"], 2, "no name 'q'"),
        (["command", "-r", "10", "1/i"], 1, "cannot compute '1/i'"),
        (["command", "sin(t)"], 2, "not the text 'sin(t)'"),
        (["command", "1.0", "-f", "x.yaml"], 2, "a VALUE and -f or --stdin exclude"),
        (["/new", "std_msgs/Float64", "1", "-f", "x", "--allow-unheard"], 2, "a VALUE and -f or --stdin exclude"),
        (["command", "-f", "x.yaml", "--stdin"], 2, "-f and --stdin exclude each other"),
        (["command", "-f", "/no/file.yaml"], 2, "/no/file.yaml: no such file"),
        ([], 2, "Missing argument"),
        (["-1"], 2, "no TOPIC given"),
        (["command", "1.0", "--bogus"], 2, "No such option"),
    ],
)
def test_what_cannot_be_published_is_refused_with_the_reason(
    world: World, ears: dict[str, Subscription], words: list[str], code: int, said: str
) -> None:
    assert ears
    done = world.slidectl("pub", *words)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) <= 3


def test_two_robots_make_a_short_name_ambiguous() -> None:
    with slider_world() as world:
        world.spawn("other")
        done = world.slidectl("pub", "command", "1.0")
        assert done.returncode == 2
        assert "/other/joint1_position_controller/command" in done.stderr
        world.slidectl.ok("--ns", "/other", "pub", "command", "1.0")
        world.slidectl.ok("pub", "other/joint1_position_controller/command", "1.0")


def test_allow_unheard_publishes_to_nobody_on_a_new_topic(world: World) -> None:
    record = json.loads(world.slidectl.ok("pub", "new", "std_msgs/Float64", "1.0", "--allow-unheard", "--json"))
    assert record == {"topic": "/new", "type": "std_msgs/Float64", "published": 1, "subscribers": []}


def test_a_rate_evaluates_expressions_anew_for_each_message(world: World, ears: dict[str, Subscription]) -> None:
    world.slidectl.ok("pub", "/f", "-r", "200", "-n", "20", "sin(2*pi*t) + i")
    expected = [math.sin(2 * math.pi * (i / 200)) + i for i in range(20)]
    assert [message["data"] for message in heard(ears, "/f")] == expected


@pytest.mark.parametrize("expression", ["-sin(t)", "-2*t", "-(t + 1)", "-.5*i"])
def test_an_expression_may_begin_with_a_minus(world: World, ears: dict[str, Subscription], expression: str) -> None:
    world.slidectl.ok("pub", "/f", "-r", "500", "-n", "2", expression)
    assert len(heard(ears, "/f")) == 2


def test_a_rate_that_is_not_reached_is_told(world: World, ears: dict[str, Subscription]) -> None:
    assert ears
    done = world.slidectl("pub", "/f", "-r", "1e9", "-n", "200", "1.0")
    assert done.returncode == 0
    assert "instead of 1e+09 Hz" in done.stderr
    assert len(heard(ears, "/f")) == 200


def test_ctrl_c_ends_a_rate_with_exit_code_130(world: World, ears: dict[str, Subscription]) -> None:
    heard(ears, "/f")
    with world.running("pub", "/f", "-r", "20", "9.5") as process:
        assert ears["/f"].get(20) == {"data": 9.5}
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (130, "")
    heard(ears, "/f")


def test_when_the_daemon_dies_during_a_rate_the_exit_code_is_3() -> None:
    with slider_world() as world:
        ear = world.client.subscribe(COMMAND)
        with world.running("pub", "command", "-r", "1", "0.5") as process:
            ear.get(20)
            assert world.daemon.pid is not None
            os.kill(world.daemon.pid, signal.SIGKILL)
            _, errors = process.communicate(timeout=20)
        assert process.returncode == 3
        assert "the daemon went away" in errors


@pytest.mark.parametrize(
    "text",
    ["data: 1.0\n---\ndata: 2.0\n---\n", "data: 1.0\n---\ndata: 2.0", '{"data": 1.0}\n{"data": 2}\n', "1.0\n2.0\n"],
)
def test_a_file_is_published_document_by_document(
    world: World, ears: dict[str, Subscription], tmp_path: Path, text: str
) -> None:
    file = tmp_path / "messages"
    file.write_text(text)
    world.slidectl.ok("pub", "/f", "-f", str(file))
    assert heard(ears, "/f") == [{"data": 1.0}, {"data": 2.0}]
    world.slidectl.ok("pub", "/f", "-f", str(file), "-1")
    assert heard(ears, "/f") == [{"data": 1.0}]
    assert world.slidectl("pub", "/f", "--stdin", stdin=text).returncode == 0
    assert heard(ears, "/f") == [{"data": 1.0}, {"data": 2.0}]


def test_a_single_document_of_a_file_repeats_at_a_rate(
    world: World, ears: dict[str, Subscription], tmp_path: Path
) -> None:
    (tmp_path / "one.yaml").write_text("data: i\n")
    world.slidectl.ok("pub", "/f", "-f", str(tmp_path / "one.yaml"), "-r", "200", "-n", "3")
    assert heard(ears, "/f") == [{"data": 0.0}, {"data": 1.0}, {"data": 2.0}]


def test_a_broken_file_is_named_with_its_line(world: World, ears: dict[str, Subscription], tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("data: 1.0\n---\ndata: [1\n---\n")
    done = world.slidectl("pub", "/f", "-f", str(tmp_path / "bad.yaml"))
    assert done.returncode == 2
    assert f"{tmp_path}/bad.yaml:4: not valid YAML" in done.stderr
    assert heard(ears, "/f") == []


@pytest.mark.parametrize(
    ("content", "reason"), [("", "holds no message"), ("[" * 3000 + "]" * 3000, "is nested too deeply")]
)
def test_a_file_without_a_message_is_an_error(world: World, tmp_path: Path, content: str, reason: str) -> None:
    (tmp_path / "odd.yaml").write_text(content)
    done = world.slidectl("pub", "/f", "-f", str(tmp_path / "odd.yaml"))
    assert (done.returncode, done.stderr) == (2, f"error: {tmp_path}/odd.yaml: {reason}\n")


def test_stdin_that_ends_in_nonsense_publishes_what_came_before(world: World, ears: dict[str, Subscription]) -> None:
    done = world.slidectl("pub", "/f", "--stdin", stdin="data: 1.0\n---\ndata: [2\n---\n")
    assert done.returncode == 2
    first, error, *_ = done.stderr.splitlines()
    assert first == "1 published on /f before this:"
    assert error.startswith("error: the document 2 is not valid YAML")
    assert heard(ears, "/f") == [{"data": 1.0}]


@pytest.mark.parametrize("words", [("pub", "/f", "--stdin"), ("ros", "rostopic", "pub", "/f", "std_msgs/Float64")])
def test_stdin_without_an_end_of_line_is_an_error(world: World, words: tuple[str, ...]) -> None:
    done = world.slidectl(*words, stdin="1" * (16 * 2**20))
    assert done.returncode == 2
    assert "stdin:1: a line longer than 16777216 characters" in done.stderr


@pytest.mark.parametrize("form", ["--json", "-o=text"])
def test_what_echo_prints_can_be_piped_back_into_pub(world: World, ears: dict[str, Subscription], form: str) -> None:
    message = {
        "header": {"seq": 1, "stamp": {"secs": 3, "nsecs": 7}, "frame_id": 'a "b"\nc'},
        "name": ["no", "x"],
        "position": [1e-9, None],
        "velocity": [],
        "effort": [-0.0],
    }
    world.latch("/source", "sensor_msgs/JointState", message)
    source = " ".join(world.slidectl.argv("echo", "/source", "-n", "1", *form.split("=")))
    sink = " ".join(world.slidectl.argv("pub", "/js", "--stdin"))
    heard(ears, "/js")
    subprocess.run(["bash", "-c", f"{source} | {sink}"], env=world.slidectl.environment, check=True, timeout=60)
    assert heard(ears, "/js") == [message]


def test_a_latched_message_stays_until_ctrl_c(world: World) -> None:
    with world.running("pub", "/kept", "std_msgs/String", "here", "--latch", "--allow-unheard") as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "/kept is latched; Ctrl-C ends it\n"
        assert world.slidectl.ok("echo", "/kept/data", "-n", "1") == '"here"\n---\n'
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert process.returncode == 130


def test_a_timeout_ends_a_latched_message_with_exit_code_4(world: World) -> None:
    done = world.slidectl("pub", "/kept2", "std_msgs/String", "x", "--latch", "--allow-unheard", "--timeout", "0.2")
    assert done.returncode == 4


def test_no_daemon_is_exit_code_3(world: World) -> None:
    assert world.slidectl("-i", "nowhere", "pub", "command", "1.0").returncode == 3


def test_topic_pub_is_the_same_command(world: World) -> None:
    assert world.slidectl.ok("topic", "pub", "command", "0.1") == ""


def test_everyday_publishing_loads_no_yaml_and_no_evaluator(world: World) -> None:
    script = (
        "import sys\nfrom slidectl.cli.main import run\nassert run(['pub', 'command', '1.0']) == 0\n"
        "late = {'yaml', 'rich', 'numpy', 'rosbags', 'slidectl.msgs.message_expressions', 'asyncio'}\n"
        "heavy = late & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run(
        [world.slidectl.argv()[0], "-c", script],
        env=world.slidectl.environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_a_command_to_a_controller_that_is_not_running_is_a_warning(world: World) -> None:
    world.slidectl("controller", "stop", "joint1_position_controller")
    try:
        done = world.slidectl("pub", COMMAND, "0.5")
    finally:
        world.slidectl("controller", "start", "joint1_position_controller")
    assert (done.returncode, done.stdout) == (0, "")
    start = "start it: slidectl controller start joint1_position_controller"
    idle = f"warning: /slider/joint1_position_controller is not running: the command has no effect; {start}\n"
    assert done.stderr == idle
    assert world.slidectl("pub", COMMAND, "0.5").stderr == ""


def test_a_command_beyond_the_limits_is_taken_cut_and_said(world: World) -> None:
    said = "warning: /slider/joint1_position_controller: {} is beyond the {} limit of joint 'joint1'; it gets {}\n"
    for value, side, limit in (("100", "upper", 1.0), ("100", "upper", 1.0), ("-7.5", "lower", -1.0)):
        done = world.slidectl("pub", COMMAND, value)
        assert (done.returncode, done.stderr) == (0, said.format(value, side, f"{limit:g}"))
        state = json.loads(world.slidectl.ok("echo", "joint1_position_controller/state", "-n", "1", "--json"))
        assert state["set_point"] == limit
    assert world.slidectl("pub", COMMAND, "0.5").stderr == ""


def test_an_emergency_stop_is_said_by_what_it_makes_vain(world: World) -> None:
    world.slidectl.ok("estop")
    warning = "warning: emergency stop is on: slider; slidectl estop release ends it\n"
    for words in (["pub", COMMAND, "0.5"], ["pub", COMMAND, "-r", "100", "-n", "5", "0.5"]):
        done = world.slidectl(*words)
        assert (done.returncode, done.stderr) == (0, warning)
    done = world.slidectl("wait", "joint_states/position[0]", "--above", "-9")
    assert (done.returncode, done.stderr) == (0, warning)
    world.slidectl.ok("estop", "release")
    assert world.slidectl("pub", COMMAND, "0.5").stderr == ""


def test_a_wave_beyond_the_limits_is_told_a_few_times_only(world: World) -> None:
    done = world.slidectl("pub", COMMAND, "-r", "500", "-n", "50", "100 + i")
    assert done.returncode == 0
    assert 1 <= done.stderr.count("is beyond the upper limit") <= 5
    world.slidectl.ok("pub", COMMAND, "0")


def test_the_warning_of_another_client_is_not_printed(world: World) -> None:
    """Two clients at the same time: one fails all the while, the other succeeds and hears nothing of it."""
    script = "import sys\nfrom slidectl import Client\nclient = Client(socket=sys.argv[1])\nprint('up', flush=True)\n"
    script += "while True:\n    client.call('/slider/controller_manager/load_controller', {'name': 'nobody'})\n"
    words = [world.slidectl.argv()[0], "-c", script, world.daemon.paths.socket_text]
    other = subprocess.Popen(words, env=world.slidectl.environment, stdout=subprocess.PIPE, text=True)
    with other:
        try:
            assert other.stdout is not None
            assert other.stdout.readline() == "up\n"
            for words in (
                ["controller", "stop", "joint1_position_controller"],
                ["controller", "start", "joint1_position_controller"],
                ["param", "set", "/quiet", "1"],
                ["pub", COMMAND, "0.5"],
                ["service", "call", "list_controllers"],
            ):
                done = world.slidectl(*words)
                assert (done.returncode, "nobody" in done.stderr) == (0, False), done.stderr
            done = world.slidectl("controller", "load", "joint_state_controller")
            assert "loaded already" in done.stderr
            assert "nobody" not in done.stderr
        finally:
            other.kill()


@pytest.mark.parametrize(
    ("words", "typed"),
    [
        (["pub", "command", "data:", "1.0"], "slidectl pub command 'data: 1.0'"),
        (["pub", "/f", "std_msgs/Float64", "{data:", "1.0}", "-1"], "'{data: 1.0}' -1"),
        (["pub", "/js", "name:", "[slide]", "position:", "[0.1]"], "'{name: [slide], position: [0.1]}'"),
        (
            ["service", "call", "load_controller", "name:", "joint1_position_controller"],
            "slidectl service call load_controller 'name: joint1_position_controller'",
        ),
        (
            ["ros", "rostopic", "pub", "-1", "/f", "std_msgs/Float64", "data:", "1.0"],
            "rostopic pub -1 /f std_msgs/Float64 'data: 1.0'",
        ),
        (
            ["ros", "rosservice", "call", "/slider/controller_manager/load_controller", "name:", "x"],
            "rosservice call /slider/controller_manager/load_controller 'name: x'",
        ),
        (["ros", "rosservice", "call", "/rosapi/topic_type", "{topic:", "/f}"], "'{topic: /f}'"),
    ],
)
def test_lost_quotes_are_named_with_the_line_to_type(
    world: World, ears: dict[str, Subscription], words: list[str], typed: str
) -> None:
    assert ears
    done = world.slidectl(*words)
    assert done.returncode in (1, 2)
    assert "the shell made" in done.stderr
    assert f"{typed}\n" in done.stderr
