"""Building, completing and checking messages: one checker and one maker per type, compiled at its first use.

A message is a dict with all fields of its type, in their order. Checking never changes what it was given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

from slidectl.msgs.catalogue import definition_of
from slidectl.msgs.mismatch import Mismatch, UnknownField, must_be
from slidectl.msgs.parsing import Definition
from slidectl.msgs.primitives import (
    Checker,
    bytes_checker,
    check_float64,
    checked_list,
    checker_of,
    encode,
    time_checker,
)
from slidectl.msgs.schema import BYTES, FLOATS, INTEGER_RANGES, PRIMITIVES, SCALAR, TIMES, Field

Message = dict[str, Any]
_KINDS: dict[str, Callable[[], Any]] = {**dict.fromkeys(INTEGER_RANGES, int), **dict.fromkeys(FLOATS, float)}
_KINDS |= {"bool": bool, "string": str}

_checkers: dict[str, Checker] = {}


def check(type_name: str, value: Any) -> Message:
    """A complete message of the type from a partial one: missing fields get their default.

    Integers become floats where a float is due, and null becomes nan; 0 and 1 pass for bool; bytes (`uint8[]`,
    `char[]`) may be base64 text, a list of integers or bytes, and become base64 text.

    Raises:
        UnknownName: no such type. BadMessage: the value does not fit; its `path` is the field.
    """
    try:
        checker = _checkers[type_name]
    except KeyError:
        checker = _checkers[type_name] = _compile(type_name)
    try:
        return checker(value)  # type: ignore[no-any-return]
    except Mismatch as problem:
        raise problem.as_error(type_name) from None


def default(type_name: str) -> Message:
    """A fresh complete message: zeros, empty texts, empty lists. Raises UnknownName."""
    return _message_maker(type_name)()  # type: ignore[no-any-return]


def _compile(type_name: str) -> Checker:
    return time_checker(type_name) if type_name in TIMES else _message_checker(definition_of(type_name))


def _message_checker(of: Definition) -> Checker:
    slots = tuple((field.name, _field_checker(field), _field_maker(field)) for field in of.fields)
    fields = tuple(field.name for field in of.fields)

    def check_message(value: Any) -> Message:
        if type(value) is not dict and not isinstance(value, Mapping):
            raise must_be(f"an object (a {of.name})", value, _has(of))
        result = {}
        given = 0
        name = ""
        try:
            for name, checker, make in slots:
                if name in value:
                    result[name] = checker(value[name])
                    given += 1
                else:
                    result[name] = make()
        except Mismatch as problem:
            problem.steps.append(name)
            problem.hint = problem.hint or _has(of)
            raise
        if given != len(value):
            raise UnknownField(next(key for key in value if key not in fields), of.name, fields)
        return result

    return check_message


def _has(of: Definition) -> str:
    """`pkg/Type has the fields float64 x, float64[] y`."""
    fields = ", ".join(f"{field.type_text} {field.name}" for field in of.fields)
    return f"{of.name} has the fields {fields}" if fields else f"{of.name} has no fields"


@cache
def _element_checker(type_name: str) -> Checker:
    return checker_of(type_name) if type_name in PRIMITIVES - TIMES else _shared(type_name)


def _shared(type_name: str) -> Checker:
    if type_name not in _checkers:
        _checkers[type_name] = _compile(type_name)
    return _checkers[type_name]


def _field_checker(field: Field) -> Checker:
    if field.array == SCALAR:
        return _element_checker(field.type)
    if field.type in BYTES:
        return bytes_checker(field.type, field.array)
    return _float_list_checker(field) if field.type == "float64" else _list_checker(field)


def _list_checker(field: Field) -> Checker:
    element = _element_checker(field.type)
    length = field.array

    def check_list(value: Any) -> list[Any]:
        if type(value) is not list:
            value = _as_list(value, field)
        if length and len(value) != length:
            raise _wrong_length(value, field)
        return checked_list(value, element)

    return check_list


def _float_list_checker(field: Field) -> Checker:
    length = field.array

    def check_floats(value: Any) -> list[float]:
        if type(value) is not list:
            value = _as_list(value, field)
        if length and len(value) != length:
            raise _wrong_length(value, field)
        for number in value:
            if type(number) is not float:
                return checked_list(value, check_float64)
        return value[:]  # type: ignore[no-any-return]

    return check_floats


def _as_list(value: Any, field: Field) -> list[Any]:
    if isinstance(value, (list, tuple)):
        return list(value)
    if hasattr(value, "tolist"):  # an array of numpy, from a script beside the simulation
        return _as_list(value.tolist(), field)
    raise must_be(f"a list ({field.type_text})", value)


def _wrong_length(value: list[Any], field: Field) -> Mismatch:
    return Mismatch(f"must be a list of exactly {field.array} ({field.type_text}), not of {len(value)}")


@cache
def _message_maker(type_name: str) -> Callable[[], Any]:
    slots = tuple((field.name, _field_maker(field)) for field in definition_of(type_name).fields)
    return lambda: {name: make() for name, make in slots}


@cache
def _field_maker(field: Field) -> Callable[[], Any]:
    if field.array == SCALAR:
        return _element_maker(field.type)
    if field.type in BYTES:
        return partial(str, encode(bytes(field.array)))
    if not field.array:
        return list
    element = _element_maker(field.type)
    return lambda: [element() for _ in range(field.array)]


def _element_maker(type_name: str) -> Callable[[], Any]:
    if type_name in TIMES:
        return lambda: {"secs": 0, "nsecs": 0}
    if type_name in PRIMITIVES:
        return _KINDS[type_name]
    return _message_maker(type_name)
