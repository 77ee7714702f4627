"""`/rosapi/get_param` and its like: the parameter tree, with values as JSON text.

Says plainly when a parameter is not set, where rosapi answers null.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from slidectl import names
from slidectl.control.node_handle import MISSING, Message
from slidectl.errors import BadMessage, Refused, quoted
from slidectl.simulation.parameters import Parameters

_LONGEST = 8 * 1024 * 1024
"""Characters of a value: what is written twice as JSON must not take longer than a world can be held up."""
_LEAST = 80
"""What a single value counts: a hundred thousand of them take as long to write as a text of that length."""
_MOST_VALUES = 100_000


def parameter_services(parameters: Parameters) -> dict[str, tuple[str, Callable[[Message], Message]]]:
    """Service name to service type and handler. Relative names stand in the root."""

    def get(request: Message) -> Message:
        default = _text_or_json(request["default"]) if request["default"] else MISSING
        value = parameters.look(absolute(request["name"]), default)
        _check_size(value, request["name"])
        return {"value": json.dumps(value)}

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


def _check_size(value: Any, name: str) -> None:
    """Raises Refused for what would take long to be written, and no line can hold."""
    left, rest = _LONGEST, [value]
    while rest and left > 0:
        here = rest.pop()
        if isinstance(here, dict):
            rest += here.values()
            left -= sum(map(len, here))
        elif isinstance(here, list):
            if len(here) * _LEAST > left:
                left = 0
            rest += here
        left -= len(here) if isinstance(here, str) else _LEAST
    if left <= 0:
        raise Refused(f"the value of {quoted(name)} is too large for an answer", "ask for a part of it")


def absolute(name: str) -> str:
    """The name of a request: relative ones stand in the root."""
    return names.join("/", name.rstrip("/") or "/")


def from_json(text: str) -> Any:
    """The value of a request. Raises BadMessage."""
    if len(text) > _LONGEST:
        raise BadMessage(f"a value of {len(text)} characters, and {_LONGEST} is the most", "value")
    if text.count(",") + text.count("[") + text.count("{") > _MOST_VALUES:
        raise BadMessage(f"a value of more than {_MOST_VALUES} parts", "value", "set parts of it one after the other")
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
