"""The services of simulation_interfaces, ROS's standard for simulators, in the namespace of the node `/slidectl`.

They do the same as those of `/gazebo` and `/slidectl` under other names: an entity is a robot or a model. All of them
answer with a result, also on errors. docs/names.md lists them, and the parts of the standard that are missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

import slidectl
from slidectl import msgs, names
from slidectl.control.duration import header_of
from slidectl.control.node_handle import Message
from slidectl.effects import Effect
from slidectl.errors import BadName, Refused, SlidectlError, UnknownName, quoted
from slidectl.features.entities import Entities
from slidectl.features.gazebo_frames import pose, pose_message, twist, twist_message, vector_message
from slidectl.features.posix_pattern import PosixPattern
from slidectl.features.spawnables import FORMATS, SpawnFailure, failure, read, spawnables
from slidectl.physics import sensing
from slidectl.rotations import ORIGIN, Pose, compose
from slidectl.simulation.feature import Feature
from slidectl.simulation.pending import Pending
from slidectl.simulation.services import responding
from slidectl.simulation.spawned_robots import RESERVED, SpawnedRobot

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

FEATURES = (
    *("SPAWNING", "SPAWNING_ENTITIES", "SPAWNING_RESOURCE_STRING", "SPAWNABLES", "DELETING"),
    *("ENTITY_STATE_GETTING", "ENTITY_STATE_SETTING", "ENTITY_INFO_GETTING", "ENTITY_INFO_SETTING"),
    *("ENTITY_TAGS", "ENTITY_CATEGORIES", "ENTITY_BOUNDS", "ENTITY_BOUNDS_BOX"),
    *("SIMULATION_RESET", "SIMULATION_RESET_TIME", "SIMULATION_RESET_STATE", "SIMULATION_RESET_SPAWNED"),
    *("SIMULATION_STATE_GETTING", "SIMULATION_STATE_SETTING", "SIMULATION_STATE_PAUSE"),
    *("STEP_SIMULATION_SINGLE", "STEP_SIMULATION_MULTIPLE"),
)
"""Constants of simulation_interfaces/SimulatorFeatures."""
MOST_SPAWNED = 100
"""The most entities that one request may spawn: the world waits while their files are read."""
_PACKAGE = "simulation_interfaces"
_INFO = "entity"
"""The key in `SpawnedRobot.saved` of a robot's data for these services."""
_NOT_ONE = 1e-3
"""The largest accepted deviation of an orientation's length from 1."""
_CATEGORIES = {"robot": "CATEGORY_ROBOT", "model": "CATEGORY_OBJECT", "static": "CATEGORY_STATIC_OBJECT"}
"""The constant for each kind of robot."""


@cache
def constant(kind: str, name: str) -> int:
    """The value of a constant of a message of the standard."""
    return next(int(one.value) for one in msgs.constants(f"{_PACKAGE}/{kind}") if one.name == name)


class FailedRequest(SlidectlError):
    """A request failed; the result is the constant `name` of the message `kind`."""

    def __init__(self, name: str, message: str, kind: str = "Result") -> None:
        super().__init__(message)
        self.code = constant(kind, name)


