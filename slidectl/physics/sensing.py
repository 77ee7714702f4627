"""Measurements of sensors in the present world: ray distances, motion, contacts, forces in joints, bounding boxes.

It changes nothing on which the next step depends. Vectors are in the world's axes, those of a sensor in its own; SI
units. Noise depends only on the names of robot and sensor and the time, so it is the same in every run.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from slidectl.control.hardware_interface import ForceTorqueData, ImuData
from slidectl.description.sensors import ForceTorque, Imu, Sensor
from slidectl.physics.collisions import link_of
from slidectl.rotations import (
    ORIGIN,
    Pose,
    Quaternion,
    Vector,
    add,
    compose,
    conjugate,
    cross,
    from_rpy,
    multiply,
    rotate,
    subtract,
)

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
    """Unit vector into the link."""
    force: Vector
    """Force on the link, N."""
    depth: float
    """Penetration depth, m."""


GROUND = "ground_plane::link"


def distances(world: World, pose: Pose, directions: Array, nearest: float, farthest: float) -> Array:
    """The distance to the first shape along each ray, m, shape (n,); `inf` when there is none up to `farthest`.

    Args:
        pose: pose of the sensor in the world.
        directions: unit vectors in the sensor's frame, shape (n, 3).
        nearest: m. As in Gazebo, rays begin at this distance, and nearer shapes are not seen.
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


def boxes(world: World, robot: str, frame: Pose) -> Array:
    """The lowest and the highest corner of the bounding box of each collision shape, in `frame`, m. Shape (n, 2, 3).

    The box of a rotated shape bounds the shape's own box. Raises UnknownName.
    """
    model, data = world.model, world.present()
    geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == world.robot(robot).root_id)
    centres, halves = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([frame[1][3], *frame[1][:3]]))
    axes = turn.reshape(3, 3).T @ data.geom_xmat[geoms].reshape(-1, 3, 3)
    places = (data.geom_xpos[geoms] - np.array(frame[0])) @ turn.reshape(3, 3)
    middles = places + np.einsum("nij,nj->ni", axes, centres)
    is_ball = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_SPHERE
    reach = np.where(is_ball[:, None], halves, np.einsum("nij,nj->ni", np.abs(axes), halves))
    return np.stack([middles - reach, middles + reach], axis=1)


def link_acceleration(world: World, robot: str, link: str) -> tuple[Vector, Vector]:
    """Linear (of the frame's origin) and angular acceleration of a link in the last step, in the world's axes.

    Raises UnknownName.
    """
    felt, turning, _ = _accelerations(world, robot, link, ORIGIN)
    return add(felt, world.gravity), turning


def _accelerations(world: World, robot: str, link: str, origin: Pose) -> tuple[Vector, Vector, Quaternion]:
    """Accelerations at `origin` in the link's frame in the last step. Raises UnknownName.

    Returns the linear acceleration as an accelerometer measures it, with the reaction to gravity; the angular
    acceleration; the sensor's attitude at that time. The first two are in the world's axes.
    """
    model, data, place = world.model, world.data, world.robot(robot).link(link)
    world.compute_body_forces()
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
    return felt, (ax, ay, az), attitude


def sensor_pose(world: World, robot: str, sensor: Sensor) -> Pose:
    """The pose of a sensor in the world. Raises UnknownName."""
    return compose(world.link_pose(robot, sensor.link), _origin(sensor))


def sensor_twist(world: World, robot: str, sensor: Sensor) -> tuple[Vector, Vector]:
    """Linear and angular velocity of the sensor's origin. Raises UnknownName."""
    linear, angular = world.link_twist(robot, sensor.link)
    arm = subtract(sensor_pose(world, robot, sensor)[0], world.link_pose(robot, sensor.link)[0])
    return add(linear, cross(angular, arm)), angular


def _origin(sensor: Sensor) -> Pose:
    return sensor.origin.xyz, from_rpy(sensor.origin.rpy)


def draws(robot: str, sensor: Sensor, time_ns: int) -> Callable[[], float]:
    """A function that draws the sensor's noise at that time, in the unit of the measurement."""
    if sensor.noise <= 0.0 and sensor.mean == 0.0:
        return lambda: 0.0
    source = random.Random(f"{robot}/{sensor.name}/{time_ns}")
    return lambda: source.gauss(sensor.mean, max(0.0, sensor.noise))


def noisy(vector: Vector, draw: Callable[[], float]) -> Vector:
    """The vector with noise on each component."""
    return (vector[0] + draw(), vector[1] + draw(), vector[2] + draw())


