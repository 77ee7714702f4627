"""Checks files of controllers: each parameter against the declaration of its controller, and against the robot.

The registry gives the parameters of controllers. Simulated hardware declares its own (`joint_limits/<joint>` and
`gazebo_ros_control/pid_gains/<joint>`). Nothing is loaded.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, isnan
from pathlib import Path
from typing import Any

from slidectl import names
from slidectl.check.findings import Findings
from slidectl.check.model import Model
from slidectl.control import registry
from slidectl.control.controller_interface import ControllerBase
from slidectl.control.hardware_interface import JointStateInterface, ResourceManager
from slidectl.control.limits import LIMITS
from slidectl.control.params import LIST, UPDATE_BUDGET, Parameter, as_boolean, as_number, described
from slidectl.control.pid import GAINS
from slidectl.control.ros2_names import NoCounterpart, refuse_others
from slidectl.control.user_classes import is_of_a_user
from slidectl.description import controllers_file, interfaces
from slidectl.description.controllers_file import ROS_2, retarget
from slidectl.description.gazebo_tags import TRANSMISSIONS, transmissions_named
from slidectl.description.models import read_file
from slidectl.description.report import did_you_mean
from slidectl.description.robot import Notice, Robot, Verdict
from slidectl.errors import BadFile, NotThere, Refused, UnknownName, listing

Tree = dict[str, Any]
Judgement = tuple[str, Verdict, str]
"""The name of a gain or a limit, the verdict, and the text of the finding."""
Reader = Callable[[str], str | None]
"""A function from a parameter's full name to its other readers, as text; None when there are none."""

_UNSPACED = re.compile(r"^\w+:\S")
_INDEX = re.compile(r"\[\d+\]")
_ANY = "<joint>"
_LONGEST = 60
# MoveIt's planners also have a `type`.
_PLANNERS = "planner_configs"
# Parameters that programs other than controllers read, in any namespace.
_OTHERS = {
    "robot_description": "the robot, for viewers and planners",
    "use_sim_time": "time is always simulated here",
    "update_rate": "how often the controllers of a robot of ROS 2 run, Hz",
}
_HARDWARE = ("joint_limits", "gazebo_ros_control")
_GAINS = "pid_gains"
# The beginnings of findings on unknown names.
_UNKNOWN = "is unknown to the controller and has no effect"
_UNKNOWN_TO_HARDWARE = "simulated hardware does not read it"
# Flags of joint limits, and the values that each enables.
_FLAGS = {
    "has_position_limits": ("min_position", "max_position"),
    "has_velocity_limits": ("max_velocity",),
    "has_acceleration_limits": ("max_acceleration",),
    "has_jerk_limits": ("max_jerk",),
    "has_effort_limits": ("max_effort",),
    "has_soft_limits": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
}
_UNREAD = {
    "has_jerk_limits": "simulated hardware bounds no jerk",
}


def known_types() -> list[tuple[str, str]]:
    """The types of controllers in this installation, each with the base class that its loader names."""
    return [(name, registry.BASE_CLASS) for name in registry.common.types()]


def check(path: str | Path, model: Model | None, findings: Findings, text: bytes | None = None) -> bool:
    """Add findings on a file of controllers, as `slidectl spawn --controllers` would load it for `model`.

    `text` replaces the content of the file. Returns True when it has a controller of a known type.

    Raises:
        BadFile: there is no such file.
    """
    from slidectl.description import yaml_tree

    text = read_file(Path(path)) if text is None else text
    notices: list[Any] = []
    try:
        written = yaml_tree.read(text, str(path), notices)
        places = controllers_file.places(text, str(path))
    except BadFile as error:
        findings.fail("parameters", error)
        return False
    findings.extend(notices)
    source = ParameterFile(str(path), places, findings)
    replaced: list[str] = []
    tree = controllers_file.plain(written, replaced)
    for name in replaced:
        source.add("wrong", name, yaml_tree.REPLACED)
    if tree is not written:
        source.add(
            "converted", "/", f"{ROS_2} is ROS 2's; its content is read as if it stood directly below the controllers"
        )
    checker = ControllerCheck(source, [model] if model is not None else [])
    if model is not None:
        # A spawn moves a single other namespace to the robot's.
        placed, remark = retarget(tree, model.namespace)
        checker.moved = placed is not tree
        top = f"/{next(iter(tree), '')}"
        if remark is not None and placed is tree:
            source.add(
                "wrong", top, f"{remark}; no controller there finds the robot, whose plugin says {model.namespace}"
            )
        elif remark is not None:
            source.add(
                "converted",
                top,
                f"{remark} by slidectl; rosparam load would leave them there, where no controller reads them",
            )
        elif checker.moved:
            source.namespace = model.namespace
    checker.check(tree)
    return bool(checker.claims)


