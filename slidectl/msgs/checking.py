"""Building, completing and checking messages: one checker per type, made at its first use.

A message is a dict with all fields of its type, in order. Checking never changes its argument. A checker returns the
checked value or raises Mismatch. The path to the wrong value is built while the exception propagates, so a valid
message costs nothing extra.
"""

from __future__ import annotations

import binascii
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from itertools import islice
from struct import Struct
from typing import Any

from slidectl.errors import BadMessage, closest
from slidectl.msgs.definitions import definition_of
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, PRIMITIVES, SCALAR, TIMES, Field

Message = dict[str, Any]
Checker = Callable[[Any], Any]

_FLOAT32 = Struct("=f")
_FLOAT32_MAX = 3.4028234663852886e38
_NS = 1_000_000_000
_DEFAULTS: dict[str, Any] = {**dict.fromkeys(INTEGER_RANGES, 0), **dict.fromkeys(FLOATS, 0.0), "bool": False}
_DEFAULTS["string"] = ""
_BYTES_WANTED = "base64 text or a list of integers from 0 to 255"
# Values of clients may be huge; an error text stays one line.
_LONGEST_SHOWN = 40
_MOST_KEYS = 8


def check(type_name: str, value: Any) -> Message:
    """Complete and check a message of the type: missing fields get their default.

    Integers become floats in float fields, and null becomes nan; 0 and 1 are valid bools; bytes (`uint8[]`, `char[]`)
    may be base64 text, a list of integers or bytes, and become base64 text.

    Raises:
        UnknownName: no such type. BadMessage: the value does not fit; its `path` is the field.
    """
    checker = checker_of(type_name)
    try:
        return checker(value)  # type: ignore[no-any-return]
    except Mismatch as problem:
        raise problem.as_error(type_name) from None


def default(type_name: str) -> Message:
    """A new message with defaults: zeros, empty texts, empty lists. Raises UnknownName."""
    return check(type_name, {})


