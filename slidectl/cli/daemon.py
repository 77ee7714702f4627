"""`slidectl daemon`: start, stop and inspect the daemon's process, through daemon/lifecycle.py, and read its log.

This module does not use the daemon's internals.
"""

from __future__ import annotations

import os
import re
import select
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click

from slidectl.cli import completion, output
from slidectl.cli.command_table import has_module
from slidectl.cli.commands import group
from slidectl.cli.context import Context
from slidectl.cli.sim import status_text
from slidectl.errors import NoDaemon, Refused

if TYPE_CHECKING:
    from slidectl.daemon.options import DaemonOptions
    from slidectl.paths import InstancePaths

PORTS: dict[str, int] = {}
"""Kind of a gateway -> its port; empty where the extension of the gateways is left out."""
_OF_ENVIRONMENT = "environment"
"""The value of --ros2 without a domain."""
if TYPE_CHECKING or has_module("extensions.gateways"):
    from slidectl.extensions.gateways.commands import gateway_commands
    from slidectl.extensions.gateways.ros2 import MOST_DOMAIN

    PORTS = gateway_commands.PORTS

START_LIMIT_S = 30.0
STOP_LIMIT_S = 10.0
LIST_LIMIT_S = 2.0
_LOOK_AGAIN_S = 0.1


@group(
    step=None, examples=["slidectl daemon start", "slidectl daemon start --rtf max --paused", "slidectl daemon status"]
)
def daemon() -> None:
    """Start, stop and watch the daemon that holds the world."""


