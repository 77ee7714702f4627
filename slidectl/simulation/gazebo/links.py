"""Single links: `get_link_state`, `set_link_state` (of a root), `get_link_properties`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.errors import Refused
from slidectl.rotations import from_rpy
from slidectl.simulation.gazebo.answers import Answer, provide
from slidectl.simulation.gazebo.entities import find, frame, link_frame
from slidectl.simulation.gazebo.models import set_state
from slidectl.simulation.gazebo.shapes import pose_message, seen_from, twist_message
from slidectl.simulation.graph import WORLD_NODE

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


def advertise(simulation: Simulation) -> None:
    """Provide them."""
    node = simulation.graph.node(WORLD_NODE)
    provide(node, "get_link_state", "GetLinkState", lambda request: _get_state(simulation, request))
    provide(node, "set_link_state", "SetLinkState", lambda request: _set_state(simulation, request["link_state"]))
    provide(node, "get_link_properties", "GetLinkProperties", lambda request: _properties(simulation, request))


def _get_state(simulation: Simulation, request: Message) -> Answer:
    robot, link = find(simulation, "link", request["link_name"])
    viewer = frame(simulation, request["reference_frame"])
    state = seen_from(link_frame(simulation, robot, link), viewer)
    message = {
        "link_name": f"{robot}::{link}",
        "pose": pose_message(state.pose),
        "twist": twist_message(state.twist),
        "reference_frame": request["reference_frame"] or "world",
    }
    return f"got the state of {robot}::{link}", {"link_state": message}


def _set_state(simulation: Simulation, state: Message) -> Answer:
    """A link in the middle of a robot hangs on its joints; only a root can be put somewhere."""
    robot, link = find(simulation, "link", state["link_name"])
    root = simulation.robots.get(robot).paper.root
    if link != root:
        raise Refused(
            f"{robot}::{link} hangs on a joint; only the root link {robot}::{root} can be put somewhere",
            "move joints with /gazebo/set_model_configuration",
        )
    return set_state(simulation, {**state, "model_name": robot})


def _properties(simulation: Simulation, request: Message) -> Answer:
    robot, name = find(simulation, "link", request["link_name"])
    link = simulation.robots.get(robot).paper.links[name]
    fields: Message = {"gravity_mode": not link.surface.turn_gravity_off}
    if link.inertial is not None:
        inertial = link.inertial
        fields["com"] = pose_message((inertial.origin.xyz, from_rpy(inertial.origin.rpy)))
        fields["mass"] = inertial.mass
        fields.update(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), inertial.inertia, strict=True))
    return f"got the properties of {robot}::{name}", fields
