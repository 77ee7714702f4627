"""The pacer on a clock of ours: when cycles run, what is caught up, and what the figures say."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import Any

import pytest

from slidectl.daemon.pacing import CATCH_UP_SLICE_S, FREE_SLICE_S, MOST_BEHIND_S, Pacer
from slidectl.event_loop import READ, EventLoop
from slidectl.simulation.loop import RunState


class FakeSimulation:
    """Cycles that take `cost_s` of the fake clock's time each."""

    def __init__(self, cost_s: float = 10e-6) -> None:
        self.run = RunState()
        self.step_ns = 1_000_000
        self.now_s = 1000.0
        self.cost_s = cost_s
        self.cycles = 0
        self.breaks_at = math.inf
        self.enough: Callable[[], bool] | None = None

    def clock(self) -> float:
        return self.now_s

    def step(self, cycles: int = 1) -> int:
        done = int(min(cycles, self.breaks_at - self.cycles))
        self.cycles += done
        self.now_s += done * self.cost_s
        self.run.count(done)
        return done


def drive(simulation: FakeSimulation, pacer: Pacer, seconds: float, oversleep_s: float = 0.0) -> None:
    """Turn as the loop does, sleeping as long as asked (and a little longer)."""
    end = simulation.now_s + seconds
    while simulation.now_s < end:
        wait = pacer.turn()
        if wait is None:
            return
        simulation.now_s += wait + (oversleep_s if wait else 1e-6)


@pytest.fixture
def simulation() -> FakeSimulation:
    return FakeSimulation()


@pytest.fixture
def pacer(simulation: FakeSimulation) -> Pacer:
    return Pacer(simulation, simulation.clock)


@pytest.mark.parametrize("speed", [0.1, 1.0, 2.0, 50.0])
def test_the_world_runs_at_the_factor_that_was_asked(simulation: FakeSimulation, pacer: Pacer, speed: float) -> None:
    simulation.run.speed = speed
    drive(simulation, pacer, 2.0)
    assert simulation.cycles == pytest.approx(2000 * speed, abs=2 * max(1.0, speed))
    assert pacer.report()["speed_reached"] == pytest.approx(speed, rel=0.01)
    assert pacer.overruns == 0


class OneCycleAtATime:
    """Lock-step with a client that is done as soon as its period of one cycle has ended."""

    def allowed(self, most: int) -> int:
        return min(most, 1)

    def awaited(self) -> list[Any]:
        return []

    def let_go(self, member: Any) -> None:
        raise AssertionError(f"nobody is awaited, and {member} was let go")


@pytest.mark.parametrize("speed", [2.0, 10.0])
def test_lock_step_keeps_the_factor_too(simulation: FakeSimulation, pacer: Pacer, speed: float) -> None:
    simulation.run.speed = speed
    simulation.run.gates.append(OneCycleAtATime())
    drive(simulation, pacer, 2.0)
    figures = pacer.report()
    assert simulation.cycles == pytest.approx(2000 * speed, rel=0.01)
    assert figures["speed_reached"] == pytest.approx(speed, rel=0.01)
    assert figures["cycle_mean"] == pytest.approx(simulation.cost_s)
    assert figures["overruns"] == 0


def test_a_short_interruption_is_caught_up_in_slices(simulation: FakeSimulation, pacer: Pacer) -> None:
    simulation.cost_s = 100e-6
    drive(simulation, pacer, 1.0)
    simulation.now_s += 0.05
    begun = simulation.now_s
    assert pacer.turn() == 0.0
    assert simulation.now_s - begun <= CATCH_UP_SLICE_S + 2 * simulation.cost_s
    drive(simulation, pacer, 0.1)
    assert simulation.cycles == pytest.approx(1152, abs=4)
    assert pacer.overruns > 30
    assert pacer.given_up_s == 0


def test_a_long_interruption_is_not_caught_up(simulation: FakeSimulation, pacer: Pacer) -> None:
    drive(simulation, pacer, 1.0)
    simulation.now_s += 3600
    drive(simulation, pacer, 1.0)
    assert simulation.cycles == pytest.approx(2000 + 1000 * MOST_BEHIND_S, abs=5)
    assert pacer.given_up_s == pytest.approx(3600 - MOST_BEHIND_S, abs=0.01)


def test_a_machine_that_is_too_slow_says_what_it_reaches(simulation: FakeSimulation, pacer: Pacer) -> None:
    simulation.cost_s = 0.004
    drive(simulation, pacer, 10.0)
    figures = pacer.report()
    assert figures["speed_reached"] == pytest.approx(0.25, rel=0.05)
    assert figures["overruns"] > 2000
    assert figures["lateness_p99"] <= MOST_BEHIND_S + 0.004


