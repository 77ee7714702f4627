"""`slidectl plot`: fields of topics over time, live in the terminal, or from topics and recordings into a file."""

from __future__ import annotations

import math
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from slidectl.cli import completion, output
from slidectl.cli.commands import command, pixel_size, simulated_seconds, wait_for_world_s
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import pause_remark
from slidectl.errors import EXIT_INTERRUPTED, NoDaemon, Refused, TimedOut, UsageError
from slidectl.extensions.recording.commands.bag import open_recording
from slidectl.extensions.viewing import plot_fields, plots
from slidectl.extensions.viewing.plot_fields import TopicCurves
from slidectl.extensions.viewing.plots import Curve, Plot
from slidectl.msgs.schema import nanoseconds
from slidectl.writing import CannotWrite, file_kind, write_whole

_LIVE_S = 10.0
"""The window of a live plot, and how long the topics of a plot drawn once are followed; simulated seconds."""
_REDRAW_S = 0.2
_FAST = 1.5
"""A world that is quicker than real time by this factor is likely to have ended a motion before a plot of it begins."""
_QUEUE = 1_000_000
_LEAST_PLAIN_ROWS = 12
_ENTER, _HOME, _LEAVE = "\033[?1049h\033[?25l", "\033[H", "\033[?25h\033[?1049l"
"""Terminal sequences: show the alternate screen without a cursor, go to its first line, show the old screen."""


@command(
    examples=[
        "slidectl plot joint1_position_controller/state/{set_point,process_value,error}",
        "slidectl plot 'joint_states/position[0]' --for 10 --save slide.svg",
        "slidectl plot run.bag joint_states/position joint_states/effort --save slide.png",
        "slidectl plot run.bag --xy 'joint_states/position[0]' 'joint_states/velocity[0]' --save phase.svg",
        "slidectl plot --compare before.bag after.bag 'joint_states/position[0]' --save both.svg",
    ]
)
@click.argument("targets", nargs=-1, metavar="[FILE] [FIELD...]", shell_complete=completion.topics)
@click.option("--for", "duration", type=float, callback=simulated_seconds, metavar="S",
              help="End after S simulated seconds (10 where it is drawn once).")  # fmt: skip
@click.option("--window", type=float, callback=simulated_seconds, metavar="S",
              help="Draw the last S simulated seconds only (10 in a live plot).")  # fmt: skip
@click.option("--once", is_flag=True, help="Draw once, at the end.")
@click.option("--save", metavar="FILE", shell_complete=completion.files,
              help="Into a file: .svg, .png, .pdf, .html or .csv.")  # fmt: skip
@click.option("--xy", nargs=2, metavar="A B", help="The field B over the field A.")
@click.option("--compare", nargs=2, metavar="FILE FILE", shell_complete=completion.files,
              help="Two recordings in one plot, each from its beginning.")  # fmt: skip
@click.option("--panels", type=click.Choice(plots.PANELS), default="unit",
              help="What shares a panel: curves of one unit (default), none, or all.")  # fmt: skip
@click.option("--title", help="Instead of the topic or the file.")
@click.option("--size", callback=pixel_size(100, 9999), metavar="WxH", help="Of a file, in pixels.")
@click.pass_obj
def plot(
    ctx: Context,
    targets: tuple[str, ...],
    duration: float | None,
    window: float | None,
    once: bool,
    save: str | None,
    xy: tuple[str, str] | None,
    compare: tuple[str, str] | None,
    panels: str,
    title: str | None,
    size: tuple[int, int] | None,
) -> None:
    """Plot fields over simulated time.

    FIELD is TOPIC/FIELD[I] as for 'slidectl echo', and 'state/{a,b}' are two; an array or a message is a curve for each
    of its numbers. FILE is a recording (.bag, .mcap) or the CSV of 'slidectl echo -p'; without one the topics are
    followed: on a terminal live until --for or Ctrl-C, else, with --once or with --save, drawn once at the end. What
    arrived is drawn or saved too when it is interrupted or the daemon ends. JSON keys, a line a curve: name, unit,
    samples, start, end, min, max, last, file.
    """
    files = list(compare or [target for target in targets if file_kind(target) in plot_fields.FILES])
    fields = [target for target in targets if compare or target not in files]
    if len(files) > 1 and not compare:
        raise UsageError("one file at a time", f"to see two in one plot: --compare {files[0]} {files[1]}")
    if xy and (fields or panels != "unit"):
        raise UsageError("--xy is a plot of its own: it goes with no FIELD and no --panels")
    wanted = list(xy or fields)
    if not wanted and not (files and all(file_kind(file) == ".csv" for file in files)):
        raise UsageError(
            "no FIELD to plot", "give one: slidectl plot 'joint_states/position[0]'; see slidectl topic list"
        )
    if files and duration:
        raise UsageError("--for is of the time to come; of a file: --window for its last seconds")
    live = not files and not once and save is None and output.is_terminal(sys.stdout) and ctx.format == "text"
    cut = window or (_LIVE_S if live else None)
    check(ctx, save)
    if xy and save and file_kind(save) == ".csv":
        raise UsageError(
            "a phase plot has no times for a CSV", "save the two as fields: slidectl plot A B --save x.csv"
        )

    def made(curves: list[Curve]) -> Plot:
        shown = Plot(title or "", curves, panels, window=cut)
        return _phase(shown, wanted) if xy else shown

    if files:
        show(ctx, made(_from_files(ctx, files, wanted, bool(xy))), save, size)
        return
    from slidectl.supervision import Interrupts

    found = plot_fields.of_live(ctx.client, wanted, ctx.namespace)
    length = duration or (None if live else window or _LIVE_S)
    ended: BaseException | None = None
    with Interrupts() as interrupts:
        try:
            now = (lambda: made(plot_fields.curves_of(found, bool(xy)))) if live else None
            _follow(ctx, found, length, cut, now, lambda: bool(interrupts.received))
        except (NoDaemon, TimedOut, KeyboardInterrupt) as error:  # the samples so far are shown before the error
            ended = error
        if interrupts.received:
            ended = click.exceptions.Exit(EXIT_INTERRUPTED)
        if curves := _arrived(ctx, found, bool(xy), f"in {length:g} s" if ended is None else ""):
            show(ctx, made(curves), save, size)
            if not any(map(plots.moves, curves)):
                ctx.say(_rest_remark(ctx, curves, found, wanted) if ended is None else "")
    if ended is not None:
        raise ended


