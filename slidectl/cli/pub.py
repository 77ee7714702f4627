"""`slidectl pub`: publish one message, messages at a rate, or those of a file or pipe, and wait for their delivery.

The everyday case (`slidectl pub command 1.0`) takes two round trips and loads neither YAML nor the evaluator.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, repeat
from typing import Any

import click

from slidectl import names
from slidectl.cli import completion
from slidectl.cli.commands import Command, command, positive_seconds
from slidectl.cli.context import Context, Target
from slidectl.cli.topic_streams import SUBSCRIBERS, details, next_step, users_of
from slidectl.errors import BadFile, SlidectlError, TimedOut, UnknownName, Unused, UsageError
from slidectl.msgs.fill import fill, mentions_clock
from slidectl.msgs.schema import Schema
from slidectl.typed_values import check_quotes, documents_of, documents_on_stdin, is_numeric, read

Values = Sequence[Any]
"""The content of a message: one mapping of fields, or one value for each field."""

_ONCE = "-1"
_TYPE = r"[A-Za-z]\w*/[A-Za-z]\w*\Z"
_EXPRESSION = r"-\s*(\d|\.\d|\(|[A-Za-z_]\w*\()"
_MAX_LATENESS_S = 1.0
_RATE_TOLERANCE = 0.95
_MOST_WARNINGS = 5
"""The most different warnings that one command prints: a sine beyond the limits causes one per message."""


class PubCommand(Command):
    """`-1` may be an option or a number, and `-sin(t)` is a value: both reach the command as words."""

    def is_value(self, token: str) -> bool:
        return token == _ONCE or super().is_value(token) or bool(re.match(_EXPRESSION, token))


def _complete(click_context: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    return [] if click_context.params.get("words") else completion.topics(click_context, param, incomplete)


@command(
    cls=PubCommand,
    examples=[
        "slidectl pub command 1.0",
        "slidectl pub /slider/joint1_position_controller/command std_msgs/Float64 'data: 1.0'",
        "slidectl pub joint1_position_controller/command -r 100 'sin(2*pi*0.2*t)'",
        "slidectl echo /left/goal --json | slidectl pub /right/goal --stdin",
    ],
)
@click.argument("words", nargs=-1, required=True, metavar="TOPIC [TYPE] [VALUE]...", shell_complete=_complete)
@click.option("--once", is_flag=True, help="Only one message; also -1.")
@click.option(
    "-r",
    "--rate",
    type=float,
    callback=positive_seconds,
    metavar="HZ",
    help="Publish repeatedly at this rate, Hz of wall time.",
)
@click.option("-n", "--count", type=click.IntRange(min=1), metavar="COUNT", help="Number of messages.")
@click.option("--latch", is_flag=True, help="Keep the last message for later subscribers; stays until Ctrl-C.")
@completion.file_option("-f", "--file", help="Values from a YAML or JSON lines file.")
@click.option("--stdin", is_flag=True, help="Values from stdin: YAML documents or JSON lines.")
@click.option("--allow-unheard", is_flag=True, help="Publish even if nobody subscribes.")
@click.pass_obj
def pub(
    ctx: Context,
    words: tuple[str, ...],
    once: bool,
    rate: float | None,
    count: int | None,
    latch: bool,
    file: str | None,
    stdin: bool,
    allow_unheard: bool,
) -> None:
    """Publish a message.

    TOPIC is matched against the topics with subscribers; TYPE is optional for a topic that exists. VALUE is YAML: one
    mapping of fields, or one value for each field. It returns when the subscribers have the message, and exits 1 when
    there are none or when one refuses it.

    With -r a value may be an expression in i (the number of the message, from 0) and t (seconds, i / HZ) with the
    functions of the math module. 'auto' for a header and 'now' for a time stand for the simulated time, anew in
    each message. JSON keys: topic, type, published, subscribers (node names).
    """
    while words[:1] == (_ONCE,):
        once, words = True, words[1:]
    _check_options(words, once, rate, file, stdin)
    name, *given = words
    from_documents = file is not None or stdin
    target, given, is_new = _target(ctx, name, given, allow_unheard, from_documents)
    given, marked = without_once(given, 0 if from_documents else len(target.typedefs[0]["fieldnames"]))
    if marked:
        once = True
        _check_options(words, once, rate, file, stdin)
    sources = _from_documents(target, file, rate) if from_documents else _from_words(target, given, rate, count)
    source = islice(sources, 1 if once else count)
    advertise, stays = allow_unheard or latch or is_new, latch and not once
    publish(ctx, target, source, rate, latch=latch, advertise=advertise, stays=stays, from_documents=from_documents)


def _check_options(words: Sequence[str], once: bool, rate: float | None, file: str | None, stdin: bool) -> None:
    if not words:
        raise UsageError("no TOPIC given")
    if once and rate is not None:
        raise UsageError("-1 and -r exclude each other")
    if file is not None and stdin:
        raise UsageError("-f and --stdin exclude each other")


# --- the topic ------------------------------------------------------------------------------------------------------


def _target(
    ctx: Context, name: str, given: list[str], allow_unheard: bool, from_documents: bool
) -> tuple[Target, list[str], bool]:
    """The topic, the words without TYPE, and whether the topic is new. Raises as `find_topic` does."""
    is_new = False
    try:
        target = ctx.find_topic(name, SUBSCRIBERS, with_field=False)
    except Unused as error:
        if not allow_unheard:
            raise _with_next_step(ctx, name, error, "--allow-unheard publishes all the same") from None
        target = ctx.find_topic(name, None, with_field=False)
    except UnknownName as error:
        full = names.join(ctx.namespace, name)
        waiting = users_of(ctx, [full], SUBSCRIBERS)[full]  # as of 'echo --wait'
        if not allow_unheard and not (waiting and given and re.match(_TYPE, given[0])):
            step = "--allow-unheard publishes on a new topic: give its TYPE"
            raise _with_next_step(ctx, name, error, step) from None
        if not given or not re.match(_TYPE, given[0]):
            hint = "slidectl msg list shows the types"
            raise UsageError(f"there is no topic {name!r} yet, so give its TYPE", hint) from None
        target, is_new = Target(names.check(full), given[0], "", details(ctx, given[0]), waiting), True
    has_type = bool(given) and _is_type(given, target, from_documents)
    if has_type and given[0] != target.type:
        raise UsageError(f"{target.topic} has the type {target.type}, not {given[0]}", "TYPE may be left out")
    values = given[1:] if has_type else given
    if from_documents and any(word != _ONCE for word in values):
        raise UsageError("a VALUE and -f or --stdin exclude each other")
    return target, values, is_new


def _with_next_step(ctx: Context, name: str, error: SlidectlError, step: str) -> SlidectlError:
    """The error with one more line: the command that loads a missing controller, else `step`."""
    error.hint = f"{error.hint}\n{next_step(ctx, name) or step}"
    return error


def _is_type(given: Sequence[str], target: Target, from_documents: bool) -> bool:
    """True when the first word is a TYPE. A lone word such as `a/b` is a value when the topic takes text."""
    if given[0] == target.type:
        return True
    if not re.match(_TYPE, given[0]):
        return False
    alone = [word for word in given if word != _ONCE] == [given[0]] and not from_documents
    return not (alone and target.typedefs[0]["fieldtypes"] == ["string"])


# --- the values -----------------------------------------------------------------------------------------------------


def without_once(given: list[str], fields: int) -> tuple[list[str], bool]:
    """The values without the option `-1`, and whether it was given. It is a number if a value is missing without it."""
    plain = [word for word in given if word != _ONCE]
    by_name = len(plain) == 1 and (":" in plain[0] or plain[0].startswith("{"))
    if len(plain) == len(given) or (len(given) == fields and len(plain) != fields and not by_name):
        return given, False
    return plain, True


def _from_words(target: Target, given: Sequence[str], rate: float | None, count: int | None) -> Iterator[Values]:
    """The values on the command line: without end at a rate, else `count` times or once."""
    check_quotes(given, target.typedefs[0]["fieldnames"])
    if not given and target.typedefs[0]["fieldnames"]:
        fields = ", ".join(target.typedefs[0]["fieldnames"])
        raise UsageError(f"no VALUE given for {target.topic} ({target.type})", f"it has the fields: {fields}")
    values = [read(word) if word else "" for word in given]
    return repeat(values) if rate is not None else repeat(values, count or 1)


def _from_documents(target: Target, file: str | None, rate: float | None) -> Iterator[Values]:
    """The values of a file or of stdin; at a rate, a single document of a file repeats without end."""
    fields = len(target.typedefs[0]["fieldnames"])
    source = documents_on_stdin() if file is None else documents_of(file)
    if source == [] and file != "-":
        raise BadFile("holds no message", file)
    spread = (_spread(document, fields) for document in source if document is not None or not fields)
    if file is None or rate is None:
        return spread
    every = list(spread)
    return repeat(every[0]) if len(every) == 1 else iter(every)


def _spread(document: Any, fields: int) -> Values:
    """A document as values: a list is one value for each field, if the type has several."""
    if document is None:
        return []
    return document if isinstance(document, list) and len(document) == fields != 1 else [document]


# --- publishing -----------------------------------------------------------------------------------------------------


def publish(
    ctx: Context,
    target: Target,
    sources: Iterable[Values],
    rate: float | None,
    *,
    latch: bool,
    advertise: bool,
    stays: bool,
    from_documents: bool = False,
) -> None:
    """Send one message for each of the values, each after the delivery of the one before; print what was published.

    Args:
        rate: in Hz; values may be expressions then. The schedule is absolute; after a long delay it begins anew.
        advertise: become a publisher of the topic, which may be new or have no subscribers.
        stays: stay connected at the end, so that a latched message stays.
        from_documents: when one of them fails, print how many were published before it.

    Raises:
        BadMessage: values that do not fit the type. MessageRefused: a subscriber refuses the message.
        UsageError, Refused: an expression is not valid, or cannot be computed. NoDaemon.
        TimedOut: not delivered within `--timeout`, or latched for that time.
    """
    client, topic, schema = ctx.client, target.topic, target.schema
    told: set[str] = set()
    published = 0
    began = latest = client.monotonic()
    try:
        try:
            for index, values in enumerate(sources):
                if rate is not None:
                    due = began + index / rate
                    late = client.monotonic() - due
                    if late > _MAX_LATENESS_S:
                        began += late
                    ctx.pause(due - client.monotonic())
                message = message_of(ctx, schema, values, rate is not None, index, index / (rate or 1.0))
                client.deliver(topic, message, target.type if advertise else None, latch)
                published += 1
                latest = client.monotonic()
                for reason in client.reasons:  # warnings of subscribers that accepted the message; each text once
                    if reason not in told and len(told) < _MOST_WARNINGS:
                        told.add(reason)
                        ctx.warn(reason)
        except SlidectlError:
            if from_documents and published:
                ctx.say(f"{published} published on {topic} before this:")
            raise
        if stays:
            ctx.say(f"{topic} is latched; Ctrl-C ends it")
            limit = ctx.wait_limit(math.inf)
            ctx.pause(limit)
            raise TimedOut(f"{topic} was latched for {limit:g} s")
    except KeyboardInterrupt:
        _warn_low_rate(ctx, rate, published, latest - began)
        raise
    _warn_low_rate(ctx, rate, published, latest - began)
    ctx.emit({"topic": topic, "type": target.type, "published": published, "subscribers": target.users}, "")
    ctx.detail(f"published {published} on {topic} to {', '.join(target.users) or 'nobody'}")


def _warn_low_rate(ctx: Context, rate: float | None, published: int, seconds: float) -> None:
    """Warn when the rate was not reached. Ten messages or fewer are too few to judge it."""
    if rate is not None and published > 10:
        reached = (published - 1) / seconds if seconds > 0 else math.inf
        if reached < _RATE_TOLERANCE * rate:
            ctx.warn(f"published at {reached:.1f} Hz instead of {rate:g} Hz")


def message_of(
    ctx: Context, schema: Schema, values: Values, expressions: bool = False, index: int = 0, seconds: float = 0.0
) -> dict[str, Any]:
    """The message of the schema's root type with these values; expressions have i = index and t = seconds.

    Raises as `fill` and `Numbers.at`.
    """
    if is_numeric(list(values)):  # no value can be an expression or stand for the time
        return fill(schema.fields, schema.root, values)
    from slidectl.msgs.message_expressions import number_converter

    now = None
    if mentions_clock(values):
        time = ctx.call("/rosapi/get_time")["time"]
        now = time["secs"], time["nsecs"]
    return fill(schema.fields, schema.root, values, now, number_converter(index, seconds, expressions))
