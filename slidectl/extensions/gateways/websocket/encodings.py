"""rosbridge's message encodings: PNG, CBOR, CBOR with ROS 1 bytes (cbor-raw), and fragments.

An encoder takes a publish line of the daemon and returns a frame. All browsers share the encoder of a type: a message
for several browsers is encoded once.
"""

from __future__ import annotations

import json
import math
import zlib
from binascii import a2b_base64, b2a_base64
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from struct import Struct, pack
from sys import getsizeof
from typing import Any

import cbor2

from slidectl import msgs
from slidectl.errors import UsageError
from slidectl.extensions.gateways.ros1.ros1_types import ros1_type
from slidectl.msgs.schema import BYTES, CODES, FLOATS, PRIMITIVES, SCALAR, Field
from slidectl.wire.json_lines import decode

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
"""If a browser subscribes a topic several times, the last one in this order is used."""
SMALLEST_FRAGMENT = 256
_ARRAY_TAGS = {"H": 69, "I": 70, "Q": 71, "b": 72, "h": 77, "i": 78, "q": 79, "f": 85, "d": 86}
"""struct code -> tag of typed arrays, little-endian (RFC 8746). Byte arrays are CBOR byte strings."""
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER = Struct(">IIBBBBB")
_RGB, _BITS = 2, 8

Frame = tuple[bytes, bool]
"""The bytes to send, and whether they are text."""
Encode = Callable[[bytes], Frame]
Convert = Callable[[Any], Any]


@cache
def encoder(compression: str, type_name: str) -> Encode:
    """The encoder of a type's messages; `compression` is one of COMPRESSIONS except "none". Raises UnknownName.

    It caches its last frame for the next browser.
    """
    if compression == "png":
        return lru_cache(1)(lambda line: (_png(line), True))
    if compression == "cbor":
        return lru_cache(1)(_cbor(_converter(type_name)))
    return lru_cache(1)(_cbor_raw(ros1_type(type_name).pack))


def _png(line: bytes) -> bytes:
    """Encode a line as the RGB pixels of an almost square PNG, padded with newlines."""
    width = max(1, math.isqrt(len(line) // 3))
    height = math.ceil(len(line) / 3 / width)
    row = 3 * width
    pixels = line.ljust(row * height, b"\n")
    rows = b"".join(b"\0" + pixels[at : at + row] for at in range(0, len(pixels), row))  # 0: as they are
    parts = {b"IHDR": _HEADER.pack(width, height, _BITS, _RGB, 0, 0, 0), b"IDAT": zlib.compress(rows), b"IEND": b""}
    image = _SIGNATURE + b"".join(
        pack(">I", len(part)) + name + part + pack(">I", zlib.crc32(name + part)) for name, part in parts.items()
    )
    return b'{"op":"png","data":"' + b2a_base64(image, newline=False) + b'"}'


def _cbor(convert: Convert) -> Encode:
    def encode(line: bytes) -> Frame:
        message = decode(line)
        message["msg"] = convert(message["msg"])
        return cbor2.dumps(message), False

    return encode


def _cbor_raw(to_bytes: Callable[[Any], bytes]) -> Encode:
    """The encoder for lines with the simulated time. A line sent before the time was requested stays unchanged."""

    def encode(line: bytes) -> Frame:
        message = decode(line)
        if "time" not in message:
            return line, True
        raw = {**message["time"], "bytes": to_bytes(message["msg"])}
        return cbor2.dumps({"op": "publish", "topic": message["topic"], "msg": raw}), False

    return encode


@cache
def _converter(type_name: str) -> Convert:
    """The conversion of a message from JSON's values to CBOR's. Raises UnknownName."""
    if type_name in FLOATS:
        return lambda value: math.nan if value is None else float(value)
    if type_name in PRIMITIVES:
        return lambda value: value
    parts = [(field.name, _field_converter(field)) for field in msgs.fields(type_name)]
    return lambda message: {name: convert(message[name]) for name, convert in parts}


def _field_converter(field: Field) -> Convert:
    if field.array == SCALAR:
        return _converter(field.type)
    if field.type in BYTES:
        return a2b_base64
    each = _converter(field.type)
    code = CODES.get(field.type)
    if code in _ARRAY_TAGS:
        tag = _ARRAY_TAGS[code]
        return lambda values: cbor2.CBORTag(tag, pack(f"<{len(values)}{code}", *map(each, values)))
    return lambda values: [each(value) for value in values]


def fragments(text: bytes, size: int, name: str) -> Iterator[bytes]:
    """Split a frame into fragment frames of `size` characters; `name` is their id. The text is ASCII."""
    total = -(-len(text) // size)
    for number in range(total):
        piece = text[number * size : (number + 1) * size].decode("ascii")
        fragment = {"op": "fragment", "id": name, "data": piece, "num": number, "total": total}
        yield json.dumps(fragment, separators=(",", ":")).encode("ascii")


class FragmentBuffer:
    """Reassembles fragmented frames; unfinished ones are limited in size."""

    MOST_FRAMES = 16
    _OVERHEAD = 200
    """Bytes counted per fragment in addition to its text."""

    def __init__(self, most_bytes: int, holds: Callable[[int], None] = lambda _: None) -> None:
        """`holds` is told the bytes in memory."""
        self._most_bytes = most_bytes
        self._holds = holds
        self._memory = 0
        self._waiting: dict[str, dict[int, str]] = {}
        self._totals: dict[str, int] = {}
        self._bytes = 0

    def add(self, fragment: dict[str, Any]) -> bytes | None:
        """Add a fragment. Returns the whole frame when it is complete.

        Raises:
            UsageError: an invalid fragment, or a limit is exceeded; all fragments of its frame are discarded then.
        """
        name, text = str(fragment.get("id"))[:1000], fragment.get("data")
        number, total = fragment.get("num"), fragment.get("total")
        if not (isinstance(text, str) and isinstance(number, int) and isinstance(total, int) and 0 <= number < total):
            raise UsageError("a fragment needs an id, data (a string), and num from 0 to total - 1")
        if self._totals.setdefault(name, total) != total:
            self._forget(name)
            raise UsageError(f"the fragments of {name!r} differ in their total")
        pieces = self._waiting.setdefault(name, {})
        if number not in pieces:
            pieces[number] = text
            self._bytes += len(text) + self._OVERHEAD
            self._memory += getsizeof(text) + self._OVERHEAD
            self._holds(self._memory)
        if len(pieces) == total:
            whole = "".join(pieces[place] for place in range(total))
            self._forget(name)
            return whole.encode("utf-8", "surrogatepass")
        if self._bytes > self._most_bytes or len(self._waiting) > self.MOST_FRAMES:
            self._forget(name)
            raise UsageError(f"{self._most_bytes} bytes and {self.MOST_FRAMES} frames may wait for their fragments")
        return None

    def clear(self) -> None:
        """Discard all fragments."""
        for name in list(self._waiting):
            self._forget(name)

    def _forget(self, name: str) -> None:
        self._totals.pop(name, None)
        pieces = self._waiting.pop(name, {}).values()
        self._bytes -= sum(len(text) + self._OVERHEAD for text in pieces)
        self._memory -= sum(getsizeof(text) + self._OVERHEAD for text in pieces)
        self._holds(self._memory)
