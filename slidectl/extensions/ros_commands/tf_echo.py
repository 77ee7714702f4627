"""`tf_echo` of tf and `echo.py` of tf2_tools: print the pose of one frame in another repeatedly."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence

import click

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.tf import listening, pose_text
from slidectl.errors import Refused, UnknownName
from slidectl.extensions.ros_commands.arguments import Parser, option, without_remappings
from slidectl.transform_tree import Frames, View

_WRONG = 255
_USAGE = """tf_echo source_frame target_frame [echo_rate]

Prints the position and the orientation of target_frame in source_frame: the transform
of coordinates from target_frame to source_frame. It prints echo_rate times a second
(default: 1), until Ctrl-C.
"""


def tf_echo(ctx: Context, argv: Sequence[str]) -> None:
    """Run `tf_echo SOURCE TARGET [HZ]` until Ctrl-C."""
    words = without_remappings(argv)
    if len(words) not in (2, 3):
        output.write(_USAGE)
        raise click.exceptions.Exit(_WRONG)
    rate = _rate([*words, "1"][2])
    if not rate > 0:
        print("Echo rate must be > 0.0", file=sys.stderr, flush=True)
        raise click.exceptions.Exit(_WRONG)
    for now, view, why_not, frames in _lookups(ctx, words[0], words[1], rate):
        if view is not None:
            output.write(f"At time {(view.time_ns or 0) / 1e9:.3f}\n{pose_text(view.pose)}")
            continue
        listing = [f"Frame {name} exists with parent {edge.parent}.\n" for name, edge in sorted(frames.edges.items())]
        error = f"Failure at {now}\nException thrown:{why_not}\nThe current list of frames is:\n"
        output.write(error + "".join(listing) + "\n")


def echo_py(ctx: Context, argv: Sequence[str]) -> None:
    """Run tf2_tools' `echo.py`. With a limit, the exit code is 1 when the last look-up failed."""
    parser = Parser(
        "echo.py",
        "echo.py [-h] [-r RATE] [-c CACHE_TIME] [-o OFFSET] [-t TIME] [-l LIMIT] [-p PRECISION] "
        "source_frame target_frame",
        option("-r --rate", "how often, in Hz (1)", "RATE"),
        option("-c --cache_time", "no effect: the latest transforms are looked up", "SECONDS", dest="cache"),
        option("-o --offset", "no effect: the latest transforms are looked up", "SECONDS"),
        option("-t --time", "no effect: the latest transforms are looked up", "SECONDS"),
        option("-l --limit", "number of look-ups after which it ends", "COUNT"),
        option("-p --precision", "decimals (3)", "DIGITS"),
        modern=True,
    )
    complaint = "the following arguments are required: source_frame, target_frame"
    given = parser.parse(without_remappings(argv), 2, 2, complaint, complaint)
    rate = _rate(given.rate or "1")
    if not rate > 0:
        parser.error("the rate must be above 0")
    limit = parser.number(int, given.limit, math.inf, "the limit must be an integer")
    digits = parser.number(int, given.precision, 3, "the precision must be an integer")
    idle = [f"-{dest[0]}" for dest in ("cache", "offset", "time") if getattr(given, dest) is not None]
    if idle:
        ctx.warn(f"{', '.join(idle)} without effect: the latest transforms are looked up")
    source, target = given.words
    for count, (now, view, why_not, _) in enumerate(_lookups(ctx, source, target, rate), start=1):
        if view is None:
            text = f"At time 0.0, (current time {now}) {why_not}"
            print(f"[ERROR] [{now}]: {text}", file=sys.stderr, flush=True)
        else:
            times = f"At time {(view.time_ns or 0) / 1e9}, (current time {float(now)})"
            output.write(f"{times}\n{pose_text(view.pose, digits)}")
        if count >= limit:
            raise click.exceptions.Exit(1 if view is None else 0)


def _rate(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def _lookups(ctx: Context, source: str, target: str, rate: float) -> Iterator[tuple[str, View | None, str, Frames]]:
    """Look up the pose of the target in the source repeatedly, without end.

    Yields:
        The simulated time in s, the pose or None, the reason when there is none, and all frames.
    """
    source, target = source.removeprefix("/"), target.removeprefix("/")
    with listening(ctx) as listener:
        # Publishers repeat their transforms: a frame that has not come after a while does not exist.
        listener.listen(lambda frames: frames.are_connected(source, target))
        due = listener.stream.monotonic()
        while True:
            time = ctx.call("/rosapi/get_time")["time"]
            now = f"{time['secs']}.{time['nsecs']:09d}"
            frames = listener.frames
            try:
                yield now, frames.transform(source, target), "", frames
            except (UnknownName, Refused):
                yield now, None, _why_not(frames, source, target), frames
            due += 1.0 / rate
            listener.until(due)


def _why_not(frames: Frames, source: str, target: str) -> str:
    """The reason of a failed look-up, in tf's words."""
    for name, role in ((source, "target_frame"), (target, "source_frame")):
        if name not in frames.names:
            return f'"{name}" passed to lookupTransform argument {role} does not exist. '
    return (
        f"Could not find a connection between '{source}' and '{target}' because they are not part of "
        "the same tree.Tf has two or more unconnected trees."
    )
