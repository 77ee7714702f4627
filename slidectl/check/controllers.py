"""Checks files of controllers: each parameter against what its controller says that it reads, and against the robot.

Knows parameters from the controllers themselves, through the registry. Nothing is loaded.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from slidectl import names
from slidectl.check import gains, hardware
from slidectl.check.declared import Declared
from slidectl.check.findings import Findings
from slidectl.check.model import Model, driven_joints
from slidectl.check.parameter_file import ParameterFile, shown
from slidectl.control import registry
from slidectl.control.controller_interface import ControllerBase
from slidectl.control.hardware_interface import JointStateInterface, ResourceManager
from slidectl.control.params import Parameter
from slidectl.description.controllers_file import retarget
from slidectl.description.models import read_file
from slidectl.description.robot import Notice
from slidectl.errors import BadFile, closest, listing

Tree = dict[str, Any]

_UNSPACED = re.compile(r"^\w+:\S")
# MoveIt's planners have a `type`, too.
_PLANNERS = "planner_configs"
# What is read by others than controllers, wherever it is.
_OTHERS = {
    "robot_description": "the robot, for whoever draws or plans",
    "use_sim_time": "time is always simulated here",
}

_UNKNOWN = "is unknown to the controller and has no effect"

Reader = Callable[[str], str | None]
"""Who, other than controllers and hardware, reads the parameter of that full name; None: nobody."""


def _nobody(_: str) -> None:
    return None


def known_types() -> list[tuple[str, str]]:
    """The types of controllers that this installation has, each with the base class that its loader names."""
    return [(name, registry.BASE_CLASS) for name in registry.types()]


def check(path: str | Path, model: Model | None, findings: Findings, text: bytes | None = None) -> None:
    """Add what there is to say of a file of controllers, as `slidectl spawn --controllers` would load it for `model`.

    `text` is its content, when that came from elsewhere.

    Raises:
        BadFile: there is no such file.
    """
    from slidectl.description import yaml_tree

    text = read_file(Path(path)) if text is None else text
    notices: list[Any] = []
    try:
        tree = yaml_tree.read(text, str(path), notices)
        places = {name: (str(path), line) for name, line in yaml_tree.places(text, str(path)).items()}
    except BadFile as error:
        findings.fail("parameters", error)
        return
    findings.extend(notices)
    source = ParameterFile(str(path), places, findings)
    checker = ControllerCheck(source, [model] if model is not None else [])
    if model is not None:
        _tell_namespace(source, tree, model, checker)
    checker.check(tree)


def _tell_namespace(source: ParameterFile, tree: Tree, model: Model, checker: ControllerCheck) -> None:
    """Whether the file is for the robot's namespace; a single other one is moved there when the robot is spawned."""
    placed, remark = retarget(tree, model.namespace)
    top = f"/{next(iter(tree), '')}"
    if remark is not None and placed is tree:
        source.add("wrong", top, f"{remark}; nothing there finds the robot, whose plugin says {model.namespace}")
    elif remark is not None:
        source.add("converted", top, f"{remark} by slidectl; rosparam load would leave them, and nothing find them")
    elif placed is not tree:
        source.namespace = model.namespace
    checker.moved = placed is not tree


def unknown(tree: Mapping[str, Any], source: ParameterFile) -> list[Notice]:
    """Findings on the parameters in a tree that their controllers, or simulated hardware, do not know; on nothing else.

    For those who load parameters: a name with a slip is told at once, as a check tells it.
    """
    ControllerCheck(source, []).check(tree)
    return [notice for notice in source.findings.sorted() if notice.text.startswith((_UNKNOWN, hardware.UNKNOWN))]


