"""`slidectl echo`: print messages of a topic, or of one field, as rostopic does, as CSV, or as JSON lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from slidectl import names
from slidectl.cli import completion, output
from slidectl.cli.commands import command, seconds
from slidectl.cli.context import Context, Target
from slidectl.cli.topic_streams import Event, Stream, find_published_topic, wait_for_topic
from slidectl.errors import TimedOut, UnknownName, Unused, UsageError
from slidectl.msgs.field_path import Selection, select
from slidectl.msgs.message_text import CsvForm, YamlForm
from slidectl.msgs.schema import Schema, nanoseconds

if TYPE_CHECKING:
    from slidectl.client import Subscription

_CLEAR = "\033[2J\033[;H"

Write = Callable[[Event], None]
Keep = Callable[[dict[str, Any]], bool]


class MessageFormat(NamedTuple):
    """The format in which messages are printed."""

    form: str
    arrays: bool
    strings: bool
    width: int | None
    clear: bool
    offset: bool
    from_bag: bool = False
    """If true, a CSV line has the time of the record, not of the header, and a selected field is printed in full."""


@command(
    examples=[
        "slidectl echo joint_states -n 1",
        "slidectl echo 'joint_states/position[0]' --for 2 -p > position.csv",
        "slidectl echo joint_states --filter 'm.position[0] > 0.5' --json",
    ]
)
@click.argument("target", metavar="TOPIC[/FIELD[I]]", shell_complete=completion.topics_and_fields)
@click.option("-n", "--count", type=click.IntRange(min=0), metavar="COUNT", help="End after COUNT messages.")
@click.option("-p", "plot", is_flag=True, help="CSV for plotting: %time in nanoseconds, then the fields.")
@click.option("--noarr", is_flag=True, help="Leave out the contents of arrays.")
@click.option("--nostr", is_flag=True, help="Leave out the contents of strings.")
@click.option("--filter", "condition", metavar="EXPR", help="Only messages for which EXPR is true; m is the message.")
@seconds("--for", "sim_seconds", help="End after S simulated seconds.")
@click.option("-c", "--clear", is_flag=True, help="Clear the screen before each message.")
@click.option("-w", "width", type=click.IntRange(min=2), metavar="N", help="Characters of a number.")
@click.option("--offset", is_flag=True, help="Print times relative to now.")
@click.option("--wait", is_flag=True, help="Wait for a topic that does not exist yet; no message is missed.")
@click.pass_obj
def echo(
    ctx: Context,
    target: str,
    count: int | None,
    plot: bool,
    noarr: bool,
    nostr: bool,
    condition: str | None,
    sim_seconds: float | None,
    clear: bool,
    width: int | None,
    offset: bool,
    wait: bool,
) -> None:
    """Print the messages of a topic.

    One YAML document per message, closed by '---', until -n or --for is reached or Ctrl-C is pressed. A field after the
    topic's name, with indices and slices as in Python, is printed alone. --json prints one message a line, which
    'slidectl pub --stdin' reads. --timeout makes it exit with 4 when no message comes for that time. With --wait the
    topic need not exist yet; its name is then relative to --ns (/).

    EXPR compares fields of m (m.position[0], m.header.stamp.to_sec()) with the operators of Python and the functions
    of its math module. The time of a CSV line is the header's stamp, else the simulated time at which it came.
    """
    if plot and ctx.format not in ("text", "csv"):
        raise UsageError(f"-p and -o {ctx.format} exclude each other")
    style = MessageFormat("csv" if plot else ctx.format, not noarr, not nostr, width, clear, offset)
    begun: list[Subscription] = []
    try:
        topic = find_published_topic(ctx, target)
    except (UnknownName, Unused):
        if not wait:
            raise
        full = names.join(ctx.namespace, target)
        topic, begun = wait_for_topic(ctx, full, lambda name: ctx.say(f"{name} is not there yet; waiting for it"))
    print_messages(ctx, topic, style, condition, count, sim_seconds, begun)


def predicate(condition: str | None, schema: Schema) -> Keep:
    """The predicate of `--filter`. Raises UsageError, before the first message, when it is not valid."""
    if condition is None:
        return lambda _message: True
    from slidectl.msgs.message_expressions import Filter

    return Filter(condition, schema)


def print_messages(
    ctx: Context,
    target: Target,
    style: MessageFormat,
    condition: str | None,
    count: int | None,
    sim_seconds: float | None = None,
    begun: Sequence[Subscription] = (),
) -> None:
    """Print messages of a topic until `count` are printed or `sim_seconds` of simulated time are over.

    `begun` is its subscription if that has begun already.

    Raises:
        TimedOut: no message comes for `--timeout`. UsageError: the field is unknown or the condition is not valid.
    """
    schema, patience = target.schema, math.inf if ctx.timeout is None else ctx.timeout
    write, keep = writer(ctx, schema, target.field, style), predicate(condition, schema)
    if count is not None and count <= 0:
        return
    needs_clock = style.offset or (style.form == "csv" and not schema.has_header)
    printed = 0
    with Stream(ctx, [target.topic], with_clock=needs_clock, sim_seconds=sim_seconds, begun=begun) as stream:
        while printed != count:
            event = stream.next(stream.monotonic() + patience)
            if event is None and stream.ended:
                return
            if event is None:
                raise TimedOut(
                    f"no message came for {patience:g} s",
                    f"{printed} printed; is the simulation paused? see: slidectl sim status",
                )
            if keep(event.message):
                write(event)
                printed += 1


def writer(ctx: Context, schema: Schema, field: str, style: MessageFormat) -> Write:
    """The function that prints one message, or a field of it, in the requested form."""
    selection = select(schema.fields, schema.root, field)
    if style.form == "csv":
        return _csv_writer(ctx, schema, selection, style)
    if style.form == "json":
        return lambda event: output.write(
            output.as_json(_pruned(schema, selection.type, selection.depth, selection.read(event.message), style))
        )
    form = YamlForm(schema, style.width, style.arrays, style.strings)
    text = form.printer(selection.type, selection.depth, full=style.from_bag)

    def write(event: Event) -> None:
        form.offset_ns = event.time_ns if style.offset else 0
        output.write(f"{_CLEAR if style.clear else ''}{text(selection.read(event.message))}\n---\n")

    return write


def _pruned(schema: Schema, type_name: str, depth: int, value: Any, style: MessageFormat) -> Any:
    """The value, without its arrays or strings when `style` leaves them out."""
    if style.arrays and style.strings:
        return value
    if depth:
        return [_pruned(schema, type_name, depth - 1, element, style) for element in value]
    if type_name not in schema.types:
        return value
    kept = (
        f for f in schema.types[type_name] if (style.arrays or f.array < 0) and (style.strings or f.type != "string")
    )
    return {f.name: _pruned(schema, f.type, int(f.array >= 0), value[f.name], style) for f in kept}


def _csv_writer(ctx: Context, schema: Schema, selection: Selection, style: MessageFormat) -> Write:
    form = CsvForm(schema, style.arrays, style.strings)
    stamped = schema.has_header and not style.from_bag
    header = ""

    def write(event: Event) -> None:
        nonlocal header
        form.offset_ns = event.time_ns if style.offset else 0
        time_ns = nanoseconds(event.message["header"]["stamp"]) if stamped else event.time_ns
        row = form.row(selection.read(event.message), selection.type, selection.depth, time_ns)
        if row.header != header:
            if header:
                ctx.warn("an array has changed its length, so the columns have changed: a new header line follows")
            header = row.header
            output.write(header)
        output.write(row.line)

    return write
