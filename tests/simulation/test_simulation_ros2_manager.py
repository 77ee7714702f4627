"""The controller manager of a robot of ROS 2: states, services and answers as in ros2_control."""

from __future__ import annotations

from typing import Any

import pytest
from sim_robots import cart, configure, logged, running_cart, states_of, switch

from slidectl.control.controller_interface import Controller
from slidectl.control.hardware_interface import EffortJointInterface
from slidectl.control.node_handle import NodeHandle
from slidectl.control.registry import controller
from slidectl.physics.robot_hw import MujocoRobotHW
from slidectl.simulation import Pending, Simulation

MANAGER = "/cart/controller_manager/"
STRICT, BEST_EFFORT = 2, 1


@controller("tests/FailsToStart")
class FailsToStart(Controller[EffortJointInterface]):
    """Its parameter `joint` is the joint that it claims."""

    interface_type = EffortJointInterface

    def init(self, interface: EffortJointInterface, node: NodeHandle) -> None:
        interface.get_handle(node.get_param("joint"))

    def starting(self, time_ns: int) -> None:  # noqa: ARG002
        raise ValueError("no power")


@pytest.fixture(autouse=True)
def _of_ros2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MujocoRobotHW, "is_of_ros2", True)


@pytest.fixture
def simulation() -> Simulation:
    """A cart with two joints and configured parameters, no controller loaded, in a world that stands still."""
    simulation = Simulation(ground=False)
    simulation.spawn(cart(joints=2), "cart")
    configure(simulation, joints=2)
    return simulation


def ask(simulation: Simulation, service: str, **request: Any) -> Pending:
    return simulation.graph.services.call(MANAGER + service, request)


def ok(simulation: Simulation, service: str, name: str) -> bool:
    answer: bool = ask(simulation, service, name=name).result()["ok"]
    return answer


def bring_up(simulation: Simulation, *names: str) -> None:
    for name in names:
        assert ok(simulation, "load_controller", name)
        assert ok(simulation, "configure_controller", name)


def activate(simulation: Simulation, *names: str, stop: Any = (), strictness: int = STRICT, **more: Any) -> Any:
    request = {"activate_controllers": list(names), "deactivate_controllers": list(stop), "strictness": strictness}
    return ask(simulation, "switch_controllers", **request, **more).result()


def test_a_controller_goes_through_the_states_of_ros2_control(simulation: Simulation) -> None:
    seen = []
    for service in ("load_controller", "configure_controller"):
        assert ok(simulation, service, "position1")
        seen.append(states_of(simulation)["position1"])
    for change in ({"start": ["position1"]}, {"stop": ["position1"]}):
        assert switch(simulation, **change)
        seen.append(states_of(simulation)["position1"])
    assert ok(simulation, "cleanup_controller", "position1")
    seen.append(states_of(simulation)["position1"])
    assert seen == ["unconfigured", "inactive", "active", "inactive", "unconfigured"]
    assert ok(simulation, "unload_controller", "position1")
    assert states_of(simulation) == {}


def test_calls_that_do_not_fit_the_state_are_refused_as_in_ros2_control(simulation: Simulation) -> None:
    lines = logged(simulation)
    for service in ("configure_controller", "cleanup_controller", "unload_controller"):
        assert not ok(simulation, service, "position1")  # it is not loaded
    assert ok(simulation, "load_controller", "position1")
    assert not ok(simulation, "load_controller", "position1")
    assert "slidectl controller configure position1" in lines[-1][1]
    assert ok(simulation, "cleanup_controller", "position1")  # it is unconfigured already
    assert ok(simulation, "configure_controller", "position1")
    assert activate(simulation, "position1")["ok"]
    for service in ("configure_controller", "cleanup_controller", "unload_controller"):
        assert not ok(simulation, service, "position1")
    assert "it is active; deactivate it first: slidectl controller stop position1" in lines[-2][1]
    assert states_of(simulation) == {"position1": "active"}


def test_what_is_configured_has_the_parameters_of_that_moment(simulation: Simulation) -> None:
    bring_up(simulation, "states", "position1", "position2")
    simulation.parameters.set("/cart/position1/joint", "joint2")
    assert ok(simulation, "unload_controller", "position2")
    assert ok(simulation, "configure_controller", "position1")
    assert list(states_of(simulation)) == ["states", "position1"], "it keeps its place"
    [claim] = simulation.call(MANAGER + "list_controllers")["controller"][1]["claimed_resources"]
    assert claim["resources"] == ["joint2"]


