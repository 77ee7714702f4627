"""Timers on simulated time, and the clock as a topic."""

from __future__ import annotations

from typing import Any

import pytest

from slidectl.simulation.clock import NEVER, Clock, Timers
from slidectl.simulation.graph import Graph, GraphNode

MS = 1_000_000


class Stage:
    """A clock, timers on it, and a record of what fired when (ms)."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.timers = Timers(self.clock.now_ns)
        self.fired: list[tuple[str, int]] = []

    def note(self, name: str) -> Any:
        return lambda: self.fired.append((name, self.clock.time_ns // MS))

    def run_until(self, end_ms: int) -> None:
        while self.clock.time_ns < end_ms * MS:
            self.clock.time_ns += MS
            if self.clock.time_ns >= self.timers.next_ns:
                self.timers.fire()


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_timers_fire_in_the_order_of_time_and_then_of_making(stage: Stage) -> None:
    stage.timers.at(3 * MS, stage.note("late"))
    stage.timers.at(2 * MS, stage.note("first"))
    stage.timers.after(2 * MS, stage.note("second"))
    stage.run_until(10)
    assert stage.fired == [("first", 2), ("second", 2), ("late", 3)]
    assert stage.timers.next_ns == NEVER


def test_a_time_between_two_cycles_fires_at_the_next(stage: Stage) -> None:
    stage.timers.at(2 * MS + 1, stage.note("x"))
    stage.run_until(10)
    assert stage.fired == [("x", 3)]


def test_a_period_is_counted_from_zero_whenever_it_was_asked_for(stage: Stage) -> None:
    stage.run_until(7)
    stage.timers.every(5 * MS, stage.note("tick"))
    stage.run_until(21)
    assert stage.fired == [("tick", 10), ("tick", 15), ("tick", 20)]


def test_a_cancelled_timer_does_not_fire_and_is_not_waited_for(stage: Stage) -> None:
    timer = stage.timers.at(2 * MS, stage.note("x"))
    timer.cancel()
    tick = stage.timers.every(MS, stage.note("tick"))
    stage.run_until(2)
    tick.cancel()
    stage.run_until(5)
    assert stage.fired == [("tick", 1), ("tick", 2)]
    assert stage.timers.next_ns == NEVER


def test_cancelled_timers_do_not_pile_up_while_time_stands_still(stage: Stage) -> None:
    kept = [stage.timers.after((k + 1) * MS, stage.note(str(k))) for k in range(100)]
    for _ in range(10_000):
        stage.timers.after(MS, stage.note("never")).cancel()
    assert len(stage.timers._heap) < 1000
    stage.run_until(100)
    assert [name for name, _ in stage.fired] == [str(k) for k in range(len(kept))]


def test_what_a_timer_makes_due_fires_too(stage: Stage) -> None:
    stage.timers.at(2 * MS, lambda: stage.timers.soon(stage.note("chained")))
    stage.run_until(3)
    assert stage.fired == [("chained", 2)]


def test_when_the_clock_is_set_back_durations_keep_what_is_left_of_them(stage: Stage) -> None:
    stage.run_until(100)
    stage.timers.after(20 * MS, stage.note("sleep"))
    stage.timers.every(30 * MS, stage.note("tick"))
    stage.run_until(110)
    stage.clock.time_ns = 0
    stage.timers.rebase(110 * MS, 0)
    stage.run_until(31)
    assert stage.fired == [("sleep", 10), ("tick", 30)]


def test_a_stamp_has_seconds_and_nanoseconds() -> None:
    clock = Clock()
    clock.time_ns = 1_500_000_001
    assert clock.stamp() == {"secs": 1, "nsecs": 500_000_001}


def test_the_clock_topic_is_published_at_every_cycle_or_at_its_frequency(graph: Graph) -> None:
    heard: list[int] = []
    graph.topics.subscribe("/clock", None, "/me", lambda message: heard.append(message["clock"]["nsecs"] // MS))
    for k in range(1, 4):
        graph.clock_topic.tick(k * MS, MS)
    assert heard == [1, 2, 3]
    heard.clear()
    graph.parameters.set("/gazebo/pub_clock_frequency", 100)
    for k in range(1, 31):
        graph.clock_topic.tick(k * MS, MS)
    assert heard == [10, 20, 30]
    heard.clear()
    graph.parameters.set("/gazebo/pub_clock_frequency", 5e-324)
    graph.clock_topic.tick(30 * MS, MS)
    assert not heard
    graph.parameters.delete("/gazebo/pub_clock_frequency")
    graph.clock_topic.tick(31 * MS, MS)
    assert heard == [31]


def test_the_log_goes_to_rosout_and_to_who_keeps_it(graph: Graph) -> None:
    kept: list[Any] = []
    heard: list[Any] = []
    graph.log.sink = lambda *line: kept.append(line)
    graph.clock.time_ns = 2 * MS
    graph.log("warn", "/gazebo", "nobody hears this on the topic")
    graph.topics.subscribe("/rosout", "rosgraph_msgs/Log", "/me", heard.append)
    graph.log("error", "/gazebo", "broken")
    assert [line[2] for line in kept] == ["nobody hears this on the topic", "broken"]
    assert [(m["level"], m["name"], m["msg"], m["header"]["stamp"]["nsecs"]) for m in heard] == [
        (8, "/gazebo", "broken", 2 * MS)
    ]


class TestRepeatedCalls:
    """Calls each period, counted from the moment that they were asked for."""

    @pytest.fixture
    def node(self, graph: Graph) -> GraphNode:
        graph.clock.time_ns = 1_003
        return graph.node("/arm")

    def pass_time(self, graph: Graph, to_ns: int, step_ns: int = 1) -> None:
        while graph.clock.time_ns < to_ns:
            graph.clock.time_ns += step_ns
            graph.timers.fire()

    def test_they_count_from_now(self, graph: Graph, node: GraphNode) -> None:
        times: list[int] = []
        node.call_every(50, lambda: times.append(graph.clock.time_ns))
        self.pass_time(graph, 1_200)
        assert times == [1_053, 1_103, 1_153]

    def test_missed_periods_are_left_out(self, graph: Graph, node: GraphNode) -> None:
        times: list[int] = []
        node.call_every(50, lambda: times.append(graph.clock.time_ns))
        self.pass_time(graph, 1_500, step_ns=120)
        assert times == [1_123, 1_243, 1_363, 1_483, 1_603]

    def test_they_go_on_after_the_clock_was_set(self, graph: Graph, node: GraphNode) -> None:
        times: list[int] = []
        node.call_every(50, lambda: times.append(graph.clock.time_ns))
        self.pass_time(graph, 1_060)
        graph.clock.time_ns = 0
        graph.timers.rebase(1_060, 0)
        self.pass_time(graph, 100)
        assert times == [1_053, 43, 93]

    def test_they_end_when_cancelled_and_with_their_node(self, graph: Graph, node: GraphNode) -> None:
        times: list[int] = []
        node.call_every(50, lambda: times.append(1)).cancel()
        node.child("below").call_every(50, lambda: times.append(2))
        node.shutdown()
        self.pass_time(graph, 1_200)
        assert times == []
        assert graph.timers.next_ns == NEVER

    def test_one_without_a_period_is_refused(self, node: GraphNode) -> None:
        with pytest.raises(ValueError, match="above 0 ns"):
            node.call_every(0, lambda: None)
