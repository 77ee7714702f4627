"""`slidectl topic hz | bw | delay`: how often, how much and how late, in reports as rostopic prints them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from time import monotonic, monotonic_ns
from typing import Any

import click

from slidectl.cli import completion, output
from slidectl.cli.commands import command, simulated_seconds
from slidectl.cli.context import Context
from slidectl.cli.echo import predicate
from slidectl.cli.measure import DelayMeter, Meter, RateMeter, SizeMeter, size_counter
from slidectl.cli.topics import PUBLISHERS, Event, Stream, Target, look_up, nanoseconds
from slidectl.errors import NoDaemon, Refused, TimedOut

REPORT_PERIOD_S = 1.0
_LARGEST_WINDOW = 10_000_000

Take = Callable[[Event], None]


class Session:
    """Takes messages into meters and prints a report each second of wall time, or one at the end of `sim_seconds`."""

    def __init__(self, ctx: Context, meters: Sequence[Meter], reports: int | None, once_at_end: bool) -> None:
        self._ctx = ctx
        self._meters = meters
        self._left = math.inf if reports is None else reports
        self._period = math.inf if once_at_end and reports is None else REPORT_PERIOD_S

    def run(self, stream: Stream, take: Take, now: Callable[[], float]) -> None:
        """Until the reports are done or the stream ends. Raises TimedOut, and Refused when not one message came."""
        start = heard = monotonic()
        due = start + self._period
        while self._left > 0 and not stream.ended:
            event = stream.next(min(due, heard + self._patience))
            if event is not None:
                take(event)
                heard = monotonic()
            elif monotonic() >= heard + self._patience:
                raise TimedOut(f"no message came for {self._patience:g} s")
            if monotonic() >= due or stream.ended:
                due += self._period
                self._report(now())
        self._check_heard()

    @property
    def _patience(self) -> float:
        return math.inf if self._ctx.timeout is None else self._ctx.timeout

    def _report(self, now: float) -> None:
        self._left -= 1
        for meter in self._meters:
            meter.now = now
        if self._ctx.format == "text":
            output.write(self._text())
        for meter in self._meters:
            self._ctx.emit(meter.record(), "")
            meter.new = 0

    def _text(self) -> str:
        if len(self._meters) == 1:
            return self._meters[0].text()
        rows = [meter.record() for meter in self._meters if meter.total > 1]
        columns = ["topic", "rate", "min", "max", "std_dev", "window"]
        return output.table(rows, columns) + "\n" if rows else "no new messages"

    def _check_heard(self) -> None:
        silent = [meter.topic for meter in self._meters if not meter.total]
        if len(silent) == len(self._meters):
            raise Refused(f"no messages on {', '.join(silent)}", "is the simulation paused? see: slidectl sim status")

    def last_words(self, now: float) -> None:
        """The report of a session that was cut off, as rostopic gives one on Ctrl-C."""
        if any(meter.new for meter in self._meters):
            self._report(now)


def _options(function: Callable[..., None]) -> Callable[..., None]:
    """The options that hz, bw and delay share."""
    for option in (
        click.option("-w", "--window", type=click.IntRange(2, _LARGEST_WINDOW), default=1000, metavar="N",
                     help="Messages to count in (1000)."),
        click.option("-n", "--reports", type=click.IntRange(min=1), metavar="COUNT", help="End after so many reports."),
        click.option("--for", "sim_seconds", type=float, callback=simulated_seconds, metavar="S",
                     help="Measure for S simulated seconds and report once."),
    ):  # fmt: skip
        function = option(function)
    return function


def _measure(
    ctx: Context,
    meters: Sequence[Meter],
    stream: Stream,
    take: Take,
    now: Callable[[], float],
    reports: int | None,
    once: bool,
) -> None:
    session = Session(ctx, meters, reports, once)
    with stream:
        ctx.say("\n".join(f"subscribed to [{meter.topic}]" for meter in meters))
        try:
            session.run(stream, take, now)
        except (KeyboardInterrupt, NoDaemon):
            session.last_words(now())
            raise


def time_ns(target: Target, wall_time: bool) -> Callable[[Event], int]:
    """The function that gives a message's time: the stamp of its header, else the clock when it came."""
    if wall_time:
        return lambda _: monotonic_ns()
    if target.schema.has_header:
        return lambda event: nanoseconds(event.message["header"]["stamp"])
    return lambda event: event.time_ns


