"""Sensors, odometry and paths in the scene, each topic drawn in the frame of its messages.

A topic is subscribed only while it is shown and a browser has the page open. How often and how much is read is bounded,
so that the world keeps its speed; /tf is read whole, while a frame that is shown needs it.
"""

from __future__ import annotations

import base64
import math
from collections import deque
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slidectl.errors import Refused
from slidectl.extensions.viewing.drawn_scene import DrawnScene
from slidectl.rotations import ORIGIN, Pose, Vector, compose
from slidectl.transform_tree import MOVING, STATIC, Frames

if TYPE_CHECKING:
    from viser import SceneApi

    from slidectl.client import Subscription
    from slidectl.extensions.viewing.page.page import Page
    from slidectl.measures import Array

_MOST_POINTS = 20_000
"""The most points of a cloud or scan that are drawn; of more, each second, third and so on is."""
_MOST_POSES = 2000
"""The most points of a line: the newest of an odometry, evenly chosen ones of a path."""
_WIDEST_CONE = 1.5
"""The largest half of a range's field of view, rad."""
_CONE_SIDES = 24
_RED, _BLUE, _GREEN, _PURPLE, _AMBER = (225, 55, 55), (70, 110, 240), (40, 165, 90), (175, 85, 215), (235, 150, 30)
_LOW, _HIGH = np.array((45, 95, 220)), np.array((235, 90, 50))
"""The colours of the lowest and the highest point of a cloud without colours."""
_NUMBERS = ("", "i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""The types of a sensor_msgs/PointField: INT8 is 1, and 0 is none."""
_TF = "tf2_msgs/TFMessage"

Message = dict[str, Any]


class _Drawing:
    """What is drawn of one topic: a node of the scene, in axes of the message's frame."""

    period_ms = 100
    """The least wall time between two messages."""
    is_rigid = False
    """Whether it moves with its frame between two messages. What was measured of the surroundings does not."""

    def __init__(self, scene: SceneApi, path: str) -> None:
        self.scene = scene
        self.path = path
        self.node: Any = None

    def draw(self, message: Message, size: float) -> None:
        """Show a message. `size` is the radius of its robot, m. Raises Refused: it cannot be drawn."""
        raise NotImplementedError

    def restart(self) -> None:
        """Forget earlier messages: the simulated time went back."""

    def remove(self) -> None:
        if self.node is not None:
            self.node.remove()
            self.node = None

    def place(self, pose: Pose) -> None:
        """Set the pose of the frame in the world."""
        if self.node is not None:
            self.node.position = pose[0]
            self.node.wxyz = (pose[1][3], *pose[1][:3])

    def _draw_points(self, points: Array, colours: Any, size: float) -> None:
        if self.node is None and len(points):
            self.node = self.scene.add_point_cloud(
                self.path, points.astype(np.float32), colours, point_size=0.02 * size, point_shape="circle",
                precision="float32", point_shading="flat",
            )  # fmt: skip
        elif len(points):
            self.node.points, self.node.colors = points.astype(np.float32), colours
        self._show(len(points) > 0)

    def _draw_line(self, points: Array, colour: Vector) -> None:
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > 1:
            pairs = np.stack((points[:-1], points[1:]), axis=1).astype(np.float32)
            if self.node is None:
                self.node = self.scene.add_line_segments(
                    self.path, pairs, colour, thickness=3.0, thickness_units="screen"
                )
            else:
                self.node.points = pairs
        self._show(len(points) > 1)

    def _show(self, value: bool) -> None:
        if self.node is not None:
            self.node.visible = value


class _Scan(_Drawing):
    """sensor_msgs/LaserScan: the points that were hit."""

    def draw(self, message: Message, size: float) -> None:
        ranges = np.array(message["ranges"], dtype=float)
        angles = message["angle_min"] + message["angle_increment"] * np.arange(len(ranges))
        hit = np.isfinite(ranges) & (ranges >= message["range_min"]) & (ranges <= message["range_max"])
        ranges, angles = (_thinned(values[hit], _MOST_POINTS) for values in (ranges, angles))
        points = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(len(ranges))))
        self._draw_points(points, np.array(_RED, dtype=np.uint8), size)


