"""A world with clients in one process: what a client can do with a daemon it can do here, always with the same bits."""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import Any

import pytest

from slidectl import Simulation
from slidectl.client import Client
from slidectl.daemon.in_process import InProcessLink, InProcessWorld
from slidectl.errors import NoDaemon, Refused, TimedOut
from slidectl.extensions.scenarios.background import BackgroundStep, InProcessBackground

CONTROLLERS = "config/slider_control.yaml"


def slide(engine: str) -> list[Any]:
    """Up and down, with a second client that listens; what was seen, and when."""
    simulation = Simulation(engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    world = InProcessWorld(simulation)
    with world.client() as client, world.client() as listener:
        client.spawn("slider", controllers=CONTROLLERS, start=["joint_state_controller", "joint1_position_controller"])
        states = listener.subscribe("joint_states", queue_length=10_000)
        seen: list[Any] = []
        for goal in (1.0, 0.5):
            client.deliver("command", {"data": goal})
            seen.append(client.wait("joint_states/position[0]", near=goal, tol=0.02, for_=0.5, within=15))
            seen.append(world.simulation.time_ns)
        return seen + [states.get(0.0)["position"] for _ in range(len(states))]


def test_waiting_makes_time_pass_and_the_same_calls_give_the_same_bits_in_both_engines() -> None:
    seen = slide("plain")
    assert seen[0] == pytest.approx(1.0, abs=0.02)
    assert seen == slide("plain")
    assert seen == slide("compiled")


def test_the_world_stands_still_while_nobody_waits_and_while_it_is_paused() -> None:
    world = InProcessWorld(Simulation(engine="plain"))
    client = world.client()
    client.call("/slidectl/sleep", {"duration": 0.25})
    assert world.simulation.time_ns == 250_000_000
    assert client.step(seconds=0.05) == pytest.approx(0.3)
    with pytest.raises(TimedOut, match="within 3 s") as caught:
        client.call("/slidectl/sleep", {"duration": 1.0}, timeout=3.0)
    assert "paused" in str(caught.value.hint)
    with pytest.raises(TimedOut, match="nobody resumes it"):
        next(client.events())
    assert world.simulation.time_ns == 300_000_000
    client.call("/gazebo/unpause_physics")
    client.call("/slidectl/set_speed", {"speed": 2.0})
    before = client.monotonic()
    client.call("/slidectl/sleep", {"duration": 1.0})
    assert client.monotonic() - before == pytest.approx(0.5)


def test_who_waits_is_told_when_the_simulated_time_is_up() -> None:
    world = InProcessWorld(Simulation(engine="plain"))
    world.end_ns = 500_000_000
    with pytest.raises(TimedOut, match=r"0\.5 s"):
        world.client().call("/slidectl/sleep", {"duration": 3.0})


def test_a_service_of_one_client_answers_another() -> None:
    world = InProcessWorld(Simulation(engine="plain"))
    link, caller = InProcessLink(world), world.client()
    provider = Client(link=link)
    provider.advertise_service("/double", "std_srvs/Trigger", lambda _: {"success": True, "message": "done"})
    link.connection.on_lines = lambda: deque(provider.events(0.0), maxlen=0)
    assert caller.call("/double")["message"] == "done"
    provider.close()
    with pytest.raises(Refused, match="/double"):
        caller.call("/double")


def test_an_action_and_the_end_of_the_world() -> None:
    world = InProcessWorld(Simulation(engine="plain"))
    client, other = world.client(), world.client()
    client.spawn("arm", controllers="config/arm_control.yaml", start=["joint_state_controller", "arm_controller"])
    with client.action("arm_controller") as action:
        joints = client.params["arm_controller/joints"]
        point = {"positions": [0.3] * len(joints), "time_from_start": {"secs": 2, "nsecs": 0}}
        result = action.wait(action.send({"trajectory": {"joint_names": joints, "points": [point]}}))
    assert result.succeeded
    assert 2.0 <= world.simulation.time_ns * 1e-9 < 3.0
    assert client.call("/slidectl/shutdown")["success"]
    for each in (client, other):
        with pytest.raises(NoDaemon, match="asked to stop"):
            each.call("/slidectl/status")
    with pytest.raises(NoDaemon):
        world.client()


def test_a_member_that_holds_the_world_for_longer_than_its_time_out_is_let_go() -> None:
    world = InProcessWorld(Simulation(engine="plain"))
    member, other = world.client(), world.client()
    member.call("/slidectl/lockstep", {"period": 0.01, "timeout": 0.5})
    other.call("/slidectl/sleep", {"duration": 0.1}, timeout=5)
    assert (world.simulation.time_ns, world.monotonic()) == (100_000_000, pytest.approx(0.6))
    with pytest.raises(Refused, match=r"it held the world for more than 0\.5 s"):
        member.call("/slidectl/lockstep")


def test_a_background_step_that_waits_again_when_it_is_ended_in_a_paused_world_comes_to_its_end() -> None:
    world = InProcessWorld(Simulation(engine="plain"))
    world.simulation.run.paused = True
    ended: list[str] = []

    def action(client: Client) -> None:
        for _ in range(2):
            try:
                client.wait_until(lambda: False, 1.0, "nothing came")
            except (KeyboardInterrupt, TimedOut) as end:
                ended.append(type(end).__name__)

    step = BackgroundStep(partial(InProcessBackground, world), action, timeout=10.0)
    step.end()
    assert ended == ["KeyboardInterrupt", "TimedOut"]
