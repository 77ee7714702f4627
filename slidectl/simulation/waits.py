"""`/slidectl/wait`: answered when a value of a topic has fulfilled a condition long enough, or the time is up.

Judged at every message, in simulated time, and answered in that cycle. Between two messages the last value counts.
"""

from __future__ import annotations

import json
import math
from typing import Any

from slidectl import msgs
from slidectl.control.duration import from_seconds
from slidectl.control.node_handle import Message
from slidectl.errors import Refused, UnknownName
from slidectl.field_path import NoElement, Selection, select
from slidectl.simulation.conditions import Condition, show
from slidectl.simulation.graph import Graph
from slidectl.simulation.pending import Pending
from slidectl.simulation.timers import Timer
from slidectl.simulation.topics import Subscription

NODE = "/slidectl"
_NOTHING: Any = object()
_LONGEST_S = 1e9


def advertise(graph: Graph) -> None:
    """Provide the service."""
    graph.node(NODE, NODE).advertise_service("wait", "slidectl/Wait", lambda request: wait(graph, request))


def wait(graph: Graph, request: Message) -> Pending:
    """Begin to wait.

    Raises:
        UnknownName: no such topic, field or condition. BadMessage: value, condition and field do not go together.
    """
    type_name = graph.topics.type_of(request["topic"])
    field = request["field"] or _only_field(type_name)
    selection = select(lambda owner: msgs.fields(owner) if "/" in owner else (), type_name, field)
    condition = Condition(request["condition"], request["value"], request["tolerance"])
    condition.check_type(f"{request['topic']}/{field}", selection.type + "[]" * selection.depth)
    hold_s, within_s = _duration("hold", request["hold"]), _duration("within", request["within"])
    return Wait(graph, request["topic"], field, selection, condition, hold_s, within_s).pending


def _only_field(type_name: str) -> str:
    """The name of the one field of a type. Raises UnknownName."""
    fields = [field.name for field in msgs.fields(type_name)]
    if len(fields) != 1:
        raise UnknownName("field", "", fields, f"in {type_name}: say which")
    return fields[0]


class Wait:
    """One who waits. `hold_s` 0: the first message that fulfils the condition is enough; `within_s` 0: no limit."""

    def __init__(
        self,
        graph: Graph,
        topic: str,
        field: str,
        selection: Selection,
        condition: Condition,
        hold_s: float,
        within_s: float,
    ) -> None:
        self.pending = Pending(on_cancel=self._close)
        self._graph = graph
        self._topic = topic
        self._path = f"{topic}/{field}"
        self._take_value = selection.take
        self._condition = condition
        self._hold_s = hold_s
        self._within_s = within_s
        self._last: Any = _NOTHING
        self._closest: Any = _NOTHING
        self._least = math.inf
        self._holding: Timer | None = None
        self._deadline = graph.timers.after(from_seconds(within_s), self._time_is_up) if within_s else None
        self._subscription: Subscription | None = None
        self._subscription = graph.topics.subscribe(topic, None, NODE, self._take)
        if self.pending.done:
            self._close()

    def _take(self, message: Message) -> None:
        if self.pending.done:
            return
        try:
            value = self._take_value(message)
        except NoElement as error:
            self._close()
            self.pending.reject(error)
            return
        if self._judge(value):
            self._begin_to_hold()
        elif self._holding is not None:
            self._holding.cancel()
            self._holding = None

    def _judge(self, value: Any) -> bool:
        distance = self._condition.distance(value)
        self._last = value
        if self._closest is _NOTHING or distance < self._least:
            self._closest, self._least = value, distance
        return distance <= 0

    def _begin_to_hold(self) -> None:
        if not self._hold_s:
            self._finish(True)
        elif self._holding is None:
            self._holding = self._graph.timers.after(from_seconds(self._hold_s), lambda: self._finish(True))

    def _time_is_up(self) -> None:
        """Holding that is complete at this very time still counts."""
        self._finish(self._holding is not None and self._holding.due_ns <= self._graph.clock.time_ns)

    def _finish(self, success: bool) -> None:
        self._close()
        self.pending.resolve(
            {
                "success": success,
                "message": f"{self._path} {self._outcome()}" if success else f"expected {self._failure()}",
                "last": _as_json(self._last),
                "closest": _as_json(self._closest),
                "time": self._graph.clock.seconds,
            }
        )

    def _outcome(self) -> str:
        return f"is {show(self._last)} ({self._condition}{self._for()})"

    def _failure(self) -> str:
        what = f"{self._path} {self._condition}{self._for()} within {self._within_s:g} s"
        alone = "" if self._graph.topics.publishers(self._topic) else "; nobody publishes it"
        if self._last is _NOTHING:
            return what + (alone or "; no message came")
        return f"{what}; last {show(self._last)}, closest {show(self._closest)}{alone}"

    def _for(self) -> str:
        return f" for {self._hold_s:g} s" if self._hold_s else ""

    def _close(self) -> None:
        for part in (self._holding, self._deadline):
            if part is not None:
                part.cancel()
        if self._subscription is not None:
            self._subscription.close()


def _as_json(value: Any) -> str:
    return "" if value is _NOTHING else json.dumps(value)


def _duration(name: str, value: float) -> float:
    """0 for none. Raises Refused for what no clock can measure."""
    if not -_LONGEST_S < value < _LONGEST_S:
        raise Refused(f"{name} is a number of seconds, not {value:g}")
    return max(value, 0.0)
