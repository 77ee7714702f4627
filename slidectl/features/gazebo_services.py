"""The services and topics of `/gazebo`, as in gazebo_ros_api_plugin, for this world.

They answer `success: false` with the reason where Gazebo does. A link or joint is named `model::link`; the model may be
left out when only one robot has a part of that name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from slidectl.control.duration import header_of
from slidectl.control.node_handle import Message
from slidectl.effects import Effect
from slidectl.errors import Refused
from slidectl.features.entities import WORLD_FRAMES, Entities
from slidectl.features.gazebo_frames import (
    Frame,
    pose,
    pose_message,
    seen_from,
    twist,
    twist_message,
    vector,
    vector_message,
)
from slidectl.msgs.schema import nanoseconds
from slidectl.rotations import IDENTITY, Vector, add, compose, cross, from_rpy, rotate, subtract
from slidectl.simulation.clock import EACH_STEP_NS
from slidectl.simulation.feature import Feature
from slidectl.simulation.graph import WORLD_NODE
from slidectl.simulation.loop import check_timestep
from slidectl.simulation.pending import Pending
from slidectl.simulation.services import Answer, Handler, answering
from slidectl.simulation.spawned_robots import SpawnedRobot
from slidectl.simulation.topics import PeriodicTopic

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

JOINT_TYPES = {"revolute": 0, "continuous": 1, "prismatic": 2, "fixed": 3, "floating": 4, "planar": 5}
"""The `type` of gazebo_msgs/GetJointProperties. Gazebo has no floating and no planar joint: the nearest are a ball and
a universal joint."""


class GazeboServices(Feature):
    """The services that read or change one simulation."""

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._world = simulation.world
        self._robots = simulation.robots
        self._entities = Entities(simulation)
        node = simulation.graph.node(WORLD_NODE)
        answered: dict[str, tuple[str, Callable[[Message], Answer | Pending]]] = {
            "spawn_urdf_model": ("SpawnModel", self._spawn),
            "spawn_sdf_model": ("SpawnModel", self._spawn_sdf),
            "delete_model": ("DeleteModel", self._delete),
            "get_world_properties": ("GetWorldProperties", self._world_properties),
            "get_model_properties": ("GetModelProperties", self._model_properties),
            "get_model_state": ("GetModelState", self._model_state),
            "set_model_state": ("SetModelState", lambda request: self._set_model_state(request["model_state"])),
            "set_model_configuration": ("SetModelConfiguration", self._configure),
            "get_link_state": ("GetLinkState", self._link_state),
            "set_link_state": ("SetLinkState", lambda request: self._set_link_state(request["link_state"])),
            "get_link_properties": ("GetLinkProperties", self._link_properties),
            "get_joint_properties": ("GetJointProperties", self._joint_properties),
            "apply_joint_effort": ("ApplyJointEffort", self._apply_effort),
            "apply_body_wrench": ("ApplyBodyWrench", self._apply_wrench),
            "get_physics_properties": ("GetPhysicsProperties", self._physics),
            "set_physics_properties": ("SetPhysicsProperties", self._set_physics),
        }
        for name, (kind, handler) in answered.items():
            node.advertise_service(
                name,
                f"gazebo_msgs/{kind}",
                answering(handler, "status_message"),
                Effect.READS if name.startswith("get_") else Effect.WRITES,
            )
        for name, kind, action in (
            ("clear_joint_forces", "gazebo_msgs/JointRequest", self._clear_joint),
            ("clear_joint_efforts", "gazebo_msgs/JointRequest", self._clear_joint),
            ("clear_body_wrenches", "gazebo_msgs/BodyRequest", self._clear_body),
            ("pause_physics", "std_srvs/Empty", lambda _: simulation.pause()),
            ("unpause_physics", "std_srvs/Empty", lambda _: simulation.resume()),
            ("reset_simulation", "std_srvs/Empty", lambda _: simulation.reset_simulation()),
            ("reset_world", "std_srvs/Empty", lambda _: simulation.reset_world()),
        ):
            node.advertise_service(name, kind, _acting(action))

        def on_model_state(message: Message) -> None:
            self._set_model_state(message)

        node.subscribe("set_model_state", "gazebo_msgs/ModelState", on_model_state)
        for topic, kind, build in (
            ("model_states", "ModelStates", self._model_states),
            ("link_states", "LinkStates", self._link_states),
        ):
            name = f"{WORLD_NODE}/{topic}"
            PeriodicTopic(simulation.graph, name, f"gazebo_msgs/{kind}", WORLD_NODE, EACH_STEP_NS, build)

    # Spawning and deleting

    def _spawn(self, request: Message) -> Pending:
        """Spawn at once, or when its meshes are read; with a driver the world runs meanwhile."""
        return self._entities.spawn(self._entities.read_request(request, is_sdf=False)).converted(_spawned)

    def _spawn_sdf(self, request: Message) -> Pending:
        """Spawn one model: all its parts or none."""
        return self._entities.spawn(self._entities.read_request(request, is_sdf=True)).converted(_spawned)

    def _delete(self, request: Message) -> Answer:
        self._simulation.delete(request["model_name"])
        return f"deleted {request['model_name']!r}", {}

    # The world and its models

    def _world_properties(self, _: Message) -> Answer:
        fields = {
            "sim_time": self._simulation.graph.clock.seconds,
            "model_names": self._robots.names(),
            "rendering_enabled": False,
        }
        return "got the properties of the world", fields

    def _model_properties(self, request: Message) -> Answer:
        robot = self._robots.get(request["model_name"])
        model = robot.description
        shapes = [
            shape.name or f"{link.name}_collision{f'_{index}' if index else ''}"
            for link in model.links.values()
            for index, shape in enumerate(link.collisions)
        ]
        fields = {
            "parent_model_name": "world",
            "canonical_body_name": model.root,
            "body_names": list(model.links),
            "geom_names": shapes,
            "joint_names": list(model.joints),
            "is_static": robot.kind == "static",
        }
        return f"got the properties of {request['model_name']!r}", fields

    def _model_state(self, request: Message) -> Answer:
        viewer = self._entities.frame(request["relative_entity_name"])
        state = seen_from(self._entities.model_frame(request["model_name"]), viewer)
        header = header_of(self._simulation.time_ns, request["relative_entity_name"] or "world")
        fields = {"header": header, "pose": pose_message(state.pose), "twist": twist_message(state.twist)}
        return f"got the state of {request['model_name']!r}", fields

    def _set_model_state(self, state: Message) -> Answer:
        """Move a robot's root as gazebo_msgs/ModelState says."""
        name = state["model_name"]
        viewer = self._entities.frame(state["reference_frame"])
        self._entities.set_state(name, pose(state["pose"]), twist(state["twist"]), viewer)
        return f"set the state of {name!r}", {}

    def _configure(self, request: Message) -> Answer:
        """Set all joints or none. A joint may be named with its model, as `model::joint`."""
        names, positions = request["joint_names"], request["joint_positions"]
        self._robots.set_joints(request["model_name"], names, positions)
        return f"set {len(names)} joints of {request['model_name']!r}", {}

    # Links and joints

    def _link_state(self, request: Message) -> Answer:
        robot, link = self._entities.find("link", request["link_name"])
        state = seen_from(self._entities.link_frame(robot, link), self._entities.frame(request["reference_frame"]))
        message = {
            "link_name": f"{robot}::{link}",
            "pose": pose_message(state.pose),
            "twist": twist_message(state.twist),
            "reference_frame": request["reference_frame"] or "world",
        }
        return f"got the state of {robot}::{link}", {"link_state": message}

    def _set_link_state(self, state: Message) -> Answer:
        """Move a root link. Other links are held by joints and cannot be moved."""
        robot, link = self._entities.find("link", state["link_name"])
        root = self._robots.get(robot).description.root
        if link != root:
            raise Refused(
                f"{robot}::{link} is held by a joint; only the root link {robot}::{root} can be moved",
                "move joints with /gazebo/set_model_configuration",
            )
        return self._set_model_state({**state, "model_name": robot})

    def _link_properties(self, request: Message) -> Answer:
        robot, name = self._entities.find("link", request["link_name"])
        link = self._robots.get(robot).description.links[name]
        fields: Message = {"gravity_mode": not link.surface.turn_gravity_off}
        if link.inertial is not None:
            inertial = link.inertial
            fields["com"] = pose_message((inertial.origin.xyz, from_rpy(inertial.origin.rpy)))
            fields["mass"] = inertial.mass
            fields.update(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), inertial.inertia, strict=True))
        return f"got the properties of {robot}::{name}", fields

    def _joint_properties(self, request: Message) -> Answer:
        robot, name = self._entities.find("joint", request["joint_name"])
        joint = self._robots.get(robot).description.joints[name]
        fields: Message = {"type": JOINT_TYPES[joint.type]}
        if name in self._world.robot(robot).joints:
            position, velocity, _ = self._world.joint_state(robot, name)
            fields.update(damping=[joint.damping], position=[position], rate=[velocity])
        return f"got the properties of {robot}::{name}", fields

    # External forces

    def _apply_effort(self, request: Message) -> Answer:
        robot, joint = self._entities.find("joint", request["joint_name"])
        self._world.add_joint_force(robot, joint, request["effort"], *self._span(request))
        return f"effort on {robot}::{joint} set", {}

    def _apply_wrench(self, request: Message) -> Answer:
        robot, link = self._entities.find("link", request["body_name"])
        self._world.add_wrench(robot, link, *self._wrench(robot, link, request), *self._span(request))
        text = f"wrench on {robot}::{link} set"
        if request["reference_frame"] in WORLD_FRAMES and any(request["reference_point"].values()):
            text += (
                "; reference_point has no effect in the frame world: the force acts at the centre of mass, as in "
                f"Gazebo. Name a reference_frame, as {robot}::{link}"
            )
        return text, {}

    def _wrench(self, robot: str, link: str, request: Message) -> tuple[Vector, Vector]:
        """Force and torque on the centre of mass, in the world's axes.

        In the world's frame the reference point is not used and the force acts at the centre of mass, as in
        gazebo_ros_api_plugin; in the frame of a model or link it acts at the reference point.
        """
        force, torque = vector(request["wrench"]["force"]), vector(request["wrench"]["torque"])
        if request["reference_frame"] in WORLD_FRAMES:
            return force, torque
        reference = self._entities.frame(request["reference_frame"]).pose
        force, torque = rotate(reference[1], force), rotate(reference[1], torque)
        point = compose(reference, (vector(request["reference_point"]), IDENTITY))[0]
        inertial = self._robots.get(robot).description.links[link].inertial
        local = inertial.origin.xyz if inertial else (0.0, 0.0, 0.0)
        centre_of_mass = compose(self._world.link_pose(robot, link), (local, IDENTITY))[0]
        return force, add(torque, cross(subtract(point, centre_of_mass), force))

    def _span(self, request: Message) -> tuple[int, int]:
        """Start and duration in ns. A start in the past means now; a negative duration lasts until it is cleared."""
        return max(nanoseconds(request["start_time"]), self._simulation.time_ns), nanoseconds(request["duration"])

    def _clear_joint(self, request: Message) -> None:
        self._world.clear_joint_forces(*self._entities.find("joint", request["joint_name"]))

    def _clear_body(self, request: Message) -> None:
        self._world.clear_wrenches(*self._entities.find("link", request["body_name"]))

    # Physics properties

    def _physics(self, _: Message) -> Answer:
        timestep, run = self._simulation.timestep_ns * 1e-9, self._simulation.run
        fields: dict[str, Any] = {
            "time_step": timestep,
            "pause": run.paused,
            "max_update_rate": 0.0 if math.isinf(run.speed) else run.speed / timestep,
            "gravity": vector_message(self._world.gravity),
        }
        return "got the properties of the physics", fields

    def _set_physics(self, request: Message) -> Answer:
        """Set time step (s), rate of cycles (1/s; 0: as fast as possible) and gravity; ODE settings have no effect."""
        timestep, rate = request["time_step"], request["max_update_rate"]
        check_timestep(timestep, "time_step")
        if not (math.isfinite(rate) and rate >= 0):
            raise Refused(f"max_update_rate must be 0 or more, not {rate:g}")
        self._simulation.loop.between_cycles("set the properties of the physics")  # all or nothing
        self._world.set_gravity(vector(request["gravity"]))
        self._simulation.set_timestep(timestep)
        self._simulation.set_speed(rate * timestep)
        ignored = any(request["ode_config"].values())
        return "physics properties set" + ("; ode_config has no effect on MuJoCo" if ignored else ""), {}

    # Topics: published in every cycle with a subscriber

    def _model_states(self) -> Message:
        return _states({name: self._entities.model_frame(name) for name in self._robots.names()})

    def _link_states(self) -> Message:
        links = [(robot.name, link) for robot in self._robots for link in robot.description.links if link != "world"]
        return _states({f"{robot}::{link}": self._entities.link_frame(robot, link) for robot, link in links})


def _acting(action: Callable[[Message], None]) -> Handler:
    """A service handler with an empty response, which calls `action`."""

    def act(request: Message) -> Message:
        action(request)
        return {}

    return act


def _spawned(done: Pending) -> Answer:
    robots: list[SpawnedRobot] = done.result()
    texts = [f"{robot.name!r} in the namespace {robot.namespace}" for robot in robots]
    return "\n".join([f"spawned {', '.join(texts)}", *(text for one in robots for text in one.warnings)]), {}


def _states(frames: dict[str, Frame]) -> Message:
    return {
        "name": list(frames),
        "pose": [pose_message(frame.pose) for frame in frames.values()],
        "twist": [twist_message(frame.twist) for frame in frames.values()],
    }
