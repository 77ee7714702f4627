"""Checks launch files: tags, parameters, robots, controllers, and the names that nodes look for.

It reads the files with the loader of `slidectl launch`, whose reading is traced, so that no rule exists twice. It also
makes the tasks, which read the arguments of their nodes. It starts nothing and runs no program.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from slidectl import description, names, paths
from slidectl.check import file_kinds, model, scenes
from slidectl.check.controllers import ControllerCheck, ParameterFile
from slidectl.check.findings import Findings
from slidectl.check.model import Model
from slidectl.check.tags import Tags, Trace, TracedElement, plain
from slidectl.description import xml_tree
from slidectl.description.gazebo_tags import TRANSMISSIONS
from slidectl.description.models import read_file
from slidectl.description.packages import Packages, is_file, shown
from slidectl.description.parser import STARTS_OUTSIDE, place_of_limit
from slidectl.description.report import did_you_mean
from slidectl.description.robot import Notice, Robot, Verdict
from slidectl.description.xml_tree import Element
from slidectl.errors import BadFile, NotThere, closest, listing
from slidectl.extensions.launch import loader
from slidectl.extensions.launch.files import LaunchFile, find
from slidectl.extensions.launch.node_kinds import tasks
from slidectl.extensions.launch.nodes.controller_nodes import Spawner
from slidectl.extensions.launch.nodes.frame_nodes import HONOURED, SEARCHED, WITHOUT_EFFECT, RobotStatePublisher
from slidectl.extensions.launch.nodes.gazebo import Gazebo
from slidectl.extensions.launch.nodes.programs import Process, ToolProcess
from slidectl.extensions.launch.nodes.spawn_model import SpawnModel
from slidectl.extensions.launch.plan import LaunchPlan, Location, Node, Remap, Setting, leaves
from slidectl.extensions.launch.task import Task

_ATTRIBUTE = re.compile(r"attribute '([^']*)'")
_JOINT_STATES = "joint_state_controller/JointStateController"
F = TypeVar("F", bound=BadFile)
Places = dict[str, tuple[str, int | None]]


def check(
    words: Sequence[str],
    arguments: Mapping[str, str],
    packages: Packages,
    findings: Findings,
    text: bytes | None = None,
    second_opinion: bool = False,
    strict: bool = False,
) -> None:
    """Add findings on launch files; `words` are those of `slidectl launch`, `text` replaces the content of the file.

    Raises:
        UsageError, UnknownName, UnknownPackage, BadFile: there is no such file, or no such argument.
    """
    sources = find(words, packages) if text is None else [LaunchFile(Path.cwd() / words[0], text, words[0])]
    run = _LaunchCheck(arguments, packages, findings, second_opinion, strict)
    try:
        run.plan = loader.load(sources, arguments, packages, parse=run.parse, missing=findings.missing)
    except BadFile as error:
        findings.fail("launch file", error)
        return
    findings.begin_with(shown(file) for file in run.plan.files)
    run.read_parameters()
    run.read_nodes()
    source = ParameterFile(sources[0].shown, run.places, findings)
    models = [robot.model for robot in run.robots if robot.model]
    controllers = ControllerCheck(source, models, run.reader, run.hint)
    controllers.check(run.tree)
    run.check_contradictions(controllers.found, controllers.claims)
    run.classify()
    findings.add_missing()
    findings.is_drivable = run.has_programs or bool(controllers.found) or bool(models)


@dataclass(frozen=True)
class PlannedRobot:
    """A robot that the launch spawns; `model` is None when it cannot be read or is not known."""

    name: str
    namespace: str | None
    model: Model | None
    node: Node


class _LaunchCheck:
    """One check. `given` are the arguments of the command line. The loader parses files with `parse`."""

    def __init__(
        self, given: Mapping[str, str], packages: Packages, findings: Findings, second_opinion: bool, strict: bool
    ) -> None:
        self.given = given
        self.packages = packages
        self.findings = findings
        self.second_opinion = second_opinion
        self.strict = strict
        self.plan = LaunchPlan()
        self.trace = Trace()
        self.roots: list[Element] = []
        """The root elements of all files."""
        self.values: dict[str, Any] = {}
        """Parameters by full name; the last value counts. None: the value is not known."""
        self.places: Places = {}
        self.descriptions: dict[str, Model | None] = {}
        """Parameters that hold a robot; None if it cannot be used."""
        self.is_complete = True
        """False when a value is not known: computing it failed, or needs a program."""
        self.tasks: list[Task] = []
        self.has_programs = False
        self.robots: list[PlannedRobot] = []

    # --- tags -----------------------------------------------------------------------------------------------------

    def parse(self, text: bytes, file: str) -> Element:
        """Parse a file into elements that record what is read of them. Raises BadFile."""
        root = TracedElement(xml_tree.read(text, file), self.trace)
        self.roots.append(root)
        return root

    def elements(self, tag: str) -> Iterator[Element]:
        """All elements with this tag whose attributes were read, other than the condition."""
        for root in self.roots:
            for element in root.walk():
                read = self.trace.read_attributes.get(id(element), set())
                if element.tag == tag and id(element) in self.trace.read and (not read or read - {"if", "unless"}):
                    yield element

    def judge_remap(self, verdict: Verdict, remap: Remap, text: str) -> None:
        """Set the verdict on a `<remap>`, which replaces that from its trace."""
        for element in self.elements("remap"):
            written = plain(element).get("from") or ""
            is_it = written.strip() == remap.source or "$(" in written
            if is_it and (element.file, element.line) == (remap.place.file, remap.place.line):
                notice = Notice(verdict, element.title, text, element.file, element.line)
                self.trace.notices.setdefault(id(element), []).append((None, notice))

    def text_at(self, place: Location) -> str:
        """The text of the `<rosparam>` at a place, with newlines before it which keep its line numbers right."""
        for element in self.elements("rosparam"):
            if (element.file, element.line) == (place.file, place.line):
                return "\n" * (element.line - 1) + element.text
        return ""

    def classify(self) -> None:
        """Add findings on all files. For shipped counterparts of ROS files only what is not used."""
        self._lead_back(self.plan.notices)
        for root in self.roots:
            own = Findings()
            Tags(self.trace, own, self._explain).classify(root)
            is_counterpart = root.file.startswith(shown(paths.share("launch") / "counterparts"))
            self.findings.extend(n for n in own.sorted() if n.verdict != "used" or not is_counterpart)
        self.findings.extend(self.plan.notices)

    def _lead_back(self, notices: list[Notice]) -> None:
        """Assign notices to their elements, by place and title."""
        by_place: dict[tuple[str, int | None, str], list[Notice]] = {}
        for notice in notices:
            by_place.setdefault((notice.file, notice.line, notice.subject), []).append(notice)
        for element in (element for root in self.roots for element in root.walk()):
            for notice in by_place.get((element.file, element.line, element.title), ()):
                match = _ATTRIBUTE.match(notice.text)
                self.trace.notices.setdefault(id(element), []).append((match[1] if match else None, notice))

    def _explain(self, element: Element, _: str) -> Iterator[Notice] | None:
        """Explain an argument that was given: its tag shows another value."""
        name = plain(element).get("name") or ""
        if element.tag != "arg" or name not in self.given or element.file != self.roots[0].file:
            return None
        text = f"{self.given[name]!r}, as given"
        return iter([Notice("used", f"argument {name}", text, element.file, element.line)])

    # --- parameters -----------------------------------------------------------------------------------------------

    def read_parameters(self) -> None:
        """Read all parameters."""
        for setting in self.plan.settings:
            self._read(setting)
        if self.is_complete:
            try:  # this reports parameters that replace each other
                self.plan.parameters(gather=True)
            except BadFile as error:
                self.findings.fail("parameters", error)

    @property
    def tree(self) -> dict[str, Any]:
        """The known parameters as a tree, without the robots' texts."""
        tree: dict[str, Any] = {}
        for full, value in self.values.items():
            if value is None or full in self.descriptions:
                continue
            *above, last = full.strip("/").split("/")
            branch: Any = tree
            for part in above:
                branch = branch.setdefault(part, {}) if isinstance(branch, dict) else {}
            if isinstance(branch, dict):
                branch[last] = value
        return tree

    def _read(self, setting: Setting) -> None:
        place = (setting.place.file, setting.place.line)
        if setting.runs_command:
            self._miss(setting)
            self.findings.add("used", setting.name, "note: a check does not run the command", *place)
            return
        try:
            value = setting.value()
            found = dict(leaves(setting.name, value, setting.place))
        except NotThere as error:
            self._miss(setting)
            self.findings.missing.note(_placed(error, setting), setting.loss)
            return
        except BadFile as error:
            self._miss(setting)
            self.findings.fail(f"parameter {setting.name}", _placed(error, setting))
            return
        for name in found:
            self.values.pop(name, None)
        self.values.update(found)
        self.places[setting.name] = place
        self.places.update(self._inner_places(setting))

    def _miss(self, setting: Setting) -> None:
        self.is_complete = False
        self.values[setting.name] = None

    def _inner_places(self, setting: Setting) -> Places:
        """The lines of the values in a YAML tree."""
        from slidectl.description import yaml_tree

        if setting.origin not in ("file", "yaml"):
            return {}
        file = shown(setting.source) if setting.source else setting.place.file
        text = read_file(Path(setting.source)) if setting.source else self.text_at(setting.place)
        try:
            lines = yaml_tree.places(text, file)
        except BadFile:  # it is YAML only after `subst_value`
            return {}
        return {names.join(setting.name, path.strip("/")): (file, line) for path, line in lines.items()}

    def _read_robot(self, name: str, xml: str) -> None:
        setting = next(setting for setting in reversed(self.plan.settings) if setting.name == name)
        file = shown(setting.source) if setting.source else f"parameter {name}"
        if self.findings.missing.keeps_going:  # check the robot as it is spawned, without missing parts
            with suppress(BadFile):  # reported when it is read
                xml = description.load(xml, {}, self.packages, missing=self.findings.missing).xml
        own = Findings()
        self.descriptions[name] = model.check_text(
            xml, file, own, self.second_opinion, self.packages, self.strict,
            self._transmission_values([task for task in self._spawns if task.parameter == name]),
        )  # fmt: skip
        self.findings.extend(replace(notice, file=shown(notice.file)) for notice in own.sorted())
        self.findings.broken += own.broken

    def _transmission_values(self, spawns: Sequence[SpawnModel]) -> model.TransmissionValues:
        """Give the values of TRANSMISSIONS for a robot that these nodes spawn."""

        def values(robot: Robot) -> Iterator[object]:
            homes = [task.home(robot, self.tasks) for task in spawns] or [description.namespace_of(robot, robot.name)]
            return (self.values.get(names.join(home, TRANSMISSIONS)) for home in homes)

        return values

    # --- nodes ----------------------------------------------------------------------------------------------------

    def read_nodes(self) -> None:
        """Make the tasks, and read the robots in parameters and those that tasks spawn."""
        self.tasks = [task for node in self.plan.nodes if (task := self._task(node)) is not None]
        self.has_programs = any(isinstance(task, Process) for task in self.tasks)
        for name, value in self.values.items():
            if isinstance(value, str) and _is_robot(value):
                self._read_robot(name, value)
        self.robots = [self._robot(task) for task in self._spawns]
        self._withdraw_starts()
        self._read_scenes()

    @property
    def _spawns(self) -> list[SpawnModel]:
        """The nodes that spawn a robot from URDF."""
        return [task for task in self.tasks if isinstance(task, SpawnModel) and not task.is_sdf]

    def _read_scenes(self) -> None:
        """Read the models of worlds, and of nodes that spawn SDF."""
        for task in self.tasks:
            if not isinstance(task, Gazebo) and not (isinstance(task, SpawnModel) and task.is_sdf):
                continue
            leaves_of = {name: (value, task.node.place) for name, value in self.values.items()}
            try:
                task.find_missing(self.plan, self.packages, leaves_of)
            except BadFile as error:
                self.findings.fail(f"node {task.node.full_name}", error)
                continue
            if task.scene is not None:
                scenes.check_scene(task.scene, self.findings, self.strict)

    def _task(self, node: Node) -> Task | None:
        """Make the task of a node, and add a finding about it."""
        try:
            made = tasks(self.plan, self.packages, gather=True, nodes=[node])
        except BadFile as error:
            self.findings.fail(
                f"node {node.full_name}", error, f"node {node.full_name} ({node.kind}): ", f"{node.full_name}: "
            )
            return None
        if not made:  # its absence is reported with the other missing things
            return None
        (task,) = made
        self._add("ignored" if task.family == "notice" else "used", node, f"{node.kind}: {task.text}")
        return task

    def _add(self, verdict: Verdict, node: Node, text: str) -> None:
        self.findings.add(verdict, f"node {node.full_name}", text, node.place.file, node.place.line)

    def _robot(self, task: SpawnModel) -> PlannedRobot:
        found = self._model(task)
        namespace = task.given_namespace
        if found is not None:
            namespace = task.home(found.robot, self.tasks)
            found = replace(found, namespace=namespace)
        return PlannedRobot(task.model, namespace, found, task.node)

    def _model(self, task: SpawnModel) -> Model | None:
        if task.words.has("-file"):
            path = Path(task.words.one("-file"))
            if is_file(path):
                return model.check(
                    path,
                    {},
                    self.packages,
                    self.findings,
                    strict=self.strict,
                    transmission_values=self._transmission_values([task]),
                )
            error = task.node.place.absence(
                f"node {task.node.full_name}: there is no file {path}", thing=f"file {path}"
            )
            self.findings.missing.note(error, f"{task.model} is left out")
            return None
        name = task.node.resolve(task.words.one("-param"))
        if name not in self.values and self.is_complete:
            hint = did_you_mean(name, self.descriptions, "{}")
            self._add("wrong", task.node, f"the launch does not set the parameter {name}{hint}")
        elif name not in self.descriptions and self.values.get(name) is not None:
            self._add("wrong", task.node, f"the parameter {name} does not hold a robot")
        return self.descriptions.get(name)

    def _withdraw_starts(self) -> None:
        """Remove findings on joints that start outside of their limits, if every spawn puts them inside (-J)."""
        outside: dict[tuple[str, str, int | None], bool] = {}
        for spawned, task in zip(self.robots, self._spawns, strict=True):
            for joint in spawned.model.robot.joints.values() if spawned.model is not None else ():
                if joint.limit is not None:
                    place = place_of_limit(joint.name), shown(joint.file or ""), joint.limit.line
                    is_inside = joint.limit.lower <= task.start_of(joint.name) <= joint.limit.upper
                    outside[place] = outside.get(place, False) or not is_inside
        self.findings.withdraw(
            notice
            for notice in self.findings.sorted()
            if notice.text.startswith(STARTS_OUTSIDE)
            and not outside.get((notice.subject, shown(notice.file), notice.line), True)
        )

    def reader(self, name: str) -> str | None:
        """The node that reads a parameter which no controller reads, as text; None when there is none."""
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
        """A hint on a node's unread parameter, `; ...`: a similar name, or why it has no effect. Else an empty text."""
        for task in self.tasks:
            if isinstance(task, RobotStatePublisher) and names.parent(name) == task.node.full_name:
                own = name.rpartition("/")[2]
                known = (*HONOURED, *WITHOUT_EFFECT)
                return f"; {WITHOUT_EFFECT[own]}" if own in WITHOUT_EFFECT else did_you_mean(own, known)
        return ""

    def check_contradictions(self, controllers: Mapping[str, str], claims: Mapping[str, set[str]]) -> None:
        """Add findings on contradictions. `controllers` maps full names to types, `claims` maps them to joints."""
        self._check_same_names()
        self._check_namespaces(controllers)
        for task in self.tasks:
            if isinstance(task, Spawner):
                self._check_spawner(task, controllers)
                self._check_same_joints(task, claims)
            elif isinstance(task, RobotStatePublisher):
                self._check_joint_states(task, controllers)
        self._check_loaded_twice()
        self._check_remaps()

    def _check_loaded_twice(self) -> None:
        """Find controllers that two spawners load: the second load is refused."""
        seen: dict[str, Node] = {}
        for task in self.tasks:
            for name in _loaded(task):
                other = seen.setdefault(name, task.node)
                if other is not task.node:
                    text = f"loads {name}, which the node at {other.place} loads too: the second one is refused"
                    self._add("wrong", task.node, text)

    def _check_same_names(self) -> None:
        """Find robots with the same name or the same namespace."""
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

    def _check_namespaces(self, controllers: Mapping[str, str]) -> None:
        """Find controllers in a namespace without a robot."""
        homes = self._namespaces()
        if not homes or len(homes) != len(self.robots):
            return
        elsewhere = {
            names.parent(name) for name in controllers if not any(names.is_under(name, home) for home in homes)
        }
        for namespace in sorted(elsewhere):
            text = f"controllers are set here, but the robots of this launch live in {listing(homes)}"
            place = self.places.get(namespace) or (shown(self.plan.files[0]), None)
            self.findings.add("wrong", f"namespace {namespace}", text, *place)

    def _check_spawner(self, task: Spawner, controllers: Mapping[str, str]) -> None:
        homes = self._namespaces()
        if homes and len(homes) == len(self.robots) and task.namespace not in homes:
            near = closest(task.namespace, homes) or homes[0]
            text = f"waits for a controller manager in {task.namespace}; the robots of this launch live in "
            self._add("wrong", task.node, f'{text}{listing(homes)}; did you mean ns="{near}"?')
        for word in task.words.rest:
            name = names.join(task.namespace, word)
            if name not in controllers and not is_file(Path(word)) and self.is_complete:
                inside = [other for other in controllers if names.is_under(other, task.namespace)]
                hint = did_you_mean(name, inside or controllers, "{}") or f"; controllers: {listing(controllers)}"
                self._add("wrong", task.node, f"the launch sets no controller {name}{hint}")

    def _check_same_joints(self, task: Spawner, claims: Mapping[str, set[str]]) -> None:
        """Find controllers of one spawner that claim the same joint."""
        holders: dict[str, str] = {}
        for name in [] if task.words.has("--stopped") else _loaded(task):
            for joint in sorted(claims.get(name, ())):
                holder = holders.setdefault(joint, name)
                if holder != name:
                    text = f"cannot start {name} beside {holder}: both want joint {joint!r} for themselves"
                    self._add("wrong", task.node, text)

    def _check_joint_states(self, task: RobotStatePublisher, controllers: Mapping[str, str]) -> None:
        """Find a robot_state_publisher whose joint states are not published."""
        topic = task.node.resolve("joint_states")
        there = sorted({names.join(names.parent(name), "joint_states") for name in self._publishers(controllers)})
        if not there:
            idle = next((name for name, kind in controllers.items() if kind == _JOINT_STATES), None)
            hint = f"; {idle} would, and no spawner of this launch starts it" if idle is not None else ""
            self._add("used", task.node, f"note: nothing in this launch publishes {topic}{hint}")
            return
        if topic in there:
            return
        remap = task.node.remap_of("joint_states")
        end = f"{topic}, which has no publisher; did you mean {closest(topic, there) or there[0]}?"
        if remap is None:
            self._add("wrong", task.node, f"it listens to {end}")
        else:
            self.judge_remap("wrong", remap, f"{task.node.full_name} listens to {end}")

    def _publishers(self, controllers: Mapping[str, str]) -> Iterator[str]:
        """The joint state controllers that a spawner of the launch starts."""
        for task in self.tasks:
            yield from (name for name in _loaded(task) if controllers.get(name) == _JOINT_STATES)

    def _check_remaps(self) -> None:
        """Find remaps that no node uses."""
        used = {remap for task in self.tasks for remap in _used_remaps(task)}
        there = {remap for node in self.plan.nodes for remap in node.remaps}
        known = {name for task in self.tasks for name in _names_of(task)}
        for remap in there - used:
            hint = did_you_mean(remap.source, known)
            self.judge_remap("ignored", remap, f"no node that it is for has the name {remap.source!r}{hint}")
        places = {(remap.place.file, remap.place.line) for remap in there}
        for element in self.elements("remap"):
            if (element.file, element.line) not in places:
                source = plain(element).get("from") or ""
                lonely = Remap(source.strip(), "", Location(element.file, element.line))
                self.judge_remap("ignored", lonely, "no node comes after it")


