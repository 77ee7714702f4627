"""The controller manager's services: at once in a standing world, in their cycle and in order in a running one."""

from __future__ import annotations

from typing import Any

import pytest
from sim_robots import cart, command, configure, logged, put_probe, running_cart, state, states_of, switch

from slidectl.errors import Refused
from slidectl.simulation import Pending, Simulation

MANAGER = "/cart/controller_manager/"


def ask(simulation: Simulation, service: str, **request: Any) -> Pending:
    return simulation.graph.services.call(MANAGER + service, request)


@pytest.fixture
def simulation() -> Simulation:
    """A cart with configured controllers, none loaded, in a world that stands still."""
    simulation = Simulation(ground=False)
    simulation.spawn(cart(), "cart")
    configure(simulation)
    return simulation


@pytest.fixture
def driven(simulation: Simulation) -> Simulation:
    """The same, with both controllers loaded, in a world that somebody drives."""
    for name in ("states", "position1"):
        assert ask(simulation, "load_controller", name=name).result()["ok"]
    simulation.driven = True
    return simulation


def test_load_start_stop_unload(simulation: Simulation) -> None:
    assert ask(simulation, "load_controller", name="states").result() == {"ok": True}
    assert states_of(simulation) == {"states": "initialized"}
    assert switch(simulation, start=["states"])
    assert states_of(simulation) == {"states": "running"}
    assert not ask(simulation, "unload_controller", name="states").result()["ok"]
    assert switch(simulation, stop=["states"])
    assert states_of(simulation) == {"states": "stopped"}
    assert ask(simulation, "unload_controller", name="states").result()["ok"]
    assert states_of(simulation) == {}
    assert simulation.time_ns == 0


def test_a_refusal_is_answered_with_false_and_its_reason_is_on_the_log(simulation: Simulation) -> None:
    lines = logged(simulation)
    assert ask(simulation, "load_controller", name="nope").result() == {"ok": False}
    assert switch(simulation, start=["nope"]) is False
    assert [severity for severity, _ in lines] == ["error", "error"]
    assert "/cart/nope/type is not set" in lines[0][1]


def test_types_come_with_their_base_class(simulation: Simulation) -> None:
    answer = ask(simulation, "list_controller_types").result()
    assert "effort_controllers/JointPositionController" in answer["types"]
    assert set(answer["base_classes"]) == {"controller_interface::ControllerBase"}
    assert len(answer["types"]) == len(answer["base_classes"])


def test_reload_needs_force_when_something_is_loaded(driven: Simulation) -> None:
    assert not ask(driven, "reload_controller_libraries").result()["ok"]
    assert ask(driven, "reload_controller_libraries", force_kill=True).result()["ok"]
    assert states_of(driven) == {}


def test_in_a_running_world_a_switch_is_answered_by_the_cycle_that_did_it(driven: Simulation) -> None:
    answer = ask(driven, "switch_controller", start_controllers=["states", "position1"], strictness=2)
    assert not answer.done
    driven.step(1)
    assert answer.result() == {"ok": True}
    assert len(driven.robots.get("cart").manager.running) == 2


def test_all_services_queue_behind_an_armed_switch(driven: Simulation) -> None:
    first = ask(driven, "switch_controller", start_controllers=["states"], strictness=2)
    second = ask(driven, "switch_controller", start_controllers=["position1"], strictness=2)
    unload = ask(driven, "unload_controller", name="position1")
    listing = ask(driven, "list_controllers")
    assert not any(answer.done for answer in (first, second, unload, listing))
    driven.step(1)
    assert first.done
    assert not second.done
    driven.step(1)
    assert second.result()["ok"]
    assert unload.result() == {"ok": False}, "it is running by then"
    assert [entry["state"] for entry in listing.result()["controller"]] == ["running", "running"]


def test_a_refused_switch_needs_no_cycle(driven: Simulation) -> None:
    assert ask(driven, "switch_controller", start_controllers=["nope"], strictness=2).result() == {"ok": False}


def test_in_a_paused_world_a_switch_is_done_at_once(driven: Simulation) -> None:
    driven.step(5)
    driven.pause()
    assert switch(driven, start=["states"])
    assert driven.time_ns == 5_000_000


def test_a_switch_that_is_armed_when_the_world_is_paused_is_finished_then(driven: Simulation) -> None:
    answer = ask(driven, "switch_controller", start_controllers=["states"], strictness=2)
    listing = ask(driven, "list_controllers")
    driven.pause()
    assert answer.result()["ok"]
    assert listing.result()["controller"][0]["state"] == "running"


def test_while_steps_are_pending_a_paused_world_runs(driven: Simulation) -> None:
    driven.pause()
    steps = driven.graph.services.call("/slidectl/step", {"cycles": 2})
    answer = ask(driven, "switch_controller", start_controllers=["states"], strictness=2)
    assert not answer.done
    driven.step(driven.run.allowed(10))
    assert steps.done
    assert answer.result()["ok"]


