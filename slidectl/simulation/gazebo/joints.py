"""`get_joint_properties`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.simulation.gazebo.answers import Answer, provide
from slidectl.simulation.gazebo.entities import find
from slidectl.simulation.graph import WORLD_NODE

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

# gazebo_msgs/GetJointProperties; Gazebo knows no floating joint, and a ball is the nearest; no planar one: a universal.
TYPES = {"revolute": 0, "continuous": 1, "prismatic": 2, "fixed": 3, "floating": 4, "planar": 5}


def advertise(simulation: Simulation) -> None:
    """Provide it."""
    node = simulation.graph.node(WORLD_NODE)
    provide(node, "get_joint_properties", "GetJointProperties", lambda request: _properties(simulation, request))


def _properties(simulation: Simulation, request: Message) -> Answer:
    robot, name = find(simulation, "joint", request["joint_name"])
    joint = simulation.robots.get(robot).paper.joints[name]
    fields: Message = {"type": TYPES[joint.type]}
    if name in simulation.world.body(robot).joints:
        position, velocity, _ = simulation.world.joint_state(robot, name)
        fields.update(damping=[joint.damping], position=[position], rate=[velocity])
    return f"got the properties of {robot}::{name}", fields
