"""Stepping, pausing, speed, sleeping and status, with and without somebody who drives."""

from __future__ import annotations

import math
from typing import Any

import pytest
from sim_robots import cart, command, logged, running_cart, state

from slidectl import msgs
from slidectl.errors import Refused, SlidectlError
from slidectl.physics import Diverged, EngineError
from slidectl.simulation import Pending, Simulation
from slidectl.simulation.compiled import object_file

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")


@pytest.fixture
def simulation() -> Simulation:
    return Simulation(ground=False)


@pytest.fixture
def driven(simulation: Simulation) -> Simulation:
    """A world that stands, and that somebody drives."""
    simulation.driven = True
    simulation.pause()
    return simulation


def ask(simulation: Simulation, service: str, **request: Any) -> Pending:
    return simulation.graph.services.call(service, request)


def break_physics(simulation: Simulation, robot: str) -> None:
    """Make the robot's velocity no number."""
    simulation.world.data.qvel[simulation.world.robot(robot).dofs] = math.nan


def drive(simulation: Simulation, most: int) -> None:
    """What a driver does in one slice."""
    simulation.step(simulation.run.allowed(most))


def test_the_clock_is_published_in_every_cycle_that_somebody_hears(simulation: Simulation) -> None:
    heard: list[int] = []
    simulation.step(5)
    subscription = simulation.subscribe("/clock", lambda message: heard.append(message["clock"]["nsecs"]))
    simulation.step(3)
    subscription.close()
    simulation.step(2)
    assert heard == [6_000_000, 7_000_000, 8_000_000]
    simulation.parameters.set("/gazebo/pub_clock_frequency", 250)
    simulation.subscribe("/clock", lambda message: heard.append(message["clock"]["nsecs"]))
    simulation.step(10)
    assert heard[3:] == [12_000_000, 16_000_000, 20_000_000]


def test_step_runs_at_once_when_nobody_drives(simulation: Simulation) -> None:
    answer = simulation.call("/slidectl/step", {"cycles": 7})
    assert (answer["success"], answer["time"], answer["cycles"]) == (True, 0.007, 7)


@pytest.mark.parametrize(("seconds", "cycles"), [(0.5, 500), (0.001, 1), (0.3, 300), (1000.001, 1000001)])
def test_a_step_in_seconds_is_at_least_that_long(simulation: Simulation, seconds: float, cycles: int) -> None:
    assert simulation.call("/slidectl/step", {"seconds": seconds})["cycles"] == cycles


@pytest.mark.parametrize(("seconds", "possible"), [(0.0005, "possible: 0.001s"), (0.0015, "0.001s or 0.002s")])
def test_a_time_that_is_no_whole_number_of_cycles_is_refused(
    simulation: Simulation, seconds: float, possible: str
) -> None:
    before = simulation.cycles
    with pytest.raises(Refused, match="is not a whole number of cycles") as refusal:
        simulation.call("/slidectl/step", {"seconds": seconds})
    assert possible in str(refusal.value)
    assert simulation.cycles == before


def test_a_time_step_that_is_rounded_to_nanoseconds_divides_a_second() -> None:
    assert Simulation(timestep=1 / 240).call("/slidectl/step", {"seconds": 1.0})["cycles"] == 240


@pytest.mark.parametrize("seconds", [-1.0, math.nan, math.inf, 1e300])
def test_a_step_of_nonsense_is_refused(simulation: Simulation, seconds: float) -> None:
    with pytest.raises(SlidectlError):
        simulation.call("/slidectl/step", {"seconds": seconds})
    assert simulation.time_ns == 0


@pytest.mark.parametrize("cycles", [-1, 1.5, "3"])
def test_what_is_no_number_of_cycles_is_refused(simulation: Simulation, cycles: Any) -> None:
    with pytest.raises(Refused, match="the number of cycles must be a whole number of 0 or more"):
        simulation.step(cycles)


@pytest.mark.parametrize("timestep", [0.0, -1.0, 1e-7, 2.0, math.nan, "0.001", None])
def test_what_is_no_time_step_is_refused(simulation: Simulation, timestep: Any) -> None:
    for act in (simulation.set_timestep, Simulation):
        with pytest.raises(Refused, match="timestep is between 1e-06 s and 1 s, not"):
            act(timestep)


def test_a_driver_answers_a_step_in_its_own_cycle(driven: Simulation) -> None:
    first, second = ask(driven, "/slidectl/step", cycles=5), ask(driven, "/slidectl/step", cycles=10)
    assert driven.run.pending_steps == 15
    drive(driven, 8)
    assert first.result() == {"success": True, "message": "5 cycles done", "time": 0.005, "cycles": 5}
    assert not second.done
    drive(driven, 1000)
    assert second.result()["cycles"] == 15
    drive(driven, 1000)
    assert driven.cycles == 15