def test_a_parameter_set_between_load_and_configure_counts(simulation: Simulation) -> None:
    assert ok(simulation, "load_controller", "position1")
    simulation.parameters.set("/cart/position1/joint", "joint2")
    assert ok(simulation, "configure_controller", "position1")
    [entry] = ask(simulation, "controller_states").result()["controller"]
    assert entry["required_command_interfaces"] == ["joint2/effort"]


def test_a_controller_that_cannot_be_configured_is_unconfigured_until_its_parameters_are_right(
    simulation: Simulation,
) -> None:
    lines = logged(simulation)
    bring_up(simulation, "position1")
    simulation.parameters.set("/cart/position1/joint", "joint9")
    assert not ok(simulation, "configure_controller", "position1")
    assert "no joint 'joint9'" in lines[-1][1]
    assert states_of(simulation) == {"position1": "unconfigured"}
    simulation.parameters.set("/cart/position1/joint", "joint1")
    assert ok(simulation, "configure_controller", "position1")
    assert activate(simulation, "position1")["ok"]
    simulation.step(5)
    assert states_of(simulation) == {"position1": "active"}


def test_a_broken_controller_can_be_unloaded(simulation: Simulation) -> None:
    bring_up(simulation, "position1")
    simulation.parameters.set("/cart/position1/joint", "joint9")
    assert not ok(simulation, "configure_controller", "position1")
    assert ok(simulation, "unload_controller", "position1")
    assert states_of(simulation) == {}


def test_an_unconfigured_controller_is_not_started(simulation: Simulation) -> None:
    lines = logged(simulation)
    assert ok(simulation, "load_controller", "position1")
    bring_up(simulation, "position2")
    assert not switch(simulation, start=["position1", "position2"])
    assert "it is unconfigured; configure it first: slidectl controller configure position1" in lines[-1][1]
    assert states_of(simulation) == {"position1": "unconfigured", "position2": "inactive"}
    assert switch(simulation, start=["position1", "position2"], strictness=BEST_EFFORT)
    assert states_of(simulation) == {"position1": "unconfigured", "position2": "active"}


def test_a_switch_with_nothing_to_do_is_true(simulation: Simulation) -> None:
    bring_up(simulation, "position1")
    assert activate(simulation)["ok"]
    assert activate(simulation, "position1")["ok"]
    assert activate(simulation, "position1", strictness=BEST_EFFORT)["ok"]
    assert not activate(simulation, "position1", strictness=STRICT)["ok"]
    assert ok(simulation, "load_controller", "position2")
    assert activate(simulation, "position2", strictness=BEST_EFFORT)["ok"], "it is unconfigured, and stays so"
    assert states_of(simulation) == {"position1": "active", "position2": "unconfigured"}


def test_best_effort_needs_one_known_name_in_a_list(simulation: Simulation) -> None:
    bring_up(simulation, "position1")
    lines = logged(simulation)
    assert not activate(simulation, "nope", strictness=BEST_EFFORT)["ok"]
    assert "cannot activate 'nope': none of them is loaded; loaded are position1" in lines[-1][1]
    answer = activate(simulation, "nope", "position1", strictness=BEST_EFFORT)
    assert answer["ok"]
    assert "activated: position1" in answer["message"].splitlines()
    assert not activate(simulation, stop=["nope"], strictness=BEST_EFFORT)["ok"]


@pytest.mark.parametrize(("default", "expected"), [(None, False), ("strict", False), ("best_effort", True)])
def test_strictness_0_is_the_default_of_the_manager(
    simulation: Simulation, default: str | None, expected: bool
) -> None:
    if default is not None:
        simulation.parameters.set("/cart/controller_manager/defaults/switch_controller/strictness", default)
    bring_up(simulation, "position1")
    assert activate(simulation, "nope", "position1", strictness=0)["ok"] is expected


@pytest.mark.parametrize("strictness", [BEST_EFFORT, STRICT])
def test_a_switch_is_false_when_a_controller_does_not_become_active(simulation: Simulation, strictness: int) -> None:
    """A strict one then stops what it has started."""
    simulation.parameters.set("/cart/dead", {"type": "tests/FailsToStart", "joint": "joint2"})
    bring_up(simulation, "position1", "dead")
    answer = activate(simulation, "position1", "dead", strictness=strictness)
    assert not answer["ok"]
    assert "not activated: dead" in answer["message"].splitlines()
    remains = "active" if strictness == BEST_EFFORT else "inactive"
    assert states_of(simulation) == {"position1": remains, "dead": "inactive"}


