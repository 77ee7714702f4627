"""`/slidectl/wait`: answered when a value of a topic has fulfilled a condition long enough, or the time is up.

The condition is tested at every message, in simulated time, and answered in that cycle. Between two messages the last
value is valid.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from slidectl import msgs
from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.effects import Effect
from slidectl.errors import BadMessage, Refused, UnknownName
from slidectl.msgs.field_path import NoElement, select
from slidectl.names import OWN_NODE
from slidectl.simulation.clock import Timer
from slidectl.simulation.feature import Feature
from slidectl.simulation.graph import Graph
from slidectl.simulation.pending import Pending
from slidectl.simulation.topics import TopicSubscription

if TYPE_CHECKING:
    from slidectl.simulation.simulation import Simulation

KINDS = ("near", "above", "below", "equals")
_NOTHING: Any = object()
_LONGEST_S = 1e9
_LONGEST_SHOWN = 120


class Waits(Feature):
    """The service."""

    def attach(self, simulation: Simulation) -> None:
        advertise(simulation.graph)


def advertise(graph: Graph) -> None:
    """Provide the service."""
    node = graph.node(OWN_NODE, OWN_NODE)
    node.advertise_service("wait", "slidectl/Wait", lambda request: Wait(graph, request).pending, Effect.READS)


def _duration(name: str, value: float) -> float:
    """The value, 0 (none) or more. Raises Refused for one that no clock can measure."""
    if not -_LONGEST_S < value < _LONGEST_S:
        raise Refused(f"{name} is a number of seconds, not {value:g}")
    return max(value, 0.0)


class Condition:
    """`near` (within the tolerance, limits included), `above`, `below` (strictly), or `equals` any JSON value."""

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
        try:
            self.wanted = json.loads(value)
        except (ValueError, RecursionError):
            reason = f"the value {value[:80]!r} is not JSON"
            raise BadMessage(reason, "value", 'text needs quotes: "\\"on\\""') from None
        number = as_number(self.wanted)
        if kind != "equals" and (number is None or not math.isfinite(number)):
            raise BadMessage(f"{kind} needs a number, not {value[:80]}", "value")
        self._number = math.nan if number is None else number

    def __str__(self) -> str:
        text = f"{self.kind} {_shown(self.wanted)}"
        return f"{text} ± {_shown(self.tolerance)}" if self.kind == "near" else text

    def check_type(self, path: str, type_name: str) -> None:
        """Raise BadMessage when values of the type can never be compared in this way."""
        comparable = type_name not in ("string", "bool") and "/" not in type_name and not type_name.endswith("]")
        if self.kind != "equals" and not comparable:
            reason = f"{path} is {type_name}, and {self.kind} needs a number"
            element = f": {path}[0] is the first" if type_name.endswith("]") else ""
            raise BadMessage(reason, "field", f"choose a field or an element{element}")

    def distance(self, value: Any) -> float:
        """The distance of the value from the condition, in its unit: at most 0 when met, inf when not comparable."""
        number, wanted = as_number(value), self._number
        if self.kind == "equals" and (number is None or math.isnan(wanted)):
            same = value == self.wanted and isinstance(value, bool) == isinstance(self.wanted, bool)
            return 0.0 if same else math.inf
        if number is None or math.isnan(number):
            return math.inf
        if self.kind == "equals":  # integers are compared as integers: as floats, large ones would be equal
            is_equal = (number if isinstance(value, dict) else value) == self.wanted
            return 0.0 if is_equal else _more_than_0(abs(number - wanted))
        if self.kind == "near":
            return max(wanted - self.tolerance - number, number - (wanted + self.tolerance))
        return _more_than_0(wanted - number if self.kind == "above" else number - wanted)


def _more_than_0(distance: float) -> float:
    """The distance to a limit that is excluded: never 0."""
    return distance if distance != 0 else 5e-324


def _shown(value: Any) -> str:
    """Short text of a value for messages: numbers with six digits, others as JSON, cut when long."""
    if isinstance(value, float):
        return f"{value:.6g}"
    text = json.dumps(value)
    return text if len(text) <= _LONGEST_SHOWN else text[: _LONGEST_SHOWN - 3] + "..."


def as_number(value: Any) -> float | None:
    """The value as a number (a time in seconds), or None when it is none."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            return math.inf if value > 0 else -math.inf
    if isinstance(value, dict) and value.keys() == {"secs", "nsecs"}:
        return float(value["secs"] + 1e-9 * value["nsecs"])
    return None