def unknown(tree: Mapping[str, Any], source: ParameterFile) -> list[Notice]:
    """The findings on parameters that their controller, or simulated hardware, does not know; no other findings.

    For loading of parameters: a mistyped name is reported at once, as by a check.
    """
    ControllerCheck(source, []).check(tree)
    return [notice for notice in source.findings.sorted() if notice.text.startswith((_UNKNOWN, _UNKNOWN_TO_HARDWARE))]


def check_named(files: Sequence[str], controllers: Sequence[str]) -> None:
    """Check the controllers that a step names, in the files that spawns have loaded so far; its own file is the last.

    Raises:
        BadFile: a file is broken, or a type is unknown (file, line). UnknownName: a controller is in none of the files.
    """
    from slidectl.client import spawning
    from slidectl.description import yaml_tree

    findings = Findings()
    known: set[str] = set()
    for file in files:
        path = str(spawning.find(file))
        text = read_file(Path(path))
        checker = ControllerCheck(ParameterFile(path, controllers_file.places(text, path), findings), [])
        checker.check(controllers_file.plain(yaml_tree.read(text, path)))
        known |= checker.found.keys()
    for name in controllers:
        meant = [full for full in known if full.endswith(f"/{name.strip('/')}")]
        if not meant:
            where = f"in {', '.join(dict.fromkeys(files))}" if files else "anywhere: no spawn has --controllers FILE"
            raise UnknownName("controller", name, sorted(full.rpartition("/")[2] for full in known), where)
        for notice in findings.sorted(("wrong",)):
            if notice.subject in [f"{full}/type" for full in meant]:
                raise BadFile(f"{notice.subject}: {notice.text}", notice.file, notice.line)


# --- the file ---------------------------------------------------------------------------------------------------------


