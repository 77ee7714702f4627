"""Recording, playing and reading recordings, with real daemons, processes and files."""

from __future__ import annotations

import csv
import inspect
import itertools
import json
import shutil
import signal
import subprocess
import sys
import zlib
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from command_line import CommandLine
from daemon_fixture import running_daemon
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Reader, Writer, reader, writer
from rosbags.typesys import Stores, get_typestore
from waiting import eventually

from slidectl import msgs
from slidectl.errors import BadFile
from slidectl.extensions.recording import codec, recording_files
from slidectl.extensions.recording.recording_files import BadRecording, create, opened

COMMAND = "/slider/joint1_position_controller/command"
STATES = "/slider/joint_states"
ROSBAG = shutil.which("rosbag")


@pytest.fixture(scope="module")
def slider() -> Iterator[CommandLine]:
    """A paused world with the slider under its position controller."""
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        spawn_slider(slidectl)
        yield slidectl


def spawn_slider(slidectl: CommandLine) -> None:
    started = ("--start", "joint_state_controller", "joint1_position_controller")
    slidectl.ok("spawn", "slider", "--controllers", "config/slider_control.yaml", *started)


class Recorder:
    """`slidectl record` in the background, from when it says that it records."""

    def __init__(self, slidectl: CommandLine, *words: str, limit: str = "") -> None:
        argv = slidectl.argv("record", *words)
        if limit:
            argv = ["bash", "-c", f'ulimit -f {limit}; exec "$@"', "bash", *argv]
        self.process = subprocess.Popen(
            argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=slidectl.environment
        )
        assert self.process.stderr is not None
        self.said = ""
        while "recording" not in self.said:
            line = self.process.stderr.readline()
            assert line, self.said
            self.said += line

    def end(self, number: int = signal.SIGTERM) -> subprocess.CompletedProcess[str]:
        self.process.send_signal(number)
        return self.ended()

    def ended(self) -> subprocess.CompletedProcess[str]:
        stdout, stderr = self.process.communicate(timeout=60)
        return subprocess.CompletedProcess([], self.process.returncode, stdout, self.said + stderr)


def recorded(slidectl: CommandLine, path: Path, *topics: str) -> None:
    """One command and a second of simulated time, from 0 on."""
    recorder = Recorder(slidectl, *topics, "-O", str(path))
    slidectl.ok("pub", COMMAND, "1.0")
    slidectl.ok("sim", "step", "1s")
    done = recorder.end()
    assert done.returncode == 0, done.stderr


def messages(path: Path) -> list[tuple[str, int, Any]]:
    with opened(path) as recording:
        return [(one.channel.topic, one.time_ns, recording.message(one)) for one in recording.records()]


def messages_so_far(path: Path) -> list[tuple[str, int, Any]]:
    try:
        return messages(path)
    except BadRecording:
        return []


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_recording_holds_every_message_with_its_simulated_time(
    slider: CommandLine, tmp_path: Path, suffix: str
) -> None:
    slider.ok("sim", "reset")
    path = tmp_path / f"run{suffix}"
    recorded(slider, path, STATES, COMMAND, "/tf_static")
    found = messages(path)
    states = [(time_ns, message) for topic, time_ns, message in found if topic == STATES]
    assert len(states) in (49, 50)  # at 50 Hz, as the phase is
    for time_ns, message in states:
        stamp = message["header"]["stamp"]
        assert stamp["secs"] * 10**9 + stamp["nsecs"] == time_ns
    assert [b - a for (a, _), (b, _) in itertools.pairwise(states)] == (len(states) - 1) * [20_000_000]
    assert [message for topic, _, message in found if topic == COMMAND] == [{"data": 1.0}]
    record = json.loads(slider.ok("bag", "info", str(path), "--json"))
    assert (record["messages"], record["damage"]) == (len(states) + 2, None)
    assert [(one["topic"], one["messages"], one["latching"]) for one in record["topics"]] == [
        (COMMAND, 1, False),
        (STATES, len(states), False),
        ("/tf_static", 1, True),
    ]