def test_a_step_pauses_a_running_world(driven: Simulation) -> None:
    driven.resume()
    step = ask(driven, "/slidectl/step", cycles=3)
    assert driven.run.paused
    drive(driven, 1000)
    assert step.done
    assert driven.cycles == 3
    driven.resume()
    assert ask(driven, "/slidectl/step").result()["success"], "no cycles: just hold"
    assert driven.run.paused


def test_pausing_gives_up_steps_and_says_so(driven: Simulation) -> None:
    step = ask(driven, "/slidectl/step", cycles=10)
    drive(driven, 4)
    driven.pause()
    assert step.result()["success"] is False
    assert step.result()["message"] == "paused after 4 of 10 cycles"
    assert driven.run.allowed(10) == 0


def test_resuming_does_not_forget_steps(driven: Simulation) -> None:
    step = ask(driven, "/slidectl/step", cycles=10)
    driven.resume()
    drive(driven, 100)
    assert step.result()["cycles"] == 10
    assert driven.cycles == 100


def test_who_goes_takes_its_steps_along(driven: Simulation) -> None:
    first, second = ask(driven, "/slidectl/step", cycles=10), ask(driven, "/slidectl/step", cycles=5)
    drive(driven, 2)
    first.cancel()
    drive(driven, 100)
    assert second.result()["cycles"] == 7


@pytest.mark.parametrize(("asked", "speed"), [(0.0, math.inf), (2.5, 2.5), (1e-3, 1e-3)])
def test_speed(driven: Simulation, asked: float, speed: float) -> None:
    assert ask(driven, "/slidectl/set_speed", speed=asked).result()["success"]
    assert driven.run.speed == speed
    assert driven.call("/slidectl/status")["speed"] == asked


@pytest.mark.parametrize("asked", [-1.0, math.nan, math.inf])
def test_a_speed_that_is_none_is_refused(driven: Simulation, asked: float) -> None:
    answer = ask(driven, "/slidectl/set_speed", speed=asked).result()
    assert not answer["success"]
    assert "as fast as possible" in answer["message"]
    assert driven.run.speed == 1.0


def test_sleep_is_answered_when_the_simulated_time_has_passed(driven: Simulation) -> None:
    sleep = ask(driven, "/slidectl/sleep", duration=0.0105)
    driven.step(10)
    assert not sleep.done
    driven.step(1)
    assert sleep.result() == {"success": True, "time": 0.011}
    assert ask(driven, "/slidectl/sleep").result()["time"] == 0.011


def test_a_call_steps_through_the_time_that_it_needs_when_nobody_drives(simulation: Simulation) -> None:
    assert simulation.call("/slidectl/sleep", {"duration": 0.25})["time"] == 0.25
    assert simulation.time_ns == 250_000_000


def test_a_call_that_needs_time_is_refused_when_somebody_else_drives(driven: Simulation) -> None:
    with pytest.raises(Refused, match="needs simulated time"):
        driven.call("/slidectl/sleep", {"duration": 1.0})


def test_status_tells_what_there_is() -> None:
    simulation = running_cart()
    simulation.step(1500)
    simulation.host.reports.append(lambda: {"pid": 42, "connections": 3})
    status = simulation.call("/slidectl/status")
    assert set(status) == {field.name for field in msgs.fields("slidectl/StatusResponse")}
    assert (status["time"], status["cycles"], status["timestep"]) == (1.5, 1500, 0.001)
    assert (status["robots"], status["controllers"], status["controllers_running"]) == (["cart"], 2, 2)
    assert (status["pid"], status["connections"], status["paused"]) == (42, 3, False)


def test_waiting_for_a_robot_on_its_way() -> None:
    simulation = running_cart()
    command(simulation, 1.0)
    request = {"topic": "/cart/joint_states", "field": "position[0]", "condition": "near", "value": "1.0"}
    answer = simulation.call("/slidectl/wait", {**request, "tolerance": 0.05, "hold": 0.5, "within": 15.0})
    assert answer["success"], answer["message"]
    assert answer["time"] == simulation.graph.clock.seconds
    late = simulation.call("/slidectl/wait", {**request, "value": "5.0", "tolerance": 0.05, "within": 0.1})
    assert late["message"].startswith("expected /cart/joint_states/position[0] near 5 ± 0.05 within 0.1 s; last ")


