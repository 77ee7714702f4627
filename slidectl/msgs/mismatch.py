"""Why a value does not fit a type: the reason, the path to it, and the text of the error that a user sees.

The path is collected while the exception climbs, so that the checkers need no book-keeping when all is well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from slidectl.errors import BadMessage, closest

# What a client sends may be huge; an error stays a line.
_LONGEST_SHOWN = 40
_MOST_KEYS = 8


class Mismatch(Exception):
    """A value that does not fit. `reason` ends the sentence that begins with the path."""

    def __init__(self, reason: str, hint: str | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.hint = hint
        self.steps: list[str] = []

    @property
    def path(self) -> str:
        """The field, as `points[0].x`; empty for the whole message."""
        return "".join(step if step[0] == "[" else f".{step}" for step in reversed(self.steps)).removeprefix(".")

    def as_error(self, type_name: str) -> BadMessage:
        """The error for the user who gave this value for a message of `type_name`."""
        return BadMessage(f"{type_name}: {self.path or 'the message'} {self.reason}", self.path, self.hint)


class UnknownField(Mismatch):
    """A field that the type at this place does not have."""

    def __init__(self, field: object, type_name: str, fields: Sequence[str]) -> None:
        hint = f"{type_name} has {'the fields ' + ', '.join(fields) if fields else 'no fields'}"
        self.field = _short(str(field))
        super().__init__(f"{self.field!r} is no field of {type_name}", hint)
        self.near = closest(self.field, fields)

    def as_error(self, type_name: str) -> BadMessage:
        """Names the unknown field by its full path, and the known one that is nearest in spelling."""
        path = f"{self.path}.{self.field}".removeprefix(".")
        near = f"{self.path}.{self.near}".removeprefix(".")
        suggestion = f". Did you mean {near!r}?" if self.near else ""
        return BadMessage(f"{type_name}: no field {path!r}{suggestion}", path, self.hint)


def must_be(expected: str, given: Any, hint: str | None = None) -> Mismatch:
    """The mismatch for a value of the wrong kind."""
    return Mismatch(f"must be {expected}, not {describe(given)}", hint)


def describe(value: Any) -> str:
    """The value as a person would name it: `the text 'abc'`, `a list of 3`, `null`."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {_short(repr(value[:_LONGEST_SHOWN]))}"
    if isinstance(value, (int, float)):
        return f"the number {_short(_number(value))}"
    if isinstance(value, Mapping):
        names = ", ".join(_short(str(key)) for key in islice(value, _MOST_KEYS))
        return f"an object with {_short(names)}" if value else "an empty object"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    return f"{type(value).__name__} {_short(str(value))}"


def _number(value: int | float) -> str:
    try:
        return str(value)
    except ValueError:  # Python writes no integers of thousands of digits
        return f"of {value.bit_length()} bits" if isinstance(value, int) else repr(value)


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST_SHOWN else text[: _LONGEST_SHOWN - 1] + "…"