@dataclass
class ParameterFile:
    """The file of a tree of parameters, for findings; the tree is loaded at `namespace`.

    A tree usually comes from one file; `file` is that file, or the first of several.
    """

    file: str
    places: Mapping[str, tuple[str, int | None]]
    """File and line by the path in the tree, as `/slider/c/pid/p` or `/slider/c/extra_joints[0]/name`."""
    findings: Findings
    namespace: str = "/"

    def place(self, path: str) -> tuple[str, int | None]:
        """The place of a path in the tree: its own, else that of its nearest parent, else of its first child."""
        above = path
        while above:
            if above in self.places:
                return self.places[above]
            above = above[: max(above.rfind("/"), above.rfind("["), 0)]
        below = (place for name, place in self.places.items() if name.startswith(f"{path}/"))
        return next(below, (self.file, 1))

    def full(self, path: str) -> str:
        """The full name of the parameter after loading."""
        return names.join(self.namespace, path.strip("/")) if path.strip("/") else self.namespace

    def add(self, verdict: Verdict, path: str, text: str) -> None:
        """Add a finding on a path."""
        self.findings.add(verdict, self.full(path), text, *self.place(path))

    def absent(self, path: str, message: str, hint: str, thing: str) -> None:
        """Add a finding on a path that names a missing thing: "wrong", or left out with --keep-going."""
        if self.findings.missing.keeps_going:
            file, line = self.place(path)
            error = NotThere(f"{self.full(path)}: {message}", file, line, hint, thing)
            self.findings.missing.note(error, "it is left out")
        else:
            self.add("wrong", path, f"{message} {hint}")

    def unread(self, path: str, text: str, value: Any) -> None:
        """Add a finding on a parameter that is not read, including everything below it."""
        below = (
            f" (nor have the parameters below it: {', '.join(map(str, value))})" if isinstance(value, Mapping) else ""
        )
        self.add("ignored", path, text + below)

    def value(self, path: str, value: Any, declared: Declared, name: str, unknown: str) -> None:
        """Add a finding on a value, judged only by its name and type."""
        parameter = declared.find(name)
        if parameter is None:
            hint = did_you_mean("/".join(_parts(name)), declared.names) or f"; it knows {listing(declared.names)}"
            self.unread(path, unknown + hint, value)
        elif parameter.kind.convert(value) is not None:
            self.add("used", path, f"{_shown(value)}{parameter.unit and ' '}{parameter.unit}; {parameter.meaning}")
        else:
            loss = "it is required" if parameter.required else "it counts as not set"
            if parameter.default is not None and not parameter.required:
                loss += f": {_shown(parameter.default)}"
            loss = "its entry is skipped" if "[]/" in parameter.name else loss
            self.add("wrong", path, f"must be {parameter.kind.words}, not {described(value)}; {loss}")


def _shown(value: Any) -> str:
    """The value as YAML, cut if it is long."""
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key}: {_shown(item)}" for key, item in value.items()) + "}"
    elif isinstance(value, list):
        text = "[" + ", ".join(map(_shown, value)) + "]"
    else:
        text = str(value)
    return text if len(text) <= _LONGEST else text[:_LONGEST] + " ..."


# --- what is declared -------------------------------------------------------------------------------------------------