def _rest_remark(ctx: Context, curves: list[Curve], topics: Iterable[str], wanted: list[str]) -> str:
    """That all values stood still, why a motion may have been missed, and how to see it."""
    begin, end = min(curve.times[0] for curve in curves), max(curve.times[-1] for curve in curves)
    speed = ctx.call("/slidectl/status")["speed_reached"] or 0.0
    fast = f" (at {speed:.3g} times real time they take {(end - begin) / speed:.2g} s)" if speed > _FAST else ""
    fields = " ".join(map(shlex.quote, wanted))
    return (
        f"all values stood still from {begin:.3f} s to {end:.3f} s{fast}: to see a motion, start the plot before it, "
        f"or record it: slidectl record {' '.join(topics)} -O run.bag, then slidectl plot run.bag {fields}"
    )


# --- output: a file, text, or records ---------------------------------------------------------------------------------


def check(ctx: Context, save: str | None) -> None:
    """Check the output before waiting. Raises as `plots.check_file`, `plots.check_terminal`; Refused: no folder."""
    if save is not None:
        plots.check_file(save)
        if not Path(save).parent.is_dir():
            raise Refused(f"cannot write {save}: there is no folder {Path(save).parent}")
    elif ctx.format == "text":
        plots.check_terminal()


def show(
    ctx: Context,
    drawn: Plot,
    save: str | None,
    size: tuple[int, int] | None = None,
    records: Sequence[dict[str, Any]] = (),
) -> None:
    """Write the file, or print the plot; `records` are the JSON output, by default one a curve.

    Raises:
        Refused: it cannot be written.
    """
    if save is not None:
        try:
            write_whole(save, plots.as_file(drawn, file_kind(save), size))
        except OSError as error:
            raise CannotWrite(save, error) from None
    if ctx.format != "text":
        for record in records or [_record(curve, drawn.begin, save) for curve in drawn.curves]:
            ctx.emit(record)
    elif save is not None:
        samples = sum(len(curve.times) for curve in drawn.curves)
        about = f"{save}: {output.count(len(drawn.curves), 'curve')}, {output.count(samples, 'sample')}"
        ctx.done({}, "\n".join([about, *drawn.notes]))
    else:
        output.write(_text(drawn, at_least=_LEAST_PLAIN_ROWS))


def _text(drawn: Plot, at_least: int = 0) -> str:
    width, height = shutil.get_terminal_size()
    rows = max(height - 1, at_least * len(drawn.rows()))
    return plots.as_text(drawn, width, rows, output.wants_colour(sys.stdout))


def _record(curve: Curve, begin: float, save: str | None) -> dict[str, Any]:
    times, values = curve.points(begin)
    finite = values[np.isfinite(values)]
    of_values = (finite.min(), finite.max(), finite[-1]) if len(finite) else (None, None, None)
    of_times = (times[0], times[-1]) if len(times) else (None, None)
    numbers = [None if number is None else float(number) for number in (*of_times, *of_values)]
    about = dict(zip(("start", "end", "min", "max", "last"), numbers, strict=True))
    return {"name": curve.name, "unit": curve.unit, "samples": len(times), **about, "file": save}


