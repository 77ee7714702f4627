"""Message, service and action types of ROS 1: what they are made of, building messages, and checking them.

A message is a plain dict in the shape of its JSON, with all fields. Types are named `pkg/Type`. Nothing here knows
what a message is used for. Each name below is resolved at its first use, so that a command line that needs only
`slidectl.msgs.fill` loads nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slidectl.msgs.catalogue import (
        constants,
        exists,
        fields,
        request_type,
        response_type,
        service_exists,
        service_names,
        type_names,
    )
    from slidectl.msgs.checking import Message, check, default
    from slidectl.msgs.parsing import Constant
    from slidectl.msgs.schema import Field
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

_HOMES = {
    "Constant": "parsing",
    "Field": "schema",
    **dict.fromkeys(("Message", "check", "default"), "checking"),
    **dict.fromkeys(("definition", "md5", "service_definition", "service_md5", "show", "show_service"), "text"),
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES.get(name, 'catalogue')}"), name)
    globals()[name] = value  # the next use finds it without coming here
    return value