def _world(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a new world."""
    options = [
        click.option(
            "--rtf",
            default="1.0",
            metavar="FACTOR|max",
            help="Simulated seconds per second of wall time, or as fast as possible.",
        ),
        click.option("--paused/--running", default=False, help="Begin paused, or running (the default)."),
        click.option(
            "--timestep", type=float, default=0.001, metavar="S", help="Length of a cycle, s of simulated time (0.001)."
        ),
        click.option(
            "--gravity",
            type=float,
            nargs=3,
            default=(0.0, 0.0, -9.8),
            metavar="X Y Z",
            help="Gravity in the axes of the world, m/s^2 (0 0 -9.8).",
        ),
        click.option("--ground/--no-ground", default=True, help="With a floor at height 0, or without."),
        click.option(
            "--strict", is_flag=True, help="Stop the world when a robot diverges; the default freezes that robot."
        ),
        click.option(
            "--engine",
            type=click.Choice(["plain", "compiled", "auto"]),
            default="auto",
            help="What runs the cycles: Python, machine code (needs numba), or machine code if possible (auto).",
        ),
        completion.file_option(
            "--import",
            "imports",
            multiple=True,
            metavar="MODULE",
            help="Import controllers and hardware of your own from this module or FILE.py; may repeat.",
        ),
        completion.file_option("--journal", default="", help="Record all input into FILE, for 'slidectl replay'."),
    ]
    for option in reversed(options):
        function = option(function)
    return function


def _options(click_context: click.Context, world: dict[str, Any]) -> tuple[DaemonOptions, list[str]]:
    """The options of the new world, and the names of those given on the command line."""
    from slidectl.daemon import options

    source = click_context.get_parameter_source
    given = [name for name in world if source(name) is click.core.ParameterSource.COMMANDLINE]
    world |= {"rtf": options.rtf(world["rtf"]), "imports": tuple(map(module_or_file, world["imports"]))}
    world["journal"] = world["journal"] and os.path.abspath(os.path.expanduser(world["journal"]))
    return options.DaemonOptions(**world, chosen=tuple(given)), given


def module_or_file(word: str) -> str:
    """The absolute path of a file, given by its path or by its module's name; any other name unchanged."""
    file = word if word.endswith(".py") else f"{word}.py"
    if word.endswith(".py") or os.path.isfile(file):
        return os.path.abspath(os.path.expanduser(file))
    return word


class _Domain(click.IntRange):
    """A domain of ROS 2, or the word that stands for that of the environment."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value == _OF_ENVIRONMENT else super().convert(value, param, ctx)


def _gateways(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for each gateway of slidectl, with an optional port or domain, and one for installed packages'."""
    if not PORTS:
        return function
    function = click.option(
        "--gateway",
        "others",
        multiple=True,
        metavar="NAME",
        help="Start this gateway too, for example one of an installed package; may repeat.",
    )(function)
    function = click.option(
        "--ros2",
        type=_Domain(0, MOST_DOMAIN),
        is_flag=False,
        flag_value=_OF_ENVIRONMENT,
        metavar="[DOMAIN]",
        help="Start the ros2 gateway too (domain: ROS_DOMAIN_ID, or 0).",
    )(function)
    for kind, port in reversed(PORTS.items()):
        function = click.option(
            f"--{kind}",
            kind,
            type=click.IntRange(0, 65535),
            is_flag=False,
            flag_value=port,
            metavar="[PORT]",
            help=f"Start the {kind} gateway too (port {port}).",
        )(function)
    return function


@daemon.command(
    "start",
    examples=[
        "slidectl daemon start",
        "slidectl -i other daemon start --rtf max",
        "slidectl daemon start --websocket 9090 --ros1 --foxglove",
    ],
)
@_world
@_gateways
@click.pass_context
def start(click_context: click.Context, /, **world: Any) -> None:
    """Start the daemon in the background; returns when it answers.

    A running daemon stays as it is (exit code 0). JSON keys: instance, pid, socket, log, already. An object follows for
    each gateway, as 'slidectl gateway' prints it.
    """
    ctx: Context = click_context.obj
    others = tuple(gateway_commands.known(name) for name in world.pop("others", ()))
    gateways = {kind: world.pop(kind) for kind in PORTS}
    domain = world.pop("ros2", None)
    options, given = _options(click_context, world)
    already = _start(ctx, options)
    for kind, port in gateways.items():
        if port is not None:
            was_running = gateway_commands.start(ctx, kind, {"port": port})
            if was_running and port != PORTS[kind]:
                ctx.warn(f"the {kind} gateway runs already, so port {port} had no effect")
    if domain is not None:
        is_chosen = domain != _OF_ENVIRONMENT
        was_running = gateway_commands.start(ctx, "ros2", {"domain": domain if is_chosen else None})
        if was_running and is_chosen:
            ctx.warn(f"the ros2 gateway runs already, so domain {domain} had no effect")
    for kind in others:
        gateway_commands.start(ctx, kind, {})
    if already and given:
        names = ", ".join("--import" if name == "imports" else f"--{name}" for name in given)
        ctx.warn(f"it runs already, so {names} had no effect")


def _start(ctx: Context, options: DaemonOptions) -> bool:
    """Start the daemon and print the outcome. True when it ran already."""
    from slidectl.daemon import lifecycle

    pid, already = lifecycle.start(ctx.paths, options, ctx.wait_limit(START_LIMIT_S))
    how = "runs already" if already else "started"
    ctx.done({**place(ctx, pid), "already": already}, f"daemon {ctx.paths.name}: {how}, process {pid}")
    return already


def place(ctx: Context, pid: int | None) -> dict[str, Any]:
    paths = ctx.paths
    return {"instance": paths.name, "pid": pid, "socket": paths.socket_text, "log": str(paths.log)}


@daemon.command("run", examples=["slidectl daemon run --rtf max"])
@_world
@click.pass_context
def run(click_context: click.Context, /, **world: Any) -> None:
    """Run the daemon in the foreground, for containers and systemd.

    It logs to standard error too. SIGTERM and Ctrl-C stop it cleanly (exit code 0).
    """
    from slidectl.daemon import lifecycle

    ctx: Context = click_context.obj
    lifecycle.run(ctx.paths, _options(click_context, world)[0])


@daemon.command("stop", examples=["slidectl daemon stop"])
@click.pass_obj
def stop(ctx: Context) -> None:
    """Stop the daemon; returns when its process has ended, and so have its gateways and the nodes of detached launches.

    When none runs there is nothing to do (exit code 0). JSON keys: instance, pid (null when none ran), socket, log.
    """
    if PORTS:
        gateway_commands.stop_all(ctx)
    pid = _stop(ctx)
    how = "does not run" if pid is None else f"stopped, it was process {pid}"
    ctx.done(place(ctx, pid), f"daemon {ctx.paths.name}: {how}")


def _stop(ctx: Context) -> int | None:
    from slidectl.cli import detached
    from slidectl.daemon import lifecycle

    pid = lifecycle.stop(ctx.paths, ctx.wait_limit(STOP_LIMIT_S))
    detached.wait(ctx.paths, ctx.wait_limit(detached.LIMIT_S), ctx.say)
    return pid


@daemon.command("restart", examples=["slidectl daemon restart --rtf max"])
@_world
@click.pass_context
def restart(click_context: click.Context, /, **world: Any) -> None:
    """Stop the daemon if it runs, and start a new one with an empty world. Its gateways connect to the new one.

    Options that you leave out keep the values of the old daemon, and a line on stderr lists them. JSON keys as those of
    start.
    """

    from slidectl.daemon import lifecycle

    ctx: Context = click_context.obj
    options, given = _options(click_context, world)
    pid = lifecycle.running(ctx.paths)
    old = lifecycle.options_of(pid) if pid else None
    if old is not None:
        chosen = tuple(dict.fromkeys((*old.chosen, *given)))
        given_now = {name: getattr(options, name) for name in given}
        options = old.of_another(**given_now, chosen=chosen)
    options.check_journal()
    _stop(ctx)
    _start(ctx, options)
    kept = [] if old is None else _shown(old, [name for name in world if name not in (*given, "journal")])
    if kept:
        ctx.say(f"as before: {' '.join(kept)}")


def _shown(options: DaemonOptions, names: list[str]) -> list[str]:
    """The options of these names that differ from the defaults, as command-line words."""
    import math

    usual = type(options)()
    texts = {
        "rtf": "--rtf max" if math.isinf(options.rtf) else f"--rtf {options.rtf:g}",
        "paused": "--paused" if options.paused else "--running",
        "timestep": f"--timestep {options.timestep:g}",
        "gravity": "--gravity " + " ".join(f"{component:g}" for component in options.gravity),
        "ground": "--ground" if options.ground else "--no-ground",
        "strict": "--strict" if options.strict else "",
        "engine": f"--engine {options.engine}",
        "imports": " ".join(f"--import {module}" for module in options.imports),
    }
    return [texts[name] for name in names if getattr(options, name) != getattr(usual, name)]


@daemon.command("status", examples=["slidectl daemon status", "slidectl daemon status --json"])
@click.pass_obj
def status(ctx: Context) -> None:
    """Show whether the daemon runs, and how; exit code 3 when it does not.

    JSON keys: running, instance, pid, socket, log, and when it runs the fields of the service /slidectl/status.
    """
    try:
        answer = ctx.call("/slidectl/status")
    except NoDaemon:
        if ctx.format != "text":
            ctx.emit({"running": False, **place(ctx, None)})
        raise
    where = place(ctx, answer["pid"])
    text = "\n".join([status_text(answer), *(f"{key + ':':<12} {where[key]}" for key in ("socket", "log"))])
    ctx.emit({"running": True, **where, **{key: value for key, value in answer.items() if key not in where}}, text)


@daemon.command("logs", examples=["slidectl daemon logs -n 20", "slidectl daemon logs -f"])
@click.option("-f", "--follow", "following", is_flag=True, help="Follow the log until Ctrl-C.")
@click.option("-n", "--lines", type=click.IntRange(min=0), metavar="N", help="Begin with the last N lines.")
@click.pass_obj
def logs(ctx: Context, following: bool, lines: int | None) -> None:
    """Print the daemon's log.

    JSON keys of each line: time (date and time of this machine), level (info, warn, error ...), node (the sender, or
    empty), text, line (the whole line). A continuation line has the time, level and node of its entry.
    """
    path, record = ctx.paths.log, _records()
    with _opened(path) as file:
        *whole, begun = file.read().split("\n")
        for line in whole if lines is None else whole[max(0, len(whole) - lines) :]:
            ctx.emit(record(line), line)
        if following:
            for line in _growing(file, path, begun):
                ctx.emit(record(line), line)
        elif begun and lines != 0:
            ctx.emit(record(begun), begun)


_ENTRY = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+) (\w+) +(.*)", re.DOTALL)
_NODE = re.compile(r"(?:\[[\d.]+\] )?(/[\w/]+): (.*)", re.DOTALL)
"""Simulated time, node and text of an entry."""


