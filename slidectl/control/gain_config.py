"""PID gains as dynamic_reconfigure messages, and back: names, ranges, and what is refused.

Pure conversions for `live_pid.py`. Ranges hold for what comes in as a configuration, not for what a file says.
"""

from __future__ import annotations

from math import isnan
from typing import Any, NamedTuple

from slidectl.control.limits import bounded
from slidectl.control.node import Message
from slidectl.control.pid import Gains
from slidectl.errors import Refused, UnknownName


class Ranged(NamedTuple):
    """A gain that is a number. `field` is its name in Gains."""

    name: str
    field: str
    description: str
    default: float
    minimum: float
    maximum: float


NUMBERS = (
    Ranged("p", "p", "Proportional gain", 10.0, -100000.0, 100000.0),
    Ranged("i", "i", "Integral gain", 0.1, -100000.0, 100000.0),
    Ranged("d", "d", "Derivative gain", 1.0, -1000.0, 1000.0),
    Ranged("i_clamp_min", "i_min", "Least integral term", -10.0, -100000.0, 0.0),
    Ranged("i_clamp_max", "i_max", "Largest integral term", 10.0, 0.0, 100000.0),
)
ANTIWINDUP = "antiwindup"
_GROUP = {"name": "Default", "id": 0, "parent": 0}


def to_parameters(gains: Gains) -> dict[str, float | bool]:
    """The six parameters that hold these gains."""
    values: dict[str, float | bool] = {entry.name: getattr(gains, entry.field) for entry in NUMBERS}
    return values | {ANTIWINDUP: gains.antiwindup}


def to_config(gains: Gains) -> Message:
    """As dynamic_reconfigure/Config."""
    return _config({entry.name: getattr(gains, entry.field) for entry in NUMBERS}, gains.antiwindup)


def description() -> Message:
    """The six gains with their ranges, as dynamic_reconfigure/ConfigDescription."""
    parameters = [_parameter(entry.name, "double", entry.description) for entry in NUMBERS]
    parameters.append(_parameter(ANTIWINDUP, "bool", "Bound the integral itself, not only its contribution"))
    return {
        "groups": [{**_GROUP, "type": "", "parameters": parameters}],
        "max": _config({entry.name: entry.maximum for entry in NUMBERS}, True),
        "min": _config({entry.name: entry.minimum for entry in NUMBERS}, False),
        "dflt": _config({entry.name: entry.default for entry in NUMBERS}, False),
    }


def merged(gains: Gains, config: Message) -> Gains:
    """`gains` with what a Config message changes, all of it brought into the ranges.

    Raises:
        UnknownName: an entry that is none of the six. Refused: a value that is no number.
    """
    changes: dict[str, Any] = {}
    for entry in config["doubles"]:
        changes[_known(entry["name"]).field] = _number(entry)
    for entry in config["bools"]:
        if entry["name"] != ANTIWINDUP:
            raise UnknownName("boolean gain", entry["name"], [ANTIWINDUP])
        changes[ANTIWINDUP] = entry["value"]
    if config["ints"] or config["strs"]:
        raise Refused("gains are doubles, and antiwindup is a bool; there are no ints and strs")
    return _in_range(gains._replace(**changes))


def _in_range(gains: Gains) -> Gains:
    inside: dict[str, Any] = {
        entry.field: bounded(getattr(gains, entry.field), entry.minimum, entry.maximum) for entry in NUMBERS
    }
    return gains._replace(**inside)


def _known(name: str) -> Ranged:
    for entry in NUMBERS:
        if entry.name == name:
            return entry
    raise UnknownName("gain", name, [entry.name for entry in NUMBERS])


def _number(entry: Message) -> float:
    value: float = entry["value"]
    if isnan(value):
        raise Refused(f"gain {entry['name']} must be a number, not nan")
    return value


def _parameter(name: str, type_name: str, text: str) -> Message:
    return {"name": name, "type": type_name, "level": 1, "description": text, "edit_method": ""}


def _config(numbers: dict[str, float], antiwindup: bool) -> Message:
    return {
        "bools": [{"name": ANTIWINDUP, "value": antiwindup}],
        "ints": [],
        "strs": [],
        "doubles": [{"name": name, "value": value} for name, value in numbers.items()],
        "groups": [{**_GROUP, "state": True}],
    }
