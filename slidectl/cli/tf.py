"""`slidectl tf`: the frames of /tf and /tf_static, and the transforms between them.

Plain arithmetic on tuples: translations x y z in m, quaternions x y z w.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import click

from slidectl import names
from slidectl.cli import output
from slidectl.cli.commands import group, positive_seconds
from slidectl.cli.context import Context
from slidectl.cli.topic_streams import PUBLISHERS, Stream, users_of
from slidectl.errors import AmbiguousName, Refused, SlidectlError, UnknownName
from slidectl.rotations import IDENTITY, Quaternion, Vector, conjugate, multiply, normalized

MOVING, STATIC = "/tf", "/tf_static"
PATIENCE_S = 3.0
# A publisher repeats itself; when a frame has come so often, all that publish as fast have had their turn.
_ROUNDS = 3


# --- frames ---------------------------------------------------------------------------------------------------------


class FramePose(NamedTuple):
    """Where a frame is in another one."""

    translation: Vector
    rotation: Quaternion


class Edge(NamedTuple):
    """A frame's place in its parent. `time_ns` is its stamp; a static one holds for all times."""

    parent: str
    pose: FramePose
    time_ns: int
    is_static: bool


class View(NamedTuple):
    """A pose between two frames, and the time up to which it is known (None when nothing on the way moves)."""

    pose: FramePose
    time_ns: int | None


ORIGIN = FramePose((0.0, 0.0, 0.0), IDENTITY)


class Frames:
    """The latest transform of every frame."""

    def __init__(self) -> None:
        self.edges: dict[str, Edge] = {}

    def add(self, message: Mapping[str, Any], is_static: bool) -> None:
        """Take in a tf2_msgs/TFMessage; newer transforms replace older ones."""
        for stamped in message["transforms"]:
            header = stamped["header"]
            child = _plain(stamped["child_frame_id"])
            time_ns = header["stamp"]["secs"] * 10**9 + header["stamp"]["nsecs"]
            self.edges[child] = Edge(_plain(header["frame_id"]), _pose(stamped["transform"]), time_ns, is_static)

    @property
    def names(self) -> list[str]:
        """All frames, sorted."""
        return sorted({*self.edges, *(edge.parent for edge in self.edges.values())})

    @property
    def roots(self) -> list[str]:
        """Frames without a parent, sorted."""
        return [name for name in self.names if name not in self.edges]

    def children(self, name: str) -> list[str]:
        """Frames whose parent is `name`, sorted."""
        return sorted(child for child, edge in self.edges.items() if edge.parent == name)

    def way_up(self, name: str) -> list[str]:
        """The frame, its parent and so on to the root."""
        way = [name]
        while way[-1] in self.edges and self.edges[way[-1]].parent not in way:
            way.append(self.edges[way[-1]].parent)
        return way

    def find(self, name: str, namespace: str = "/") -> str:
        """The frame that `name` means: one below the namespace, else the unique end of a frame's name.

        Raises:
            UnknownName: it lists the frames there are. AmbiguousName: several end so.
        """
        known = self.names
        try:
            full = names.resolve(name, [f"/{frame}" for frame in known], kind="frame", namespace=namespace)
        except AmbiguousName as error:
            raise AmbiguousName("frame", name, [match[1:] for match in error.matches]) from None
        except UnknownName:
            raise UnknownName("frame", name, known) from None
        return full[1:]

    def are_connected(self, one: str, other: str) -> bool:
        """True when both are known, by their full names, and have the same root."""
        known = self.names
        one, other = one.removeprefix("/"), other.removeprefix("/")
        return one in known and other in known and self.way_up(one)[-1] == self.way_up(other)[-1]

    def look_up(self, reference: str, target: str) -> View:
        """The pose of `target` in `reference`.

        Raises:
            UnknownName: no such frame. Refused: they are not in one tree.
        """
        for name in (reference, target):
            if name not in self.names:
                raise UnknownName("frame", name, self.names)
        up, down = self.way_up(reference), self.way_up(target)
        if up[-1] != down[-1]:
            raise Refused(f"{reference} and {target} are not connected", f"their roots are {up[-1]} and {down[-1]}")
        common = next(name for name in up if name in down)
        up, down = up[: up.index(common)], down[: down.index(common)]
        times = [edge.time_ns for edge in map(self.edges.__getitem__, up + down) if not edge.is_static]
        pose = compose(inverse(self._along(up)), self._along(down))
        return View(pose, min(times) if times else None)

    def _along(self, way: Iterable[str]) -> FramePose:
        """The pose of the first frame of the way in the parent of the last one."""
        pose = ORIGIN
        for name in way:
            pose = compose(self.edges[name].pose, pose)
        return pose


