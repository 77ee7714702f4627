"""Rates, sizes and delays: figures, and the text of a report."""

from __future__ import annotations

import pytest
from cli_graph_types import schema

from slidectl import msgs
from slidectl.cli.measure import DelayMeter, RateMeter, SizeMeter, Spread, size_counter


def rate_meter(times_ms: list[int], window: int = 1000) -> RateMeter:
    meter = RateMeter("/t", window)
    for time_ms in times_ms:
        meter.take(time_ms * 10**6)
    return meter


def test_a_steady_topic_has_the_rate_of_its_period() -> None:
    record = rate_meter([0, 20, 40, 60]).record()
    assert record == {
        "topic": "/t", "rate": 50.0, "min": 0.02, "max": 0.02, "std_dev": 0.0, "p50": 0.02, "p99": 0.02,
        "window": 4, "new": 4,
    }  # fmt: skip


def test_the_report_has_the_form_of_rostopic_with_microseconds() -> None:
    assert rate_meter([0, 19, 40]).text() == (
        "average rate: 50.000\n\tmin: 0.019000s max: 0.021000s std dev: 0.001000s window: 3"
    )


@pytest.mark.parametrize("times", [[], [5]])
def test_fewer_than_two_messages_have_no_rate(times: list[int]) -> None:
    meter = rate_meter(times)
    assert meter.text() == "no new messages"
    assert meter.record()["rate"] is None
    assert meter.record()["window"] == len(times)


def test_nothing_since_the_last_report_is_said() -> None:
    meter = rate_meter([0, 20])
    meter.new = 0
    assert meter.text() == "no new messages"
    assert meter.record()["rate"] == 50.0


def test_only_the_window_counts() -> None:
    assert rate_meter([0, 1000, 1010, 1020], window=3).record()["rate"] == 100.0


def test_a_clock_that_jumps_back_starts_anew() -> None:
    assert rate_meter([1000, 2000, 0, 10]).record()["rate"] == 100.0


def test_messages_of_one_instant_have_no_finite_rate() -> None:
    meter = rate_meter([10, 10])
    assert meter.rate() is None
    assert meter.text().startswith("average rate: inf\n")


def test_bandwidth_counts_from_the_oldest_message_to_now() -> None:
    meter = SizeMeter("/t", 100)
    meter.take(0.0, 1000)
    assert meter.text() == "no new messages"
    meter.take(0.5, 3000)
    meter.now = 2.0
    assert meter.text() == "average: 2.00KB/s\n\tmean: 2.00KB min: 1.00KB max: 3.00KB window: 2"
    assert meter.record() == {
        "topic": "/t", "rate": 2000.0, "mean": 2000.0, "min": 1000, "max": 3000, "window": 2, "new": 2,
    }  # fmt: skip


@pytest.mark.parametrize(("size", "shown"), [(66, "66.00B"), (1500, "1.50KB"), (2_500_000, "2.50MB")])
def test_a_size_has_the_unit_that_suits_it(size: int, shown: str) -> None:
    meter = SizeMeter("/t", 100)
    for second in (0.0, 1.0):
        meter.take(second, size)
    meter.now = 2.0
    assert f"mean: {shown} " in meter.text()


def test_a_delay_is_reported_with_microseconds() -> None:
    meter = DelayMeter("/t", 10)
    for delay in (0.001, 0.003):
        meter.take(delay)
    assert meter.text() == "average delay: 0.002000\n\tmin: 0.001000s max: 0.003000s std dev: 0.001000s window: 2"
    assert meter.record()["delay"] == 0.002


def test_percentiles_are_values_that_occurred() -> None:
    spread = Spread([float(number) for number in range(100)])
    assert (spread.p50, spread.p99, spread.min, spread.max) == (49.0, 98.0, 0.0, 99.0)


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
    assert size_counter(schema(type_name))(msgs.check(type_name, message)) == size