def _records() -> Callable[[str], dict[str, str]]:
    """A function from each line of a log to its record."""
    last = {"time": "", "level": "", "node": ""}

    def record(line: str) -> dict[str, str]:
        text = line.strip()
        if entry := _ENTRY.fullmatch(line):
            speaks = _NODE.fullmatch(entry[3])
            text = speaks[2] if speaks else entry[3]
            last.update(time=entry[1], level=entry[2], node=speaks[1] if speaks else "")
        return {**last, "text": text, "line": line}

    return record


def _growing(file: TextIO, path: Path, begun: str) -> Iterator[str]:
    """Yield new lines of the file and, after a rotation, of the new file with its name.

    `begun` is the beginning of a line that is not yet complete.
    """
    while True:
        begun += file.readline()
        if begun.endswith("\n"):
            yield begun[:-1]
            begun = ""
            continue
        with suppress(FileNotFoundError):  # the log is being rotated
            if not os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                file.close()
                file = _opened(path)
                continue
        output.check_reader()
        select.select([], [], [], _LOOK_AGAIN_S)


def _opened(path: Path) -> TextIO:
    try:
        return path.open(encoding="utf-8", errors="replace", newline="\n")
    except FileNotFoundError:
        raise Refused(f"there is no log {path}", "no daemon of this instance has run") from None
    except OSError as error:
        raise Refused(f"cannot read the log {path}: {error.strerror or error}") from None


