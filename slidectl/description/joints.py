"""`<joint>`: type, axis, limits, dynamics, safety_controller, mimic.

Rules of urdfdom for what is mandatory, of sdformat for limits the wrong way round. Whether parents, children and
mimic masters exist is structure.py.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import cast, get_args

from slidectl.description import values
from slidectl.description.report import Report
from slidectl.description.robot import Joint, JointType, Limit, Mimic, Pose, Safety, Vector
from slidectl.description.xml_tree import Element

_TYPES: tuple[str, ...] = get_args(JointType)
_WITH_AXIS = ("revolute", "continuous", "prismatic", "planar")
_WITH_RANGE = ("revolute", "prismatic")
_CHILDREN = {"parent", "child", "origin", "axis", "limit", "dynamics", "safety_controller", "mimic", "calibration"}


STARTS_OUTSIDE = "the joint starts at 0, outside of its limits"
"""How the notice of such a joint begins: whoever puts it elsewhere at once need not hear of it."""


def tell_starts(
    joints: Mapping[str, Joint], elements: Mapping[str, Element], moved: Collection[str], report: Report
) -> None:
    """Report the joints that start outside of their limits; not those `moved` by position commands, into the limits."""
    for joint in joints.values():
        limit = joint.limit
        if limit is None or joint.type not in _WITH_RANGE or joint.name in moved or limit.lower == limit.upper:
            continue
        if not limit.lower <= 0 <= limit.upper:
            place = elements[joint.name].find("limit") or elements[joint.name]
            report.wrong(place, f"{STARTS_OUTSIDE} {limit.lower:g} to {limit.upper:g}", place_of_limit(joint.name))


def place_of_limit(joint: str) -> str:
    """The subject of notices on a joint's range."""
    return f"joint {joint!r}/<limit>"


