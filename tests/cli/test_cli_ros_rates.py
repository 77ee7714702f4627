"""`rostopic hz`, `bw` and `delay`: their reports in rostopic's own lines."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator

import pytest
from cli_ros_world import SlideWorld, slide_world

from slidectl.cli.topic_measure import IntervalMeter, Record
from slidectl.cli.topic_streams import Event
from slidectl.extensions.ros_commands import rostopic

MS = 1_000_000
SPREAD = r"\tmin: \d\.\d{3}s max: \d\.\d{3}s std dev: \d\.\d{5}s window: \d+\n"


@pytest.fixture(scope="module")
def slide() -> Iterator[SlideWorld]:
    with slide_world() as world:
        yield world


def report(slide: SlideWorld, *words: str, lines: int = 3) -> str:
    """What a measuring command prints in its first report, and what it adds when Ctrl-C ends it."""
    process = slide.shell.slidectl.start("ros", "rostopic", *words)
    assert process.stdout is not None
    first = "".join(process.stdout.readline() for _ in range(lines))
    process.send_signal(signal.SIGINT)
    rest, stderr = process.communicate(timeout=30)
    assert (stderr, process.returncode) == ("", 130)
    return first + rest


def test_hz_reports_each_second(slide: SlideWorld) -> None:
    text = report(slide, "hz", "--wall-time", "/slide/joint_states")
    assert re.match(rf"subscribed to \[/slide/joint_states\]\naverage rate: \d+\.\d{{3}}\n{SPREAD}", text)


def test_hz_measures_the_topic_of_a_field(slide: SlideWorld) -> None:
    text = report(slide, "hz", "--wall-time", "/slide/joint_states/position", lines=1)
    assert text.startswith("subscribed to [/slide/joint_states]\n")


def test_a_window_may_be_as_large_as_one_likes(slide: SlideWorld) -> None:
    text = report(slide, "hz", "-w", str(10**30), "--wall-time", "/slide/joint_states", lines=2)
    assert "average rate: " in text


def test_hz_of_a_silent_topic(slide: SlideWorld) -> None:
    text = report(slide, "hz", "/slide/description", lines=3)
    assert text.startswith("subscribed to [/slide/description]\nno new messages\nno new messages\n")


def test_hz_of_several_topics_is_a_table(slide: SlideWorld) -> None:
    text = report(slide, "hz", "--wall-time", "/slide/joint_states", "/slide/position", "/slide/command", lines=8)
    subscribed, header, line, first, second, empty = text.splitlines()[2:8]
    assert subscribed == "subscribed to [/slide/command]"
    assert header.split() == ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
    assert set(line) == {"="}
    assert len(line) == len(first) == len(second)
    assert [first.split()[0], second.split()[0], empty] == ["/slide/joint_states", "/slide/position", ""]


def test_the_rate_of_stamps_that_stand_still_cannot_be_told(slide: SlideWorld) -> None:
    assert "no new messages\n" in report(slide, "hz", "/slide/joint_states", lines=2)


def test_bw_reports_in_the_unit_of_the_rate(slide: SlideWorld) -> None:
    text = report(slide, "bw", "-w", "10", "/slide/joint_states")
    assert re.match(
        r"subscribed to \[/slide/joint_states\]\naverage: \d+\.\d\dKB/s\n"
        r"\tmean: 0\.10KB min: 0\.10KB max: 0\.10KB window: 10\n",
        text,
    )


def test_delay_reports_seconds(slide: SlideWorld) -> None:
    text = report(slide, "delay", "/slide/joint_states")
    assert re.match(
        r"subscribed to \[/slide/joint_states\]\naverage delay: -\d+\.\d{3}\n"
        r"\tmin: -\d+\.\d{3}s max: -\d+\.\d{3}s std dev: ",
        text,
    )


def test_delay_needs_a_header(slide: SlideWorld) -> None:
    done = slide("rostopic delay /slide/position")
    assert done.stdout == "subscribed to [/slide/position]\n"
    assert (done.stderr, done.returncode) == ("[ERROR] msg does not have header\n", 1)


HZ = "rostopic hz [options] /topic_0 [/topic_1 [topic_2 [..]]]"
USAGES = [
    ("hz", f"Usage: {HZ}\n\nrostopic: error: topic must be specified\n"),
    ("hz -w x /t", f"Usage: {HZ}\n\nrostopic: error: window size must be an integer\n"),
    ("bw", "Usage: rostopic bw /topic\n\nrostopic: error: topic must be specified\n"),
    ("bw -w x /t", "Usage: rostopic bw /topic\n\nrostopic: error: window size must be an integer\n"),
    (
        "delay",
        "usage: rostopic delay [options] /topic\nrostopic: error: the following arguments are required: topic\n",
    ),
    (
        "delay -w x /t",
        "usage: rostopic delay [options] /topic\nrostopic: error: argument -w/--window: invalid int value: 'x'\n",
    ),
]


@pytest.mark.parametrize(("words", "stderr"), USAGES, ids=[words for words, _ in USAGES])
def test_wrong_usage(slide: SlideWorld, words: str, stderr: str) -> None:
    done = slide(f"rostopic {words}")
    assert (done.stdout, done.stderr, done.returncode) == ("", stderr, 2)


def test_an_unknown_topic_is_waited_for_with_a_warning(slide: SlideWorld) -> None:
    for verb in ("hz", "bw", "delay"):
        process = slide.shell.slidectl.start("ros", "rostopic", verb, "/nope")
        assert process.stderr is not None
        assert process.stderr.readline() == "WARNING: topic [/nope] does not appear to be published yet\n"
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
        assert process.returncode == 130


def record(topic: str, intervals_ms: list[float]) -> Record:
    meter = IntervalMeter(topic, 100, lambda event: event.time_ns)
    at_ns = 0
    for interval in [0.0, *intervals_ms]:
        at_ns += round(interval * MS)
        meter.add(Event(topic, {}, at_ns))
    return meter.record()


def test_the_table_is_laid_out_as_the_recorded_one() -> None:
    records = [
        record("/slide/joint_states", [19.64, 20.39, 20.0, 20.0]),
        record("/slide/position", [19.59, 20.46]),
        record("/slide/command", []),
    ]
    assert rostopic._rates_text(records) == (
        "       topic           rate   min_delta   max_delta    std_dev    window\n"
        "========================================================================\n"
        "/slide/joint_states   49.98   0.01964     0.02039     0.0002653   5     \n"
        "/slide/position       49.94   0.01959     0.02046     0.000435    3     \n\n"
    )


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (98, "average: 980.00B/s\n\tmean: 98.00B min: 98.00B max: 98.00B window: 10"),
        (98_000, "average: 980.00KB/s\n\tmean: 98.00KB min: 98.00KB max: 98.00KB window: 10"),
        (980_000, "average: 9.80MB/s\n\tmean: 0.98MB min: 0.98MB max: 0.98MB window: 10"),
    ],
)
def test_sizes_have_the_unit_of_the_rate(size: int, text: str) -> None:
    sizes = {"rate": size * 10, "mean": size, "min": size, "max": size, "window": 10}
    assert rostopic._sizes_text([sizes]) == text