def test_free_running_returns_to_the_sockets_after_a_slice(simulation: FakeSimulation, pacer: Pacer) -> None:
    simulation.run.speed = math.inf
    for _ in range(20):
        begun = simulation.now_s
        assert pacer.turn() == 0.0
        assert simulation.now_s - begun <= 1.3 * FREE_SLICE_S
    assert simulation.cycles > 1000


def test_free_running_cycles_are_limited_by_the_clock_and_paced_ones_by_their_number(
    simulation: FakeSimulation,
) -> None:
    pacer = Pacer(simulation, simulation.clock)
    pacer.turn()
    assert simulation.enough is None
    simulation.run.speed = math.inf
    began = simulation.now_s
    pacer.turn()
    assert simulation.enough is not None
    simulation.now_s = began + 0.9 * FREE_SLICE_S
    assert not simulation.enough()
    simulation.now_s = began + 1.1 * FREE_SLICE_S
    assert simulation.enough()
    simulation.run.speed = 1.0
    pacer.turn()
    assert simulation.enough is None


def test_a_paused_world_has_nothing_to_do(simulation: FakeSimulation, pacer: Pacer) -> None:
    simulation.run.paused = True
    assert pacer.turn() is None
    assert simulation.cycles == 0
    assert pacer.report()["speed_reached"] == 0


def test_steps_run_as_fast_as_possible_and_exactly_as_many(simulation: FakeSimulation, pacer: Pacer) -> None:
    pending = simulation.run.request_steps(12_345)
    turns = 0
    while pacer.turn() is not None:
        turns += 1
    assert (simulation.cycles, pending.done, simulation.run.paused) == (12_345, True, True)
    assert turns > 100  # the sockets had their turn all the while
    assert simulation.now_s - 1000 == pytest.approx(12_345 * 10e-6)


def test_time_that_passed_while_paused_is_not_caught_up(simulation: FakeSimulation, pacer: Pacer) -> None:
    drive(simulation, pacer, 1.0)
    simulation.run.paused = True
    pacer.turn()
    simulation.now_s += 0.09
    simulation.run.paused = False
    drive(simulation, pacer, 1.0)
    assert simulation.cycles == pytest.approx(2000, abs=3)


def test_another_speed_takes_effect_from_now_on(simulation: FakeSimulation, pacer: Pacer) -> None:
    drive(simulation, pacer, 1.0)
    simulation.run.set_speed(0.5)
    drive(simulation, pacer, 1.0)
    assert simulation.cycles == pytest.approx(1500, abs=3)
    assert pacer.report()["speed_reached"] == pytest.approx(0.5, rel=0.02)


def test_short_cycles_are_grouped_so_that_the_loop_sleeps(simulation: FakeSimulation, pacer: Pacer) -> None:
    simulation.step_ns = 100_000
    pacer.turn()
    assert simulation.cycles == 10
    wait = pacer.turn()
    assert wait is not None
    assert wait > 0.0005


def test_cycles_that_run_as_fast_as_possible_make_way_for_who_knocks(simulation: FakeSimulation) -> None:
    calls = iter([False, False, True, False])
    pacer = Pacer(simulation, simulation.clock, clients_wait=lambda: next(calls, False))
    simulation.run.speed = math.inf
    begun = simulation.now_s
    assert pacer.turn() == 0.0
    assert 0 < simulation.now_s - begun < FREE_SLICE_S
    begun = simulation.now_s
    pacer.turn()
    assert simulation.now_s - begun >= FREE_SLICE_S


@pytest.mark.parametrize("speed", [1e9, 1e308])
def test_a_speed_that_nothing_reaches_is_as_fast_as_possible(
    simulation: FakeSimulation, pacer: Pacer, speed: float
) -> None:
    simulation.run.speed = speed
    began = simulation.now_s
    assert pacer.turn() == 0.0
    assert simulation.now_s - began < 0.002


@pytest.mark.parametrize("speed", [1e-300, 5e-324])
def test_a_speed_of_almost_nothing_is_waited_for(simulation: FakeSimulation, pacer: Pacer, speed: float) -> None:
    simulation.run.speed = speed
    pacer.turn()
    wait_s = pacer.turn()
    assert wait_s is not None
    assert wait_s > 1e6
    loop = EventLoop()
    knocking, door = os.pipe()
    calls: list[bytes] = []
    loop.watch(knocking, READ, lambda _: calls.append(os.read(knocking, 1)))
    os.write(door, b"x")
    loop.poll(wait_s)
    assert calls == [b"x"]
    loop.close()
    os.close(knocking)
    os.close(door)
