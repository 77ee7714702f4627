"""The 3D view of the robots in the browser, optional drawings in it, and pushing links with the mouse."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from viser import SceneNodeHandle

from slidectl.description.robot import MOVING, Robot
from slidectl.errors import UnknownName
from slidectl.extensions.viewing.drawn_scene import VIEWS, DrawnScene
from slidectl.extensions.viewing.page.drawing_quality import DrawingQuality
from slidectl.extensions.viewing.page.frame_labels import FrameLabels
from slidectl.extensions.viewing.page.goal_ghost import GoalGhost
from slidectl.extensions.viewing.page.sensor_drawings import SensorDrawings
from slidectl.measures import Array
from slidectl.rotations import IDENTITY, Vector, compose, conjugate, relative, rotate

if TYPE_CHECKING:
    from slidectl.extensions.viewing.page.page import Page
    from slidectl.msgs.typed import PointMsg, SceneResponseMsg, Vector3Msg

FRAMES, AXES, MASSES, CONTACTS = "frames", "axes", "masses", "contacts"
_DISTANCE = 3.2
"""The distance of the camera, in radii of what it looks at."""
_EXTRAS_S = 0.1
"""Wall seconds between two drawings of what follows the robots: names, traces, pushes and the ghost of a goal."""
_MOST_TRACED = 2000
_STIFFNESS = 50.0
"""Stiffness of a push with the mouse, N per m and per kg of the robot."""
_PUSH_S = 0.3
"""Wall seconds after which a push ends unless it is renewed: the page may have ended."""
_LONGEST_PUSH = 10.0
"""The longest push, in radii of the scene."""
_RED, _GREEN, _BLUE, _YELLOW = (230, 60, 60), (60, 180, 75), (60, 90, 230), (240, 190, 30)


class SceneView:
    """The 3D scene, and what browsers choose of it. All browsers show the same."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self._scene: DrawnScene | None = None
        self._links: dict[str, Any] = {}
        """ROBOT::LINK -> its frame in viser."""
        self._extra: dict[str, list[SceneNodeHandle]] = {FRAMES: [], AXES: [], MASSES: []}
        self._shown: dict[str, bool] = dict.fromkeys((FRAMES, AXES, MASSES, CONTACTS), False)
        self._collisions = False
        self._traced = ""
        self._held: dict[str, tuple[Vector, Array]] = {}
        """Pushed link -> the grasped point in the link's frame, and the mouse's point in the world, m."""
        self._trace: deque[Vector] = deque(maxlen=_MOST_TRACED)
        self._is_trace_new = False
        self._placed: Any = None
        self._placed_name = ""
        self._told: set[str] = set()
        self._is_looked_at = False
        self._extras_due = 0.0
        self.sensors = SensorDrawings(page)
        self.quality = DrawingQuality(page)
        self._ghost = GoalGhost(page)
        self._labels = FrameLabels(page)
        self._ground = page.server.scene.add_grid(
            "/ground", 40.0, 40.0, cell_size=1.0, section_size=5.0, plane="xy",
            cell_color=(150, 158, 170), section_color=(120, 128, 140), cell_thickness=0.6, section_thickness=0.9,
            shadow_opacity=0.3,
        )  # fmt: skip

    # --- what browsers choose -----------------------------------------------------------------------------------

    def options(self) -> dict[str, Any]:
        """What is shown."""
        more = {"collisions": self._collisions, "trace": self._traced, "placed": self._placed_name}
        looks = {
            "shadows": self.quality.shadows,
            "has_shadows": self.quality.has_shadows,
            "sensors": self.sensors.state(),
            "drawn_types": self.sensors.types(),
        }
        return {**self._shown, **more, **looks}

    def choose(self, request: dict[str, Any]) -> None:
        """Change some of the options. Raises UnknownName."""
        for name, value in request.items():
            if name == "trace":
                self._choose_traced(str(value))
            elif name == "collisions":
                self._collisions = bool(value)
                self._look()
            elif name == "shadows":
                self.quality.choose_shadows(str(value))
            elif name in self._shown:
                self._show(name, bool(value))
            else:
                raise UnknownName("option of the view", name, [*self._shown, "trace", "collisions", "shadows"])

    def look_from(self, request: dict[str, Any]) -> None:
        """Move the cameras of all browsers to the `view`, as of `slidectl render`, of a `robot` or of the whole world.

        Raises:
            UnknownName.
        """
        view, robot = str(request["view"]), str(request.get("robot", ""))
        if view not in VIEWS:
            raise UnknownName("view", view, list(VIEWS))
        if self._scene is not None:
            self._aim(view, robot if robot in self._scene.robots else "")

    def _aim(self, view: str, robot: str) -> None:
        assert self._scene is not None
        centre, radius = self._scene.bounds(robot)
        # Straight from above, the camera would have no direction for up.
        eye = centre + _DISTANCE * radius * (np.array(VIEWS[view]) + np.array((0.0, -1e-3, 0.0)) * (view == "top"))
        server = self.page.server
        server.initial_camera.look_at, server.initial_camera.position = centre, eye
        for browser in server.get_clients().values():
            browser.camera.up_direction = (0.0, 0.0, 1.0)
            browser.camera.position, browser.camera.look_at = eye, centre

    def leave(self) -> None:
        """Remove everything: the daemon has ended."""
        self._held.clear()
        self.page.server.scene.remove_by_name("/push")
        self._place("")
        self.sensors.leave()
        self._ghost.leave()
        self._remove_robots()
        self._scene = None

    def rest(self) -> None:
        """Let go of what is subscribed: no browser has the page open."""
        self.sensors.rest()

    def show_ghost(self, request: dict[str, Any]) -> None:
        """Show the goal of a trajectory, as `GoalGhost.show` does. Raises UnknownName, Refused."""
        self._ghost.show(request, self._scene)

    def _remove_robots(self) -> None:
        self._labels.clear()
        for link in self._links.values():
            link.remove()
        self._links.clear()
        for nodes in self._extra.values():
            nodes.clear()

    def _show(self, what: str, value: bool) -> None:
        self._shown[what] = value
        for node in self._extra.get(what, ()):
            node.visible = value
        if what == CONTACTS and not value:
            self.page.server.scene.remove_by_name("/contacts")
        if what == FRAMES and not value:
            self._labels.clear()

    def _choose_traced(self, link: str) -> None:
        if link and (self._scene is None or link not in self._scene.poses):
            raise UnknownName("link", link, [*self._scene.poses] if self._scene else [])
        self._traced = link
        self._trace.clear()
        self.page.server.scene.remove_by_name("/trace")

    # --- the scene ------------------------------------------------------------------------------------------------

    def draw(self) -> None:
        """Update all poses. Raises NoDaemon."""
        if self._scene is None:
            self._look()
        assert self._scene is not None
        answer = self.page.client.call("/slidectl/scene", {"contacts": self._shown[CONTACTS]})
        before = self._scene.poses
        if not self._scene.place(answer):
            self._look()
            return
        with self.page.server.atomic():
            for link, frame in self._links.items():
                place, turn = pose = self._scene.poses[link]
                if before.get(link) != pose:
                    frame.position = place
                    frame.wxyz = (turn[3], *turn[:3])
            self._draw_contacts(answer)
            self.sensors.update(self._scene)
        here = self._scene.poses.get(self._traced, (None,))[0]
        if here is not None and (not self._trace or self._trace[-1] != here):
            self._trace.append(here)
            self._is_trace_new = True
        now = time.monotonic()
        if now >= self._extras_due:
            self._extras_due = now + _EXTRAS_S
            self._draw_trace()
            self._ghost.update(self._scene)
            if self._shown[FRAMES]:
                self._labels.update(self._scene, self.quality.pixel_ratio)
            for link in list(self._held):
                self._push(link)

    def _look(self) -> None:
        """Rebuild the robots in the view. Raises NoDaemon."""
        self._remove_robots()
        scene = self._scene = DrawnScene(
            self.page.client.call("/slidectl/scene", {"descriptions": True}), self._collisions
        )
        server = self.page.server
        for notice in scene.notices:
            if notice not in self._told:
                self._told.add(notice)
                self.page.tell("warning", f"drawn otherwise\n{notice}")
        with server.atomic():
            for link, (place, turn) in scene.poses.items():
                self._links[link] = server.scene.add_frame(
                    _path(link), show_axes=False, position=place, wxyz=(turn[3], *turn[:3])
                )
            for number, surface in enumerate(scene.surfaces):
                mesh = server.scene.add_mesh_simple(
                    f"{_path(surface.link)}/surface{number}", surface.vertices, surface.faces.astype(np.uint32),
                    color=np.array(surface.colour[:3]), flat_shading=True,
                    opacity=None if surface.colour[3] >= 1.0 else surface.colour[3], side="double",
                )  # fmt: skip
                if not self.page.read_only:
                    self._pushable(mesh, surface.link)
            for name, robot in scene.robots.items():
                self._add_extras(name, robot, 2 * scene.bounds(name)[1])
        self.sensors.robots_changed()
        self._ground.visible = scene.ground
        if self._traced and self._traced not in scene.poses:
            self._choose_traced("")
        if self._placed_name not in scene.robots:
            self._place("")
        if not self._is_looked_at and scene.surfaces:
            self._is_looked_at = True
            self._aim("iso", "")

    def _add_extras(self, name: str, robot: Robot, size: float) -> None:
        """Add frames, joint axes and centres of mass of a robot of `size` m."""
        scene, length = self.page.server.scene, 0.08 * size
        for link in robot.links.values():
            path = _path(f"{name}::{link.name}")
            if f"{name}::{link.name}" not in self._links:
                continue
            axes = scene.add_frame(f"{path}/frame", axes_length=length, axes_radius=0.06 * length)
            self._extra[FRAMES].append(axes)
            if link.inertial is not None:
                ball = scene.add_icosphere(
                    f"{path}/mass", 0.2 * length, color=_YELLOW, position=link.inertial.origin.xyz
                )
                self._extra[MASSES].append(ball)
        for joint in robot.joints.values():
            if joint.type in MOVING:
                axis = np.array([[[0.0, 0.0, 0.0], np.array(joint.axis) * 2 * length]])
                arrow = scene.add_arrows(
                    f"{_path(f'{name}::{joint.child}')}/axis", axis, _BLUE,
                    shaft_radius=0.06 * length, head_radius=0.15 * length, head_length=0.4 * length,
                )  # fmt: skip
                self._extra[AXES].append(arrow)
        for what, nodes in self._extra.items():
            for node in nodes:
                node.visible = self._shown[what]

    def _draw_contacts(self, answer: SceneResponseMsg) -> None:
        if not self._shown[CONTACTS]:
            return
        scene, points = self.page.server.scene, _vectors(answer["contact_points"])
        forces = _vectors(answer["contact_forces"])
        if not len(points):
            scene.remove_by_name("/contacts")
            return
        largest = float(np.linalg.norm(forces, axis=1).max())
        length = self._scene.bounds()[1] / 2 if self._scene else 1.0
        ends = points + forces * (length / largest if largest > 0 else 0.0)
        scene.add_arrows(
            "/contacts", np.stack((points, ends), axis=1), _RED,
            shaft_radius=0.02 * length, head_radius=0.06 * length, head_length=0.15 * length,
        )  # fmt: skip

    def _draw_trace(self) -> None:
        if self._is_trace_new and len(self._trace) > 1:
            self._is_trace_new = False
            points = np.array(self._trace)
            self.page.server.scene.add_line_segments(
                "/trace", np.stack((points[:-1], points[1:]), axis=1), _GREEN, thickness=2.0, thickness_units="screen"
            )

    # --- the mouse ------------------------------------------------------------------------------------------------

    def _pushable(self, mesh: Any, link: str) -> None:
        async def dragged(event: Any) -> None:  # async: keeps the order of events
            start, end = event.start_position, event.end_position
            if event.phase == "end":
                self.page.do(lambda: self._release(link), ("push", link))
            else:
                self.page.do(lambda: self._hold(link, start, end), ("push", link))

        mesh.on_drag("left", modifier="shift")(dragged)

    def _hold(self, link: str, start: Vector, end: Vector) -> None:
        """Start or move a push: it acts on the grasped point at each refresh until released."""
        if self._scene is None or link not in self._scene.poses:  # its robot was just deleted
            return
        radius = self._scene.bounds()[1]
        way = np.array(end) - start
        length = float(np.linalg.norm(way))
        if length > _LONGEST_PUSH * radius:  # a browser may send any numbers
            way *= _LONGEST_PUSH * radius / length
        taken_at = relative((start, IDENTITY), self._scene.poses[link])[0]
        self._held[link] = taken_at, np.array(start) + way

    def _push(self, link: str) -> None:
        """Apply a spring force from the grasped point towards the mouse, for a short time."""
        if self._scene is None or link not in self._scene.poses:
            del self._held[link]
            self.page.server.scene.remove_by_name("/push")
            return
        taken_at, end = self._held[link]
        pose = self._scene.poses[link]
        start = np.array(compose(pose, (taken_at, IDENTITY))[0])
        robot = self._scene.robots[link.partition("::")[0]]
        mass = sum(one.inertial.mass for one in robot.links.values() if one.inertial is not None) or 1.0
        speed = self.page.client.call("/slidectl/status")["speed_reached"]
        lasting = divmod(round(_PUSH_S * max(1.0, speed) * 1e9), 10**9)  # simulated
        force = rotate(conjugate(pose[1]), tuple((_STIFFNESS * mass * (end - start)).tolist()))
        self.page.call("/gazebo/clear_body_wrenches", {"body_name": link})
        request = {
            "body_name": link, "reference_frame": link, "reference_point": dict(zip("xyz", taken_at, strict=True)),
            "wrench": {"force": dict(zip("xyz", force, strict=True))},
            "duration": dict(zip(("secs", "nsecs"), lasting, strict=True)),
        }  # fmt: skip
        self.page.call("/gazebo/apply_body_wrench", request)
        line = np.array([[start, end]])
        self.page.server.scene.add_line_segments("/push", line, _RED, thickness=3.0, thickness_units="screen")

    def _release(self, link: str) -> None:
        self._held.pop(link, None)
        self.page.server.scene.remove_by_name("/push")
        self.page.call("/gazebo/clear_body_wrenches", {"body_name": link})

    def choose_placed(self, request: dict[str, Any]) -> None:
        """Show the handles that move the free `robot`; none with an empty name. Raises UnknownName."""
        name = str(request["robot"])
        if name and (self._scene is None or name not in self._scene.robots):
            raise UnknownName("robot", name, list(self._scene.robots) if self._scene else [])
        self._place(name)

    def _place(self, name: str) -> None:
        if self._placed is not None:
            self._placed.remove()
            self._placed = None
        self._placed_name = name
        if self._scene is None or not name:
            return
        robot = self._scene.robots[name]
        place, turn = self._scene.poses[f"{name}::{robot.root}"]
        handles = self._placed = self.page.server.scene.add_transform_controls(
            "/place", scale=self._scene.bounds(name)[1], position=place, wxyz=(turn[3], *turn[:3])
        )

        async def moved(_: Any) -> None:
            w, x, y, z = map(float, handles.wxyz)
            position = dict(zip("xyz", map(float, handles.position), strict=True))
            pose = {"position": position, "orientation": {"x": x, "y": y, "z": z, "w": w}}
            state = {"model_name": name, "pose": pose, "reference_frame": "world"}
            self.page.do(lambda: self.page.call("/gazebo/set_model_state", {"model_state": state}), ("place", name))

        handles.on_update(moved)


def _path(link: str) -> str:
    """The name of a link's node in viser's scene tree."""
    robot, _, name = link.partition("::")
    return f"/robots/{robot.replace('/', '_')}/{name.replace('/', '_')}"


def _vectors(messages: list[PointMsg] | list[Vector3Msg]) -> Array:
    return np.array([[one["x"], one["y"], one["z"]] for one in messages]).reshape(-1, 3)