class Wait:
    """One wait. `hold` 0: the first message that fulfils the condition is enough; `within` 0: no limit."""

    def __init__(self, graph: Graph, request: Message) -> None:
        """
        Raises:
            UnknownName: no such topic, field or condition. BadMessage: value, condition and field do not go together.
            Refused: times that no clock can measure.
        """
        self.pending = Pending(on_cancel=self._close)
        self._graph = graph
        self._topic: str = request["topic"]
        type_name = graph.topics.type_of(self._topic)
        field = request["field"]
        if not field:
            fields = [one.name for one in msgs.fields(type_name)]
            if len(fields) != 1:
                raise UnknownName("field", "", fields, f"in {type_name}: say which")
            field = fields[0]
        selection = select(lambda owner: msgs.fields(owner) if "/" in owner else (), type_name, field)
        self._path = f"{self._topic}/{field}"
        self._select = selection.read
        self._condition = Condition(request["condition"], request["value"], request["tolerance"])
        self._condition.check_type(self._path, selection.type + "[]" * selection.depth)
        self._hold_s = _duration("hold", request["hold"])
        self._within_s = within_s = _duration("within", request["within"])
        self._last: Any = _NOTHING
        self._closest: Any = _NOTHING
        self._least = math.inf
        self._holding: Timer | None = None
        self._deadline = graph.timers.after(from_seconds(within_s), self._time_is_up) if within_s else None
        self._subscription: TopicSubscription | None = None
        self._subscription = graph.topics.subscribe(self._topic, None, OWN_NODE, self._receive)
        if self.pending.done:  # by a latched message, before there was a subscription to close
            self._close()

    def _receive(self, message: Message) -> None:
        if self.pending.done:
            return
        try:
            value = self._select(message)
        except NoElement as error:
            self._close()
            self.pending.reject(error)
            return
        distance = self._condition.distance(value)
        self._last = value
        if self._closest is _NOTHING or distance < self._least:
            self._closest, self._least = value, distance
        if not distance <= 0:  # also NaN: not fulfilled
            if self._holding is not None:
                self._holding.cancel()
                self._holding = None
        elif not self._hold_s:
            self._finish(True)
        elif self._holding is None:
            self._holding = self._graph.timers.after(from_seconds(self._hold_s), lambda: self._finish(True))

    def _time_is_up(self) -> None:
        """Finish: it also succeeds when holding is complete at this very time."""
        self._finish(self._holding is not None and self._holding.due_ns <= self._graph.clock.time_ns)

    def _finish(self, success: bool) -> None:
        self._close()
        condition = f"{self._condition} for {self._hold_s:g} s" if self._hold_s else str(self._condition)
        if success:
            text = f"{self._path} is {_shown(self._last)} ({condition})"
        else:
            text = f"expected {self._path} {condition} within {self._within_s:g} s{self._why_not()}"
        self.pending.resolve(
            {
                "success": success,
                "message": text,
                "last": "" if self._last is _NOTHING else json.dumps(self._last),
                "closest": "" if self._closest is _NOTHING else json.dumps(self._closest),
                "time": self._graph.clock.seconds,
            }
        )

    def _why_not(self) -> str:
        alone = "" if self._graph.topics.publishers(self._topic) else "; it has no publisher"
        if self._last is _NOTHING:
            return alone or "; no message came"
        return f"; last {_shown(self._last)}, closest {_shown(self._closest)}{alone}"

    def _close(self) -> None:
        for part in (self._holding, self._deadline):
            if part is not None:
                part.cancel()
        if self._subscription is not None:
            self._subscription.close()
