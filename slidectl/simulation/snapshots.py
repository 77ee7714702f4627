"""Snapshots: the whole state of a simulation at one time, from which it continues with the same bits.

Loading first restores robots and controllers, by deleting and creating those that differ, and creates all faults
again; then it restores the numbers. When the same robots and controllers exist, it only restores the numbers. Speed
and pause do not change; nor do clients: their waits keep the remaining time.

Code that adds a part to robots or to the simulation must register it in `SpawnedRobot.kept` or `Simulation.kept`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar

from slidectl import description, names
from slidectl.control.registry import ControllerTypes
from slidectl.control.user_classes import is_of_a_user
from slidectl.description import source_note
from slidectl.errors import BadName, Refused, SlidectlError, UnknownName
from slidectl.physics.hulls import Hulls
from slidectl.rotations import Pose
from slidectl.simulation.action_server import ActionGoal
from slidectl.simulation.faults import FaultRequest
from slidectl.simulation.saved_state import Restoring, SavedObject, Saving
from slidectl.simulation.spawned_robots import ParsedRobot, SpawnedRobot

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

PUT_BACK = "The simulation was put back to a time before this goal was sent"


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
    controllers: list[tuple[str, str]]
    """Names and types in load order."""

    @classmethod
    def of(cls, robot: SpawnedRobot) -> SpawnedAs:
        """The inputs of this robot's spawn."""
        return cls(
            robot.name,
            robot.namespace,
            robot.xml,
            robot.is_controlled,
            robot.body.spawn_pose,
            robot.note,
            robot.caller,
            robot.may_use_files,
            robot.body.hulls,
            list(robot.made_parameters),
            list(robot.parts.manager.loaded()) if robot.is_controlled else [],
        )

    def parsed(self) -> ParsedRobot:
        """The parsed robot, to be spawned again."""
        paper = description.parse(source_note.join(self.xml, self.note), may_use_files=self.may_use_files)
        place = names.check(self.namespace)
        return ParsedRobot(
            self.name, place, paper, self.xml, self.note, self.caller, self.is_controlled, self.may_use_files
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
    faults: list[FaultRequest]
    parameters: dict[str, Any]
    derived: list[str]
    """The parameters that no client has set."""
    world: dict[str, Any]
    entries: list[SavedObject]
    state: Any
    """The saved form of `_tree`; its objects are in `entries`."""


def take(simulation: Simulation) -> Snapshot:
    """A snapshot of the present state.

    Raises:
        Refused: a switch is in progress, the world cannot go on, or it is inside a cycle. CannotSave: a user's class
        has a value that a snapshot cannot hold.
    """
    simulation.loop.between_cycles("save a snapshot")
    if simulation.run.trouble:
        raise Refused(f"a world that cannot go on is not saved: {simulation.run.trouble}", "slidectl sim reset")
    _check_settled(simulation, "save a snapshot")
    simulation.loop.settle()
    return _taken(simulation)


def _taken(simulation: Simulation) -> Snapshot:
    simulation.types.code.activate()  # `save_state` of users' classes may be called
    saving = Saving()
    state = saving.value(_tree(simulation))
    return Snapshot(
        simulation.time_ns,
        simulation.cycles,
        simulation.timestep_ns,
        simulation.world.gravity,
        simulation.world.has_ground,
        False,
        [SpawnedAs.of(robot) for robot in simulation.robots],
        simulation.faults.asked(),
        simulation.parameters.tree(),
        simulation.parameters.derived(),
        simulation.world.snapshot(),
        saving.entries,
        state,
    )


def put(simulation: Simulation, snapshot: Snapshot) -> list[str]:
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
            before = take(simulation)
        except SlidectlError as error:
            text = f"cannot load a snapshot: should that fail, the world could not be as it is now: {error.message}"
            raise Refused(text, error.hint) from None
    kept = dict(simulation.kept)
    try:
        made = _put(simulation, snapshot)
        if snapshot.is_from_file:  # what cannot be saved and loaded again is no state of a simulation
            _put(simulation, _taken(simulation))
    except BaseException as error:
        if before is not None:
            _go_back(simulation, before, kept)
        if isinstance(error, Exception) and not isinstance(error, SlidectlError):
            raise Refused(f"the snapshot does not fit: {type(error).__name__}: {error}") from error
        raise
    simulation.run.trouble = ""
    simulation.graph.clock_topic.publish_now(simulation.time_ns)
    return made


def _go_back(simulation: Simulation, before: Snapshot, kept: dict[str, object]) -> None:
    """Restore the world after a failed restore, which may have lost any part of it. `kept` is what it had."""
    simulation.kept.clear()
    simulation.kept.update(kept)
    try:
        _put(simulation, before)
    except Exception:  # robots have lost parts: they are spawned again
        for name in reversed([robot.name for robot in simulation.robots]):
            simulation.robots.delete(name)
        _put(simulation, before)


def _put(simulation: Simulation, snapshot: Snapshot) -> list[str]:
    simulation.types.code.activate()
    simulation.faults.remove()
    goals = _goals_since(simulation, snapshot)
    clock, timers = simulation.graph.clock, simulation.graph.timers
    before_ns, clock.time_ns, clock.cycles = clock.time_ns, snapshot.time_ns, snapshot.cycles
    timers.rebase(before_ns, snapshot.time_ns)
    if snapshot.step_ns != simulation.timestep_ns:
        simulation.set_timestep(snapshot.step_ns * 1e-9)
    simulation.world.set_gravity(snapshot.gravity)
    made = _make(simulation, snapshot)
    simulation.faults.make(snapshot.faults)
    for goal in goals:
        if goal.ended_ns is None:
            goal.cancel(text=PUT_BACK)
    live = _tree(simulation)
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
    simulation.faults.go_on()
    simulation.world.restore(snapshot.world)
    simulation.loop.history.forget()
    return made


def _tree(simulation: Simulation) -> dict[str, Any]:
    """The root of all objects whose state is saved."""
    return {"robots": {robot.name: _tree_of(robot) for robot in simulation.robots}, "simulation": simulation.kept}


def _tree_of(robot: SpawnedRobot) -> dict[str, Any]:
    """The objects of a robot, ordered so that each comes after those it refers to: actions, ..., calls."""
    parts = robot.parts
    return {
        "actions": robot.node.servers_below(),
        **({"hardware": parts.hardware, "manager": parts.manager, "cycle": parts.cycle} if robot.is_controlled else {}),
        "start": robot.body.start,
        "command_warning": robot.node.command_warning,
        "kept": robot.kept,
        "calls": robot.node.calls_below(),
    }


def _check_settled(simulation: Simulation, action: str) -> None:
    """Raise Refused while a switch is in progress."""
    for robot in simulation.robots:
        if robot.is_controlled and robot.services.is_busy:
            raise Refused(
                f"cannot {action}: a switch of controllers of {robot.name!r} is under way",
                "let the world go on until it is done",
            )


def _goals_since(simulation: Simulation, snapshot: Snapshot) -> list[ActionGoal]:
    """Open goals that are not in the snapshot."""
    known = {entry.content["id"] for entry in snapshot.entries if entry.kind == ActionGoal.__qualname__}
    servers = [server for robot in simulation.robots for server in robot.node.servers_below()]
    goals = [goal for server in servers for goal in server.open_goals]
    # After the failed restore of a file anything may be in that list.
    return [goal for goal in goals if isinstance(goal, ActionGoal) and goal.id not in known]


def _modules_of_users(simulation: Simulation) -> list[ModuleType]:
    """The user modules that define the present controllers and hardware."""
    simulation.types.code.activate()
    found = {}
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
        for name, type_name in one.controllers:
            _check_type(simulation.types, one.name, name, type_name)
    same = _common([one.is_like(other) for one, other in zip(present, wanted, strict=False)])
    for one in reversed(present[same:]):
        robots.delete(one.name)
    kept = {}
    for one, other in zip(present[:same], wanted, strict=False):
        count = _common([mine == its for mine, its in zip(one.controllers, other.controllers, strict=False)])
        kept[one.name] = [name for name, _ in one.controllers[:count]]
        if count < len(one.controllers):
            robots.get(one.name).manager.keep_only(kept[one.name])
    late = {name for one in wanted[same:] for name in one.made_parameters}
    simulation.parameters.replace(snapshot.parameters, snapshot.derived, late)
    for one in wanted:
        robot = robots.get(one.name) if one.name in robots else robots.spawn_read(one.parsed(), one.pose, one.hulls)
        for name, _ in one.controllers:
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
            f"controller {name!r} of {robot!r} is a {type_name}, which is not known here",
            "import its file first: slidectl daemon start --import FILE.py",
        ) from None


