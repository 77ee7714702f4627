"""What `/slidectl/wait` waits for: a condition on one value, its wording, and how far a value is from it.

Pure judgement of values; when they come and how long it takes is not known here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

from slidectl.errors import BadMessage, UnknownName

_NUMERIC = ("near", "above", "below")
KINDS = (*_NUMERIC, "equals")
_LONGEST = 120


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
        if kind in _NUMERIC and (self._number is None or not math.isfinite(self._number)):
            raise BadMessage(f"{kind} needs a number, not {value[:80]}", "value")

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

    def distance(self, value: Any) -> float:
        """How far the value is from fulfilling it, in its unit: 0 or less when it does, inf when beyond compare."""
        number = as_number(value)
        if self.kind == "equals":
            return self._from_equal(value, number)
        if number is None or self._number is None or math.isnan(number):
            return math.inf
        return _DISTANCES[self.kind](number, self._number, self.tolerance)

    def _from_equal(self, value: Any, number: float | None) -> float:
        if number is None or self._number is None:
            same = value == self.wanted and isinstance(value, bool) == isinstance(self.wanted, bool)
            return 0.0 if same else math.inf
        if (number if isinstance(value, dict) else value) == self.wanted:
            return 0.0
        return math.inf if math.isnan(number) else _more_than_0(abs(number - self._number))


def show(value: Any) -> str:
    """Short text of a value for messages: numbers with six digits, all else as JSON, cut where it is long."""
    if isinstance(value, float):
        return f"{value:.6g}"
    text = json.dumps(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."


def _parse(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise BadMessage(f"the value {text[:80]!r} is not JSON", "value", 'text needs quotes: "\\"on\\""') from None


def _more_than_0(distance: float) -> float:
    """A limit that does not count itself."""
    return distance if distance != 0 else 5e-324


_DISTANCES: dict[str, Callable[[float, float, float], float]] = {
    "near": lambda value, wanted, tolerance: max(wanted - tolerance - value, value - (wanted + tolerance)),
    "above": lambda value, wanted, _: _more_than_0(wanted - value),
    "below": lambda value, wanted, _: _more_than_0(value - wanted),
}


def as_number(value: Any) -> float | None:
    """The value as a number (a time in seconds), or None when it is none."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return _as_float(value)
    if isinstance(value, dict) and value.keys() == {"secs", "nsecs"}:
        return float(value["secs"] + 1e-9 * value["nsecs"])
    return None


def _as_float(value: int | float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
