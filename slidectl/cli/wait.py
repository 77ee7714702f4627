"""`slidectl wait`: block until a field of a topic has a value. The daemon watches, in simulated time."""

from __future__ import annotations

import json
from typing import Any

import click

from slidectl.cli import live
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.cli.options import simulated_seconds, wait_for_world_s
from slidectl.cli.stream import paused
from slidectl.cli.topics import PUBLISHERS, look_up
from slidectl.errors import Refused, TimedOut, UsageError


@command(
    examples=[
        "slidectl wait 'joint_states/position[0]' --near 1.0 --tol 0.02 --for 0.5 --within 15",
        "slidectl wait 'joint_states/velocity[0]' --below -0.05 --within 5 --json",
    ]
)
@click.argument("target", metavar="TOPIC/FIELD[I]", shell_complete=live.topics)
@click.option("--near", type=float, metavar="X", help="Within --tol of X.")
@click.option("--above", type=float, metavar="X", help="Greater than X.")
@click.option("--below", type=float, metavar="X", help="Less than X.")
@click.option("--equals", metavar="X", help="Exactly X: a number, true, false or text.")
@click.option("--tol", type=click.FloatRange(min=0), metavar="T", help="How far --near may be off (0.01).")
@click.option(
    "--for", "hold", type=click.FloatRange(min=0), default=0.0, metavar="S", help="Must hold for S simulated seconds."
)
@click.option("--within", type=float, callback=simulated_seconds, metavar="S", help="Fail after S simulated seconds.")
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

    Prints the value and the simulated time. When --within has passed it prints what was expected, the last and the
    closest value, and exits 1. --timeout is the limit on the wall clock (4); without it that is a minute, plus ten
    times --within and --for. JSON keys: topic, field, expected, reached, value, closest, time.
    """
    condition, value = _condition(near=near, above=above, below=below, equals=equals)
    if tol is not None and condition != "near":
        raise UsageError("--tol goes with --near only")
    found = look_up(ctx, target, PUBLISHERS)
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
    if status["paused"]:
        ctx.say(f"{paused(status)}; this waits until somebody lets it go on or steps it")
    try:
        answer = ctx.client.answer(call, timeout=limit)
    except TimedOut as error:
        text = f"{_where(request)} was not {_expected(request)} within {limit:g} s of wall time"
        raise TimedOut(text, error.hint) from None
    _tell(ctx, request, answer)


def _condition(**given: Any) -> tuple[str, Any]:
    """The one condition that was given, and its value."""
    chosen = [(name, value) for name, value in given.items() if value is not None]
    if len(chosen) != 1:
        raise UsageError("give exactly one of --near, --above, --below and --equals")
    name, value = chosen[0]
    return name, _literal(value) if name == "equals" else value


def _literal(text: str) -> Any:
    """What a person means by it: a number, a truth value, else the text itself."""
    try:
        value = json.loads(text)
    except ValueError:
        value = text
    return value if isinstance(value, bool | int | float | str) else text


def _expected(request: dict[str, Any]) -> str:
    what = f"{request['condition']} {request['value']}"
    if request["condition"] == "near":
        what += f" (tolerance {request['tolerance']:g})"
    return what + (f" for {request['hold']:g} s" if request["hold"] else "")


def _where(request: dict[str, Any]) -> str:
    return f"{request['topic']}/{request['field']}".rstrip("/")


def _tell(ctx: Context, request: dict[str, Any], answer: dict[str, Any]) -> None:
    last, closest = (json.loads(answer[key]) if answer[key] else None for key in ("last", "closest"))
    where = _where(request)
    record = {
        "topic": request["topic"],
        "field": request["field"],
        "expected": _expected(request),
        "reached": answer["success"],
        "value": last,
        "closest": closest,
        "time": answer["time"],
    }
    if answer["success"]:
        ctx.done(record, f"{where} is {last} at {answer['time']:.3f} s")
        return
    if ctx.format != "text":
        ctx.emit(record)
    seen = f"last {last}, closest {closest}" if answer["last"] else "no message came"
    limit = f" within {request['within']:g} s" if request["within"] else ""
    raise Refused(f"{where} was not {record['expected']}{limit}", f"{seen}, at {answer['time']:.3f} s")
