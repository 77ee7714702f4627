"""Poses and twists of links, computed in a copy of the state.

It uses its own MjData, so that queries never change data on which the next step depends, such as warm starts. It
changes nothing in the world.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from slidectl.physics.attached_robot import LinkPlace
from slidectl.rotations import Pose, Vector, add, compose, cross, rotate, xyzw

Twist = tuple[Vector, Vector]
"""Linear (m/s) and angular (rad/s) velocity, in the world's axes."""


class Observer:
    """Kinematics of the present state, computed at the first query after a change."""

    def __init__(self, model: Any, data: Any) -> None:
        self._model = model
        self._data = data
        self._copy: Any = None
        self._twist = np.zeros(6)
        self.invalidate()

    def invalidate(self) -> None:
        """Discard the kinematics, because the state was changed by other means than a step."""
        self._poses_at = self._twists_at = float("nan")

    def pose(self, link: LinkPlace) -> Pose:
        """Pose of the link's frame in the world: position (m), attitude x y z w."""
        self._refresh_poses()
        return compose(self._body_pose(link.body), link.frame)

    def twist(self, link: LinkPlace) -> Twist:
        """Linear velocity of the origin of the link's frame and angular velocity, in the world's axes."""
        self._refresh_twists()
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self._model, self._copy, kind, link.body, self._twist, 0)
        wx, wy, wz, vx, vy, vz = self._twist.tolist()
        arm = rotate(self._body_pose(link.body)[1], link.frame[0])
        return add((vx, vy, vz), cross((wx, wy, wz), arm)), (wx, wy, wz)

    def geometry(self) -> Any:
        """The copy, with the present poses of bodies and geoms."""
        self._refresh_poses()
        return self._copy

    def _body_pose(self, body: int) -> Pose:
        x, y, z = self._copy.xpos[body].tolist()
        return (x, y, z), xyzw(tuple(self._copy.xquat[body].tolist()))

    def _refresh_poses(self) -> None:
        if self._poses_at == self._data.time:
            return
        if self._copy is None:
            self._copy = mujoco.MjData(self._model)
        self._copy.qpos[:] = self._data.qpos
        mujoco.mj_kinematics(self._model, self._copy)
        self._poses_at = self._data.time

    def _refresh_twists(self) -> None:
        self._refresh_poses()
        if self._twists_at == self._data.time:
            return
        self._copy.qvel[:] = self._data.qvel
        mujoco.mj_comPos(self._model, self._copy)
        mujoco.mj_comVel(self._model, self._copy)
        self._twists_at = self._data.time
