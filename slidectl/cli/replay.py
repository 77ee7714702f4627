"""`slidectl replay`: the run of a journal again, in this process, or in a daemon that stays at its end."""

from __future__ import annotations

import dataclasses
import traceback
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, robots
from slidectl.cli.commands import command
from slidectl.cli.context import Context
from slidectl.errors import Refused, UsageError

if TYPE_CHECKING:
    from slidectl.daemon.journal import Contents

_LONGEST_START_S = 1e6


def _time(_click: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    if value is not None and not 0 <= value < 1e9:
        raise click.BadParameter(f"{value:g} is no simulated time in s")
    return value


@command(
    examples=[
        "slidectl replay run.journal",
        "slidectl replay run.journal --check",
        "slidectl -i look replay run.journal --to 3.2 --keep",
    ]
)
@click.argument("file", metavar="FILE", shell_complete=completion.files)
@click.option("--to", "until", type=float, callback=_time, metavar="T", help="End at this simulated time, s.")
@click.option("--check", is_flag=True, help="Exit 1 at the first state that is not that of the journal.")
@click.option("--keep", is_flag=True, help="Leave the world in a daemon (-i NAME), paused.")
@click.pass_obj
def replay(ctx: Context, file: str, until: float | None, check: bool, keep: bool) -> None:
    """Run again what a journal has, with the same bits.

    'slidectl daemon start --journal FILE' writes one. Without a daemon and as fast as the cycles go; then the robots
    are shown as they are at the end. The state of each simulated second is compared with that of the journal: the
    first one that differs is a warning, with --check an error. With --keep a daemon begins with the replay and stays
    there, without the clients that there were. A journal whose end is missing is replayed up to its last whole entry.

    JSON keys: file, time, cycles, entries, whole (false where its end is missing), states (compared), differs, robots
    (as those of robots).
    """
    import os

    from slidectl.daemon import journal

    if keep and check:
        raise UsageError("--keep and --check exclude each other: a replay that differs is not kept")
    contents = journal.read(file)
    _warn(ctx, contents)
    if keep:
        _keep(ctx, contents, os.path.abspath(file), until)
    else:
        _replay(ctx, contents, until, check)


def _warn(ctx: Context, contents: Contents) -> None:
    from slidectl.daemon.journal_replay import other_versions

    if contents.is_cut:
        ctx.warn(f"{contents.path}: its end is missing; it is replayed up to its last whole entry")
    others = other_versions(contents)
    if others:
        ctx.warn(f"{contents.path} was written elsewhere, the bits may differ: {'; '.join(others)}")


def _replay(ctx: Context, contents: Contents, until: float | None, check: bool) -> None:
    from slidectl.daemon.journal_replay import Replay

    one = Replay(contents, until)
    one.run(lambda what: ctx.detail(f"{what}\n{traceback.format_exc()}"), check=check)
    simulation = one.simulation
    found = simulation.call("/slidectl/list_robots")["robots"]
    seconds, entries = simulation.time_ns * 1e-9, len(contents.entries)
    record: dict[str, Any] = {
        "file": contents.path, "time": seconds, "cycles": simulation.cycles, "entries": one.taken,
        "whole": not contents.is_cut, "states": one.states, "differs": one.differs,
        "robots": [robots.record(robot, with_report=False) for robot in found],
    }  # fmt: skip
    shown = [robots.robot_text({**one, "report": []}, with_report=False) for one in record["robots"]]
    head = f"{contents.path}: {seconds:.3f} s, {one.taken} of {entries} entries; {one.states} states are the same"
    if one.differs:
        ctx.warn(one.differs)
        head = f"{contents.path}: {seconds:.3f} s, {one.taken} of {entries} entries"
    ctx.done(record, "\n\n".join([head, *shown]))


def _keep(ctx: Context, contents: Contents, path: str, until: float | None) -> None:
    from slidectl.cli.daemon import place
    from slidectl.daemon import lifecycle

    if lifecycle.running(ctx.paths) is not None:
        raise Refused(f"daemon {ctx.paths.name} runs already", "name another one: slidectl -i NAME replay FILE --keep")
    options = dataclasses.replace(contents.options, replay=path, until=until)
    pid, _ = lifecycle.start(ctx.paths, options, ctx.wait_limit(_LONGEST_START_S))
    time = ctx.call("/slidectl/status")["time"]
    ctx.done(
        {**place(ctx, pid), "time": time}, f"daemon {ctx.paths.name}: started, process {pid}; paused at {time:.3f} s"
    )