@command(
    examples=[
        "slidectl hz joint_states --for 2",
        "slidectl topic hz joint_states --for 2 --min 49 --max 51 --json",
        "slidectl topic hz joint_states /clock -n 3",
    ]
)
@click.argument("topics", nargs=-1, required=True, metavar="TOPIC...", shell_complete=completion.topics)
@_options
@click.option("--filter", "condition", metavar="EXPR", help="Count only messages for which it is true, as in echo.")
@click.option("--wall-time", is_flag=True, help="Rates on the computer's clock.")
@click.option("--min", "least", type=float, metavar="HZ", help="Exit 1 when the last rate is below.")
@click.option("--max", "most", type=float, metavar="HZ", help="Exit 1 when the last rate is above.")
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
    """Measure how often messages come.

    Rates are in simulated time: of the headers' stamps where there are any, else of /clock; --wall-time takes the
    computer's clock. A report is printed each second of wall time. Exits 1 when it ends and not one message has come.
    JSON keys: topic, rate (Hz), min, max, std_dev, p50, p99 (of the intervals, s), window, new (since the last report).
    """
    found = {target.topic: target for target in (look_up(ctx, text, PUBLISHERS) for text in topics)}
    meters = {topic: RateMeter(topic, window) for topic in found}
    times = {topic: time_ns(target, wall_time) for topic, target in found.items()}
    keeps = {topic: predicate(condition, target.schema) for topic, target in found.items()}
    clock = not wall_time and not all(target.schema.has_header for target in found.values())
    stream = Stream(ctx, list(found), with_clock=clock, sim_seconds=sim_seconds)

    def take(event: Event) -> None:
        if keeps[event.topic](event.message):
            meters[event.topic].take(times[event.topic](event))

    _measure(ctx, list(meters.values()), stream, take, monotonic, reports, sim_seconds is not None)
    _check_rates(meters.values(), least, most)


def _check_rates(meters: Any, least: float | None, most: float | None) -> None:
    for meter in meters:
        rate = meter.rate() or 0.0
        if (least is not None and rate < least) or (most is not None and rate > most):
            bounds = [
                f"{word} {limit:g}" for word, limit in (("at least", least), ("at most", most)) if limit is not None
            ]
            raise Refused(f"{meter.topic} comes at {rate:.3f} Hz; expected {' and '.join(bounds)}")


@command(examples=["slidectl topic bw joint_states --for 2", "slidectl topic bw /gazebo/link_states -n 3 --json"])
@click.argument("topic", metavar="TOPIC", shell_complete=completion.topics)
@_options
@click.option("--wall-time", is_flag=True, help="Per second of the computer's clock.")
@click.pass_obj
def bw(ctx: Context, topic: str, window: int, reports: int | None, sim_seconds: float | None, wall_time: bool) -> None:
    """Measure how many bytes a second the messages have.

    Counted are the bytes of ROS 1's serialisation, as rostopic does, per second of simulated time; on the socket
    messages are JSON. JSON keys: topic, rate (bytes/s), mean, min, max (bytes), window, new.
    """
    target = look_up(ctx, topic, PUBLISHERS)
    meter, size = SizeMeter(target.topic, window), size_counter(target.schema)
    stream = Stream(ctx, [target.topic], with_clock=not wall_time, sim_seconds=sim_seconds)
    now = monotonic if wall_time else lambda: stream.time_ns / 1e9
    _measure(
        ctx,
        [meter],
        stream,
        lambda event: meter.take(now(), size(event.message)),
        now,
        reports,
        sim_seconds is not None,
    )


@command(examples=["slidectl topic delay joint_states --for 2", "slidectl topic delay joint_states -n 3 --json"])
@click.argument("topic", metavar="TOPIC", shell_complete=completion.topics)
@_options
@click.pass_obj
def delay(ctx: Context, topic: str, window: int, reports: int | None, sim_seconds: float | None) -> None:
    """Measure the simulated time from the stamp of a message to its arrival.

    The topic's type must have a header. JSON keys: topic, delay (the mean), min, max, std_dev, p50, p99, window, new;
    times in s.
    """
    target = look_up(ctx, topic, PUBLISHERS)
    if not target.schema.has_header:
        raise Refused(f"{target.topic} has no header ({target.type}), so there is no stamp to measure from")
    meter = DelayMeter(target.topic, window)
    stream = Stream(ctx, [target.topic], with_clock=True, sim_seconds=sim_seconds)

    def take(event: Event) -> None:
        meter.take((event.time_ns - nanoseconds(event.message["header"]["stamp"])) / 1e9)

    _measure(ctx, [meter], stream, take, monotonic, reports, sim_seconds is not None)