def _plain(frame: str) -> str:
    # Frames of tf 1 may begin with a slash, those of tf2 never do.
    return frame.removeprefix("/")


def _pose(transform: Mapping[str, Mapping[str, float]]) -> FramePose:
    t, q = transform["translation"], transform["rotation"]
    return FramePose((t["x"], t["y"], t["z"]), normalized((q["x"], q["y"], q["z"], q["w"])))


def rotate(q: Quaternion, v: Vector) -> Vector:
    """The vector rotated by a unit quaternion."""
    x, y, z, _ = multiply(multiply(q, (*v, 0.0)), conjugate(q))
    return x, y, z


def compose(outer: FramePose, inner: FramePose) -> FramePose:
    """The pose of `inner`'s frame where `outer` says how its parent stands."""
    ox, oy, oz = outer.translation
    x, y, z = rotate(outer.rotation, inner.translation)
    return FramePose((ox + x, oy + y, oz + z), multiply(outer.rotation, inner.rotation))


def inverse(pose: FramePose) -> FramePose:
    """The pose of the parent in the frame."""
    back = conjugate(pose.rotation)
    tx, ty, tz = rotate(back, pose.translation)
    return FramePose((-tx, -ty, -tz), back)


def roll_pitch_yaw(q: Quaternion) -> Vector:
    """Fixed-axis angles in rad (URDF's rpy); at a pitch of 90 degrees the yaw is 0."""
    x, y, z, w = q
    sine = 2 * (x * z - w * y)
    if abs(sine) >= 1.0 - 1e-9:
        sign = -1.0 if sine > 0 else 1.0
        return sign * 2 * math.atan2(x, w), sign * math.pi / 2, 0.0
    roll = math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return roll, -math.asin(sine), yaw


# --- commands -------------------------------------------------------------------------------------------------------


@group(examples=["slidectl tf echo world link2", "slidectl tf tree"])
def tf() -> None:
    """Show the frames and the transforms between them."""


class Listener:
    """Collects transforms from a stream of `topics` until there is enough."""

    def __init__(self, ctx: Context, stream: Stream, topics: list[str]) -> None:
        self._ctx = ctx
        self._stream = stream
        self._topics = topics
        self.frames = Frames()
        self._heard: Counter[str] = Counter()
        self._is_still = False

    def listen(self, enough: Callable[[Frames], bool]) -> None:
        """Until it is enough, all frames have come, or `--timeout` (3 s) is over."""
        deadline = self._stream.monotonic() + self._ctx.wait_limit(PATIENCE_S)
        # Its answer comes after all that a world that stands still has to tell.
        self._is_still = self._ctx.call("/slidectl/status")["paused"]
        while not enough(self.frames) and not self._is_complete():
            event = self._stream.next(deadline)
            if event is None:
                return
            self._take(event.topic, event.message)

    def until(self, deadline: float) -> None:
        """Take in what comes until then (on the stream's clock)."""
        while (event := self._stream.next(deadline)) is not None:
            self._take(event.topic, event.message)
            if self._stream.monotonic() >= deadline:
                return

    def find(self, *wanted: str) -> list[str]:
        """The frames' full names; an error says so when the reason may be a world that stands still."""
        try:
            return [self.frames.find(name, self._ctx.namespace) for name in wanted]
        except SlidectlError as error:
            if MOVING in self._topics and not self._heard:
                error.hint = f"{error.hint}\nnothing came on {MOVING}; is the simulation paused? slidectl sim status"
            raise

    def _take(self, topic: str, message: dict[str, Any]) -> None:
        self.frames.add(message, topic == STATIC)
        if topic == MOVING:
            self._heard.update(transform["child_frame_id"] for transform in message["transforms"])

    def _is_complete(self) -> bool:
        """Static transforms are latched: they come at once, before the first moving one or the answer of a call."""
        if MOVING not in self._topics or (self._is_still and self._heard and self._stream.is_drained):
            return self._stream.is_drained
        return any(count >= _ROUNDS for count in self._heard.values())