def test_a_controller_that_fails_is_inactive_and_can_be_activated_again(simulation: Simulation) -> None:
    bring_up(simulation, "position1")
    assert activate(simulation, "position1")["ok"]
    assert simulation.robots.get("cart").manager.fail("position1", ValueError("broken"))
    assert states_of(simulation) == {"position1": "inactive"}
    assert activate(simulation, "position1")["ok"]


def test_controller_states_have_the_fields_of_ros2_control(simulation: Simulation) -> None:
    bring_up(simulation, "states", "position1")
    assert ok(simulation, "load_controller", "position2")
    assert activate(simulation, "position1")["ok"]
    listed = {one["name"]: one for one in ask(simulation, "controller_states").result()["controller"]}
    assert [listed[name]["state"] for name in ("states", "position1", "position2")] == [
        "inactive", "active", "unconfigured"]  # fmt: skip
    one = listed["position1"]
    assert one["update_rate"] == 1000
    assert one["claimed_interfaces"] == one["required_command_interfaces"] == ["joint1/effort"]
    assert one["required_state_interfaces"] == ["joint1/position", "joint1/velocity", "joint1/effort"]
    assert listed["position2"]["required_command_interfaces"] == []
    assert listed["states"]["claimed_interfaces"] == []


def test_hardware_is_listed_and_always_active(simulation: Simulation) -> None:
    bring_up(simulation, "position1")
    assert activate(simulation, "position1")["ok"]
    [component] = ask(simulation, "list_hardware_components").result()["component"]
    assert component["state"] == {"id": 3, "label": "active"}
    assert component["type"] == "system"
    assert component["rw_rate"] == 1000
    found = ask(simulation, "list_hardware_interfaces").result()
    claimed = {one["name"]: one["is_claimed"] for one in found["command_interfaces"]}
    assert claimed == {"joint1/effort": True, "joint2/effort": False}
    names = [one["name"] for one in found["state_interfaces"]]
    assert names == sorted(f"joint{k}/{state}" for k in (1, 2) for state in ("position", "velocity", "effort"))

    def set_state(name: str, number: int, label: str) -> Any:
        return ask(simulation, "set_hardware_component_state", name=name,
                   target_state={"id": number, "label": label}).result()  # fmt: skip

    name = component["name"]
    assert set_state(name, 3, "") == set_state(name, 0, "active") == {"ok": True, "state": component["state"]}
    lines = logged(simulation)
    assert set_state(name, 0, "inactive") == set_state(name, 1, "") == {"ok": False, "state": component["state"]}
    assert "cannot become 'unconfigured': simulated hardware is always active" in lines[-1][1]
    assert set_state("gripper", 3, "") == {"ok": False, "state": {"id": 0, "label": ""}}
    assert f"hardware components: {name}" in lines[-1][1]


def test_libraries_are_reloaded_without_force_when_nothing_is_active(simulation: Simulation) -> None:
    bring_up(simulation, "position1")
    assert activate(simulation, "position1")["ok"]
    assert not ask(simulation, "reload_controller_libraries").result()["ok"]
    assert activate(simulation, stop=["position1"])["ok"]
    assert ask(simulation, "reload_controller_libraries").result()["ok"]
    assert states_of(simulation) == {}


def test_activity_shows_every_change(simulation: Simulation) -> None:
    seen: list[dict[str, str]] = []
    simulation.subscribe(
        MANAGER + "activity",
        lambda message: seen.append({one["name"]: one["state"]["label"] for one in message["controllers"]}),
    )
    bring_up(simulation, "position1")
    assert activate(simulation, "position1")["ok"]
    simulation.robots.get("cart").manager.fail("position1", ValueError("broken"))
    assert ok(simulation, "unload_controller", "position1")
    changes = [one for number, one in enumerate(seen) if number == 0 or one != seen[number - 1]]
    states = ["unconfigured", "inactive", "active", "inactive"]
    assert changes == [{}, *({"position1": state} for state in states), {}]


def test_a_snapshot_keeps_what_is_configured(simulation: Simulation) -> None:
    bring_up(simulation, "position1")
    assert ok(simulation, "load_controller", "position2")
    simulation.call("/slidectl/save", {"name": "before"})
    assert ok(simulation, "configure_controller", "position2")
    assert ok(simulation, "cleanup_controller", "position1")
    simulation.call("/slidectl/load", {"name": "before"})
    assert states_of(simulation) == {"position1": "inactive", "position2": "unconfigured"}


def test_robots_of_ros_1_keep_their_states_and_services(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MujocoRobotHW, "is_of_ros2", False)
    simulation = running_cart()
    assert states_of(simulation) == {"states": "running", "position1": "running"}
    assert not [name for name in simulation.graph.services.names() if name.endswith("configure_controller")]
