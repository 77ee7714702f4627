"""The fields of what a client sends, read with suspicion: of the right kind, and of a size that can be told back."""

from __future__ import annotations

import json
import re
from typing import Any

from slidectl import names
from slidectl.client.lines import BadLine
from slidectl.errors import UsageError

Message = dict[str, Any]

_MOST_VALUES = 100_000
_MOST_MAPPINGS = 20_000
"""A mapping may stand for a message with all its default values."""
_LONGEST_ENVELOPE = 4096
_FIELD = re.compile(r'"(op|id|service)"\s*:\s*("(?:[^"\\\x00-\x1f]|\\["\\/bfnrt])*"|-?\d{1,18}(?=\s*[,}]))')
_LONGEST_ID = 1000
_DEEPEST_ID = 200
"""Characters of an id that is a list or a mapping: enough to number things with, too few to nest deeply."""
_LARGEST_NUMBER = 1e9


def text(message: Message, key: str, default: str | None = None) -> str:
    """Raises UsageError."""
    value = message.get(key, default)
    if not isinstance(value, str):
        raise UsageError(f"op {message['op']!r} needs {key!r}, a text")
    return value


def name(message: Message, key: str) -> str:
    """A name, from the root if it is relative. Raises UsageError: BadName for one that is too long."""
    given = text(message, key)
    if len(given) > names.LONGEST:
        raise names.TooLong(given)
    return names.join("/", given)


def check_size(line: bytes) -> None:
    """Raises BadLine for one that would take long to read, with as much of the message as tells what it is.

    Text is quick to read, values are not: a message of more than so many holds up the world. They are counted by what
    stands between them, without looking whether that is inside of a text.
    """
    if len(line) < _MOST_VALUES:
        return
    values = line.count(b",") + line.count(b"[")
    mappings = line.count(b"{")
    if values + mappings > _MOST_VALUES:
        raise BadLine(f"a line with {values + mappings} values, and {_MOST_VALUES} is the most")
    if mappings > _MOST_MAPPINGS:
        raise BadLine(f"a line with {mappings} mappings, and {_MOST_MAPPINGS} is the most")


def envelope(line: bytes) -> Message:
    """What stands before the first list of a line that is not read: its op, its id, its service, where given."""
    beginning = line[:_LONGEST_ENVELOPE].decode("utf-8", "replace")
    fields = {match[1]: json.loads(match[2]) for match in _FIELD.finditer(beginning.partition("[")[0])}
    return {key: fields[key] for key in ("op", "id", "service") if key in fields}


def check_id(message: Message) -> None:
    """Raises UsageError, and forgets the id, when it is one that nobody could want back."""
    given = message.get("id")
    most = _LONGEST_ID if isinstance(given, str) else _DEEPEST_ID
    try:
        fits = len(given if isinstance(given, str) else repr(given)) <= most
    except RecursionError:
        fits = False
    if not fits:
        del message["id"]
        raise UsageError(f"an id of more than {most} characters")


def given_id(message: Message) -> Message:
    """The id that comes back with the answer: as it was given, if it was."""
    return {"id": message["id"]} if "id" in message else {}


def wish_id(message: Message) -> str | None:
    """The id by which a subscription is told from another one of the same connection."""
    given = message.get("id")
    return None if given is None else str(given)


def number(message: Message, key: str) -> float:
    """0 when it is not given. Raises UsageError."""
    value = message.get(key) or 0
    if not isinstance(value, int | float) or not 0 <= value <= _LARGEST_NUMBER:
        raise UsageError(f"{key!r} is a number from 0 to {_LARGEST_NUMBER:g}, not {shortened(value)}")
    return value


def shortened(value: Any) -> str:
    """The value as an error quotes it."""
    text = repr(value[:60] if isinstance(value, str) else value)
    return text if len(text) <= 60 else text[:57] + "..."
