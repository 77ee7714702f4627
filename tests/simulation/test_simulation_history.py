"""`/slidectl/trace`: the past of a joint as far as it is kept, and its motion at every cycle to come."""

from __future__ import annotations

from binascii import a2b_base64
from typing import Any

import numpy as np
import pytest
from sim_robots import cart, command, running_cart, state

from slidectl.errors import Refused, SlidectlError, UnknownName
from slidectl.simulation import Simulation, history
from slidectl.simulation.compiled import object_file

ENGINES = ["plain", *(["compiled"] if object_file.is_possible() else [])]


def rows_of(answer: dict[str, Any]) -> Any:
    """Time, position, velocity, effort, (n, 4)."""
    return np.frombuffer(a2b_base64(answer["samples"]), dtype="<f8").reshape(-1, 4)


def trace(simulation: Simulation, **request: Any) -> Any:
    return rows_of(simulation.call("/slidectl/trace", {"robot": "cart", "joint": "joint1", **request}))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_trace_to_come_has_every_cycle_and_the_past_every_tenth_of_them(engine: str) -> None:
    simulation = running_cart(engine=engine)
    start = simulation.time_ns / 1e9
    command(simulation, 1.0)
    come = trace(simulation, duration=0.5)
    assert come[:, 0] == pytest.approx(start + 0.001 * np.arange(501), abs=1e-12)
    assert tuple(come[-1, 1:]) == state(simulation)
    past = trace(simulation, last=0.4)
    cycles = np.round(past[:, 0] * 1000).astype(int)
    assert set(np.diff(cycles[:-1])) == {10}
    assert cycles[0] % 10 == 0
    assert (cycles[0], cycles[-1]) == (pytest.approx(cycles[-1] - 400, abs=9), round(come[-1, 0] * 1000))
    assert {row.tobytes() for row in past} <= {row.tobytes() for row in come}
    assert np.ptp(come[:, 3]) > 10, "efforts are those of the controller"


@pytest.mark.parametrize("engine", ENGINES)
def test_the_past_begins_anew_with_the_clock_and_when_a_robot_comes(engine: str) -> None:
    simulation = running_cart(engine=engine)
    simulation.step(500)
    simulation.reset_simulation()
    simulation.step(100)
    assert trace(simulation, last=10)[:, 0] == pytest.approx(0.01 * np.arange(1, 11))
    simulation.spawn(cart().replace('name="cart"', 'name="other"'), "other")
    simulation.step(25)
    assert trace(simulation, last=10)[:, 0] == pytest.approx([0.11, 0.12, 0.125])


@pytest.mark.parametrize("engine", ENGINES)
def test_after_a_jump_the_joint_is_where_it_is_and_has_no_past(engine: str) -> None:
    simulation = running_cart(engine=engine)

    def put_joint() -> None:
        request = {"model_name": "cart", "joint_names": ["joint1"], "joint_positions": [0.25]}
        assert simulation.call("/gazebo/set_model_configuration", request)["success"]

    simulation.save("start")
    for jump in (simulation.reset_world, put_joint, lambda: simulation.load("start"), simulation.reset_simulation):
        command(simulation, 1.0)
        simulation.step(100)  # to a cycle that is kept
        jump()
        now_s = simulation.time_ns / 1e9
        assert trace(simulation, last=10).tolist() == [[now_s, *state(simulation)]]
        simulation.step(5)
        assert trace(simulation, last=10)[:, 0].tolist() == [simulation.time_ns / 1e9]
        simulation.step(5)


def test_a_joint_that_a_script_puts_elsewhere_is_there() -> None:
    simulation = running_cart()
    simulation.step(100)
    simulation.world.set_joint("cart", "joint1", 0.5, 0.0)
    assert trace(simulation, last=10)[-1, 1] == 0.5


@pytest.mark.parametrize("engine", ENGINES)
def test_only_the_newest_rows_are_kept(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history, "_MOST_ROWS", 7)
    simulation = running_cart(engine=engine)
    simulation.step(1000)
    now = simulation.time_ns // 10**7 * 0.01
    assert trace(simulation, last=10)[:7, 0] == pytest.approx(now - 0.01 * np.arange(6, -1, -1))


def test_a_long_trace_leaves_cycles_out_and_has_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    from slidectl.features import joint_traces

    monkeypatch.setattr(joint_traces, "_MOST_SAMPLES", 10)
    simulation = running_cart()
    start_ns = simulation.time_ns
    times = trace(simulation, duration=0.095)[:, 0]
    assert len(times) <= 12
    assert (times[0], times[-1]) == (start_ns / 1e9, (start_ns + 95_000_000) / 1e9)


@pytest.mark.parametrize("duration", [1.0, 0.011])
def test_a_robot_that_goes_ends_the_trace_to_come(duration: float) -> None:
    simulation = running_cart()
    pending = simulation.graph.services.call(
        "/slidectl/trace", {"robot": "cart", "joint": "joint1", "last": 0.0, "duration": duration}
    )
    simulation.step(10)
    simulation.delete("cart")
    simulation.step(10)
    with pytest.raises(SlidectlError, match="no model 'cart'"):
        pending.result()


@pytest.mark.parametrize(
    ("request_", "cause"),
    [
        ({"last": 1.0, "duration": 1.0}, Refused),
        ({}, Refused),
        ({"last": -1.0}, Refused),
        ({"duration": 1e300}, Refused),
        ({"last": 1.0, "joint": "elbow"}, UnknownName),
        ({"last": 1.0, "robot": "crate"}, UnknownName),
    ],
)
def test_what_no_trace_can_be_of_is_refused(request_: dict[str, Any], cause: type[SlidectlError]) -> None:
    with pytest.raises(cause):
        trace(running_cart(), **request_)