def test_a_switch_whose_steps_are_given_up_is_finished_all_the_same(driven: Simulation) -> None:
    driven.pause()
    steps = driven.graph.services.call("/slidectl/step", {"cycles": 2})
    answer = ask(driven, "switch_controller", start_controllers=["states"], strictness=2)
    steps.cancel()
    assert answer.result()["ok"]


def test_a_switch_that_is_asked_for_at_the_end_of_the_last_step_is_not_left_hanging(driven: Simulation) -> None:
    driven.pause()
    answers: list[Pending] = []
    sleep = driven.graph.services.call("/slidectl/sleep", {"duration": 0.002})
    sleep.then(lambda _: answers.append(ask(driven, "switch_controller", start_controllers=["states"], strictness=2)))
    driven.graph.services.call("/slidectl/step", {"cycles": 2})
    driven.step(driven.run.allowed(10))
    assert answers[0].result()["ok"]


def test_who_goes_while_queued_is_passed_over(driven: Simulation) -> None:
    ask(driven, "switch_controller", start_controllers=["states"], strictness=2)
    unload = ask(driven, "unload_controller", name="position1")
    unload.cancel()
    driven.step(1)
    assert states_of(driven) == {"states": "running", "position1": "initialized"}


def test_when_the_robot_goes_who_waits_is_told(driven: Simulation) -> None:
    switching = ask(driven, "switch_controller", start_controllers=["states"], strictness=2)
    listing = ask(driven, "list_controllers")
    driven.delete("cart")
    for answer in (switching, listing):
        with pytest.raises(Refused, match="went away"):
            answer.result()
    driven.step(3)


def test_a_switch_from_inside_a_cycle_takes_place_in_that_cycle(simulation: Simulation) -> None:
    robot = simulation.robots.get("cart")
    probe = put_probe(simulation, robot)
    ask(simulation, "load_controller", name="states")
    assert switch(simulation, start=["probe"])
    answers: list[Pending] = []

    def act(_time_ns: int) -> None:
        if not answers:
            answers.append(ask(simulation, "switch_controller", start_controllers=["states"], strictness=2))

    probe.act = act
    simulation.step(1)
    assert answers[0].result()["ok"]
    assert states_of(simulation) == {"probe": "running", "states": "running"}


def test_gains_set_as_parameters_take_effect_at_the_next_cycle() -> None:
    simulation = running_cart()
    command(simulation, 1.0)
    states: list[Any] = []
    simulation.subscribe("/cart/position1/state", states.append)
    simulation.step(10)
    simulation.parameters.set("/cart/position1/pid/p", 55.0)
    simulation.step(10)
    assert states[0]["p"] == 100.0
    assert states[-1]["p"] == 55.0


def test_gains_set_through_rosapi_and_through_reconfigure_reach_the_controller() -> None:
    simulation = running_cart()
    states: list[Any] = []
    simulation.subscribe("/cart/position1/state", states.append)
    simulation.call("/rosapi/set_param", {"name": "/cart/position1/pid/d", "value": "7"})
    config = {"doubles": [{"name": "p", "value": 42.0}]}
    simulation.call("/cart/position1/pid/set_parameters", {"config": config})
    simulation.step(11)
    assert (states[-1]["p"], states[-1]["d"]) == (42.0, 7.0)
    assert simulation.parameters.get("/cart/position1/pid/p") == 42.0


def test_a_controller_that_starts_in_a_standing_world_holds_the_joint_where_it_is(simulation: Simulation) -> None:
    simulation.world.set_joint("cart", "joint1", 0.25, 0.0)
    for name in ("states", "position1"):
        ask(simulation, "load_controller", name=name)
    assert switch(simulation, start=["states", "position1"])
    simulation.step(500)
    assert state(simulation)[0] == pytest.approx(0.25, abs=1e-9)


def test_a_switch_may_be_asked_for_in_the_words_of_ros2_control(driven: Simulation) -> None:
    strict = {"strictness": 2, "timeout": {"secs": 0, "nsecs": 500_000_000}}
    answer = ask(driven, "switch_controllers", activate_controllers=["states", "position1"], **strict)
    assert not answer.done, "it takes effect in a cycle, as the other one"
    driven.step()
    assert answer.result() == {"ok": True, "message": ""}
    driven.graph.log.reasons = []
    refused = ask(driven, "switch_controllers", deactivate_controllers=["nope"], **strict).result()
    driven.graph.log.reasons = None
    assert not refused["ok"]
    assert "no controller 'nope' to stop" in refused["message"]
    ask(driven, "switch_controllers", deactivate_controllers=["position1"], strictness=1)
    driven.step()
    assert states_of(driven) == {"states": "running", "position1": "stopped"}
