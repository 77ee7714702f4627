"""A path to one value of a message: `position[0]`, `pose.position.x`, `pose/position/x`, `header.stamp`.

Checked against the type before the first message; only an index can turn out wrong later.
"""

from __future__ import annotations

import binascii
import math
import re
from collections.abc import Callable
from typing import Any, NamedTuple

from slidectl import msgs, names
from slidectl.errors import UnknownName, UsageError

_PART = re.compile(r"(\w+)((?:\[-?\d+\])*)\Z")
_TIMES = ("time", "duration")
_BYTES = ("uint8", "char")
"""Arrays of these are base64 text inside messages."""


class MessagePath(NamedTuple):
    """Text as it was completed, type of the value (with `[]` for a whole array), and what takes it out of a message."""

    text: str
    type: str
    take: Callable[[Any], Any]


class NoElement(UnknownName):
    """An array that is shorter than the index."""

    def __init__(self, name: str, index: int, length: int) -> None:
        known = [f"{name}[{i}]" for i in range(min(length, 12))]
        super().__init__("element", f"{name}[{index}]", known, f"in a message with {length} there")


def parse(type_name: str, text: str) -> MessagePath:
    """The path `text` in messages of the type; empty means the only field of the type.

    Raises:
        UnknownName: no such field, or more than one to choose from; it lists those that exist. UsageError: no path.
    """
    if len(text) > names.LONGEST:
        raise names.TooLong(text)
    parts = [part for part in re.split(r"[./]", text) if part]
    if not parts:
        parts = [_only_field(type_name)]
    here, takers = type_name, []
    for part in parts:
        here, taker = _step(here, part)
        takers.append(taker)
    return MessagePath(".".join(parts), here, _chain(takers))


def _only_field(type_name: str) -> str:
    fields = [field.name for field in msgs.fields(type_name)]
    if len(fields) != 1:
        raise UnknownName("field", "", fields, f"in {type_name}: say which")
    return fields[0]


def _step(owner: str, part: str) -> tuple[str, Callable[[Any], Any]]:
    match = _PART.match(part)
    if match is None:
        raise UsageError(f"{part!r} is not a field: write name or name[0]")
    name, indices = match[1], [int(index) for index in re.findall(r"-?\d+", match[2])]
    field = _field(owner, name)
    if len(indices) > (field.array >= 0):
        raise UsageError(f"{part!r}: {name} is {field.type_text}, which has no such element")
    if indices:
        return field.type, _element(field, indices[0])
    return field.type_text, lambda message: message[name]


def _field(owner: str, name: str) -> msgs.Field:
    if owner in _TIMES:
        fields = tuple(msgs.Field(part, "int32") for part in ("secs", "nsecs"))
    else:
        fields = msgs.fields(owner) if "/" in owner and not owner.endswith("]") else ()
    for field in fields:
        if field.name == name:
            return field
    raise UnknownName("field", name, [field.name for field in fields], f"in {owner}")


def _element(field: msgs.Field, index: int) -> Callable[[Any], Any]:
    name, packed = field.name, field.type in _BYTES

    def take(message: Any) -> Any:
        values = binascii.a2b_base64(message[name]) if packed else message[name]
        if not -len(values) <= index < len(values):
            raise NoElement(name, index, len(values))
        return values[index]

    return take


def _chain(takers: list[Callable[[Any], Any]]) -> Callable[[Any], Any]:
    def take(message: Any) -> Any:
        for taker in takers:
            message = taker(message)
        return message

    return take


def as_number(value: Any) -> float | None:
    """The value as a number (a time in seconds), or None when it is none."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return _as_float(value)
    if isinstance(value, dict) and value.keys() == {"secs", "nsecs"}:
        return float(value["secs"] + 1e-9 * value["nsecs"])
    return None


def _as_float(value: int | float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