def test_all_topics_are_recorded_also_those_that_come_later(tmp_path: Path) -> None:
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        recorder = Recorder(slidectl, "-a", "-x", "/gazebo/.*", "-O", str(tmp_path / "all"))
        spawn_slider(slidectl)
        slidectl.until_subscribed(STATES)
        slidectl.ok("sim", "step", "100ms")
        done = recorder.end(signal.SIGINT)
        assert done.returncode == 0
        topics = {topic for topic, _, _ in messages(tmp_path / "all.bag")}
        assert {"/clock", STATES, "/tf_static"} <= topics
        assert not any(topic.startswith("/gazebo/") for topic in topics)


def test_a_recording_of_the_commands_gives_the_same_bits_again(tmp_path: Path) -> None:
    """The commands come at any moment; played at their times into a new world they make the same motion."""
    path, again = tmp_path / "run.mcap", tmp_path / "again.mcap"
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        spawn_slider(slidectl)
        recorder = Recorder(slidectl, STATES, COMMAND, "-O", str(path))
        for number, step in enumerate((37, 112, 250, 1)):
            slidectl.ok("pub", COMMAND, str(0.3 * number))
            slidectl.ok("sim", "step", str(step))
        assert recorder.end().returncode == 0
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        spawn_slider(slidectl)
        recorder = Recorder(slidectl, STATES, COMMAND, "-O", str(again))
        player = slidectl("play", str(path), "--topic", COMMAND, "--at-recorded-times", "--detach")
        assert "nothing is played until it goes on" in player.stderr
        assert (player.returncode, player.stdout.strip().isdigit()) == (0, True)
        slidectl.ok("sim", "step", "400")
        assert recorder.end().returncode == 0
        slidectl.ok("daemon", "stop")  # returns when the playing has ended too
        [log] = runtime.folder.glob("slidectl/default/playing-*.log")
        assert log.read_text() == "played 4 messages on 1 topic, 0.399 s\n"
    assert messages(again) == messages(path)


