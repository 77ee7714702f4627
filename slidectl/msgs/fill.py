"""Messages from command-line values, as `rostopic pub` and `rosservice call` interpret them.

A single mapping gives fields by name, anything else one value per field (genpy's `fill_message_args`). The caller
provides a look-up of types, since a client asks the daemon for them. This module reads no file and parses no YAML or
expression.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from slidectl.errors import BadMessage
from slidectl.msgs.checking import (
    Message,
    Mismatch,
    UnknownField,
    at,
    bytes_checker,
    checked_length,
    checker_of,
    describe,
    must_be,
)
from slidectl.msgs.schema import BYTES, PRIMITIVES, SCALAR, TIMES, Field, FieldsOf

Time = tuple[int, int]
"""Seconds and nanoseconds."""
NumberOf = Callable[[str, str], Any]
"""Takes a text in place of a number, and the number's type; returns the number."""

_HEADER = "std_msgs/Header"
_NS = 1_000_000_000
_CLOCK_WORDS = ("now", "auto")


def mentions_clock(values: Any) -> bool:
    """True when a value, at any depth, may be a word for the present time."""
    if isinstance(values, Mapping):
        values = list(values.values())
    if isinstance(values, (list, tuple)):
        return any(map(mentions_clock, values))
    return values in _CLOCK_WORDS


def field_paths(fields_of: FieldsOf, type_name: str) -> list[str]:
    """All leaf fields of a type, nested ones as `pose.position.x`, as `rosservice args` prints them."""
    paths: list[str] = []
    for field in fields_of(type_name):
        if field.array != SCALAR or field.type in PRIMITIVES:
            paths.append(field.name)
        else:
            paths += (f"{field.name}.{path}" for path in field_paths(fields_of, field.type))
    return paths


def fill(
    fields_of: FieldsOf,
    type_name: str,
    args: Sequence[Any],
    now: Time | None = None,
    number_of: NumberOf = lambda text, _type_name: text,
) -> Message:
    """Build a message from parsed values. Fields that are not given are left out; the receiver sets their defaults.

    A single mapping is by name; otherwise there must be one value per field, nested messages as lists or mappings. The
    numbers of a multi-array may be given alone. The word `now` is the present time, `auto` a header with it; an integer
    for a time or duration counts nanoseconds. `number_of` converts texts in number fields.

    Raises:
        BadMessage: unknown fields, too few or too many values, a value that does not fit. UnknownName: no such type.
            What `number_of` raises.
    """
    try:
        return _Filler(fields_of, now, number_of).whole(type_name, args)
    except Mismatch as problem:
        raise problem.as_error(type_name) from None


class _WrongCount(Mismatch):
    """Too few or too many values for the fields of a message."""

    def __init__(self, given: int, fields: Sequence[Field]) -> None:
        few = "not enough" if given < len(fields) else "too many"
        names = ", ".join(field.name for field in fields)
        hint = (
            f"one value for each of: {names}; or by name: {{{fields[0].name}: ...}}" if fields else "it has no fields"
        )
        super().__init__(f"{few} arguments: {given} given, {len(fields)} expected", hint)

    def as_error(self, type_name: str) -> BadMessage:
        """The error, without a path when the message itself has the wrong count."""
        where = f"{self.path}: " if self.path else ""
        return BadMessage(f"{type_name}: {where}{self.reason}", self.path, self.hint)


class _Filler:
    """Converts values by type, recursively."""

    def __init__(self, fields_of: FieldsOf, now: Time | None, number_of: NumberOf) -> None:
        self._fields_of = fields_of
        self._now = now
        self._number_of = number_of

    def whole(self, type_name: str, args: Sequence[Any]) -> Message:
        fields = self._fields_of(type_name)
        if len(args) == 1 and isinstance(args[0], Mapping):
            return self._by_name(type_name, args[0])
        is_multi_array = len(fields) == 2 and fields[0].type == "std_msgs/MultiArrayLayout" and fields[1].name == "data"
        if len(args) == 1 and is_multi_array and _is_plain_list(args[0]):
            return {"data": at("data", self._value, fields[1], args[0])}
        if len(args) == len(fields):  # YAML reads an empty argument as null: it means empty text in a string field
            texts = [field.array == SCALAR and field.type == "string" for field in fields]
            args = ["" if is_text and value is None else value for is_text, value in zip(texts, args, strict=True)]
        return self._by_position(type_name, args)

    def _by_name(self, type_name: str, given: Mapping[Any, Any]) -> Message:
        fields = {field.name: field for field in self._fields_of(type_name)}
        if not given.keys() <= fields.keys():
            raise UnknownField(given, type_name, tuple(fields))
        return {name: at(name, self._value, fields[name], value) for name, value in given.items()}

    def _by_position(self, type_name: str, given: Sequence[Any]) -> Message:
        fields = self._fields_of(type_name)
        if len(given) != len(fields):
            raise _WrongCount(len(given), fields)
        return {f.name: at(f.name, self._value, f, value) for f, value in zip(fields, given, strict=True)}

    def _value(self, field: Field, value: Any) -> Any:
        if field.array == SCALAR:
            return self._single(field.type, value)
        if field.type in BYTES:
            return bytes_checker(field)(
                [self._number(field.type, each) for each in value] if isinstance(value, (list, tuple)) else value
            )
        values = checked_length(field, value)
        return [at(f"[{index}]", self._single, field.type, element) for index, element in enumerate(values)]

    def _single(self, type_name: str, value: Any) -> Any:
        if type_name in TIMES:
            return self._time(type_name, value)
        if type_name in PRIMITIVES:
            return self._primitive(type_name, value)
        if type_name == _HEADER and value == "auto":
            return {"seq": 0, "stamp": self._time("time", "now"), "frame_id": ""}
        if isinstance(value, Mapping):
            return self._by_name(type_name, value)
        if isinstance(value, (list, tuple)):
            return self._by_position(type_name, value)
        names = ", ".join(field.name for field in self._fields_of(type_name))
        keyword = "'auto', " if type_name == _HEADER else ""
        raise must_be(f"{keyword}a mapping or a list (a {type_name})", value, f"{type_name} has the fields {names}")

    def _primitive(self, type_name: str, value: Any) -> Any:
        if type_name == "string" and not isinstance(value, str):
            reason = f"must be text (string), and YAML reads this as {describe(value)}"
            raise Mismatch(reason, "quote it twice: '\"text\"'")
        if value is None:
            raise must_be(type_name, value)
        return checker_of(type_name)(value if type_name == "string" else self._number(type_name, value))

    def _number(self, type_name: str, value: Any) -> Any:
        return self._number_of(value, type_name) if isinstance(value, str) else value

    def _time(self, type_name: str, value: Any) -> Any:
        if type_name == "time" and value == "now":
            if self._now is None:
                raise Mismatch("cannot be 'now': there is no clock")
            return {"secs": self._now[0], "nsecs": self._now[1]}
        if isinstance(value, int) and not isinstance(value, bool):
            value = {"secs": value // _NS, "nsecs": value % _NS}
        elif isinstance(value, (list, tuple)) and len(value) == 2:
            value = {"secs": value[0], "nsecs": value[1]}
        if not isinstance(value, Mapping):
            keyword = "'now', " if type_name == "time" else ""
            raise must_be(f"{keyword}{{secs, nsecs}} or nanoseconds (a {type_name})", value)
        return checker_of(type_name)(value)


def _is_plain_list(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and not any(isinstance(each, (list, tuple, Mapping)) for each in value)
