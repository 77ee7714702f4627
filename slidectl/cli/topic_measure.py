"""`slidectl topic hz | bw | delay`: measure the rate, bandwidth and delay of messages.

`rostopic hz`, `bw` and `delay` use these measurements too, and print them in rostopic's format.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence, Sized
from time import monotonic, monotonic_ns
from typing import Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, number, seconds
from slidectl.cli.context import Context, Target
from slidectl.cli.echo import predicate
from slidectl.cli.topic_streams import PUBLISHERS, Event, Stream
from slidectl.client.rate_meter import RateMeter
from slidectl.errors import NoDaemon, Refused, TimedOut
from slidectl.msgs.schema import Schema, nanoseconds
from slidectl.msgs.serialization import packer

Record = dict[str, Any]
Render = Callable[[Sequence[Record]], str]
"""Turns the records of all topics into the text of a report; an empty text is not printed."""

NOTHING_NEW = "no new messages"
_REPORT_PERIOD_S = 1.0
_PICTURES = "sensor_msgs/Image"
_LARGEST_WINDOW = 10_000_000


# --- the figures ------------------------------------------------------------------------------------------------------


class Meter:
    """Figures of the last `window` messages of a topic. `add` takes a message with its simulated arrival time."""

    _window: Sized
    is_camera = False
    """True for pictures, whose rate may be lower than that asked for."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.total = self.new = 0
        """Messages in all, and since the last report."""

    def add(self, event: Event) -> None:  # noqa: ARG002
        self.total += 1
        self.new += 1

    def record(self) -> Record:
        """The figures by name; a figure that is not known yet is None."""
        return {"topic": self.topic, **self._figures(), "window": len(self._window), "new": self.new}

    def _figures(self) -> Record:
        raise NotImplementedError


class IntervalMeter(Meter):
    """Intervals between messages; a silent topic keeps its rate.

    `time_ns` returns a message's time, `keep` whether it counts.
    """

    def __init__(
        self,
        topic: str,
        window: int,
        time_ns: Callable[[Event], int],
        keep: Callable[[dict[str, Any]], bool] = lambda _: True,
    ) -> None:
        super().__init__(topic)
        self._window: RateMeter = RateMeter(window)
        self._time_ns = time_ns
        self._keep = keep

    def add(self, event: Event) -> None:
        if self._keep(event.message):
            super().add(event)
            self._window.add(self._time_ns(event))

    def _figures(self) -> Record:
        """`rate` in Hz (None when all messages came at one time), and statistics of the intervals in s."""
        spread = spread_of(self._window.intervals)
        del spread["mean"]
        return {"rate": self._window.rate, **spread}


class SizeMeter(Meter):
    """Bytes in ROS 1's serialisation, and bytes a second from the oldest message of the window to `now()`."""

    def __init__(
        self, topic: str, window: int, size: Callable[[dict[str, Any]], int], now: Callable[[], float]
    ) -> None:
        super().__init__(topic)
        self._window: deque[tuple[float, int]] = deque(maxlen=window)
        """When each message came, and its bytes. A clock that jumps back starts it anew."""
        self._size = size
        self._now = now

    def add(self, event: Event) -> None:
        super().add(event)
        now = self._now()
        if self._window and now < self._window[-1][0]:
            self._window.clear()
        self._window.append((now, self._size(event.message)))

    def _figures(self) -> Record:
        """`rate` in bytes a second, and statistics of the sizes in bytes."""
        sizes = [number for _, number in self._window]
        passed = self._now() - self._window[0][0] if len(sizes) > 1 else 0.0
        spread = spread_of(sizes)
        return {"rate": sum(sizes) / passed if passed > 0 else None, **{k: spread[k] for k in ("mean", "min", "max")}}