def open_stream(ctx: Context) -> tuple[Stream, list[str]]:
    """A stream of the topics of transforms that somebody publishes. Raises Refused when there is none."""
    known = ctx.client.topics()
    users = users_of(ctx, [topic for topic in (STATIC, MOVING) if topic in known], PUBLISHERS)
    topics = [topic for topic, nodes in users.items() if nodes]
    if not topics:
        raise Refused("nobody publishes transforms", "spawn a robot: slidectl spawn slider")
    return Stream(ctx, topics), topics


def _frames(ctx: Context) -> Frames:
    """All frames there are."""
    stream, topics = open_stream(ctx)
    with stream:
        listener = Listener(ctx, stream, topics)
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

    Behind a frame stands 'static' or 'moving'. JSON is one object for each frame, as in 'slidectl tf list'.
    """
    frames = _frames(ctx)
    if ctx.format != "text":
        return _rows(ctx, frames)
    return output.write("\n".join(line for root in frames.roots for line in _branch(frames, root, "")))


def _branch(frames: Frames, name: str, indent: str) -> Iterator[str]:
    edge = frames.edges.get(name)
    yield f"{indent}{name}" + ("" if edge is None else " (static)" if edge.is_static else " (moving)")
    for child in frames.children(name):
        yield from _branch(frames, child, indent + "  ")


@tf.command("echo", examples=["slidectl tf echo base_link link2", "slidectl tf echo world link2 -f --rate 5 --json"])
@click.argument("reference", metavar="A")
@click.argument("target", metavar="B")
@click.option("-n", "--count", type=click.IntRange(min=1), metavar="COUNT", help="So many transforms.")
@click.option("-f", "--follow", is_flag=True, help="Go on until Ctrl-C.")
@click.option(
    "--rate", type=float, default=1.0, callback=positive_seconds, metavar="HZ", help="How often, on the wall clock (1)."
)
@click.pass_obj
def echo(ctx: Context, reference: str, target: str, count: int | None, follow: bool, rate: float) -> None:
    """Print the pose of frame B in frame A, as tf_echo does: once, or -n times, or again and again.

    The end of a frame's name is enough when no other one ends so.
    JSON keys: reference, target, time (simulated s; null when nothing between them moves), translation (x y z, m),
    rotation (x y z w), rpy (rad).
    """
    stream, topics = open_stream(ctx)
    left = math.inf if follow and count is None else count or 1
    with stream:
        listener = Listener(ctx, stream, topics)
        listener.listen(lambda frames: ctx.namespace == "/" and frames.are_connected(reference, target))
        due = stream.monotonic()
        reference, target = listener.find(reference, target)
        while True:
            _tell(ctx, reference, target, listener.frames.look_up(reference, target))
            left -= 1
            if left <= 0:
                return
            due += 1.0 / rate
            listener.until(due)


def _tell(ctx: Context, reference: str, target: str, view: View) -> None:
    pose, rpy = view.pose, roll_pitch_yaw(view.pose.rotation)
    time = None if view.time_ns is None else view.time_ns / 1e9
    record = {
        "reference": reference,
        "target": target,
        "time": time,
        "translation": list(pose.translation),
        "rotation": list(pose.rotation),
        "rpy": list(rpy),
    }
    ctx.emit(record, f"At time {time or 0.0:.3f}\n{pose_text(view.pose)}")


def pose_text(pose: FramePose, digits: int = 3) -> str:
    """The lines of tf_echo below the time: where the frame is, in m, and how it is turned."""
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
