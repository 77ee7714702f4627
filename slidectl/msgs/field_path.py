"""Field paths such as `position[0]`, `pose/position/x`, `header.stamp` or `poses[:]/position`, which select values.

Components are separated by `/` or `.`; indices and slices are Python's. A path is checked against the type before the
first message; only an index can fail later. This module knows no message definitions: the caller gives the fields.
"""

from __future__ import annotations

import re
from binascii import a2b_base64
from collections.abc import Sequence
from typing import Any, NamedTuple

from slidectl.errors import Refused, UnknownName, UsageError
from slidectl.msgs.schema import BYTES, TIMES, Field, FieldsOf

_LONGEST = 1000
_STEP = re.compile(r"(\w+)((?:\[[^\]]*\])*)\Z")
_INTEGER = re.compile(r"\s*-?\d+\s*\Z")


class NoElement(Refused):
    """A message whose array is shorter than the index."""

    def __init__(self, step: str, length: int) -> None:
        super().__init__(f"index out of range: {step}, but the message has {length} there")


class PathStep(NamedTuple):
    """One component of a path: the field `name` of the type `owner`."""

    owner: str
    name: str
    is_packed: bool
    indices: Sequence[int | slice]
    is_list: bool

    def of(self, message: Any) -> Any:
        value = byte_values(message[self.name]) if self.is_packed else message[self.name]
        for index in self.indices:
            try:
                value = value[index]
            except IndexError:
                raise NoElement(f"{self.name}[{index}]", len(value)) from None
        return value


class Selection(NamedTuple):
    """The values that a path selects: values of `type` in `depth` nested lists."""

    type: str
    depth: int
    steps: Sequence[PathStep]

    def read(self, message: Any) -> Any:
        """Get the values out of a message. Raises NoElement."""
        return _read(message, self.steps)


def byte_values(value: Any) -> list[int]:
    """The numbers of a uint8[] or char[] field, given as base64 text or as a list."""
    return list(a2b_base64(value)) if isinstance(value, str) else list(value)


def select(fields_of: FieldsOf, root: str, text: str) -> Selection:
    """Find what the path `text` selects in messages of the type `root`. An empty path selects the whole message.

    Raises:
        UnknownName: no such field; it lists the existing ones. UsageError: not a path, or an index of what is no array.
    """
    if len(text) > _LONGEST:
        raise UsageError(f"the path of a field is longer than {_LONGEST} characters")
    here, depth, steps = root, 0, []
    for part in re.split(r"[/.](?![^\[]*\])", text) if text else ():
        match = _STEP.match(part)
        if match is None:
            reason = "']' is missing" if "[" in part and "]" not in part else "write name, name[0] or name[1:3]"
            raise UsageError(f"{part!r} is not a field: {reason}")
        name, indices = match[1], [_index(inside, part) for inside in re.findall(r"\[([^\]]*)\]", match[2])]
        owner, field = here, _field(fields_of, here, name)
        here, is_list = field.type, field.array >= 0
        for index, inside in zip(indices, re.findall(r"\[[^\]]*\]", match[2]), strict=True):
            if not is_list:
                raise UsageError(f"{name!r} of {owner} is {field.type_text}, which has no element {name}{inside}")
            is_list = isinstance(index, slice)
        steps.append(PathStep(owner, name, field.array >= 0 and here in BYTES, indices, is_list))
        depth += is_list
    return Selection(here, depth, steps)


def _index(text: str, part: str) -> int | slice:
    numbers = text.split(":")
    if len(numbers) > 3 or not all(_INTEGER.match(n) or (not n.strip() and len(numbers) > 1) for n in numbers):
        raise UsageError(f"{part!r} is not a field: an index is a number or a slice, [0], [-1], [1:3] or [::2]")
    values = [int(n) if n.strip() else None for n in numbers]
    if len(values) == 3 and values[2] == 0:
        raise UsageError(f"{part!r} is not a field: the step of a slice cannot be 0")
    return int(text) if len(values) == 1 else slice(*values)


def _field(fields_of: FieldsOf, owner: str, name: str) -> Field:
    known = {field.name: field for field in TIMES.get(owner) or fields_of(owner)}
    if not known:
        raise UsageError(f"{owner} has no fields, so there is no {name!r} in it")
    if name not in known:
        raise UnknownName("field", name, list(known), f"in {owner}")
    return known[name]


def _read(value: Any, steps: Sequence[PathStep]) -> Any:
    for number, step in enumerate(steps, 1):
        value = step.of(value)
        if step.is_list and number < len(steps):
            return [_read(each, steps[number:]) for each in value]
    return value
