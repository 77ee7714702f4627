"""Models as wholes: `get_world_properties`, `get_model_properties`, `get_model_state`, `set_model_state`,
`set_model_configuration`, and the topic `set_model_state`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.errors import Refused, UnknownName
from slidectl.simulation.clock import stamp
from slidectl.simulation.gazebo.answers import Answer, provide
from slidectl.simulation.gazebo.entities import STILL, Frame, frame, model_frame
from slidectl.simulation.gazebo.shapes import into_world, pose, pose_message, seen_from, twist, twist_message
from slidectl.simulation.graph import WORLD_NODE

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

CLOSED = ("revolute", "prismatic")


def advertise(simulation: Simulation) -> None:
    """Provide them."""
    node = simulation.graph.node(WORLD_NODE)
    provide(node, "get_world_properties", "GetWorldProperties", lambda _: _world(simulation))
    provide(node, "get_model_properties", "GetModelProperties", lambda request: _properties(simulation, request))
    provide(node, "get_model_state", "GetModelState", lambda request: _get_state(simulation, request))
    provide(node, "set_model_state", "SetModelState", lambda request: set_state(simulation, request["model_state"]))
    provide(node, "set_model_configuration", "SetModelConfiguration", lambda request: _configure(simulation, request))

    def take(message: Message) -> None:
        set_state(simulation, message)

    node.subscribe("set_model_state", "gazebo_msgs/ModelState", take)


def _world(simulation: Simulation) -> Answer:
    fields = {
        "sim_time": simulation.graph.clock.seconds,
        "model_names": simulation.robots.names(),
        "rendering_enabled": False,
    }
    return "got the properties of the world", fields


def _properties(simulation: Simulation, request: Message) -> Answer:
    paper = simulation.robots.get(request["model_name"]).paper
    shapes = [
        shape.name or f"{link.name}_collision{f'_{index}' if index else ''}"
        for link in paper.links.values()
        for index, shape in enumerate(link.collisions)
    ]
    fields = {
        "parent_model_name": "world",
        "canonical_body_name": paper.root,
        "body_names": list(paper.links),
        "geom_names": shapes,
        "joint_names": list(paper.joints),
        "is_static": False,
    }
    return f"got the properties of {request['model_name']!r}", fields


def _get_state(simulation: Simulation, request: Message) -> Answer:
    viewer = frame(simulation, request["relative_entity_name"])
    state = seen_from(model_frame(simulation, request["model_name"]), viewer)
    header = {"stamp": stamp(simulation.time_ns), "frame_id": request["relative_entity_name"] or "world"}
    fields = {"header": header, "pose": pose_message(state.pose), "twist": twist_message(state.twist)}
    return f"got the state of {request['model_name']!r}", fields


def set_state(simulation: Simulation, state: Message) -> Answer:
    """Put a robot's root where gazebo_msgs/ModelState says. Raises UnknownName, AmbiguousName, Refused (not finite)."""
    name = state["model_name"]
    robot = simulation.robots.get(name)
    asked = Frame(pose(state["pose"]), twist(state["twist"]))
    there = into_world(asked, frame(simulation, state["reference_frame"]))
    if robot.paper.is_fixed_to_world and asked.twist != STILL:
        raise Refused(f"{name!r} is fixed to the world and cannot have a twist", "leave the twist out")
    simulation.world.set_pose(name, there.pose, there.twist)
    return f"set the state of {name!r}", {}


def _configure(simulation: Simulation, request: Message) -> Answer:
    """All joints or none. A joint may be named with its model, as `model::joint`."""
    names, positions = request["joint_names"], request["joint_positions"]
    if len(names) != len(positions):
        raise Refused(f"{len(names)} joint names but {len(positions)} positions")
    robot = simulation.robots.get(request["model_name"])
    names = [name.removeprefix(f"{robot.name}::") for name in names]
    for joint, position in zip(names, positions, strict=True):
        _check_position(simulation, robot.name, joint, position)
    for joint, position in zip(names, positions, strict=True):
        simulation.world.set_joint(robot.name, joint, position, 0.0)
    return f"set {len(names)} joints of {robot.name!r}", {}


def _check_position(simulation: Simulation, robot: str, joint: str, position: float) -> None:
    known = simulation.world.body(robot).joints
    if joint not in known:
        raise UnknownName("moving joint", joint, list(known), f"on robot {robot!r}")
    if not math.isfinite(position):
        raise Refused(f"position of {joint} must be a finite number, not {position}")
    made = known[joint].joint
    if made.limit and made.type in CLOSED and not made.limit.lower <= position <= made.limit.upper:
        raise Refused(f"{joint} goes from {made.limit.lower:g} to {made.limit.upper:g}, not to {position:g}")
