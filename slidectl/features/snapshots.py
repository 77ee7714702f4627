"""Snapshots: the whole state of a simulation at one time, from which it continues with the same bits.

Loading first restores robots and controllers, by deleting and creating those that differ, and lets features make their
parts again; then it restores the numbers. When the same robots and controllers exist, it only restores the numbers.
Speed and pause do not change; nor do clients: their waits keep the remaining time.

Code that adds a part to a robot must register it in `SpawnedRobot.saved`. A feature declares its own state.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from operator import attrgetter
from types import ModuleType
from typing import TYPE_CHECKING, Any

from slidectl import description, names
from slidectl.control.registry import ControllerTypes
from slidectl.control.user_classes import is_of_a_user
from slidectl.description import source_note
from slidectl.errors import Refused, SlidectlError, UnknownName
from slidectl.features.action_server import ActionGoal
from slidectl.features.saved_state import Restoring, SavedObject, Saving
from slidectl.physics.hulls import Hulls
from slidectl.rotations import Pose
from slidectl.simulation.feature import Feature
from slidectl.simulation.spawned_robots import ParsedRobot, SpawnedRobot

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

RESTORED = "The simulation was restored to a time before this goal was sent"


@dataclass(frozen=True)
class SpawnedAs:
    """The inputs of a robot's spawn: enough to spawn it again."""

    name: str
    namespace: str
    xml: str
    is_controlled: bool
    pose: Pose
    note: str
    caller: int
    may_use_files: bool
    hulls: Hulls
    made_parameters: list[str]
    controllers: list[tuple[str, str, Any]]
    """Names, types, and the parameters with which they were loaded, in load order."""

    @classmethod
    def of(cls, robot: SpawnedRobot) -> SpawnedAs:
        """The inputs of this robot's spawn."""
        return cls(
            robot.name,
            robot.namespace,
            robot.xml,
            robot.is_controlled,
            robot.attached.spawn_pose,
            robot.note,
            robot.caller,
            robot.may_use_files,
            robot.attached.hulls,
            list(robot.made_parameters),
            list(robot.parts.manager.loaded()) if robot.is_controlled else [],
        )

    def parsed(self) -> ParsedRobot:
        """The parsed robot, to be spawned again."""
        model = description.parse(source_note.join(self.xml, self.note), may_use_files=self.may_use_files)
        place = names.check(self.namespace)
        return ParsedRobot(
            self.name, place, model, self.xml, self.note, self.caller, self.is_controlled, self.may_use_files
        )

    def is_like(self, other: SpawnedAs) -> bool:
        """True when both spawn the same robot, apart from its controllers."""
        made_by = attrgetter("name", "namespace", "is_controlled", "pose", "xml")
        return bool(made_by(self) == made_by(other))


@dataclass(frozen=True)
class Snapshot:
    """The state at one time. The running simulation does not modify it."""

    time_ns: int
    cycles: int
    step_ns: int
    gravity: tuple[float, float, float]
    ground: bool
    is_from_file: bool
    """True when it was read from a file: its values may be invalid."""
    robots: list[SpawnedAs]
    features: list[str]
    """The features of which it has a state."""
    parts: dict[str, list[Any]]
    """The requests for the parts of features, by the features' names; see Feature.save_parts."""
    parameters: dict[str, Any]
    derived: list[str]
    """The parameters that no client has set."""
    world: dict[str, Any]
    entries: list[SavedObject]
    state: Any
    """The saved form of `_tree`; its objects are in `entries`."""


def capture(simulation: Simulation) -> Snapshot:
    """A snapshot of the present state.

    Raises:
        Refused: a switch is in progress, the world cannot go on, or it is inside a cycle. CannotSave: a user's class
        has a value that a snapshot cannot hold.
    """
    simulation.loop.between_cycles("save a snapshot")
    if simulation.run.trouble:
        raise Refused(f"a world that cannot go on cannot be saved: {simulation.run.trouble}", "slidectl sim reset")
    _check_settled(simulation, "save a snapshot")
    simulation.loop.settle()
    return _captured(simulation)


def _captured(simulation: Simulation) -> Snapshot:
    simulation.types.code.activate()  # `save_state` of users' classes may be called
    saving = Saving()
    state = saving.value(_tree(simulation, simulation.features.with_state()))
    return Snapshot(
        simulation.time_ns,
        simulation.cycles,
        simulation.timestep_ns,
        simulation.world.gravity,
        simulation.world.has_ground,
        False,
        [SpawnedAs.of(robot) for robot in simulation.robots],
        list(simulation.features.with_state()),
        {feature.name: parts for feature in simulation.features if (parts := feature.save_parts())},
        simulation.parameters.tree(),
        simulation.parameters.derived(),
        simulation.world.snapshot(),
        saving.entries,
        state,
    )


