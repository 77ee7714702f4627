"""`/rosapi/get_param` and its like: the parameter tree, with values as JSON text.

Says plainly when a parameter is not set, where rosapi answers null.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from slidectl import names
from slidectl.control.node import MISSING, Message
from slidectl.errors import BadMessage
from slidectl.simulation.parameters import Parameters


def parameter_services(parameters: Parameters) -> dict[str, tuple[str, Callable[[Message], Message]]]:
    """Service name to service type and handler. Relative names stand in the root."""

    def get(request: Message) -> Message:
        default = _text_or_json(request["default"]) if request["default"] else MISSING
        return {"value": json.dumps(parameters.get(absolute(request["name"]), default))}

    def put(request: Message) -> Message:
        parameters.set(absolute(request["name"]), from_json(request["value"]))
        return {}

    def delete(request: Message) -> Message:
        parameters.delete(absolute(request["name"]))
        return {}

    def search(request: Message) -> Message:
        return {"global_name": parameters.search("/", request["name"]) or ""}

    return {
        "get_param": ("GetParam", get),
        "set_param": ("SetParam", put),
        "delete_param": ("DeleteParam", delete),
        "search_param": ("SearchParam", search),
        "has_param": ("HasParam", lambda request: {"exists": parameters.has(absolute(request["name"]))}),
        "get_param_names": ("GetParamNames", lambda _: {"names": parameters.names()}),
    }


def absolute(name: str) -> str:
    """The name of a request: relative ones stand in the root."""
    return names.join("/", name.rstrip("/") or "/")


def from_json(text: str) -> Any:
    """The value of a request. Raises BadMessage."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadMessage(
            f"the value is not JSON ({error}): {text[:80]!r}", "value", "text needs quotes of its own"
        ) from None


def _text_or_json(text: str) -> Any:
    """rosapi takes a default that is no JSON for the text that it is."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