class DelayMeter(Meter):
    """Simulated time from a message's stamp to its arrival."""

    def __init__(self, topic: str, window: int) -> None:
        super().__init__(topic)
        self._window: deque[float] = deque(maxlen=window)

    def add(self, event: Event) -> None:
        super().add(event)
        self._window.append((event.time_ns - nanoseconds(event.message["header"]["stamp"])) / 1e9)

    def _figures(self) -> Record:
        """`delay`, the mean, and the other statistics, in s."""
        spread = spread_of(self._window)
        return {"delay": spread.pop("mean"), **spread}


def spread_of(numbers: Sequence[float]) -> dict[str, float | None]:
    """Mean, minimum, maximum, population standard deviation and percentiles; each None where there is no number."""
    if not numbers:
        return dict.fromkeys(("mean", "min", "max", "std_dev", "p50", "p99"))
    ordered = sorted(numbers)
    count = len(ordered)
    mean = math.fsum(ordered) / count
    return {
        "mean": mean,
        "min": ordered[0],
        "max": ordered[-1],
        "std_dev": math.sqrt(math.fsum((number - mean) ** 2 for number in ordered) / count),
        "p50": ordered[(count - 1) // 2],
        "p99": ordered[math.ceil(0.99 * count) - 1],
    }


# --- text -------------------------------------------------------------------------------------------------------------


def rates_text(records: Sequence[Record], digits: int = 6, digits_of_deviation: int = 6) -> str:
    """A report of hz in rostopic's form, by default with microseconds; a table for several topics."""
    if len(records) > 1:
        rows = [record for record in records if record["min"] is not None]
        table = output.table(rows, ["topic", "rate", "min", "max", "std_dev", "window"])
        return table + "\n" if rows else NOTHING_NEW
    (record,) = records
    if not record["new"] or record["min"] is None:
        return NOTHING_NEW
    shown = "inf" if record["rate"] is None else f"{record['rate']:.3f}"
    return f"average rate: {shown}\n{_seconds_line(record, digits, digits_of_deviation)}"


def sizes_text(records: Sequence[Record]) -> str:
    """A report of bw, each number in B, KB or MB by its size."""
    (record,) = records
    if record["rate"] is None:
        return NOTHING_NEW
    mean, least, most = (in_bytes(record[key], record[key]) for key in ("mean", "min", "max"))
    rate = in_bytes(record["rate"], record["rate"])
    return f"average: {rate}/s\n\tmean: {mean} min: {least} max: {most} window: {record['window']}"


def delays_text(records: Sequence[Record], digits: int = 6, digits_of_deviation: int = 6) -> str:
    """A report of delay in rostopic's form, by default with microseconds."""
    (record,) = records
    if not record["new"]:
        return NOTHING_NEW
    return f"average delay: {record['delay']:.{digits}f}\n{_seconds_line(record, digits, digits_of_deviation)}"


def _seconds_line(record: Record, digits: int, digits_of_deviation: int) -> str:
    """The second line of a report, as rostopic indents it."""
    least, most = (f"{record[key]:.{digits}f}s" for key in ("min", "max"))
    deviation = f"{record['std_dev']:.{digits_of_deviation}f}s"
    return f"\tmin: {least} max: {most} std dev: {deviation} window: {record['window']}"


def in_bytes(number: float, like: float) -> str:
    """The number in B, KB or MB, chosen by the size of `like`."""
    divisor, unit = (1, "B") if like < 1000 else (1000, "KB") if like < 1_000_000 else (1_000_000, "MB")
    return f"{number / divisor:.2f}{unit}"


# --- measuring --------------------------------------------------------------------------------------------------------


def measure(
    ctx: Context,
    stream: Stream,
    meters: Sequence[Meter],
    text: Render,
    say: Callable[[str], None],
    reports: int | None = None,
) -> None:
    """Take messages into the meters and report each second of wall time, until all is reported or the stream ends.

    Args:
        say: prints the line `subscribed to [topic]`.
        reports: their number; None for no limit, or for one report at the end of a stream with `sim_seconds`.

    Raises:
        TimedOut: no message came for `--timeout`. Refused: no message came at all. NoDaemon.
    """
    by_topic = {meter.topic: meter for meter in meters}
    patience = math.inf if ctx.timeout is None else ctx.timeout
    left = math.inf if reports is None else reports
    with stream:
        say("\n".join(f"subscribed to [{topic}]" for topic in by_topic))
        heard = stream.monotonic()
        period = _REPORT_PERIOD_S if stream.sim_seconds is None or reports is not None else math.inf
        due = heard + period
        cameras = {meter.topic: meter for meter in meters if meter.is_camera}
        try:
            while left > 0 and not stream.ended:
                event = stream.next(min(due, heard + patience))
                if event is not None:
                    by_topic[event.topic].add(event)
                    heard = stream.monotonic()
                elif stream.monotonic() >= heard + patience:
                    raise TimedOut(f"no message came for {patience:g} s")
                if stream.monotonic() >= due or stream.ended:
                    due += period
                    left -= 1
                    _report(ctx, meters, text)
                    if cameras and _warn_slow_cameras(ctx, cameras):
                        cameras = {}  # once
        except (KeyboardInterrupt, NoDaemon):
            if any(meter.new for meter in meters):  # the pending report, which rostopic prints on Ctrl-C, too
                _report(ctx, meters, text)
            raise
    if not any(meter.total for meter in meters):
        raise Refused(f"no messages on {', '.join(by_topic)}", "is the simulation paused? see: slidectl sim status")


def _warn_slow_cameras(ctx: Context, cameras: Mapping[str, Meter]) -> bool:
    """Warn of cameras that drawing does not keep up with, with the rates measured here. True when there was one."""
    status = ctx.call("/slidectl/status")
    found = False
    for topic, asked, advice in zip(status["cameras"], status["cameras_asked"], status["cameras_advice"], strict=True):
        if advice and topic in cameras and (reached := cameras[topic].record()["rate"]) is not None:
            found = True
            ctx.warn(f"{topic}: {asked:.4g} Hz asked, {reached:.4g} reached; {advice}")
    return found


def _report(ctx: Context, meters: Sequence[Meter], text: Render) -> None:
    records = [meter.record() for meter in meters]
    shown = text(records) if ctx.format == "text" else ""
    if shown:
        output.write(shown)
    for record in records:
        ctx.emit(record, "")
    for meter in meters:
        meter.new = 0


def rates(
    ctx: Context,
    targets: Sequence[Target],
    window: int,
    condition: str | None,
    wall_time: bool,
    sim_seconds: float | None = None,
) -> tuple[Stream, list[IntervalMeter]]:
    """The stream and the meters for the rates of topics, one meter for each.

    A message's time is its header's stamp, else its simulated arrival; with `wall_time` the computer's clock.
    """
    schemas = {target.topic: target.schema for target in targets}

    def time_of(schema: Schema) -> Callable[[Event], int]:
        if wall_time:
            return lambda _: monotonic_ns()
        if schema.has_header:
            return lambda event: nanoseconds(event.message["header"]["stamp"])
        return lambda event: event.time_ns

    meters = [
        IntervalMeter(topic, window, time_of(schema), predicate(condition, schema)) for topic, schema in schemas.items()
    ]
    for meter in meters:
        meter.is_camera = any(target.topic == meter.topic and target.type == _PICTURES for target in targets)
    clock = not wall_time and not all(schema.has_header for schema in schemas.values())
    return Stream(ctx, list(schemas), with_clock=clock, sim_seconds=sim_seconds), meters


def _options(function: Callable[..., None]) -> Callable[..., None]:
    """Add the common options of hz, bw and delay."""
    for option in (
        click.option("-w", "--window", type=click.IntRange(2, _LARGEST_WINDOW), default=1000, metavar="N",
                     help="Messages to count in (1000)."),
        click.option("-n", "--reports", type=click.IntRange(min=1), metavar="COUNT", help="End after COUNT reports."),
        seconds("--for", "sim_seconds", help="Measure for S simulated seconds and report once."),
    ):  # fmt: skip
        function = option(function)
    return function


@command(
    examples=[
        "slidectl hz joint_states --for 2",
        "slidectl topic hz joint_states --for 2 --min 49 --max 51 --json",
        "slidectl topic hz joint_states /clock -n 3",
    ]
)
@click.argument("topics", nargs=-1, required=True, metavar="TOPIC...", shell_complete=completion.topics)
@_options
@click.option("--filter", "condition", metavar="EXPR", help="Count only messages for which EXPR is true, as in echo.")
@click.option("--wall-time", is_flag=True, help="Rates on the computer's clock.")
@number("--min", "least", metavar="HZ", help="Exit 1 when the last rate is below it, in Hz.")
@number("--max", "most", metavar="HZ", help="Exit 1 when the last rate is above it, in Hz.")
@click.pass_obj
def hz(
    ctx: Context,
    topics: tuple[str, ...],
    window: int,
    reports: int | None,
    sim_seconds: float | None,
    condition: str | None,
    wall_time: bool,
    least: float | None,
    most: float | None,
) -> None:
    """Measure the rate of messages.

    Rates are in simulated time, by the stamps of the headers or else by /clock; --wall-time takes the computer's clock.
    It prints a report each second of wall time, and exits 1 if no message has come at the end. JSON keys: topic, rate
    (Hz), min, max, std_dev, p50, p99 (of the intervals, s), window, new (since the last report).
    """
    targets = [ctx.find_topic(text, PUBLISHERS) for text in topics]
    stream, meters = rates(ctx, targets, window, condition, wall_time, sim_seconds)
    measure(ctx, stream, meters, rates_text, ctx.say, reports)
    limits = [f"{word} {limit:g}" for word, limit in (("at least", least), ("at most", most)) if limit is not None]
    for meter in meters:
        rate = meter.record()["rate"] or 0.0
        if (least is not None and rate < least) or (most is not None and rate > most):
            raise Refused(f"{meter.topic} comes at {rate:.3f} Hz; expected {' and '.join(limits)}")


@command(examples=["slidectl topic bw joint_states --for 2", "slidectl topic bw /gazebo/link_states -n 3 --json"])
@click.argument("topic", metavar="TOPIC", shell_complete=completion.topics)
@_options
@click.option("--wall-time", is_flag=True, help="Per second of the computer's clock.")
@click.pass_obj
def bw(ctx: Context, topic: str, window: int, reports: int | None, sim_seconds: float | None, wall_time: bool) -> None:
    """Measure the bandwidth of a topic, bytes per second.

    It counts the bytes of ROS 1's serialisation, as rostopic does, per second of simulated time; on the socket,
    messages are JSON. JSON keys: topic, rate (bytes/s), mean, min, max (bytes), window, new.
    """
    target = ctx.find_topic(topic, PUBLISHERS)
    pack = packer(target.schema.root, target.schema.fields)
    stream = Stream(ctx, [target.topic], with_clock=not wall_time, sim_seconds=sim_seconds)
    now = monotonic if wall_time else lambda: stream.time_ns / 1e9
    meter = SizeMeter(target.topic, window, lambda message: len(pack(message)), now)
    measure(ctx, stream, [meter], sizes_text, ctx.say, reports)


@command(examples=["slidectl topic delay joint_states --for 2", "slidectl topic delay joint_states -n 3 --json"])
@click.argument("topic", metavar="TOPIC", shell_complete=completion.topics)
@_options
@click.pass_obj
def delay(ctx: Context, topic: str, window: int, reports: int | None, sim_seconds: float | None) -> None:
    """Measure the simulated time from the stamp of a message to its arrival.

    The topic's type must have a header. JSON keys: topic, delay (the mean), min, max, std_dev, p50, p99, window, new;
    times in s.
    """
    target = ctx.find_topic(topic, PUBLISHERS)
    if not target.schema.has_header:
        raise Refused(f"{target.topic} has no header ({target.type}), so there is no stamp to measure from")
    stream = Stream(ctx, [target.topic], with_clock=True, sim_seconds=sim_seconds)
    measure(ctx, stream, [DelayMeter(target.topic, window)], delays_text, ctx.say, reports)
