"""gazebo_ros/spawn_model: a URDF from a parameter or a file becomes a robot in the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from slidectl import description, names, rotations
from slidectl.description import source_note
from slidectl.description.packages import Packages, is_file, shown
from slidectl.description.parser import STARTS_OUTSIDE, place_of_limit
from slidectl.description.report import needs_telling
from slidectl.errors import BadFile, BadName, Refused
from slidectl.launch.plan import LaunchPlan, Leaf, Node
from slidectl.launch.task import HOOK_LIMIT_S, SPAWN_LIMIT_S, Run, Task, Words, number, parse

_OPTIONS = {
    "-urdf": 0, "-sdf": 0, "-trimesh": 0, "-file": 1, "-param": 1, "-database": 1, "-stdin": 0, "-model": 1,
    "-robot_namespace": 1, "-gazebo_namespace": 1, "-reference_frame": 1, "-x": 1, "-y": 1, "-z": 1, "-R": 1,
    "-P": 1, "-Y": 1, "-J": 2, "-unpause": 0, "-wait": 1, "-package_to_model": 0, "-b": 0, "-v": 0, "--verbose": 0,
}  # fmt: skip
_REFUSED = {
    "-sdf": "only URDF can be spawned, and this is SDF",
    "-trimesh": "only URDF can be spawned, and this is a bare mesh",
    "-database": "there is no model database here",
    "-stdin": "nodes of a launch file have no standard input",
}


class SpawnModel(Task):
    """The spawn script. Only with `-b` something of it stays: then the robot leaves with it.

    The robot of a launch that fails does not stay in a world that was there before.
    """

    family = "robot"

    def __init__(self, node: Node, plan: LaunchPlan) -> None:
        super().__init__(node, plan)
        self.words = words = parse(node, _OPTIONS)
        for option, reason in _REFUSED.items():
            if words.has(option):
                raise self.error(f"{option}: {reason}", "describe the robot in URDF or xacro")
        if words.has("-file") == words.has("-param"):
            raise self.error("takes one of -param NAME and -file FILE")
        if words.rest:
            raise self.error(f"does not understand {' '.join(words.rest)!r}")
        if not words.one("-model"):
            raise self.error("needs a name for the robot: -model NAME")
        if words.one("-gazebo_namespace", "/gazebo").strip("/") != "gazebo":
            raise self.error("there is one world, and it is in /gazebo", "leave -gazebo_namespace out")
        try:
            self.model = names.check_robot(words.one("-model"))
        except BadName as error:
            raise self.error(error.message, "give it another name (-model NAME)") from None
        self.pose = _pose(words)
        self.joints = {
            joint.removeprefix(f"{self.model}::"): number(node, f"-J {joint}", value)
            for joint, value in words.given.get("-J", [])
        }
        """Where joints begin, in rad or m, by their names without the model's."""
        self.bound = self.keeps_running = self.needs_presence = words.has("-b")

    def start_of(self, joint: str) -> float:
        """Where a joint is when the robot is there: -J says it, by the joint's name or `robot::joint`."""
        return next((value for name, value in self.joints.items() if name.rpartition("::")[2] == joint), 0.0)

    @property
    def asked_namespace(self) -> str | None:
        """What `-robot_namespace` says, from the root: Gazebo gets it as it is typed and knows no groups."""
        asked = self.words.one("-robot_namespace")
        return names.join("/", asked).rstrip("/") or "/" if asked else None

    def home(self, robot: description.Robot, tasks: Sequence[Task]) -> str:
        """The namespace in which the robot will be, in a launch of these tasks.

        A plugin that names none gets the node's own from spawn_model, and else the model's name. Which of them is
        meant is seen from the nodes that speak to a controller manager.
        """
        if self.asked_namespace is not None:
            return self.asked_namespace
        is_open = robot.plugin is not None and robot.plugin.robot_namespace is None
        if is_open and self._is_spoken_to(tasks):
            return self.node.namespace
        return description.namespace_of(robot, self.model)

    def _is_spoken_to(self, tasks: Sequence[Task]) -> bool:
        """Whether a task speaks to a controller manager in this one's namespace, and none to one in the model's."""
        managers = {task.manager_namespace for task in tasks}
        return self.node.namespace in managers and names.join("/", self.model) not in managers

    @property
    def text(self) -> str:
        source = f"file {self.words.one('-file')}" if self.words.has("-file") else f"parameter {self.parameter}"
        return f"spawn {self.model} from {source}"

    @property
    def parameter(self) -> str | None:
        """The full name of the parameter with the description; None when that is in a file."""
        return self.node.resolve(self.words.one("-param")) if self.words.has("-param") else None

    def look_ahead(self, plan: LaunchPlan, packages: Packages, parameters: Mapping[str, Leaf]) -> None:
        source: Any = Path(self.words.one("-file"))
        if self.parameter is not None:
            source = parameters[self.parameter][0] if self.parameter in parameters else None
        elif not is_file(source):
            message = f"{self.node.full_name}: there is no file {source}"
            plan.missing.note(self.node.place.absence(message, thing=f"file {source}"), f"{self.model} is left out")
            return
        if isinstance(source, Path) or (isinstance(source, str) and _is_xml(source)):
            with suppress(BadFile):  # which is said when it is spawned
                description.load(source, {}, self._packages(packages), missing=plan.missing)

    def _packages(self, packages: Packages) -> Packages:
        """The lookup, from the launch file upwards too."""
        return packages.starting_at(Path(self.node.file).parent) if self.node.file else packages

    def start(self, run: Run) -> str | None:
        awaited = self.words.one("-wait")
        if awaited and awaited not in run.call("/slidectl/status")["robots"]:
            return f"the model {awaited}"
        run.new_warnings()
        document = self._document(run)
        if run.options.strict:
            description.parse(document.xml, document.file, strict=True)
        if self.model not in run.call("/slidectl/status")["robots"]:
            run.spawned.append(self.model)  # before it is there: a call that is cut short may have been heard
        try:
            self._spawn(run, document)
        except Refused:
            if self.model in run.spawned:
                run.spawned.remove(self.model)
            raise
        if self.words.has("-unpause"):
            run.call("/gazebo/unpause_physics")
        self._tell(run)
        return None

    def _document(self, run: Run) -> description.Document:
        """Expanded, with meshes found. Raises Refused, BadFile."""
        packages, missing = self._packages(run.packages), run.plan.missing
        if self.words.has("-file"):
            path = Path(self.words.one("-file"))
            if not is_file(path):
                raise Refused(f"there is no file {path}")
            return description.load(path, {}, packages, missing=missing)
        name = self.parameter
        assert name is not None
        # What the files say is what is meant, though another launch may have set the same name meanwhile.
        own = run.parameters.get(name)
        xml = own[0] if own is not None else run.parameter(name)
        if not isinstance(xml, str):
            there = [one for one in run.call("/rosapi/get_param_names")["names"] if one.endswith("description")]
            hint = f"descriptions there are: {', '.join(there) or 'none'}"
            raise Refused(f"the parameter {name} is not set to a robot's description", hint)
        if not _is_xml(xml):
            raise Refused(f"the parameter {name} holds no XML")
        if own is None:
            known = run.call("/slidectl/sources", {"digest": source_note.digest(xml)})  # where elements were written
            return description.load(source_note.join(xml, known["note"]), {}, packages, missing=missing)
        setting = next((one for one in reversed(run.plan.settings) if one.name == name), None)
        title = shown(setting.source) if setting is not None and setting.source else f"parameter {name}"
        return description.load(xml, {}, packages, missing=missing, title=title)

    def _spawn(self, run: Run, document: description.Document) -> None:
        namespace = self.asked_namespace or ""  # empty where the plugin says it, or the robot's name does
        if not namespace and self._is_spoken_to(run.tasks):
            namespace = self.home(description.parse(document.xml), run.tasks)
        request: dict[str, Any] = {
            "model_name": self.model,
            "model_xml": document.xml,
            "robot_namespace": namespace,
            "initial_pose": self.pose,
            "reference_frame": self.words.one("-reference_frame"),
        }
        halt = bool(self.joints) and not run.call("/slidectl/status")["paused"]
        if halt:  # no moment passes between the two
            run.call("/gazebo/pause_physics")
        try:
            warnings = _act(run, "/gazebo/spawn_urdf_model", request, SPAWN_LIMIT_S)
            if self.joints:
                self._set_joints(run)  # which may bring it out of what it was put into
            else:
                for warning in warnings:
                    self.warn(run, warning.replace("(--at X Y Z)", "(-x, -y, -z)"))
        finally:
            if halt:
                run.call("/gazebo/unpause_physics")

    def _set_joints(self, run: Run) -> None:
        request = {
            "model_name": self.model,
            "urdf_param_name": "robot_description",
            "joint_names": list(self.joints),
            "joint_positions": list(self.joints.values()),
        }
        try:
            _act(run, "/gazebo/set_model_configuration", request)
        except Refused:
            run.call("/gazebo/delete_model", {"model_name": self.model})
            raise

    def _tell(self, run: Run) -> None:
        """Where it is, and what became of its tags: what needs telling in full, the others counted unless `-v`."""
        run.new_warnings()  # the same is said here
        [robot] = run.call("/slidectl/list_robots", {"name": self.model})["robots"]
        # What -J put elsewhere is between its limits: set_model_configuration refuses all else.
        put = {place_of_limit(joint.rpartition("::")[2]) for joint in self.joints}
        ignored = 0
        for notice in robot["report"]:
            where = f"{notice['file']}:{notice['line']}" if notice["line"] else notice["file"]
            if notice["text"].startswith(STARTS_OUTSIDE) and notice["subject"] in put:
                continue
            if needs_telling(notice["verdict"], notice["subject"]) or run.console.verbose:
                run.console.warn(f"{where}: {notice['verdict']}: {notice['subject']}: {notice['text']}")
            elif notice["verdict"] == "ignored":
                ignored += 1
        joints = " ".join(joint["name"] for joint in robot["joints"] if joint["type"] != "fixed") or "none"
        more = f"; {ignored} {'tag' if ignored == 1 else 'tags'} without effect, -v shows them" if ignored else ""
        self.settled(run, f"{self.model} spawned in {robot['namespace']}, joints: {joints}{more}", robot=self.model)

    def stop(self, run: Run) -> None:
        """The robot goes with `-b`, and with a launch that failed; where the daemon goes too, it goes with that."""
        if not (self.bound or (run.failed and not run.owns_daemon)) or self.model not in run.spawned:
            return
        run.spawned.remove(self.model)
        if run.call("/gazebo/delete_model", {"model_name": self.model}, HOOK_LIMIT_S)["success"]:
            self.settled(run, f"{self.model}: deleted")


def _is_xml(text: str) -> bool:
    return text.lstrip("\ufeff \t\r\n").startswith("<")


def _act(run: Run, service: str, request: dict[str, Any], timeout: float | None = None) -> list[str]:
    """Call a service of gazebo_ros. The lines of its answer behind the first are warnings."""
    answer = run.call(service, request, timeout)
    first, _, rest = answer["status_message"].partition("\n")
    if not answer["success"]:
        raise Refused(first, rest.replace("(-n)", "(-model)") or None)
    return list(rest.splitlines())


def _pose(words: Words) -> dict[str, Any]:
    """geometry_msgs/Pose: metres, and fixed-axis angles in radians, about x, then y, then z of the world."""
    x, y, z, roll, pitch, yaw = (words.number(option, 0.0) for option in ("-x", "-y", "-z", "-R", "-P", "-Y"))
    turn = rotations.from_rpy((roll, pitch, yaw))
    return {"position": {"x": x, "y": y, "z": z}, "orientation": rotations.message(turn)}
