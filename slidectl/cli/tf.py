"""`slidectl tf`: the frames of /tf and /tf_static, and the transforms between them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from slidectl.cli import output
from slidectl.cli.commands import group, positive_seconds
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import PUBLISHERS, Stream, users_of
from slidectl.errors import Refused, SlidectlError
from slidectl.transform_tree import MOVING, STATIC, FramePose, Frames, View, roll_pitch_yaw

PATIENCE_S = 3.0
# Publishers repeat their transforms. After a frame has come this often, all publishers of the same rate have published.
_ROUNDS = 3


# --- commands -------------------------------------------------------------------------------------------------------


@group(examples=["slidectl tf echo world link2", "slidectl tf tree"])
def tf() -> None:
    """Show the frames and the transforms between them."""


class Listener:
    """Collects transforms from a stream of `topics` until a condition holds."""

    def __init__(self, ctx: Context, stream: Stream, topics: list[str]) -> None:
        self._ctx = ctx
        self.stream = stream
        self._topics = topics
        self.frames = Frames()
        self._heard: Counter[str] = Counter()

    def listen(self, enough: Callable[[Frames], bool]) -> None:
        """Collect until `enough` is true, all frames have come, or `--timeout` (3 s) is over."""
        deadline = self.stream.monotonic() + self._ctx.wait_limit(PATIENCE_S)
        # The answer arrives after all messages of a paused world.
        is_paused = self._ctx.call("/slidectl/status")["paused"]
        while not enough(self.frames) and not self._is_complete(is_paused):
            event = self.stream.next(deadline)
            if event is None:
                return
            self._add(event.topic, event.message)

    def until(self, deadline: float) -> None:
        """Collect until `deadline` (on the stream's clock)."""
        while (event := self.stream.next(deadline)) is not None:
            self._add(event.topic, event.message)
            if self.stream.monotonic() >= deadline:
                return

    def find(self, *wanted: str) -> list[str]:
        """The frames' full names. The error has a hint when a paused world may be the reason."""
        try:
            return [self.frames.find(name, self._ctx.namespace) for name in wanted]
        except SlidectlError as error:
            if MOVING in self._topics and not self._heard:
                error.hint = f"{error.hint}\nnothing came on {MOVING}; is the simulation paused? slidectl sim status"
            raise

    def _add(self, topic: str, message: dict[str, Any]) -> None:
        self.frames.add(message, topic == STATIC)
        if topic == MOVING:
            self._heard.update(transform["child_frame_id"] for transform in message["transforms"])

    def _is_complete(self, is_paused: bool) -> bool:
        """True when all frames have come. Static ones are latched: they precede moving ones and a call's answer."""
        if MOVING not in self._topics or (is_paused and self._heard and self.stream.is_drained):
            return self.stream.is_drained
        return any(count >= _ROUNDS for count in self._heard.values())


@contextmanager
def listening(ctx: Context) -> Iterator[Listener]:
    """A listener to the transform topics that have publishers. Raises Refused when there is none."""
    known = ctx.client.topics()
    users = users_of(ctx, [topic for topic in (STATIC, MOVING) if topic in known], PUBLISHERS)
    topics = [topic for topic, nodes in users.items() if nodes]
    if not topics:
        raise Refused("nobody publishes transforms", "spawn a robot: slidectl spawn slider")
    with Stream(ctx, topics) as stream:
        yield Listener(ctx, stream, topics)


def _frames(ctx: Context) -> Frames:
    """All frames."""
    with listening(ctx) as listener:
        listener.listen(lambda _: False)
    return listener.frames


@tf.command("list", examples=["slidectl tf list", "slidectl tf list --json"])
@click.pass_obj
def list_frames(ctx: Context) -> None:
    """List the frames.

    JSON keys: frame, parent (null for a root), static, time (of the latest transform, simulated s).
    """
    frames = _frames(ctx)
    if ctx.format == "text":
        return ctx.emit_names(frames.names, "frame")
    return _rows(ctx, frames)


def _rows(ctx: Context, frames: Frames) -> None:
    columns = ["frame", "parent", "static", "time"]
    rows = []
    for name in frames.names:
        edge = frames.edges.get(name)
        cells = (None, True, None) if edge is None else (edge.parent, edge.is_static, edge.time_ns / 1e9)
        rows.append(dict(zip(columns, (name, *cells), strict=True)))
    ctx.emit_rows(rows, columns)


@tf.command("tree", examples=["slidectl tf tree"])
@click.pass_obj
def tree(ctx: Context) -> None:
    """Show the frames as a tree, children indented under their parent.

    Each frame is followed by 'static' or 'moving'. JSON is one object for each frame, as in 'slidectl tf list'.
    """
    frames = _frames(ctx)
    if ctx.format != "text":
        return _rows(ctx, frames)
    lines = []
    for depth, name, edge in frames.tree():
        lines.append("  " * depth + name + ("" if edge is None else " (static)" if edge.is_static else " (moving)"))
    return output.write("\n".join(lines))


@tf.command("echo", examples=["slidectl tf echo base_link link2", "slidectl tf echo world link2 -f --rate 5 --json"])
@click.argument("reference", metavar="A")
@click.argument("target", metavar="B")
@click.option("-n", "--count", type=click.IntRange(min=1), metavar="COUNT", help="Number of transforms.")
@click.option("-f", "--follow", is_flag=True, help="Continue until Ctrl-C.")
@click.option(
    "--rate", type=float, default=1.0, callback=positive_seconds, metavar="HZ", help="How often, Hz of wall time (1)."
)
@click.pass_obj
def echo(ctx: Context, reference: str, target: str, count: int | None, follow: bool, rate: float) -> None:
    """Print the pose of frame B in frame A, as tf_echo does: once, -n times, or until Ctrl-C.

    The unique end of a frame's name is enough. JSON keys: reference, target, time (simulated s; null when nothing
    between them moves), translation (x y z, m), rotation (x y z w), rpy (rad).
    """
    left = math.inf if follow and count is None else count or 1
    with listening(ctx) as listener:
        listener.listen(lambda frames: ctx.namespace == "/" and frames.are_connected(reference, target))
        due = listener.stream.monotonic()
        reference, target = listener.find(reference, target)
        while True:
            _print_pose(ctx, reference, target, listener.frames.transform(reference, target))
            left -= 1
            if left <= 0:
                return
            due += 1.0 / rate
            listener.until(due)


def _print_pose(ctx: Context, reference: str, target: str, view: View) -> None:
    pose, rpy = view.pose, roll_pitch_yaw(view.pose.rotation)
    time = None if view.time_ns is None else view.time_ns / 1e9
    record = {
        "reference": reference, "target": target, "time": time, "translation": list(pose.translation),
        "rotation": list(pose.rotation), "rpy": list(rpy),
    }  # fmt: skip
    ctx.emit(record, f"At time {time or 0.0:.3f}\n{pose_text(view.pose)}")


def pose_text(pose: FramePose, digits: int = 3) -> str:
    """The lines of tf_echo below the time: the frame's translation, in m, and its rotation."""
    rpy = roll_pitch_yaw(pose.rotation)
    degrees = [math.degrees(angle) for angle in rpy]
    return (
        f"- Translation: {_vector(pose.translation, digits)}\n"
        f"- Rotation: in Quaternion {_vector(pose.rotation, digits)}\n"
        f"            in RPY (radian) {_vector(rpy, digits)}\n"
        f"            in RPY (degree) {_vector(degrees, digits)}"
    )


def _vector(numbers: Any, digits: int) -> str:
    return "[" + ", ".join(f"{number:.{digits}f}" for number in numbers) + "]"