@daemon.command(
    "clean",
    examples=["slidectl daemon clean --dry-run", "slidectl -i other daemon clean", "slidectl daemon clean --all"],
)
@click.option("--dry-run", is_flag=True, help="List what would be removed, and remove nothing.")
@click.option("--all", "everything", is_flag=True, help="All instances, compiled code, and the history of the shell.")
@click.pass_obj
def clean(ctx: Context, dry_run: bool, everything: bool) -> None:
    """Remove the files of this instance: its folder with its logs.

    With --socket it removes the files beside that socket. It leaves other instances alone, unless --all is given: --all
    removes all files of slidectl. Files of a running daemon stay, and the exit code is then 1. JSON keys: path, what,
    bytes, removed.
    """
    from slidectl.cli.shell import history_file
    from slidectl.daemon import cleaning
    from slidectl.paths import command

    found = cleaning.of_all(Path(history_file()), ctx.paths) if everything else cleaning.of_instance(ctx.paths)
    stop_it = "slidectl daemon list" if everything else command(ctx.paths, "daemon stop")
    failures = []
    for one in found:
        problem = f"process {one.pid} runs there; stop it first: {stop_it}" if one.pid is not None else ""
        if not problem and not dry_run:
            try:
                cleaning.remove(one)
            except OSError as error:
                problem = error.strerror or str(error)
        if problem:
            failures.append(f"{one.path} ({one.what}) stays: {problem}")
            continue
        record = {"path": str(one.path), "what": one.what, "bytes": one.size, "removed": not dry_run}
        ctx.done(record, f"{'would remove' if dry_run else 'removed'} {one.path}: {one.what}, {one.size} bytes")
    if failures:
        raise Refused("\n".join(failures))
    if not found:
        left = "nothing of slidectl" if everything else f"nothing of instance {ctx.paths.name}"
        ctx.say(f"{left} is left")


def _gateways_of(paths: InstancePaths) -> list[dict[str, Any]]:
    from slidectl.extensions.gateways.process import find_all

    return [{"kind": found.kind, "pid": found.pid, "address": found.address} for found in find_all(paths)]


@daemon.command("list", examples=["slidectl daemon list", "slidectl daemon list --json"])
@click.pass_obj
def list_daemons(ctx: Context) -> None:
    """List the running daemons of this user: simulated time, start time, robots and gateways.

    One that does not answer within 2 s, or within --timeout, is listed as such. A daemon with a socket elsewhere is
    listed when --socket names it. The table shows an instance that -i does not reach from this shell by its socket.

    JSON keys: instance, socket, pid, answers, time (s, simulated), since (date and time), state (running, paused,
    stopped by an error, or why it does not answer), robots, gateways (objects with kind, pid, address).
    """
    from slidectl.daemon.lifecycle import running_daemons
    from slidectl.paths import is_named_by_instance

    rows = []
    for one in running_daemons(ctx.paths, ctx.wait_limit(LIST_LIMIT_S)):
        status = one.status
        state = status["trouble"] or ("paused" if status["paused"] else "running") if status else ""
        since = one.since and datetime.fromtimestamp(one.since).astimezone().isoformat(timespec="seconds")
        gateways = _gateways_of(one.paths) if PORTS else []
        row: dict[str, Any] = {
            "instance": one.paths.name,
            "socket": one.paths.socket_text,
            "pid": one.pid,
            "answers": bool(status),
            "time": status["time"] if status else None,
            "since": since,
            "state": state or f"does not answer: {one.trouble}",
            "robots": status["robots"] if status else [],
            "gateways": gateways,
        }
        if ctx.format == "text":
            row["since"] = since and since[:19].replace("T", " ")  # the zone is that of the reader
            row["gateways"] = [found["kind"] for found in gateways]
            if not is_named_by_instance(one.paths):
                row["instance"] = one.paths.socket_text
        rows.append(row)
    ctx.emit_rows(rows, ["instance", "pid", "time", "since", "robots", "gateways", "state"], "no daemon runs")