class ControllerCheck:
    """One tree of parameters, and the robots that may be meant in it."""

    def __init__(
        self,
        source: ParameterFile,
        models: Sequence[Model],
        reader: Reader = _nobody,
        hint: Callable[[str], str] = lambda _: "",
    ) -> None:
        self.source = source
        self.models = models
        self.reader = reader
        """Which node reads a parameter that no controller reads."""
        self.hint = hint
        """What was meant by one that nobody reads, or nothing."""
        self.moved = False
        """True: whatever the file says, it is for the first robot."""
        self.found: dict[str, str] = {}
        """Full name and type of each controller."""
        self.claims: dict[str, set[str]] = {}
        """The joints that each controller of a known type has for itself while it runs."""

    def check(self, tree: Mapping[str, Any], path: str = "") -> None:
        """Go through a mapping: controllers, what hardware reads, namespaces with more of them, and strays."""
        if not tree and not path:
            self.source.add("used", "/", "note: the file holds no parameters")
        for key, value in tree.items():
            below = f"{path}/{key}"
            if key == _PLANNERS:
                self.source.unknown(below, "MoveIt's planners; nobody reads them here", value)
            elif isinstance(value, Mapping) and _is_controller(value):
                self._controller(below, value)
            elif isinstance(value, Mapping) and key in hardware.PLACES:
                self._hardware(key, below, value)
            elif key == hardware.GAINS_PLACE:
                text = "no controller reads it; simulated hardware looks for gazebo_ros_control/pid_gains"
                self.source.unknown(below, text, value)
            elif isinstance(value, Mapping) and value:
                self._namespace(below, value)
            elif reason := _OTHERS.get(key) or self.reader(self.source.full(below)):
                self.source.add("used", below, reason)
            elif isinstance(value, str) and _UNSPACED.search(value):
                text = f"{shown(value)!r} is one text: a blank follows each colon between a name and its value"
                self.source.add("wrong", below, text)
            else:
                hint = self.hint(self.source.full(below))
                text = "no controller reads it, nor does the simulated hardware" + (f"; {hint}" if hint else "")
                self.source.unknown(below, text, value)

    def _hardware(self, place: str, path: str, tree: Mapping[str, Any]) -> None:
        """What simulated hardware reads, if there is any in this namespace."""
        model = self._model(path)
        if model is None and self.models:
            homes = listing({names.join(model.namespace, place) for model in self.models})
            self.source.unknown(path, f"no robot lives here; simulated hardware reads {homes}", tree)
        else:
            hardware.check(self.source, place, path, tree, model)

    def _namespace(self, path: str, tree: Mapping[str, Any]) -> None:
        if candidates := _likely_types(tree):
            text = f"has no 'type' and cannot be loaded as a controller; its parameters are those of {candidates[0]}"
            self.source.add("wrong", path, text)
            return
        if path.endswith("/ros__parameters"):
            self.source.add("wrong", path, "is ROS 2's: controllers are to be directly below the robot's namespace")
        else:
            self.source.add("used", path, f"namespace of {', '.join(map(str, tree))}")
        self.check(tree, path)

    def _model(self, path: str) -> Model | None:
        """The robot whose namespace a path is in; the nearest, where that of one is inside that of another."""
        if self.moved:
            return self.models[0]
        full = self.source.full(path)
        around = [model for model in self.models if names.is_under(full, model.namespace)]
        return max(around, key=lambda model: len(model.namespace), default=None)

    def _controller(self, path: str, tree: Mapping[str, Any]) -> None:
        type_name = str(tree["type"])
        self.found[self.source.full(path)] = type_name
        try:
            cls = registry.find(type_name)
        except registry.UnknownType as error:
            self.source.absent(f"{path}/type", error.message, error.hint or "", f"controller type {type_name}")
            for name, value in tree.items():
                if name != "type":
                    self.source.unknown(f"{path}/{name}", "has no effect, as the controller's type is unknown", value)
            return
        self.source.add(
            "used",
            f"{path}/type",
            f"{type_name}; on {' and '.join(i.type_name for i in _interfaces(cls)) or 'no interface'}",
        )
        parameters = _Parameters(self.source, path, cls, self._model(path))
        parameters.check(tree)
        self.claims[self.source.full(path)] = parameters.claims(tree)


