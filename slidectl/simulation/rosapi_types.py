"""`/rosapi/message_details` and its like: type definitions taken apart, the type asked for first, then its parts.

Order and shape are rosapi's: depth first, each type once, constants in alphabetical order, times as types of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from slidectl import msgs
from slidectl.control.node_handle import Message

_TIMES = ("time", "duration")


def type_services() -> dict[str, tuple[str, Callable[[Message], Message]]]:
    """Service name to service type and handler. An unknown type fails the call with the names that are near."""
    return {
        "message_details": ("MessageDetails", lambda request: _details(request["type"])),
        "service_request_details": ("ServiceRequestDetails", lambda r: _details(msgs.request_type(r["type"]))),
        "service_response_details": ("ServiceResponseDetails", lambda r: _details(msgs.response_type(r["type"]))),
    }


def typedefs(type_name: str) -> list[Message]:
    """The type (rosapi/TypeDef), then those that it is made of. Raises UnknownName."""
    return list(_typedefs(type_name, set()))


def _details(type_name: str) -> Message:
    return {"typedefs": typedefs(type_name)}


def _typedefs(type_name: str, seen: set[str]) -> Iterator[Message]:
    if type_name in seen:
        return
    seen.add(type_name)
    if type_name in _TIMES:
        yield _time_typedef(type_name)
        return
    yield _typedef(type_name)
    for field in msgs.fields(type_name):
        if "/" in field.type or field.type in _TIMES:
            yield from _typedefs(field.type, seen)


def _typedef(type_name: str) -> Message:
    fields = msgs.fields(type_name)
    example = msgs.default(type_name)
    constants = sorted(msgs.constants(type_name))
    return {
        "type": type_name,
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [field.type for field in fields],
        "fieldarraylen": [field.array for field in fields],
        "examples": [_example(field, example[field.name]) for field in fields],
        "constnames": [constant.name for constant in constants],
        "constvalues": [str(constant.value) for constant in constants],
    }


def _example(field: msgs.Field, value: Any) -> str:
    """As rosapi writes it: empty brackets for lists and messages, else the default's text."""
    if field.array >= 0:
        return "[]"
    return "{}" if isinstance(value, dict) else str(value)


def _time_typedef(type_name: str) -> Message:
    return {
        "type": type_name,
        "fieldnames": ["secs", "nsecs"],
        "fieldtypes": ["int32", "int32"],
        "fieldarraylen": [-1, -1],
        "examples": ["0", "0"],
        "constnames": [],
        "constvalues": [],
    }
