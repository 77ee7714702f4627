"""JSON lines: one object per line, in both directions of the socket.

Encoding, decoding and splitting a stream of bytes into lines of bounded length. The bounds are against: a client that
sends without end, or JSON whose values fill the memory. It knows no socket and no operation.
"""

from __future__ import annotations

import json
import json.encoder
import re
from collections import deque
from typing import Any

from slidectl.errors import UsageError

LONGEST_LINE = 16 * 1024 * 1024
"""The maximum length of a line in bytes, in both directions."""
_QUOTED = 60
_MOST_VALUES = 100_000
_MOST_MAPPINGS = 20_000
"""Lower than the limit of values: a mapping may stand for a message with all its default values."""

_ENCODER = json.JSONEncoder(allow_nan=False, check_circular=False, separators=(",", ":"))
# `JSONEncoder.encode` makes this object anew for each message, which takes as long as encoding a short message.
_pieces = json.encoder.c_make_encoder(  # type: ignore[attr-defined]
    None, _ENCODER.default, json.encoder.encode_basestring_ascii, None, ":", ",", False, False, False
)
_encode_all = json.JSONEncoder(check_circular=False, separators=(",", ":")).encode
_decode = json.JSONDecoder().decode
_TEXTS_AND_NUMBERS = re.compile(r'"(?:[^"\\]|\\.)*"|-?Infinity|NaN')
_IN_JSON = {"NaN": "null", "Infinity": "1e999", "-Infinity": "-1e999"}


class BadLine(UsageError):
    """A line that is no JSON object, or is too long."""


def encode(message: dict[str, Any]) -> bytes:
    """The object as one line. NaN becomes null, as rosbridge sends it; infinities stay, see `numbers_of_json`."""
    try:
        text = "".join(_pieces(message, 0))
    except ValueError:  # the message has NaN or infinity, which is rare
        text = numbers_of_json(_encode_all(message))
    return (text + "\n").encode("ascii")


def encode_bounded(message: dict[str, Any]) -> bytes:
    """The object as one line. Raises BadLine: it is longer than the other end takes."""
    line = encode(message)
    if len(line) > LONGEST_LINE:
        raise BadLine(f"a message of {len(line)} bytes is more than the {LONGEST_LINE} that fit a line")
    return line


def numbers_of_json(text: str) -> str:
    """Replace Python's NaN and Infinity by JSON: null, and 1e999, which readers parse as infinity."""
    return _TEXTS_AND_NUMBERS.sub(lambda match: _IN_JSON.get(match[0], match[0]), text)


def check_size(line: bytes) -> None:
    """Check that a line can be decoded quickly. Raises BadLine.

    Long texts decode quickly, many values do not: decoding them delays the world. Values are counted by their
    separators, also those inside texts.
    """
    if len(line) < _MOST_VALUES:
        return
    values = line.count(b",") + line.count(b"[")
    mappings = line.count(b"{")
    if values + mappings > _MOST_VALUES:
        raise BadLine(f"a line with {values + mappings} values, and {_MOST_VALUES} is the most")
    if mappings > _MOST_MAPPINGS:
        raise BadLine(f"a line with {mappings} mappings, and {_MOST_MAPPINGS} is the most")


def decode(line: bytes) -> dict[str, Any]:
    """The object that the line holds. Raises BadLine."""
    try:
        # json.loads does the same after checks for other encodings and byte order marks, which take as long as
        # decoding.
        is_plain = line.startswith(b"{")
        value = _decode(line.decode("utf-8", "surrogatepass")) if is_plain else json.loads(line)
    except (ValueError, RecursionError) as error:
        raise BadLine(f"a line that is not JSON ({error}): {_beginning(line)}") from None
    if not isinstance(value, dict):
        raise BadLine(f"a line that is not a JSON object but {type(value).__name__}: {_beginning(line)}")
    return value


def _beginning(line: bytes) -> str:
    text = repr(line[:_QUOTED].decode("utf-8", "replace"))
    return text + (f" and {len(line) - _QUOTED} bytes more" if len(line) > _QUOTED else "")


class LineBuffer:
    """Splits received bytes into whole lines. An unfinished line is at most `longest` bytes."""

    def __init__(self, longest: int = LONGEST_LINE) -> None:
        self._longest = longest
        self._rest = bytearray()
        self.lines: deque[bytes] = deque()

    @property
    def unfinished(self) -> int:
        """The number of bytes of the last line, whose end has not arrived."""
        return len(self._rest)

    def feed(self, data: bytes) -> None:
        """Add received bytes. Raises BadLine when a line exceeds the limit; whole lines before it are kept."""
        *whole, rest = data.split(b"\n")
        if whole and self._rest:
            whole[0] = b"".join((self._rest, whole[0]))  # one copy: the line may have 16 MiB
            self._rest.clear()
        for line in whole:
            if line and not line.isspace():
                self.lines.append(line)
        if not rest:
            return
        self._rest += rest
        if len(self._rest) > self._longest:
            self._rest.clear()
            raise BadLine(f"a line longer than {self._longest} bytes")