# -- by name -----------------------------------------------------------------------------------------------------------


class Snapshots:
    """The snapshots of one simulation, by name, in the order of their saving."""

    MOST: ClassVar[int] = 1000

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._kept: dict[str, Snapshot] = {}

    def __iter__(self) -> Any:
        return iter(tuple(self._kept.items()))

    def get(self, name: str) -> Snapshot:
        """The snapshot. Raises UnknownName."""
        if name not in self._kept:
            raise UnknownName("snapshot", name, list(self._kept))
        return self._kept[name]

    def save(self, name: str, first: Callable[[Snapshot], None] = lambda _: None) -> Snapshot:
        """Save the present state under the name, after `first` was called with it. An older one is replaced.

        Raises as `take`, the errors of `first`, and BadName; then nothing has changed.
        """
        if not names.is_component(name):
            raise BadName(name, "name of a snapshot: letters, digits and '_', and the first is a letter")
        if len(self._kept) >= self.MOST and name not in self._kept:
            raise Refused(f"there are {self.MOST} snapshots, which is the most", "slidectl sim delete NAME")
        snapshot = take(self._simulation)
        first(snapshot)
        self._kept.pop(name, None)
        self._kept[name] = snapshot
        return snapshot

    def load(self, name: str) -> list[str]:
        """Restore a snapshot. Returns the names of the robots spawned again. Raises UnknownName, and as `put`."""
        return put(self._simulation, self.get(name))

    def delete(self, name: str) -> None:
        """Delete a snapshot. Raises UnknownName."""
        self.get(name)
        del self._kept[name]
