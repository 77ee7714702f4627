"""What sensors on links measure in the present world: distances along rays, accelerations, contacts.

It looks and changes nothing that the next step depends on. Vectors are in the world's axes; SI units.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from slidectl.physics.touching import link_of
from slidectl.rotations import Pose, Quaternion, Vector, add, compose, cross, multiply, rotate

if TYPE_CHECKING:
    from slidectl.physics.world import World

Array = npt.NDArray[np.float64]


class Touch(NamedTuple):
    """One contact point of a link."""

    own: str
    """The link."""
    other: str
    """`ROBOT::LINK`, or the ground's name."""
    position: Vector
    normal: Vector
    """Into the link."""
    force: Vector
    """On the link, N."""
    depth: float
    """m."""


GROUND = "ground_plane::link"


def distances(world: World, pose: Pose, directions: Array, nearest: float, farthest: float) -> Array:
    """How far it is to the first thing along each ray, m; `inf` where nothing is nearer than `farthest`.

    Args:
        pose: of the sensor in the world.
        directions: unit vectors in the sensor's frame, shape (n, 3).
        nearest: m. Rays begin there, as Gazebo's do: what is nearer is not seen.
    """
    model, data = world.model, world.present()
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([pose[1][3], *pose[1][:3]]))
    rays = directions @ turn.reshape(3, 3).T
    count = len(rays)
    geoms, found = np.zeros(count, dtype=np.int32), np.zeros(count)
    centre = np.array(pose[0])
    mujoco.mj_multiRay(model, data, centre, rays.ravel(), None, True, -1, geoms, found, None, count, farthest)
    found[(found < 0) | (found > farthest)] = math.inf
    one = np.zeros(1, dtype=np.int32)
    for index in np.flatnonzero(found < nearest):
        start = centre + nearest * rays[index]
        rest = mujoco.mj_ray(model, data, start, rays[index], None, True, -1, one)
        found[index] = nearest + rest if 0 <= rest <= farthest - nearest else math.inf
    return found


def acceleration(world: World, robot: str, link: str, origin: Pose) -> tuple[Vector, Quaternion]:
    """What an accelerometer at `origin` in the link's frame felt in the last step, the reaction to gravity included.

    Returns:
        The acceleration in the world's axes, and the sensor's attitude at that time.

    Raises:
        UnknownName.
    """
    model, data, place = world.model, world.data, world.body(robot).link(link)
    mujoco.mj_rnePostConstraint(model, data)  # writes accelerations and forces between bodies only
    found, moving, kind = np.zeros(6), np.zeros(6), mujoco.mjtObj.mjOBJ_XBODY
    mujoco.mj_objectAcceleration(model, data, kind, place.body, found, 0)
    mujoco.mj_objectVelocity(model, data, kind, place.body, moving, 0)
    ax, ay, az, lx, ly, lz = found.tolist()
    wx, wy, wz = moving[:3].tolist()
    w, x, y, z = data.xquat[place.body].tolist()
    at, turn = compose(place.frame, origin)
    arm, attitude = rotate((x, y, z, w), at), multiply((x, y, z, w), turn)
    spin = (wx, wy, wz)
    felt = add((lx, ly, lz), add(cross((ax, ay, az), arm), cross(spin, cross(spin, arm))))
    return felt, attitude


def sensor_pose(world: World, robot: str, link: str, origin: Pose) -> Pose:
    """Where a sensor is in the world that is at `origin` in a link's frame. Raises UnknownName."""
    return compose(world.link_pose(robot, link), origin)


def touches(world: World, robot: str, link: str) -> list[Touch]:
    """The contacts of a link with other robots, its own robot and the ground in the last step. Raises UnknownName."""
    model, data, body = world.model, world.data, world.body(robot)
    body.link(link)
    robots = {world.body(name).root_id: name for name in world.names()}
    found: list[Touch] = []
    wrench = np.zeros(6)
    for index in range(data.ncon):
        contact = data.contact[index]
        names = [_touching(model, int(geom), robots) for geom in contact.geom]
        for own in (0, 1):
            if names[own] != f"{robot}::{link}":
                continue
            mujoco.mj_contactForce(model, data, index, wrench)
            axes = contact.frame.reshape(3, 3)
            # The frame's first axis goes from the first geom to the second, and the force is on the second.
            sign = -1.0 if own == 0 else 1.0
            force = sign * (wrench[:3] @ axes)
            position, normal = _vector(contact.pos), _vector(sign * axes[0])
            found.append(
                Touch(names[own], names[1 - own], position, normal, _vector(force), max(0.0, -float(contact.dist)))
            )
    return found


def _vector(array: Array) -> Vector:
    x, y, z = array.tolist()
    return x, y, z


def _touching(model: mujoco.MjModel, geom: int, robots: dict[int, str]) -> str:
    robot = robots.get(int(model.body_rootid[model.geom_bodyid[geom]]))
    return GROUND if robot is None else f"{robot}::{link_of(model, geom, robot)}"
