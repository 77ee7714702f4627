"""`tf_echo` of tf and `echo.py` of tf2_tools: the pose of one frame in another, again and again."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from time import monotonic

import click

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.arguments import Arguments, Option, Parser
from slidectl.cli.ros.naming import without_remappings
from slidectl.cli.tf import Frames, Listener, View, open_stream, pose_text
from slidectl.errors import Refused, UnknownName

_WRONG = 255
_FIRST_WAIT_S = 1.0
_USAGE = """tf_echo source_frame target_frame [echo_rate]

Prints where target_frame is in source_frame, and how it is turned there: what takes
coordinates of target_frame into source_frame. Again and again, echo_rate times a
second (1 if it is left out), until Ctrl-C.
"""


def tf_echo(ctx: Context, argv: Sequence[str]) -> None:
    """`tf_echo SOURCE TARGET [HZ]`, until Ctrl-C."""
    words = without_remappings(argv)
    if len(words) not in (2, 3):
        output.write(_USAGE)
        raise click.exceptions.Exit(_WRONG)
    rate = _rate(words[2]) if len(words) == 3 else 1.0
    if not rate > 0:
        print("Echo rate must be > 0.0", file=sys.stderr, flush=True)
        raise click.exceptions.Exit(_WRONG)
    with _Listening(ctx, words[0], words[1]) as frames:
        while True:
            try:
                view = frames.view()
            except (UnknownName, Refused):
                output.write(f"Failure at {frames.now()}\nException thrown:{frames.why_not()}\n{frames.listing()}\n")
            else:
                output.write(f"At time {(view.time_ns or 0) / 1e9:.3f}\n{pose_text(view.pose)}")
            frames.listen(1.0 / rate)


def _rate(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


class _Listening:
    """The frames as they come. `source` and `target` are tf_echo's: the pose of the target in the source."""

    def __init__(self, ctx: Context, source: str, target: str) -> None:
        self._ctx = ctx
        self.source, self.target = source.removeprefix("/"), target.removeprefix("/")
        self._stream, topics = open_stream(ctx)
        self._listener = Listener(ctx, self._stream, topics)
        self._due = 0.0

    def __enter__(self) -> _Listening:
        self._stream.__enter__()
        # A publisher repeats itself: what is not there after a while is not there.
        self._listener.listen(lambda frames: frames.are_connected(self.source, self.target))
        self._due = monotonic()
        return self

    def __exit__(self, *error: object) -> None:
        self._stream.__exit__(*error)  # type: ignore[arg-type]

    @property
    def _frames(self) -> Frames:
        return self._listener.frames

    def listen(self, seconds: float) -> None:
        """Until the next report is due."""
        self._due += seconds
        self._listener.until(self._due)

    def view(self) -> View:
        """Raises UnknownName, Refused."""
        return self._frames.look_up(self.source, self.target)

    def now(self) -> str:
        """The simulated time in seconds."""
        time = self._ctx.call("/rosapi/get_time")["time"]
        return f"{time['secs']}.{time['nsecs']:09d}"

    def why_not(self) -> str:
        """The reason in tf's words."""
        for name, role in ((self.source, "target_frame"), (self.target, "source_frame")):
            if name not in self._frames.names:
                return f'"{name}" passed to lookupTransform argument {role} does not exist. '
        return (
            f"Could not find a connection between '{self.source}' and '{self.target}' because they are not part of "
            "the same tree.Tf has two or more unconnected trees."
        )

    def listing(self) -> str:
        """All frames that have a parent."""
        lines = [f"Frame {name} exists with parent {edge.parent}." for name, edge in sorted(self._frames.edges.items())]
        return "\n".join(["The current list of frames is:", *lines, ""])


_PARSER = Parser(
    "echo.py",
    "echo.py [-h] [-r RATE] [-c CACHE_TIME] [-o OFFSET] [-t TIME] [-l LIMIT] [-p PRECISION] source_frame target_frame",
    [
        Option(("-r", "--rate"), "rate", "how often, in Hz (1)", "RATE"),
        Option(("-c", "--cache_time"), "cache", "no effect: the latest transforms are looked up", "SECONDS"),
        Option(("-o", "--offset"), "offset", "no effect: the latest transforms are looked up", "SECONDS"),
        Option(("-t", "--time"), "time", "no effect: the latest transforms are looked up", "SECONDS"),
        Option(("-l", "--limit"), "limit", "end after so many", "COUNT"),
        Option(("-p", "--precision"), "precision", "decimals (3)", "DIGITS"),
    ],
    modern=True,
)


def echo_py(ctx: Context, argv: Sequence[str]) -> None:
    """tf2_tools' `echo.py`. With a limit it ends with 1 when the last look-up failed."""
    given = _PARSER.parse(without_remappings(argv))
    if len(given.words) != 2:
        _PARSER.error("echo.py: error: the following arguments are required: source_frame, target_frame")
    rate, limit, digits = _numbers(ctx, given)
    failed = False
    with _Listening(ctx, *given.words) as frames:
        while limit > 0:
            failed = not _echo_once(frames, digits)
            limit -= 1
            if limit > 0:
                frames.listen(1.0 / rate)
    if failed:
        raise click.exceptions.Exit(1)


def _numbers(ctx: Context, given: Arguments) -> tuple[float, float, int]:
    rate = 1.0 if given.rate is None else _rate(given.rate)
    if not rate > 0:
        _PARSER.error("echo.py: error: the rate must be above 0")
    limit = math.inf if given.limit is None else _PARSER.integer(given.limit, 0, "echo.py: error: limit: no integer")
    idle = [f"-{dest[0]}" for dest in ("cache", "offset", "time") if getattr(given, dest) is not None]
    if idle:
        ctx.warn(f"{', '.join(idle)} without effect: the latest transforms are looked up")
    return rate, limit, _PARSER.integer(given.precision, 3, "echo.py: error: precision: no integer")


def _echo_once(frames: _Listening, digits: int) -> bool:
    """Print one pose on stdout, or on stderr why there is none."""
    now = frames.now()
    try:
        view = frames.view()
    except (UnknownName, Refused):
        text = f"At time 0.0, (current time {now}) {frames.why_not()}"
        print(f"[ERROR] [{now}]: {text}", file=sys.stderr, flush=True)
        return False
    output.write(f"At time {(view.time_ns or 0) / 1e9}, (current time {float(now)})\n{pose_text(view.pose, digits)}")
    return True
