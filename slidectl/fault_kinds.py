"""The kinds of faults: what each acts on, its options and their defaults. Standard library only."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

from slidectl.errors import EXIT_USAGE, Refused, UnknownName, UsageError

QUANTITIES = ("position", "velocity", "effort")
"""What the sensor of a joint measures."""
REQUIRED = "required"


class FaultOption(NamedTuple):
    """An option of a fault. `form` is `number`, `vector` (three numbers) or `quantity`."""

    text: str
    form: str = "number"
    lowest: float = -math.inf
    highest: float = math.inf

    def read(self, name: str, value: Any) -> Any:
        """Check and convert a value: to a float, a tuple of three floats, or a quantity. Raises UsageError."""
        if self.form == "quantity":
            if value not in (*QUANTITIES, "all"):
                raise UsageError(f"{name} is one of {', '.join(QUANTITIES)} and all, not {value!r}")
            return value
        numbers = value if self.form == "vector" and isinstance(value, list | tuple) else [value]
        if len(numbers) != (3 if self.form == "vector" else 1) or not all(map(_is_number, numbers)):
            what = "three numbers" if self.form == "vector" else "a finite number"
            raise UsageError(f"{name} ({self.text}) is {what}, not {value!r}")
        for number in numbers:
            if not self.lowest <= number <= self.highest:
                bounds = f"{self.lowest:g} to {self.highest:g}"
                bounds = bounds if self.highest < math.inf else f"at least {self.lowest:g}"
                raise UsageError(f"{name} ({self.text}) is {bounds}, not {number:g}")
        return tuple(map(float, numbers)) if self.form == "vector" else float(value)


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) <= sys.float_info.max  # an int may be larger than any float


_SHORTEST_S = 1e-6
_LIGHTEST_KG = 1e-9
_HEAVIEST_KG = 1e9
_FARTHEST_M = 1e6
_STRONGEST = 1e12
"""N or N m. Beyond this the world has no finite numbers."""


class UnknownFaultKind(UnknownName):
    """An unknown kind of fault, which is a wrong option and not a missing thing."""

    exit_code = EXIT_USAGE


OPTIONS = {
    "of": FaultOption("the faulty quantity: position, velocity, effort or all", "quantity"),
    "sd": FaultOption("standard deviation, in the unit of the quantity", lowest=0.0),
    "bias": FaultOption("offset, in the unit of the quantity"),
    "rate": FaultOption("drift per simulated s, in the unit of the quantity"),
    "step": FaultOption("width of a step, in the unit of the quantity", lowest=1e-300),
    "delay": FaultOption("delay, s of simulated time", lowest=0.0, highest=3600.0),
    "probability": FaultOption("per cycle or message, from 0 to 1", lowest=0.0, highest=1.0),
    "limit": FaultOption("largest absolute value of a command, in its unit", lowest=0.0),
    "friction": FaultOption("dry friction, N or N m", lowest=0.0),
    "damping": FaultOption("viscous friction, N s/m or N m s/rad", lowest=0.0),
    "mass": FaultOption("added mass, kg", lowest=_LIGHTEST_KG, highest=_HEAVIEST_KG),
    "at": FaultOption("position on the link, in its frame, m", "vector", -_FARTHEST_M, _FARTHEST_M),
    "force": FaultOption("force in world axes, N", "vector", -_STRONGEST, _STRONGEST),
    "torque": FaultOption("torque in world axes, N m", "vector", -_STRONGEST, _STRONGEST),
    "takes": FaultOption("duration of an update, s of simulated time", lowest=_SHORTEST_S, highest=3600.0),
}
"""All options of all kinds, by name."""


class FaultKind(NamedTuple):
    """`target` is what the fault acts on: joint (with a transmission), moving joint, link, controller or topic.

    `options` maps names to defaults. REQUIRED means that there is no default, None that the model's value stays.
    """

    target: str
    text: str
    options: Mapping[str, Any] = {}


_POSITION = {"of": "position"}
_ALL = {"of": "all"}
_NOTHING = (0.0, 0.0, 0.0)

KINDS = {
    "sensor-noise": FaultKind("joint", "Gaussian noise on readings", {"sd": REQUIRED, **_POSITION}),
    "sensor-bias": FaultKind("joint", "constant error of readings", {"bias": REQUIRED, **_POSITION}),
    "sensor-drift": FaultKind("joint", "readings drift at a constant rate", {"rate": REQUIRED, **_POSITION}),
    "sensor-quantisation": FaultKind("joint", "readings come in steps", {"step": REQUIRED, **_POSITION}),
    "sensor-delay": FaultKind("joint", "readings come late", {"delay": REQUIRED, **_ALL}),
    "sensor-dropout": FaultKind("joint", "readings are lost: the last one stays", {"probability": REQUIRED, **_ALL}),
    "sensor-frozen": FaultKind("joint", "the last reading stays", _ALL),
    "command-delay": FaultKind("joint", "commands come late", {"delay": REQUIRED}),
    "command-loss": FaultKind("joint", "commands are lost: the last one stays", {"probability": REQUIRED}),
    "command-saturation": FaultKind("joint", "commands are limited", {"limit": REQUIRED}),
    "command-reversed": FaultKind("joint", "commands have the opposite sign"),
    "joint-stuck": FaultKind("moving joint", "it stays in place, whatever acts on it"),
    "joint-friction": FaultKind("moving joint", "its friction is changed", {"friction": None, "damping": None}),
    "payload": FaultKind("link", "a point mass is fixed to the link", {"mass": REQUIRED, "at": _NOTHING}),
    "push": FaultKind("link", "a wrench acts on its centre of mass", {"force": _NOTHING, "torque": _NOTHING}),
    "controller-raise": FaultKind("controller", "its update raises an exception, once: it is aborted"),
    "controller-slow": FaultKind("controller", "its update holds up the robot's whole cycle", {"takes": REQUIRED}),
    "controller-kill": FaultKind("controller", "it is stopped and unloaded, once"),
    "topic-loss": FaultKind("topic", "messages are lost", {"probability": REQUIRED}),
    "topic-delay": FaultKind("topic", "messages come late", {"delay": REQUIRED, "probability": 1.0}),
}
"""All kinds, by name."""


def check_span(start: float, end: float) -> None:
    """Raise Refused unless `end` is after `start` (both in s of simulated time)."""
    if end <= start:
        raise Refused(f"a fault from {start:g} s to {end:g} s never acts")


def checked_options(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """All options of a kind: the given ones, and the defaults of the others.

    Raises:
        UnknownFaultKind: no such kind. UsageError: an option is unknown, missing, or has a wrong value.
    """
    if kind not in KINDS:
        raise UnknownFaultKind("kind of fault", kind, list(KINDS))
    own = KINDS[kind].options
    taken = f"{kind} takes {', '.join(own) or 'no options'}"
    if unknown := [name for name in given if name not in own]:
        raise UsageError(f"{kind} has no option {', '.join(unknown)}", taken)
    options = {**own, **given}
    if missing := [name for name, value in options.items() if value == REQUIRED]:
        raise UsageError(f"{kind} needs {', '.join(f'{name} ({OPTIONS[name].text})' for name in missing)}", taken)
    found = {name: value if value is None else OPTIONS[name].read(name, value) for name, value in options.items()}
    if own and all(value is None or value == _NOTHING for value in found.values()):
        raise UsageError(f"{kind} changes nothing without {' or '.join(own)}", taken)
    return found
