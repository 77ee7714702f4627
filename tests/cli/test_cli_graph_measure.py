"""Rates, sizes and delays: figures, and the text of a report."""

from __future__ import annotations

import pytest
from cli_graph_types import schema

from slidectl import msgs
from slidectl.cli.topic_measure import (
    DelayMeter,
    IntervalMeter,
    Record,
    SizeMeter,
    delays_text,
    rates_text,
    sizes_text,
    spread_of,
)
from slidectl.cli.topic_streams import Event
from slidectl.msgs.serialization import packer


def rates(times_ms: list[int], window: int = 1000) -> Record:
    meter = IntervalMeter("/t", window, lambda event: event.time_ns)
    for time_ms in times_ms:
        meter.add(Event("/t", {}, time_ms * 10**6))
    return meter.record()


def sizes(taken: list[tuple[float, int]], now: float) -> Record:
    clock = iter([*(at for at, _ in taken), now])
    meter = SizeMeter("/t", 100, lambda message: int(message["size"]), lambda: next(clock, now))
    for _, size in taken:
        meter.add(Event("/t", {"size": size}, 0))
    return meter.record()


def test_a_steady_topic_has_the_rate_of_its_period() -> None:
    assert rates([0, 20, 40, 60]) == {
        "topic": "/t", "rate": 50.0, "min": 0.02, "max": 0.02, "std_dev": 0.0, "p50": 0.02, "p99": 0.02,
        "window": 4, "new": 4,
    }  # fmt: skip


def test_the_report_has_the_form_of_rostopic_with_microseconds() -> None:
    assert rates_text([rates([0, 19, 40])]) == (
        "average rate: 50.000\n\tmin: 0.019000s max: 0.021000s std dev: 0.001000s window: 3"
    )


@pytest.mark.parametrize("times", [[], [5]])
def test_fewer_than_two_messages_have_no_rate(times: list[int]) -> None:
    record = rates(times)
    assert rates_text([record]) == "no new messages"
    assert (record["rate"], record["window"]) == (None, len(times))


def test_nothing_since_the_last_report_is_said() -> None:
    assert rates_text([{**rates([0, 20]), "new": 0}]) == "no new messages"


def test_only_the_window_counts() -> None:
    assert rates([0, 1000, 1010, 1020], window=3)["rate"] == 100.0


def test_a_clock_that_jumps_back_starts_anew() -> None:
    assert rates([1000, 2000, 0, 10])["rate"] == 100.0


def test_messages_of_one_instant_have_no_finite_rate() -> None:
    record = rates([10, 10])
    assert record["rate"] is None
    assert rates_text([record]).startswith("average rate: inf\n")


def test_bandwidth_counts_from_the_oldest_message_to_now() -> None:
    assert sizes_text([sizes([(0.0, 1000)], 1.0)]) == "no new messages"
    record = sizes([(0.0, 1000), (0.5, 3000)], 2.0)
    assert sizes_text([record]) == "average: 2.00KB/s\n\tmean: 2.00KB min: 1.00KB max: 3.00KB window: 2"
    assert record == {
        "topic": "/t", "rate": 2000.0, "mean": 2000.0, "min": 1000, "max": 3000, "window": 2, "new": 2,
    }  # fmt: skip


@pytest.mark.parametrize(("size", "shown"), [(66, "66.00B"), (1500, "1.50KB"), (2_500_000, "2.50MB")])
def test_a_size_has_the_unit_that_suits_it(size: int, shown: str) -> None:
    assert f"mean: {shown} " in sizes_text([sizes([(0.0, size), (1.0, size)], 2.0)])


def test_a_delay_is_reported_with_microseconds() -> None:
    meter = DelayMeter("/t", 10)
    for delay_ms in (1, 3):
        meter.add(Event("/t", {"header": {"stamp": {"secs": 5, "nsecs": 0}}}, 5 * 10**9 + delay_ms * 10**6))
    record = meter.record()
    assert record["delay"] == 0.002
    assert delays_text([record]) == (
        "average delay: 0.002000\n\tmin: 0.001000s max: 0.003000s std dev: 0.001000s window: 2"
    )


def test_percentiles_are_values_that_occurred() -> None:
    found = spread_of([float(number) for number in range(100)])
    assert [found[name] for name in ("p50", "p99", "min", "max")] == [49.0, 98.0, 0.0, 99.0]


@pytest.mark.parametrize(
    ("type_name", "message", "size"),
    [
        ("std_msgs/Float64", {}, 8),
        ("std_msgs/Empty", {}, 0),
        ("std_msgs/String", {"data": "é"}, 6),
        ("std_msgs/UInt8MultiArray", {"data": "AEH/"}, 4 + 4 + 4 + 3),
        ("sensor_msgs/JointState", {"name": ["slide", "latch"], "position": [0.0, 0.0], "velocity": [0.0, 0.0],
                                    "effort": [0.0, 0.0]}, 98),
        ("geometry_msgs/PoseWithCovariance", {}, 7 * 8 + 36 * 8),
        ("tf2_msgs/TFMessage", {"transforms": [{}]}, 4 + (4 + 8 + 4) + 4 + 7 * 8),
    ],
)  # fmt: skip
def test_sizes_are_those_of_ros_serialisation(type_name: str, message: dict[str, object], size: int) -> None:
    types = schema(type_name)
    assert len(packer(types.root, types.fields)(msgs.check(type_name, message))) == size
