"""`slidectl sim`: the time of the world, and snapshots. It only calls /gazebo and /slidectl services."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion
from slidectl.cli.commands import group, wait_for_world_s
from slidectl.cli.context import Context
from slidectl.command_steps import CommandStep, StepEffects
from slidectl.errors import Refused, TimedOut, UsageError

if TYPE_CHECKING:
    from slidectl.msgs.typed import StatusResponseMsg

_STEPS = r"\d+"
_SECONDS = r"(?i)(?P<number>\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*(?P<unit>s|ms)"
_FORK_LIMIT_S = 60.0


@group(examples=["slidectl sim status", "slidectl sim step 0.5s", "slidectl sim reset --time"])
def sim() -> None:
    """Control the simulation: status, pause, step, reset, snapshots."""


@sim.command("status", examples=["slidectl sim status", "slidectl sim status --json"])
@click.pass_obj
def status(ctx: Context) -> None:
    """Show time, speed, cycle times, robots, controllers, connections.

    The keys of json, yaml and csv are the fields of the service /slidectl/status: times in s, memory in bytes, speed 0
    for as fast as possible.
    """
    answer = ctx.call("/slidectl/status")
    ctx.emit(answer, status_text(answer))


def status_text(answer: StatusResponseMsg) -> str:
    """The answer of /slidectl/status as text."""
    times = (("mean", answer["cycle_mean"]), ("p99", answer["cycle_p99"]), ("worst", answer["cycle_worst"]))
    cycles = [f"{_micro(time)} {name}" for name, time in times]
    late = f"{_micro(answer['lateness_p50'])} p50, {_micro(answer['lateness_p99'])} p99"
    journal_ended = f", which has ended: {answer['journal_trouble']}" if answer["journal_trouble"] else ""
    lines = {
        "time": f"{answer['time']:.3f} s, cycle {answer['cycles']} of {1000 * answer['timestep']:g} ms",
        "state": ": ".join(filter(None, ["paused", answer["trouble"]])) if answer["paused"] else "running",
        "held by": " ".join(answer["holders"]),
        "lock-step": answer["lockstep"] and f"with {' '.join(answer['lockstep'])}",
        "speed": f"{speed_text(answer['speed'])} asked, {answer['speed_reached'] or 0:.3g} reached",
        "engine": answer["engine"],
        "cameras": answer["pictures"] and "; ".join([f"drawn by {answer['pictures']}", *camera_rates(answer)]),
        "cycle time": ", ".join(cycles),
        "lateness": f"{late}, {answer['overruns']} overruns",
        "robots": " ".join(answer["robots"]) or "none",
        "estop": answer["estop"] and f"on: {' '.join(answer['estop'])}",
        "frozen": answer["frozen"] and f"{' '.join(answer['frozen'])}: diverged, held at rest until a reset",
        "faults": " ".join(answer["faults"]),
        "controllers": f"{answer['controllers']} loaded, {answer['controllers_running']} running",
        "connections": str(answer["connections"]),
        "journal": answer["journal"] and answer["journal"] + journal_ended,
        "memory": f"{answer['memory'] / 2**20:.0f} MiB",
        "daemon": f"{answer['version']}, {answer['instance']}, process {answer['pid']}, up {answer['uptime']:.0f} s",
    }
    return "\n".join(f"{key + ':':<12} {text}" for key, text in lines.items() if text)


def camera_rates(answer: StatusResponseMsg) -> list[str]:
    """For each camera that draws pictures, its topic and rate, from the answer of /slidectl/status."""
    rates = zip(answer["cameras"], answer["cameras_asked"], answer["cameras_reached"], strict=True)
    return [f"{topic}: {asked:.4g} Hz asked, {reached:.4g} reached" for topic, asked, reached in rates]


def speed_text(speed: float) -> str:
    """A real-time factor; 0 means as fast as possible."""
    return f"{speed:g}" if speed else "max"


def _micro(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e6 * seconds:.4g} us"


@sim.command("pause", examples=["slidectl sim pause"])
@click.pass_obj
def pause(ctx: Context) -> None:
    """Pause the world between two cycles."""
    ctx.call("/gazebo/pause_physics")
    _print_time(ctx, "paused")


@sim.command("resume", examples=["slidectl sim resume"])
@click.pass_obj
def resume(ctx: Context) -> None:
    """Resume the world."""
    ctx.call("/gazebo/unpause_physics")
    _print_time(ctx, "running")


@sim.command("reset", examples=["slidectl sim reset", "slidectl sim reset --time"])
@click.option("--time", "with_time", is_flag=True, help="Set the clock to 0, too.")
@click.pass_obj
def reset(ctx: Context, with_time: bool) -> None:
    """Put every robot back to where it was spawned; controllers stay loaded and running."""
    ctx.call("/gazebo/reset_simulation" if with_time else "/gazebo/reset_world")
    _print_time(ctx, "reset")


@sim.command("speed", examples=["slidectl sim speed 2", "slidectl sim speed max"])
@click.argument("factor", metavar="FACTOR|max")
@click.pass_obj
def speed(ctx: Context, factor: str) -> None:
    """Set the speed: a factor of the wall clock, or as fast as possible."""
    wanted = parse_speed(factor)
    _demand(ctx.call("/slidectl/set_speed", {"speed": wanted}))
    ctx.done({"speed": wanted}, f"speed {speed_text(wanted)}")


def parse_speed(text: str) -> float:
    """A positive real-time factor, or 0 for `max`. Raises UsageError."""
    try:
        value = 0.0 if text == "max" else float(text)
    except ValueError:
        value = -1.0
    if text != "max" and not 0 < value < float("inf"):
        raise UsageError(f"{text!r} is not a speed: write a factor above 0, or max")
    return value


def _steps(amount: str | None, until: str | None) -> dict[str, Any]:
    """The request of /slidectl/step. Raises UsageError."""
    if until is None:
        return parse_amount(amount or "1")
    if amount is not None:
        raise UsageError(f"give an amount ({amount}) or --until, not both")
    return {"until": _time(until)}


@sim.command(
    "step",
    check_words=_steps,
    examples=["slidectl sim step", "slidectl sim step 100", "slidectl sim step 0.5s", "slidectl sim step --until 12.5"],
)
@click.argument("amount", required=False, metavar="[N|SECONDSs]")
@click.option("--until", metavar="TIME", help="Up to this simulated time, s.")
@click.pass_obj
def step(ctx: Context, amount: str | None, until: str | None) -> None:
    """Run N cycles (1), or some simulated seconds, or up to a time, and return when they are done.

    A time must be a whole number of cycles (0.001 s each by default). The command pauses a running world first. Without
    --timeout it waits a minute longer than the steps take at a tenth of real time.
    """
    request = _steps(amount, until)
    if "until" in request:
        seconds = max(0.0, request["until"] - ctx.call("/slidectl/status")["time"])
    else:
        seconds = request["seconds"] or request["cycles"] * 1e-3
    limit = ctx.wait_limit(wait_for_world_s(seconds))
    try:
        answer = ctx.call("/slidectl/step", request, timeout=limit)
    except TimedOut:
        raise TimedOut(
            f"the steps are not done within {limit:g} s", "the rest is given up; allow more with --timeout"
        ) from None
    _demand(answer)
    record = {"time": answer["time"], "cycles": answer["cycles"]}
    ctx.done(record, f"time {answer['time']:.6g} s after {answer['cycles']} cycles")


def _time(text: str) -> float:
    """The time in s of `12.5` or `12.5s`. Raises UsageError."""
    with suppress(ValueError):
        if 0.0 < (value := float(text.removesuffix("s"))) < math.inf:
            return value
    raise UsageError(f"--until takes a simulated time above 0 s, such as 12.5, not {text!r}")


def parse_amount(text: str) -> dict[str, Any]:
    """`100` or `0.5s` or `20ms` as a request of /slidectl/step. Raises UsageError."""
    match = re.fullmatch(_SECONDS, text)
    if match:
        scale = 1e-3 if match["unit"].lower() == "ms" else 1.0
        seconds = scale * float(text[: match.start("unit")])
        if math.isfinite(seconds):
            return {"cycles": 0, "seconds": seconds}
    if not re.fullmatch(_STEPS, text) or int(text) == 0:
        raise UsageError(f"{text!r} is not a number of steps: write a number of cycles, or a time such as 0.5s")
    return {"cycles": int(text), "seconds": 0.0}


def _demand(answer: Mapping[str, Any]) -> None:
    if not answer["success"]:
        raise Refused(answer["message"] or "refused without a reason")


# --- snapshots --------------------------------------------------------------------------------------------------------


@completion.completer
def _kept(ctx: Context) -> list[str]:
    return [one["name"] for one in ctx.client.snapshots()]


@sim.command("save", examples=["slidectl sim save before", "slidectl sim save before --to before.snapshot"])
@click.argument("name")
@completion.file_option("--to", "file", help="Also write it to this file.")
@click.pass_obj
def save(ctx: Context, name: str, file: str | None) -> None:
    """Save the state of the world under a name, until the daemon stops.

    It replaces a snapshot of the same name. JSON keys: name, time, file (null without --to).
    """
    time = ctx.client.save(name, file)
    ctx.done(
        {"name": name, "time": time, "file": file}, f"{name}: saved at {time:.3f} s{f' to {file}' if file else ''}"
    )


@sim.command(
    "load",
    step=CommandStep(may_add_controllers=True),
    examples=["slidectl sim load before", "slidectl sim load --from before.snapshot"],
)
@click.argument("name", required=False, shell_complete=_kept)
@completion.file_option("--from", "file", help="Load it from this file.")
@click.pass_obj
def load(ctx: Context, name: str | None, file: str | None) -> None:
    """Restore a saved state; the world goes on from there with the same bits.

    It spawns robots and loads controllers again where they differ. Goals that were sent since then end as PREEMPTED.
    JSON keys: time.
    """
    if (name is None) == (file is None):
        raise UsageError("give the name of a snapshot, or --from FILE", "slidectl sim snapshots")
    time = ctx.client.load(name, file)
    ctx.done({"time": time}, f"{name or file}: loaded, it is {time:.3f} s")


@sim.command("snapshots", examples=["slidectl sim snapshots"])
@click.pass_obj
def snapshots(ctx: Context) -> None:
    """List the snapshots that the daemon keeps. JSON keys: name, time, cycles, robots."""
    ctx.emit_rows(ctx.client.snapshots(), ["name", "time", "cycles", "robots"], "no snapshots")


@sim.command("delete", examples=["slidectl sim delete before after"])
@click.argument("names", nargs=-1, required=True, metavar="NAME...", shell_complete=_kept)
@click.pass_obj
def delete(ctx: Context, names: tuple[str, ...]) -> None:
    """Delete all these snapshots, or none if one is unknown. Files stay. JSON key: names."""
    ctx.call("/slidectl/delete_snapshots", {"names": list(names)})
    ctx.done({"names": list(names)}, f"deleted: {', '.join(names)}")


def _refuse_fork(parameters: Mapping[str, Any], has_daemon: bool) -> StepEffects:  # noqa: ARG001
    raise UsageError("sim fork leaves a daemon behind", "a scenario has a world of its own")


@sim.command(
    "fork",
    step=CommandStep(effects=_refuse_fork),
    examples=["slidectl sim fork before -i other", "slidectl -i first sim fork before -i other"],
)
@click.argument("name", shell_complete=_kept)
@click.option("-i", "--instance", "other", required=True, metavar="NAME", help="The daemon to start.")
@click.pass_obj
def fork(ctx: Context, name: str, other: str) -> None:
    """Start a second daemon that continues from a snapshot of this one.

    It has the options and the speed of this one, and is paused if this one is. The -i before 'sim' chooses the daemon
    to fork: 'slidectl -i first sim fork NAME -i other'. JSON keys: instance, pid, socket, time.
    """
    from slidectl import paths
    from slidectl.daemon import lifecycle

    place = paths.instance(other)
    pid, time = lifecycle.fork(ctx.client, name, place, ctx.wait_limit(_FORK_LIMIT_S))
    record = {"instance": other, "pid": pid, "socket": place.socket_text, "time": time}
    ctx.done(record, f"daemon {other}: started, process {pid}, from {name} at {time:.3f} s")


def _print_time(ctx: Context, what: str) -> None:
    answer = ctx.call("/slidectl/status")
    record = {"time": answer["time"], "cycles": answer["cycles"], "paused": answer["paused"]}
    ctx.done(record, f"{what} at {answer['time']:.3f} s")
