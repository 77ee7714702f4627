"""Calling a service for a command: its types, the names of its arguments, its answer as YAML, and why it said no.

Only service calls and text. What the words of a command line mean is for the commands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from slidectl.cli.context import Context
    from slidectl.msgs.fill import FieldsOf

CALL_TIMEOUT_S = 60.0
_VERDICTS = ("ok", "success")
_REASONS = ("message", "status_message")

Typedefs = list[dict[str, Any]]


class Answer(NamedTuple):
    """What came of a call.

    `refusal`: when the response says no (a false `ok` or `success`) the lines that say so, with the reasons.
    `reasons`: the warnings and errors of the call.
    """

    response: dict[str, Any]
    refusal: list[str]
    reasons: list[str]


def ask_each(ctx: Context, question: str, services: Iterable[str], key: str) -> dict[str, str]:
    """Service -> the answer of rosapi about it, asked in one go."""
    calls = {name: ctx.client.call_async(question, {"service": name}) for name in services}
    return {name: str(ctx.client.answer(call)[key]) for name, call in calls.items()}


def typedefs(ctx: Context, kind: str) -> tuple[Typedefs, Typedefs]:
    """What the request and the response of a service type are made of, asked in one go."""
    questions = "/rosapi/service_request_details", "/rosapi/service_response_details"
    calls = [ctx.client.call_async(question, {"type": kind}) for question in questions]
    request, response = (list(ctx.client.answer(call)["typedefs"]) for call in calls)
    return request, response


def request_typedefs(ctx: Context, kind: str) -> Typedefs:
    """What the request of a service type is made of."""
    return list(ctx.call("/rosapi/service_request_details", {"type": kind})["typedefs"])


class Forms(NamedTuple):
    """A service type as `service call` needs it: the fields of a request, and what prints a response."""

    request: Typedefs
    fields_of: FieldsOf
    printer: Callable[[dict[str, Any]], str]


def forms(resolved: dict[str, Any]) -> Forms:
    """Those of a service, of what `/slidectl/resolve` says of it."""
    from slidectl.msgs.fill import fields_from

    request = resolved["typedefs"]
    return Forms(request, fields_from(request), _printer(resolved["response_typedefs"]))


def argument_names(request: Typedefs) -> list[str]:
    """The fields of a request, nested ones as `a.b`."""
    from slidectl.msgs.fill import field_paths, fields_from

    return field_paths(fields_from(request), str(request[0]["type"]))


def as_yaml(message: dict[str, Any], parts: Typedefs) -> str:
    """A complete request or response as rosservice prints it, with its line end."""
    return _printer(parts)(message)


def _printer(parts: Typedefs) -> Callable[[dict[str, Any]], str]:
    from slidectl.cli.schema import from_typedefs
    from slidectl.cli.yamlform import YamlForm

    schema = from_typedefs(parts)
    text = YamlForm(schema).printer(schema.root)
    return lambda message: text(message) + "\n"


def call(ctx: Context, full: str, request: dict[str, Any]) -> Answer:
    """Call it. Raises as Client.call; TimedOut after a minute."""
    response = ctx.call(full, request, ctx.wait_limit(CALL_TIMEOUT_S))
    reasons = ctx.client.reasons
    return Answer(response, _refusal(full, response, reasons), reasons)


def _refusal(full: str, response: dict[str, Any], given: Sequence[str]) -> list[str]:
    verdict = next((field for field in _VERDICTS if response.get(field) is False), None)
    if verdict is None:
        return []
    reasons = [str(response[field]) for field in _REASONS if response.get(field)]
    reasons += [reason for reason in given if reason not in reasons][-2:]
    indented = [f"  {line}" for reason in reasons for line in reason.splitlines()]
    return [f"{full} answered {verdict}: false", *indented]
