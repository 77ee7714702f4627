"""The goal of a trajectory as a translucent ghost: the links that it moves, where they will be."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from slidectl.description.robot import MOVING, Joint, Robot
from slidectl.errors import Refused, UnknownName
from slidectl.extensions.viewing.drawn_scene import DrawnScene
from slidectl.rotations import Pose, compose, relative

if TYPE_CHECKING:
    from slidectl.extensions.viewing.page.page import Page

_PATH = "/ghost"
_COLOUR = (60, 125, 245)
_OPACITY = 0.4
_LASTS_S = 3.0
"""Wall seconds after which the ghost goes unless it is shown again: the browser may have ended."""
_AT_GOAL_M = 1e-3
"""A link that is so near to its goal has no ghost: their surfaces would flicker."""


class GoalGhost:
    """One ghost, of the robot whose goal was edited last. All browsers see it."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._robot = ""
        self._positions: dict[str, float] = {}
        self._ends = 0.0
        self._drawn_of: tuple[DrawnScene, str, frozenset[str]] | None = None
        self._links: dict[str, Any] = {}
        """Link -> its frame in viser."""
        self._joints: list[Joint] = []
        """The joints that move a link of the ghost, parents first."""

    def show(self, request: dict[str, Any], scene: DrawnScene | None) -> None:
        """Show the ghost of a `robot` at `positions` of joints (m or rad), for 3 s; of none with an empty name.

        Raises:
            UnknownName: no such robot or joint. Refused: a position that is not finite.
        """
        name = str(request["robot"])
        positions = {str(joint): float(value) for joint, value in request.get("positions", {}).items()}
        if name and (scene is None or name not in scene.robots):
            raise UnknownName("robot", name, list(scene.robots) if scene else [])
        if scene is not None and name:
            moving = [joint.name for joint in scene.robots[name].joints.values() if joint.type in MOVING]
            for joint, value in positions.items():
                if joint not in moving:
                    raise UnknownName("joint", joint, moving)
                if not math.isfinite(value):
                    raise Refused(f"the goal of {joint} is not a finite number")
        self._robot, self._positions, self._ends = name, positions, time.monotonic() + _LASTS_S

    def leave(self) -> None:
        """Remove the ghost."""
        self._robot = ""
        if self._drawn_of is not None:
            self._drawn_of = None
            self._links.clear()
            self._page.server.scene.remove_by_name(_PATH)

    def update(self, scene: DrawnScene) -> None:
        """Draw the ghost where the goal is as seen from where the robot is now."""
        if self._robot not in scene.robots or time.monotonic() > self._ends:
            self.leave()
            return
        what = (scene, self._robot, frozenset(self._positions))
        if what != self._drawn_of:
            self._draw(scene)
            self._drawn_of = what
        poses: dict[str, Pose] = {}

        def present(link: str) -> Pose:
            return scene.poses[f"{self._robot}::{link}"]

        for joint in self._joints:
            position = self._positions.get(joint.name)
            if position is None and joint.mimic is not None and joint.mimic.joint in self._positions:
                position = joint.mimic.multiplier * self._positions[joint.mimic.joint] + joint.mimic.offset
            here = (
                relative(present(joint.child), present(joint.parent))
                if position is None
                else joint.child_pose(position)
            )
            poses[joint.child] = compose(poses.get(joint.parent) or present(joint.parent), here)
        with self._page.server.atomic():
            for link, frame in self._links.items():
                (place, turn), (now, turned) = poses[link], present(link)
                cosine = abs(sum(a * b for a, b in zip(turn, turned, strict=True)))
                frame.position, frame.wxyz = place, (turn[3], *turn[:3])
                frame.visible = math.dist(place, now) > _AT_GOAL_M or cosine < 1.0 - 1e-6

    def _draw(self, scene: DrawnScene) -> None:
        """Make the links that are below a joint of the goal."""
        api = self._page.server.scene
        api.remove_by_name(_PATH)
        self._joints = _moved_joints(scene.robots[self._robot], set(self._positions))
        moved = {f"{self._robot}::{joint.child}": joint.child for joint in self._joints}
        self._links = {}
        with self._page.server.atomic():
            for number, surface in enumerate(scene.surfaces):
                link = moved.get(surface.link)
                if link is None:
                    continue
                path = f"{_PATH}/{link.replace('/', '_')}"
                if link not in self._links:
                    self._links[link] = api.add_frame(path, show_axes=False)
                api.add_mesh_simple(
                    f"{path}/surface{number}", surface.vertices, surface.faces.astype(np.uint32), color=_COLOUR,
                    opacity=_OPACITY, flat_shading=True, side="double", cast_shadow=False, receive_shadow=False,
                )  # fmt: skip


def _moved_joints(robot: Robot, goal: set[str]) -> list[Joint]:
    """The joints of the goal, and those below them, parents first."""
    children = defaultdict(list)
    for joint in robot.joints.values():
        children[joint.parent].append(joint)
    found, waiting = [], [(joint, False) for joint in children[robot.root]]
    for joint, is_below in waiting:  # grows meanwhile
        is_moved = is_below or joint.name in goal or (joint.mimic is not None and joint.mimic.joint in goal)
        if is_moved:
            found.append(joint)
        waiting += [(child, is_moved) for child in children[joint.child]]
    return found