class Declared:
    """The declared parameters of one controller, or of one namespace that hardware reads.

    `extra_joints[2]/name` in a file means the declared `extra_joints[]/name`; any name matches `<joint>`.
    """

    def __init__(self, parameters: Iterable[Parameter]) -> None:
        self.all = tuple(parameters)
        self.names = [parameter.name for parameter in self.all]
        self._patterns = [(parameter.name.split("/"), parameter) for parameter in self.all]

    def find(self, name: str) -> Parameter | None:
        """The declared parameter with this name."""
        parts = _parts(name)
        return next((parameter for pattern, parameter in self._patterns if _fits(pattern, parts)), None)

    def has_below(self, name: str) -> bool:
        """True when a declared parameter is below this name."""
        parts = _parts(name)
        return any(len(pattern) > len(parts) and _fits(pattern[: len(parts)], parts) for pattern, _ in self._patterns)

    def is_list(self, name: str, value: Any) -> bool:
        """True when the value is a list and the name is declared as a list of mappings."""
        parameter = self.find(name)
        return parameter is not None and parameter.kind is LIST and isinstance(value, list)

    def leaves(self, tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
        """The values in a tree, as deep as parameters are declared; an unknown mapping is one value."""
        for key, value in tree.items():
            name = f"{above}{key}"
            if isinstance(value, Mapping) and self.has_below(name):
                yield from self.leaves(value, f"{name}/")
                continue
            yield name, value
            for index, entry in enumerate(value) if self.is_list(name, value) else ():
                if isinstance(entry, Mapping):
                    yield from self.leaves(entry, f"{name}[{index}]/")

    def missing(self, tree: Mapping[str, Any]) -> Iterator[tuple[str, Parameter]]:
        """Names and declarations of required parameters that a tree lacks; optional parts count only if they exist."""
        given = dict(self.leaves(tree))
        for parameter in self.all:
            if parameter.required:
                yield from ((name, parameter) for name in _expected(parameter.name, tree) if name not in given)


def _parts(name: str) -> list[str]:
    return _INDEX.sub("[]", name).split("/")


def _fits(pattern: list[str], parts: list[str]) -> bool:
    return len(pattern) == len(parts) and all(want in (_ANY, part) for want, part in zip(pattern, parts, strict=True))


def _expected(name: str, tree: Mapping[str, Any]) -> Iterator[str]:
    """The names of a required parameter: one, or one for each entry of its list or each joint that is there."""
    sign = next((sign for sign in ("[]/", f"{_ANY}/") if sign in name), None)
    if sign is None:
        yield name
        return
    above, _, below = name.partition(sign)
    branch = controllers_file.at(tree, above)
    if sign == "[]/" and isinstance(branch, list):
        yield from (f"{above}[{index}]/{below}" for index, entry in enumerate(branch) if isinstance(entry, Mapping))
    elif isinstance(branch, Mapping):
        yield from (f"{above}{key}/{below}" for key, value in branch.items() if isinstance(value, Mapping))


# --- the tree ---------------------------------------------------------------------------------------------------------


class ControllerCheck:
    """Checks one tree of parameters against the robots that it may be for.

    Args:
        reader: names a node that reads a parameter which no controller reads.
        hint: a suggestion for an unread parameter, `; ...`, or an empty text.
    """

    def __init__(
        self,
        source: ParameterFile,
        models: Sequence[Model],
        reader: Reader = lambda _: None,
        hint: Callable[[str], str] = lambda _: "",
    ) -> None:
        self.source = source
        self.models = models
        self.reader = reader
        self.hint = hint
        self.moved = False
        """True: the tree is for the first robot, whatever namespaces it names."""
        self.found: dict[str, str] = {}
        """Full name and type of each controller found."""
        self.claims: dict[str, set[str]] = {}
        """The joints that each controller of a known type claims while it runs."""

    def check(self, tree: Mapping[str, Any], path: str = "") -> None:
        """Check a mapping: controllers, parameters of hardware, nested namespaces, and the rest."""
        if not tree and not path:
            self.source.add("used", "/", "note: the file holds no parameters")
        for key, value in tree.items():
            below = f"{path}/{key}"
            if key == _PLANNERS:
                self.source.unread(below, "MoveIt's planners; nobody reads them here", value)
            elif isinstance(value, Mapping) and isinstance(value.get("type"), str):
                self._controller(below, value)
            elif isinstance(value, Mapping) and key in _HARDWARE:
                self._hardware(key, below, value)
            elif key == _GAINS:
                text = "no controller reads it; simulated hardware looks for gazebo_ros_control/pid_gains"
                self.source.unread(below, text, value)
            elif isinstance(value, Mapping) and value:
                self._namespace(below, value)
            elif reason := _OTHERS.get(key) or self.reader(self.source.full(below)):
                self.source.add("used", below, reason)
            elif isinstance(value, str) and _UNSPACED.search(value):
                text = f"{_shown(value)!r} is one text: a blank follows each colon between a name and its value"
                self.source.add("wrong", below, text)
            else:
                hint = self.hint(self.source.full(below))
                self.source.unread(below, f"no controller reads it, nor does the simulated hardware{hint}", value)

    def _namespace(self, path: str, tree: Mapping[str, Any]) -> None:
        if likely := _likely_type(tree):
            text = f"has no 'type' and cannot be loaded as a controller; its parameters are those of {likely}"
            self.source.add("wrong", path, text)
            return
        if path.endswith(f"/{ROS_2}"):
            self.source.add("wrong", path, "is ROS 2's: controllers are to be directly below the robot's namespace")
        else:
            self.source.add("used", path, f"namespace of {', '.join(map(str, tree))}")
        self.check(tree, path)

    def _model(self, path: str) -> Model | None:
        """The robot whose namespace contains the path; of nested namespaces the innermost."""
        if self.moved:
            return self.models[0]
        full = self.source.full(path)
        around = [model for model in self.models if names.is_under(full, model.namespace)]
        return max(around, key=lambda model: len(model.namespace), default=None)

    # --- simulated hardware -------------------------------------------------------------------------------------------

    def _hardware(self, place: str, path: str, tree: Mapping[str, Any]) -> None:
        """Check the parameters of simulated hardware."""
        model = self._model(path)
        if model is None and self.models:
            homes = listing({names.join(model.namespace, place) for model in self.models})
            self.source.unread(path, f"no robot lives here; simulated hardware reads {homes}", tree)
        elif place == "joint_limits":
            self._joints(path, tree, Declared(LIMITS), model)
        else:
            for key, value in tree.items():
                if key == _GAINS and isinstance(value, Mapping):
                    self._joints(f"{path}/{key}", value, Declared(GAINS), model, are_gains=True)
                elif f"{place}/{key}" == TRANSMISSIONS:
                    self._transmissions(f"{path}/{key}", value, model)
                else:
                    self.source.unread(f"{path}/{key}", _UNKNOWN_TO_HARDWARE, value)

    def _transmissions(self, path: str, value: Any, model: Model | None) -> None:
        """Check the parameter TRANSMISSIONS."""
        if model is not None and model.sets_transmissions:
            text = "has no effect: <transmissions> of the model, or --transmissions, overrides it"
            self.source.add("ignored", path, text)
            return
        try:
            how = transmissions_named(str(value))
        except Refused as error:
            self.source.add("wrong", path, f"{error.message}; no robot can be spawned here")
        else:
            self.source.add("used", path, f"{how}; how transmissions count, read at the spawn")

    def _joints(
        self, path: str, tree: Mapping[str, Any], declared: Declared, model: Model | None, are_gains: bool = False
    ) -> None:
        """Check a mapping from joints to their parameters."""
        for joint, values in tree.items():
            below = f"{path}/{joint}"
            absence = _absence(model.robot, joint) if model is not None else None
            driven = model.driven.get(joint) if model is not None else None
            if absence:
                self.source.add("wrong", below, absence)
            elif model is not None and not driven:
                text = f"no controller can drive joint {joint!r}, so simulated hardware does not read it"
                self.source.add("ignored", below, text)
            elif are_gains and driven == [interfaces.EFFORT.name]:
                text = f"joint {joint!r} takes efforts, for which simulated hardware needs no PID"
                self.source.add("ignored", below, text)
            elif isinstance(values, Mapping):
                self._joint(below, values, declared, are_gains)
            else:
                self.source.add("wrong", below, "must hold the parameters of a joint")

    def _joint(self, path: str, values: Mapping[str, Any], declared: Declared, are_gains: bool) -> None:
        judge = judge_gains if are_gains else _judge_limits
        judged = {name: (verdict, text) for name, verdict, text in judge(values)}
        for name, value in values.items():
            if name in judged:
                self.source.add(judged[name][0], f"{path}/{name}", judged[name][1])
            else:
                self.source.value(f"{path}/{name}", value, declared, name, _UNKNOWN_TO_HARDWARE)
        for name, parameter in declared.missing(values):
            text = f"is missing: {parameter.kind.words}, {parameter.meaning}; without it the joint has no PID"
            self.source.add("wrong", f"{path}/{name}", text)

    # --- controllers --------------------------------------------------------------------------------------------------

    def _controller(self, path: str, tree: Mapping[str, Any]) -> None:
        type_name = str(tree["type"])
        self.found[self.source.full(path)] = type_name
        model = self._model(path)
        is_ros2 = model is not None and model.robot.ros2_control is not None
        for_ros2 = registry.is_of_ros2(type_name, tree, is_ros2)
        try:
            if not for_ros2:
                refuse_others(type_name, tree)
            cls = registry.common.find(type_name, for_ros2=for_ros2)
        except (registry.UnknownType, NoCounterpart) as error:
            self.source.absent(f"{path}/type", error.message, error.hint or "", f"controller type {type_name}")
            for name, value in tree.items():
                if name != "type":
                    self.source.unread(f"{path}/{name}", "has no effect, as the controller's type is unknown", value)
            return
        kinds = " and ".join(interface.type_name for interface in _interfaces(cls))
        self.source.add("used", f"{path}/type", f"{type_name}; on {kinds or 'no interface'}")
        if not cls.parameters and is_of_a_user(cls):
            for name in tree.keys() - {"type"}:
                self.source.add("used", f"{path}/{name}", f"{cls.__name__} does not say which parameters it reads")
            return
        declared = Declared((*cls.parameters, UPDATE_BUDGET))
        values = {name: value for name, value in declared.leaves(tree) if name != "type"}
        said: set[str] = set()
        for space in dict.fromkeys(name.rpartition("/")[0] for name in values):
            prefix = f"{space}/" if space else ""
            if declared.find(f"{prefix}i_clamp") is None:
                continue
            own = {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}
            for name, verdict, text in judge_gains(own):
                self.source.add(verdict, f"{path}/{prefix}{name}", text)
                said.add(prefix + name)
        for name, value in values.items():
            if name not in said:
                self._value(f"{path}/{name}", name, value, declared, cls, model)
        for name, parameter in declared.missing(tree):
            loss = "its entry is skipped" if "[]/" in parameter.name else "the controller cannot be loaded"
            text = f"is missing: {parameter.kind.words}, {parameter.meaning}; {loss}"
            self.source.add("wrong", f"{path}/{name}", text)
        claiming = any(interface.claims for interface in _interfaces(cls))
        joints = (_joints_in(declared.find(name), value) for name, value in values.items() if claiming)
        self.claims[self.source.full(path)] = {joint for some in joints for joint in some}

    def _value(
        self, path: str, name: str, value: Any, declared: Declared, cls: type[ControllerBase], model: Model | None
    ) -> None:
        parameter = declared.find(name)
        joints = _joints_in(parameter, value) if model is not None else []
        troubles = (_trouble(model, joint, cls) for joint in joints) if model is not None else iter(())
        trouble = next(filter(None, troubles), None)
        number = parameter.kind.convert(value) if parameter is not None and parameter.unless_positive else None
        if trouble:
            self.source.add("wrong", path, trouble)
        elif parameter is not None and number is not None and not number > 0:
            self.source.add("ignored", path, f"{value} is not above 0: {parameter.unless_positive}")
        else:
            self.source.value(path, value, declared, name, _UNKNOWN)
            if declared.is_list(name, value) and declared.has_below(f"{name}[0]"):
                for index, entry in enumerate(value):
                    if not isinstance(entry, Mapping):
                        self.source.add("wrong", f"{path}[{index}]", "must be a mapping; it is skipped")


def _joints_in(parameter: Parameter | None, value: Any) -> list[str]:
    """The joints named in the value of a parameter."""
    named = parameter.kind.convert(value) if parameter is not None and parameter.names_joints else None
    return [named] if isinstance(named, str) else list(named or ())


def _absence(robot: Robot, joint: str) -> str | None:
    if joint in robot.joints:
        return None
    hint = did_you_mean(joint, robot.joints) or ";"
    return f"the robot has no joint {joint!r}{hint} joints: {listing(robot.joints)}"


def _trouble(model: Model, joint: str, cls: type[ControllerBase]) -> str | None:
    """Why the controller cannot use the joint; None when it can.

    `controller/joint` is exported by another controller, which may be in another file.
    """
    if "/" in joint:
        return None
    if absence := _absence(model.robot, joint):
        return absence
    offered = model.driven.get(joint)
    if offered is None:
        driver = "transmission" if model.robot.ros2_control is None else "command_interface"
        return f"no {driver} drives joint {joint!r}, so controllers do not know it"
    wanted = {interface.type_name.rpartition("::")[2] for interface in _interfaces(cls)}
    if wanted and not wanted & {*offered, JointStateInterface.__name__}:
        needed = f"the controller needs {' or '.join(wanted)}"
        return f"joint {joint!r} offers {' and '.join(offered)}, {needed}"
    return None


def _interfaces(cls: type[ControllerBase]) -> list[type[ResourceManager[Any]]]:
    """The hardware interfaces of a controller class."""
    one = getattr(cls, "interface_type", None)
    return [one] if one is not None else list(getattr(cls, "interface_types", ()))


def _likely_type(tree: Mapping[str, Any]) -> str | None:
    """The controller type that declares all these names; of several the one with the fewest missing parameters."""
    fitting = []
    for name in registry.common.types():
        declared = Declared(registry.common.find(name).parameters)
        required = {each.name for each in declared.all if each.required and "<" not in each.name}
        given = {leaf for leaf, _ in declared.leaves(tree)}
        if given & required and all(map(declared.find, given)):
            fitting.append((len(required - given), name))
    return min(fitting)[1] if fitting else None


# --- gains and limits -------------------------------------------------------------------------------------------------


def judge_gains(values: Mapping[str, Any]) -> Iterator[Judgement]:
    """Judge the gains `p`, `i` and so on in `values` by the equation of control/pid.py.

    Ordinary gains, and values that are not numbers, get no judgement.
    """
    numbers = {name: number for name in values if (number := as_number(values[name])) is not None}
    for name, number in numbers.items():
        if isnan(number) or (name in ("p", "i", "d") and not isfinite(number)):
            yield name, "wrong", f"{number} is not a finite number: the gains are refused"
            return
    gains = {name: numbers[name] for name in ("p", "i", "d") if name in numbers}
    if "p" in gains and not any(gains.values()):
        yield "p", "wrong", "0.0, as are all gains: the controller never pushes"
    for name, value in gains.items():
        if value < 0:
            yield name, "wrong", f"{value:g} is negative: it drives away from the set point"
    gain, clamp = numbers.get("i", 0.0), numbers.get("i_clamp", 0.0)
    is_bounded_to_0 = not numbers.get("i_clamp_min", clamp) and not numbers.get("i_clamp_max", clamp)
    if gain != 0 and is_bounded_to_0:
        yield "i", "ignored", f"{gain:g} has no effect without i_clamp (or i_clamp_min and i_clamp_max)"
    if as_boolean(values.get("antiwindup")) and (gain == 0 or is_bounded_to_0):
        why = "i is 0" if gain == 0 else "the integral is bounded to 0"
        yield "antiwindup", "ignored", f"true has no effect, as {why}"
    for name, sign in (("i_clamp", 1), ("i_clamp_min", -1), ("i_clamp_max", 1)):
        if name not in numbers:
            continue
        value = numbers[name]
        if gain == 0:
            yield name, "ignored", f"{value:g} bounds nothing, as i is 0"
        elif name == "i_clamp" and {"i_clamp_min", "i_clamp_max"} <= numbers.keys():
            yield name, "ignored", f"{value:g} has no effect beside i_clamp_min and i_clamp_max"
        elif value * sign < 0:
            yield name, "converted", f"{value:g} is taken as {-value:g}"


def _judge_limits(values: Mapping[str, Any]) -> Iterator[Judgement]:
    """Find limits without their flag, and flags without their limits."""
    for flag, bounds in _FLAGS.items():
        there = [name for name in bounds if name in values]
        lacking = [name for name in bounds if name not in values]
        if flag in _UNREAD:
            yield from ((name, "ignored", _UNREAD[flag]) for name in (flag, *there) if name in values)
        elif values.get(flag) is not True:
            yield from ((name, "ignored", f"has no effect without {flag}: true") for name in there)
        elif lacking:
            yield flag, "ignored", f"true has no effect without {', '.join(lacking)}"
            yield from ((name, "ignored", f"has no effect without {', '.join(lacking)}") for name in there)
    if "angle_wraparound" in values and values.get("has_position_limits") is not False:
        yield "angle_wraparound", "ignored", "counts only with has_position_limits: false"
