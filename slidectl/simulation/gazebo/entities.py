"""Names of Gazebo's entities: models, links as `model::link`, joints as `model::joint`, and frames of reference.

A link or joint may be named without its model as long as only one robot has it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from slidectl.errors import AmbiguousName, UnknownName
from slidectl.physics.observer import Twist
from slidectl.physics.rotation import ORIGIN, Pose

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

WORLD_FRAMES = ("", "world", "map", "/map", "/world")
STILL: Twist = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Frame:
    """Where something is and how it moves, in the world."""

    pose: Pose
    twist: Twist = STILL


WORLD = Frame(ORIGIN)


def find(simulation: Simulation, kind: Literal["link", "joint"], name: str) -> tuple[str, str]:
    """Robot and link (or joint) that `name` means.

    Raises:
        UnknownName: there is none. AmbiguousName: several robots have one of that name.
    """
    robots = {robot.name: robot.paper.links if kind == "link" else robot.paper.joints for robot in simulation.robots}
    known = [f"{robot}::{part}" for robot, parts in robots.items() for part in parts]
    model, separator, part = name.rpartition("::")
    matches = (
        [full for full in known if full == name]
        if separator
        else [full for full in known if full.endswith(f"::{part}")]
    )
    if not matches:
        raise UnknownName(kind, name, known)
    if len(matches) > 1:
        raise AmbiguousName(kind, name, matches)
    model, _, part = matches[0].partition("::")
    return model, part


def link_frame(simulation: Simulation, robot: str, link: str) -> Frame:
    """Pose and twist of a link's frame in the world."""
    world = simulation.world
    return Frame(world.link_pose(robot, link), world.link_twist(robot, link))


def model_frame(simulation: Simulation, robot: str) -> Frame:
    """Pose and twist of a robot: that of its root link. Raises UnknownName."""
    return link_frame(simulation, robot, simulation.robots.get(robot).paper.root)


def frame(simulation: Simulation, name: str) -> Frame:
    """A frame of reference: the world, a model, or a link. Raises UnknownName, AmbiguousName."""
    if name in WORLD_FRAMES:
        return WORLD
    if name in simulation.robots:
        return model_frame(simulation, name)
    return link_frame(simulation, *find(simulation, "link", name))