class _Cloud(_Drawing):
    """sensor_msgs/PointCloud2: in its own colours, or coloured by height."""

    period_ms = 200

    def draw(self, message: Message, size: float) -> None:
        try:
            points = _thinned(_cloud_points(message), _MOST_POINTS)
        except (TypeError, ValueError, IndexError) as error:
            raise Refused(f"this cloud does not have the data that its fields need: {error}") from error
        places = np.column_stack([points[axis] for axis in "xyz"]).astype(float)
        finite = np.isfinite(places).all(axis=1)
        places, points = places[finite], points[finite]
        if "rgb" in (points.dtype.names or ()):
            packed = points["rgb"].astype(np.uint32)
            colours = np.column_stack([packed >> shift & 255 for shift in (16, 8, 0)])
        else:
            heights = places[:, 2]
            span = float(np.ptp(heights)) if len(heights) else 0.0
            part = (heights - heights.min()) / span if span > 0 else np.zeros(len(heights))
            colours = _LOW + part[:, None] * (_HIGH - _LOW)
        self._draw_points(places, colours.astype(np.uint8), size)


class _Range(_Drawing):
    """sensor_msgs/Range: a cone along x as long as what was measured."""

    is_rigid = True

    def draw(self, message: Message, size: float) -> None:  # noqa: ARG002
        if self.node is None:
            radius = math.tan(min(max(message["field_of_view"] / 2, 0.01), _WIDEST_CONE))
            turns = np.linspace(0.0, 2 * math.pi, _CONE_SIDES, endpoint=False)
            rim = np.column_stack((np.ones(_CONE_SIDES), radius * np.cos(turns), radius * np.sin(turns)))
            here = np.arange(_CONE_SIDES)
            there = np.roll(here, -1)
            faces = np.concatenate(
                [np.column_stack((np.full(_CONE_SIDES, tip), 2 + here, 2 + there)) for tip in (0, 1)]
            )
            self.node = self.scene.add_mesh_simple(
                self.path, np.concatenate(([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], rim)), faces, color=_AMBER, opacity=0.35,
                side="double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        measured = message["range"]
        is_hit = measured is not None and message["min_range"] <= measured <= message["max_range"] and measured > 0
        if is_hit:
            self.node.scale = float(measured)
        self._show(is_hit)


class _Wrench(_Drawing):
    """geometry_msgs/WrenchStamped: arrows of the force (red) and the torque (blue), the largest so far the longest."""

    is_rigid = True

    def __init__(self, scene: SceneApi, path: str) -> None:
        super().__init__(scene, path)
        self._largest = {"force": 0.0, "torque": 0.0}

    def restart(self) -> None:
        self._largest = dict.fromkeys(self._largest, 0.0)

    def draw(self, message: Message, size: float) -> None:
        ends, colours = [], []
        for kind, colour in (("force", _RED), ("torque", _BLUE)):
            vector = np.array([message["wrench"][kind][axis] for axis in "xyz"], dtype=float)
            length = float(np.linalg.norm(vector))
            if 0.0 < length < math.inf:
                self._largest[kind] = max(self._largest[kind], length)
                ends.append(vector * (0.8 * size / self._largest[kind]))
                colours.append(colour)
        self.remove()  # the number of arrows may be another one
        if ends:
            self.node = self.scene.add_arrows(
                self.path, np.stack((np.zeros((len(ends), 3)), np.array(ends)), axis=1), np.array(colours),
                shaft_radius=0.02 * size, head_radius=0.05 * size, head_length=0.12 * size,
            )  # fmt: skip


class _Odometry(_Drawing):
    """nav_msgs/Odometry: the way so far."""

    def __init__(self, scene: SceneApi, path: str) -> None:
        super().__init__(scene, path)
        self._way: deque[Vector] = deque(maxlen=_MOST_POSES)

    def restart(self) -> None:
        self._way.clear()

    def draw(self, message: Message, size: float) -> None:
        here = _place(message["pose"]["pose"]["position"])
        if not all(map(math.isfinite, here)):  # raises TypeError for None, which is how nan is sent
            return
        if not self._way or math.dist(here, self._way[-1]) > 0.01 * size:
            self._way.append(here)
            self._draw_line(np.array(self._way), _GREEN)


class _Path(_Drawing):
    """nav_msgs/Path: the line through its poses."""

    def draw(self, message: Message, size: float) -> None:  # noqa: ARG002
        poses = [_place(one["pose"]["position"]) for one in _thinned(message["poses"], _MOST_POSES)]
        self._draw_line(np.array(poses).reshape(-1, 3), _PURPLE)


_DRAWINGS: dict[str, type[_Drawing]] = {
    "sensor_msgs/LaserScan": _Scan,
    "sensor_msgs/PointCloud2": _Cloud,
    "sensor_msgs/Range": _Range,
    "geometry_msgs/WrenchStamped": _Wrench,
    "nav_msgs/Odometry": _Odometry,
    "nav_msgs/Path": _Path,
}


class _ShownTopic:
    """A topic that is shown, with its newest message."""

    def __init__(self, topic: str, type_name: str, drawing: _Drawing) -> None:
        self.topic = topic
        self.type = type_name
        self.drawing = drawing
        self.subscription: Subscription | None = None
        self.frame: str | None = None
        """The frame of the newest message; None before the first."""
        self.message: Message | None = None
        """The newest message as long as it is not drawn."""
        self.trouble = ""
        """Why nothing is drawn."""
        self.size = 1.0
        """The radius of the topic's robot, m."""
        self.needs_tf = False
        """Whether its frame was looked for on /tf."""

    def take(self, event: Message) -> None:
        self.message = event["msg"]


class SensorDrawings:
    """The topics that browsers have chosen to see in the scene. All browsers see the same."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._shown: dict[str, _ShownTopic] = {}
        self._namespaces: dict[str, str] = {}
        """Robot -> namespace."""
        self._tf = Frames()
        self._tf_subscriptions: list[Subscription] = []
        self._anchors: dict[tuple[str, str], Pose] = {}
        """Robot of a topic, and a frame above it (`odom`) -> where that was when it was first needed.

        So its drift is seen. Frames of several robots may have one name."""
        self._time = 0.0

    def state(self) -> dict[str, str]:
        """Each shown topic, and why nothing is drawn; empty when it is drawn."""
        return {topic: one.trouble for topic, one in self._shown.items()}

    @staticmethod
    def types() -> list[str]:
        """The message types that are drawn."""
        return list(_DRAWINGS)

    def choose(self, request: Message) -> None:
        """Show a `topic`, or with `shown` false (then its full name) do not. Raises UnknownName, Refused."""
        topic = str(request["topic"])
        if not request["shown"]:
            self._remove(topic)
        elif topic not in self._shown:
            found = self._page.client.resolve("topic", topic)
            topic, type_name = str(found["name"]), str(found["type"])
            if topic in self._shown:
                return
            if type_name not in _DRAWINGS:
                raise Refused(f"{type_name} is not drawn in the scene", f"drawn are {', '.join(_DRAWINGS)}")
            path = f"/sensors/{topic[1:].replace('/', '.')}"  # flat: a topic below another one is not below its node
            drawing = _DRAWINGS[type_name](self._page.server.scene, path)
            self._shown[topic] = _ShownTopic(topic, type_name, drawing)

    def _remove(self, topic: str) -> None:
        one = self._shown.pop(topic, None)
        if one is not None:
            one.drawing.remove()
            if one.subscription is not None:
                one.subscription.close()
        if not any(one.needs_tf for one in self._shown.values()):
            self._end_tf()

    def rest(self) -> None:
        """End all subscriptions: no browser has the page open, or the robots have changed."""
        for one in self._shown.values():
            if one.subscription is not None:
                one.subscription.close()
                one.subscription = None
        self._end_tf()

    def _end_tf(self) -> None:
        for subscription in self._tf_subscriptions:
            subscription.close()
        self._tf_subscriptions.clear()
        self._tf = Frames()

    def leave(self) -> None:
        """Show nothing any more."""
        for topic in list(self._shown):
            self._remove(topic)

    def robots_changed(self) -> None:
        """Begin anew; topics of robots that have gone are not shown any more. Raises NoDaemon."""
        self.rest()
        self._anchors.clear()
        for topic in list(self._shown):
            if not self._page.client.call("/rosapi/publishers", {"topic": topic})["publishers"]:
                self._remove(topic)

    # --- drawing ------------------------------------------------------------------------------------------------

    def update(self, scene: DrawnScene) -> None:
        """Draw what has come. Raises NoDaemon."""
        if scene.time < self._time:
            self._anchors.clear()
            for one in self._shown.values():
                one.drawing.restart()
        self._time = scene.time
        for one in list(self._shown.values()):
            try:
                if one.subscription is None:
                    self._subscribe(one, scene)
                self._draw(one, scene)
            except Refused as error:
                one.drawing.remove()
                one.trouble = f"{error.message[0].upper()}{error.message[1:]}."
                if one.subscription is None:  # the topic has another type now
                    self._remove(one.topic)
                    self._page.tell("error", f"{one.topic} is not drawn any more: {error.message}")

    def _subscribe(self, one: _ShownTopic, scene: DrawnScene) -> None:
        client = self._page.client
        self._namespaces = {robot["name"]: robot["namespace"] for robot in client.robots()}
        one.subscription = client.subscribe(
            one.topic, one.type, queue_length=1, throttle_rate=one.drawing.period_ms, take=one.take
        )
        owners = self._owners(one.topic)
        one.size = scene.bounds(owners[0] if owners and owners[0] in scene.robots else "")[1]
        if one.frame is None:
            one.trouble = "No message has come yet."

    def _draw(self, one: _ShownTopic, scene: DrawnScene) -> None:
        message = one.message
        if message is None:
            if one.drawing.is_rigid and one.frame is not None and (pose := self._pose_of(one, scene)):
                one.drawing.place(pose)
            return
        one.frame = message["header"]["frame_id"].removeprefix("/")
        try:
            pose = self._pose_of(one, scene)
            if pose is None:  # the message waits for its frame
                one.trouble = f"There is no frame {one.frame!r}: no link has this name, and it is not on /tf."
                return
            one.message, one.trouble = None, ""
            one.drawing.draw(message, one.size)
        except TypeError:  # null is how nan is sent
            one.message, one.trouble = None, "A number of the message is nan."
        else:
            one.drawing.place(pose)

    # --- frames -------------------------------------------------------------------------------------------------

    def _owners(self, topic: str) -> list[str]:
        """The robots, that with the longest namespace that the topic is in first."""

        def length(robot: str) -> int:
            space = self._namespaces[robot].rstrip("/")
            return len(space) if topic.startswith(f"{space}/") else -1

        return sorted(self._namespaces, key=length, reverse=True)

    def _pose_of(self, one: _ShownTopic, scene: DrawnScene) -> Pose | None:
        """Where the frame of a topic is in the world; None: not known yet."""
        assert one.frame is not None
        if one.frame in ("", "world"):
            return ORIGIN
        if link := self._link(one.frame, one, scene):
            return scene.poses[link]
        if (anchor := self._anchors.get(self._anchor(one))) is not None:
            return anchor
        if isinstance(one.drawing, _Odometry) and one.message is not None:
            odometry, pose = Frames(), one.message["pose"]["pose"]
            transform = {"translation": pose["position"], "rotation": pose["orientation"]}
            stamped = {"header": one.message["header"], "child_frame_id": one.message["child_frame_id"]}
            odometry.add({"transforms": [{**stamped, "transform": transform}]}, is_static=False)
            if (found := self._through(odometry, one, scene)) is not None:
                return found
        one.needs_tf = True
        if not self._tf_subscriptions:
            for topic in (STATIC, MOVING):
                take = partial(self._take_tf, is_static=topic == STATIC)
                self._tf_subscriptions.append(self._page.client.subscribe(topic, _TF, take=take))
        return self._through(self._tf, one, scene)

    def _take_tf(self, event: Message, is_static: bool) -> None:
        with suppress(TypeError):  # a number that is nan comes as null
            self._tf.add(event["msg"], is_static)

    def _through(self, frames: Frames, one: _ShownTopic, scene: DrawnScene) -> Pose | None:
        """Where a frame is that is above or below a link in the tree."""
        assert one.frame is not None
        way = frames.way_up(one.frame)
        above = [frame for frame in way[1:] if frame == "world" or self._link(frame, one, scene)]
        below = (child for child in frames.edges if self._link(child, one, scene) and one.frame in frames.way_up(child))
        known = next(iter(above), None) or next(below, None)
        if known is None:
            return None
        link = self._link(known, one, scene)
        pose = compose(scene.poses[link] if link else ORIGIN, frames.transform(known, one.frame).pose)
        if not above:
            self._anchors[self._anchor(one)] = pose
        return pose

    def _anchor(self, one: _ShownTopic) -> tuple[str, str]:
        return next(iter(self._owners(one.topic)), ""), one.frame or ""

    def _link(self, frame: str, one: _ShownTopic, scene: DrawnScene) -> str | None:
        """ROBOT::LINK of a frame."""
        found = (f"{robot}::{name}" for robot in self._owners(one.topic) for name in _names(frame))
        return next((link for link in found if link in scene.poses), None)


def _names(frame: str) -> tuple[str, ...]:
    """What the link of a frame may be called: PREFIX/LINK is the frame of LINK where robots have equal links."""
    return (frame, frame.rpartition("/")[2]) if "/" in frame else (frame,)


def _thinned(values: Any, most: int) -> Any:
    """At most so many of the values, evenly chosen."""
    return values[:: max(1, math.ceil(len(values) / most))]


def _place(point: Message) -> Vector:
    return point["x"], point["y"], point["z"]


def _cloud_points(message: Message) -> NDArray[Any]:
    """The points of a sensor_msgs/PointCloud2, with the fields x, y, z, and perhaps rgb.

    Raises:
        Refused: there are no coordinates. TypeError, ValueError, IndexError: the description and the data do not fit.
    """
    order = ">" if message["is_bigendian"] else "<"
    fields = {field["name"]: field for field in message["fields"]}
    if not fields.keys() >= {*"xyz"}:
        raise Refused("this cloud has no fields x, y and z")
    kinds = {axis: order + _NUMBERS[fields[axis]["datatype"]] for axis in "xyz"}
    offsets = {axis: fields[axis]["offset"] for axis in "xyz"}
    colour = fields.get("rgb") or fields.get("rgba")
    if colour is not None:
        kinds["rgb"], offsets["rgb"] = f"{order}u4", colour["offset"]
    if message["row_step"] < message["width"] * message["point_step"]:
        raise ValueError("row_step is too small")  # few bytes would be many points
    kind = np.dtype(
        {"names": [*kinds], "formats": [*kinds.values()], "offsets": [*offsets.values()],
         "itemsize": message["point_step"]}
    )  # fmt: skip
    shape, strides = (message["height"], message["width"]), (message["row_step"], message["point_step"])
    return np.ndarray(shape, kind, base64.b64decode(message["data"]), strides=strides).reshape(-1)
