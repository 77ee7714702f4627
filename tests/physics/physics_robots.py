"""Robots on paper for the physics tests, and how to read their state from a world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from slidectl.description.robot import (
    Box,
    Inertial,
    Joint,
    Limit,
    Link,
    Pose,
    Robot,
    Shape,
    Surface,
    TransmissionActuator,
    TransmissionInfo,
    TransmissionJoint,
    Vector,
)
from slidectl.physics import World

AT_ORIGIN = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
EFFORT = "hardware_interface/EffortJointInterface"
POSITION = "hardware_interface/PositionJointInterface"
VELOCITY = "hardware_interface/VelocityJointInterface"


def at(x: float, y: float, z: float) -> tuple[Vector, tuple[float, float, float, float]]:
    """A pose without rotation."""
    return ((x, y, z), (0.0, 0.0, 0.0, 1.0))


def box_inertial(mass: float, size: Vector, origin: Pose = Pose()) -> Inertial:  # noqa: B008 - frozen
    """A solid box."""
    x, y, z = (edge * edge for edge in size)
    return Inertial(origin, mass, (mass * (y + z) / 12, 0.0, 0.0, mass * (x + z) / 12, 0.0, mass * (x + y) / 12))


def box_shape(size: Vector, origin: Pose = Pose()) -> Shape:  # noqa: B008 - frozen
    """A collision box."""
    return Shape(Box(size), origin)


def block(size: Vector = (0.2, 0.3, 0.4), mass: float = 1.0, surface: Surface = Surface()) -> Robot:  # noqa: B008
    """One free link."""
    link = Link("base", box_inertial(mass, size), collisions=(box_shape(size),), surface=surface)
    return Robot("block", {"base": link}, {}, "base")


def tree(links: Iterable[Link], joints: Iterable[Joint], root: str = "world") -> Robot:
    """A robot of these parts; the link `world` is added when it is the root and missing."""
    known = {link.name: link for link in links}
    if root == "world":
        known = {"world": Link("world"), **known}
    return Robot("robot", known, {joint.name: joint for joint in joints}, root)


def one_joint(
    kind: str = "prismatic",
    axis: Vector = (0.0, 0.0, 1.0),
    limit: Limit | None = None,
    mass: float = 1.0,
    inertial: Inertial | None = None,
    **more: object,
) -> Robot:
    """A link `cart` on the joint `joint1` of a root that is fixed; no collision shapes."""
    if limit is None and kind in ("prismatic", "revolute"):
        limit = Limit(-5.0, 5.0, 100.0, 100.0)
    joint = Joint("joint1", kind, "world", "cart", axis=axis, limit=limit, **more)  # type: ignore[arg-type]
    return tree([Link("cart", inertial or box_inertial(mass, (0.1, 0.1, 0.1)))], [joint])


def arm(
    joints: int = 3, *, free: bool = False, damping: float = 0.1, friction: float = 0.0, reach: float | None = None
) -> Robot:
    """A chain of boxes with skew axes that touches the ground when it falls; `reach` limits its angles."""
    root = "base" if free else "world"
    links = [Link("base", box_inertial(1.0, (0.3, 0.3, 0.1)), collisions=(box_shape((0.3, 0.3, 0.1)),))] if free else []
    made, parent = [], root
    for i in range(joints):
        inertial = Inertial(
            Pose((0.0, 0.0, 0.2), (0.1, 0.2, 0.3)), 1.0 + 0.3 * i, (0.02, 0.001, 0.0, 0.03, 0.002, 0.02)
        )
        shape = box_shape((0.05, 0.05, 0.4), Pose((0.0, 0.0, 0.2)))
        links.append(Link(f"link{i}", inertial, collisions=(shape,), surface=Surface(mu1=0.8)))
        origin = Pose((0.0, 0.06, 0.4 if i else 0.1 if free else 1.0), (0.0, 0.0, 0.3 * i))
        axis = (0.0, 1.0, 0.0) if i % 2 == 0 else (1.0, 0.0, 0.0)
        limit = Limit(-reach, reach, 2.0, 10.0) if reach else None
        kind = "revolute" if reach else "continuous"
        made.append(Joint(f"joint{i}", kind, parent, f"link{i}", origin, axis, limit, damping, friction))
        parent = f"link{i}"
    return tree(links, made, root)


def driven(robot: Robot, interfaces: Mapping[str, str] | str) -> Robot:
    """The robot with a transmission for each joint: all by one interface, or by those of a mapping."""
    if isinstance(interfaces, str):
        interfaces = dict.fromkeys(robot.joints, interfaces)
    return replace(robot, transmissions=tuple(transmission(joint, by) for joint, by in interfaces.items()))


def transmission(joint: str, *interfaces: str) -> TransmissionInfo:
    """A SimpleTransmission of one joint."""
    kind = "transmission_interface/SimpleTransmission"
    return TransmissionInfo(
        f"tran_{joint}", kind, (TransmissionJoint(joint, interfaces),), (TransmissionActuator("m"),)
    )


def state_of(world: World, name: str) -> bytes:
    """Positions and velocities of one robot, to the bit."""
    body = world.robot(name)
    return bytes(world.data.qpos[body.coordinates].tobytes() + world.data.qvel[body.dofs].tobytes())


def deviation(world: World, other: World, name: str) -> float:
    """The largest difference between a robot's state here and there."""
    here, there = world.robot(name), other.robot(name)
    positions = abs(world.data.qpos[here.coordinates] - other.data.qpos[there.coordinates])
    velocities = abs(world.data.qvel[here.dofs] - other.data.qvel[there.dofs])
    return float(max(positions.max(), velocities.max()))