class _Parameters:
    """The parameters of one controller of a known type."""

    def __init__(self, source: ParameterFile, path: str, cls: type[ControllerBase], model: Model | None) -> None:
        self.source = source
        self.path = path
        self.cls = cls
        self.declared = Declared(cls.parameters)
        self.robot = model.robot if model is not None else None
        self.driven = driven_joints(model.robot) if model is not None else {}

    def check(self, tree: Mapping[str, Any]) -> None:
        values = {name: value for name, value in self.declared.leaves(tree) if name != "type"}
        said = self._judge_gains(values)
        for name, value in values.items():
            if name not in said:
                self._value(name, value)
        for name, parameter in self.declared.missing(tree):
            loss = "its entry is skipped" if "[]/" in parameter.name else "the controller cannot be loaded"
            text = f"is missing: {parameter.kind.words}, {parameter.meaning}; {loss}"
            self.source.add("wrong", f"{self.path}/{name}", text)

    def claims(self, tree: Mapping[str, Any]) -> set[str]:
        """The joints that nobody else may command while the controller runs."""
        if not any(interface.claims for interface in _interfaces(self.cls)):
            return set()
        found: set[str] = set()
        for name, value in self.declared.leaves(tree):
            parameter = self.declared.find(name)
            named = parameter.kind.convert(value) if parameter is not None and parameter.names_joints else None
            found.update([named] if isinstance(named, str) else named or ())
        return found

    def _judge_gains(self, values: Mapping[str, Any]) -> set[str]:
        """Findings on gains without effect; the names that need no others."""
        said: set[str] = set()
        spaces = dict.fromkeys(name.rpartition("/")[0] for name in values)
        for space in spaces:
            prefix = f"{space}/" if space else ""
            if self.declared.find(f"{prefix}i_clamp") is None:
                continue
            own = {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}
            for name, verdict, text in gains.judge(own):
                self.source.add(verdict, f"{self.path}/{prefix}{name}", text)
                said.add(prefix + name)
        return said

    def _value(self, name: str, value: Any) -> None:
        path = f"{self.path}/{name}"
        parameter = self.declared.find(name)
        if parameter is None:
            near = self.declared.closest(name)
            hint = f"did you mean {near!r}?" if near else f"it knows {listing(self.declared.names())}"
            self.source.unknown(path, f"{_UNKNOWN}; {hint}", value)
            return
        trouble = self._joint_trouble(parameter, value)
        number = parameter.kind.convert(value) if parameter.unless_positive else None
        if trouble:
            self.source.add("wrong", path, trouble)
        elif number is not None and not number > 0:
            self.source.add("ignored", path, f"{value} is not above 0: {parameter.unless_positive}")
        else:
            self.source.value(path, value, parameter)
            for index in self.declared.strays(name, value):
                self.source.add("wrong", f"{path}[{index}]", "must be a mapping; it is skipped")

    def _joint_trouble(self, parameter: Parameter, value: Any) -> str | None:
        """Why the robot has not what a parameter names; None without a robot, or when it has."""
        named = parameter.kind.convert(value) if parameter.names_joints else None
        if self.robot is None or named is None:
            return None
        troubles = (self._trouble_with(joint) for joint in ([named] if isinstance(named, str) else named))
        return next((trouble for trouble in troubles if trouble), None)

    def _trouble_with(self, joint: str) -> str | None:
        assert self.robot is not None
        if joint not in self.robot.joints:
            near = closest(joint, self.robot.joints)
            hint = f"did you mean {near!r}? " if near else ""
            return f"the robot has no joint {joint!r}; {hint}joints: {listing(self.robot.joints)}"
        if joint not in self.driven:
            return f"no transmission drives joint {joint!r}, so controllers do not know it"
        wanted = {interface.type_name.rpartition("::")[2] for interface in _interfaces(self.cls)}
        offered = self.driven[joint]
        if wanted and not wanted & {offered, JointStateInterface.__name__}:
            return f"the transmission of joint {joint!r} offers {offered}, the controller needs {' or '.join(wanted)}"
        return None


def _is_controller(tree: Mapping[str, Any]) -> bool:
    return isinstance(tree.get("type"), str)


def _interfaces(cls: type[ControllerBase]) -> list[type[ResourceManager[Any]]]:
    """The hardware interfaces of a class of controllers."""
    one = getattr(cls, "interface_type", None)
    return [one] if one is not None else list(getattr(cls, "interface_types", ()))


def _likely_types(tree: Mapping[str, Any]) -> list[str]:
    """The types of controllers that have parameters of just these names, those that need most of them first."""
    values = [(name, cls) for name in registry.types() if (cls := registry.find(name)).parameters]
    fitting = []
    for name, cls in values:
        declared = Declared(cls.parameters)
        required = [parameter.name for parameter in cls.parameters if parameter.required and "<" not in parameter.name]
        given = [leaf for leaf, _ in declared.leaves(tree)]
        if all(declared.find(leaf) for leaf in given) and any(leaf in required for leaf in given):
            fitting.append((len(set(required) - set(given)), name))
    return [name for _, name in sorted(fitting)]
