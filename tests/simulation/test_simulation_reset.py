"""Resets: all back at once, controllers running on, as often as one likes."""

from __future__ import annotations

from typing import Any

import pytest
from sim_robots import cart, command, drive_up, put_probe, running_cart, state, states_of, switch

from slidectl.simulation import Simulation


def run(simulation: Simulation, cycles: int = 700) -> list[Any]:
    """Where the cart goes after a command, and every message of its topics on the way."""
    heard: list[Any] = []
    subscriptions = [
        simulation.subscribe(topic, lambda message, topic=topic: heard.append((topic, stampless(message))))
        for topic in ("/cart/joint_states", "/clock")
    ]
    command(simulation, 1.0)
    simulation.step(cycles)
    for subscription in subscriptions:
        subscription.close()
    return [state(simulation), *heard]


def stampless(message: dict[str, Any]) -> dict[str, Any]:
    """The message without the number that its publisher counts on."""
    if "header" not in message:
        return message
    return {**message, "header": {**message["header"], "seq": 0}}


def test_after_a_reset_of_the_simulation_all_happens_again_to_the_bit() -> None:
    simulation = running_cart()
    first = run(simulation)
    for _ in range(3):
        simulation.reset_simulation()
        assert (simulation.time_ns, simulation.cycles) == (0, 0)
        assert state(simulation) == (0.0, 0.0, 0.0)
        assert run(simulation) == first


def test_controllers_stay_loaded_and_running_and_hold_the_joint_where_it_begins() -> None:
    simulation = running_cart()
    run(simulation)
    simulation.reset_simulation()
    simulation.step(500)
    assert states_of(simulation) == {"states": "running", "position1": "running"}
    assert state(simulation)[0] == pytest.approx(0.0, abs=1e-9)


def test_a_reset_of_the_world_leaves_the_time_alone() -> None:
    simulation = running_cart()
    run(simulation)
    for times in range(1, 4):
        before = simulation.time_ns
        simulation.reset_world()
        assert simulation.time_ns == before
        assert state(simulation) == (0.0, 0.0, 0.0)
        command(simulation, 1.0)
        simulation.step(700)
        assert state(simulation)[0] > 0.3, f"reset number {times}"


def test_joint_states_go_on_at_once_after_both_resets() -> None:
    simulation = running_cart()
    simulation.step(3000)
    stamps: list[int] = []
    simulation.subscribe("/cart/joint_states", lambda message: stamps.append(message["header"]["stamp"]["nsecs"]))
    simulation.reset_simulation()
    simulation.step(100)
    assert [stamp // 1_000_000 for stamp in stamps] == [21, 41, 61, 81]
    stamps.clear()
    simulation.reset_world()
    simulation.step(100)
    assert len(stamps) == 5


def test_running_controllers_are_stopped_and_started_and_see_one_step_as_period() -> None:
    simulation = Simulation(ground=False)
    robot = simulation.spawn(cart(), "cart")
    probe = put_probe(simulation, robot)
    assert switch(simulation, start=["probe"])
    simulation.step(1000)
    for reset in (simulation.reset_simulation, simulation.reset_world):
        probe.calls.clear()
        probe.periods.clear()
        reset()
        now = simulation.time_ns
        simulation.step(2)
        assert probe.calls == [
            ("stopping", now),
            ("starting", now),
            ("update", now + 1_000_000),
            ("update", now + 2_000_000),
        ]
        assert probe.periods == [0.001, 0.001]


def test_the_integral_of_a_pid_is_forgotten() -> None:
    simulation = running_cart()
    errors: list[float] = []
    simulation.world.add_joint_force("cart", "joint1", 50.0)
    command(simulation, 1.0)
    simulation.step(3000)
    simulation.reset_world()
    simulation.subscribe("/cart/position1/state", lambda message: errors.append(message["command"]))
    simulation.step(100)
    assert max(map(abs, errors)) < 1e-6, "neither an old integral nor the force from outside is left"


def test_the_clock_tells_its_new_time_at_once() -> None:
    simulation = running_cart()
    simulation.step(1500)
    heard: list[Any] = []
    simulation.subscribe("/clock", lambda message: heard.append(message["clock"]))
    simulation.reset_simulation()
    assert heard == [{"secs": 0, "nsecs": 0}]


def test_sleeps_and_waits_keep_what_is_left_of_them() -> None:
    simulation = running_cart()
    simulation.step(1000)
    sleep = simulation.graph.services.call("/slidectl/sleep", {"duration": 0.5})
    simulation.step(400)
    simulation.reset_simulation()
    simulation.step(99)
    assert not sleep.done
    simulation.step(1)
    assert sleep.result()["time"] == 0.1


def test_periodic_topics_keep_their_phase() -> None:
    simulation = running_cart()
    stamps: list[int] = []
    simulation.subscribe("/tf", lambda _: stamps.append(simulation.time_ns // 1_000_000))
    simulation.step(50)
    simulation.reset_simulation()
    simulation.step(50)
    assert stamps == [20, 40, 20, 40]


def test_an_armed_switch_is_finished_by_a_reset() -> None:
    simulation = running_cart()
    simulation.driven = True
    request = {"stop_controllers": ["position1"], "strictness": 2}
    answer = simulation.graph.services.call("/cart/controller_manager/switch_controller", request)
    simulation.reset_simulation()
    assert answer.result()["ok"]
    assert states_of(simulation)["position1"] == "stopped"


def test_what_a_stopped_controller_left_in_the_hardware_is_gone() -> None:
    simulation = running_cart()
    command(simulation, 1.0)
    simulation.step(10)
    assert switch(simulation, stop=["position1"])
    simulation.step(10)
    assert state(simulation)[2] != 0.0, "the last command stays, as in ros_control"
    simulation.reset_world()
    simulation.step(10)
    assert state(simulation) == (0.0, 0.0, 0.0)


def test_every_robot_goes_back_to_where_it_was_spawned() -> None:
    simulation = Simulation(ground=False)
    there = ((1.0, 2.0, 0.5), (0.0, 0.0, 0.0, 1.0))
    for name, pose in (("a", ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))), ("b", there)):
        simulation.spawn(cart(), name, pose=pose)
        drive_up(simulation, f"/{name}")
        command(simulation, 1.0, f"/{name}/position1/command")
    simulation.world.set_pose("b", ((9.0, 9.0, 9.0), (0.0, 0.0, 0.0, 1.0)))
    simulation.step(500)
    simulation.reset_world()
    assert state(simulation, "a") == state(simulation, "b") == (0.0, 0.0, 0.0)
    assert tuple(simulation.world.link_pose("b", "world")[0]) == there[0]