class JointReader:
    """Reads `<joint>` elements of one robot."""

    def __init__(self, report: Report) -> None:
        self.report = report

    def read(self, element: Element) -> Joint:
        """One joint.

        Raises:
            BadFile: anything that is missing, malformed or impossible.
        """
        name = values.required(element, "name", "joint")
        owner = f"joint {name!r}"
        self.report.unknown(element, {"name", "type"}, _CHILDREN)
        kind = _type(element, owner)
        limit = self._limit(element, kind, owner)
        damping, friction = self._dynamics(element, kind, owner)
        self._calibration(element, owner)
        return Joint(
            name,
            kind,
            self._link(element, "parent", owner),
            self._link(element, "child", owner),
            self._origin(element, owner),
            self._axis(element, kind, owner),
            limit,
            damping,
            friction,
            self._safety(element, kind, limit, owner),
            self._mimic(element, kind, owner),
            element.line,
            element.file,
        )

    def _link(self, element: Element, tag: str, owner: str) -> str:
        child = self.report.only(element, tag)
        if child is None:
            raise element.error(f"{owner} lacks <{tag}>")
        self.report.unknown(child, {"link"}, (), f"{owner}/<{tag}>")
        return values.required(child, "link", owner)

    def _origin(self, element: Element, owner: str) -> Pose:
        origin = self.report.only(element, "origin")
        if origin is not None:
            self.report.unknown(origin, {"xyz", "rpy"}, (), f"{owner}/<origin>")
        return values.pose(origin, owner)

    def _axis(self, element: Element, kind: JointType, owner: str) -> Vector:
        axis = self.report.only(element, "axis")
        if axis is None:
            return (1.0, 0.0, 0.0)
        if kind not in _WITH_AXIS:
            self.report.ignored(axis, f"a {kind} joint has no axis", f"{owner}/<axis>")
            return (1.0, 0.0, 0.0)
        self.report.unknown(axis, {"xyz"}, (), f"{owner}/<axis>")
        x, y, z = values.vector(axis, "xyz", owner)
        length = math.hypot(x, y, z)
        if length == 0.0 or math.isinf(length):
            raise axis.error(f"{owner}: <axis> is {axis.get('xyz')!r}, which is no direction")
        if abs(length - 1.0) <= 1e-9:
            # Left as written: dividing by a length that is 1 but for its rounding would only move the last digit.
            return x, y, z
        self.report.converted(axis, f"made a unit vector; its length is {length:g}", f"{owner}/<axis>")
        return x / length, y / length, z / length

    def _limit(self, element: Element, kind: JointType, owner: str) -> Limit | None:
        limit = self.report.only(element, "limit")
        if limit is None:
            if kind in _WITH_RANGE:
                raise element.error(f"{owner} is {kind} and lacks <limit>", "add <limit lower upper effort velocity/>")
            return None
        if kind not in (*_WITH_RANGE, "continuous"):
            self.report.ignored(limit, f"a {kind} joint has no limits", f"{owner}/<limit>")
            return None
        self.report.unknown(limit, {"lower", "upper", "effort", "velocity"}, (), f"{owner}/<limit>")
        effort = values.not_negative(limit, "effort", owner)
        velocity = values.not_negative(limit, "velocity", owner)
        lower, upper = self._range(limit, kind, owner)
        return Limit(lower, upper, velocity, effort, limit.line)

    def _range(self, limit: Element, kind: JointType, owner: str) -> tuple[float, float]:
        place = f"{owner}/<limit>"
        if kind == "continuous":
            for name in ("lower", "upper"):
                if name in limit.attributes:
                    self.report.ignored(limit, f"a continuous joint has no {name!r}", place, name)
            return 0.0, 0.0
        lower = values.number(limit, "lower", owner, 0.0)
        upper = values.number(limit, "upper", owner, 0.0)
        if lower > upper:
            self.report.converted(limit, f"lower {lower:g} is above upper {upper:g}; they are swapped", place)
            return upper, lower
        if lower == upper:
            self.report.wrong(limit, f"lower and upper are both {lower:g}: the joint cannot move", place)
        return lower, upper

    def _dynamics(self, element: Element, kind: JointType, owner: str) -> tuple[float, float]:
        dynamics = self.report.only(element, "dynamics")
        if dynamics is None:
            return 0.0, 0.0
        if kind == "fixed":
            self.report.ignored(dynamics, "a fixed joint does not move", f"{owner}/<dynamics>")
            return 0.0, 0.0
        self.report.unknown(dynamics, {"damping", "friction"}, (), f"{owner}/<dynamics>")
        damping = values.not_negative(dynamics, "damping", owner, 0.0)
        return damping, values.not_negative(dynamics, "friction", owner, 0.0)

    def _calibration(self, element: Element, owner: str) -> None:
        for calibration in element.find_all("calibration"):
            self.report.ignored(calibration, "simulated joints need no calibration", f"{owner}/<calibration>")

    def _safety(self, element: Element, kind: JointType, limit: Limit | None, owner: str) -> Safety | None:
        safety = self.report.only(element, "safety_controller")
        if safety is None:
            return None
        place = f"{owner}/<safety_controller>"
        known = {"soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"}
        self.report.unknown(safety, known, (), place)
        if limit is None:
            self.report.ignored(safety, "the joint has no <limit>", place)
            return None
        lower = values.number(safety, "soft_lower_limit", owner, 0.0)
        upper = values.number(safety, "soft_upper_limit", owner, 0.0)
        k_position = values.number(safety, "k_position", owner, 0.0)
        read = Safety(lower, upper, k_position, values.number(safety, "k_velocity", owner))
        if kind in _WITH_RANGE:
            self._compare(safety, read, limit, place)
        return read

    def _compare(self, element: Element, safety: Safety, limit: Limit, place: str) -> None:
        if safety.soft_lower_limit > safety.soft_upper_limit:
            self.report.wrong(element, "soft_lower_limit is above soft_upper_limit", place)
        if safety.soft_lower_limit < limit.lower or safety.soft_upper_limit > limit.upper:
            text = (
                f"soft limits {safety.soft_lower_limit:g} to {safety.soft_upper_limit:g} lie outside "
                f"of the hard ones, {limit.lower:g} to {limit.upper:g}"
            )
            self.report.wrong(element, text, place)
        if safety.k_position == 0.0:
            text = "with k_position 0 the soft limits allow no velocity at all"
            self.report.add("wrong", element, text, place, "k_position")

    def _mimic(self, element: Element, kind: JointType, owner: str) -> Mimic | None:
        mimic = self.report.only(element, "mimic")
        if mimic is None:
            return None
        if kind not in (*_WITH_RANGE, "continuous"):
            self.report.ignored(mimic, f"a {kind} joint cannot follow another", f"{owner}/<mimic>")
            return None
        self.report.unknown(mimic, {"joint", "multiplier", "offset"}, (), f"{owner}/<mimic>")
        multiplier = values.number(mimic, "multiplier", owner, 1.0)
        return Mimic(values.required(mimic, "joint", owner), multiplier, values.number(mimic, "offset", owner, 0.0))


def _type(element: Element, owner: str) -> JointType:
    kind = values.required(element, "type", owner)
    if kind not in _TYPES:
        raise values.unknown(element, owner, "joint type", kind, _TYPES)
    return cast(JointType, kind)
