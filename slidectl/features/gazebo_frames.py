"""Conversion between geometry_msgs and plain tuples, and states seen from a moving frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.physics.world import Twist
from slidectl.rotations import (
    ORIGIN,
    Pose,
    Vector,
    add,
    compose,
    conjugate,
    cross,
    normalized,
    relative,
    rotate,
    subtract,
)
from slidectl.rotations import message as quaternion_message

if TYPE_CHECKING:
    from slidectl.msgs.typed import PointMsg

STILL: Twist = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Frame:
    """Pose and twist in the world."""

    pose: Pose
    twist: Twist = STILL


WORLD = Frame(ORIGIN)


def vector(message: Message) -> Vector:
    """Convert from geometry_msgs/Vector3 or Point."""
    return (message["x"], message["y"], message["z"])


def vector_message(values: Vector) -> PointMsg:
    """Convert to geometry_msgs/Vector3 or Point."""
    return {"x": values[0], "y": values[1], "z": values[2]}


def pose(message: Message) -> Pose:
    """Convert from geometry_msgs/Pose; an orientation of four zeros (left out) means no rotation."""
    turn = message["orientation"]
    return vector(message["position"]), normalized((turn["x"], turn["y"], turn["z"], turn["w"]))


def pose_message(values: Pose) -> Message:
    """Convert to geometry_msgs/Pose."""
    return {"position": vector_message(values[0]), "orientation": quaternion_message(values[1])}


def transform_message(values: Pose) -> Message:
    """Convert to geometry_msgs/Transform."""
    return {"translation": vector_message(values[0]), "rotation": quaternion_message(values[1])}


def twist(message: Message) -> Twist:
    """Convert from geometry_msgs/Twist."""
    return vector(message["linear"]), vector(message["angular"])


def twist_message(values: Twist) -> Message:
    """Convert to geometry_msgs/Twist."""
    return {"linear": vector_message(values[0]), "angular": vector_message(values[1])}


def seen_from(state: Frame, viewer: Frame) -> Frame:
    """Pose and twist of `state` relative to the (moving) frame `viewer`, in its axes."""
    back = conjugate(viewer.pose[1])
    arm = subtract(state.pose[0], viewer.pose[0])
    carried = add(viewer.twist[0], cross(viewer.twist[1], arm))
    linear = rotate(back, subtract(state.twist[0], carried))
    angular = rotate(back, subtract(state.twist[1], viewer.twist[1]))
    return Frame(relative(state.pose, viewer.pose), (linear, angular))


def into_world(local: Frame, viewer: Frame) -> Frame:
    """The inverse of `seen_from`: the pose and twist in the world of a state given in `viewer`."""
    place = compose(viewer.pose, local.pose)
    arm = subtract(place[0], viewer.pose[0])
    carried = add(viewer.twist[0], cross(viewer.twist[1], arm))
    linear = add(rotate(viewer.pose[1], local.twist[0]), carried)
    angular = add(rotate(viewer.pose[1], local.twist[1]), viewer.twist[1])
    return Frame(place, (linear, angular))
