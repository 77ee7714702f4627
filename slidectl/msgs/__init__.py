"""Message, service and action types of ROS 1: what they are made of, building messages, and checking them.

A message is a plain dict in the shape of its JSON, with all fields. Types are named `pkg/Type`. Nothing here knows
what a message is used for. Definitions are read when a type is first asked for; importing this costs little.
"""

from __future__ import annotations

from slidectl.msgs.catalogue import (
    definition_of,
    exists,
    service_exists,
    service_names,
    service_of,
    type_names,
)
from slidectl.msgs.checking import Message, check, default
from slidectl.msgs.schema import Constant, Field
from slidectl.msgs.text import definition, md5, service_definition, service_md5, show, show_service

__all__ = [
    "Constant",
    "Field",
    "Message",
    "check",
    "constants",
    "default",
    "definition",
    "exists",
    "fields",
    "md5",
    "request_type",
    "response_type",
    "service_definition",
    "service_exists",
    "service_md5",
    "service_names",
    "show",
    "show_service",
    "type_names",
]


def fields(type_name: str) -> tuple[Field, ...]:
    """The fields in their order. Raises UnknownName."""
    return definition_of(type_name).fields


def constants(type_name: str) -> tuple[Constant, ...]:
    """The constants (name, type, value) in their order. Raises UnknownName."""
    return definition_of(type_name).constants


def request_type(service: str) -> str:
    """The type of a service's request, `pkg/TypeRequest`: as good as any message type. Raises UnknownName."""
    return service_of(service).request.name


def response_type(service: str) -> str:
    """The type of a service's response, `pkg/TypeResponse`. Raises UnknownName."""
    return service_of(service).response.name
