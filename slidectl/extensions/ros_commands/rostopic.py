"""`rostopic`: its verbs. Publishing has a module of its own.

The verbs that follow a topic wait for its first publisher or subscriber. Rates are in simulated time, as in ROS with
/use_sim_time.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING

from slidectl.cli import output
from slidectl.cli.context import Context, Target
from slidectl.cli.topic_streams import (
    PUBLISHERS,
    SUBSCRIBERS,
    usage_of_topic,
    usage_of_topics,
    users_of,
    wait_for_topic,
)
from slidectl.errors import UnknownName, closest
from slidectl.extensions.ros_commands.arguments import (
    HOST,
    Failure,
    Parser,
    Tool,
    below,
    option,
    resolve,
    without_remappings,
)
from slidectl.extensions.ros_commands.rostopic_pub import pub

if TYPE_CHECKING:
    from slidectl.cli.topic_measure import Record
    from slidectl.client import Subscription

_LONGEST_WINDOW = 50_000
_BW_WINDOW = 100


# --- looking ----------------------------------------------------------------------------------------------------------


def list_topics(ctx: Context, argv: Sequence[str]) -> None:
    """Print the names, with -v also types and counts of users."""
    parser = Parser(
        "rostopic",
        "rostopic list [/namespace]",
        option("-b --bag", "the topics of a bag", "BAGFILE"),
        option("-v --verbose", "types, and numbers of publishers and subscribers"),
        option("-p", "only topics with publishers", dest="published"),
        option("-s", "only topics with subscribers", dest="subscribed"),
        option("--host", "grouped by host"),
    )
    given = parser.parse(without_remappings(argv), most=1, extra="you may only specify one input topic")
    namespace = given.words[0] if given.words else None
    if given.published and given.subscribed:
        parser.error("you may only specify one of -p, -s")
    if given.bag:
        from slidectl.extensions.ros_commands import rosbag as bag

        return bag.list_topics(given.bag, namespace and (resolve(ctx, namespace, "rostopic").rstrip("/") or "/"))
    types = ctx.client.topics()
    chosen = below(ctx, sorted(types), namespace, "rostopic")
    wanted = {PUBLISHERS: given.published, SUBSCRIBERS: given.subscribed}
    roles = [role for role in wanted if wanted[role]] or (list(wanted) if given.verbose else [])
    users = {role: users_of(ctx, chosen, role) for role in roles}
    if given.verbose:
        shown = {name: types[name] for name in chosen}
        return output.write(usage_of_topics(shown, users.get(PUBLISHERS), users.get(SUBSCRIBERS)))
    used = [name for name in chosen if all(found[name] for found in users.values())]
    return output.write("\n".join([f"Host [{HOST}]:", *(f"  {name}" for name in used)] if given.host else used))


def info(ctx: Context, argv: Sequence[str]) -> None:
    """Print type, publishers and subscribers of a topic."""
    complaints = "you must specify a topic name", "you may only specify one topic name"
    given = Parser("rostopic", "rostopic info /topic").parse(without_remappings(argv), 1, 1, *complaints)
    full = resolve(ctx, given.words[0], "rostopic")
    kind = ctx.client.topics().get(full)
    if kind is None:
        raise Failure(f"ERROR: Unknown topic {full}")
    publishers, subscribers = (users_of(ctx, [full], role)[full] for role in (PUBLISHERS, SUBSCRIBERS))
    output.write(usage_of_topic(kind, publishers, subscribers, ctx.uri))


def type_of(ctx: Context, argv: Sequence[str]) -> None:
    """Print the type of a topic; for a field the topic's type, the path, and the field's type."""
    parser = Parser("rostopic type", "rostopic type [-h] topic_or_field", modern=True)
    complaints = "the following arguments are required: topic_or_field", "unrecognized arguments: {}"
    given = parser.parse(without_remappings(argv), 1, 1, *complaints)
    full = resolve(ctx, given.words[0], "rostopic")
    try:
        found = ctx.find_topic(full, None)
        if not found.field:
            return output.write(found.type)
        from slidectl.msgs.field_path import select

        selected = select(found.schema.fields, found.schema.root, found.field)
    except UnknownName:
        raise Failure(f"unknown topic type [{full}]") from None
    return output.write(f"{found.type} {found.field} {selected.type}{'[]' * selected.depth}")


def find(ctx: Context, argv: Sequence[str]) -> None:
    """Print the topics of a type."""
    complaints = "please specify a message type", "you may only specify one message type"
    given = Parser("rostopic", "rostopic find msg-type").parse(without_remappings(argv), 1, 1, *complaints)
    output.write("\n".join(ctx.call("/rosapi/topics_for_type", {"type": given.words[0]})["topics"]))


# --- following --------------------------------------------------------------------------------------------------------


def awaited(ctx: Context, name: str) -> tuple[Target, list[Subscription]]:
    """Wait until a node publishes or subscribes to the topic; print a warning when none does yet.

    Returns the topic, and the subscription to one that came later. Raises TimedOut after `--timeout`; without it the
    wait has no limit, as with rostopic.
    """

    def warn(full: str) -> None:
        near = closest(full, ctx.call("/rosapi/topics")["topics"])
        suggestion = f"; did you mean {near}?" if near else ""
        if not near and full.endswith("/joint_states"):
            from slidectl.cli.topic_streams import step_to_joint_states

            suggestion = f"; {step_to_joint_states(ctx)}"
        print(f"WARNING: topic [{full}] does not appear to be published yet{suggestion}", file=sys.stderr, flush=True)

    return wait_for_topic(ctx, resolve(ctx, name, "rostopic"), warn)


def echo(ctx: Context, argv: Sequence[str]) -> None:
    """Print messages until -n are printed or Ctrl-C comes."""
    from slidectl.cli.echo import MessageFormat, print_messages

    parser = Parser(
        "rostopic",
        "rostopic echo [options] /topic",
        option("-b --bag", "messages of a bag", "BAGFILE"),
        option("-p", "CSV, for plotting", dest="plot"),
        option("-w", "width of numbers, in characters", "NUM_WIDTH", dest="width"),
        option("--filter", "only messages for which EXPR is true; m is the message", "EXPR", dest="condition"),
        option("--nostr", "without the contents of strings"),
        option("--noarr", "without the contents of arrays"),
        option("-c --clear", "clear the screen before each message"),
        option("-a --all", "with -b: all topics of the bag"),
        option("-n", "number of messages after which it ends", "COUNT", dest="count"),
        option("--offset", "times as difference from now"),
    )
    given = parser.parse(without_remappings(argv), most=1, extra="you may only specify one input topic")
    if given.all and not given.bag:
        parser.error("Display all option is only valid when echoing from bag files")
    if given.offset and given.bag:
        parser.error("offset time option is not valid with bag files")
    if not given.words and not given.all:
        parser.error("topic must be specified")
    count = parser.number(int, given.count, None, "COUNT must be an integer")
    width = parser.number(int, given.width, None, "NUM_WIDTH must be an integer")
    if width is not None and width < 2:
        parser.error("Fixed width for numeric values must be at least 2")
    form = "csv" if given.plot else "text"
    message_format = MessageFormat(
        form, not given.noarr, not given.nostr, width, bool(given.clear), bool(given.offset), from_bag=bool(given.bag)
    )
    if given.bag:
        from slidectl.extensions.ros_commands import rosbag as bag

        name = None if given.all else resolve(ctx, given.words[0], "rostopic")
        return bag.echo(ctx, given.bag, name, message_format, given.condition, count)
    target, begun = awaited(ctx, given.words[0])
    return print_messages(ctx, target, message_format, given.condition, count, begun=begun)


# --- measuring --------------------------------------------------------------------------------------------------------

_WINDOW = option("-w --window", "number of messages in the window", "WINDOW")
_NODELAY = option("--tcpnodelay", "no effect: there is no TCP")


def _window(parser: Parser, text: str | None, default: int) -> int:
    argparse_text = f"argument -w/--window: invalid int value: {text!r}"
    window = parser.number(int, text, default, argparse_text if parser.modern else "window size must be an integer")
    return min(window, sys.maxsize) if window > 1 else default


def hz(ctx: Context, argv: Sequence[str]) -> None:
    """Measure the rate of messages."""
    from slidectl.cli.topic_measure import measure, rates

    parser = Parser(
        "rostopic",
        "rostopic hz [options] /topic_0 [/topic_1 [topic_2 [..]]]",
        _WINDOW,
        option("--filter", "only messages for which EXPR is true; m is the message", "EXPR", dest="condition"),
        option("--wall-time", "rates on the computer's clock, not in simulated time"),
        _NODELAY,
    )
    given = parser.parse(without_remappings(argv), 1, missing="topic must be specified")
    window = _window(parser, given.window, _LONGEST_WINDOW)
    targets = [awaited(ctx, name)[0] for name in given.words]
    stream, meters = rates(ctx, targets, window, given.condition, bool(given.wall_time))
    measure(ctx, stream, meters, _rates_text, output.write)


def bw(ctx: Context, argv: Sequence[str]) -> None:
    """Measure the bytes a second, on the wall clock."""
    from slidectl.cli.topic_measure import SizeMeter, measure
    from slidectl.cli.topic_streams import Stream
    from slidectl.msgs.serialization import packer

    parser = Parser("rostopic", "rostopic bw /topic", _WINDOW)
    complaints = "topic must be specified", "you may only specify one input topic"
    given = parser.parse(without_remappings(argv), 1, 1, *complaints)
    window = _window(parser, given.window, _BW_WINDOW)
    target, _ = awaited(ctx, given.words[0])
    pack = packer(target.schema.root, target.schema.fields)
    meter = SizeMeter(target.topic, window, lambda message: len(pack(message)), monotonic)
    measure(ctx, Stream(ctx, [target.topic]), [meter], _sizes_text, output.write)


def delay(ctx: Context, argv: Sequence[str]) -> None:
    """Measure the simulated time from the header stamps of messages to their arrival."""
    from slidectl.cli.topic_measure import DelayMeter, delays_text, measure
    from slidectl.cli.topic_streams import Stream

    parser = Parser("rostopic", "rostopic delay [options] /topic", _WINDOW, _NODELAY, modern=True)
    complaints = "the following arguments are required: topic", "unrecognized arguments: {}"
    given = parser.parse(without_remappings(argv), 1, 1, *complaints)
    window = _window(parser, given.window, _LONGEST_WINDOW)
    target, _ = awaited(ctx, given.words[0])
    if not target.schema.has_header:
        output.write(f"subscribed to [{target.topic}]")
        raise Failure("[ERROR] msg does not have header")
    stream = Stream(ctx, [target.topic], with_clock=True)
    text = partial(delays_text, digits=3, digits_of_deviation=5)
    measure(ctx, stream, [DelayMeter(target.topic, window)], text, output.write)


def _rates_text(records: Sequence[Record]) -> str:
    """rostopic's report; for several topics a row for each that has a rate, the headings centred over their columns."""
    from slidectl.cli.topic_measure import NOTHING_NEW, rates_text

    if len(records) == 1:
        return NOTHING_NEW if records[0]["rate"] is None else rates_text(records, digits=3, digits_of_deviation=5)
    header = ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
    rows = [
        [r["topic"], *(f"{r[key]:.4}" for key in ("rate", "min", "max", "std_dev")), str(r["window"])]
        for r in records
        if r["rate"] is not None
    ]
    if not rows:
        return NOTHING_NEW
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    lines = ["   ".join(name.center(width) for name, width in zip(header, widths, strict=True))]
    lines.append("=" * (sum(widths) + 3 * (len(widths) - 1)))
    lines += ["   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(lines) + "\n\n"


def _sizes_text(records: Sequence[Record]) -> str:
    """rostopic's report of bw, all in the unit of the rate."""
    from slidectl.cli.topic_measure import in_bytes

    rate = records[0]["rate"]
    if rate is None:
        return ""
    shown, mean, least, most = (in_bytes(records[0][key], rate) for key in ("rate", "mean", "min", "max"))
    return f"average: {shown}/s\n\tmean: {mean} min: {least} max: {most} window: {records[0]['window']}"


rostopic = Tool(
    "rostopic",
    "rostopic shows topics, and publishes and measures messages.",
    {
        "bw": (bw, "measure the bandwidth"),
        "delay": (delay, "measure the delay of messages, by their headers"),
        "echo": (echo, "print messages"),
        "find": (find, "list topics by type"),
        "hz": (hz, "measure the rate of messages"),
        "info": (info, "show publishers and subscribers"),
        "list": (list_topics, "list topics"),
        "pub": (pub, "publish messages"),
        "type": (type_of, "print the type of a topic or of a field"),
    },
)
