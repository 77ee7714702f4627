"""`tf_monitor` of tf: how late transforms come and how often, for all frames or along the chain between two."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import monotonic

import click

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.naming import without_remappings
from slidectl.cli.tf import STATIC, Frames, open_stream
from slidectl.cli.topics import Event, Stream, nanoseconds

_PERIOD_S = 0.25
_UNKNOWN = "unknown_publisher"
_STATIC_HZ = 1e8
_USAGE = "tf_monitor [SOURCE TARGET]: all frames, or the chain between two; until Ctrl-C"


class _Delays:
    """Delays in s of what came from somewhere, and when."""

    def __init__(self) -> None:
        self.count = 0
        self.total = self.most = 0.0
        self.first_ns = self.last_ns = 0

    def take(self, delay: float, now_ns: int) -> None:
        self.count += 1
        self.total += delay
        self.most = max(self.most, delay)
        if self.count == 1:
            self.first_ns = now_ns
        self.last_ns = now_ns

    @property
    def mean(self) -> float:
        return self.total / self.count if self.count else 0.0

    @property
    def rate(self) -> float:
        span = (self.last_ns - self.first_ns) / 1e9
        return (self.count - 1) / span if span > 0 else 0.0


class Monitor:
    """Takes transforms in and puts reports together. Delays are in simulated time, from stamp to arrival."""

    def __init__(self) -> None:
        self.frames = Frames()
        self._by_frame: dict[str, _Delays] = {}
        self._by_node: dict[str, _Delays] = {}
        self._chain = _Delays()

    def take(self, event: Event) -> None:
        """One message of /tf or /tf_static."""
        is_static = event.topic == STATIC
        self.frames.add(event.message, is_static)
        node = self._by_node.setdefault(_UNKNOWN + ("(static)" if is_static else ""), _Delays())
        for transform in event.message["transforms"]:
            stamp = nanoseconds(transform["header"]["stamp"])
            delay = 0.0 if is_static else (event.time_ns - stamp) / 1e9
            child = transform["child_frame_id"].removeprefix("/")
            self._by_frame.setdefault(child, _Delays()).take(delay, event.time_ns)
            node.take(delay, event.time_ns)

    def report(self, pair: tuple[str, str] | None, now_ns: int) -> str:
        """The block of one period. Raises UnknownName, Refused when there is no chain between the two."""
        lines = ["", "", "", f"RESULTS: for {f'{pair[0]} to {pair[1]}' if pair else 'all Frames'}"]
        shown = sorted(self._by_frame)
        if pair:
            view = self.frames.look_up(*pair)
            if view.time_ns is not None:
                self._chain.take((now_ns - view.time_ns) / 1e9, now_ns)
            chain = self._between(*pair)
            lines += [f"Chain is: {' -> '.join(chain)}"]
            lines += [f"Net delay     avg = {self._chain.mean:g}: max = {self._chain.most:g}"]
            shown = [frame for frame in chain if frame in self._by_frame]
        lines += ["", "Frames:", *map(self._frame, shown)]
        return "\n".join(lines)

    def _between(self, source: str, target: str) -> list[str]:
        up, down = self.frames.way_up(source), self.frames.way_up(target)
        common = next(name for name in up if name in down)
        return [*up[: up.index(common)], common, *reversed(down[: down.index(common)])]

    def _frame(self, name: str) -> str:
        delays = self._by_frame[name]
        by = _UNKNOWN + ("(static)" if self.frames.edges[name].is_static else "")
        return f"Frame: {name} published by {by} Average Delay: {delays.mean:g} Max Delay: {delays.most:g}"

    def broadcasters(self) -> str:
        """A line for each publisher; who they are is not said by their messages."""
        return "\n".join(
            f"Node: {name} {_STATIC_HZ if name.endswith('(static)') else delays.rate:g} Hz, "
            f"Average Delay: {delays.mean:g} Max Delay: {delays.most:g}"
            for name, delays in sorted(self._by_node.items())
        )


def tf_monitor(ctx: Context, argv: Sequence[str]) -> None:
    """Report four times a second, until Ctrl-C."""
    words = [word.removeprefix("/") for word in without_remappings(argv)]
    if len(words) not in (0, 2):
        print(_USAGE, file=sys.stderr, flush=True)
        raise click.exceptions.Exit(255)
    _, topics = open_stream(ctx)
    pair = (words[0], words[1]) if words else None
    monitor = Monitor()
    with Stream(ctx, topics, with_clock=True) as stream:
        if pair:
            _await_chain(stream, monitor, *pair)
        while True:
            _listen(stream, monitor)
            output.write(monitor.report(pair, stream.time_ns))
            print("\nAll Broadcasters:", file=sys.stderr, flush=True)
            output.write(monitor.broadcasters())


def _await_chain(stream: Stream, monitor: Monitor, source: str, target: str) -> None:
    sys.stdout.write(f"Waiting for transform chain to become available between {source} and {target} ")
    sys.stdout.flush()
    while not monitor.frames.are_connected(source, target):
        _listen(stream, monitor)
        if not monitor.frames.are_connected(source, target):
            sys.stdout.write(".")
            sys.stdout.flush()
    output.write("")


def _listen(stream: Stream, monitor: Monitor) -> None:
    deadline = monotonic() + _PERIOD_S
    while monotonic() < deadline and (event := stream.next(deadline)) is not None:
        monitor.take(event)
