"""`/gazebo/link_states` and `/gazebo/model_states`: every cycle, but only while somebody listens."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.simulation.gazebo.entities import Frame, link_frame, model_frame
from slidectl.simulation.gazebo.shapes import pose_message, twist_message
from slidectl.simulation.graph import WORLD_NODE
from slidectl.simulation.periodic import PeriodicTopic

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

EVERY_CYCLE_NS = 1


def advertise(simulation: Simulation) -> None:
    """Publish them."""
    graph = simulation.graph
    models, links = f"{WORLD_NODE}/model_states", f"{WORLD_NODE}/link_states"
    PeriodicTopic(graph, models, "gazebo_msgs/ModelStates", WORLD_NODE, EVERY_CYCLE_NS, lambda: _models(simulation))
    PeriodicTopic(graph, links, "gazebo_msgs/LinkStates", WORLD_NODE, EVERY_CYCLE_NS, lambda: _links(simulation))


def _models(simulation: Simulation) -> Message:
    return _states({name: model_frame(simulation, name) for name in simulation.robots.names()})


def _links(simulation: Simulation) -> Message:
    return _states(
        {
            f"{robot.name}::{link}": link_frame(simulation, robot.name, link)
            for robot in simulation.robots
            for link in robot.paper.links
            if link != "world"
        }
    )


def _states(frames: dict[str, Frame]) -> Message:
    return {
        "name": list(frames),
        "pose": [pose_message(frame.pose) for frame in frames.values()],
        "twist": [twist_message(frame.twist) for frame in frames.values()],
    }