def _is_robot(text: str) -> bool:
    try:
        return text.lstrip("\ufeff \t\r\n").startswith("<") and file_kinds.of_text(text.encode(), "") == "model"
    except BadFile:
        return False


def _placed(error: F, setting: Setting) -> F:
    """The error, placed at the tag if it has no line."""
    if error.line is not None:
        return error
    return type(error)(error.message, setting.place.file, setting.place.line, error.hint)


def _used_remaps(task: Task) -> Iterator[Remap]:
    node = task.node
    known = {node.absolute(name) for name in _names_of(task)}
    for remap in node.remaps:
        is_program = isinstance(task, Process) and not isinstance(task, ToolProcess)
        if is_program or node.absolute(remap.source) in known:
            yield remap


def _loaded(task: Task) -> list[str]:
    """The full names of the controllers that a spawner loads; of other tasks none."""
    return [names.join(task.namespace, word) for word in task.words.rest] if isinstance(task, Spawner) else []


def _names_of(task: Task) -> list[str]:
    """The names that a node looks up, as written in its arguments."""
    if isinstance(task, SpawnModel):
        return [task.words.one("-param")] if task.words.has("-param") else []
    if isinstance(task, Spawner):
        return [task.words.one("--wait-for")] if task.words.has("--wait-for") else []
    if isinstance(task, ToolProcess):
        return [word for word in task.node.words[1:] if names.is_legal(word)] if task.node.type == "rostopic" else []
    return ["joint_states", "robot_description"] if isinstance(task, RobotStatePublisher) else []
