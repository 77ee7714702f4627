"""The same commands at the same simulated times give the same bits, whoever listens and however time is cut."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

import pytest
from sim_robots import cart, command, drive_up, running_cart, state

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")

CYCLES = 1000
TARGETS = {0: 1.0, 300: -0.5, 701: 0.25}
Track = list[tuple[float, float, float]]


def advance(simulation: Simulation, cuts: Callable[[], int], track: Track | None = None) -> None:
    """Run CYCLES cycles in pieces, with a command before each cycle of TARGETS."""
    done = 0
    while done < CYCLES:
        if done in TARGETS:
            command(simulation, TARGETS[done])
            command(simulation, -TARGETS[done], "/cart/position2/command")
        piece = min([cuts(), *(at - done for at in (*TARGETS, CYCLES) if at > done)])
        done += simulation.step(piece)
        if track is not None:
            track.append(state(simulation))


def outcome(simulation: Simulation, cuts: Callable[[], int] = lambda: CYCLES) -> bytes:
    """All of the physics' state after the run, to the bit."""
    advance(simulation, cuts)
    data = simulation.world.data
    return b"".join(array.tobytes() for array in (data.qpos, data.qvel, data.qfrc_applied, data.qacc_warmstart))


@pytest.fixture(scope="module")
def reference() -> bytes:
    return outcome(running_cart(joints=2))


def test_two_runs_are_the_same_to_the_bit(reference: bytes) -> None:
    assert outcome(running_cart(joints=2)) == reference


@pytest.mark.parametrize("cuts", [(1,), (10,), (7, 1, 113), (256,), (255, 257), (999,)], ids=str)
def test_how_stepping_is_cut_changes_nothing(reference: bytes, cuts: tuple[int, ...]) -> None:
    pieces = cycle(cuts)
    assert outcome(running_cart(joints=2), lambda: next(pieces)) == reference


def test_who_listens_changes_nothing(reference: bytes) -> None:
    simulation = running_cart(joints=2)
    for topic in simulation.graph.topics.names():
        simulation.subscribe(topic, lambda _: None)
    assert outcome(simulation) == reference


def test_who_asks_changes_nothing(reference: bytes) -> None:
    simulation = running_cart(joints=2)

    def ask() -> int:
        for service in ("/slidectl/status", "/slidectl/list_robots", "/cart/controller_manager/list_controllers"):
            simulation.call(service)
        return 50

    assert outcome(simulation, ask) == reference


def test_a_driver_changes_nothing(reference: bytes) -> None:
    simulation = running_cart(joints=2)
    simulation.driven = True
    assert outcome(simulation, lambda: 33) == reference


def test_robots_that_come_and_go_elsewhere_change_nothing() -> None:
    quiet, busy = running_cart(joints=2), running_cart(joints=2)
    expected: Track = []
    seen: Track = []
    advance(quiet, lambda: 50, expected)
    numbers = iter(range(1000))

    def come_and_go() -> int:
        number = next(numbers)
        name = f"late{number % 3}"
        if name in busy.robots:
            busy.delete(name)
        else:
            busy.spawn(cart(), name, pose=((0.0, 10.0 * (1 + number % 3), 0.0), (0.0, 0.0, 0.0, 1.0)))
            drive_up(busy, f"/{name}")
            command(busy, 0.3, f"/{name}/position1/command")
        return 50

    advance(busy, come_and_go, seen)
    assert seen == expected


def test_messages_carry_the_same_numbers_in_every_run() -> None:
    def record() -> list[object]:
        simulation = running_cart(joints=2)
        heard: list[object] = []
        for topic in ("/cart/joint_states", "/cart/position1/state", "/tf", "/gazebo/model_states"):
            simulation.subscribe(topic, lambda message, topic=topic: heard.append((topic, simulation.time_ns, message)))
        outcome(simulation, lambda: 17)
        return heard

    first, second = record(), record()
    assert len(first) > 1000
    assert first == second


@pytest.mark.parametrize("engine", ["plain", pytest.param("compiled", marks=needs_numba)])
def test_the_numbers_of_headers_are_those_that_an_earlier_listener_would_have_heard(engine: str) -> None:
    topics = ("/cart/joint_states", "/cart/position1/state", "/rosout")

    def numbers(listens_at: int) -> list[tuple[str, int, int]]:
        heard: list[tuple[str, int, int]] = []

        def listen(topic: str) -> None:
            simulation.subscribe(topic, lambda m: heard.append((topic, simulation.time_ns, m["header"]["seq"])))

        simulation = running_cart(joints=2, engine=engine)
        for burst in range(5):
            if burst == listens_at:
                for topic in topics:
                    listen(topic)
            simulation.step(200)
            simulation.graph.log("info", "/me", "hello")
        return heard

    first = numbers(0)
    assert first[0][2] >= 0
    late = numbers(3)
    assert {topic for topic, _, _ in late} == set(topics)
    assert late == first[-len(late) :]
