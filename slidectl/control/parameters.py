"""What a controller says of its parameters: name, type, meaning, unit, default.

Declarations only, for whoever looks at a file before anything runs. The reading itself is params.py; a test holds
the two against each other.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from slidectl.control.params import BOOLEAN, INTEGER, NUMBER, NUMBERS, TEXT, TEXTS, Kind

__all__ = ["BOOLEAN", "FLOAT", "INTEGER", "LIST", "NUMBER", "NUMBERS", "TEXT", "TEXTS", "Parameter", "within"]

LIST = Kind("a list", lambda value: value if isinstance(value, list) else None)
FLOAT = Kind("a float, as 0.0", lambda value: value if isinstance(value, float) else None)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a controller."""

    name: str
    """Below the controller's name: `pid/p`; `extra_joints[]/name` in each entry of a list; in `gains/<joint>/p` any
    name may stand for `<joint>`."""
    kind: Kind[Any]
    meaning: str
    unit: str = ""
    default: Any = None
    """What counts when it is not set; None: nothing does, or it is required."""
    required: bool = False
    names_joints: bool = False
    """Its value is the name of a joint of the robot, or a list of such."""
    unless_positive: str = ""
    """What becomes of a number that is not above 0; empty: such a number is like any other."""


def within(prefix: str, parameters: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """The same parameters below a name."""
    return tuple(replace(parameter, name=f"{prefix}/{parameter.name}") for parameter in parameters)


JOINT = Parameter("joint", TEXT, "the joint that it drives", required=True, names_joints=True)
