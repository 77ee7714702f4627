"""PID gains that have no effect, or not the one that was meant, by the equation that pid.py computes.

Judges values of one namespace of gains; what is unremarkable is not mentioned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite, isnan
from typing import Any

from slidectl.control.params import as_boolean, as_number
from slidectl.description.robot import Verdict

NAMES = frozenset(("p", "i", "d", "i_clamp", "i_clamp_min", "i_clamp_max", "antiwindup", "publish_state"))

Judgement = tuple[str, Verdict, str]
"""The gain's name, and what is to be said of it."""


def judge(values: Mapping[str, Any]) -> Iterator[Judgement]:
    """What is to be said of the gains `p`, `i` and so on in `values`; of values that are no numbers nothing."""
    numbers = {name: number for name in values if (number := as_number(values[name])) is not None}
    for name, number in numbers.items():
        if isnan(number) or (name in ("p", "i", "d") and not isfinite(number)):
            yield name, "wrong", f"{number} is no finite number: the gains are refused"
            return
    yield from _signs(numbers)
    yield from _integral(numbers, as_boolean(values.get("antiwindup")))


def _signs(numbers: Mapping[str, float]) -> Iterator[Judgement]:
    gains = {name: numbers[name] for name in ("p", "i", "d") if name in numbers}
    if "p" in gains and not any(gains.values()):
        yield "p", "wrong", "0.0, as are all gains: the controller never pushes"
    for name, value in gains.items():
        if value < 0:
            yield name, "wrong", f"{value:g} is negative: it drives away from the set point"


def _integral(numbers: Mapping[str, float], antiwindup: bool | None) -> Iterator[Judgement]:
    gain = numbers.get("i", 0.0)
    lower, upper = _clamp(numbers)
    if gain == 0:
        for name in ("i_clamp", "i_clamp_min", "i_clamp_max"):
            if name in numbers:
                yield name, "ignored", f"{numbers[name]:g} bounds nothing, as i is 0"
        if antiwindup:
            yield "antiwindup", "ignored", "true has no effect, as i is 0"
        return
    if lower == upper == 0:
        yield "i", "ignored", f"{gain:g} has no effect without i_clamp (or i_clamp_min and i_clamp_max)"
        if antiwindup:
            yield "antiwindup", "ignored", "true has no effect, as the integral is bounded to 0"
    yield from _clamps(numbers)


def _clamps(numbers: Mapping[str, float]) -> Iterator[Judgement]:
    if "i_clamp" in numbers and {"i_clamp_min", "i_clamp_max"} <= numbers.keys():
        yield "i_clamp", "ignored", f"{numbers['i_clamp']:g} has no effect beside i_clamp_min and i_clamp_max"
    elif numbers.get("i_clamp", 0.0) < 0:
        yield "i_clamp", "converted", f"{numbers['i_clamp']:g} is taken as {-numbers['i_clamp']:g}"
    if numbers.get("i_clamp_min", 0.0) > 0:
        yield "i_clamp_min", "converted", f"{numbers['i_clamp_min']:g} is taken as {-numbers['i_clamp_min']:g}"
    if numbers.get("i_clamp_max", 0.0) < 0:
        yield "i_clamp_max", "converted", f"{numbers['i_clamp_max']:g} is taken as {-numbers['i_clamp_max']:g}"


def _clamp(numbers: Mapping[str, float]) -> tuple[float, float]:
    """The bounds of the integral term that these values give."""
    both = abs(numbers.get("i_clamp", 0.0))
    return -abs(numbers.get("i_clamp_min", both)), abs(numbers.get("i_clamp_max", both))
