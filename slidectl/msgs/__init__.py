"""Message, service and action types of ROS 1: their definitions, and building and checking messages.

A message is a plain dict in the shape of its JSON, with all fields. Types are named `pkg/Type`. Nothing here knows what
a message is used for.
"""

from slidectl.msgs.checking import Message, check, default
from slidectl.msgs.definitions import (
    Constant,
    constants,
    definition,
    exists,
    fields,
    full_definition,
    md5,
    request_type,
    response_type,
    service_definition,
    service_exists,
    service_md5,
    service_names,
    show,
    show_service,
    type_names,
)
from slidectl.msgs.schema import Field

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
    "full_definition",
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