def imu(world: World, robot: str, sensor: Imu, time_ns: int) -> ImuData:
    """The measurement of an IMU. Raises UnknownName."""
    attitude = sensor_pose(world, robot, sensor)[1]
    draw = draws(robot, sensor, time_ns)
    felt, _, then = _accelerations(world, robot, sensor.link, _origin(sensor))
    if not sensor.feels_gravity:
        felt = add(felt, world.gravity)
    turning = sensor_twist(world, robot, sensor)[1]
    variance = sensor.noise**2
    covariance = (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance)
    return ImuData(
        attitude,
        covariance,
        noisy(rotate(conjugate(attitude), turning), draw),
        covariance,
        noisy(rotate(conjugate(then), felt), draw),
        covariance,
    )


def force_torque(world: World, robot: str, sensor: ForceTorque, time_ns: int) -> ForceTorqueData:
    """The force, and the torque about the joint, that a joint transmitted in the last step. Raises UnknownName.

    As in Gazebo, this is the wrench of the child link on the joint, or the opposite, by the sensor's direction.
    """
    model, data, body = world.model, world.data, world.robot(robot).link(sensor.link).body
    world.compute_body_forces()
    anchor = data.xpos[body]
    # The wrench of the parent on the child, about the centre of mass of the whole robot.
    torque, force = data.cfrc_int[body, :3].copy(), data.cfrc_int[body, 3:].copy()
    torque += np.cross(data.subtree_com[model.body_rootid[body]] - anchor, force)
    # Subtract the external wrenches and the gravity compensation of the bodies below, which MuJoCo does not include.
    outside = world.applied_forces.wrenches_of_step(data)
    for below in _subtree(model, body):
        push, turn = -model.body_gravcomp[below] * model.body_mass[below] * model.opt.gravity, np.zeros(3)
        if outside is not None:
            push, turn = push + outside[below, :3], outside[below, 3:]
        force -= push
        torque -= turn + np.cross(data.xipos[below] - anchor, push)
    link = world.robot(robot).description.joints[sensor.joint].parent if sensor.in_parent else sensor.link
    place = world.robot(robot).link(link)
    w, x, y, z = data.xquat[place.body].tolist()
    back = conjugate(multiply((x, y, z, w), place.frame[1]))
    sign, draw = 1.0 if sensor.on_child else -1.0, draws(robot, sensor, time_ns)
    return ForceTorqueData(
        noisy(rotate(back, _vector(sign * force)), draw), noisy(rotate(back, _vector(sign * torque)), draw)
    )


def _subtree(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """A body and its descendants, which MuJoCo numbers consecutively."""
    yield body
    for below in range(body + 1, model.nbody):
        if model.body_parentid[below] < body:
            return
        yield below


def touches(world: World, robot: str, link: str) -> list[Touch]:
    """The contacts of a link with other robots, its own robot and the ground in the last step. Raises UnknownName."""
    model, data, body = world.model, world.data, world.robot(robot)
    body.link(link)
    robots = {world.robot(name).root_id: name for name in world.names()}
    found: list[Touch] = []
    wrench = np.zeros(6)
    for index in range(data.ncon):
        contact = data.contact[index]
        names = []
        for geom in contact.geom.tolist():
            other = robots.get(int(model.body_rootid[model.geom_bodyid[geom]]))
            names.append(GROUND if other is None else f"{other}::{link_of(model, geom, other)}")
        for own in (0, 1):
            if names[own] != f"{robot}::{link}":
                continue
            mujoco.mj_contactForce(model, data, index, wrench)
            axes = contact.frame.reshape(3, 3)
            # The frame's first axis points from the first geom to the second, and the force acts on the second.
            sign = -1.0 if own == 0 else 1.0
            force = sign * (wrench[:3] @ axes)
            position, normal = _vector(contact.pos), _vector(sign * axes[0])
            found.append(
                Touch(names[own], names[1 - own], position, normal, _vector(force), max(0.0, -float(contact.dist)))
            )
    return found


def contacts(world: World) -> Iterator[tuple[Vector, Vector]]:
    """The contact points of the last step, m, and the forces there, N, in the world's axes.

    The force is that of the ground on a robot, or that on the second geom.
    """
    model, data = world.model, world.data
    wrench = np.zeros(6)
    for index in range(data.ncon):
        contact = data.contact[index]
        mujoco.mj_contactForce(model, data, index, wrench)
        sign = -1.0 if model.geom_bodyid[contact.geom[1]] == 0 else 1.0
        yield _vector(contact.pos), _vector(sign * (wrench[:3] @ contact.frame.reshape(3, 3)))


def _vector(array: Array) -> Vector:
    x, y, z = array.tolist()
    return x, y, z
