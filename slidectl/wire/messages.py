"""The objects of the protocol: what a client asks and what the daemon answers, each as made and as read.

A client sends operations. A `call_service` is answered by one `service_response` with its id. Other operations are
answered only when they are refused, by a `status` of level "error" with their id; a `publish` with `ack` is also
answered when it is done. Objects are handled in the order in which they were sent: so the answer to a call, such as
`SYNCHRONIZE`, says that everything before it has been handled.

A refusal has the text of its error, its exit code and the name of its cause. An answer has the warnings and errors of
its own request, as `reasons` with parallel `levels`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

from slidectl import __version__, names
from slidectl.errors import AmbiguousName, Reason, Refused, SlidectlError, UnknownName, Unused, UsageError, listing
from slidectl.wire.json_lines import BadLine, check_size, decode

Message = dict[str, Any]

SYNCHRONIZE = "/rosapi/get_time"
"""A service that changes nothing. Its answer means that the daemon has handled everything sent before it."""
OPERATIONS = (
    "advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service", "advertise_service",
    "unadvertise_service", "service_response", "set_level", "set_node", "restrict",
    "cancel_call",
)  # fmt: skip
"""The operations of a client."""
READING = ("subscribe", "unsubscribe", "call_service", "cancel_call", "set_level", "set_node", "restrict")
"""Those that change nothing of the world; of services that depends on the service."""
LEVELS = {"info": 0, "warning": 1, "error": 2, "none": 3}
"""Levels of a status. A client gets those from its own level on (`set_level`), by default from "warning" on."""

_LONGEST_ENVELOPE = 4096
_ENVELOPE = re.compile(r'"(op|id|service)"\s*:\s*("(?:[^"\\\x00-\x1f]|\\["\\/bfnrt])*"|-?\d{1,18}(?=\s*[,}]))')
_LONGEST_ID = 1000
_DEEPEST_ID = 200
"""The most characters of an id that is a list or a mapping: enough for numbers, too few to nest deeply."""
_LARGEST_NUMBER = 1e9
_NAME_ERRORS = {cause.__name__: cause for cause in (AmbiguousName, UnknownName, Unused)}


# --- operations, as the daemon reads them -----------------------------------------------------------------------------


def read_operation(line: bytes) -> tuple[Message, SlidectlError | None]:
    """The operation on a line, and why it cannot be carried out (None when it can).

    With an error the message holds what the answer needs, as far as it could be read: op, id and service.
    """
    message: Message = {}
    try:
        try:
            check_size(line)
        except BadLine:
            message = _envelope(line)
            raise
        message = decode(line)
        _check_id(message)
        op = message.get("op")
        if op not in OPERATIONS:
            what = "a message without an op" if op is None else f"unknown op {shortened(op)}"
            raise UsageError(what, f"ops: {listing(OPERATIONS, len(OPERATIONS))}")
    except SlidectlError as error:
        return message, error
    return message, None


def _envelope(line: bytes) -> Message:
    """The op, id and service before the first list of a line that is too large to parse, as far as given."""
    beginning = line[:_LONGEST_ENVELOPE].decode("utf-8", "replace")
    fields = {match[1]: json.loads(match[2]) for match in _ENVELOPE.finditer(beginning.partition("[")[0])}
    return {key: fields[key] for key in ("op", "id", "service") if key in fields}


def _check_id(message: Message) -> None:
    """Raise UsageError, and remove the id, when it is too long to be returned."""
    given = message.get("id")
    most = _LONGEST_ID if isinstance(given, str) else _DEEPEST_ID
    try:
        fits = len(given if isinstance(given, str) else repr(given)) <= most
    except RecursionError:
        fits = False
    if not fits:
        del message["id"]
        raise UsageError(f"an id of more than {most} characters")


def text(message: Message, key: str, default: str | None = None) -> str:
    """The text under a key. Raises UsageError."""
    value = message.get(key, default)
    if not isinstance(value, str):
        raise UsageError(f"op {message['op']!r} needs {key!r}, a text")
    return value


def name(message: Message, key: str) -> str:
    """An absolute name; relative ones are resolved in the root. Raises UsageError: BadName when it is too long."""
    given = text(message, key)
    if len(given) > names.LONGEST:
        raise names.TooLong(given)
    return names.join("/", given)


def number(message: Message, key: str) -> float:
    """The number under a key, 0 when it is not given. Raises UsageError."""
    value = message.get(key) or 0
    if not isinstance(value, int | float) or not 0 <= value <= _LARGEST_NUMBER:
        raise UsageError(f"{key!r} is a number from 0 to {_LARGEST_NUMBER:g}, not {shortened(value)}")
    return value


def time_ns(message: Message, key: str) -> int:
    """The time {secs, nsecs} under a key, in ns. Raises UsageError."""
    time = message.get(key)
    parts: list[Any] = [time.get(part) for part in ("secs", "nsecs")] if isinstance(time, dict) else []
    if not parts or not all(isinstance(part, int) and 0 <= part < 2**32 for part in parts):
        raise UsageError(f"{key!r} is a time, {{secs, nsecs}}, not {shortened(time)}")
    return int(parts[0] * 10**9 + parts[1])


def subscription_id(message: Message) -> str | None:
    """The id that distinguishes a subscription from others of the same connection."""
    given = message.get("id")
    return None if given is None else str(given)


def shortened(value: Any) -> str:
    """The value as quoted in an error."""
    text = repr(value[:60] if isinstance(value, str) else value)
    return text if len(text) <= 60 else text[:57] + "..."


# --- answers, as the daemon makes them --------------------------------------------------------------------------------


def given_id(message: Message) -> Message:
    """The id for the answer: as it was given, if it was."""
    return {"id": message["id"]} if "id" in message else {}


def returned(call: Message) -> Message:
    """Fields for the answer to a call: the id, and our version for a client that has sent its own."""
    return given_id(call) | ({"version": __version__} if "version" in call else {})


def with_levels(reasons: Sequence[Reason] | None) -> Message:
    """The part of an answer that has the reasons; empty when there are none."""
    return {"reasons": reasons, "levels": [reason.level for reason in reasons]} if reasons else {}


def response(service: str, about: Message, reasons: Message) -> Message:
    """The answer to a call, without its values. `about` is from `returned`, `reasons` from `with_levels`."""
    return {"op": "service_response", **about, "service": service, **reasons}


def failure(error: SlidectlError) -> Message:
    """The part of a service_response about an error."""
    fields = {"values": str(error), "result": False, "exit_code": error.exit_code, "cause": type(error).__name__}
    if isinstance(error, AmbiguousName):
        fields["matches"] = error.matches  # all of them: the text may leave some out
    return fields


def refused_call(error: SlidectlError, message: Message, reasons: Message) -> Message:
    """The answer to a call whose service was not reached."""
    asked = {"op": "service_response", "service": message["service"][: names.LONGEST]}
    return asked | returned(message) | failure(error) | reasons


def error_status(error: SlidectlError, message: Message, reasons: Message) -> Message:
    """The status about an operation that was refused."""
    status = {"op": "status", "level": "error", "msg": str(error), "exit_code": error.exit_code}
    return status | given_id(message) | reasons


def warning_status(text: str) -> Message:
    """A status that belongs to no request."""
    return {"op": "status", "level": "warning", "msg": text}


def dropped_status(topic: str, dropped: int) -> Message:
    """The status about messages that a slow client did not get."""
    text = f"{dropped} messages on {topic} were dropped: read too slowly"
    return {"op": "status", "level": "warning", "topic": topic, "dropped": dropped, "msg": text}


def unheard_status(message: Message, topic: str) -> Message:
    """The status about a message that no subscriber got, for a publish with `unheard`."""
    status = {"op": "status", "level": "info", **given_id(message), "topic": topic, "unheard": True}
    return {**status, "msg": f"nobody subscribes to {topic}"}


def delivered_status(message: Message, is_late: bool, reasons: Message) -> Message:
    """The answer to a publish with `ack`; `is_late`: it arrived after the time `at` of the message."""
    status = {"op": "status", "level": "info", **given_id(message), "msg": "delivered"}
    return status | ({"late": True} if is_late else {}) | reasons


# --- answers, as a client reads them ----------------------------------------------------------------------------------


def refusal(cause: type[Refused], text: str, answer: Message) -> Refused:
    """The error of a status or response of a refused request, with the daemon's text and exit code."""
    error = cause(text)
    error.exit_code = int(answer.get("exit_code", cause.exit_code))
    return error


