"""Attributes of elements as numbers and vectors. Errors name the element, its file and its line.

Numbers are decimal, as "1", "-0.5" and "1e-3", and finite. This module does not know what tags mean.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection

from slidectl.description.robot import Pose, Vector
from slidectl.description.xml_tree import Element, below
from slidectl.errors import BadFile, UnknownName

LONGEST_PERIOD_S = 2**31 - 1
"""The largest duration of ROS."""
_INFINITE = ("inf", "infinity")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def unknown(element: Element, place: str, kind: str, name: str, known: Collection[str]) -> BadFile:
    """The error for a name that does not exist: it lists the existing ones, and suggests the closest."""
    error = UnknownName(kind, name, list(known))
    return element.error(f"{place}: {error.message}", error.hint)


def parse_number(text: str, element: Element, what: str, finite: bool = True) -> float:
    """Convert `text` to a number, a finite one unless `finite` is False. `what` names the value in the error."""
    stripped = text.strip()
    if not finite and stripped.lower().lstrip("+-") in _INFINITE:
        return float(stripped)
    if not _NUMBER.fullmatch(stripped):
        raise element.error(f"{what} is {text!r}, which is {_why_not(stripped)}")
    value = float(stripped)
    if finite and not math.isfinite(value):
        raise element.error(f"{what} is {text!r}, which is too large for a number")
    return value


def _why_not(text: str) -> str:
    if text.lower().lstrip("+-") in {"nan", *_INFINITE}:
        return "not a finite number"
    if _NUMBER.fullmatch(text.replace(",", ".", 1)):
        return "not a number (the decimal sign is a point)"
    return "not a number"


def required(element: Element, name: str, owner: str) -> str:
    """A mandatory attribute that must not be empty."""
    value = element.get(name)
    if value is None:
        raise element.error(f"{owner}: <{element.tag}> lacks the attribute {name!r}")
    if not value.strip():
        raise element.error(f"{owner}: attribute {name!r} of <{element.tag}> is empty")
    return value


def number(element: Element, name: str, owner: str, default: float | None = None) -> float:
    """A number attribute; mandatory when `default` is None."""
    if default is not None and name not in element.attributes:
        return default
    return parse_number(required(element, name, owner), element, f"{owner}: {name!r} of <{element.tag}>")


def not_negative(element: Element, name: str, owner: str, default: float | None = None) -> float:
    """A number attribute that must not be negative."""
    value = number(element, name, owner, default)
    if value < 0:
        raise element.error(f"{owner}: {name!r} of <{element.tag}> is {value:g}; it must not be negative")
    return value


def child_text(element: Element, tag: str, default: str) -> str:
    """The text of a child; the default when the child is missing or empty."""
    child = element.find(tag)
    return child.first_text if child is not None and child.first_text else default


def child_number(element: Element | None, tag: str, default: float, place: str, finite: bool = True) -> float:
    """The number in a child; the default when the child is missing or empty."""
    child = below(element, tag)
    if child is None or not child.first_text:
        return default
    return parse_number(child.first_text, child, f"{place}/<{tag}>", finite)


def child_count(element: Element | None, tag: str, default: int, place: str) -> int:
    """The whole number in a child, read as by child_number."""
    value = child_number(element, tag, default, place)
    if element is not None and not value.is_integer():
        raise (element.find(tag) or element).error(f"{place}/<{tag}> is {value:g}; it must be a whole number")
    return int(value)


def child_rate(element: Element, tag: str, default: float, place: str) -> float:
    """The rate in a child, Hz, read as by child_number. 0 and infinity mean that there is no fixed period."""
    rate = child_number(element, tag, default, place, finite=False)
    if rate < 0.0 or 0.0 < rate < 1.0 / LONGEST_PERIOD_S:
        text = f"{place}/<{tag}> is {rate:g} Hz; it must not be negative, nor its period above {LONGEST_PERIOD_S} s"
        raise (element.find(tag) or element).error(text)
    return rate


def numbers(element: Element, name: str, count: int, owner: str) -> tuple[float, ...]:
    """A mandatory attribute of `count` numbers, separated by blanks."""
    text = required(element, name, owner)
    parts = text.split()
    what = f"{owner}: {name!r} of <{element.tag}>"
    if len(parts) != count:
        raise element.error(f"{what} is {text!r}: {len(parts)} numbers, expected {count}")
    return tuple(parse_number(part, element, what) for part in parts)


def vector(element: Element, name: str, owner: str) -> Vector:
    """A mandatory attribute of three numbers."""
    x, y, z = numbers(element, name, 3, owner)
    return (x, y, z)


def text_numbers(element: Element, count: int, what: str) -> tuple[float, ...]:
    """The text of an element as `count` numbers, separated by blanks. `what` names it in the error."""
    words = element.first_text.split()
    if len(words) != count:
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise element.error(f"{what} is {wanted}, not {element.first_text!r}")
    return tuple(parse_number(word, element, what) for word in words)


def pose_numbers(element: Element, what: str) -> tuple[Vector, Vector]:
    """Position and angles of an SDF `<pose>`. As in Gazebo, the angles are 0 unless all three of them are there.

    Raises BadFile: fewer than three numbers, more than six, or what is not a number.
    """
    words = element.first_text.split()
    if not 3 <= len(words) <= 6:
        raise element.error(f"{what} is 6 numbers, or 3 without its angles, not {element.first_text!r}")
    x, y, z, *angles = (parse_number(word, element, what) for word in words)
    roll, pitch, yaw = angles if len(angles) == 3 else (0.0, 0.0, 0.0)
    return (x, y, z), (roll, pitch, yaw)


def lacks_angles(element: Element) -> bool:
    """True for a `<pose>` with one or two angles, which have no effect."""
    return element.tag == "pose" and len(element.first_text.split()) in (4, 5)


LACKS_ANGLES = "lacks some of its three angles: it is a position without rotation, as in Gazebo"
"""The notice for a pose that `lacks_angles`."""


def pose(origin: Element | None, owner: str) -> Pose:
    """The pose of an `<origin xyz rpy>`; missing parts are zero."""
    if origin is None:
        return Pose()
    zero = (0.0, 0.0, 0.0)
    xyz = vector(origin, "xyz", owner) if "xyz" in origin.attributes else zero
    rpy = vector(origin, "rpy", owner) if "rpy" in origin.attributes else zero
    return Pose(xyz, rpy)
