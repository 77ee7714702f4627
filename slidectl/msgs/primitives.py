"""Checkers of single values, one function per primitive type. Each returns the value to keep or raises Mismatch.

The first line of each is the way of a value that is right already; everything else may be slow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from struct import Struct
from typing import Any

from slidectl.msgs.mismatch import Mismatch, UnknownField, describe, must_be
from slidectl.msgs.schema import FLOATS, INTEGER_RANGES

Checker = Callable[[Any], Any]

_FLOAT32 = Struct("=f")
_FLOAT32_MAX = 3.4028234663852886e38
_NS = 1_000_000_000
_BYTES_WANTED = "base64 text or a list of integers from 0 to 255"
_SECONDS_RANGE = {"time": INTEGER_RANGES["uint32"], "duration": INTEGER_RANGES["int32"]}


def checker_of(type_name: str) -> Checker:
    """The checker of a primitive type other than a time."""
    if type_name in INTEGER_RANGES:
        return _integer(type_name)
    if type_name in FLOATS:
        return check_float64 if type_name == "float64" else _check_float32
    return _check_bool if type_name == "bool" else check_string


def check_float64(value: Any) -> float:
    """A number; null is not-a-number, as rosbridge sends it."""
    if type(value) is float:
        return value
    return _as_float(value, "float64")


def _check_float32(value: Any) -> float:
    number = _as_float(value, "float32")
    if abs(number) > _FLOAT32_MAX and not math.isinf(number):
        raise Mismatch(f"must be float32 (at most 3.4e38), not the number {number}")
    rounded: float = _FLOAT32.unpack(_FLOAT32.pack(number))[0]  # what a reader in ROS gets
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
    """True for numbers of that kind of `numbers` other than bool; numpy's scalars are such."""
    if isinstance(value, (bool, str)):
        return False
    import numbers  # late: a command line must start fast

    return isinstance(value, getattr(numbers, kind))


def _integer(type_name: str) -> Checker:
    lowest, highest = INTEGER_RANGES[type_name]

    def check(value: Any) -> int:
        if type(value) is int and lowest <= value <= highest:
            return value
        if not _is_number(value, "Integral"):
            raise must_be(f"an integer ({type_name})", value)
        if not lowest <= value <= highest:
            raise must_be(f"{type_name} ({lowest} to {highest})", value)
        return int(value)

    return check


def _check_bool(value: Any) -> bool:
    if value is True or value is False:
        return bool(value)
    if _is_number(value, "Integral") and value in (0, 1):
        return bool(value)
    raise must_be("true or false", value)


def check_string(value: Any) -> str:
    """Text that can be written as UTF-8."""
    if type(value) is str and value.isascii():
        return value
    if not isinstance(value, str):
        raise must_be("text (string)", value)
    try:
        value.encode()
    except UnicodeEncodeError:
        raise Mismatch("holds half of a surrogate pair, which is no text") from None
    return str(value)


@cache
def time_checker(type_name: str) -> Checker:
    """The checker of `time` or `duration`: {"secs", "nsecs"}, brought to 0 <= nsecs < 10^9 as ROS does."""
    lowest, highest = _SECONDS_RANGE[type_name]
    integer = _integer("int64")

    def check(value: Any) -> dict[str, int]:
        if type(value) is dict and len(value) == 2:
            secs, nsecs = value.get("secs"), value.get("nsecs")
            if type(secs) is int and type(nsecs) is int and 0 <= nsecs < _NS and lowest <= secs <= highest:
                return {"secs": secs, "nsecs": nsecs}
        return check_slowly(value)

    def check_slowly(value: Any) -> dict[str, int]:
        if not isinstance(value, Mapping):
            raise must_be(f"a {type_name} {{secs, nsecs}}", value)
        for key in value:
            if key not in ("secs", "nsecs"):
                raise UnknownField(key, type_name, ("secs", "nsecs"))
        secs, nsecs = _step("secs", integer, value), _step("nsecs", integer, value)
        if not 0 <= nsecs < _NS:
            secs, nsecs = secs + nsecs // _NS, nsecs % _NS
        if not lowest <= secs <= highest:
            raise Mismatch(f"must be a {type_name} of {lowest} to {highest} seconds, not {describe(secs)}")
        return {"secs": secs, "nsecs": nsecs}

    return check


def _step(key: str, integer: Checker, value: Mapping[str, Any]) -> int:
    try:
        return int(integer(value.get(key, 0)))
    except Mismatch as problem:
        problem.steps.append(key)
        raise


def bytes_checker(type_name: str, length: int) -> Checker:
    """The checker of a list of bytes, which a message holds as base64 text: takes that, a list of integers, or bytes.

    `length` 0 is any.
    """
    element = _integer(type_name)

    def check(value: Any) -> str:
        data = _decoded(value) if isinstance(value, str) else _packed(value, element)
        if length and len(data) != length:
            raise Mismatch(f"must hold exactly {length} bytes, not {len(data)}")
        return value if isinstance(value, str) else encode(data)

    return check


def encode(data: bytes) -> str:
    """Bytes as the base64 text that stands for them in a message."""
    import binascii

    return binascii.b2a_base64(data, newline=False).decode("ascii")


def _decoded(text: str) -> bytes:
    import binascii

    try:
        return binascii.a2b_base64(text, strict_mode=True) if text else b""
    except ValueError:
        raise must_be(_BYTES_WANTED, text) from None


def _packed(value: Any, element: Checker) -> bytes:
    if isinstance(value, (bytes, bytearray)):
        return bytes(value)
    if not isinstance(value, (list, tuple)):
        raise must_be(_BYTES_WANTED, value)
    return bytes(checked_list(value, element))


def checked_list(values: Any, element: Checker) -> list[Any]:
    """The checked elements; a mismatch knows the index of the first wrong one."""
    try:
        return [element(value) for value in values]
    except Mismatch:
        for index, value in enumerate(values):
            try:
                element(value)
            except Mismatch as problem:
                problem.steps.append(f"[{index}]")
                raise problem from None
        raise
