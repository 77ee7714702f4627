"""Parameters that the simulated hardware reads: `joint_limits/<joint>` and `gazebo_ros_control/pid_gains/<joint>`.

After gazebo_ros_control's DefaultRobotHWSim: which of them count, and for which joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from slidectl.check import gains
from slidectl.check.declared import Declared
from slidectl.check.model import Model, driven_joints
from slidectl.check.parameter_file import ParameterFile
from slidectl.control.hardware_interface import EffortJointInterface
from slidectl.control.limits import LIMITS
from slidectl.control.reconfigurable_pid import GAINS
from slidectl.errors import closest, listing

PLACES = ("joint_limits", "gazebo_ros_control")
GAINS_PLACE = "pid_gains"

UNKNOWN = "simulated hardware does not read it"
"""How findings on names that nobody knows begin."""

# A flag, and the values that it lets count.
_GROUPS = {
    "has_position_limits": ("min_position", "max_position"),
    "has_velocity_limits": ("max_velocity",),
    "has_acceleration_limits": ("max_acceleration",),
    "has_jerk_limits": ("max_jerk",),
    "has_effort_limits": ("max_effort",),
    "has_soft_limits": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
}
_UNREAD = {
    "has_jerk_limits": "simulated hardware bounds no jerk",
    "has_soft_limits": "simulated hardware takes soft limits from <safety_controller> only",
}


def check(source: ParameterFile, place: str, path: str, tree: Mapping[str, Any], model: Model | None) -> None:
    """Findings on the parameters at one of PLACES, which is at `path`, in the namespace of the robot `model`."""
    if place == "joint_limits":
        _Joints(source, Declared(LIMITS), model).check(path, tree)
        return
    for key, value in tree.items():
        if key == GAINS_PLACE and isinstance(value, Mapping):
            _Joints(source, Declared(GAINS), model, are_gains=True).check(f"{path}/{key}", value)
        else:
            source.unknown(f"{path}/{key}", "simulated hardware does not read it", value)


class _Joints:
    """A mapping from joints to their parameters."""

    def __init__(self, source: ParameterFile, declared: Declared, model: Model | None, are_gains: bool = False) -> None:
        self.source = source
        self.declared = declared
        self.robot = model.robot if model is not None else None
        self.are_gains = are_gains

    def check(self, path: str, tree: Mapping[str, Any]) -> None:
        for joint, values in tree.items():
            below = f"{path}/{joint}"
            if trouble := self._trouble(joint):
                self.source.add("wrong" if "no joint" in trouble else "ignored", below, trouble)
            elif isinstance(values, Mapping):
                self._joint(below, values)
            else:
                self.source.add("wrong", below, "must hold the parameters of a joint")

    def _trouble(self, joint: str) -> str | None:
        if self.robot is None:
            return None
        if joint not in self.robot.joints:
            near = closest(joint, self.robot.joints)
            hint = f"did you mean {near!r}? " if near else ""
            return f"the robot has no joint {joint!r}; {hint}joints: {listing(self.robot.joints)}"
        interface = driven_joints(self.robot).get(joint)
        if not interface:
            return f"no transmission drives joint {joint!r}, so simulated hardware does not read it"
        if self.are_gains and interface == EffortJointInterface.__name__:
            return f"joint {joint!r} takes efforts, for which simulated hardware needs no PID"
        return None

    def _joint(self, path: str, values: Mapping[str, Any]) -> None:
        judged = {name: (verdict, text) for name, verdict, text in (gains.judge if self.are_gains else _limits)(values)}
        for name, value in values.items():
            parameter = self.declared.find(name)
            if name in judged:
                self.source.add(judged[name][0], f"{path}/{name}", judged[name][1])
            elif parameter is None:
                near = self.declared.closest(name)
                hint = f"did you mean {near!r}?" if near else f"known: {listing(self.declared.names())}"
                self.source.unknown(f"{path}/{name}", f"{UNKNOWN}; {hint}", value)
            else:
                self.source.value(f"{path}/{name}", value, parameter)
        for name, parameter in self.declared.missing(values):
            text = f"is missing: {parameter.kind.words}, {parameter.meaning}; without it the joint has no PID"
            self.source.add("wrong", f"{path}/{name}", text)


def _limits(values: Mapping[str, Any]) -> Iterator[gains.Judgement]:
    """Values without their flag, and flags without their values."""
    for flag, bounds in _GROUPS.items():
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
