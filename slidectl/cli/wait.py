"""`slidectl wait`: block until a field of a topic has a value. The daemon watches, in simulated time."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from typing import Any

import click

from slidectl.cli import completion, output, robots
from slidectl.cli.commands import command, conditions, finite, seconds, wait_for_world_s
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import find_published_topic, pause_remark
from slidectl.errors import Refused, SlidectlError, TimedOut, UsageError
from slidectl.msgs.schema import Schema, nanoseconds

_LOOK_EVERY_S = 0.2


def _condition(
    near: float | None, above: float | None, below: float | None, equals: str | None, tol: float | None, **_: Any
) -> tuple[str, Any]:
    """The condition and its value. Raises UsageError."""
    conditions: dict[str, Any] = {"near": near, "above": above, "below": below, "equals": equals}
    given = [(name, value) for name, value in conditions.items() if value is not None]
    if len(given) != 1:
        raise UsageError("give exactly one of --near, --above, --below and --equals")
    ((condition, value),) = given
    with suppress(ValueError, TypeError):  # of --equals: numbers, true and false are JSON values, all else is text
        read = json.loads(value)
        value = read if isinstance(read, bool | int | float | str) else value
    if tol is not None and condition != "near":
        raise UsageError("--tol needs --near")
    return condition, value


@command(
    check_words=_condition,
    examples=[
        "slidectl wait 'joint_states/position[0]' --near 1.0 --tol 0.02 --for 0.5 --within 15",
        "slidectl wait 'joint_states/velocity[0]' --below -0.05 --within 5 --json",
    ],
)
@click.argument("target", metavar="TOPIC/FIELD[I]", shell_complete=completion.topics_and_fields)
@conditions(
    click.option("--equals", metavar="X", help="Exactly X: a number in the unit of the value, true, false or text.")
)
@click.option(
    "--for", "hold", type=click.FloatRange(min=0), default=0.0, callback=finite, metavar="S",
    help="Must hold for S simulated seconds.",
)  # fmt: skip
@seconds("--within", help="Fail after S simulated seconds.")
@click.pass_obj
def wait(
    ctx: Context,
    target: str,
    near: float | None,
    above: float | None,
    below: float | None,
    equals: str | None,
    tol: float | None,
    hold: float,
    within: float | None,
) -> None:
    """Wait until a field of a topic has a value.

    Prints the value and the simulated time; on a terminal a line shows the progress. When --within has passed it prints
    the expected, the last and the closest value, and exits 1. --timeout limits the wall time (exit code 4); the default
    is a minute plus ten times --within and --for. JSON keys: topic, field, expected, reached, value, closest, time.
    """
    condition, value = _condition(near, above, below, equals, tol)
    found = find_published_topic(ctx, target)
    request = {
        "topic": found.topic,
        "field": found.field,
        "condition": condition,
        "value": json.dumps(value),
        "tolerance": 0.01 if tol is None else tol,
        "hold": hold,
        "within": within or 0.0,
    }
    limit = ctx.wait_limit(wait_for_world_s(hold + (within or 0.0)))
    call = ctx.client.call_async("/slidectl/wait", request)
    status = ctx.call("/slidectl/status")
    robots.warn_stopped(ctx, status["estop"])
    ctx.say(pause_remark(status))
    deadline = ctx.client.monotonic() + limit
    try:
        if output.is_terminal(sys.stderr) and not ctx.quiet and not ctx.client.is_answered(call):
            _show_progress(ctx, request, found.schema, call, deadline, status["time"])
        answer = ctx.client.answer(call, timeout=max(0.0, deadline - ctx.client.monotonic()))
    except TimedOut as error:
        # A scenario may end the wait before the deadline.
        ending = f" within {limit:g} s of wall time" if ctx.client.monotonic() >= deadline else ""
        raise TimedOut(f"{_where(request)} was not {_expected(request)}{ending}", error.hint) from None
    _print_outcome(ctx, request, answer)


def _show_progress(
    ctx: Context, request: dict[str, Any], schema: Schema, call: str, deadline: float, since: float
) -> None:
    """Show a status line while the daemon watches: the last value, the closest, the simulated time left.

    Returns, and erases the line, when the call is answered or at the deadline (on the client's clock). `since` is the
    simulated time at which the wait began.
    """
    from slidectl.msgs.field_path import select

    client, selection = ctx.client, select(schema.fields, schema.root, request["field"])
    kind, target, within = request["condition"], json.loads(request["value"]), request["within"]
    time, last = since, None
    closest: tuple[float, Any] | None = None

    def line() -> str:
        passed = max(0.0, time - since)
        parts = [f"{_where(request)} {_expected(request)}"]
        parts.append("no message yet" if last is None else f"last {_short(last)}")
        parts += [f"closest {_short(closest[1])}"] if closest is not None else []
        parts.append(f"{max(0.0, within - passed):.1f} s left" if within else f"{passed:.1f} s passed")
        return "; ".join(parts)

    topic = client.subscribe(request["topic"], queue_length=1, throttle_rate=int(1000 * _LOOK_EVERY_S))
    with topic, output.status_line(line(), not ctx.quiet) as show:
        while not client.is_answered(call) and client.monotonic() < deadline:
            clock = client.call_async("/rosapi/get_time")
            look_at = min(client.monotonic() + _LOOK_EVERY_S, deadline)
            while not client.is_answered(call) and (left := look_at - client.monotonic()) > 0:
                next(client.events(left), None)
            if client.is_answered(clock):
                time = nanoseconds(client.answer(clock)["time"]) / 1e9
            else:
                client.forget(clock)
            while len(topic):
                with suppress(SlidectlError, LookupError):  # an element that does not exist yet
                    last = selection.read(topic.get())
                    if isinstance(last, int | float) and isinstance(target, int | float):
                        past = last - target
                        gap = abs(past) if kind in ("near", "equals") else max(0.0, -past if kind == "above" else past)
                        if closest is None or gap < closest[0]:
                            closest = gap, last
            show(line())


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)[:40]


def _expected(request: dict[str, Any]) -> str:
    what = f"{request['condition']} {request['value']}"
    if request["condition"] == "near":
        what += f" (tolerance {request['tolerance']:g})"
    return what + (f" for {request['hold']:g} s" if request["hold"] else "")


def _where(request: dict[str, Any]) -> str:
    return f"{request['topic']}/{request['field']}".rstrip("/")


def _print_outcome(ctx: Context, request: dict[str, Any], answer: dict[str, Any]) -> None:
    last, closest = (json.loads(answer[key]) if answer[key] else None for key in ("last", "closest"))
    where, expected = _where(request), _expected(request)
    record = {
        "topic": request["topic"], "field": request["field"], "expected": expected, "reached": answer["success"],
        "value": last, "closest": closest, "time": answer["time"],
    }  # fmt: skip
    if answer["success"]:
        ctx.done(record, f"{where} is {last} at {answer['time']:.3f} s")
        return
    if ctx.format != "text":
        ctx.emit(record)
    seen = f"last {last}, closest {closest}" if answer["last"] else "no message came"
    limit = f" within {request['within']:g} s" if request["within"] else ""
    from slidectl.client import steady_error

    why = steady_error.of_field(ctx.client, request["topic"], request["field"])
    hint = f"{seen}, at {answer['time']:.3f} s"
    raise Refused(f"{where} was not {expected}{limit}", f"{hint}\n{why}" if why else hint)
