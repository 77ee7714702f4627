"""What `/slidectl/wait` waits for: a condition on one value, its wording, and how far a value is from it.

Pure judgement of values; when they come and how long it takes is not known here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

from slidectl.errors import BadMessage, UnknownName
from slidectl.simulation.message_path import as_number

_NUMERIC = ("near", "above", "below")
KINDS = (*_NUMERIC, "equals")


class Condition:
    """`near` (within the tolerance, its edge included), `above`, `below` (strictly), or `equals` any JSON value."""

    def __init__(self, kind: str, value: str, tolerance: float = 0.0) -> None:
        """
        Args:
            kind: one of KINDS.
            value: JSON text.
            tolerance: of `near`, 0 or more.

        Raises:
            UnknownName: no such condition. BadMessage: the value or the tolerance makes no sense for it.
        """
        if kind not in KINDS:
            raise UnknownName("condition", kind, KINDS)
        if not tolerance >= 0 or math.isinf(tolerance):
            raise BadMessage(f"the tolerance is a number of 0 or more, not {tolerance:g}", "tolerance")
        self.kind = kind
        self.tolerance = tolerance
        self.wanted = _parse(value)
        self._number = as_number(self.wanted)
        if kind in _NUMERIC and (self._number is None or math.isnan(self._number)):
            raise BadMessage(f"{kind} needs a number, not {value}", "value")

    def __str__(self) -> str:
        text = f"{self.kind} {show(self.wanted)}"
        return f"{text} ± {show(self.tolerance)}" if self.kind == "near" else text

    def check_type(self, path: str, type_name: str) -> None:
        """Raises BadMessage when values of the type can never be compared like this."""
        comparable = type_name not in ("string", "bool") and "/" not in type_name and not type_name.endswith("]")
        if self.kind in _NUMERIC and not comparable:
            raise BadMessage(
                f"{path} is {type_name}, and {self.kind} needs a number", "field", "choose a field or an element"
            )

    def holds(self, value: Any) -> bool:
        """Whether the value fulfils the condition."""
        return self.distance(value) <= 0

    def distance(self, value: Any) -> float:
        """How far the value is from fulfilling it, in its unit: 0 or less when it does, inf when beyond compare."""
        number = as_number(value)
        if number is None or self._number is None:
            return (
                0.0 if self.kind == "equals" and value == self.wanted and _same_kind(value, self.wanted) else math.inf
            )
        if math.isnan(number):
            return math.inf
        return _DISTANCES[self.kind](number, self._number, self.tolerance)


def show(value: Any) -> str:
    """Short text of a value for messages: numbers with six digits, all else as JSON."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return json.dumps(value)


def _parse(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        raise BadMessage(f"the value {text[:80]!r} is not JSON", "value", 'text needs quotes: "\\"on\\""') from None


def _same_kind(value: Any, wanted: Any) -> bool:
    """True and 1 are equal to Python, not to a person."""
    return isinstance(value, bool) == isinstance(wanted, bool)


def _beyond(excess: float) -> float:
    """Strictly above: the limit itself does not count."""
    return excess if excess != 0 else 5e-324


_DISTANCES: dict[str, Callable[[float, float, float], float]] = {
    "near": lambda value, wanted, tolerance: max(wanted - tolerance - value, value - (wanted + tolerance)),
    "above": lambda value, wanted, _: _beyond(wanted - value),
    "below": lambda value, wanted, _: _beyond(value - wanted),
    "equals": lambda value, wanted, _: abs(value - wanted) if value != wanted else 0.0,
}
