"""`view_frames` of tf and of tf2_tools: the tree of frames as a drawing, frames.gv and, with graphviz, frames.pdf.

They listen for a second, where the real ones take five.
"""

from __future__ import annotations

import subprocess
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic

from slidectl.cli import output
from slidectl.cli.context import Context
from slidectl.cli.ros.arguments import Parser
from slidectl.cli.ros.failure import Failure
from slidectl.cli.ros.naming import without_remappings
from slidectl.cli.tf import STATIC, Frames, open_stream
from slidectl.cli.topics import PUBLISHERS, nanoseconds, users_of
from slidectl.errors import Refused

_LISTEN_S = 1.0
_STATIC_RATE = 10000.0
"""What tf says of frames that never change."""


class Heard:
    """What came of the transforms of one frame: how many, and the stamps of the first and the last."""

    def __init__(self) -> None:
        self.count = 0
        self.oldest_ns = self.latest_ns = 0

    def take(self, time_ns: int) -> None:
        """One transform more."""
        self.count += 1
        if self.count == 1:
            self.oldest_ns = time_ns
        self.latest_ns = time_ns

    @property
    def rate(self) -> float:
        """Hz, by the stamps."""
        span = (self.latest_ns - self.oldest_ns) / 1e9
        return (self.count - 1) / span if span > 0 else 0.0


class Recording:
    """All that was heard on /tf and /tf_static for a while. Raises Refused when nobody publishes transforms."""

    def __init__(self, ctx: Context, seconds: float) -> None:
        self.frames = Frames()
        self.heard: defaultdict[str, Heard] = defaultdict(Heard)
        stream, topics = open_stream(ctx)
        self.publishers = {topic: _name(nodes) for topic, nodes in users_of(ctx, topics, PUBLISHERS).items()}
        deadline = monotonic() + seconds
        with stream:
            while (event := stream.next(deadline)) is not None and monotonic() < deadline:
                self.frames.add(event.message, event.topic == STATIC)
                for transform in event.message["transforms"]:
                    child = transform["child_frame_id"].removeprefix("/")
                    self.heard[child].take(nanoseconds(transform["header"]["stamp"]))

    def broadcaster(self, child: str) -> str:
        """The node that says where the frame is."""
        topic = STATIC if self.frames.edges[child].is_static else "/tf"
        return self.publishers.get(topic, "unknown_publisher")


def _name(nodes: Sequence[str]) -> str:
    # A message does not say whose it is, so with several publishers nobody knows.
    return nodes[0] if len(nodes) == 1 else "unknown_publisher"


def dot(recording: Recording, now: float) -> str:
    """The graph in graphviz's language, as tf writes it."""
    lines = ["digraph G {"]
    for child, edge in sorted(recording.frames.edges.items()):
        heard = recording.heard[child]
        numbers = (_STATIC_RATE, 0.0, 0.0, 0.0)
        if not edge.is_static:
            latest, oldest = heard.latest_ns / 1e9, heard.oldest_ns / 1e9
            numbers = (round(heard.rate, 3), round(latest - oldest, 3), latest, oldest)
        label = (
            f" Broadcaster: {recording.broadcaster(child)}\\n"
            f"Average rate: {numbers[0]}\\nBuffer length: {numbers[1]}\\n"
            f"Most recent transform: {numbers[2]}\\nOldest transform: {numbers[3]}\\n"
        )
        lines.append(f'"{edge.parent}" -> "{child}"[label="{label}"];')
    lines += ["edge [style=invis];"]
    lines += [' subgraph cluster_legend { style=bold; color=black; label ="view_frames Result";']
    lines += [f'"Recorded at time: {now}"[ shape=plaintext ] ;']
    lines += ["}" + "".join(f'->"{root}";' for root in recording.frames.roots[:1]), "}"]
    return "\n".join(lines)


def _draw(ctx: Context, say: Callable[[str], None]) -> str | None:
    """Listen and write frames.gv and frames.pdf; the reason why there is no pdf, if so."""
    try:
        recording = Recording(ctx, _LISTEN_S)
    except Refused as error:
        raise Failure(f"ERROR: {error}") from None
    say("Done Listening")
    time = ctx.call("/rosapi/get_time")["time"]
    graph = Path("frames.gv")
    try:
        graph.write_text(dot(recording, nanoseconds(time) / 1e9), encoding="utf-8")
    except OSError as error:
        raise Failure(f"ERROR: cannot write {graph}: {error.strerror}") from None
    try:
        subprocess.run(["dot", "-Tpdf", str(graph), "-o", "frames.pdf"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        said = b"" if isinstance(error, OSError) else error.stderr
        why = said.decode(errors="replace").strip() or "graphviz is not installed"
        return f"no frames.pdf: {why}; frames.gv holds the graph, and 'slidectl tf tree' prints it"
    return None


def view_frames(ctx: Context, argv: Sequence[str]) -> None:
    """tf's."""
    Parser("view_frames", "view_frames").parse(without_remappings(argv))
    output.write(f"Listening to /tf for {_LISTEN_S} seconds")
    trouble = _draw(ctx, output.write)
    output.write(trouble or "frames.pdf generated")


def view_frames_py(ctx: Context, argv: Sequence[str]) -> None:
    """tf2_tools'."""
    Parser("view_frames.py", "view_frames.py").parse(without_remappings(argv))
    info = _Info(ctx)
    info("Listening to tf data during 1 seconds...")
    trouble = _draw(ctx, lambda _: info("Generating graph in frames.pdf file..."))
    if trouble:
        ctx.warn(trouble)


class _Info:
    """Lines as rospy logs them, with the simulated time."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx

    def __call__(self, text: str) -> None:
        time = self._ctx.call("/rosapi/get_time")["time"]
        output.write(f"[INFO] [{time['secs']}.{time['nsecs'] // 1000:06d}]: {text}")
