"""What in a robot looks like a slip of its author, though it can be simulated: one line each, for `spawn` and `check`.

Nothing is refused for it: a robot may be meant so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from slidectl.description.robot import MOVING, Box, Cylinder, Geometry, Joint, Robot, Sphere

LARGEST_M = 10.0
"""The largest size of a robot's part that is not taken for millimetres, m."""
PLUGIN = "libgazebo_ros_control.so"


def of_robot(robot: Robot) -> Iterator[str]:
    """The slips of a robot. A model without moving joints, as a room, has none."""
    if not any(joint.type in MOVING for joint in robot.joints.values()):
        return
    for joint in robot.joints.values():
        if (text := degrees(joint)) is not None:
            yield f"{joint.file}:{joint.line}: joint {joint.name!r}: {text}"
    if (text := millimetres(robot)) is not None:
        yield text
    if robot.plugin is None and robot.transmissions:
        yield (
            f"robot {robot.name!r} has transmissions but no {PLUGIN}; here it is driven all the same, Gazebo would "
            f'load no controller manager: <gazebo><plugin name="control" filename="{PLUGIN}"/></gazebo>'
        )


def degrees(joint: Joint) -> str | None:
    """A revolute joint's limits, if they look like degrees: multiples of 5, one of 15 or more, none above 720."""
    if joint.type != "revolute" or joint.limit is None:
        return None
    bounds = (abs(joint.limit.lower), abs(joint.limit.upper))
    if not all(bound % 5 == 0 and bound <= 720 for bound in bounds) or max(bounds) < 15:
        return None
    turns = (joint.limit.upper - joint.limit.lower) / math.tau
    return f"its limits are {turns:.3g} turns apart; angles are in rad: 90 degrees are 1.5708"


def millimetres(robot: Robot) -> str | None:
    """A robot with a part, or a joint away from its parent, of more than LARGEST_M."""
    for link in robot.links.values():
        for shape in (*link.collisions, *link.visuals):
            if (size := _size(shape.geometry)) > LARGEST_M:
                return f"{link.file}:{link.line}: link {link.name!r} is {_metres(size)}"
    for joint in robot.joints.values():
        if (size := max(map(abs, joint.origin.xyz))) > LARGEST_M:
            return f"{joint.file}:{joint.line}: joint {joint.name!r} is {_metres(size)} away from its parent"
    return None


def _metres(size: float) -> str:
    return f"{size:g} m: lengths are in m, {size:g} mm are {size / 1000:g}"


def _size(geometry: Geometry) -> float:
    """The largest extent, m; 0 for a mesh, whose file is not read here."""
    if isinstance(geometry, Box):
        return max(geometry.size)
    if isinstance(geometry, Cylinder):
        return max(2.0 * geometry.radius, geometry.length)
    return 2.0 * geometry.radius if isinstance(geometry, Sphere) else 0.0