class StandardServices(Feature):
    """The standard services of one simulation."""

    def attach(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._world = simulation.world
        self._robots = simulation.robots
        self._entities = Entities(simulation)
        node = simulation.graph.node(names.OWN_NODE, names.OWN_NODE)
        answered: dict[str, Callable[[Message], Message | Pending]] = {
            "spawn_entity": self._spawn,
            "spawn_entities": self._spawn_several,
            "get_spawnables": self._spawnables,
            "delete_entity": self._delete,
            "get_entities": self._names,
            "get_entities_states": self._states,
            "get_entity_state": lambda request: {"state": self._state(self._robots.get(request["entity"]))},
            "set_entity_state": self._set_state,
            "get_entity_info": lambda request: {"info": _info(self._robots.get(request["entity"]))},
            "set_entity_info": self._set_info,
            "get_entity_bounds": self._bounds,
            "get_simulation_state": lambda _: {"state": {"state": constant("SimulationState", self._run_state)}},
            "set_simulation_state": self._set_run_state,
            "step_simulation": self._step,
            "reset_simulation": self._reset,
        }
        for name, handler in answered.items():
            kind = name.title().replace("_", "")
            node.advertise_service(
                name,
                f"{_PACKAGE}/{kind}",
                responding(handler, _respond),
                Effect.READS if name.startswith("get_") else Effect.WRITES,
                "sources" if name == "get_spawnables" else "",
            )
        node.advertise_service(
            "get_simulator_features", f"{_PACKAGE}/GetSimulatorFeatures", lambda _: _features(), Effect.READS
        )

    # Spawning and deleting

    def _spawn(self, request: Message) -> Pending:
        return Pending.attempt(lambda: self._spawn_one(request)).converted(_spawn_result)

    def _spawn_one(self, request: Message) -> Pending:
        """Resolved with the entity's name. All its parts are spawned, or none."""
        place = self._place(request["initial_pose"])
        namespace = request["entity_namespace"]
        if namespace and not names.is_legal(names.join("/", namespace)):
            raise SpawnFailure("NAMESPACE_INVALID", str(BadName(namespace)))
        parts = read(
            request["entity_resource"],
            request["name"],
            lambda name: self._name(name, request),
            self._simulation.graph.services.permitted,
            self._simulation.host,
        )
        try:
            parsed = [
                (self._entities.read(one.xml, one.name, namespace or None, is_model=one.is_model), one.pose)
                for one in parts
            ]
        except SlidectlError as error:
            raise failure(error) from None

        def spawned(done: Pending) -> str:
            robots: list[SpawnedRobot] = done.result()
            for robot in robots:
                _kept(robot)["is_spawned"] = True
            return robots[0].name

        return self._entities.spawn([(one, compose(place, inside)) for one, inside in parsed]).converted(spawned)

    def _place(self, stamped: Message) -> Pose:
        """The pose in the world of a geometry_msgs/PoseStamped. Raises SpawnFailure, UnknownName."""
        frame = self._entities.frame(stamped["header"]["frame_id"])
        try:
            return compose(frame.pose, _valid_pose(stamped["pose"]))
        except Refused as error:
            raise SpawnFailure("INVALID_POSE", str(error)) from None

    def _name(self, wanted: str, request: Message) -> str:
        """The name to use for a requested one. Raises SpawnFailure."""
        may_rename = request["allow_renaming"]
        if not wanted and not may_rename:
            raise SpawnFailure("NAME_INVALID", "the entity has no name, and allow_renaming is false")
        wanted = wanted or "entity"
        try:
            names.check_robot(wanted)
        except BadName as error:
            raise SpawnFailure("NAME_INVALID", str(error)) from None
        if wanted in RESERVED:
            raise SpawnFailure("NAME_INVALID", f"{wanted!r} is a name of the world's own frame")
        if wanted not in self._robots:
            return wanted
        if not may_rename:
            raise SpawnFailure("NAME_NOT_UNIQUE", f"there is an entity {wanted!r}, and allow_renaming is false")
        return next(name for name in (f"{wanted}_{number}" for number in count(1)) if name not in self._robots)

    def _spawn_several(self, request: Message) -> Pending:
        """Spawn one after the other. A failed one does not stop the others."""
        requests: list[Message] = request["spawn_requests"]
        if len(requests) > MOST_SPAWNED:
            text = f"{len(requests)} entities in one request: at most {MOST_SPAWNED} are allowed"
            raise FailedRequest("RESULT_OPERATION_FAILED", text)
        results: list[Message] = []
        answer = Pending()

        def on_spawned(done: Pending) -> None:
            results.append(done.result())
            go_on()

        def go_on() -> None:
            while len(results) < len(requests):
                spawning = self._spawn(requests[len(results)])
                answer.on_cancel = spawning.cancel
                if not spawning.done:
                    spawning.then(on_spawned)
                    return
                results.append(spawning.result())
            result = _ok()
            if any(one["result"]["result"] != result["result"] for one in results):
                code = constant("SpawnEntitiesResponse", "ENTITIES_SPAWN_FAILED")
                result = _result(code, "the results say which were not spawned, and why")
            answer.resolve({"result": result, "results": results})

        go_on()
        return answer

    def _spawnables(self, request: Message) -> Message:
        found, text = spawnables(request["sources"])
        return {"spawnables": found, "result": _ok(text)}

    def _delete(self, request: Message) -> Message:
        self._simulation.delete(request["entity"])
        return {}

    # State of entities

    def _names(self, request: Message) -> Message:
        return {"entities": [robot.name for robot in self._matching(request["filters"])]}

    def _states(self, request: Message) -> Message:
        found = list(self._matching(request["filters"]))
        return {"entities": [robot.name for robot in found], "states": [self._state(robot) for robot in found]}

    def _matching(self, filters: Message) -> Iterator[SpawnedRobot]:
        """The robots that match all filters; an empty filter matches all."""
        pattern = PosixPattern(filters["filter"]) if filters["filter"] else None
        categories = {one["category"] for one in filters["categories"]}
        tags, mode = set(filters["tags"]["tags"]), filters["tags"]["filter_mode"]
        needs_all = mode == constant("TagsFilter", "FILTER_MODE_ALL")
        is_within = self._within(filters["bounds"])
        for robot in self._robots:
            info = _info(robot)
            own = tags.intersection(info["tags"])
            if (
                (pattern is None or pattern.is_in(robot.name))
                and (not categories or info["category"]["category"] in categories)
                and (not tags or (own == tags if needs_all else bool(own)))
                and is_within(robot)
            ):
                yield robot

    def _within(self, bounds: Message) -> Callable[[SpawnedRobot], bool]:
        """A test whether the boxes around a robot's shapes overlap with simulation_interfaces/Bounds of the world.

        A robot without shapes is a point. Raises FailedRequest.
        """
        kind = bounds["type"]
        points = np.array([[one["x"], one["y"], one["z"]] for one in bounds["points"]], dtype=float)
        if kind == constant("Bounds", "TYPE_EMPTY"):
            return lambda _: True
        if kind not in (constant("Bounds", "TYPE_BOX"), constant("Bounds", "TYPE_SPHERE")):
            raise FailedRequest("RESULT_FEATURE_UNSUPPORTED", "bounds are TYPE_EMPTY, TYPE_BOX or TYPE_SPHERE")
        if len(points) != 2 or not np.isfinite(points).all():
            raise FailedRequest("RESULT_OPERATION_FAILED", "such bounds have two points, with finite numbers")

        def is_within(robot: SpawnedRobot) -> bool:
            boxes = sensing.boxes(self._world, robot.name, ORIGIN)
            if not len(boxes):
                boxes = np.array([[self._entities.model_frame(robot.name).pose[0]] * 2])
            low, high = boxes[:, 0], boxes[:, 1]
            if kind == constant("Bounds", "TYPE_BOX"):
                return bool(((low <= points.max(axis=0)) & (high >= points.min(axis=0))).all(axis=1).any())
            nearest = np.clip(points[0], low, high)
            return bool((np.linalg.norm(nearest - points[0], axis=1) <= points[1, 0]).any())

        return is_within

    def _state(self, robot: SpawnedRobot) -> Message:
        """The state as simulation_interfaces/EntityState."""
        frame = self._entities.model_frame(robot.name)
        acceleration = sensing.link_acceleration(self._world, robot.name, robot.description.root)
        return {
            "header": header_of(self._simulation.time_ns, "world"),
            "pose": pose_message(frame.pose),
            "twist": twist_message(frame.twist),
            "acceleration": twist_message(acceleration),
        }

    def _set_state(self, request: Message) -> Message:
        name, state = request["entity"], request["state"]
        robot = self._robots.get(name)
        pushes = [
            flag
            for flag, field in (("set_twist", "twist"), ("set_acceleration", "acceleration"))
            if request[flag] and any(any(part.values()) for part in state[field].values())
        ]
        if robot.description.is_fixed_to_world and pushes:
            raise FailedRequest("RESULT_OPERATION_FAILED", f"{name!r} is fixed to the world and cannot move")
        try:
            place = _valid_pose(state["pose"]) if request["set_pose"] else None
        except Refused as error:
            raise FailedRequest("INVALID_POSE", str(error), "SetEntityStateResponse") from None
        moving = twist(state["twist"]) if request["set_twist"] else None
        self._entities.set_state(name, place, moving, self._entities.frame(state["header"]["frame_id"]))
        text = "an acceleration follows from forces and is not set" if "set_acceleration" in pushes else ""
        return {"result": _ok(text)}

    def _set_info(self, request: Message) -> Message:
        robot, info = self._robots.get(request["entity"]), request["info"]
        known = {one.value for one in msgs.constants(f"{_PACKAGE}/EntityCategory")}
        if info["category"]["category"] not in known:
            raise FailedRequest(
                "RESULT_NOT_FOUND", f"{info['category']['category']} is not a category; categories: {known}"
            )
        _kept(robot).update(
            category=info["category"]["category"], description=info["description"], tags=list(info["tags"])
        )
        return {}

    def _bounds(self, request: Message) -> Message:
        """The box around all collision shapes, in the axes of the root link."""
        robot = self._robots.get(request["entity"])
        boxes = sensing.boxes(self._world, robot.name, self._entities.model_frame(robot.name).pose)
        if not len(boxes):
            return {"bounds": {"type": constant("Bounds", "TYPE_EMPTY")}}
        corners = boxes[:, 1].max(axis=0).tolist(), boxes[:, 0].min(axis=0).tolist()
        points = [vector_message(corner) for corner in corners]
        return {"bounds": {"type": constant("Bounds", "TYPE_BOX"), "points": points}}

    # Run state

    @property
    def _run_state(self) -> str:
        """The state's name. A world that is paused at time 0 is stopped; later it is paused."""
        if not self._simulation.run.paused:
            return "STATE_PLAYING"
        return "STATE_PAUSED" if self._simulation.cycles else "STATE_STOPPED"

    def _set_run_state(self, request: Message) -> Message | Pending:
        simulation, present = self._simulation, self._run_state
        known = {one.value: one.name for one in msgs.constants(f"{_PACKAGE}/SimulationState")}
        asked = known.get(request["state"]["state"], "")
        response = "SetSimulationStateResponse"
        if asked == present:
            raise FailedRequest("ALREADY_IN_TARGET_STATE", f"it is in {asked} already", response)
        if asked == "STATE_PLAYING":
            try:
                simulation.resume()
            except SlidectlError as error:
                raise FailedRequest("STATE_TRANSITION_ERROR", str(error), response) from None
        elif asked == "STATE_PAUSED":
            if present == "STATE_STOPPED":
                text = "a stopped world cannot be paused; play it, or step it"
                raise FailedRequest("INCORRECT_TRANSITION", text, response)
            simulation.pause()
        elif asked == "STATE_STOPPED":
            simulation.pause()
            self._delete_spawned()
            simulation.reset_simulation()
        elif asked == "STATE_QUITTING" and simulation.graph.services.exists(f"{names.OWN_NODE}/shutdown"):
            return simulation.graph.services.call(f"{names.OWN_NODE}/shutdown").converted(_nothing_more)
        else:
            text = f"{asked or request['state']['state']} cannot be requested here"
            raise FailedRequest("RESULT_FEATURE_UNSUPPORTED", text)
        return {}

    def _step(self, request: Message) -> Pending:
        if not self._simulation.run.paused:
            raise FailedRequest("RESULT_OPERATION_FAILED", "the simulation is not paused")
        return self._simulation.request_steps(request["steps"] or 1).converted(_nothing_more)

    def _reset(self, request: Message) -> Message:
        scope = request["scope"] or constant("ResetSimulationRequest", "SCOPE_ALL")
        time, state, spawned = (
            bool(scope & constant("ResetSimulationRequest", f"SCOPE_{name}")) for name in ("TIME", "STATE", "SPAWNED")
        )
        if time and not state:
            text = "time goes back together with the state: SCOPE_TIME and SCOPE_STATE"
            raise FailedRequest("RESULT_FEATURE_UNSUPPORTED", text)
        if spawned:
            self._delete_spawned()
        if time:
            self._simulation.reset_simulation()
        elif state:
            self._simulation.reset_world()
        return {}

    def _delete_spawned(self) -> None:
        """Delete the entities spawned by these services. A reset keeps those from files and other services."""
        for robot in self._robots:
            if _kept(robot).get("is_spawned"):
                self._simulation.delete(robot.name)


# Requests and responses


def _respond(done: Pending) -> Message:
    """The fields of the response with its result; on an error only the result for it."""
    if done.error is not None:
        return {"result": _failed(done.error)}
    return {"result": _ok(), **done.result()}


def _result(code: int, text: str = "") -> Message:
    return {"result": code, "error_message": text}


def _ok(text: str = "") -> Message:
    return _result(constant("Result", "RESULT_OK"), text)


def _failed(error: SlidectlError) -> Message:
    if isinstance(error, FailedRequest):
        return _result(error.code, str(error))
    name = "RESULT_NOT_FOUND" if isinstance(error, UnknownName) else "RESULT_OPERATION_FAILED"
    return _result(constant("Result", name), str(error))


def _spawn_result(done: Pending) -> Message:
    """The answer as simulation_interfaces/SpawnResult."""
    if done.error is None:
        return {"result": _ok(), "entity_name": done.result()}
    if isinstance(done.error, UnknownName):
        return {"result": _failed(done.error)}
    error = failure(done.error)
    kind = "Result" if error.reason.startswith("RESULT_") else "SpawnResult"
    return {"result": _result(constant(kind, error.reason), str(error))}


def _nothing_more(done: Pending) -> Message:
    """An empty response. Raises the call's error."""
    done.result()
    return {}


def _features() -> Message:
    return {
        "features": {
            "features": sorted(constant("SimulatorFeatures", name) for name in FEATURES),
            "spawn_formats": list(FORMATS),
            "custom_info": f"slidectl {slidectl.__version__}",
        }
    }


def _valid_pose(message: Message) -> Pose:
    """The pose of a geometry_msgs/Pose. Four zeros mean no rotation, as when ROS 1 leaves it out. Raises Refused."""
    from slidectl.client.spawning import FARTHEST  # late import, as in spawnables

    place, turn = message["position"], message["orientation"]
    if not all(abs(value) <= FARTHEST for value in place.values()):
        raise Refused(f"positions are numbers up to ±{FARTHEST:g} m, not {_values(place)}")
    length = math.hypot(*turn.values())
    if length and not abs(length - 1) <= _NOT_ONE:
        raise Refused(f"an orientation has the length 1, not {_values(turn)}")
    return pose(message)


def _values(message: Message) -> str:
    return " ".join(f"{name} {value:g}" for name, value in message.items())


def _kept(robot: SpawnedRobot) -> dict[str, Any]:
    """The robot's data for these services; snapshots save it."""
    kept = robot.saved.setdefault(_INFO, {})
    assert isinstance(kept, dict)
    return kept


def _info(robot: SpawnedRobot) -> Message:
    """The robot as simulation_interfaces/EntityInfo: what was set, else defaults."""
    kept = _kept(robot)
    tags: Sequence[str] = kept.get("tags", ())
    return {
        "category": {"category": kept.get("category", constant("EntityCategory", _CATEGORIES[robot.kind]))},
        "description": kept.get("description", f"{quoted(robot.name)}, a {robot.kind}"),
        "tags": list(tags),
    }
