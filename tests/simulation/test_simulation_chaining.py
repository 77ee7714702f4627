"""A chain of controllers on a simulated robot: a forward controller gives positions to a PID, which gives efforts."""

from __future__ import annotations

from random import Random

import pytest
from engine_scenes import add
from sim_robots import STATES, cart, state, states_of
from test_simulation_compiled_controllers import assert_same, is_compiled, played, restart

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

GRAVITY = 9.81
LIFT = cart(damping=0.5).replace('axis xyz="1 0 0"', 'axis xyz="0 0 1"')
"""A carriage of 1 kg on a vertical rail."""
GAINS = {"p": 400.0, "i": 800.0, "d": 40.0, "u_clamp_max": 100.0, "u_clamp_min": -100.0}
CONTROLLERS = {
    "states": {"type": STATES, "publish_rate": 100},
    "pid_controller": {
        "type": "pid_controller/PidController",
        "dof_names": ["joint1"],
        "command_interface": "effort",
        "reference_and_state_interfaces": ["position"],
        "gains": {"joint1": {**GAINS, "antiwindup_strategy": "conditional_integration"}},
    },
    "forward": {"type": "position_controllers/JointGroupPositionController", "joints": ["pid_controller/joint1"]},
}


def lift(simulation: Simulation) -> Simulation:
    add(simulation, "a", LIFT, CONTROLLERS)
    simulation.step(2)
    assert states_of(simulation, "/a") == dict.fromkeys(("states", "forward", "pid_controller"), "running")
    return simulation


def test_a_chain_holds_a_carriage_against_gravity_and_moves_it() -> None:
    simulation = lift(Simulation(ground=False))
    simulation.step(3000)
    position, velocity, effort = state(simulation, "a")
    assert (position, velocity) == pytest.approx((0.0, 0.0), abs=2e-3)
    assert effort == pytest.approx(GRAVITY, abs=0.05)
    simulation.publish("/a/forward/command", {"data": [0.5]})
    simulation.step(5000)
    assert state(simulation, "a") == pytest.approx((0.5, 0.0, GRAVITY), abs=0.01)


def test_exported_interfaces_are_no_joints_of_the_robot() -> None:
    simulation = lift(Simulation(ground=False))
    heard = []
    simulation.subscribe("/a/joint_states", heard.append)
    simulation.step(50)
    assert {tuple(message["name"]) for message in heard} == {("joint1",)}
    listed = simulation.call("/slidectl/list_robots", {})["robots"][0]
    assert [joint["name"] for joint in listed["joints"]] == ["joint1"]
    assert simulation.call("/slidectl/joint_states", {})["joints"] == ["a::joint1"]


@pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
def test_a_robot_with_a_chain_runs_the_same_compiled_and_its_other_controllers_have_machine_code() -> None:
    def scene(simulation: Simulation) -> None:
        lift(simulation)
        for topic in ("/a/joint_states", "/a/pid_controller/controller_state"):
            simulation.heard.listen(topic)  # type: ignore[attr-defined]
        dice = Random(3)
        things = [
            lambda: simulation.publish("/a/forward/command", {"data": [dice.uniform(-1.0, 1.0)]}),
            lambda: simulation.publish("/a/pid_controller/reference", {"dof_names": ["joint1"], "values": [0.2]}),
            lambda: restart(simulation, "forward"),
        ]
        played(simulation, dice, things, 15)

    simulation = assert_same(scene)
    assert is_compiled(simulation, "a", "states")
    assert not is_compiled(simulation, "a", "pid_controller")
