"""`slidectl fault`: inject faults. It only calls the /slidectl/fault services."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import click

from slidectl.cli import completion, robots
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.fault_kinds import KINDS, OPTIONS, QUANTITIES, check_span, checked_options

_COLUMNS = ("name", "kind", "target", "from", "to", "seed", "options", "state", "count")


def _names(context: Context) -> list[str]:
    return [fault["name"] for fault in context.client.faults()]


def _targets(context: Context) -> list[str]:
    present = context.client.robots()
    parts = [f"/{one['name']}/{part}" for one in present for part in (*robots.moving(one), *one["links"])]
    controllers = [f"{one['namespace'].rstrip('/')}/{name}" for one in present for name in one["controllers"]]
    return [*parts, *controllers, *context.names("topic")]


def _kind_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of all fault kinds."""
    for name, option in reversed(OPTIONS.items()):
        more: dict[str, Any] = {"type": float, "metavar": "X"}
        if option.form == "vector":
            more = {"type": float, "nargs": 3, "metavar": "X Y Z"}
        elif option.form == "quantity":
            more = {"type": click.Choice([*QUANTITIES, "all"])}
        kinds = ", ".join(kind for kind, one in KINDS.items() if name in one.options)
        click.option(f"--{name}", help=f"{option.text[0].upper()}{option.text[1:]} ({kinds}).", **more)(command)
    return command


@group(
    examples=[
        "slidectl fault add slider/joint1 --kind sensor-noise --sd 0.001 --seed 7 --from 2 --to 5",
        "slidectl fault list",
        "slidectl fault clear",
    ]
)
def fault() -> None:
    """Inject faults into joints, links, controllers and topics."""


def _check_words(kind: str, start: float | None, end: float | None, **given: Any) -> None:
    """Raise SlidectlError for options that are invalid in any world. The daemon repeats the check."""
    checked_options(kind, {name: given[name] for name in OPTIONS if given[name] is not None})
    check_span(start or 0.0, math.inf if end is None else end)


@fault.command(
    "add",
    check_words=_check_words,
    examples=[
        "slidectl fault add slider/joint1 --kind sensor-noise --sd 0.001 --seed 7 --from 2 --to 5",
        "slidectl fault add joint1 --kind joint-stuck",
        "slidectl fault add link2 --kind push --force 0 0 -50 --from 3 --to 3.1",
        "slidectl fault add joint_states --kind topic-loss --probability 0.2",
    ],
)
@click.argument("target", shell_complete=completion.completer(_targets))
@click.option("--kind", required=True, metavar="KIND", shell_complete=completion.completer(lambda _: KINDS),
              help="The kind of fault; 'slidectl fault kinds' lists them.")  # fmt: skip
@click.option("--from", "start", type=float, metavar="TIME",
              help="When it begins, simulated s (default: the next cycle).")  # fmt: skip
@click.option("--to", "end", type=float, metavar="TIME",
              help="When it ends, simulated s (default: when it is removed).")  # fmt: skip
@click.option("--seed", type=int, default=0, metavar="N", help="Seed of its random numbers (0).")
@click.option("--name", default="", metavar="NAME", help="Its name in the list (default: made from the kind).")
@_kind_options
@click.pass_obj
def add(ctx: Context, /, target: str, kind: str, start: float | None, end: float | None, **given: Any) -> None:
    """Add a fault that acts from one simulated time to another.

    TARGET is a joint or link (ROBOT/JOINT), a controller or a topic, as the kind needs it; the unique end of the name
    is enough. The fault acts in the cycles with a time from --from on and before --to. JSON keys: as fault list.
    """
    options = {option: value for option, value in given.items() if value is not None}
    added = ctx.client.add_fault(target, kind, start, end, namespace=ctx.namespace, **options)
    until = "until it is removed" if added["end"] == math.inf else f"to {added['end']:g} s"
    span = f"from {added['start']:g} s {until}"
    ctx.done(_record(added), f"{added['name']}: {kind} on {added['target']} {span}")


def _record(found: dict[str, Any]) -> dict[str, Any]:
    """A fault with the documented JSON keys."""
    end = None if found["end"] == math.inf else found["end"]
    record = {**found, "from": found["start"], "to": end}
    return {key: record[key] for key in _COLUMNS}


@fault.command("list", examples=["slidectl fault list", "slidectl fault list --json"])
@click.pass_obj
def list_faults(ctx: Context) -> None:
    """List the faults and their effects so far.

    STATE is waiting, active or over; COUNT is the number of cycles, or messages, in which the fault acted. JSON keys:
    name, kind, target (the full name), from and to (s; null until it is removed), seed, options, state, count.
    """
    rows = [_record(found) for found in ctx.client.faults()]
    if ctx.format in ("text", "csv"):
        rows = [{**row, "options": _shown(row["options"])} for row in rows]
    ctx.emit_rows(rows, _COLUMNS, empty="no faults; slidectl fault kinds lists what can go wrong")


def _shown(options: dict[str, Any]) -> str:
    return " ".join(f"{name}={json.dumps(value)}" for name, value in options.items() if value is not None)


@fault.command("remove", examples=["slidectl fault remove sensor_noise_1"])
@click.argument("names", nargs=-1, required=True, metavar="NAME...", shell_complete=completion.completer(_names))
@click.pass_obj
def remove(ctx: Context, names: tuple[str, ...]) -> None:
    """Remove faults and undo their changes.

    If one name is unknown, it removes none. JSON key: name.
    """
    for name in ctx.client.remove_faults(*names):
        ctx.done({"name": name}, f"{name}: removed")


@fault.command("clear", examples=["slidectl fault clear"])
@click.pass_obj
def clear(ctx: Context) -> None:
    """Remove all faults.

    JSON key: name.
    """
    for name in ctx.client.remove_faults():
        ctx.done({"name": name}, f"{name}: removed")


@fault.command("kinds", examples=["slidectl fault kinds", "slidectl fault kinds --json"])
@click.pass_obj
def kinds(ctx: Context) -> None:
    """List the kinds of faults with their targets and options.

    JSON keys: name, target, text, options (each with its default: required, or null for unchanged).
    """
    rows = [{"name": name, **kind._asdict()} for name, kind in KINDS.items()]
    if ctx.format in ("text", "csv"):
        rows = [{**row, "options": " ".join(f"--{option}" for option in row["options"])} for row in rows]
    ctx.emit_rows(rows, ["name", "target", "options", "text"])
