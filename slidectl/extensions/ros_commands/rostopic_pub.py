"""`rostopic pub`: its options, forms and output. It publishes with the code of `slidectl pub`.

A single message, with -1 or without, is done when the subscribers have it, so scripts do not wait; only -l stays.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from itertools import chain
from optparse import Option, OptionParser
from typing import Any

from slidectl.cli import output
from slidectl.cli.context import Context, Target
from slidectl.cli.pub import publish, without_once
from slidectl.cli.service import argument_names
from slidectl.cli.topic_streams import SUBSCRIBERS, details, users_of
from slidectl.errors import BadFile, NotThere, Refused, SlidectlError, UnknownName, Unused, closest
from slidectl.extensions.ros_commands import genpy
from slidectl.extensions.ros_commands.arguments import (
    Failure,
    Parser,
    option,
    refusals,
    resolve_remapped,
    without_remappings,
)
from slidectl.input_files import read_text
from slidectl.typed_values import check_quotes

_ONCE = "-1"
_PAYLOAD = 2
"""The index of the first word that is a value."""
_DOCUMENTS_HZ = 10.0


def _once(_option: Option, name: str, _value: None, parser: OptionParser) -> None:
    """`-1` is an option before the values. Behind TYPE it may be a value, depending on the number of fields."""
    assert parser.largs is not None
    assert parser.values is not None
    if name == _ONCE and len(parser.largs) >= _PAYLOAD:
        parser.largs.append(_ONCE)
    else:
        parser.values.once = True


_PARSER = Parser(
    "rostopic",
    "rostopic pub /topic type [args...]",
    option("-v", "show each message", dest="verbose"),
    option("-r --rate", "publish repeatedly, at this rate in Hz; default for documents: 10", "RATE"),
    Option("-1", "--once", dest="once", action="callback", callback=_once, help="only one message"),
    option("-f --file", "messages from a YAML file", "FILE"),
    option("-l --latch", "keep running, with the message latched for later subscribers"),
    option("-s --substitute-keywords", "with -r: new values of 'now' and 'auto' in each message", dest="renew"),
    option("--use-rostime", "no effect: stamps are always in simulated time"),
)


def pub(ctx: Context, argv: Sequence[str]) -> None:
    """Publish the values of the command line, of a file or of stdin."""
    given = _PARSER.parse(without_remappings(argv, _PAYLOAD))
    rate = _rate(given)
    if len(given.words) < _PAYLOAD:
        missing = "topic type" if given.words else "/topic"
        _PARSER.error(f"{missing} must be specified, as in: rostopic pub /TOPIC std_msgs/Float64 'data: 1.0'")
    topic, type_name, *words = given.words
    if given.file is not None and words:
        _PARSER.error("args conflict with -f setting")
    with refusals():
        check_quotes(words)
    values = [_value(word) for word in words]
    target, nobody = _target(ctx, resolve_remapped(ctx, topic, "rostopic", argv, _PAYLOAD), type_name)
    fields = target.typedefs[0]["fieldnames"]
    with refusals():
        check_quotes(words, fields)
    if _ONCE in words:
        kept, marked = without_once(words, len(fields))
        values = [_value(word) for word in kept]
        given.once = given.once or marked
    run = _Run(ctx, given, target, nobody)
    if values or not fields:
        return run.values(values, rate)
    if given.file is None and sys.stdin.isatty():
        _PARSER.error("Please specify message values")
    return run.documents(rate)


def _rate(given: Any) -> float | None:
    if given.rate is None:
        return None
    if given.once:
        _PARSER.error("You cannot select both -r and -1 (--once)")
    rate = _PARSER.number(float, given.rate, 0.0, "rate must be a number")
    if not rate > 0:
        _PARSER.error("rate must be greater than zero")
    return rate


def _value(word: str) -> Any:
    try:
        return genpy.read(word)
    except genpy.NotYaml as error:
        _PARSER.error(f"Argument error: {error}")


def _target(ctx: Context, topic: str, type_name: str) -> tuple[Target, SlidectlError | None]:
    """The topic, and an error when no node subscribes to it. Raises Failure for a wrong type."""
    if "/" not in type_name:
        raise Failure(f"ERROR: invalid topic type: {type_name}\n{_with_type(ctx, topic)}")
    try:
        target = ctx.find_topic(topic, SUBSCRIBERS, with_field=False)
    except (UnknownName, Unused) as nobody:
        return Target(topic, type_name, "", _typedefs(ctx, type_name), []), nobody
    if target.type != type_name:
        _typedefs(ctx, type_name)
        raise Failure(f"ERROR: topic types do not match: [{target.type}] vs. [{type_name}]\n{_with_type(ctx, topic)}")
    return target, None


def _with_type(ctx: Context, topic: str) -> str:
    """A hint: the command line with the type that the topic has."""
    try:
        known = ctx.find_topic(topic, SUBSCRIBERS, with_field=False).type
    except (UnknownName, Unused):
        return "the type follows the topic: rostopic pub TOPIC std_msgs/Float64 'data: 1.0'"
    return f"type: rostopic pub {topic} {known} VALUE"


def _typedefs(ctx: Context, type_name: str) -> list[dict[str, Any]]:
    try:
        return details(ctx, type_name)
    except Refused:
        package = type_name.partition("/")[0]
        raise Failure(
            f"ERROR: invalid message type: {type_name}.\n"
            f"If this is a valid message type, perhaps you need to type 'rosmake {package}'{_near(type_name)}"
        ) from None


def _near(type_name: str) -> str:
    """A line with the known type that is nearest in spelling; empty when there is none."""
    from slidectl import msgs

    near = closest(type_name, msgs.type_names())
    return f"\ndid you mean {near}? slidectl msg list has all" if near else ""


class _Run:
    """One run of `rostopic pub` with its options. `nobody` is the error when no node subscribes, else None."""

    def __init__(self, ctx: Context, given: Any, target: Target, nobody: SlidectlError | None) -> None:
        self._ctx = ctx
        self._given = given
        self._target = target
        self._nobody = nobody
        self._latch = given.latch and not given.once

    def values(self, values: Sequence[Any], rate: float | None) -> None:
        """Publish the values of the command line: once, or repeatedly at a rate."""
        message = self._message(values)
        if rate is not None:
            return self._publish(self._again(values, message, rate), rate)
        self._announce(message, for_a_while=self._given.once)
        if self._nobody is not None and not self._latch:
            raise self._nobody
        self._publish(iter([message]), None, self._latch)
        if not self._given.once:
            self._ctx.say(f"received by {', '.join(self._target.users)}; -l keeps it latched until Ctrl-C")
        return None

    def documents(self, rate: float | None) -> None:
        """Publish the documents of a file or of stdin: one each period; a single document of a file repeatedly."""
        given = self._given
        if rate is None and not given.latch and not given.once:
            rate = _DOCUMENTS_HZ
        source = self._documents()
        first = next(source, None)
        if first is None:
            return None
        stays = self._latch and rate is None
        is_single = given.once or stays
        second = None if is_single else next(source, None)
        if given.file is not None and second is None and rate is not None:
            output.write("Got one message and a rate, publishing repeatedly")
            return self.values(first, rate)
        every = chain([first], [] if second is None else [second], [] if is_single else source)
        self._publish(self._announced(every, not stays), rate, stays)
        topic = self._target.topic
        # A node may have subscribed while the documents were published.
        if self._nobody is not None and not users_of(self._ctx, [topic], SUBSCRIBERS)[topic]:
            raise self._nobody
        return None

    def _documents(self) -> Iterator[Sequence[Any]]:
        """The values of each document. A document of a file is one value, even when it is a list."""
        file_name = self._given.file
        try:
            if file_name is None:
                yield from genpy.documents(sys.stdin)
                return
            text = read_text(file_name, pipes=True)
            yield from [[document] for document in genpy.read_file(text, file_name) if document is not None]
        except NotThere:
            raise Failure(f"ERROR: file does not exist: {file_name}") from None
        except BadFile as error:
            if file_name is None:
                raise
            raise Failure(f"ERROR: cannot read {file_name}: {error.reason}") from None
        except genpy.NotYaml as error:
            what = "Invalid YAML" if file_name is None else "ERROR: invalid YAML in file"
            raise Failure(f"{what}: {error}") from None

    def _announced(self, every: Iterator[Sequence[Any]], for_a_while: bool) -> Iterator[genpy.Message]:
        for values in every:
            message = self._message(values)
            self._announce(message, for_a_while)
            yield message

    def _again(self, values: Sequence[Any], message: genpy.Message, rate: float) -> Iterator[genpy.Message]:
        """Yield the message without end. Without -s its times stay those of the first one."""
        if self._nobody is not None:
            self._ctx.say(f"{self._target.topic} has no subscribers yet; publishing at {rate:g} Hz")
        while True:
            if self._given.verbose:
                output.write(f"publishing {genpy.as_yaml(self._target.typedefs, message)}")
            yield message
            if self._given.renew:
                message = self._message(values)

    def _publish(self, messages: Iterator[genpy.Message], rate: float | None, stays: bool = False) -> None:
        advertise = self._latch or self._nobody is not None
        values = ([message] for message in messages)
        publish(self._ctx, self._target, values, rate, latch=self._latch, advertise=advertise, stays=stays)

    def _announce(self, message: genpy.Message, for_a_while: bool) -> None:
        what = f"[{genpy.as_yaml(self._target.typedefs, message)}]" if self._given.verbose else "message"
        end = " for 3.0 seconds" if for_a_while else ". Press ctrl-C to terminate"
        output.write(f"publishing and latching {what}{end}")

    def _message(self, values: Sequence[Any]) -> genpy.Message:
        typedefs = self._target.typedefs
        try:
            with refusals():
                return genpy.filled(self._ctx, typedefs, values)
        except genpy.WrongStructure as error:
            raise Failure(f"ERROR: {error}\n\nArgs are: [{' '.join(argument_names(typedefs))}]") from None
        except genpy.WrongType as error:
            from slidectl import msgs

            raise Failure(
                "ERROR: Unable to publish message. One of the fields has an incorrect type:\n"
                f"  {error}\n\nmsg file:\n{msgs.definition(self._target.type).strip()}{_slip(values)}"
            ) from None


def _slip(values: Sequence[Any]) -> str:
    """A line for `data:1.0`, in which YAML sees no field, and for `1,5`; else empty."""
    for value in values:
        text = next(iter(value.values()), None) if isinstance(value, dict) and len(value) == 1 else value
        if isinstance(text, str) and re.fullmatch(r"[-+]?\d+,\d+", text):
            return f"\nnumbers have a point, not a comma: {text.replace(',', '.')}"
        if isinstance(value, str) and (match := re.fullmatch(r"([A-Za-z]\w*):(\S.*)", value)):
            return f"\nwrite a space after the colon: '{match[1]}: {match[2]}'"
    return ""
