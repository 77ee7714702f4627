"""`rostopic echo`: messages of a topic, of a field, or of a bag. A topic that nobody publishes yet is waited for."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from time import monotonic

from slidectl.cli.context import Context
from slidectl.cli.echo import Look, follow, predicate, writer
from slidectl.cli.output import check_reader
from slidectl.cli.ros.arguments import Arguments, Option, Parser
from slidectl.cli.ros.naming import pause, resolve, without_remappings
from slidectl.cli.topics import Stream, Target, look_up
from slidectl.errors import TimedOut, UnknownName
from slidectl.field_path import select

_LOOK_AGAIN_S = 0.1

_PARSER = Parser(
    "rostopic",
    "rostopic echo [options] /topic",
    [
        Option(("-b", "--bag"), "bag", "messages of a bag", "BAGFILE"),
        Option(("-p",), "plot", "CSV, for plotting"),
        Option(("-w",), "width", "characters of a number", "NUM_WIDTH"),
        Option(("--filter",), "condition", "only messages for which it is true; m is the message", "EXPR"),
        Option(("--nostr",), "nostr", "without the contents of strings"),
        Option(("--noarr",), "noarr", "without the contents of arrays"),
        Option(("-c", "--clear"), "clear", "clear the screen before each message"),
        Option(("-a", "--all"), "everything", "with -b: all topics of the bag"),
        Option(("-n",), "count", "end after so many messages", "COUNT"),
        Option(("--offset",), "offset", "times as difference from now"),
    ],
)


def echo(ctx: Context, argv: Sequence[str]) -> None:
    """Print messages until -n are printed or Ctrl-C comes."""
    given = _PARSER.parse(without_remappings(argv))
    name = resolve(ctx, _topic(given), "rostopic")
    count = None if given.count is None else _PARSER.integer(given.count, 0, "COUNT must be an integer")
    look = _look(given)
    if given.bag:
        from slidectl.cli.ros import bag

        return bag.echo(ctx, given.bag, None if given.everything else name, look, given.condition, count)
    found = wait_for_topic(ctx, name)
    schema = found.schema
    write = writer(ctx, schema, select(schema.fields, schema.root, found.field), look)
    keep = predicate(given.condition, schema)
    needs_clock = look.offset or (look.form == "csv" and not schema.has_header)
    if count is not None and count <= 0:
        return None
    with Stream(ctx, [found.topic], with_clock=needs_clock) as stream:
        return follow(stream, keep, write, count, ctx.timeout)


def _topic(given: Arguments) -> str:
    """The topic (empty with -a). Usage errors in the order of rostopic's."""
    if len(given.words) > 1:
        _PARSER.error("you may only specify one input topic")
    if given.everything and not given.bag:
        _PARSER.error("Display all option is only valid when echoing from bag files")
    if given.offset and given.bag:
        _PARSER.error("offset time option is not valid with bag files")
    if not given.words and not given.everything:
        _PARSER.error("topic must be specified")
    return given.words[0] if given.words else ""


def _look(given: Arguments) -> Look:
    width = None if given.width is None else _PARSER.integer(given.width, 0, "NUM_WIDTH must be an integer")
    if width is not None and width < 2:
        _PARSER.error("Fixed width for numeric values must be at least 2")
    form = "csv" if given.plot else "text"
    return Look(form, not given.noarr, not given.nostr, width, given.clear, given.offset, from_bag=bool(given.bag))


def wait_for_topic(ctx: Context, full: str) -> Target:
    """The topic, as soon as somebody publishes or subscribes it; a warning says that there is none yet.

    Raises TimedOut after `--timeout`; without it the wait has no limit, as with rostopic.
    """
    limit = ctx.wait_limit(math.inf)
    deadline = monotonic() + limit
    warned = False
    while True:
        try:
            return look_up(ctx, full, None)
        except UnknownName as error:
            if not warned:
                print(f"WARNING: topic [{full}] does not appear to be published yet", file=sys.stderr, flush=True)
                warned = True
            if monotonic() >= deadline:
                raise TimedOut(f"nobody published {full} within {limit:g} s", error.hint) from None
        check_reader()
        pause(ctx, _LOOK_AGAIN_S)
