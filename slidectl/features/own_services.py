"""The services of `/slidectl` on time, parameters, names and robots. `shutdown` is the daemon's.

These are not in ROS; `attach` has all of them. Other features have services there too: snapshots, faults, lock-step,
traces, waits.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING, Any

import slidectl
from slidectl import msgs, names
from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.description import interfaces, source_note
from slidectl.description.robot import MOVING, Joint
from slidectl.effects import Effect
from slidectl.errors import Reason, Refused, UnknownName, Unused, UsageError, closest, listing
from slidectl.features.entities import Entities
from slidectl.features.gazebo_frames import pose_message, vector_message
from slidectl.features.rosapi import absolute, check_size, from_json, typedefs
from slidectl.physics import sensing
from slidectl.simulation.feature import Feature
from slidectl.simulation.loop import whole_cycles
from slidectl.simulation.pending import Pending
from slidectl.simulation.services import Answer, Handler, answering
from slidectl.simulation.spawned_robots import SpawnedRobot

if TYPE_CHECKING:
    from slidectl.msgs.typed import (
        ControllerStateMsg,
        JointInfoMsg,
        JointStatesResponseMsg,
        ListRobotsResponseMsg,
        RobotInfoMsg,
        SceneResponseMsg,
        SetParamsResponseMsg,
        SpawnResponseMsg,
        StepResponseMsg,
    )
    from slidectl.simulation.simulation import Simulation

LONGEST_S = 1e9
_KINDS = ("topic", "service", "parameter", "node", "robot")
_MOST_COMPARED = 8
"""The most ways to split a name from a field that are compared with known names for a suggestion; this takes ms."""
_PHRASES = {interface.type_name: interface.phrase for interface in interfaces.ALL}

Claim = tuple[str, str]
"""An interface and a joint."""


class OwnServices(Feature):
    """The services of one simulation."""

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._graph = simulation.graph
        self._robots = simulation.robots
        self._entities = Entities(simulation)
        self._graph.on_node_closed.append(simulation.run.holders.discard)
        node = simulation.graph.node(names.OWN_NODE, names.OWN_NODE)
        offers: dict[str, tuple[Effect, str, Handler]] = {
            "status": (Effect.READS, "Status", self._status),
            "step": (Effect.WRITES, "Step", self._step),
            "sleep": (Effect.WRITES, "Sleep", self._sleep),
            "set_speed": (Effect.WRITES, "SetSpeed", answering(self._set_speed, "message")),
            "set_params": (Effect.WRITES, "SetParams", self._set_params),
            "given_params": (Effect.READS, "GivenParams", self._given_params),
            "spawn": (Effect.WRITES, "Spawn", self._spawn),
            "list_robots": (Effect.READS, "ListRobots", self._list_robots),
            "scene": (Effect.READS, "Scene", self._scene),
            "joint_states": (Effect.READS, "JointStates", self._joint_states),
            "sources": (Effect.WRITES, "Sources", self._sources),
            "resolve": (Effect.READS, "Resolve", self._resolve),
            "estop": (Effect.WRITES, "EmergencyStop", answering(self._stop, "message")),
            "rest_joints": (Effect.WRITES, "RestJoints", answering(self._rest, "message")),
            "start_joints": (Effect.WRITES, "StartJoints", answering(self._start_joints, "message")),
            "load_controller_file": (Effect.CODE, "LoadControllerFile", self._load_file),
            "reload_controller": (Effect.CODE, "ReloadController", self._reload),
            "graph": (Effect.READS, "GraphState", lambda _: self._graph.state()),
            "update_times": (Effect.READS, "ListUpdateTimes", self._update_times),
        }
        for name, (effect, kind, handler) in offers.items():
            node.advertise_service(name, f"slidectl/{kind}", handler, effect, "note" if name == "sources" else "")

    def _status(self, _: Message) -> Message:
        simulation = self._simulation
        managers = [robot.parts.manager for robot in self._robots if robot.is_controlled]
        return {
            "version": slidectl.__version__,
            "time": self._graph.clock.seconds,
            "cycles": simulation.cycles,
            "paused": simulation.run.paused,
            "trouble": simulation.run.trouble,
            "holders": sorted(simulation.run.holders),
            "speed": 0.0 if math.isinf(simulation.run.speed) else simulation.run.speed,
            "timestep": simulation.timestep_ns * 1e-9,
            "chosen": sorted(simulation.chosen),
            "engine": str(simulation.engine),
            "pictures": simulation.host.drawn_by(),
            "robots": self._robots.names(),
            "estop": [robot.name for robot in self._robots if robot.emergency_stop],
            "frozen": simulation.world.frozen,
            "controllers": sum(len(manager.names()) for manager in managers),
            "controllers_running": sum(len(manager.running) for manager in managers),
            **simulation.features.status(),
            **simulation.host.status(),
        }

    # Time

    def _step(self, request: Message) -> Pending:
        """Pause and step. Answered when the cycles are done or abandoned."""
        clock = self._graph.clock

        def response(done: Pending) -> StepResponseMsg:
            text = str(done.error) if done.error else f"{done.result()} cycles done"
            return {"success": done.error is None, "message": text, "time": clock.seconds, "cycles": clock.cycles}

        reader = self._graph.calling_node if request["news"] else ""
        return self._simulation.request_steps(self._cycles(request), reader).converted(response)

    def _cycles(self, request: Message) -> int:
        """The requested number of cycles, or the number of cycles in the requested time.

        Raises Refused for a time that is not a whole number of cycles, since the world could not stop at that time, and
        for a time in the past.
        """
        for name in ("seconds", "until"):
            if not 0 <= request[name] < LONGEST_S:
                raise Refused(f"{name} must be 0 or more (and less than {LONGEST_S:g}), not {request[name]:g}")
        if request["cycles"]:
            return int(request["cycles"])
        is_until = request["until"] and not request["seconds"]
        seconds, start_ns = (request["until"], self._graph.clock.time_ns) if is_until else (request["seconds"], 0)
        step_ns, asked_ns = self._simulation.timestep_ns, from_seconds(seconds) - start_ns
        if asked_ns < 0:
            raise Refused(f"it is {start_ns * 1e-9:.9g} s already", "slidectl sim reset --time begins at 0 again")
        return whole_cycles(asked_ns, step_ns, start_ns)

    def _sleep(self, request: Message) -> Pending:
        """Answered when the simulated time has passed; never while the world is paused."""
        duration: float = request["duration"]
        if not 0 <= duration < LONGEST_S:
            raise Refused(f"a duration is 0 s or more (and less than {LONGEST_S:g} s), not {duration:g}")
        clock, pending = self._graph.clock, Pending()

        def wake() -> None:
            pending.resolve({"success": True, "time": clock.seconds})

        if duration:
            pending.on_cancel = self._graph.timers.after(from_seconds(duration), wake).cancel
        else:
            wake()
        return pending

    def _set_speed(self, request: Message) -> Answer:
        self._simulation.set_speed(request["speed"])
        self._simulation.chosen.add("speed")
        speed = self._simulation.run.speed
        return "as fast as possible" if math.isinf(speed) else f"real-time factor {speed:g}", {}

    # Parameters and names

    def _set_params(self, request: Message) -> SetParamsResponseMsg:
        return self._set(request["names"], request["values"], request["known_only"])

    def _set(self, given: list[str], texts: list[str], known_only: bool = False) -> SetParamsResponseMsg:
        if len(given) != len(texts):
            raise UsageError(f"{len(given)} names and {len(texts)} values: one value for each name")
        parameters = self._graph.parameters
        values = {absolute(name): from_json(text) for name, text in zip(given, texts, strict=True)}
        created = [name for name in values if not parameters.has(name)]
        guarded = [name for name in created if parameters.is_guarded(name)]
        parameters.set_all(values, known_only)
        return {"created": created, "guarded": guarded}

    def _given_params(self, request: Message) -> Message:
        parameters, name = self._graph.parameters, absolute(request["name"])
        check_size(parameters.view(name), name)
        return {"value": json.dumps(parameters.given(name))}

    def _sources(self, request: Message) -> Message:
        digest: str = request["digest"]
        if re.fullmatch("[0-9a-f]{64}", digest) is None:
            raise Refused("a digest is SHA-256 in 64 hexadecimal digits")
        if request["note"]:
            self._robots.sources.add(digest, request["note"])
        return {"note": self._robots.sources.get(digest)}

    def _resolve(self, request: Message) -> Message:
        """The full name for a short one (see names.resolve), with the type and the nodes. It changes nothing.

        Raises:
            UnknownName: nothing fits. AmbiguousName: several do. Unused: the topic has no node in the role.
        """
        kind, name = request["kind"], request["name"]
        if kind not in _KINDS:
            raise UsageError(f"unknown kind {kind!r}", f"kinds: {', '.join(_KINDS)}")
        if len(name) > names.LONGEST:
            raise names.TooLong(name)
        namespace = request["namespace"] or "/"
        if kind == "topic":
            return self._resolve_topic(name, namespace, request["role"], request["with_field"])
        if kind == "service":
            services = self._graph.services
            full = names.resolve(name, services.names(), kind=kind, namespace=namespace)
            type_name = services.type_of(full)
            return {
                "name": full,
                "type": type_name,
                "typedefs": typedefs(msgs.request_type(type_name)),
                "response_typedefs": typedefs(msgs.response_type(type_name)),
                "nodes": [services.node_of(full)],
                "effects": [str(effect) for effect in services.effects_of(full)],
            }
        if kind == "parameter":
            return {"name": self._resolve_parameter(name, namespace)}
        if kind == "robot":
            return {"name": self._robot(name).name}
        return {"name": names.resolve(name, self._graph.nodes(), kind=kind, namespace=namespace)}

    def _resolve_topic(self, text: str, namespace: str, role: str, with_field: bool) -> Message:
        topics = self._graph.topics
        types = topics.types()
        users = {"publishers": topics.publishers, "subscribers": topics.subscribers}
        if role and role not in users:
            raise UsageError(f"unknown role {role!r}", f"roles: {', '.join(users)}")

        def used(known: list[str]) -> list[str]:
            return [topic for topic in known if not role or users[role](topic)]

        cuts = list(names.cut_from_field(text)) if with_field else [(text, "")]
        for name, field in cuts:
            exact, is_relative = names.join(namespace, name), not name.startswith("/")
            near = [known for known in types if known == exact or (is_relative and known.endswith(f"/{name}"))]
            if not near:
                continue
            if not used(near):
                raise Unused(role, " or ".join(near), used(list(types)))
            full = names.resolve(name, used(near), kind="topic", namespace=namespace)
            nodes = users[role](full) if role else []
            found = {"name": full, "field": field, "type": types[full], "nodes": nodes}
            return {**found, "typedefs": typedefs(types[full])}
        known = used(list(types))
        suggested = (name for name, _ in cuts[:_MOST_COMPARED] if closest(name, known))
        raise UnknownName("topic", next(suggested, text), known)

    def _resolve_parameter(self, name: str, namespace: str) -> str:
        """The full name of a parameter, or of a namespace of parameters."""
        if name == "/":
            return name
        known = self._graph.parameters.names()
        spaces = set()
        for each in known:
            while (each := names.parent(each)) != "/":
                spaces.add(each)
        try:
            return names.resolve(name.rstrip("/"), {*known, *spaces}, kind="parameter", namespace=namespace)
        except UnknownName as error:
            error.hint = f"parameters: {listing(known)}"
            raise

    def _robot(self, name: str) -> SpawnedRobot:
        """The robot by its name or its namespace. Raises UnknownName."""
        return next((robot for robot in self._robots if name == robot.namespace), None) or self._robots.get(name)

    # Robots

    def _spawn(self, request: Message) -> Pending:
        """Spawn at once, or when its meshes are read; with a driver the world runs meanwhile."""
        self._robots.check_free(request["model_name"], "" if request["sdf"] else request["robot_namespace"])
        warnings: list[str] = []
        if request["parameter_names"]:
            reasons: list[Reason] = []
            with self._graph.log.answering(reasons):
                self._set(request["parameter_names"], request["parameter_values"])
            warnings = [str(reason) for reason in reasons]
        placed = self._entities.read_request(request, is_sdf=request["sdf"])

        def spawned(done: Pending) -> SpawnResponseMsg:
            robots: list[SpawnedRobot] = done.result()
            joints, positions = request["joint_names"], request["joint_positions"]
            try:
                if joints:
                    self._robots.set_joints(robots[0].name, joints, positions, is_start=True)
            except BaseException:
                for robot in reversed(robots):
                    self._robots.delete(robot.name)
                raise
            told = [text for robot in robots for text in robot.warnings]
            return {"robots": [self._robot_info(robot) for robot in robots], "warnings": warnings + told}

        return self._entities.spawn(placed).converted(spawned)

    def _list_robots(self, request: Message) -> ListRobotsResponseMsg:
        asked: str = request["name"]
        robots = [self._robots.get(asked)] if asked else list(self._robots)
        return {"robots": [self._robot_info(robot) for robot in robots]}

    def _robot_info(self, robot: SpawnedRobot) -> RobotInfoMsg:
        """The robot as slidectl/RobotInfo."""
        model = robot.description
        commanded = robot.parts.hardware.interfaces() if robot.is_controlled else {}
        position, attitude = self._simulation.world.link_pose(robot.name, model.root)
        return {
            "name": robot.name,
            "namespace": robot.namespace,
            "kind": robot.kind,
            "fixed": model.is_fixed_to_world,
            "links": list(model.links),
            "joints": [self._joint_info(robot, joint, commanded) for joint in model.joints.values()],
            "controllers": list(robot.parts.manager.names()) if robot.is_controlled else [],
            "pose": [*map(float, position), *map(float, attitude)],
            "report": [
                {"verdict": n.verdict, "subject": n.subject, "text": n.text, "file": n.file, "line": n.line or 0}
                for n in model.report
            ],
            "estop": robot.emergency_stop,
            "frozen": robot.name in self._simulation.world.frozen,
            "process_session": robot.caller,
        }

    def _joint_info(self, robot: SpawnedRobot, joint: Joint, commanded: dict[str, str]) -> JointInfoMsg:
        position: Any = math.nan
        velocity = effort = position
        if joint.type in MOVING:
            position, velocity, effort = self._simulation.world.joint_state(robot.name, joint.name)
        limit = joint.limit
        bounded = limit is not None and joint.type in ("revolute", "prismatic")
        return {
            "name": joint.name,
            "type": joint.type,
            "hardware_interface": commanded.get(joint.name, ""),
            "position": position,
            "velocity": velocity,
            "effort": effort,
            "lower": limit.lower if limit and bounded else math.nan,
            "upper": limit.upper if limit and bounded else math.nan,
            "max_velocity": limit.velocity if limit else math.nan,
            "max_effort": limit.effort if limit else math.nan,
        }

    def _scene(self, request: Message) -> SceneResponseMsg:
        """The data for drawing the world, all from the same time."""
        world, robots = self._simulation.world, list(self._robots)
        places = [(robot.name, link) for robot in robots for link in robot.description.links if link != "world"]
        contacts = list(sensing.contacts(world)) if request["contacts"] else []
        return {
            "time": self._graph.clock.seconds,
            "ground": world.has_ground,
            "robots": [robot.name for robot in robots],
            "serials": [robot.serial for robot in robots],
            "may_use_files": [robot.may_use_files for robot in robots],
            "descriptions": [source_note.join(robot.xml, robot.note) for robot in robots if request["descriptions"]],
            "links": [f"{robot}::{link}" for robot, link in places],
            "poses": [pose_message(world.link_pose(robot, link)) for robot, link in places],
            "contact_points": [vector_message(point) for point, _ in contacts],
            "contact_forces": [vector_message(force) for _, force in contacts],
        }

    def _joint_states(self, _: Message) -> JointStatesResponseMsg:
        """The state of all joints, for frequent calls; `list_robots` returns more and takes much longer."""
        places = [(robot.name, one.name) for robot in self._robots for one in robot.description.joints.values()
                  if one.type in MOVING]  # fmt: skip
        states = [self._simulation.world.joint_state(*place) for place in places]
        position, velocity, effort = map(list, zip(*states, strict=True)) if states else ([], [], [])
        joints = [f"{robot}::{joint}" for robot, joint in places]
        return {"joints": joints, "position": position, "velocity": velocity, "effort": effort}

    # Emergency stop, and commands without a running controller

    def _stop(self, request: Message) -> Answer:
        """Set or release the emergency stop of DefaultRobotHWSim, as the topic in a robot's plugin does.

        It acts on all robots in one cycle, or on none when a name is unknown.
        """
        controlled = [robot for robot in self._robots if robot.is_controlled]
        meant = [self._robot(name) for name in dict.fromkeys(request["names"])] or controlled
        if not meant:
            raise Refused("no robots in the world")
        for robot in meant:
            robot.check_controlled()
        for robot in meant:
            robot.emergency_stop = request["stop"]
        listed = [robot.name for robot in meant]
        what = "emergency stop" if request["stop"] else "released"
        return f"{', '.join(listed)}: {what}", {"robots": listed}

    def _rest(self, request: Message) -> Answer:
        """Replace the last command of stopped controllers, which stays with the hardware as in ros_control."""
        if request["command"] not in ("zero", "hold"):
            raise UnknownName("command", request["command"], ["zero", "hold"])
        robot = self._robot(request["robot"])
        claims = _resting_claims(robot, request)
        if not request["check_only"]:
            robot.read_joints()
        commands = robot.hardware.resting_commands(claims, request["command"] == "hold")
        if not request["check_only"]:
            robot.hardware.command(commands)
        joints = list(dict.fromkeys(joint for _, joint in commands))
        text = "; ".join(f"{joint} keeps {_PHRASES[kind]} {value:g}" for (kind, joint), value in commands.items())
        return text or "no joints affected", {"joints": joints}

    def _update_times(self, request: Message) -> Message:
        robot = self._robot(request["robot"])
        compiled = self._simulation.loop.runner.compiled_controllers(robot)
        times = robot.manager.update_times() if robot.is_controlled else []
        return {"controllers": [{**one, "compiled": one["name"] in compiled} for one in times]}

    def _start_joints(self, request: Message) -> Answer:
        robot = self._robot(request["robot"])
        self._robots.set_joints(robot.name, request["joint_names"], request["joint_positions"], is_start=True)
        text = f"{robot.name}: {len(request['joint_names'])} joints start elsewhere"
        return "\n".join([text, *robot.warnings]), {}

    # Controllers of users

    def _load_file(self, request: Message) -> Pending:
        file = absolute_path(request["file"])
        return self._robot(request["robot"]).services.load_file(request["name"], file, request["class_name"])

    def _reload(self, request: Message) -> Pending:
        robot = self._robot(request["robot"])
        return robot.services.reload(request["name"], robot.parts.cycle.control_period_ns)


def absolute_path(file: str) -> str:
    """The path. Raises UsageError for a relative one: clients have other working directories."""
    if not file.startswith("/"):
        raise UsageError(f"the file {file!r} is not an absolute path")
    return file


def _resting_claims(robot: SpawnedRobot, request: Message) -> list[Claim]:
    """The claims of the given controllers that no other has. Raises UnknownName, Refused (one of them runs)."""
    loaded = {one["name"]: one for one in robot.manager.list()}
    for name in (*request["controllers"], *request["left_to"]):
        if name not in loaded:
            raise UnknownName("controller", name, list(loaded), f"of robot {robot.name!r}")
    running = {entry.name for entry in robot.manager.running}
    asked = [name for name in loaded if name in set(request["controllers"])]
    if running.intersection(asked) and not request["check_only"]:
        still = ", ".join(name for name in asked if name in running)
        raise Refused(f"{still} runs and writes its own commands", "stop it first")
    others = running.difference(asked) | set(request["left_to"])
    taken = {joint for name in others for _, joint in _claims(loaded[name])}
    found = dict.fromkeys(claim for name in request["controllers"] for claim in _claims(loaded[name]))
    return [claim for claim in found if claim[1] not in taken]


def _claims(controller: ControllerStateMsg) -> list[Claim]:
    claimed = controller["claimed_resources"]
    return [(claim["hardware_interface"], joint) for claim in claimed for joint in claim["resources"]]
