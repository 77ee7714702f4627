"""`slidectl replay`: repeat the run of a journal, in this process, or in a daemon that stays paused at its end."""

from __future__ import annotations

import dataclasses
import math
import os
import traceback
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slidectl.cli import completion, robots
from slidectl.cli.commands import command, simulated_seconds
from slidectl.cli.context import Context
from slidectl.command_steps import CommandStep, StepEffects
from slidectl.errors import Refused, UsageError

if TYPE_CHECKING:
    from slidectl.extensions.journal.journal import Contents
    from slidectl.extensions.journal.replay_recording import ReplayRecording

_LONGEST_START_S = 1e6


def _time(_click: click.Context, _param: click.Parameter, value: float | None) -> float | None:
    if value is not None and not 0 <= value < 1e9:
        raise click.BadParameter(f"{value:g} is not a simulated time in s")
    return value


def _step_effects(parameters: Mapping[str, Any], has_daemon: bool) -> StepEffects:  # noqa: ARG001
    if parameters["keep"]:
        raise UsageError("--keep leaves a daemon behind", "a scenario has a world of its own")
    return StepEffects()


@command(
    step=CommandStep(effects=_step_effects),
    examples=[
        "slidectl replay run.journal",
        "slidectl replay run.journal --check",
        "slidectl replay run.journal --record run.mcap --last 60",
        "slidectl -i look replay run.journal --to 3.2 --keep",
    ],
)
@click.argument("file", metavar="FILE", shell_complete=completion.files)
@click.option("--to", "until", type=float, callback=_time, metavar="T", help="End at this simulated time, s.")
@click.option("--check", is_flag=True, help="Exit 1 at the first state that differs from the journal's.")
@click.option("--record", "recording", metavar="FILE", shell_complete=completion.files,
              help="Record the published messages in a new .bag or .mcap file.")  # fmt: skip
@click.option("--last", type=float, callback=simulated_seconds, metavar="S",
              help="Record only the last S simulated seconds.")  # fmt: skip
@click.option("--keep", is_flag=True, help="Leave the world in a daemon (-i NAME), paused.")
@click.pass_obj
def replay(
    ctx: Context, file: str, until: float | None, check: bool, recording: str | None, last: float | None, keep: bool
) -> None:
    """Repeat the run of a journal, with the same bits.

    'slidectl daemon start --journal FILE' writes a journal. The replay needs no daemon and runs as fast as possible;
    then it shows the robots. The state of each simulated second is compared with the journal: the first difference is a
    warning, with --check an error. With --keep a new daemon replays the journal and stays paused at its end, without
    the clients of the run. --record records all topics except pictures and those with a message in every cycle
    (/clock, /gazebo/link_states, /gazebo/model_states). A journal without its end is replayed up to its last whole
    entry.

    JSON keys: file, time, cycles, entries, whole (false where its end is missing), states (compared), differs,
    messages (recorded, null without --record), robots (as those of robots).
    """
    from slidectl.extensions.journal import journal
    from slidectl.extensions.journal.journal_replay import other_versions

    if keep and check:
        raise UsageError("--keep and --check exclude each other: a replay that differs is not kept")
    if keep and recording is not None:
        raise UsageError("--keep and --record exclude each other: a daemon that stays has no recording")
    if last is not None and recording is None:
        raise UsageError("--last goes with --record")
    contents = journal.read(file)
    if contents.is_cut:
        ctx.warn(f"{file}: its end is missing; it is replayed up to its last whole entry")
    if others := other_versions(contents):
        ctx.warn(f"{file} was written elsewhere, the bits may differ: {'; '.join(others)}")
    if keep:
        _keep(ctx, contents, os.path.abspath(file), until)
    else:
        _replay(ctx, contents, until, check, recording, last)


def _replay(
    ctx: Context, contents: Contents, until: float | None, check: bool, recording: str | None, last: float | None
) -> None:
    from slidectl.extensions.journal.journal_replay import Replay

    recorder = None if recording is None else _recorder(contents, recording, until, last)
    with recorder or nullcontext():
        one = Replay(contents, until)
        if recorder is not None:
            recorder.watch(one)
        one.run(lambda what: ctx.detail(f"{what}\n{traceback.format_exc()}"), check=check)
    messages = None if recorder is None else recorder.messages
    simulation = one.simulation
    found = simulation.call("/slidectl/list_robots")["robots"]
    seconds, entries = simulation.time_ns * 1e-9, len(contents.entries)
    record: dict[str, Any] = {
        "file": contents.path, "time": seconds, "cycles": simulation.cycles, "entries": one.consumed,
        "whole": not contents.is_cut, "states": one.states, "differs": one.differs, "messages": messages,
        "robots": [robots.record(robot, with_report=False) for robot in found],
    }  # fmt: skip
    shown = [robots.robot_text(robot, with_report=False) for robot in record["robots"]]
    head = f"{contents.path}: {seconds:.3f} s, {one.consumed} of {entries} entries; {one.states} states are the same"
    if one.differs:
        ctx.warn(one.differs)
        head = f"{contents.path}: {seconds:.3f} s, {one.consumed} of {entries} entries"
    if recorder is not None:
        head += f"\n{recording}: {messages} messages"
    ctx.done(record, "\n\n".join([head, *shown]))


def _recorder(contents: Contents, file: str, until: float | None, last: float | None) -> ReplayRecording:
    from slidectl.extensions.journal.replay_recording import ReplayRecording

    if last is None:
        return ReplayRecording(Path(file))
    # The journal has a state for each simulated second that passes, also after the clock is set back.
    step_s = contents.options.timestep
    most = math.inf if until is None else round(until / step_s)
    states = since = before = 0
    for entry in contents.entries:
        cycle = min(entry["cycle"], most)
        since += cycle - before if cycle >= before else cycle
        before = cycle
        if entry["cycle"] > most:
            break
        if "state" in entry and "end" not in entry:
            states, since = states + 1, 0
    return ReplayRecording(Path(file), max(0.0, states + min(1.0, since * step_s) - last))


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
