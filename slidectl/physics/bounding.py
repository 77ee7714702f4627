"""Boxes around the collision shapes of robots, as they are now. It looks and changes nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from slidectl.rotations import Pose

if TYPE_CHECKING:
    from slidectl.physics.world import World

Array = npt.NDArray[np.float64]


def boxes(world: World, robot: str, frame: Pose) -> Array:
    """The lowest and the highest corner of the box around each collision shape, in `frame`. Shape (n, 2, 3).

    The box of a shape that is turned is the box around its own box. Raises UnknownName.
    """
    model, data = world.model, world.present()
    geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == world.body(robot).root_id)
    centres, halves = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([frame[1][3], *frame[1][:3]]))
    axes = turn.reshape(3, 3).T @ data.geom_xmat[geoms].reshape(-1, 3, 3)
    places = (data.geom_xpos[geoms] - np.array(frame[0])) @ turn.reshape(3, 3)
    middles = places + np.einsum("nij,nj->ni", axes, centres)
    is_ball = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_SPHERE
    reach = np.where(is_ball[:, None], halves, np.einsum("nij,nj->ni", np.abs(axes), halves))
    return np.stack([middles - reach, middles + reach], axis=1)