def test_a_wait_does_not_change_the_motion() -> None:
    simulations = [running_cart(), running_cart()]
    for simulation in simulations:
        command(simulation, 1.0)
    ask(simulations[0], "/slidectl/wait", topic="/cart/joint_states", field="position[0]", condition="above", value="9")
    for simulation in simulations:
        simulation.step(500)
    assert state(simulations[0]) == state(simulations[1])


def test_when_the_physics_diverges_the_world_is_held_and_the_robot_is_named(driven: Simulation) -> None:
    driven.spawn(cart(), "good")
    driven.spawn(cart(), "bad")
    driven.resume()
    lines = logged(driven)
    step = ask(driven, "/slidectl/step", cycles=1_000_000)
    break_physics(driven, "bad")
    drive(driven, 1_000_000)
    assert driven.cycles < 1000
    assert driven.run.paused
    assert not step.result()["success"]
    (fatal,) = [text for severity, text in lines if severity == "fatal"]
    assert "'bad'" in fatal
    assert "'bad' diverged" in driven.call("/slidectl/status")["trouble"]
    driven.delete("bad")
    driven.resume()
    assert driven.call("/slidectl/status")["trouble"] == ""
    assert driven.step(10) == 10


@pytest.mark.parametrize("cut", [1, 100, 1000])
def test_a_divergence_is_found_in_the_same_cycle_however_stepping_is_cut(driven: Simulation, cut: int) -> None:
    driven.spawn(cart(), "bad")
    driven.step(300)
    break_physics(driven, "bad")
    driven.resume()
    while not driven.run.paused:
        driven.step(cut)
    assert driven.cycles == 301


def test_a_timer_may_reset_the_time_in_the_middle_of_a_step(simulation: Simulation) -> None:
    simulation.graph.timers.at(5_000_000, simulation.reset_simulation)
    assert simulation.step(12) == 12
    assert simulation.cycles == 7


def test_a_reset_brings_a_diverged_world_back(driven: Simulation) -> None:
    driven.spawn(cart(), "bad")
    break_physics(driven, "bad")
    assert driven.step(1000) < 1000
    driven.reset_simulation()
    assert driven.step(100) == 100
    assert state(driven, "bad") == (0.0, 0.0, 0.0)


def test_who_steps_directly_is_told_of_a_divergence_by_an_error(simulation: Simulation) -> None:
    simulation.spawn(cart(), "bad")
    break_physics(simulation, "bad")
    with pytest.raises(Diverged, match="'bad'"):
        simulation.step(1000)


def test_a_step_that_mujoco_cannot_do_at_all_holds_the_world_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise EngineError("out of memory")

    driven = Simulation(engine="plain")  # machine code steps without the method that fails here
    driven.driven = True
    driven.resume()
    lines = logged(driven)
    monkeypatch.setattr(driven.world, "step", fail)
    driven.step(10)
    monkeypatch.undo()
    assert driven.run.paused
    assert ("fatal", "MuJoCo cannot go on: out of memory") in lines
    driven.resume()
    assert driven.step(10) == 10


def test_a_divergence_in_the_middle_of_a_step_is_told_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = running_cart(engine="plain")
    step = simulation.world.step

    def fails() -> None:
        if simulation.time_ns == 5_000_000:
            raise Diverged("cart")
        step()

    monkeypatch.setattr(simulation.world, "step", fails)
    with pytest.raises(Diverged, match="'cart' diverged"):
        simulation.step(10)
    assert simulation.cycles == 5
    assert simulation.run.paused


@pytest.mark.parametrize("engine", ["plain", "auto"])
def test_the_time_step_does_not_change_inside_a_cycle(engine: str) -> None:
    simulation = running_cart(engine=engine)
    refusals: list[str] = []

    def change(_: object) -> None:
        try:
            simulation.set_timestep(0.002)
        except Refused as refusal:
            refusals.append(refusal.message)

    simulation.subscribe("/cart/joint_states", change)
    simulation.step(100)
    assert set(refusals) == {"cannot change the time step in the middle of a control cycle"}
    assert (simulation.time_ns, simulation.world.data.time) == (100_000_000, pytest.approx(0.1))


@pytest.mark.parametrize("engine", ["plain", pytest.param("compiled", marks=needs_numba)])
def test_a_step_ends_after_few_cycles_when_the_driver_has_had_enough(engine: str) -> None:
    simulation = running_cart(engine=engine)
    simulation.driven = True
    asked = []

    def enough() -> bool:
        asked.append(simulation.loop.graph.clock.cycles)
        return len(asked) > 2

    simulation.loop.enough = enough
    done = simulation.step(1_000_000)
    assert len(asked) >= 3
    assert done < 200
    asked.clear()
    simulation.loop.enough = None
    assert simulation.step(500) == 500
    assert asked == []
