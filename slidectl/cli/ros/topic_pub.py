"""`rostopic pub`: its options, forms and lines, over the publication that `slidectl pub` uses.

It never makes a script wait: a single message is done when the subscribers have it, with -1 and without; only -l stays.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.pub import Publication
from slidectl.cli.ros import genpy, yamltext
from slidectl.cli.ros.arguments import Arguments, Option, Parser, begins_as_number
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.naming import resolve_remapped, without_remappings
from slidectl.cli.topics import SUBSCRIBERS, Target, details, look_up, users_of
from slidectl.cli.values import check_quotes
from slidectl.errors import BadMessage, Refused, SlidectlError, UnknownName, Unused, UsageError

_ONCE = "-1"
_PAYLOAD = 2
"""The number of the first word that is a value."""
_FLAGS = frozenset("vlrfs")
_DOCUMENTS_HZ = 10.0
_Message = dict[str, Any]


def _is_value(token: str, before: Sequence[str]) -> bool:
    """A number is one; `-1` behind TYPE may be, which only the number of fields can tell. `-1v` is `-1 -v`."""
    if token.startswith(_ONCE) and set(token[2:]) & _FLAGS:
        return False
    return begins_as_number(token) and (token != _ONCE or len(before) >= 2)


_PARSER = Parser(
    "rostopic",
    "rostopic pub /topic type [args...]",
    [
        Option(("-v",), "verbose", "show each message"),
        Option(
            ("-r", "--rate"),
            "rate",
            "again and again, so many a second; 10 for documents of a file or of stdin",
            "RATE",
        ),
        Option(("-1", "--once"), "once", "only one message"),
        Option(("-f", "--file"), "file", "messages from a YAML file", "FILE"),
        Option(("-l", "--latch"), "latch", "stay, with the message latched for those who subscribe later"),
        Option(("-s", "--substitute-keywords"), "renew", "with -r: 'now' and 'auto' anew in each message"),
        Option(("--use-rostime",), "rostime", "no effect: stamps are always of the simulated time"),
    ],
    is_value=_is_value,
)


def pub(ctx: Context, argv: Sequence[str]) -> None:
    """Publish the values of the command line, of a file or of stdin."""
    given = _PARSER.parse(without_remappings(argv, _PAYLOAD))
    rate = _rate(given)
    topic, type_name = _topic_and_type(given)
    if given.file is not None and given.words[2:]:
        _PARSER.error("args conflict with -f setting")
    _check_quotes(given.words[2:])
    values = [_value(word) for word in given.words[2:]]
    target, nobody = _target(ctx, resolve_remapped(ctx, topic, "rostopic", argv, _PAYLOAD), type_name)
    _check_quotes(given.words[2:], target.typedefs[0]["fieldnames"])
    values, marked = _without_once(target, given.words[2:], values)
    run = _Run(ctx, given, target, nobody, given.once or marked)
    if values or not target.typedefs[0]["fieldnames"]:
        return run.values(values, rate)
    if given.file is None and sys.stdin.isatty():
        _PARSER.error("Please specify message values")
    return run.documents(rate)


# --- the command line -------------------------------------------------------------------------------------------------


def _rate(given: Arguments) -> float | None:
    if given.rate is None:
        return None
    if given.once:
        _PARSER.error("You cannot select both -r and -1 (--once)")
    try:
        rate = float(given.rate)
    except ValueError:
        _PARSER.error("rate must be a number")
    if not rate > 0:
        _PARSER.error("rate must be greater than zero")
    return rate


def _topic_and_type(given: Arguments) -> tuple[str, str]:
    if not given.words:
        _PARSER.error("/topic must be specified")
    if len(given.words) == 1:
        _PARSER.error("topic type must be specified")
    return given.words[0], given.words[1]


def _check_quotes(words: Sequence[str], fields: Sequence[str] = ()) -> None:
    try:
        check_quotes(words, fields)
    except UsageError as error:
        raise Failure(f"ERROR: {error}") from None


def _value(word: str) -> Any:
    try:
        return yamltext.read(word)
    except yamltext.NotYaml as error:
        return _PARSER.error(f"Argument error: {error}")


def _without_once(target: Target, words: list[str], values: list[Any]) -> tuple[list[Any], bool]:
    """The values without a `-1` that is the option, and whether there was one."""
    if _ONCE not in words:
        return values, False
    from slidectl.cli.pub import without_once

    kept, marked = without_once(words, len(target.typedefs[0]["fieldnames"]))
    return [_value(word) for word in kept], marked


# --- the topic --------------------------------------------------------------------------------------------------------


def _target(ctx: Context, topic: str, type_name: str) -> tuple[Target, SlidectlError | None]:
    """The topic, and the error that says so when nobody subscribes to it. Raises Failure for the type."""
    if "/" not in type_name:
        raise Failure(f"ERROR: invalid topic type: {type_name}")
    try:
        target = look_up(ctx, topic, SUBSCRIBERS, with_field=False)
    except (UnknownName, Unused) as nobody:
        return Target(topic, type_name, "", _typedefs(ctx, type_name), []), nobody
    if target.type != type_name:
        _typedefs(ctx, type_name)
        raise Failure(f"ERROR: topic types do not match: [{target.type}] vs. [{type_name}]")
    return target, None


def _typedefs(ctx: Context, type_name: str) -> list[dict[str, Any]]:
    try:
        return details(ctx, type_name)
    except Refused:
        package = type_name.partition("/")[0]
        raise Failure(
            f"ERROR: invalid message type: {type_name}.\n"
            f"If this is a valid message type, perhaps you need to type 'rosmake {package}'"
        ) from None


# --- publishing -------------------------------------------------------------------------------------------------------


class _Run:
    """One `rostopic pub` with what it was given."""

    def __init__(
        self, ctx: Context, given: Arguments, target: Target, nobody: SlidectlError | None, once: bool
    ) -> None:
        self._ctx = ctx
        self._given = given
        self._target = target
        self._nobody = nobody
        self._once = once

    def values(self, values: Sequence[Any], rate: float | None) -> None:
        """Those of the command line: once, or again and again at a rate."""
        message = self._message(values)
        if rate is not None:
            return self._publish(self._again(values, message, rate), rate)
        stays = self._given.latch and not self._once
        self._announce(message, for_a_while=self._once)
        if self._nobody is not None and not stays:
            raise self._nobody
        self._publish(iter([message]), None, stays)
        if not self._once:
            self._ctx.say(f"taken in by {', '.join(self._target.users)}; -l would keep it latched until Ctrl-C")
        return None

    def documents(self, rate: float | None) -> None:
        """Those of a file or of stdin: one for each period, the only one of a file again and again."""
        given = self._given
        if rate is None and not given.latch and not self._once:
            rate = _DOCUMENTS_HZ
        source = self._documents()
        first = next(source, None)
        if first is None:
            return None
        stays = given.latch and not self._once and rate is None
        second = None if self._once or stays else next(source, None)
        if given.file is not None and second is None and rate is not None:
            output.write("Got one message and a rate, publishing repeatedly")
            return self.values(first, rate)
        every = chain([first], [] if second is None else [second], [] if self._once or stays else source)
        self._publish(self._announced(every, not stays), rate, stays)
        return self._check_heard()

    def _documents(self) -> Iterator[Sequence[Any]]:
        given = self._given
        try:
            if given.file is None:
                yield from map(_spread, yamltext.documents(sys.stdin))
                return
            with open(given.file, encoding="utf-8") as file:
                yield from [[document] for document in yamltext.read_file(file) if document is not None]
        except (OSError, UnicodeDecodeError) as error:
            if isinstance(error, FileNotFoundError):
                raise Failure(f"ERROR: file does not exist: {given.file}") from None
            why = error.strerror if isinstance(error, OSError) else f"it is no text: {error}"
            raise Failure(f"ERROR: cannot read {given.file}: {why}") from None
        except yamltext.NotYaml as error:
            what = "Invalid YAML" if given.file is None else "ERROR: invalid YAML in file"
            raise Failure(f"{what}: {error}") from None

    def _announced(self, every: Iterator[Sequence[Any]], for_a_while: bool) -> Iterator[_Message]:
        for values in every:
            message = self._message(values)
            self._announce(message, for_a_while)
            yield message

    def _again(self, values: Sequence[Any], message: _Message, rate: float) -> Iterator[_Message]:
        """For ever; the times in it stay those of the first one without -s."""
        if self._nobody is not None:
            self._ctx.say(f"nobody subscribes to {self._target.topic} yet; publishing at {rate:g} Hz")
        while True:
            if self._given.verbose:
                output.write(f"publishing {self._text(message)}")
            yield message
            if self._given.renew:
                message = self._message(values)

    def _publish(self, messages: Iterator[_Message], rate: float | None, stays: bool = False) -> None:
        latch = self._given.latch and not self._once
        advertise = latch or self._nobody is not None
        with Publication(self._ctx, self._target, rate, latch=latch, advertise=advertise) as run:
            run.publish([message] for message in messages)
            if stays:
                run.hold()

    def _check_heard(self) -> None:
        """Somebody may have come while the documents went out. Raises the error that says that nobody has."""
        if self._nobody is None:
            return
        topic = self._target.topic
        if not users_of(self._ctx, [topic], SUBSCRIBERS)[topic]:
            raise self._nobody

    def _announce(self, message: _Message, for_a_while: bool) -> None:
        what = f"[{self._text(message)}]" if self._given.verbose else "message"
        end = " for 3.0 seconds" if for_a_while else ". Press ctrl-C to terminate"
        output.write(f"publishing and latching {what}{end}")

    def _text(self, message: _Message) -> str:
        from slidectl.cli.forms import YamlForm

        schema = self._target.schema
        return YamlForm(schema).printer(schema.root)(genpy.complete(schema, schema.root, message))

    def _message(self, values: Sequence[Any]) -> _Message:
        typedefs = self._target.typedefs
        try:
            return genpy.filled(self._ctx, typedefs, values)
        except genpy.Misfit as error:
            raise Failure(f"ERROR: {error}\n\nArgs are: [{genpy.paths(typedefs)}]") from None
        except genpy.WrongType as error:
            raise Failure(
                "ERROR: Unable to publish message. One of the fields has an incorrect type:\n"
                f"  {error}\n\nmsg file:\n{_definition(self._target.type)}"
            ) from None
        except BadMessage as error:
            raise Failure(f"ERROR: {error}") from None


def _spread(document: Any) -> Sequence[Any]:
    """A document on stdin that is a list has one value for each field; one of a file has not."""
    return document if isinstance(document, list) else [document]


def _definition(type_name: str) -> str:
    from slidectl import msgs

    return msgs.definition(type_name).strip()