def _phase(drawn: Plot, wanted: list[str]) -> Plot:
    """The plot of the second curve over the first, at the times of the first that both curves cover."""
    if not drawn.curves:
        return drawn
    if len(drawn.curves) != 2:
        raise UsageError(f"--xy takes two numbers; {wanted[0]} and {wanted[1]} are {len(drawn.curves)}")
    one, other = drawn.curves
    (times, xs), (moments, ys) = one.points(drawn.begin), other.points(drawn.begin)
    if not np.array_equal(times, moments):
        ys = np.interp(times, *other.points(), left=math.nan, right=math.nan)
    x_label, y_label = (f"{label} ({curve.unit})" if curve.unit else label for label, curve in drawn.labelled())
    curve = Curve(f"{other.name} over {one.name.rpartition('/')[2]}", unit=other.unit, times=xs, values=ys)
    return replace(drawn, curves=[curve], x_label=x_label, y_label=y_label, window=None, is_phase=True)


# --- where the curves are from ----------------------------------------------------------------------------------------


def _arrived(ctx: Context, found: Mapping[str, TopicCurves], is_phase: bool, where: str) -> list[Curve]:
    """The curves with samples; warns of topics without a message. With `where`, raises Refused when there are none."""
    curves = plot_fields.curves_of(found, is_phase)
    if silent := [topic for topic, messages in found.items() if not messages.curves]:
        text = f"no message of {', '.join(silent)} {where}".rstrip()
        if where and not curves:
            raise Refused(text)
        ctx.warn(text)
    return curves


def _from_files(ctx: Context, files: list[str], fields: list[str], is_phase: bool) -> list[Curve]:
    every = []
    for file in files:
        if file_kind(file) == ".csv":
            begin, curves = plot_fields.of_csv(Path(file), fields)
        elif file_kind(file) in plot_fields.FILES:
            with open_recording(ctx, file) as recording:
                found = plot_fields.of_recording(recording, fields, ctx.namespace)
                begin = (recording.summary().begin_ns or 0) * 1e-9
            curves = _arrived(ctx, found, is_phase, f"in {file}")
        else:
            raise UsageError(f"{file} is no recording", f"its name ends in one of: {', '.join(plot_fields.FILES)}")
        if len(files) > 1:
            for curve in curves:
                curve.times = np.array(curve.times) - begin
                curve.name = f"{curve.name} {file}"
        every += curves
    return every


def _follow(
    ctx: Context,
    found: Mapping[str, TopicCurves],
    duration: float | None,
    window: float | None,
    now: Callable[[], Plot] | None,
    is_over: Callable[[], bool],
) -> None:
    """Collect messages until `is_over`, or for `duration` simulated s; redraw the plot of `now` periodically.

    Raises:
        NoDaemon: the daemon ended. TimedOut. ClosedPipe. NoElement, UsageError: about the first message.
    """
    client = ctx.client
    status = ctx.call("/slidectl/status")
    remark = pause_remark(status, "nothing comes until it goes on")
    if now is None:
        ctx.say(remark)
    sleep = client.call_async("/slidectl/sleep", {"duration": duration}) if duration else ""
    limit = ctx.wait_limit(wait_for_world_s(duration) if duration else math.inf)
    deadline = client.monotonic() + limit
    with ExitStack() as stack:

        def take(published: dict[str, Any]) -> None:
            plot_fields.take(found, published["topic"], nanoseconds(published["time"]), published["msg"])

        every = [
            stack.enter_context(client.subscribe(topic, queue_length=_QUEUE, take=take, wait=False)) for topic in found
        ]
        client.flush()
        if now is not None:
            stack.callback(output.write, _LEAVE)
            sys.stdout.write(_ENTER)
        while not (is_over() or (sleep and client.is_answered(sleep))):
            output.check_reader()
            look = min(client.monotonic() + _REDRAW_S, deadline)
            while (left := look - client.monotonic()) > 0 and not (sleep and client.is_answered(sleep)):
                next(client.events(left), None)
            if client.monotonic() >= deadline:
                raise TimedOut(f"the simulated time has not passed within {limit:g} s", "see: slidectl sim status")
            if window is not None:
                newest = max(messages.last for messages in found.values())
                for messages in found.values():
                    messages.keep_since(newest - window)
            if now is not None:
                drawn = now()
                if any(messages.last > status["time"] for messages in found.values()):
                    remark = ""
                drawn.notes = [remark] if remark else []
                text = _text(drawn) if drawn.curves else "\n".join(["no message has come yet", *drawn.notes])
                # Each line overwrites the old one, so that the plot does not flicker.
                output.write(_HOME + text.replace("\n", "\033[K\n") + "\033[J")
        if is_over():  # receive what was published up to now
            client.call("/rosapi/get_time")
        elif sleep:
            client.answer(sleep)
    if dropped := sum(subscription.dropped for subscription in every):
        ctx.warn(f"{dropped} messages were lost: the reader is too slow")
