"""gazebo_ros/spawn_model: spawns a robot from URDF, or a model from SDF, in a parameter or a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from slidectl import description, names, rotations
from slidectl.client import spawning
from slidectl.description import sdf, source_note
from slidectl.description.packages import Packages, is_file, shown
from slidectl.description.parser import is_moved_inside
from slidectl.description.report import is_important
from slidectl.description.robot import Robot
from slidectl.errors import BadFile, NotThere, Refused, UnknownName, listing
from slidectl.extensions.launch.plan import LaunchPlan, Leaf, Node
from slidectl.extensions.launch.task import HOOK_LIMIT_S, SPAWN_LIMIT_S, Run, Task, Words, number, parse

_OPTIONS = {
    "-urdf": 0, "-sdf": 0, "-trimesh": 0, "-file": 1, "-param": 1, "-database": 1, "-stdin": 0, "-model": 1,
    "-robot_namespace": 1, "-gazebo_namespace": 1, "-reference_frame": 1, "-x": 1, "-y": 1, "-z": 1, "-R": 1,
    "-P": 1, "-Y": 1, "-J": 2, "-unpause": 0, "-wait": 1, "-package_to_model": 0, "-b": 0, "-v": 0, "--verbose": 0,
}  # fmt: skip
_REFUSED = {
    "-trimesh": "only URDF and SDF can be spawned, and this is a bare mesh",
    "-stdin": "nodes of a launch file have no standard input",
}


def _joined(words: Sequence[str], surplus: Sequence[str]) -> str | None:
    """A hint for a name whose underscores became blanks; None when the surplus words follow no value."""
    at = words.index(surplus[0]) if surplus[0] in words else 0
    if at < 2 or not words[at - 2].startswith("-"):
        return None
    return f"names have no spaces: did you mean {words[at - 2]} {'_'.join([words[at - 1], *surplus])}?"


class SpawnModel(Task):
    """The spawn script. With `-b` it stays as a node, and the robot is deleted at its end.

    When a launch fails, its robot is also deleted from a world that was running before.
    """

    family = "robot"

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self.words = words = parse(node, _OPTIONS)
        for option, reason in _REFUSED.items():
            if words.has(option):
                raise self.error(f"{option}: {reason}", "describe the robot in URDF or xacro")
        self.is_sdf = words.has("-sdf")
        if words.has("-database") and not self.is_sdf:
            raise self.error("-database NAME is model://NAME, which is SDF", "use -sdf instead of -urdf")
        if sum(words.has(option) for option in ("-file", "-param", "-database")) != 1:
            raise self.error("takes one of -param NAME and -file FILE, or with -sdf -database NAME")
        if words.rest:
            raise self.error(f"does not understand {' '.join(words.rest)!r}", _joined(node.words, words.rest))
        if not words.one("-model"):
            raise self.error("needs a name for the robot: -model NAME")
        if words.one("-gazebo_namespace", "/gazebo").strip("/") != "gazebo":
            text = f"-gazebo_namespace {words.one('-gazebo_namespace')} has no effect: there is one world, in /gazebo"
            plan.notice("converted", node.place, node.full_name, text)
        self.given_name = words.one("-model")
        self.model = names.legal_robot(self.given_name)
        self.pose = _pose(words)
        self.scene: sdf.Scene | None = None
        """The scene of an SDF model; set by `find_missing`."""
        self.parts: list[str] = []
        """The names in the world: several if links of an SDF model are not connected by joints."""
        self.joints = {
            joint.removeprefix(f"{self.given_name}::"): number(node, f"-J {joint}", value)
            for joint, value in words.given.get("-J", [])
        }
        """Initial joint positions, in rad or m, by joint name without the model's name."""
        self.bound = self.keeps_running = self.needs_presence = words.has("-b")

    def start_of(self, joint: str) -> float:
        """The initial position of a joint, which -J sets by the joint's name or `robot::joint`; else 0."""
        return next((value for name, value in self.joints.items() if name.rpartition("::")[2] == joint), 0.0)

    @property
    def given_namespace(self) -> str | None:
        """The namespace in `-robot_namespace`, from the root: Gazebo does not know the groups of launch files."""
        asked = self.words.one("-robot_namespace")
        return names.join("/", asked).rstrip("/") or "/" if asked else None

    def home(self, robot: description.Robot, tasks: Sequence[Task]) -> str:
        """The namespace that the robot gets in a launch with these tasks.

        If its plugin sets none, spawn_model sets the node's own; without that it is the model's name. Which one the
        launch file expects is seen from the nodes that use a controller manager. Without controllers it is the node's.
        """
        if self.given_namespace is not None:
            return self.given_namespace
        if robot.ros2_control is not None:  # its manager is where the plugin has it
            return description.namespace_of(robot, self.model)
        is_open = robot.plugin is not None and robot.plugin.robot_namespace is None
        is_free = robot.plugin is None and not robot.transmissions and bool(robot.drives or robot.sensors)
        managers = {task.manager_namespace for task in tasks}
        own = names.legal_namespace(self.given_name)
        is_spoken_to = self.node.namespace in managers and own not in managers
        if is_free or (is_open and is_spoken_to):
            return self.node.namespace
        return own if is_open or robot.plugin is None else description.namespace_of(robot, self.model)

    @property
    def text(self) -> str:
        return f"spawn {self.model} from {self._source}"

    @property
    def _source(self) -> str:
        for option, what in (("-file", "file "), ("-database", sdf.SCHEME)):
            if self.words.has(option):
                return what + self.words.one(option)
        return f"parameter {self.parameter}"

    @property
    def parameter(self) -> str | None:
        """The full name of the parameter with the description; None if it is in a file."""
        return self.node.resolve(self.words.one("-param")) if self.words.has("-param") else None

    def find_missing(self, plan: LaunchPlan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:
        if self.words.has("-database"):
            self._read_scene(None, packages, plan)
            return
        source: Any = Path(self.words.one("-file"))
        if self.parameter is not None:
            source = parameters[self.parameter][0] if self.parameter in parameters else None
        elif not is_file(source):
            message = f"{self.node.full_name}: there is no file {source}"
            plan.missing.note(self.node.place.absence(message, thing=f"file {source}"), f"{self.model} is left out")
            return
        if not isinstance(source, Path) and not (isinstance(source, str) and _is_xml(source)):
            return
        if self.is_sdf:
            self._read_scene(source, packages, plan)
            return
        with suppress(BadFile):  # reported at the spawn
            description.load(source, {}, self._packages(packages), missing=plan.missing)

    def _read_scene(self, source: Path | str | None, packages: Packages, plan: LaunchPlan) -> None:
        try:
            self.scene = self._scene(source, packages, plan)
        except NotThere as error:
            plan.missing.note(error, f"{self.model} is left out")

    def _scene(self, source: Path | str | None, packages: Packages, plan: LaunchPlan) -> sdf.Scene:
        """The model from a file, a text, or (without both) -database. Raises BadFile: broken, or several models."""
        places = self._packages(packages)
        if isinstance(source, str):
            scene = sdf.parse(source, f"parameter {self.parameter}", places, None, plan.missing)
        else:
            try:
                path = source or sdf.find(sdf.SCHEME + self.words.one("-database"), places)
            except NotThere as error:
                message = f"{self.node.full_name}: {error.reason}"
                raise self.node.place.absence(message, error.hint, error.thing) from None
            scene = sdf.read(path, places, plan.missing)
        if len(scene.names) > 1:
            text = f"-model names one model, and {self._source} has {len(scene.names)}: {listing(scene.names)}"
            raise self.error(text, "give each model a file of its own")
        return scene

    def _packages(self, packages: Packages) -> Packages:
        """The lookup, also upwards from the launch file."""
        return packages.starting_at(Path(self.node.file).parent) if self.node.file else packages

    def start(self, run: Run) -> str | None:
        awaited = self.words.one("-wait")
        if awaited and awaited not in run.call("/slidectl/status")["robots"]:
            return f"the model {awaited}"
        plan = self._scene_plan(run) if self.is_sdf else self._robot_plan(run)
        if not plan.models:
            self.settled(run, f"{self._source} is a ground plane, which is the world's own")
            return None
        if self.joints:
            robot = plan.robot or description.parse(plan.models[0]["model_xml"])
            plan.joints, remarks = self._positions(robot)
            for remark in remarks:
                self.warn(run, remark)
        spawn = spawning.Spawn(run.client, plan, SPAWN_LIMIT_S)
        self.parts = spawn.names
        if remark := names.remark_on_robot(self.given_name):
            self.warn(run, remark)
        there = run.call("/slidectl/status")["robots"]
        added = [name for name in self.parts if name not in there]
        run.spawned += added  # before the call: an interrupted call may have spawned them
        try:
            self._spawn(run, spawn)
        except Refused:
            run.spawned[:] = [name for name in run.spawned if name not in added]
            raise
        if self.words.has("-unpause"):
            run.resume()
        self._report(run)
        return None

    def _scene_plan(self, run: Run) -> spawning.SpawnPlan:
        """The plan of the parts of the model; their poses in the file are relative to the requested pose."""
        source: Path | str | None = self._file() if self.words.has("-file") else None
        if self.parameter is not None:
            source = self._text(run)[0]
        scene = self._scene(source, run.packages, run.plan)
        if not scene.models and not scene.has_ground:
            raise Refused(f"no model is left in {self._source}")
        parts = scene.named(self.model) if scene.models else []
        for notice in scene.notices:
            if notice.verdict == "wrong" or run.console.verbose:
                run.console.warn(str(notice))
        frame = self.words.one("-reference_frame")
        return spawning.scene_plan(parts, self.pose, strict=run.options.strict, reference_frame=frame)

    def _robot_plan(self, run: Run) -> spawning.SpawnPlan:
        """The plan of the robot, in the namespace that the launch file expects."""
        plan = spawning.robot_plan(self._document(run), self.pose, self.model, strict=run.options.strict)
        assert plan.robot is not None
        plan.namespace = self.home(plan.robot, run.tasks)
        for text in plan.warnings:
            run.console.warn(text)
        own = spawning.controller_parameters(plan.own_files, plan.namespace)
        # What the launch sets counts.
        plan.parameters = {name: value for name, value in own.items() if name not in run.parameters}
        options = {"reference_frame": self.words.one("-reference_frame"), "robot_namespace": plan.namespace}
        plan.models = [{**model, **options} for model in plan.models]
        return plan

    def _file(self) -> Path:
        path = Path(self.words.one("-file"))
        if not is_file(path):
            raise Refused(f"there is no file {path}")
        return path

    def _document(self, run: Run) -> description.Document:
        """The expanded model with its meshes. Raises Refused, BadFile."""
        packages, missing = self._packages(run.packages), run.plan.missing
        if self.words.has("-file"):
            return description.load(self._file(), {}, packages, missing=missing)
        xml, is_own = self._text(run)
        if not is_own:
            known = run.call("/slidectl/sources", {"digest": source_note.digest(xml)})  # the places of its elements
            return description.load(source_note.join(xml, known["note"]), {}, packages, missing=missing)
        name = self.parameter
        setting = next((one for one in reversed(run.plan.settings) if one.name == name), None)
        title = shown(setting.source) if setting is not None and setting.source else f"parameter {name}"
        return description.load(xml, {}, packages, missing=missing, title=title)

    def _text(self, run: Run) -> tuple[str, bool]:
        """The text of the parameter, and True if this launch sets it. Raises Refused."""
        name = self.parameter
        assert name is not None
        # The value in the files counts, as another launch may have changed the parameter meanwhile.
        own = run.parameters.get(name)
        xml = own[0] if own is not None else run.parameter(name)
        if not isinstance(xml, str):
            there = [one for one in run.call("/rosapi/get_param_names")["names"] if one.endswith("description")]
            hint = f"descriptions there are: {', '.join(there) or 'none'}"
            raise Refused(f"the parameter {name} is not set to a robot's description", hint)
        if not _is_xml(xml):
            raise Refused(f"the parameter {name} is not XML")
        return xml, own is not None

    def _spawn(self, run: Run, spawn: spawning.Spawn) -> None:
        try:
            _, warnings = spawn.apply()
        except spawning.SpawnRefused as refused:
            if self.is_sdf:
                raise
            first, *rest = refused.reason.splitlines() or [""]
            raise Refused(first, "\n".join(rest).replace("(-n)", "(-model)") or None) from None
        for warning in warnings:
            self.warn(run, warning.replace("(--at X Y Z)", "(-x, -y, -z)"))

    def _positions(self, robot: Robot) -> tuple[dict[str, float], list[str]]:
        """The positions of -J and remarks. As in Gazebo, a limit holds a position, and unknown joints are skipped."""
        moving = {joint.name: joint for joint in robot.joints.values() if joint.type != "fixed"}
        remarks, positions = [], {}
        for name, asked in self.joints.items():
            joint = moving.get(name)
            if joint is None:
                unknown = UnknownName("moving joint", name, list(moving), f"on robot {self.model!r}")
                remarks.append(f"-J {name} {asked:g} is skipped: {unknown.message}")
                continue
            position = positions[name] = asked
            limit = joint.limit if joint.type in ("revolute", "prismatic") else None
            if limit is not None and limit.lower <= limit.upper:
                position = positions[name] = min(max(asked, limit.lower), limit.upper)
            if limit is not None and position != asked:
                bounds = f"{limit.lower:.10g} to {limit.upper:.10g}"
                remarks.append(f"-J {name} {asked:.10g} is beyond its limits, {bounds}: it starts at {position:.10g}")
        return positions, remarks

    def _report(self, run: Run) -> None:
        """Report the namespace and joints, important notices in full, and the number of others unless `-v`."""
        [robot] = run.call("/slidectl/list_robots", {"name": self.model})["robots"]
        put = [joint.rpartition("::")[2] for joint in self.joints]
        ignored = 0
        for notice in robot["report"]:
            where = f"{notice['file']}:{notice['line']}" if notice["line"] else notice["file"]
            if is_moved_inside(notice["subject"], notice["text"], put):
                continue
            if is_important(notice["verdict"], notice["subject"]) or run.console.verbose:
                run.console.warn(f"{where}: {notice['verdict']}: {notice['subject']}: {notice['text']}")
            elif notice["verdict"] == "ignored":
                ignored += 1
        joints = " ".join(joint["name"] for joint in robot["joints"] if joint["type"] != "fixed") or "none"
        more = f"; {ignored} {'tag' if ignored == 1 else 'tags'} without effect, -v shows them" if ignored else ""
        where = f"spawned in {robot['namespace']}" if robot["kind"] == "robot" else f"spawned, {robot['kind']}"
        self.settled(run, f"{self.model} {where}, joints: {joints}{more}", robot=self.model)

    def stop(self, run: Run) -> None:
        """Delete the robot with `-b` or after a failed launch, unless the daemon ends too."""
        if not (self.bound or (run.failed and not run.owns_daemon)) or self.model not in run.spawned:
            return
        for name in reversed(self.parts):
            run.spawned.remove(name)
            if run.call("/gazebo/delete_model", {"model_name": name}, timeout=HOOK_LIMIT_S)["success"]:
                self.settled(run, f"{name}: deleted")


def _is_xml(text: str) -> bool:
    return text.lstrip("\ufeff \t\r\n").startswith("<")


def _pose(words: Words) -> rotations.Pose:
    """The pose in the options: metres, and fixed-axis angles in rad about x, then y, then z of the world."""
    x, y, z, roll, pitch, yaw = (words.number(option, 0.0) for option in ("-x", "-y", "-z", "-R", "-P", "-Y"))
    return (x, y, z), rotations.from_rpy((roll, pitch, yaw))