def restore(simulation: Simulation, snapshot: Snapshot) -> list[str]:
    """Restore a snapshot, all or nothing. Returns the names of the robots that were spawned again.

    Goals that clients have sent since then end as PREEMPTED.

    Raises:
        Refused: a switch is in progress, it is inside a cycle, or the snapshot does not fit.
    """
    simulation.loop.between_cycles("load a snapshot")
    _check_settled(simulation, "load a snapshot")
    if snapshot.ground != simulation.world.has_ground:
        option = "--ground" if snapshot.ground else "--no-ground"
        text = f"the snapshot is of a world {'with' if snapshot.ground else 'without'} ground"
        raise Refused(text, f"load it into a daemon that was started with {option}")
    simulation.loop.settle()
    present = [SpawnedAs.of(robot) for robot in simulation.robots]
    is_sure = not snapshot.is_from_file and _are_alike(present, snapshot.robots) and not _modules_of_users(simulation)
    before = None
    if not is_sure and not simulation.run.trouble:
        try:
            before = capture(simulation)
        except SlidectlError as error:
            text = f"cannot load a snapshot: after a failure, the present state could not be restored: {error.message}"
            raise Refused(text, error.hint) from None
    try:
        made = _restore(simulation, snapshot)
        if snapshot.is_from_file:  # a state that cannot be saved and loaded again is not one of a simulation
            _restore(simulation, _captured(simulation))
    except BaseException as error:
        if before is not None:
            _go_back(simulation, before)
        if isinstance(error, Exception) and not isinstance(error, SlidectlError):
            raise Refused(f"the snapshot does not fit: {type(error).__name__}: {error}") from error
        raise
    simulation.run.trouble = ""
    simulation.graph.clock_topic.publish(simulation.time_ns)
    return made


def _go_back(simulation: Simulation, before: Snapshot) -> None:
    """Restore the world after a failed restore, which may have lost any part of it."""
    try:
        _restore(simulation, before)
    except Exception:  # robots have lost parts: they are spawned again
        for name in reversed([robot.name for robot in simulation.robots]):
            simulation.robots.delete(name)
        _restore(simulation, before)


def _restore(simulation: Simulation, snapshot: Snapshot) -> list[str]:
    simulation.types.code.activate()
    with_state = _with_state(simulation, snapshot)
    for feature in simulation.features:
        feature.drop_parts()
    goals = _goals_since(simulation, snapshot)
    clock, timers = simulation.graph.clock, simulation.graph.timers
    before_ns, clock.time_ns, clock.cycles = clock.time_ns, snapshot.time_ns, snapshot.cycles
    timers.rebase(before_ns, snapshot.time_ns)
    if snapshot.step_ns != simulation.timestep_ns:
        simulation.set_timestep(snapshot.step_ns * 1e-9)
    simulation.world.set_gravity(snapshot.gravity)
    made = _make(simulation, snapshot)
    for name, parts in snapshot.parts.items():
        simulation.features[name].make_parts(parts)
    for goal in goals:
        if goal.ended_ns is None:
            goal.cancel(text=RESTORED)
    live = _tree(simulation, with_state)
    restoring = Restoring(snapshot.entries, timers, _modules_of_users(simulation))
    if snapshot.is_from_file:
        restoring.check_complete(snapshot.state, live)
    state = restoring.value(snapshot.state, live)
    for robot in simulation.robots:
        robot.node.command_warning = state["robots"][robot.name]["command_warning"]
        calls = state["robots"][robot.name]["calls"]
        for call in robot.node.calls_below():
            if call not in calls:
                call.cancel()
        for call in calls:
            call.resume()
    restoring.finish()
    for robot in simulation.robots:
        for name in robot.parts.manager.names() if robot.is_controlled else ():
            if (controller := robot.parts.manager.get(name)) is not None:
                controller.check_restored()
    for feature in simulation.features:
        feature.resume()
    simulation.world.restore(snapshot.world)
    simulation.loop.history.forget()
    return made


def _with_state(simulation: Simulation, snapshot: Snapshot) -> dict[str, Feature]:
    """The features of which the snapshot has a state. Others, which were installed since, begin anew.

    Raises UnknownFeature: the world does not have a feature of the snapshot.
    """
    wanted: dict[str, Feature] = {name: simulation.features[name] for name in snapshot.features}
    for name, feature in simulation.features.with_state().items():
        if name not in wanted:
            feature.reset()
    return wanted


def _tree(simulation: Simulation, features: dict[str, Feature]) -> dict[str, Any]:
    """The root of all objects whose state is saved."""
    return {"robots": {robot.name: _tree_of(robot) for robot in simulation.robots}, "simulation": features}