def values_of(answer: Message) -> Message:
    """The values of a service_response. Raises Refused with the daemon's text and exit code."""
    values = answer.get("values")
    if not answer.get("result", True):
        raise refusal(Refused, str(values), answer)
    return values if isinstance(values, dict) else {}


def resolved(answer: Message) -> Any:
    """The values of a response of /slidectl/resolve. Raises UnknownName, AmbiguousName, Unused, as the daemon did."""
    cause = _NAME_ERRORS.get(str(answer.get("cause")))
    if answer.get("result", True) or cause is None:
        return values_of(answer)
    message, _, hint = str(answer.get("values")).partition("\n")
    error = cause.__new__(cause)  # skips the constructor, which would build the text again
    SlidectlError.__init__(error, message, hint or None)
    if isinstance(error, AmbiguousName):
        error.matches = list(map(str, answer.get("matches", ())))
    raise error


def reasons_of(answer: Message) -> tuple[list[str], list[str], list[str]]:
    """The warnings and errors of a request, the warnings alone, and the errors alone."""
    if "reasons" not in answer:
        return [], [], []
    texts = list(map(str, answer["reasons"]))
    levels = answer.get("levels", ["error"] * len(texts))  # an older daemon sends no levels
    warnings = [text for text, level in zip(texts, levels, strict=True) if level == "warn"]
    return texts, warnings, [text for text, level in zip(texts, levels, strict=True) if level != "warn"]
