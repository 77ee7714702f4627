"""The frames of /tf and /tf_static, and the transforms between them, from received messages.

Tuples only: translations x y z in m, quaternions x y z w.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from slidectl import names
from slidectl.errors import AmbiguousName, Refused, UnknownName
from slidectl.msgs.schema import nanoseconds
from slidectl.rotations import ORIGIN, Pose, Quaternion, Vector, compose, normalized, relative

MOVING, STATIC = "/tf", "/tf_static"


class FramePose(NamedTuple):
    """The pose of a frame in another one."""

    translation: Vector
    rotation: Quaternion


class Edge(NamedTuple):
    """The pose of a frame in its parent. `time_ns` is its stamp; a static pose holds for all times."""

    parent: str
    pose: FramePose
    time_ns: int
    is_static: bool


class View(NamedTuple):
    """A pose between two frames, and the time up to which it is known (None if all transforms are static)."""

    pose: FramePose
    time_ns: int | None


class Frames:
    """The latest transform of every frame."""

    def __init__(self) -> None:
        self.edges: dict[str, Edge] = {}

    def add(self, message: Mapping[str, Any], is_static: bool) -> None:
        """Add a tf2_msgs/TFMessage; newer transforms replace older ones."""
        for stamped in message["transforms"]:
            header = stamped["header"]
            child = _plain(stamped["child_frame_id"])
            time_ns = nanoseconds(header["stamp"])
            self.edges[child] = Edge(_plain(header["frame_id"]), _pose(stamped["transform"]), time_ns, is_static)

    @property
    def names(self) -> list[str]:
        """All frames, sorted."""
        return sorted({*self.edges, *(edge.parent for edge in self.edges.values())})

    @property
    def roots(self) -> list[str]:
        """Frames without a parent, sorted."""
        return [name for name in self.names if name not in self.edges]

    def tree(self) -> Iterator[tuple[int, str, Edge | None]]:
        """Each frame, parents first, with its depth and its pose in the parent; None for a root."""
        children: defaultdict[str, list[str]] = defaultdict(list)
        for name in sorted(self.edges):
            children[self.edges[name].parent].append(name)

        def below(frames: list[str], depth: int) -> Iterator[tuple[int, str, Edge | None]]:
            for name in frames:
                yield depth, name, self.edges.get(name)
                yield from below(children[name], depth + 1)

        return below(self.roots, 0)

    def way_up(self, name: str) -> list[str]:
        """The frame, its parent and so on up to the root."""
        way = [name]
        while way[-1] in self.edges and self.edges[way[-1]].parent not in way:
            way.append(self.edges[way[-1]].parent)
        return way

    def find(self, name: str, namespace: str = "/") -> str:
        """The full name of a frame: one below the namespace, else the unique end of a frame's name.

        Raises:
            UnknownName: lists the known frames. AmbiguousName: several match.
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
        """True when both frames are known, by full name, and have the same root."""
        known = self.names
        one, other = one.removeprefix("/"), other.removeprefix("/")
        return one in known and other in known and self.way_up(one)[-1] == self.way_up(other)[-1]

    def transform(self, reference: str, target: str) -> View:
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
        pose = FramePose(*relative(self._along(down), self._along(up)))
        return View(pose, min(times) if times else None)

    def _along(self, way: Iterable[str]) -> Pose:
        """The pose of the first frame of the path in the parent of the last one."""
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
