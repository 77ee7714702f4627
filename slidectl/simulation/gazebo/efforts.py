"""Forces from outside: `apply_joint_effort`, `apply_body_wrench`, `clear_joint_forces`, `clear_body_wrenches`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slidectl.control.node_handle import Message
from slidectl.physics.frames import add, compose, rotate, subtract
from slidectl.physics.rotation import cross
from slidectl.rotations import IDENTITY, Vector
from slidectl.simulation.clock import SECOND
from slidectl.simulation.gazebo.answers import Answer, provide
from slidectl.simulation.gazebo.entities import WORLD_FRAMES, find, frame
from slidectl.simulation.gazebo.shapes import vector
from slidectl.simulation.graph import WORLD_NODE

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation


def advertise(simulation: Simulation) -> None:
    """Provide them."""
    node = simulation.graph.node(WORLD_NODE)
    provide(node, "apply_joint_effort", "ApplyJointEffort", lambda request: _apply_effort(simulation, request))
    provide(node, "apply_body_wrench", "ApplyBodyWrench", lambda request: _apply_wrench(simulation, request))
    node.advertise_service(
        "clear_joint_forces", "gazebo_msgs/JointRequest", lambda request: _clear_joint(simulation, request)
    )
    node.advertise_service(
        "clear_joint_efforts", "gazebo_msgs/JointRequest", lambda request: _clear_joint(simulation, request)
    )
    node.advertise_service(
        "clear_body_wrenches", "gazebo_msgs/BodyRequest", lambda request: _clear_body(simulation, request)
    )


def _apply_effort(simulation: Simulation, request: Message) -> Answer:
    robot, joint = find(simulation, "joint", request["joint_name"])
    simulation.world.add_joint_force(robot, joint, request["effort"], *_span(simulation, request))
    return f"effort on {robot}::{joint} set", {}


def _apply_wrench(simulation: Simulation, request: Message) -> Answer:
    robot, link = find(simulation, "link", request["body_name"])
    force, torque = _wrench(simulation, robot, link, request)
    simulation.world.add_wrench(robot, link, force, torque, *_span(simulation, request))
    return f"wrench on {robot}::{link} set", {}


def _wrench(simulation: Simulation, robot: str, link: str, request: Message) -> tuple[Vector, Vector]:
    """Force and torque on the centre of mass, in the world's axes.

    In the world's frame the reference point is not used and the force acts at the centre of mass, as in
    gazebo_ros_api_plugin; in the frame of a model or link it acts at the reference point.
    """
    force, torque = vector(request["wrench"]["force"]), vector(request["wrench"]["torque"])
    if request["reference_frame"] in WORLD_FRAMES:
        return force, torque
    reference = frame(simulation, request["reference_frame"]).pose
    force, torque = rotate(reference[1], force), rotate(reference[1], torque)
    point = compose(reference, (vector(request["reference_point"]), IDENTITY))[0]
    arm = subtract(point, _centre_of_mass(simulation, robot, link))
    return force, add(torque, cross(arm, force))


def _centre_of_mass(simulation: Simulation, robot: str, link: str) -> Vector:
    inertial = simulation.robots.get(robot).paper.links[link].inertial
    local = inertial.origin.xyz if inertial else (0.0, 0.0, 0.0)
    return compose(simulation.world.link_pose(robot, link), (local, IDENTITY))[0]


def _span(simulation: Simulation, request: Message) -> tuple[int, int]:
    """Start and duration in ns; a start that has passed means now, a negative duration until it is cleared."""
    start, duration = request["start_time"], request["duration"]
    start_ns = start["secs"] * SECOND + start["nsecs"]
    return max(start_ns, simulation.time_ns), duration["secs"] * SECOND + duration["nsecs"]


def _clear_joint(simulation: Simulation, request: Message) -> Message:
    simulation.world.clear_joint_forces(*find(simulation, "joint", request["joint_name"]))
    return {}


def _clear_body(simulation: Simulation, request: Message) -> Message:
    simulation.world.clear_wrenches(*find(simulation, "link", request["body_name"]))
    return {}