def _tree_of(robot: SpawnedRobot) -> dict[str, Any]:
    """The objects of a robot, ordered so that each comes after those it refers to: actions, ..., calls."""
    parts = robot.parts
    return {
        "actions": robot.node.servers_below(),
        **({"hardware": parts.hardware, "manager": parts.manager, "cycle": parts.cycle} if robot.is_controlled else {}),
        "start": robot.attached.start,
        "command_warning": robot.node.command_warning,
        "kept": robot.saved,
        "calls": robot.node.calls_below(),
    }


def _check_settled(simulation: Simulation, action: str) -> None:
    """Raise Refused while a switch is in progress."""
    for robot in simulation.robots:
        if robot.is_controlled and robot.services.is_busy:
            raise Refused(
                f"cannot {action}: a switch of controllers of {robot.name!r} is under way",
                "let the world run until the switch is done",
            )


def _goals_since(simulation: Simulation, snapshot: Snapshot) -> list[ActionGoal]:
    """Open goals that are not in the snapshot."""
    known = {entry.content["id"] for entry in snapshot.entries if entry.kind == ActionGoal.__qualname__}
    servers = [server for robot in simulation.robots for server in robot.node.servers_below()]
    goals = [goal for server in servers for goal in server.open_goals]
    # After the failed restore of a file anything may be in that list.
    return [goal for goal in goals if isinstance(goal, ActionGoal) and goal.id not in known]


def _modules_of_users(simulation: Simulation) -> list[ModuleType]:
    """The user modules that define the present controllers and hardware, and features."""
    simulation.types.code.activate()
    present = [feature for feature in simulation.features if is_of_a_user(type(feature))]
    found = {type(one).__module__: sys.modules[type(one).__module__] for one in present}
    for robot in simulation.robots:
        if robot.is_controlled:
            managed = [robot.parts.manager.get(name) for name in robot.parts.manager.names()]
            for one in (robot.parts.hardware, *managed):
                if is_of_a_user(type(one)):
                    found[type(one).__module__] = sys.modules[type(one).__module__]
    return list(found.values())


# -- restoring robots and controllers ----------------------------------------------------------------------------------


def _make(simulation: Simulation, snapshot: Snapshot) -> list[str]:
    """Restore the same robots and controllers, in the same order. Returns the names of the robots spawned again."""
    robots, wanted = simulation.robots, snapshot.robots
    present = [SpawnedAs.of(robot) for robot in robots]
    if _are_alike(present, wanted):
        simulation.parameters.replace(snapshot.parameters, snapshot.derived)
        return []
    for one in wanted:
        for name, type_name, _ in one.controllers:
            _check_type(simulation.types, one.name, name, type_name)
    same = _common([one.is_like(other) for one, other in zip(present, wanted, strict=False)])
    for one in reversed(present[same:]):
        robots.delete(one.name)
    kept = {}
    for one, other in zip(present[:same], wanted, strict=False):
        count = _common([mine == its for mine, its in zip(one.controllers, other.controllers, strict=False)])
        kept[one.name] = [name for name, *_ in one.controllers[:count]]
        if count < len(one.controllers):
            robots.get(one.name).manager.keep_only(kept[one.name])
    late = {name for one in wanted[same:] for name in one.made_parameters}
    simulation.parameters.replace(snapshot.parameters, snapshot.derived, late)
    for one in wanted:
        robot = robots.get(one.name) if one.name in robots else robots.spawn_read(one.parsed(), one.pose, one.hulls)
        for name, *_ in one.controllers:
            if name not in kept.get(one.name, ()):
                robot.manager.load_again(name)
    simulation.parameters.replace(snapshot.parameters, snapshot.derived)
    return [one.name for one in wanted[same:]]


def _are_alike(present: list[SpawnedAs], wanted: list[SpawnedAs]) -> bool:
    """True when the robots and their controllers are the same."""
    return len(present) == len(wanted) and all(
        one.is_like(other) and one.controllers == other.controllers for one, other in zip(present, wanted, strict=True)
    )


def _common(equal: list[bool]) -> int:
    """The number of leading True values."""
    return next((place for place, one in enumerate(equal) if not one), len(equal))


def _check_type(types: ControllerTypes, robot: str, name: str, type_name: str) -> None:
    """Raise Refused for an unknown type: a snapshot must not cause the import of a user's file."""
    try:
        types.find(type_name)
    except UnknownName:
        raise Refused(
            f"controller {name!r} of {robot!r} is a {type_name}, which is unknown here",
            "import its file first: slidectl daemon start --import FILE.py",
        ) from None
