"""Frames of Foxglove's WebSocket protocol: JSON objects as text, and binary frames that begin with an operation code.

It decodes frames of apps and encodes frames for them. It knows no connection. Integers are little-endian. JavaScript
has one number type, so 1.0 comes back as 1: the type of a parameter distinguishes float from integer.
"""

from __future__ import annotations

import json
import struct
from typing import Any, NamedTuple

from slidectl.errors import UsageError, cut, quoted
from slidectl.wire.json_lines import encode

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""The names used by Foxglove's SDK and app, and by older clients. The frames are the same."""
LONGEST_FRAME = 16 * 1024 * 1024
"""The maximum length of a received frame in bytes."""
MOST_ID = 2**32 - 1
WARNING, ERROR = 1, 2
"""Status levels of the protocol."""

_MOST_VALUES = 100_000
_FLOAT, _FLOATS, _BYTES = "float64", "float64_array", "byte_array"
_LONGEST_STATUS = 4000
_MESSAGE, _SERVICE_REQUEST = 1, 2
_TIME, _SERVICE_RESPONSE, _ASSET = 2, 3, 4
_MESSAGE_HEAD = struct.Struct("<BIQ")
_CALL_HEAD = struct.Struct("<BIII")


Parameter = dict[str, Any]


class BadFrame(UsageError):
    """A frame of an app violates the protocol."""


class AppMessage(NamedTuple):
    """A message that an app publishes on one of its channels."""

    channel: int
    payload: bytes


class AppRequest(NamedTuple):
    """A call of a service by an app."""

    service: int
    call: int
    encoding: str
    payload: bytes


def read_text(text: str) -> dict[str, Any]:
    """Decode a text frame: a JSON object whose `op` is text. Raises BadFrame."""
    message = read_json(text)
    if not isinstance(message.get("op"), str):
        raise BadFrame("a frame without an op")
    return message


def read_json(text: str) -> dict[str, Any]:
    """Decode a JSON object. Raises BadFrame."""
    if len(text) > _MOST_VALUES and sum(map(text.count, ",[{")) > _MOST_VALUES:
        raise BadFrame(f"JSON of more than {_MOST_VALUES} values")
    try:
        message = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadFrame(f"this is not JSON: {error}") from None
    if not isinstance(message, dict):
        raise BadFrame("this is not a JSON object")
    return message


def read_binary(data: bytes) -> AppMessage | AppRequest:
    """Decode a binary frame. Raises BadFrame."""
    operation = data[0] if data else 0
    if operation == _MESSAGE and len(data) >= 5:
        return AppMessage(int.from_bytes(data[1:5], "little"), data[5:])
    if operation == _SERVICE_REQUEST and len(data) >= _CALL_HEAD.size:
        _, service, call, length = _CALL_HEAD.unpack_from(data)
        encoding, payload = data[_CALL_HEAD.size :][:length], data[_CALL_HEAD.size + length :]
        if len(encoding) == length:
            return AppRequest(service, call, encoding.decode("utf-8", "replace"), payload)
    raise BadFrame(f"a binary frame of {len(data)} bytes with the operation {operation} that is cut off or unknown")


def field(message: dict[str, Any], key: str, kind: type) -> Any:
    """A field of an object. Raises BadFrame: it is missing or has another type."""
    value = message.get(key)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise BadFrame(f"{quoted(str(message.get('op', 'an object')))}: {key} must be a {_KINDS[kind]}")
    return value


def fields(message: dict[str, Any], key: str, kind: type, most: int) -> list[Any]:
    """A field that is a list of at most `most` values of type `kind`. Raises BadFrame."""
    values = field(message, key, list)
    if len(values) > most:
        raise BadFrame(f"{key}: {len(values)} values, more than {most}")
    if any(not isinstance(value, kind) or isinstance(value, bool) for value in values):
        raise BadFrame(f"{quoted(str(message.get('op', '')))}: each of {key} must be a {_KINDS[kind]}")
    return list(values)


def number(message: dict[str, Any], key: str) -> int:
    """A field that is an id: an unsigned 32-bit integer. Raises BadFrame."""
    value = field(message, key, int)
    if not 0 <= value <= MOST_ID:
        raise BadFrame(f"{key} must be a number of 32 bits")
    return int(value)


_KINDS: dict[type, str] = {int: "whole number", str: "text", list: "list", dict: "JSON object"}


def text_frame(op: str, **values: Any) -> str:
    """Encode a JSON object. NaN becomes null, and infinity a number that parses as infinity."""
    return encode({"op": op, **values}).decode("ascii").rstrip("\n")


def status_frame(level: int, message: str, status_id: str = "") -> str:
    """A status for the app's list of problems; it replaces an earlier one with the same id."""
    return text_frame(
        "status", level=level, message=cut(message, _LONGEST_STATUS), **({"id": status_id} if status_id else {})
    )


def message_frame(subscription: int, time_ns: int, payload: bytes) -> bytes:
    """A message of a channel. `time_ns` is its publication time, simulated, in ns."""
    return _MESSAGE_HEAD.pack(_MESSAGE, subscription, time_ns) + payload


def time_frame(time_ns: int) -> bytes:
    """The simulated time, in ns."""
    return struct.pack("<BQ", _TIME, time_ns)


def response_frame(request: AppRequest, payload: bytes) -> bytes:
    """The response to a call, in the encoding of its request."""
    encoding = request.encoding.encode()
    return _CALL_HEAD.pack(_SERVICE_RESPONSE, request.service, request.call, len(encoding)) + encoding + payload


def asset_frame(request: int, data: bytes) -> bytes:
    """The content of a requested file."""
    return struct.pack("<BIBI", _ASSET, request, 0, 0) + data


def no_asset_frame(request: int, why: str) -> bytes:
    """The refusal of a requested file, with the reason."""
    text = why.encode("utf-8", "replace")
    return struct.pack("<BIBI", _ASSET, request, 1, len(text)) + text


def parameter(name: str, value: Any) -> Parameter:
    """A parameter with its value and, for floats, its type."""
    found: Parameter = {"name": name, "value": value}
    if isinstance(value, float):
        found["type"] = _FLOAT
    elif isinstance(value, list) and any(isinstance(each, float) for each in value) and all(map(_is_number, value)):
        found["type"] = _FLOATS
    return found


def wanted_parameter(given: Parameter) -> tuple[str, Any]:
    """Name and value of a parameter that an app sets; None deletes it. Raises BadFrame."""
    name, value, kind = field(given, "name", str), given.get("value"), given.get("type")
    if kind == _BYTES:
        raise BadFrame(f"{name}: a parameter of slidectl holds no bytes; give text or a list")
    if kind == _FLOAT and _is_number(value):
        value = _float(value)
    elif kind == _FLOATS and isinstance(value, list):
        value = [_float(each) if _is_number(each) else each for each in value]
    return name, value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        raise BadFrame("a number that is too large") from None
