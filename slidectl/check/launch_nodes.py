"""The nodes of a launch and what they look for: robots to spawn, controllers to load, topics to listen to.

Makes the launch room's own tasks, which read the arguments of their nodes. Nothing is started.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from slidectl import names
from slidectl.check import model
from slidectl.check.findings import Findings
from slidectl.check.launch_parameters import LaunchParameters
from slidectl.check.launch_tags import LaunchTags
from slidectl.check.model import Model
from slidectl.check.tags import plain
from slidectl.description.packages import Packages, is_file
from slidectl.description.parser import STARTS_OUTSIDE, place_of_limit
from slidectl.description.robot import Verdict
from slidectl.errors import BadFile, closest, listing
from slidectl.launch.files import shown
from slidectl.launch.kinds import tasks
from slidectl.launch.nodes.process import Process
from slidectl.launch.nodes.spawn_model import SpawnModel
from slidectl.launch.nodes.spawner import Spawner
from slidectl.launch.nodes.state_publishers import HONOURED, SEARCHED, WITHOUT_EFFECT, RobotStatePublisher
from slidectl.launch.nodes.tools import Tool
from slidectl.launch.plan import Node, Place, Plan, Remap
from slidectl.launch.task import Task

_JOINT_STATES = "joint_state_controller/JointStateController"
_VERDICTS: dict[str, Verdict] = {"refused": "wrong", "notice": "ignored"}


@dataclass(frozen=True)
class SpawnedOnPaper:
    """A robot that the launch puts into the world; `model` is None when it cannot be read or is not known here."""

    name: str
    namespace: str | None
    model: Model | None
    node: Node


class LaunchNodes:
    """The nodes of a plan as tasks, and the robots among them."""

    def __init__(
        self, plan: Plan, parameters: LaunchParameters, packages: Packages, findings: Findings, strict: bool = False
    ) -> None:
        self.plan = plan
        self.parameters = parameters
        self.packages = packages
        self.findings = findings
        self.strict = strict
        self.tasks = [task for node in plan.nodes if (task := self._task(node)) is not None]
        self.robots = [self._robot(task) for task in self.tasks if isinstance(task, SpawnModel)]
        self._withdraw_starts()
        self.has_programs = any(isinstance(task, Process) for task in self.tasks)

    def _task(self, node: Node) -> Task | None:
        """What the node is here, with a finding that says so."""
        try:
            made = tasks(self.plan, self.packages, gather=True, nodes=[node])
        except BadFile as error:
            self.findings.fail(
                f"node {node.full_name}", error, f"node {node.full_name} ({node.kind}): ", f"{node.full_name}: "
            )
            return None
        if not made:  # what it lacks is told with all that is not there
            return None
        (task,) = made
        self._add(_VERDICTS.get(task.family, "used"), node, f"{node.kind}: {task.text}")
        return task

    def _add(self, verdict: Verdict, node: Node, text: str) -> None:
        self.findings.add(verdict, f"node {node.full_name}", text, node.place.file, node.place.line)

    # --- robots -------------------------------------------------------------------------------------------------------

    def _robot(self, task: SpawnModel) -> SpawnedOnPaper:
        found = self._model(task)
        namespace = task.asked_namespace
        if found is not None:
            namespace = task.home(found.robot, self.plan.nodes)
            found = replace(found, namespace=namespace)
        return SpawnedOnPaper(task.model, namespace, found, task.node)

    def _model(self, task: SpawnModel) -> Model | None:
        if task.words.has("-file"):
            path = Path(task.words.one("-file"))
            if is_file(path):
                return model.check(path, {}, self.packages, self.findings, strict=self.strict)
            error = task.node.place.absence(
                f"node {task.node.full_name}: there is no file {path}", thing=f"file {path}"
            )
            self.findings.missing.note(error, f"{task.model} is left out")
            return None
        name = task.node.resolve(task.words.one("-param"))
        if name not in self.parameters.values and self.parameters.is_complete:
            near = closest(name, self.parameters.robots)
            hint = f"; did you mean {near}?" if near else ""
            self._add("wrong", task.node, f"the launch does not set the parameter {name}{hint}")
        elif name not in self.parameters.robots and self.parameters.values.get(name) is not None:
            self._add("wrong", task.node, f"the parameter {name} holds no robot")
        return self.parameters.robots.get(name)

    def _withdraw_starts(self) -> None:
        """A joint that every spawn of a robot puts between its limits (-J) does not start outside of them."""
        spawns = [task for task in self.tasks if isinstance(task, SpawnModel)]
        put: dict[int, list[SpawnModel]] = {}
        for spawned, task in zip(self.robots, spawns, strict=True):
            if spawned.model is not None:
                put.setdefault(id(spawned.model.robot), []).append(task)
        for spawned in self.robots:
            for joint in spawned.model.robot.joints.values() if spawned.model is not None else ():
                starts = [task.start_of(joint.name) for task in put[id(spawned.model.robot)]]  # type: ignore[union-attr]
                if joint.limit and all(joint.limit.lower <= start <= joint.limit.upper for start in starts):
                    said = (notice for notice in self.findings.sorted() if notice.subject == place_of_limit(joint.name))
                    self.findings.withdraw(notice for notice in said if notice.text.startswith(STARTS_OUTSIDE))

    # --- who reads parameters -----------------------------------------------------------------------------------------

    def reader(self, name: str) -> str | None:
        """Which node reads a parameter that no controller reads; None when none does."""
        for robot in self.robots:
            if name.endswith("/tf_prefix") and robot.namespace and names.is_under(robot.namespace, names.parent(name)):
                return f"for the frames of {robot.name}"
        for task in self.tasks:
            node = task.node.full_name
            is_above = names.is_under(node, names.parent(name)) and name.rpartition("/")[2] in SEARCHED
            if isinstance(task, RobotStatePublisher) and is_above:
                return f"for node {node}"
            if not names.is_under(name, node):
                continue
            own = name[len(node) + 1 :]
            if isinstance(task, Process) or (isinstance(task, RobotStatePublisher) and own in HONOURED):
                return f"for node {node}"
            return None
        return "note: no controller reads it; a program of this launch may" if self.has_programs else None

    def hint(self, name: str) -> str:
        """Which parameter of a node may have been meant by one that it does not read, or why that has no effect."""
        for task in self.tasks:
            if isinstance(task, RobotStatePublisher) and names.parent(name) == task.node.full_name:
                own = name.rpartition("/")[2]
                near = closest(own, (*HONOURED, *WITHOUT_EFFECT))
                return WITHOUT_EFFECT.get(own) or (f"did you mean {near!r}?" if near else "")
        return ""

    # --- what they look for -------------------------------------------------------------------------------------------

    def tell(self, controllers: Mapping[str, str], claims: Mapping[str, set[str]], tags: LaunchTags) -> None:
        """Findings on what fits nothing. `controllers` are full names and types in the parameters, `claims` joints."""
        self._tell_twins()
        self._tell_namespaces(controllers)
        for task in self.tasks:
            if isinstance(task, Spawner):
                self._tell_spawner(task, controllers)
                self._tell_rivals(task, claims)
            elif isinstance(task, RobotStatePublisher):
                self._tell_joint_states(task, controllers, tags)
        self._tell_loaded_twice()
        self._tell_remaps(tags)

    def _tell_loaded_twice(self) -> None:
        """Controllers that two spawners load: the second one is refused."""
        seen: dict[str, Node] = {}
        for task in self.tasks:
            for name in _loaded(task):
                other = seen.setdefault(name, task.node)
                if other is not task.node:
                    text = f"loads {name}, which the node at {other.place} loads too: whoever is second is refused"
                    self._add("wrong", task.node, text)

    def _tell_twins(self) -> None:
        """Two robots of one name, or in one namespace."""
        for what in ("name", "namespace"):
            seen: dict[str, Node] = {}
            for robot in self.robots:
                value = getattr(robot, what)
                other = seen.setdefault(value, robot.node) if value is not None else robot.node
                if other is not robot.node:
                    text = f"spawns a second robot with the {what} {value}; the first one is spawned at {other.place}"
                    self._add("wrong", robot.node, text)

    def _namespaces(self) -> list[str]:
        return [robot.namespace for robot in self.robots if robot.namespace is not None]

    def _tell_namespaces(self, controllers: Mapping[str, str]) -> None:
        """Controllers in a namespace where no robot of the launch lives."""
        homes = self._namespaces()
        if not homes or len(homes) != len(self.robots):
            return
        strays = {names.parent(name) for name in controllers if not any(names.is_under(name, home) for home in homes)}
        for namespace in sorted(strays):
            text = f"controllers are set here, but the robots of this launch live in {listing(homes)}"
            place = self.parameters.places.get(namespace) or (shown(self.plan.files[0]), None)
            self.findings.add("wrong", f"namespace {namespace}", text, *place)

    def _tell_spawner(self, task: Spawner, controllers: Mapping[str, str]) -> None:
        homes = self._namespaces()
        if homes and len(homes) == len(self.robots) and task.namespace not in homes:
            near = closest(task.namespace, homes) or homes[0]
            text = f"waits for a controller manager in {task.namespace}; the robots of this launch live in "
            self._add("wrong", task.node, f'{text}{listing(homes)}; did you mean ns="{near}"?')
        for word in task.words.rest:
            name = names.join(task.namespace, word)
            if name not in controllers and not is_file(Path(word)) and self.parameters.is_complete:
                self._add("wrong", task.node, self._unknown_controller(name, task.namespace, controllers))

    def _tell_rivals(self, task: Spawner, claims: Mapping[str, set[str]]) -> None:
        """Controllers that one spawner starts, and that want the same joint."""
        holders: dict[str, str] = {}
        for name in [] if task.words.has("--stopped") else _loaded(task):
            for joint in sorted(claims.get(name, ())):
                holder = holders.setdefault(joint, name)
                if holder != name:
                    text = f"cannot start {name} beside {holder}: both want joint {joint!r} for themselves"
                    self._add("wrong", task.node, text)

    def _unknown_controller(self, name: str, namespace: str, controllers: Mapping[str, str]) -> str:
        inside = [other for other in controllers if names.is_under(other, namespace)]
        near = closest(name, inside or controllers)
        hint = f"; did you mean {near}?" if near else f"; controllers: {listing(controllers)}"
        return f"the launch sets no controller {name}{hint}"

    def _tell_joint_states(self, task: RobotStatePublisher, controllers: Mapping[str, str], tags: LaunchTags) -> None:
        """The tutorial's slip: joint states are awaited where nobody publishes them."""
        topic = task.node.resolve("joint_states")
        there = sorted({names.join(names.parent(name), "joint_states") for name in self._publishers(controllers)})
        if not there:
            idle = next((name for name, kind in controllers.items() if kind == _JOINT_STATES), None)
            hint = f"; {idle} would, and no spawner of this launch starts it" if idle is not None else ""
            self._add("used", task.node, f"note: nothing in this launch publishes {topic}{hint}")
            return
        if topic in there:
            return
        awaited = task.node.absolute("joint_states")
        remap = next((r for r in reversed(task.node.remaps) if task.node.absolute(r.source) == awaited), None)
        end = f"{topic}, which nobody publishes; did you mean {closest(topic, there) or there[0]}?"
        if remap is None:
            self._add("wrong", task.node, f"it listens to {end}")
        else:
            tags.say_of_remap("wrong", remap, f"{task.node.full_name} listens to {end}")

    def _publishers(self, controllers: Mapping[str, str]) -> Iterator[str]:
        """The joint state controllers that a spawner of the launch starts."""
        for task in self.tasks:
            yield from (name for name in _loaded(task) if controllers.get(name) == _JOINT_STATES)

    def _tell_remaps(self, tags: LaunchTags) -> None:
        """Remaps that no node makes use of."""
        used = {remap for task in self.tasks for remap in self._used_remaps(task)}
        there = {remap for node in self.plan.nodes for remap in node.remaps}
        known = {name for task in self.tasks for name in _names_of(task)}
        for remap in there - used:
            near = closest(remap.source, known)
            suggestion = f"; did you mean {near!r}?" if near else ""
            tags.say_of_remap("ignored", remap, f"no node that it is for has the name {remap.source!r}{suggestion}")
        places = {(remap.place.file, remap.place.line) for remap in there}
        for element in tags.elements("remap"):
            if (element.file, element.line) not in places:
                source = plain(element).get("from") or ""
                lonely = Remap(source.strip(), "", Place(element.file, element.line))
                tags.say_of_remap("ignored", lonely, "no node comes after it")

    def _used_remaps(self, task: Task) -> Iterator[Remap]:
        node = task.node
        known = {node.absolute(name) for name in _names_of(task)}
        for remap in node.remaps:
            is_program = isinstance(task, Process) and not isinstance(task, Tool)
            if is_program or node.absolute(remap.source) in known:
                yield remap


def _loaded(task: Task) -> list[str]:
    """The full names of the controllers that a spawner loads."""
    return [names.join(task.namespace, word) for word in task.words.rest] if isinstance(task, Spawner) else []


def _names_of(task: Task) -> list[str]:
    """The names that a node looks up, as it writes them."""
    if isinstance(task, SpawnModel):
        return [task.words.one("-param")] if task.words.has("-param") else []
    if isinstance(task, Spawner):
        return [task.words.one("--wait-for")] if task.words.has("--wait-for") else []
    if isinstance(task, Tool):
        return [word for word in task.node.words[1:] if names.is_legal(word)] if task.node.type == "rostopic" else []
    return ["joint_states", "robot_description"] if isinstance(task, RobotStatePublisher) else []
