"""`rostopic hz`, `bw` and `delay`: a report each second, in rostopic's own lines, until Ctrl-C.

The figures are those of `slidectl topic hz`; rates are in simulated time, as they are in ROS with /use_sim_time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import monotonic
from typing import TypeVar

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.echo import predicate
from slidectl.cli.measure import DelayMeter, Meter, RateMeter, SizeMeter, Spread, size_counter
from slidectl.cli.ros.arguments import Option, Parser
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.naming import resolve, without_remappings
from slidectl.cli.ros.topic_echo import wait_for_topic
from slidectl.cli.topic_measure import REPORT_PERIOD_S, time_ns
from slidectl.cli.topics import Event, Stream, Target, nanoseconds

AnyMeter = TypeVar("AnyMeter", bound=Meter)

_LONGEST_WINDOW = 50_000
_BW_WINDOW = 100
_WINDOW = Option(("-w", "--window"), "window", "how many messages to count in", "WINDOW")
_NODELAY = Option(("--tcpnodelay",), "tcpnodelay", "no effect: there is no TCP")


def _window(parser: Parser, text: str | None, default: int) -> int:
    complaint = "window size must be an integer"
    if parser.modern:
        complaint = f"{parser.tool}: error: argument -w/--window: invalid int value: {text!r}"
    window = parser.integer(text, default, complaint)
    return window if window > 1 else default


def _run(
    stream: Stream, meters: Sequence[AnyMeter], take: Callable[[Event], None], text: Callable[[Sequence[AnyMeter]], str]
) -> None:
    """Report each second, and once more when Ctrl-C ends it."""

    def report() -> None:
        for meter in meters:
            meter.now = monotonic()
        if (lines := text(meters)) != "":
            output.write(lines)
        for meter in meters:
            meter.new = 0

    with stream:
        output.write("\n".join(f"subscribed to [{meter.topic}]" for meter in meters))
        due = monotonic() + REPORT_PERIOD_S
        try:
            while True:
                event = stream.next(due)
                if event is not None:
                    take(event)
                if monotonic() >= due:
                    due += REPORT_PERIOD_S
                    report()
        except KeyboardInterrupt:
            if any(meter.new for meter in meters):
                report()
            raise


def _spread(spread: Spread, window: int) -> str:
    return f"\tmin: {spread.min:.3f}s max: {spread.max:.3f}s std dev: {spread.std_dev:.5f}s window: {window}"


# --- hz ---------------------------------------------------------------------------------------------------------------


def hz(ctx: Context, argv: Sequence[str]) -> None:
    """How often messages come."""
    parser = Parser(
        "rostopic",
        "rostopic hz [options] /topic_0 [/topic_1 [topic_2 [..]]]",
        [
            _WINDOW,
            Option(("--filter",), "condition", "only count messages for which it is true; m is the message", "EXPR"),
            Option(("--wall-time",), "wall_time", "rates on the computer's clock, not in simulated time"),
            _NODELAY,
        ],
    )
    given = parser.parse(without_remappings(argv))
    window = _window(parser, given.window, _LONGEST_WINDOW)
    if not given.words:
        parser.error("topic must be specified")
    found = {t.topic: t for t in (wait_for_topic(ctx, resolve(ctx, name, "rostopic")) for name in given.words)}
    meters = {topic: RateMeter(topic, window) for topic in found}
    times = {topic: time_ns(target, given.wall_time) for topic, target in found.items()}
    keeps = {topic: predicate(given.condition, target.schema) for topic, target in found.items()}

    def take(event: Event) -> None:
        if keeps[event.topic](event.message):
            meters[event.topic].take(times[event.topic](event))

    clock = not given.wall_time and not all(target.schema.has_header for target in found.values())
    _run(Stream(ctx, list(found), with_clock=clock), list(meters.values()), take, _rates)


def _rates(meters: Sequence[RateMeter]) -> str:
    if len(meters) > 1:
        return _table(meters)
    meter = meters[0]
    spread, rate = meter.spread(), meter.rate()
    if not meter.new or spread is None or rate is None:
        return "no new messages"
    return f"average rate: {rate:.3f}\n{_spread(spread, meter.record()['window'])}"


def _table(meters: Sequence[RateMeter]) -> str:
    """A row for each topic that has a rate, the headings centred over their columns."""
    header = ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
    records = [meter.record() for meter in meters if meter.rate() is not None]
    rows = [
        [r["topic"], *(f"{r[key]:.4}" for key in ("rate", "min", "max", "std_dev")), str(r["window"])] for r in records
    ]
    if not rows:
        return "no new messages"
    widths = [max(len(cell) for cell in column) for column in zip(header, *rows, strict=True)]
    lines = ["   ".join(name.center(width) for name, width in zip(header, widths, strict=True))]
    lines.append("=" * (sum(widths) + 3 * (len(widths) - 1)))
    lines += ["   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(lines) + "\n\n"


# --- bw ---------------------------------------------------------------------------------------------------------------


def bw(ctx: Context, argv: Sequence[str]) -> None:
    """How many bytes come, on the wall clock."""
    parser = Parser("rostopic", "rostopic bw /topic", [_WINDOW])
    given = parser.parse(without_remappings(argv))
    window = _window(parser, given.window, _BW_WINDOW)
    if not given.words:
        parser.error("topic must be specified")
    if len(given.words) > 1:
        parser.error("you may only specify one input topic")
    target = wait_for_topic(ctx, resolve(ctx, given.words[0], "rostopic"))
    meter, size = SizeMeter(target.topic, window), size_counter(target.schema)

    def take(event: Event) -> None:
        meter.take(monotonic(), size(event.message))

    _run(Stream(ctx, [target.topic]), [meter], take, _sizes)


def _sizes(meters: Sequence[SizeMeter]) -> str:
    """All four figures in the unit of the rate."""
    record = meters[0].record()
    rate = record["rate"]
    if rate is None:
        return ""
    divisor, unit = (1, "B") if rate < 1000 else (1000, "KB") if rate < 1_000_000 else (1_000_000, "MB")
    mean, least, most = (f"{record[key] / divisor:.2f}{unit}" for key in ("mean", "min", "max"))
    second = f"\tmean: {mean} min: {least} max: {most} window: {record['window']}"
    return f"average: {rate / divisor:.2f}{unit}/s\n{second}"


# --- delay ------------------------------------------------------------------------------------------------------------


def delay(ctx: Context, argv: Sequence[str]) -> None:
    """How late messages come, in simulated time, by the stamps of their headers."""
    parser = Parser("rostopic", "rostopic delay [options] /topic", [_WINDOW, _NODELAY], modern=True)
    given = parser.parse(without_remappings(argv))
    window = _window(parser, given.window, _LONGEST_WINDOW)
    if not given.words:
        parser.error("rostopic: error: the following arguments are required: topic")
    if len(given.words) > 1:
        parser.error(f"rostopic: error: unrecognized arguments: {' '.join(given.words[1:])}")
    target = wait_for_topic(ctx, resolve(ctx, given.words[0], "rostopic"))
    _check_header(target)
    meter = DelayMeter(target.topic, window)
    stream = Stream(ctx, [target.topic], with_clock=True)

    def take(event: Event) -> None:
        meter.take((event.time_ns - nanoseconds(event.message["header"]["stamp"])) / 1e9)

    _run(stream, [meter], take, _delays)


def _check_header(target: Target) -> None:
    if not target.schema.has_header:
        output.write(f"subscribed to [{target.topic}]")
        raise Failure("[ERROR] msg does not have header")


def _delays(meters: Sequence[DelayMeter]) -> str:
    meter = meters[0]
    spread = meter.spread()
    if not meter.new or spread is None:
        return "no new messages"
    return f"average delay: {spread.mean:.3f}\n{_spread(spread, meter.record()['window'])}"