def test_playing_keeps_the_distances_on_other_topics_and_at_other_rates(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    recorded(slider, tmp_path / "run.bag", STATES)
    recorder = Recorder(slider, "/copy", "-O", str(tmp_path / "copy.bag"))
    assert "/copy has no publisher yet" in recorder.said
    player = slider.start(
        "play",
        str(tmp_path / "run.bag"),
        "joint_states:=/copy",
        "-r",
        "2",
        "--start",
        "0.5",
        "--until",
        "0.7",
        "--json",
    )
    with slider.client() as client:
        eventually(lambda: "/copy" in client.topics(), "nobody publishes /copy")
    slider.until_subscribed("/copy")
    slider.ok("sim", "step", "300")
    stdout, _ = player.communicate(timeout=60)
    assert json.loads(stdout) == {"published": 10, "late": 0, "refused": 0, "topics": ["/copy"], "seconds": 0.09}
    recorder.end()
    times = [time_ns for _, time_ns, _ in messages(tmp_path / "copy.bag")]
    assert [b - a for a, b in itertools.pairwise(times)] == 9 * [10_000_000]


def test_a_topic_that_is_not_in_the_recording_gets_no_other_name(slider: CommandLine, tmp_path: Path) -> None:
    recorded(slider, tmp_path / "run.bag", STATES)
    done = slider("play", str(tmp_path / "run.bag"), "/slidr/joint_states:=/elsewhere")
    assert (done.returncode, done.stdout) == (1, "")
    assert "no topic '/slidr/joint_states'" in done.stderr
    assert STATES in done.stderr


def test_what_is_refused_is_counted_and_fails(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    with slider.client() as client:
        client.advertise("/narrow", "std_msgs/Float32")
        client.flush()
        recorded(slider, tmp_path / "run.bag", COMMAND)
        for other in (STATES, "/narrow"):
            player = slider.start("play", str(tmp_path / "run.bag"), f"{COMMAND}:={other}", "--loop", "--json")
            client.step(seconds=1.0)
            while player.poll() is None:  # the daemon may have got the message after the steps
                client.step(seconds=0.1)
            stdout, stderr = player.communicate(timeout=60)
            record = json.loads(stdout)
            assert (player.returncode, record["published"], record["refused"]) == (1, 0, 1)
            assert "1 messages were refused" in stderr
            assert "std_msgs/Float64" in stderr or "data" in stderr


def test_a_part_without_messages_is_said_to_be_empty(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    recorded(slider, tmp_path / "run.bag", STATES)
    done = slider("play", str(tmp_path / "run.bag"), "--start", "1e6")
    assert "no messages in this part; the recording is 0.9" in done.stderr
    assert done.stdout == "played 0 messages on 0 topics, 0.000 s\n"


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_recorder_that_is_killed_leaves_what_came_before(slider: CommandLine, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"killed{suffix}"
    slider.ok("sim", "reset")
    recorder = Recorder(slider, STATES, "-O", str(path))
    slider.ok("sim", "step", "1s")
    eventually(lambda: len(messages_so_far(path)) >= 49)  # it puts what it has into the file each second
    slider.ok("sim", "step", "20ms")
    held = slider("bag", "reindex", str(path))
    assert (held.returncode, f"{path} is being recorded" in held.stderr) == (1, True)
    update = ("bag", "diff", str(path), str(tmp_path / "baselines"), "--update-baseline")
    assert f"{path} is being recorded" in slider(*update).stderr
    recorder.end(signal.SIGKILL)
    assert f"{path} cannot be a baseline: it was not closed" in slider(*update).stderr
    assert not (tmp_path / "baselines").exists()
    done = slider("bag", "info", str(path), "--json")
    record = json.loads(done.stdout)
    assert record["messages"] in (49, 50, 51)
    assert record["damage"] == "it was not closed"
    assert "slidectl bag reindex" in done.stderr
    assert "killed.orig" in slider.ok("bag", "reindex", str(path))
    assert json.loads(slider.ok("bag", "info", str(path), "--json"))["damage"] is None
    assert len(messages(path)) == record["messages"]
    slider.ok(*update)
    shutil.copy(tmp_path / f"killed.orig{suffix}", path)
    done = slider(*update[:-1])
    assert (
        done.returncode,
        f"{path}: it was not closed; {record['messages']} messages in it can be read" in done.stderr,
    ) == (0, True)
    slider.ok("bag", "filter", str(tmp_path / "baselines" / path.name), str(path), "--force")
    assert slider.ok("bag", "reindex", str(path)) == f"{path}: complete\n"


_NEVER_FLUSHED = """
from slidectl.cli import entry
from slidectl.extensions.recording.commands import record
record._CHECK_EVERY_S = 1000.0
entry()
"""
"""The command line with a recorder that comes to no regular flush."""


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_recorder_that_is_killed_at_once_leaves_its_first_message(
    slider: CommandLine, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"killed{suffix}"
    argv = [sys.executable, "-c", _NEVER_FLUSHED, "record", STATES, "-O", str(path)]
    with subprocess.Popen(argv, stderr=subprocess.PIPE, text=True, env=slider.environment) as recorder:
        assert recorder.stderr is not None
        assert "recording" in recorder.stderr.readline()
        slider.ok("sim", "step", "20ms")
        eventually(lambda: len(messages_so_far(path)) == 1, "the first message is not in the file")
        recorder.kill()
    assert [topic for topic, _, _ in messages(path)] == [STATES]


@pytest.mark.parametrize(
    ("suffix", "compression"),
    [(".bag", "none"), (".bag", "lz4"), (".mcap", "none"), (".mcap", "lz4"), (".mcap", "zstd")],
)
def test_a_chunk_that_is_cut_off_gives_the_messages_that_are_whole(
    slider: CommandLine, tmp_path: Path, suffix: str, compression: str
) -> None:
    """One chunk of 4000 messages: of a file that is cut in it they are what the user has."""
    path = tmp_path / f"run{suffix}"
    write_numbers(path, compression, 4000)
    whole, content = messages(path), path.read_bytes()
    before = 0
    for part in range(1, 50):
        path.write_bytes(content[: len(content) * part // 50])
        found = messages_so_far(path)
        assert found == whole[: len(found)]
        assert len(found) >= before
        before = len(found)
        if compression == "none" and part > 5:
            assert len(found) >= min(4000, len(whole) * part // 50 - 50)
    assert before > 3000
    with opened(path) as recording:
        assert recording.damage == "it was cut off" or suffix == ".bag"
    for words in (
        ("bag", "info"),
        ("bag", "export", "--csv", "-"),
        ("plot", "/number/data", "--save", str(tmp_path / "p.csv")),
    ):
        done = slider(words[0], *words[1:2], str(path), *words[2:])
        assert done.returncode == 0, done.stderr
        assert f"{before} messages in it can be read (slidectl bag reindex {path} completes it)" in done.stderr
    count = f"{before} of {before} messages"
    assert count in slider.ok("bag", "filter", str(path), str(tmp_path / f"copy{suffix}"))
    assert slider("assert", "/number/data", "--from", str(path), "--above", "-1").returncode == 0
    assert f"{before} messages" in slider.ok("bag", "reindex", str(path))
    assert messages(path) == whole[:before]


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_file_that_is_cut_at_any_byte_gives_all_whole_messages(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    write_numbers(path, "none", 12, flush_every=3)
    whole, content = messages(path), path.read_bytes()
    least = 0
    for size in range(len(content)):
        path.write_bytes(content[:size])
        found = messages_so_far(path)
        assert found == whole[: len(found)]
        assert len(found) >= least, f"of {size} bytes"
        least = len(found)
    assert least == 12


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_damaged_chunk_hides_no_other(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    write_numbers(path, "lz4", 300, flush_every=100, is_closed=False)
    content = bytearray(path.read_bytes())
    second = content.index(b"\x04\x22\x4d\x18", content.index(b"\x04\x22\x4d\x18") + 1)  # what an lz4 frame begins with
    content[second : second + 4] = bytes(4)
    path.write_bytes(content)
    with opened(path) as recording:
        numbers = [int(recording.message(one)["data"]) for one in recording.records()]
        assert recording.damage
    assert numbers == [*range(100), *range(200, 300)]


def write_numbers(path: Path, compression: str, count: int, flush_every: int = 10**9, is_closed: bool = True) -> None:
    """A recording of one topic, whose messages have the numbers from 0 on."""
    writer, kind = create(path, compression), codec.of("std_msgs/Float64")
    topic = writer.add("/number", kind, latching=False)
    for number in range(count):
        writer.write(topic, 10**9 + number * 10**6, kind.encode({"data": float(number)}))
        if number % flush_every == flush_every - 1:
            writer.flush()
    (writer.close if is_closed else writer.abandon)()


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_file_that_is_cut_off_anywhere_is_read_as_far_as_it_goes(
    slider: CommandLine, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"run{suffix}"
    slider.ok("sim", "reset")
    recorded(slider, path, STATES)
    whole, content = messages(path), path.read_bytes()
    for part in range(1, 20):
        path.write_bytes(content[: len(content) * part // 20])
        done = slider("bag", "export", str(path), "--csv", "-")
        assert done.returncode in (0, 2), done.stderr
        assert "Traceback" not in done.stderr
        if done.returncode == 0:
            assert messages(path) == whole[: len(messages(path))]


def test_a_file_is_written_over_only_when_something_can_be_recorded(slider: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "mcap.py").write_text("raise ImportError")
    without_mcap = ":".join([str(tmp_path), slider.environment["PYTHONPATH"]])
    kept = {name: tmp_path / name for name in ("notes.txt", "keep.bag", "keep.mcap")}
    for path in kept.values():
        path.write_text("kept")
    for name, code, said, more in (
        ("notes.txt", 2, "is neither a .bag nor a .mcap file", ()),
        ("keep.bag", 2, "have no compression 'zstd'", ("--compression", "zstd")),
        ("keep.mcap", 1, "need the library mcap", ()),
        ("keep.bag", 3, "no daemon", ("-i", "nobody")),
    ):
        done = slider("record", "-a", "-O", str(kept[name]), "--force", *more, PYTHONPATH=without_mcap)
        assert (done.returncode, said in done.stderr) == (code, True), done.stderr
        assert kept[name].read_text() == "kept"
    slider.ok("sim", "reset")
    recorder = Recorder(slider, STATES, "-O", str(kept["keep.bag"]), "--force")
    slider.ok("sim", "step", "100ms")
    assert recorder.end().returncode == 0
    assert len(messages(kept["keep.bag"])) in (4, 5)


def test_a_full_disk_ends_the_recording_and_says_so(slider: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    recorder = Recorder(slider, "-a", "-O", str(path), limit="200")  # KiB
    slider.ok("sim", "step", "2s")
    done = recorder.ended()
    assert done.returncode == 1
    assert f"cannot write {path}: File too large; " in done.stderr
    assert done.stdout == ""
    kept = int(done.stderr.split(" that came, ")[1].split(" ")[0])
    info = slider("bag", "info", str(path), "--json")
    assert kept == (json.loads(info.stdout)["messages"] if info.returncode == 0 else 0)
    assert (f"slidectl bag reindex {path}" in done.stderr) == (kept > 0)


def test_a_daemon_that_ends_completes_the_recording(tmp_path: Path) -> None:
    with running_daemon(paused=True) as runtime:
        slidectl = CommandLine(runtime.folder)
        spawn_slider(slidectl)
        pid = int(slidectl.ok("record", STATES, "/clock", "-O", str(tmp_path / "run.bag"), "--detach"))
        slidectl.ok("sim", "step", "10s")  # more than the recorder has read when the daemon ends
        slidectl.ok("daemon", "stop")  # returns when the recording has ended too
        assert pid > 1
        topics = Counter(topic for topic, *_ in messages(tmp_path / "run.bag"))
        assert topics["/clock"] == 10_000
        assert topics[STATES] in (499, 500)
        [log] = runtime.folder.glob("slidectl/default/recording-*.log")
        assert "run.bag: " in log.read_text()


def test_ends_by_duration_size_and_limit_and_splits(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    recorder = Recorder(slider, STATES, "-O", str(tmp_path / "d.bag"), "--duration", "0.1s")
    slider.ok("sim", "step", "200ms")
    assert recorder.ended().returncode == 0
    assert len(messages(tmp_path / "d.bag")) in (4, 5)
    recorder = Recorder(slider, STATES, "-O", str(tmp_path / "l.bag"), "--limit", "3")
    slider.ok("sim", "step", "200ms")
    assert recorder.ended().returncode == 0
    assert len(messages(tmp_path / "l.bag")) == 3
    words = ("--split", "--duration", "0.1", "--max-splits", "2", "--repeat-latched", "--json")
    recorder = Recorder(slider, STATES, "/tf_static", "-O", str(tmp_path / "s.mcap"), *words)
    slider.ok("sim", "step", "340ms")
    record = json.loads(recorder.end().stdout)
    assert [Path(file).name for file in record["files"]] == ["s_2.mcap", "s_3.mcap"]
    assert not (tmp_path / "s_0.mcap").exists()
    assert [topic for topic, _, _ in messages(tmp_path / "s_3.mcap")][:2] == ["/tf_static", STATES]


def test_copies_and_tables(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    recorded(slider, tmp_path / "run.bag", STATES, COMMAND)
    count = len(messages(tmp_path / "run.bag"))
    for target, compression in (("c.mcap", "zstd"), ("d.bag", "bz2"), ("e.mcap", "lz4"), ("f.bag", "lz4")):
        words = (str(tmp_path / "run.bag"), str(tmp_path / target), "--compression", compression)
        assert slider.ok("bag", "filter", *words) == f"{tmp_path / target}: {count} of {count} messages\n"
        assert sorted(map(repr, messages(tmp_path / target))) == sorted(map(repr, messages(tmp_path / "run.bag")))
        assert json.loads(slider.ok("bag", "info", words[1], "--json"))["compression"] == compression
    words = (str(tmp_path / "run.bag"), str(tmp_path / "part.bag"))
    begin = next(time_ns for topic, time_ns, _ in messages(tmp_path / "run.bag") if topic == STATES) / 1e9
    expression = f"topic == '{STATES}' and t - {begin} < 0.19 and m.position[0] >= 0"
    assert f"10 of {count} messages" in slider.ok("bag", "filter", *words, expression)
    assert "already exists" in slider("bag", "filter", *words, expression).stderr
    refused = slider("bag", "filter", *words, "m.nothing > 0", "--force")
    assert (refused.returncode, "no field 'nothing'" in refused.stderr) == (2, True)
    slider.ok("bag", "export", str(tmp_path / "run.bag"), "--csv", str(tmp_path / "run.csv"), "--topic", STATES)
    with (tmp_path / "run.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == count - 1
    assert [float(row["position[0]"]) for row in rows] == [
        message["position"][0] for topic, _, message in messages(tmp_path / "run.bag") if topic == STATES
    ]
    assert {"time", "topic", "header.stamp", "name[0]", "effort[0]"} <= rows[0].keys()


@pytest.mark.skipif(find_spec("pyarrow") is None, reason="pyarrow is not installed")
def test_a_parquet_file_has_the_rows_and_columns_of_the_csv_file_with_their_types(
    slider: CommandLine, tmp_path: Path
) -> None:
    from pyarrow import parquet

    slider.ok("sim", "reset")
    run, table, text = (str(tmp_path / name) for name in ("run.bag", "run.parquet", "run.csv"))
    recorded(slider, Path(run), STATES, COMMAND)
    written = [message for topic, _, message in messages(Path(run)) if topic == STATES]
    assert f"{len(written)} rows" in slider.ok("bag", "export", run, "--topic", STATES, "--parquet", table)
    slider.ok("bag", "export", run, "--topic", STATES, "--csv", text)
    with open(text) as file:
        names, *_ = rows = list(csv.reader(file))
    read = parquet.read_table(table)
    assert read.column_names == names
    states = read.to_pylist()
    assert [row["position[0]"] for row in states] == [message["position"][0] for message in written]
    assert {type(row[name]) for row in states for name in ("time", "position[0]")} == {float}
    assert {row["name[0]"] for row in states} == {"joint1"}
    assert len(states) == len(rows) - 1


def test_without_the_library_for_parquet_it_says_what_to_install(slidectl: CommandLine, tmp_path: Path) -> None:
    two_publishers(tmp_path / "run.bag")
    (tmp_path / "pyarrow.py").write_text("raise ImportError")
    search = f"{tmp_path}:{slidectl.environment['PYTHONPATH']}"
    done = slidectl("bag", "export", "run.bag", "--parquet", "run.parquet", cwd=tmp_path, PYTHONPATH=search)
    assert (done.returncode, "[parquet]', or use --csv" in done.stderr) == (1, True)
    assert not (tmp_path / "run.parquet").exists()


def test_a_table_takes_the_place_of_no_file_unasked_and_never_of_its_recording(
    slidectl: CommandLine, tmp_path: Path
) -> None:
    two_publishers(tmp_path / "run.bag")
    before = (tmp_path / "run.bag").read_bytes()
    done = slidectl("bag", "export", "run.bag", "--csv", "run.bag", "--force", cwd=tmp_path)
    assert (done.returncode, "the target is the source" in done.stderr) == (2, True)
    assert (tmp_path / "run.bag").read_bytes() == before
    (tmp_path / "-").touch()
    done = slidectl("bag", "export", "run.bag", "--parquet", "-", cwd=tmp_path)
    assert (done.returncode, "- already exists" in done.stderr) == (1, True)


def two_publishers(path: Path) -> None:
    """A bag as rosbag makes it of a topic with two publishers, one of which came twice."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as bag:
        for time_ns, callerid in ((1, "/a"), (2, "/b")):
            connection = bag.add_connection(
                "/talk", "std_msgs/msg/String", typestore=store, callerid=callerid, latching=1
            )
            text = store.types["std_msgs/msg/String"](callerid)
            bag.write(connection, time_ns * 10**9, store.serialize_ros1(text, "std_msgs/msg/String"))


def test_copies_keep_the_publishers_of_a_topic_apart(slider: CommandLine, tmp_path: Path) -> None:
    two_publishers(tmp_path / "run.bag")
    path = tmp_path / "run.bag"
    for copy in ("c.bag", "c.mcap", "d.bag"):
        slider.ok("bag", "filter", str(path), str(tmp_path / copy))
        path = tmp_path / copy
        assert messages(path) == messages(tmp_path / "run.bag")
        with opened(path) as recording:
            assert [(one.callerid, one.latching) for one in recording.channels] == [("/a", True), ("/b", True)]
    path.write_bytes(path.read_bytes()[:-20])  # inside the index
    assert "it was cut off; 2 messages in it can be read" in slider("bag", "info", str(path)).stderr
    slider.ok("bag", "reindex", str(path))
    assert messages(path) == messages(tmp_path / "run.bag")


def test_an_mcap_without_md5_sums_is_copied_into_a_bag(slider: CommandLine, tmp_path: Path) -> None:
    with (tmp_path / "run.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros1")
        definition = f"Header header\nfloat64 x\n{'=' * 80}\nMSG: std_msgs/Header\n{msgs.definition('std_msgs/Header')}"
        for type_name, text in (("std_msgs/Float64", "float64 data"), ("my_pkg/Stamped", definition)):
            schema = writer.register_schema(type_name, "ros1msg", text.encode())
            channel = writer.register_channel(f"/{type_name}", "ros1", schema)
            writer.add_message(channel, 10**9, bytes(8 if text[0] == "f" else 24), 10**9)
        writer.finish()
    slider.ok("bag", "filter", str(tmp_path / "run.mcap"), str(tmp_path / "run.bag"))
    assert messages(tmp_path / "run.bag") == messages(tmp_path / "run.mcap")
    types = json.loads(slider.ok("bag", "info", str(tmp_path / "run.bag"), "--json"))["types"]
    assert {"type": "std_msgs/Float64", "md5sum": msgs.md5("std_msgs/Float64")} in types


def test_each_file_of_a_split_begins_with_what_is_latched_by_then(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    with slider.client() as client:
        client.deliver("/mode", {"data": "old"}, "std_msgs/String", latch=True)
        words = ("--split", "--duration", "0.1", "--repeat-latched")
        recorder = Recorder(slider, STATES, "/mode", "-O", str(tmp_path / "s.mcap"), *words)
        client.step(seconds=0.05)
        client.deliver("/mode", {"data": "new"}, "std_msgs/String", latch=True)
        client.step(seconds=0.2)
    assert recorder.end().returncode == 0
    modes = [
        [message["data"] for topic, _, message in messages(tmp_path / f"s_{number}.mcap") if topic == "/mode"]
        for number in range(3)
    ]
    assert modes == [["old", "new"], ["new"], ["new"]]


def test_a_split_that_cannot_go_on_keeps_what_it_has_and_says_why(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    for suffix in (".bag", ".mcap"):
        (tmp_path / f"s_1{suffix}").touch()
        words = ("-O", str(tmp_path / f"s{suffix}"), "--split", "--duration", "0.1", "--json")
        recorder = Recorder(slider, STATES, *words)
        slider.ok("sim", "step", "300ms")
        done = recorder.ended()
        assert done.returncode == 1
        assert f"s_1{suffix} already exists" in done.stderr
        assert "Traceback" not in done.stderr
        [file] = json.loads(done.stdout)["files"]
        assert len(messages(Path(file))) == json.loads(done.stdout)["messages"] == 5


def test_duration_ends_a_recording_whose_limit_is_not_reached(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    recorder = Recorder(slider, "/never", "-O", str(tmp_path / "d.bag"), "--duration", "0.1s", "--limit", "3")
    slider.ok("sim", "step", "200ms")
    assert recorder.ended().returncode == 0


BAD = [
    (("record",), 2, "give the topics, or -a for all"),
    (("record", "nothing"), 1, "no topic 'nothing'"),
    (("record", "-a", "-O", "x.txt"), 2, "neither a .bag nor a .mcap file"),
    (("record", "-a", "-O", "x.bag", "--compression", "zstd"), 2, "choose from: none, bz2, lz4"),
    (("record", "-a", "-O", "/nowhere/x.bag"), 1, "cannot write /nowhere/x.bag: No such file or directory"),
    (("record", "-e", "(", "-O", "x.bag"), 2, "is not a regular expression"),
    (("record", "-a", "--split", "-O", "x.bag"), 2, "--split needs --duration or --size"),
    (("record", "-a", "--duration", "soon"), 2, "is not a time above 0"),
    (("play", "gone.bag"), 2, "gone.bag: no such file or directory"),
    (("play", "README.md"), 2, "neither a bag (of format 2.0) nor an mcap file"),
    (("play", "config/slider_control.yaml:=", "README.md"), 2, "names no topic"),
    (("bag", "info", "/dev/null"), 2, "is a device"),
    (("bag", "export", "README.md"), 2, "give one of --csv and --parquet"),
]


@pytest.mark.parametrize(("words", "code", "text"), BAD, ids=[" ".join(words) for words, _, _ in BAD])
def test_what_cannot_be_done_is_said(slider: CommandLine, words: tuple[str, ...], code: int, text: str) -> None:
    done = slider(*words)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert text in done.stderr


@pytest.mark.skipif(ROSBAG is None, reason="the real rosbag is not installed")
def test_the_real_rosbag_reads_what_is_recorded_and_its_files_are_read(slider: CommandLine, tmp_path: Path) -> None:
    slider.ok("sim", "reset")
    for compression in ("none", "bz2", "lz4"):
        path = tmp_path / f"{compression}.bag"
        recorder = Recorder(slider, "-a", "-O", str(path), "--compression", compression)
        slider.ok("sim", "step", "300ms")
        assert recorder.end().returncode == 0
        text = subprocess.run([str(ROSBAG), "info", "--yaml", path], capture_output=True, text=True, check=True).stdout
        ours = json.loads(slider.ok("bag", "info", str(path), "--json"))
        assert f"messages: {ours['messages']}" in text
        for one in ours["types"]:
            assert f"- type: {one['type']}\n      md5: {one['md5sum']}" in text
        theirs = tmp_path / "theirs.bag"
        keep = f"topic == '{STATES}'"
        subprocess.run([str(ROSBAG), "filter", path, theirs, keep], capture_output=True, check=True)
        assert messages(theirs) == [one for one in messages(path) if one[0] == STATES]
        theirs.unlink()


INSIDES = (
    reader.RecordType, reader.Header, reader.read_uint32, reader.read_bytes, reader.Chunk, reader.ChunkInfo,
    Reader.__init__, Reader.open, Reader.close, Reader.read_chunk, Reader.read_chunk_info, Reader.messages,
    writer.WriteChunk, Writer.__init__, Writer.set_compression, Writer.open, Writer.write, Writer.write_chunk,
    Writer.close, Writer.abort,
)  # fmt: skip


def test_the_insides_of_rosbags_are_those_that_the_adapter_was_written_for() -> None:
    """After an update: read what has changed in them beside recording/rosbags_adapter.py, then take the new number."""
    assert zlib.crc32("".join(map(inspect.getsource, INSIDES)).encode()) == 4179125369
    assert set(reader.decompressors) == {"none", "bz2", "lz4"}


@pytest.mark.parametrize("kind", [".bag", ".mcap"])
def test_a_message_goes_through_the_recorder_and_the_format_to_the_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    library = pytest.importorskip("rosbags.rosbag1" if kind == ".bag" else "mcap.writer").Writer
    layers: list[str] = []

    def write(*_: object) -> None:
        frame = sys._getframe(1)
        while frame is not None and "/extensions/recording/" in frame.f_code.co_filename:
            layers.append(frame.f_code.co_qualname)
            frame = frame.f_back  # type: ignore[assignment]

    monkeypatch.setattr(library, "write" if kind == ".bag" else "add_message", write)
    recorder = recording_files.Recorder(tmp_path / f"run{kind}")
    recorder.add("/x", "std_msgs/Float64")
    recorder.write("/x", 0, {"data": 1.0})
    recorder.close()
    assert layers == [f"_{kind[1:].capitalize()}Writer.write", "Recorder.write"]


@pytest.mark.parametrize("kind", [".bag", ".mcap"])
def test_a_file_that_cannot_be_read_is_replaced_with_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    def refuse(path: Path, *_: Any, **__: Any) -> Any:
        raise BadFile("cannot be read: Permission denied", path)

    path = tmp_path / f"run{kind}"
    path.write_bytes(b"of another program")
    with monkeypatch.context() as patch:  # not by the mode of the file, which does not bind root
        patch.setattr(recording_files.input_files, "opened", refuse)
        create(path, force=True).close()
    with opened(path) as recording:
        assert not recording.damage
