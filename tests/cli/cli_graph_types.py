"""Schemas of message types for the tests of the printers, as the daemon's /rosapi/message_details would give them."""

from __future__ import annotations

from slidectl import msgs
from slidectl.msgs.schema import PRIMITIVES, Field, Schema


def schema(type_name: str) -> Schema:
    """The schema of a type and all types in it."""
    types: dict[str, tuple[Field, ...]] = {}
    _collect(type_name, types)
    return Schema(type_name, types)


def _collect(type_name: str, types: dict[str, tuple[Field, ...]]) -> None:
    if type_name in types or type_name in PRIMITIVES:
        return
    types[type_name] = msgs.fields(type_name)
    for field in types[type_name]:
        _collect(field.type, types)
