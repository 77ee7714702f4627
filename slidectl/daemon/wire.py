"""The fields of what a client sends, read with suspicion: of the right kind, and of a size that can be told back."""

from __future__ import annotations

from typing import Any

from slidectl import names
from slidectl.errors import UsageError

Message = dict[str, Any]

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
    """A name, from the root if it is relative. Raises UsageError."""
    return names.join("/", text(message, key))


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
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
