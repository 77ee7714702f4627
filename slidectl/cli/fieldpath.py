"""Paths into a message: `position[0]`, `pose/position/x`, `poses[:]/position`, `position[::2]`.

Parsing, checking against a schema and following. A name that does not exist is found before the first message; an
index that is too large only in the message.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from slidectl.cli.schema import BYTES, TIMES, Field, Schema
from slidectl.cli.yamlform import byte_values
from slidectl.errors import Refused, UnknownName, UsageError

Index = int | slice
_STEP = r"(?P<name>\w+)(?P<indices>(\[[^\]]*\])*)\Z"
_INTEGER = r"\s*-?\d+\s*\Z"
_TIME_FIELDS = {"time": ("uint32", "uint32"), "duration": ("int32", "int32")}


class Step(NamedTuple):
    """One component of a path: a field and what is taken out of its array."""

    name: str
    indices: tuple[Index, ...]


class Selection(NamedTuple):
    """What a path leads to: values of `type` in `depth` nested lists; `take` gets them out of a message."""

    type: str
    depth: int
    take: Callable[[Any], Any]


class IndexOutOfRange(Refused):
    """A message whose array is shorter than the index that was asked for."""

    def __init__(self, step: str, length: int) -> None:
        super().__init__(f"index out of range: {step}, but the message has {length} there")


def parse(text: str) -> tuple[Step, ...]:
    """The steps of a path; components are separated by `/` or `.`. Raises UsageError for text that is no path."""
    return tuple(_step(part) for part in _components(text)) if text else ()


def _components(text: str) -> list[str]:
    return re.split(r"[/.](?![^\[]*\])", text)


def _step(part: str) -> Step:
    match = re.match(_STEP, part)
    if not match:
        missing = "[" in part and "]" not in part
        raise UsageError(
            f"{part!r} is not a field: " + ("']' is missing" if missing else "write name, name[0] or name[1:3]")
        )
    return Step(match["name"], tuple(_index(text, part) for text in re.findall(r"\[([^\]]*)\]", match["indices"])))


def _index(text: str, part: str) -> Index:
    numbers = text.split(":")
    if len(numbers) > 3 or not all(re.match(_INTEGER, n) or (not n.strip() and len(numbers) > 1) for n in numbers):
        raise UsageError(f"{part!r} is not a field: an index is a number or a slice, [0], [-1], [1:3] or [::2]")
    values = [int(n) if n.strip() else None for n in numbers]
    if len(values) == 3 and values[2] == 0:
        raise UsageError(f"{part!r} is not a field: the step of a slice cannot be 0")
    return int(numbers[0]) if len(numbers) == 1 else slice(*values)


def select(schema: Schema, text: str) -> Selection:
    """What the path `text` (may be empty) selects in messages of the schema's root type.

    Raises:
        UnknownName: no such field; it lists those that exist. UsageError: no path, or an index where there is no array.
    """
    selection = Selection(schema.root, 0, _itself)
    for step in parse(text):
        selection = _descend(schema, selection, step)
    return selection


def _descend(schema: Schema, owner: Selection, step: Step) -> Selection:
    field = _find(schema, owner.type, step.name)
    depth = int(field.array >= 0)
    take = _field_taker(field, step.name)
    for index in step.indices:
        if depth == 0:
            raise UsageError(f"{step.name!r} is {field.spelled}, which has no element {_spelled(step.name, index)}")
        depth -= isinstance(index, int)
        take = _indexed(take, index, step.name)
    return Selection(field.type, owner.depth + depth, _over(owner.take, take, owner.depth))


def _find(schema: Schema, type_name: str, name: str) -> Field:
    fields = _time_fields(type_name) or schema.fields(type_name)
    if not fields:
        raise UsageError(f"{type_name} has no fields, so there is no {name!r} in it")
    for field in fields:
        if field.name == name:
            return field
    raise UnknownName("field", name, [field.name for field in fields], f"in {type_name}")


def _time_fields(type_name: str) -> Sequence[Field]:
    if type_name not in TIMES:
        return ()
    return [Field(name, kind, -1) for name, kind in zip(("secs", "nsecs"), _TIME_FIELDS[type_name], strict=True)]


def _itself(message: Any) -> Any:
    return message


def _field_taker(field: Field, name: str) -> Callable[[Any], Any]:
    if field.array >= 0 and field.type in BYTES:
        return lambda message: byte_values(message[name])
    return lambda message: message[name]


def _indexed(take: Callable[[Any], Any], index: Index, name: str) -> Callable[[Any], Any]:
    def taken(message: Any) -> Any:
        values = take(message)
        try:
            return values[index]
        except IndexError:
            raise IndexOutOfRange(_spelled(name, index), len(values)) from None

    return taken


def _over(outer: Callable[[Any], Any], inner: Callable[[Any], Any], depth: int) -> Callable[[Any], Any]:
    """`inner` applied to what `outer` gives, element by element in `depth` lists."""

    def apply(value: Any, level: int) -> Any:
        return inner(value) if level == 0 else [apply(element, level - 1) for element in value]

    return lambda message: apply(outer(message), depth)


def _spelled(name: str, index: Index) -> str:
    if isinstance(index, int):
        return f"{name}[{index}]"
    parts = [index.start, index.stop] + ([index.step] if index.step is not None else [])
    return f"{name}[{':'.join('' if part is None else str(part) for part in parts)}]"
