"""A topic that is published at a steady rate of simulated time, and costs nothing while nobody listens.

The phase is that of multiples of the period, whoever listened before.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from slidectl.control.node_handle import Message
from slidectl.simulation.graph import Graph
from slidectl.simulation.timers import Timer
from slidectl.simulation.topics import NodePublisher


class _DemandPublisher(NodePublisher):
    """Tells when it begins and when it ceases to be wanted."""

    __slots__ = ("_is_wanted", "_newcomer", "_on_demand")

    def __init__(
        self, on_demand: Callable[[bool], None], newcomer: Callable[[], Message | None], *arguments: Any
    ) -> None:
        self._on_demand = on_demand
        self._newcomer = newcomer
        self._is_wanted = False
        super().__init__(*arguments)

    @property
    def wanted(self) -> bool:
        return self._is_wanted

    @wanted.setter
    def wanted(self, value: bool) -> None:
        if value != self._is_wanted:
            self._is_wanted = value
            self._on_demand(value)

    def for_newcomer(self) -> Message | None:
        return self._newcomer()


class PeriodicTopic:
    """Publishes what `build` gives, every `period_ns`, until `close`.

    While `is_still` says that no cycle will come by itself, a new subscriber gets the present message at once, and
    those that are there when the publisher comes get it too.
    """

    def __init__(
        self,
        graph: Graph,
        topic: str,
        type_name: str,
        node: str,
        period_ns: int,
        build: Callable[[], Message],
        is_still: Callable[[], bool] = lambda: False,
    ) -> None:
        self._graph = graph
        self._period_ns = period_ns
        self._build = build
        self._timer: Timer | None = None
        kind = partial(_DemandPublisher, self._demand, lambda: build() if is_still() else None)
        self._publisher = graph.topics.advertise(topic, type_name, node, kind=kind)
        if self._publisher.wanted and is_still():
            self._publish()

    def close(self) -> None:
        """Stop publishing."""
        self._demand(False)
        self._publisher.close()

    def _demand(self, wanted: bool) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._graph.timers.every(self._period_ns, self._publish) if wanted else None

    def _publish(self) -> None:
        self._publisher.publish(self._build())
