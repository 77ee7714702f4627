"""Messages and requests from a file or a pipe: YAML documents between `---` lines, or JSON lines.

A document is read as soon as it is complete, and the last one needs no `---`. Nothing is checked against a type.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

from slidectl.cli import values
from slidectl.client.lines import LONGEST_LINE
from slidectl.errors import BadFile, UsageError

_ENDS = ("---", "...")
_LONGEST_TEXT = 64 * 1024 * 1024
_NO_JSON: Any = object()


def from_file(path: str) -> list[Any]:
    """The documents of a file; `-` is stdin. Raises BadFile."""
    if path == "-":
        return list(from_stdin())
    text = text_of(path)
    lines = text.splitlines(keepends=True)
    if any(_json(line) is not _NO_JSON for line in lines[:1]):
        return list(split(lines))
    return list(values.read_documents(text, "file", path))


def text_of(path: str) -> str:
    """The text of a file; `-` is stdin. Raises BadFile when it cannot be read, or has no end."""
    try:
        if path == "-":
            return _whole(sys.stdin, "stdin")
        with open(path, encoding="utf-8") as file:
            return _whole(file, path)
    except (OSError, UnicodeDecodeError) as error:
        raise BadFile(getattr(error, "strerror", None) or str(error), path) from None


def _whole(file: TextIO, name: str) -> str:
    text = file.read(_LONGEST_TEXT + 1)
    if len(text) > _LONGEST_TEXT:
        raise BadFile(f"holds more than {_LONGEST_TEXT >> 20} Mi characters", name)
    return text


def from_stdin() -> Iterator[Any]:
    """The documents on stdin as they come. Raises UsageError with the number of the one that cannot be read."""
    try:
        yield from split(bounded(sys.stdin, "stdin"))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot read stdin: {error}") from None


def bounded(file: TextIO, name: str) -> Iterator[str]:
    """The lines of a file, none of them without end. Raises BadFile."""
    for number in itertools.count(1):
        line = file.readline(LONGEST_LINE)
        if not line:
            return
        if len(line) == LONGEST_LINE and line[-1] != "\n":
            raise BadFile(f"a line longer than {LONGEST_LINE} characters", name, number)
        yield line


def split(lines: Iterable[str]) -> Iterator[Any]:
    """The documents in lines of text. A line that is JSON by itself is one; null in it is NaN, as on the wire."""
    pending: list[str] = []
    size = 0
    count = 1
    after_json = False
    for line in lines:
        if line.rstrip() in _ENDS:
            if pending:
                yield _read(pending, count)
                count += 1
            pending, size, after_json = [], 0, False
        elif not pending and (value := _json(line)) is not _NO_JSON:
            yield value
            count += 1
            after_json = True
        elif line.strip() or not after_json:
            pending.append(line)
            size += len(line)
            if size > LONGEST_LINE:
                raise UsageError(f"the document {count} is longer than {LONGEST_LINE} characters")
    if any(line.strip() for line in pending):
        yield _read(pending, count)


def _read(lines: list[str], number: int) -> Any:
    return values.read_yaml("".join(lines), f"document {number}")


def _json(line: str) -> Any:
    if not line.strip():
        return _NO_JSON
    try:
        return _with_nan(json.loads(line))
    except (ValueError, RecursionError):
        return _NO_JSON


def _with_nan(value: Any) -> Any:
    """JSON's null is what NaN becomes on the wire."""
    if value is None:
        return math.nan
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    return [_with_nan(item) for item in value] if isinstance(value, list) else value