class Mismatch(Exception):
    """A value does not fit a type. `reason` continues a sentence that begins with the path."""

    def __init__(self, reason: str, hint: str | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.hint = hint
        self.steps: list[str] = []

    @property
    def path(self) -> str:
        """The path of the field, for example `points[0].x`; empty for the whole message."""
        return "".join(step if step[0] == "[" else f".{step}" for step in reversed(self.steps)).removeprefix(".")

    def as_error(self, type_name: str) -> BadMessage:
        """The error for the user who gave the value as a message of `type_name`."""
        return BadMessage(f"{type_name}: {self.path or 'the message'} {self.reason}", self.path, self.hint)


class UnknownField(Mismatch):
    """A field that the type does not have."""

    def __init__(self, given: Iterable[Any], type_name: str, fields: Sequence[str]) -> None:
        """`given` are the keys of the value; one of them is not in `fields`."""
        self.field = _short(str(next(key for key in given if key not in fields)))
        hint = f"{type_name} has {'the fields ' + ', '.join(fields) if fields else 'no fields'}"
        super().__init__(f"{self.field!r} is not a field of {type_name}", hint)
        self.near = closest(self.field, fields)

    def as_error(self, type_name: str) -> BadMessage:
        """The error with the full path of the unknown field, and the known field with the most similar spelling."""
        path = f"{self.path}.{self.field}".removeprefix(".")
        near = f"{self.path}.{self.near}".removeprefix(".")
        suggestion = f". Did you mean {near!r}?" if self.near else ""
        return BadMessage(f"{type_name}: no field {path!r}{suggestion}", path, self.hint)


def must_be(expected: str, given: Any, hint: str | None = None) -> Mismatch:
    """The mismatch of a value of the wrong kind."""
    return Mismatch(f"must be {expected}, not {describe(given)}", hint)


def at(step: str, convert: Callable[..., Any], *arguments: Any) -> Any:
    """Call `convert`; a mismatch in it gets this step in its path."""
    try:
        return convert(*arguments)
    except Mismatch as problem:
        problem.steps.append(step)
        raise


_NO_BLANK = re.compile(r"([a-z_]\w{0,30}):(\S{1,30})")
"""A field and its value without a blank between them: to YAML that is one text."""


def describe(value: Any) -> str:
    """The value in words: `the text 'abc'`, `a list of 3`, `null`."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        found = _NO_BLANK.fullmatch(value)
        advice = f" (write a space after the colon: '{found[1]}: {found[2]}')" if found else ""
        return f"the text {_short(repr(value[:_LONGEST_SHOWN]))}{advice}"
    if isinstance(value, (int, float)):
        return f"the number {_short(_number_text(value))}"
    if isinstance(value, Mapping):
        names = ", ".join(_short(str(key)) for key in islice(value, _MOST_KEYS))
        return f"an object with {_short(names)}" if value else "an empty object"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    return f"{type(value).__name__} {_short(str(value))}"


def _number_text(value: int | float) -> str:
    try:
        return str(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return f"of {value.bit_length()} bits" if isinstance(value, int) else repr(value)


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST_SHOWN else text[: _LONGEST_SHOWN - 1] + "…"


@cache
def checker_of(type_name: str) -> Checker:
    """The checker of a message type or a primitive type. Raises UnknownName."""
    if type_name in INTEGER_RANGES:
        return _integer_checker(type_name)
    if type_name in TIMES:
        return _time_checker(type_name)
    primitives = {"float64": _check_float64, "float32": _check_float32, "bool": _check_bool, "string": _check_string}
    return primitives.get(type_name) or _message_checker(type_name)


def _message_checker(type_name: str) -> Checker:
    of = definition_of(type_name)
    slots = tuple((field.name, *_checker_and_default(field)) for field in of.fields)
    fields = tuple(field.name for field in of.fields)
    listed = ", ".join(f"{field.type_text} {field.name}" for field in of.fields)
    hint = f"{type_name} has the fields {listed}" if fields else f"{type_name} has no fields"

    def check_message(value: Any) -> Message:
        if type(value) is not dict and not isinstance(value, Mapping):
            raise must_be(f"an object (a {type_name})", value, hint)
        result = {}
        given = 0
        name = ""
        try:
            for name, checker, make_default in slots:
                if name in value:
                    result[name] = checker(value[name])
                    given += 1
                else:
                    result[name] = make_default()
        except Mismatch as problem:
            problem.steps.append(name)
            problem.hint = problem.hint or hint
            raise
        if given != len(value):
            raise UnknownField(value, type_name, fields)
        return result

    return check_message


def _checker_and_default(field: Field) -> tuple[Checker, Callable[[], Any]]:
    """The field's checker, and a function that makes its default."""
    element = checker_of(field.type)
    is_single_value = field.type in PRIMITIVES - TIMES.keys()
    make_one = partial(_DEFAULTS.get, field.type) if is_single_value else partial(element, {})
    if field.array == SCALAR:
        return element, make_one
    if field.type in BYTES:
        return bytes_checker(field), partial(str, _base64(bytes(field.array)))
    kept_as_is = {float} if field.type == "float64" else set()

    def check_list(value: Any) -> list[Any]:
        # numpy arrays come from scripts in the same process.
        if type(value) is not list and hasattr(value, "tolist"):
            value = value.tolist()
        values = checked_length(field, value)
        if kept_as_is and kept_as_is.issuperset(map(type, values)):
            return list(values)
        return _checked_elements(values, element)

    return check_list, lambda: [make_one() for _ in range(field.array)]


def checked_length(field: Field, value: Any) -> Sequence[Any]:
    """Check that the value is a list of the field's length. Raises Mismatch."""
    if not isinstance(value, (list, tuple)):
        raise must_be(f"a list ({field.type_text})", value)
    if field.array and len(value) != field.array:
        raise Mismatch(f"must be a list of exactly {field.array} ({field.type_text}), not of {len(value)}")
    return value


def _checked_elements(values: Sequence[Any], element: Checker) -> list[Any]:
    """Check all elements. A mismatch has the index of the first wrong one."""
    try:
        return [element(value) for value in values]
    except Mismatch:
        for index, value in enumerate(values):
            at(f"[{index}]", element, value)
        raise


# Primitive types. The first line of each checker is the fast path for a correct value.


def _check_float64(value: Any) -> float:
    """Check a number; null becomes nan, as rosbridge sends it."""
    return value if type(value) is float else _as_float(value, "float64")


def _check_float32(value: Any) -> float:
    number = _as_float(value, "float32")
    if abs(number) > _FLOAT32_MAX and not math.isinf(number):
        raise Mismatch(f"must be float32 (at most 3.4e38), not the number {number}")
    rounded: float = _FLOAT32.unpack(_FLOAT32.pack(number))[0]  # the value that a ROS subscriber receives
    return rounded


def _as_float(value: Any, expected: str) -> float:
    if value is None:
        return math.nan
    if not _is_number(value, "Real"):
        raise must_be(f"a number ({expected})", value)
    try:
        return float(value)
    except OverflowError:
        raise must_be(f"a number that fits {expected}", value) from None


def _is_number(value: Any, kind: str) -> bool:
    """True for numbers of this class of `numbers`, numpy's scalars included, but not for bool."""
    import numbers  # imported on use: `slidectl pub` sends correct values

    return isinstance(value, getattr(numbers, kind)) and not isinstance(value, bool)


def _integer_checker(type_name: str) -> Checker:
    lowest, highest = INTEGER_RANGES[type_name]

    def check_integer(value: Any) -> int:
        if type(value) is int and lowest <= value <= highest:
            return value
        if not _is_number(value, "Integral"):
            raise must_be(f"an integer ({type_name})", value)
        if not lowest <= value <= highest:
            raise must_be(f"{type_name} ({lowest} to {highest})", value)
        return int(value)

    return check_integer


def _check_bool(value: Any) -> bool:
    if isinstance(value, bool):
        return value
    if _is_number(value, "Integral") and value in (0, 1):
        return bool(value)
    raise must_be("true or false", value)


def _check_string(value: Any) -> str:
    """Check text; it must be encodable as UTF-8."""
    if type(value) is str and value.isascii():
        return value
    if not isinstance(value, str):
        raise must_be("text (string)", value)
    try:
        value.encode()
    except UnicodeEncodeError:
        raise Mismatch("holds half of a surrogate pair") from None
    return str(value)


def _time_checker(type_name: str) -> Checker:
    """The checker of `time` or `duration`: {"secs", "nsecs"}, normalized to 0 <= nsecs < 10^9 as in ROS."""
    lowest, highest = INTEGER_RANGES[TIMES[type_name][0].type]
    integer = _integer_checker("int64")

    def check_time(value: Any) -> dict[str, int]:
        if type(value) is dict and len(value) == 2:
            secs, nsecs = value.get("secs"), value.get("nsecs")
            if type(secs) is int and type(nsecs) is int and 0 <= nsecs < _NS and lowest <= secs <= highest:
                return {"secs": secs, "nsecs": nsecs}
        if not isinstance(value, Mapping):
            raise must_be(f"a {type_name} {{secs, nsecs}}", value)
        if not value.keys() <= {"secs", "nsecs"}:
            raise UnknownField(value, type_name, ("secs", "nsecs"))
        carried, nsecs = divmod(at("nsecs", integer, value.get("nsecs", 0)), _NS)
        secs = at("secs", integer, value.get("secs", 0)) + carried
        if not lowest <= secs <= highest:
            raise Mismatch(f"must be a {type_name} of {lowest} to {highest} seconds, not {describe(secs)}")
        return {"secs": secs, "nsecs": nsecs}

    return check_time


def bytes_checker(field: Field) -> Checker:
    """The checker of a byte array. It takes base64 text, a list of integers, or bytes, and returns base64 text."""
    element = checker_of(field.type)

    def check_bytes(value: Any) -> str:
        if isinstance(value, str):
            try:
                data = binascii.a2b_base64(value, strict_mode=True) if value else b""
            except ValueError:
                raise must_be(_BYTES_WANTED, value) from None
        elif isinstance(value, (list, tuple)):
            data = bytes(_checked_elements(value, element))
        elif isinstance(value, (bytes, bytearray)):
            data = bytes(value)
        else:
            raise must_be(_BYTES_WANTED, value)
        if field.array and len(data) != field.array:
            raise Mismatch(f"must hold exactly {field.array} bytes, not {len(data)}")
        return value if isinstance(value, str) else _base64(data)

    return check_bytes


def _base64(data: bytes) -> str:
    return binascii.b2a_base64(data, newline=False).decode("ascii")
