"""`rostopic pub` in recorded sessions of the real tool: what it prints, and what a subscriber gets.

Where the real one waits (three seconds with -1, for ever without) these return when the message has been taken in.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from typing import Any

import pytest
from cli_ros_world import SINKS, SlideWorld, slide_world

from slidectl.client import Subscription

ONCE = "publishing and latching message for 3.0 seconds\n"
STAYS = "publishing and latching message. Press ctrl-C to terminate\n"
USAGE = "Usage: rostopic pub /topic type [args...]\n\nrostopic: error: "
ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}
POSE = {"position": ORIGIN, "orientation": {**ORIGIN, "w": 0.0}}
TURN = {"linear": {**ORIGIN, "x": 1.0}, "angular": {**ORIGIN, "z": 0.5}}
NO_LAYOUT = {"dim": [], "data_offset": 0}


class Sink:
    """Subscribes to all the topics that the sessions publish on."""

    def __init__(self, world: SlideWorld) -> None:
        self.world = world
        self.queues: dict[str, Subscription] = {
            topic: world.client.subscribe(topic, kind) for topic, kind in SINKS.items()
        }

    def received(self) -> list[tuple[str, dict[str, Any]]]:
        """Topic and message of all that came since the last time."""
        self.world.client.flush()
        return [(topic, queue.get()) for topic, queue in self.queues.items() for _ in range(len(queue))]


@pytest.fixture(scope="module")
def slide() -> Iterator[SlideWorld]:
    with slide_world() as world:
        yield world


@pytest.fixture(scope="module")
def all_topics(slide: SlideWorld) -> Sink:
    return Sink(slide)


@pytest.fixture
def sink(all_topics: Sink) -> Sink:
    all_topics.received()
    return all_topics


def header(**given: Any) -> dict[str, Any]:
    return {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": "", **given}


WORKING = [
    ("-1 /f std_msgs/Float64 'data: 1.0'", ("/f", {"data": 1.0})),
    ("-1 /f std_msgs/Float64 1.5", ("/f", {"data": 1.5})),
    ("--once /f std_msgs/Float64 2", ("/f", {"data": 2.0})),
    ("-1 /f std_msgs/Float64 -- -5.0", ("/f", {"data": -5.0})),
    ("-l -1 /f std_msgs/Float64 'data: 1.0'", ("/f", {"data": 1.0})),
    ("-1 /f std_msgs/Float64 1_000", ("/f", {"data": 1000.0})),
    ("-1 /f std_msgs/Float64 010", ("/f", {"data": 8.0})),
    ("-1 f std_msgs/Float64 1.0", ("/f", {"data": 1.0})),
    ("-1 /s std_msgs/String hello", ("/s", {"data": "hello"})),
    ("-1 /s std_msgs/String \"data: 'a b'\"", ("/s", {"data": "a b"})),
    ("-1 /s std_msgs/String 'data: \"a:=b\"'", ("/s", {"data": "a:=b"})),
    ("-1 /s std_msgs/String 'é'", ("/s", {"data": "é"})),
    ("-1 /pt geometry_msgs/Point 1 2 3", ("/pt", {"x": 1.0, "y": 2.0, "z": 3.0})),
    ("-1 /pt geometry_msgs/Point 'x: 1.0'", ("/pt", {**ORIGIN, "x": 1.0})),
    ("-1 /tw geometry_msgs/Twist '[1,0,0]' '[0,0,0.5]'", ("/tw", TURN)),
    ("-1 /tw geometry_msgs/Twist '{linear: {x: 1.0}, angular: {z: 0.5}}'", ("/tw", TURN)),
    ("-1 /e std_msgs/Empty", ("/e", {})),
    ("-1 /b std_msgs/Bool 1", ("/b", {"data": True})),
    ("-1 /i std_msgs/Int32 0x10", ("/i", {"data": 16})),
    (
        "-1 /p geometry_msgs/PoseStamped '{header: {stamp: {secs: 12, nsecs: 5}}}'",
        ("/p", {"header": header(seq=1, stamp={"secs": 12, "nsecs": 5}), "pose": POSE}),
    ),
    (
        "-1 /p geometry_msgs/PoseStamped '{header: {stamp: 1500000000}}'",
        ("/p", {"header": header(seq=1, stamp={"secs": 1, "nsecs": 500000000}), "pose": POSE}),
    ),
    ("-1 /a std_msgs/Float64MultiArray '{data: [1.0, 2]}'", ("/a", {"layout": NO_LAYOUT, "data": [1.0, 2.0]})),
    ("-1 /u8a std_msgs/UInt8MultiArray '{data: [1, 2, 255]}'", ("/u8a", {"layout": NO_LAYOUT, "data": "AQL/"})),
    # a person's numbers, and a text that looks like a remapping
    ("-1 /f std_msgs/Float64 -5.0", ("/f", {"data": -5.0})),
    ("-1 /f std_msgs/Float64 -1", ("/f", {"data": -1.0})),
    ("-1 /f std_msgs/Float64 1e-3", ("/f", {"data": 0.001})),
    ("-1 /f std_msgs/Float64 -.5", ("/f", {"data": -0.5})),
    ("-1 --use-rostime /s std_msgs/String hello", ("/s", {"data": "hello"})),
    ("/f std_msgs/Float64 1.0 --once", ("/f", {"data": 1.0})),
    (
        "-1 /j sensor_msgs/JointState '{position: [0.5]}'",
        ("/j", {"header": header(seq=1), "name": [], "position": [0.5], "velocity": [], "effort": []}),
    ),
    ("-1 /s std_msgs/String '{data: }'", ("/s", {"data": ""})),
    ("-1l /f std_msgs/Float64 1.0", ("/f", {"data": 1.0})),
    (
        "-1 /p geometry_msgs/PoseStamped '{header: {frame_id: null}}'",
        ("/p", {"header": header(seq=1), "pose": POSE}),
    ),
    ("-1 /s std_msgs/String 'a:=b' __name:=x", ("/s", {"data": "a:=b"})),
]


@pytest.mark.parametrize(("words", "message"), WORKING, ids=[words for words, _ in WORKING])
def test_the_forms_of_a_message(sink: Sink, words: str, message: tuple[str, Any]) -> None:
    done = sink.world(f"rostopic pub {words}")
    assert (done.stdout, done.stderr, done.returncode) == (ONCE, "", 0)
    assert sink.received() == [message]


ARGS_OF_A_POSE = (
    "Args are: [header.seq header.stamp header.frame_id pose.position.x pose.position.y pose.position.z "
    "pose.orientation.x pose.orientation.y pose.orientation.z pose.orientation.w]"
)
ARGS_OF_A_TWIST = "Args are: [linear.x linear.y linear.z angular.x angular.y angular.z]"
ROSMAKE = "If this is a valid message type, perhaps you need to type"
MISFITS = [
    ("-1 /f std_msgs/Float64 'value: 1.0'", "No field name [value]\n\nArgs are: [data]"),
    (
        "-1 /f std_msgs/Float64 1.0 2.0",
        "Too many arguments:\n * Given: [1.0, 2.0]\n * Expected: ['data']\n\nArgs are: [data]",
    ),
    (
        "-1 /pt geometry_msgs/Point 1 2",
        "Not enough arguments:\n * Given: [1, 2]\n * Expected: ['x', 'y', 'z']\n\nArgs are: [x y z]",
    ),
    (
        "-1 /pt geometry_msgs/Point '[1,2,3]'",
        "Not enough arguments:\n * Given: [[1, 2, 3]]\n * Expected: ['x', 'y', 'z']\n\nArgs are: [x y z]",
    ),
    (
        "-1 /j sensor_msgs/JointState '{name: slide}'",
        "Field [name] must be a list or tuple instead of: str\n\n"
        "Args are: [header.seq header.stamp header.frame_id name position velocity effort]",
    ),
    ("-1 /p geometry_msgs/PoseStamped '{header: foo}'", f"No key named [foo]\n\n{ARGS_OF_A_POSE}"),
    (
        "-1 /p geometry_msgs/PoseStamped '{pose: {position: {q: 1.0}}}'",
        f"No field name [pose.position.q]\n\n{ARGS_OF_A_POSE}",
    ),
    (
        "-1 /h std_msgs/Header auto",
        "Not enough arguments:\n * Given: ['auto']\n * Expected: ['seq', 'stamp', 'frame_id']\n\n"
        "Args are: [seq stamp frame_id]",
    ),
    ("-1 /e std_msgs/Empty 1", "Too many arguments:\n * Given: [1]\n * Expected: []\n\nArgs are: []"),
    ("-1 /s std_msgs/String 'a: b'", "No field name [a]\n\nArgs are: [data]"),
    (
        "-1 /j sensor_msgs/JointState '{name: {a: b}}'",
        "Field [name] must be a list or tuple instead of: dict\n\n"
        "Args are: [header.seq header.stamp header.frame_id name position velocity effort]",
    ),
    ("-1 /f std_msgs/Nope 1.0", f"invalid message type: std_msgs/Nope.\n{ROSMAKE} 'rosmake std_msgs'"),
    ("-1 /f nopkg/Float64 1.0", f"invalid message type: nopkg/Float64.\n{ROSMAKE} 'rosmake nopkg'"),
    ("-1 /f Float64 1.0", "invalid topic type: Float64\ntype: rostopic pub /f std_msgs/Float64 VALUE"),
    (
        "-1 /f std_msgs/String hello",
        "topic types do not match: [std_msgs/Float64] vs. [std_msgs/String]\n"
        "type: rostopic pub /f std_msgs/Float64 VALUE",
    ),
    (
        "-1 /p geometry_msgs/PoseStamped '{header: {stamp: {secs: -1}}}'",
        "geometry_msgs/PoseStamped: header.stamp must be a time of 0 to 4294967295 seconds, not the number -1",
    ),
    ("-1 /tw geometry_msgs/Twist 'linear: '", f"No key named []\n\n{ARGS_OF_A_TWIST}"),
    ("-1 -f /nofile.yaml /f std_msgs/Float64", "file does not exist: /nofile.yaml"),
]


@pytest.mark.parametrize(("words", "text"), MISFITS, ids=[words for words, _ in MISFITS])
def test_a_message_that_does_not_fit_is_an_error_of_genpy(sink: Sink, words: str, text: str) -> None:
    done = sink.world(f"rostopic pub {words}")
    assert (done.stdout, done.stderr, done.returncode) == ("", f"ERROR: {text}\n", 1)
    assert sink.received() == []


WRONG_TYPES = [
    ("/f std_msgs/Float64 abc", "field data must be float type"),
    ("/f std_msgs/Float64 'data:1.0'", "field data must be float type"),
    ("/f std_msgs/Float64 nan", "field data must be float type"),
    ("/s std_msgs/String ''", "field data must be of type bytes or an ascii string"),
    ("/s std_msgs/String 5", "field data must be of type bytes or an ascii string"),
    ("/s std_msgs/String 'data: 5'", "field data must be of type bytes or an ascii string"),
    ("/s std_msgs/String '# comment'", "field data must be of type bytes or an ascii string"),
    ("/u8 std_msgs/UInt8 300", "field data exceeds specified width [uint8]"),
    ("/i std_msgs/Int32 1.5", "field data must be an integer type"),
    ("/i std_msgs/Int32 99999999999", "field data exceeds specified width [int32]"),
    ("/j sensor_msgs/JointState '{position: [a, b]}'", "field position[] must be float type"),
    ("/b std_msgs/Bool 'data: 7'", "field data is not a bool"),
]


@pytest.mark.parametrize(("words", "text"), WRONG_TYPES, ids=[words for words, _ in WRONG_TYPES])
def test_a_value_of_a_wrong_type_is_said_before_anything_is_sent(sink: Sink, words: str, text: str) -> None:
    done = sink.world(f"rostopic pub {words}")
    first, second = done.stderr.splitlines()[:2]
    assert first == "ERROR: Unable to publish message. One of the fields has an incorrect type:"
    assert second == f"  {text}"
    assert (done.stdout, done.returncode) == ("", 1)
    assert sink.received() == []


def test_the_definition_stands_behind_a_wrong_type(sink: Sink) -> None:
    done = sink.world("rostopic pub -r 5 /f std_msgs/Float64 'data: abc'")
    assert done.stderr.endswith("  field data must be float type\n\nmsg file:\nfloat64 data\n")


AS_IN = "as in: rostopic pub /TOPIC std_msgs/Float64 'data: 1.0'"
USAGES = [
    ("", f"/topic must be specified, {AS_IN}"),
    ("/f", f"topic type must be specified, {AS_IN}"),
    ("-1 -r 5 /f std_msgs/Float64 1.0", "You cannot select both -r and -1 (--once)"),
    ("-r x /f std_msgs/Float64 1.0", "rate must be a number"),
    ("-r 0 /f std_msgs/Float64 1.0", "rate must be greater than zero"),
    ("-r -1 /f std_msgs/Float64 1.0", "rate must be greater than zero"),
    ("-r nan /f std_msgs/Float64 1.0", "rate must be greater than zero"),
    ("-f x.yaml /f std_msgs/Float64 1.0", "args conflict with -f setting"),
    ("-z /f std_msgs/Float64 1.0", "no such option: -z"),
    (
        "-1 /s std_msgs/String 2020-01-01",
        "Argument error: 2020-01-01 in the value '2020-01-01' is a date to YAML\nwrite it in quotes if it is text",
    ),
    (
        "-1 /f std_msgs/Float64 'data: [1'",
        "Argument error: while parsing a flow sequence\n"
        '  in "<unicode string>", line 1, column 7:\n    data: [1\n          ^\n'
        "expected ',' or ']', but got '<stream end>'\n"
        '  in "<unicode string>", line 1, column 9:\n    data: [1\n            ^',
    ),
]


@pytest.mark.parametrize(("words", "text"), USAGES, ids=[words for words, _ in USAGES])
def test_wrong_usage_is_said_as_optparse_says_it(sink: Sink, words: str, text: str) -> None:
    done = sink.world(f"rostopic pub {words}")
    assert (done.stdout, done.stderr, done.returncode) == ("", f"{USAGE}{text}\n", 2)


def test_now_and_auto_are_the_simulated_time(sink: Sink) -> None:
    before = sink.world.client.call("/rosapi/get_time")["time"]
    for words in (
        "/j sensor_msgs/JointState '{header: auto, name: [slide, latch], position: [0.1, 0.2]}'",
        "/j sensor_msgs/JointState auto '[slide, latch]' '[0.1, 0.2]' '[]' '[]'",
        "/p geometry_msgs/PoseStamped '{header: {stamp: now, frame_id: base}}'",
        "/h std_msgs/Header '{stamp: now, frame_id: base}'",
        "/tm std_msgs/Time now",
        "/tm std_msgs/Time '{data: now}'",
    ):
        assert sink.world(f"rostopic pub -1 {words}").returncode == 0
        ((topic, message),) = sink.received()
        stamp = message["data"] if topic == "/tm" else message.get("header", message)["stamp"]
        after = sink.world.client.call("/rosapi/get_time")["time"]
        assert (before["secs"], before["nsecs"]) <= (stamp["secs"], stamp["nsecs"]) <= (after["secs"], after["nsecs"])


def test_without_once_it_returns_all_the_same_and_says_so(sink: Sink) -> None:
    done = sink.world("rostopic pub /f std_msgs/Float64 'data: 1.0'")
    assert (done.stdout, done.returncode) == (STAYS, 0)
    assert done.stderr.startswith("received by /slidectl_")
    assert sink.received() == [("/f", {"data": 1.0})]


def test_verbose_shows_the_whole_message(sink: Sink) -> None:
    done = sink.world("rostopic pub -1 -v /f std_msgs/Float64 1.0e-3")
    assert done.stdout == "publishing and latching [data: 0.001] for 3.0 seconds\n"
    done = sink.world("rostopic pub -1 -v /pt geometry_msgs/Point 'y: 2'")
    assert done.stdout == "publishing and latching [x: 0.0\ny: 2.0\nz: 0.0] for 3.0 seconds\n"


def test_a_topic_that_nobody_subscribes_to_is_an_error(slide: SlideWorld) -> None:
    for words in ("-1 /lonely std_msgs/Float64 1.0", "/lonely std_msgs/Float64 1.0"):
        done = slide(f"rostopic pub {words}")
        assert done.returncode == 1
        assert "no topic '/lonely'" in done.stderr
    assert "no topic '/bad name!'" in slide("rostopic pub -1 'bad name!' std_msgs/Float64 1.0").stderr
    done = slide("rostopic pub /lonely std_msgs/Float64", stdin="data: 1.0\n---\n")
    assert (done.stdout, done.returncode) == (ONCE, 1)
    done = slide("ROS_NAMESPACE=ns rostopic pub -1 f std_msgs/Float64 1.0")
    assert done.returncode == 1
    assert "'/ns/f'" in done.stderr


def test_l_stays_and_keeps_the_message_for_those_who_come_later(slide: SlideWorld) -> None:
    staying = slide.shell.slidectl.start("ros", "rostopic", "pub", "-l", "/late", "std_msgs/Float64", "1.0")
    assert staying.stdout is not None
    assert staying.stderr is not None
    assert staying.stdout.readline() == STAYS
    assert "latched" in staying.stderr.readline()
    assert slide.client.subscribe("/late").get(30.0) == {"data": 1.0}
    staying.send_signal(signal.SIGINT)
    staying.communicate(timeout=30)
    assert staying.returncode == 130


def publishing(sink: Sink, words: str, topic: str, count: int) -> tuple[list[dict[str, Any]], str]:
    """Starts `rostopic pub`, takes so many messages, ends it with Ctrl-C; the messages, and what it printed."""
    process = sink.world.shell.slidectl.start("ros", "rostopic", "pub", *words.split("|"))
    messages = [sink.queues[topic].get(30.0) for _ in range(count)]
    process.send_signal(signal.SIGINT)
    stdout, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    sink.received()
    return messages, stdout


def test_a_rate_repeats_the_message_until_it_is_interrupted(sink: Sink) -> None:
    messages, stdout = publishing(sink, "-r|50|/f|std_msgs/Float64|data: 1.0", "/f", 4)
    assert messages == [{"data": 1.0}] * 4
    assert stdout == ""


def test_verbose_with_a_rate_shows_each_message(sink: Sink) -> None:
    _, stdout = publishing(sink, "-r|50|-v|/f|std_msgs/Float64|data: 1.0", "/f", 4)
    assert stdout.startswith("publishing data: 1.0\n" * 4)


def test_stamps_stay_those_of_the_first_message_unless_they_are_to_be_renewed(sink: Sink) -> None:
    messages, _ = publishing(sink, "-r|50|/p|geometry_msgs/PoseStamped|{header: auto}", "/p", 4)
    assert len({str(message["header"]["stamp"]) for message in messages}) == 1
    assert [message["header"]["seq"] for message in messages] == [1, 2, 3, 4]
    messages, _ = publishing(sink, "-s|-r|50|/p|geometry_msgs/PoseStamped|{header: auto}", "/p", 4)
    # A publisher that was held up sends two messages in one simulated millisecond to keep its rate.
    assert len({str(message["header"]["stamp"]) for message in messages}) > 1


@pytest.fixture
def files(tmp_path: Any) -> Any:
    for name, text in {
        "one.yaml": "data: 3.25\n",
        "three.yaml": "data: 1.0\n---\ndata: 2.0\n---\ndata: 3.0\n",
        "bad.yaml": "data: [1\n",
        "badfield.yaml": "value: 1.0\n",
        "empty.yaml": "",
        "list.yaml": "[[1.0]]\n",
        "pose.yaml": "header: {stamp: now, frame_id: base}\npose: {position: {x: 1.0}}\n",
    }.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def test_a_file_with_one_document_is_published_again_and_again(sink: Sink, files: Any) -> None:
    for rate in ("", "-r|50|"):
        messages, stdout = publishing(sink, f"{rate}-f|{files}/one.yaml|/f|std_msgs/Float64", "/f", 2)
        assert messages == [{"data": 3.25}] * 2
        assert stdout == "Got one message and a rate, publishing repeatedly\n"


def test_a_file_is_published_document_by_document(sink: Sink, files: Any) -> None:
    done = sink.world("rostopic pub -r 50 -f three.yaml /f std_msgs/Float64", cwd=files)
    assert (done.stdout, done.stderr, done.returncode) == (ONCE * 3, "", 0)
    assert sink.received() == [("/f", {"data": value}) for value in (1.0, 2.0, 3.0)]


def test_l_with_a_rate_publishes_all_documents_of_a_file(sink: Sink, files: Any) -> None:
    done = sink.world("rostopic pub -l -r 50 -f three.yaml /f std_msgs/Float64", cwd=files)
    assert (done.stdout, done.returncode) == (ONCE * 3, 0)
    assert [message["data"] for _, message in sink.received()] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(("name", "value"), [("one", 3.25), ("three", 1.0)])
def test_once_publishes_the_first_document_of_a_file(sink: Sink, files: Any, name: str, value: float) -> None:
    done = sink.world(f"rostopic pub -1 -f {name}.yaml /f std_msgs/Float64", cwd=files)
    assert (done.stdout, done.stderr, done.returncode) == (ONCE, "", 0)
    assert sink.received() == [("/f", {"data": value})]


@pytest.mark.parametrize(("name", "value"), [("one", 3.25), ("three", 1.0)])
def test_l_keeps_the_first_document_of_a_file_latched(slide: SlideWorld, files: Any, name: str, value: float) -> None:
    words = ("ros", "rostopic", "pub", "-l", "-f", f"{files}/{name}.yaml", f"/latched_{name}", "std_msgs/Float64")
    staying = slide.shell.slidectl.start(*words)
    assert staying.stdout is not None
    assert staying.stderr is not None
    assert staying.stdout.readline() == STAYS
    assert "is latched" in staying.stderr.readline()
    assert slide.client.subscribe(f"/latched_{name}").get(30.0) == {"data": value}
    staying.send_signal(signal.SIGINT)
    staying.communicate(timeout=30)
    assert staying.returncode == 130


def test_now_in_a_file_is_the_simulated_time(sink: Sink, files: Any) -> None:
    done = sink.world("rostopic pub -1 -f pose.yaml /p geometry_msgs/PoseStamped", cwd=files)
    assert (done.stdout, done.stderr, done.returncode) == (ONCE, "", 0)
    ((_, message),) = sink.received()
    assert message["header"]["frame_id"] == "base"
    assert message["header"]["stamp"]["secs"] + message["header"]["stamp"]["nsecs"] > 0
    assert message["pose"]["position"]["x"] == 1.0


@pytest.mark.parametrize(("name", "why"), [("", "is a folder, and only"), ("binary", "is not text in UTF-8: ")])
def test_a_file_that_cannot_be_read_is_named(sink: Sink, files: Any, name: str, why: str) -> None:
    (files / "binary").write_bytes(b"\xff\xfe")
    done = sink.world(f"rostopic pub -f {files}/{name} /f std_msgs/Float64")
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr.startswith(f"ERROR: cannot read {files}/{name}: {why}")


def test_a_file_that_is_no_yaml_is_reported_with_its_name_and_place(sink: Sink, files: Any) -> None:
    done = sink.world("rostopic pub -f bad.yaml /f std_msgs/Float64", cwd=files)
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr == (
        'ERROR: invalid YAML in file: while parsing a flow sequence\n  in "bad.yaml", line 1, column 7\n'
        "expected ',' or ']', but got '<stream end>'\n  in \"bad.yaml\", line 2, column 1\n"
    )


def test_documents_of_a_file_that_do_not_fit(sink: Sink, files: Any) -> None:
    got_one = "Got one message and a rate, publishing repeatedly\n"
    done = sink.world("rostopic pub -f badfield.yaml /f std_msgs/Float64", cwd=files)
    assert (done.stdout, done.returncode) == (got_one, 1)
    assert done.stderr == "ERROR: No field name [value]\n\nArgs are: [data]\n"
    for text in ("[[1.0]]\n", "[1.0]\n"):
        (files / "list.yaml").write_text(text)
        done = sink.world("rostopic pub -f list.yaml /f std_msgs/Float64", cwd=files)
        assert (done.stdout, done.returncode) == (got_one, 1)
        assert "  field data must be float type\n" in done.stderr
    done = sink.world("rostopic pub -f empty.yaml /f std_msgs/Float64", cwd=files)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)


def test_stdin_gives_one_message_for_each_document(sink: Sink) -> None:
    done = sink.world("rostopic pub -r 50 /f std_msgs/Float64", stdin="data: 5.0\n---\n\n---\ndata: 6.0\n---\n")
    assert (done.stdout, done.stderr, done.returncode) == (ONCE * 2, "", 0)
    assert sink.received() == [("/f", {"data": 5.0}), ("/f", {"data": 6.0})]
    done = sink.world("rostopic pub -1 /f std_msgs/Float64", stdin="data: 5.0\n---\ndata: 6.0\n---\n")
    assert (done.stdout, sink.received()) == (ONCE, [("/f", {"data": 5.0})])


def test_the_last_document_on_stdin_needs_no_end(sink: Sink) -> None:
    assert sink.world("rostopic pub /f std_msgs/Float64", stdin="data: 5.0\n").stdout == ONCE
    assert sink.received() == [("/f", {"data": 5.0})]


def test_no_document_on_stdin_is_nothing_to_do(sink: Sink) -> None:
    done = sink.world("rostopic pub -1 /f std_msgs/Float64 < /dev/null")
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)
    assert sink.received() == []


def test_a_document_on_stdin_that_is_no_yaml(sink: Sink) -> None:
    done = sink.world("rostopic pub /f std_msgs/Float64", stdin="data: [1\n---\ndata: 7\n---\n")
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr == (
        'Invalid YAML: while parsing a flow sequence\n  in "<unicode string>", line 1, column 7:\n    data: [1\n'
        "          ^\nexpected ',' or ']', but got '<stream end>'\n"
        '  in "<unicode string>", line 1, column 9:\n    data: [1\n            ^\n'
    )


def test_echo_can_be_piped_into_pub(sink: Sink) -> None:
    done = sink.world("rostopic echo -n 2 /slide/position | rostopic pub -r 50 /f std_msgs/Float64")
    assert (done.stdout, done.returncode) == (ONCE * 2, 0)
    assert sink.received() == [("/f", {"data": 0.0})] * 2


def test_no_values_on_a_terminal_are_wrong_usage(slide: SlideWorld) -> None:
    output = slide.shell.slidectl.on_a_terminal("ros", "rostopic", "pub", "/f", "std_msgs/Float64").decode()
    assert "rostopic: error: Please specify message values" in output
