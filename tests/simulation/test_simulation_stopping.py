"""`/slidectl/estop` and `/slidectl/rest_joints`: what joints do when nobody is to move them, on both engines."""

from __future__ import annotations

from typing import Any

import pytest
from engine_scenes import add, arm, play, switch

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

KINDS = {
    "Effort": "JointEffortController",
    "Velocity": "JointVelocityController",
    "Position": "JointPositionController",
}
ENGINES = [
    "plain",
    pytest.param("compiled", marks=pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")),
]


@pytest.fixture(params=ENGINES)
def world(request: pytest.FixtureRequest) -> Simulation:
    return Simulation(engine=request.param)


def drive(simulation: Simulation, name: str, interface: str, command: float = 0.5) -> None:
    """A robot whose second joint, a revolute one, gets this command."""
    kind = f"{interface.lower()}_controllers/{KINDS[interface]}"
    xml = arm(("prismatic", "revolute"), interface=interface)
    add(simulation, name, xml, {"goal": {"type": kind, "joint": "joint2"}})
    simulation.step(2)
    simulation.publish(f"/{name}/goal/command", {"data": command})
    simulation.step(200)


def state(simulation: Simulation, name: str) -> tuple[float, float, float]:
    """Position, velocity and effort of the second joint."""
    position, velocity, effort = simulation.world.joint_state(name, "joint2")
    return float(position), float(velocity), float(effort)


def rest(simulation: Simulation, command: str, **more: Any) -> dict[str, Any]:
    return simulation.call("/slidectl/rest_joints", {"robot": "a", "controllers": ["goal"], "command": command, **more})


def estop(simulation: Simulation, *names: str, stop: bool = True) -> dict[str, Any]:
    return simulation.call("/slidectl/estop", {"names": list(names), "stop": stop})


# -- rest_joints ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("interface", ["Effort", "Velocity"])
def test_a_stopped_controller_leaves_its_command_and_zero_takes_it_away(world: Simulation, interface: str) -> None:
    drive(world, "a", interface)
    switch(world, "a", stop=["goal"])
    world.step(2)
    command = world.robots.get("a").hardware.driven()[1].handle.command
    assert command == 0.5, "as in ROS"
    assert rest(world, "zero") == {
        "success": True,
        "message": f"joint2 keeps {'an effort' if interface == 'Effort' else 'a velocity'} of 0",
        "joints": ["joint2"],
    }
    world.step(1)
    assert world.robots.get("a").hardware.driven()[1].handle.command == 0.0
    if interface == "Effort":
        assert state(world, "a")[2] == 0.0


@pytest.mark.parametrize("interface", ["Velocity", "Position"])
def test_hold_keeps_a_joint_where_it_is(world: Simulation, interface: str) -> None:
    drive(world, "a", interface)
    if interface == "Position":
        world.publish("/a/goal/command", {"data": 0.9})
        world.step(1)
    switch(world, "a", stop=["goal"])
    world.step(1)
    assert rest(world, "hold")["success"]
    world.step(1)
    held = state(world, "a")[0]
    world.step(1000)
    assert state(world, "a")[0] == pytest.approx(held, abs=2e-3)


@pytest.mark.parametrize(("interface", "command"), [("Effort", "hold"), ("Position", "zero")])
def test_what_an_interface_cannot_do_is_refused_and_changes_nothing(
    world: Simulation, interface: str, command: str
) -> None:
    drive(world, "a", interface)
    switch(world, "a", stop=["goal"])
    world.step(2)
    before = world.robots.get("a").hardware.driven()[1].handle.command
    for check_only in (True, False):
        answer = rest(world, command, check_only=check_only)
        assert not answer["success"]
        assert "joint2 is commanded by its" in answer["message"]
    assert world.robots.get("a").hardware.driven()[1].handle.command == before


def test_a_running_controller_is_asked_for_first_and_an_unknown_one_is_named(world: Simulation) -> None:
    drive(world, "a", "Effort")
    assert "goal runs and writes its own commands" in rest(world, "zero")["message"]
    assert rest(world, "zero", check_only=True)["joints"] == ["joint2"]
    assert "no controller 'gaol'" in rest(world, "zero", controllers=["gaol"])["message"]
    assert "no robot 'b'" in rest(world, "zero", robot="b")["message"]
    assert "no command 'fly'" in rest(world, "fly")["message"]


def test_joints_that_another_controller_takes_over_are_left_to_it(world: Simulation) -> None:
    drive(world, "a", "Effort")
    kind = "effort_controllers/JointEffortController"
    world.parameters.set("/a/other", {"type": kind, "joint": "joint2"})
    assert world.call("/a/controller_manager/load_controller", {"name": "other"})["ok"]
    assert rest(world, "hold", check_only=True, left_to=["other"])["joints"] == []
    switch(world, "a", stop=["goal"], start=["other"])
    world.step(2)
    assert rest(world, "hold") == {"success": True, "message": "no joints affected", "joints": []}


# -- the emergency stop ---------------------------------------------------------------------------------------------


def test_an_emergency_stop_does_to_each_interface_what_the_hardware_of_gazebo_does(world: Simulation) -> None:
    for name, interface in (("a", "Effort"), ("b", "Velocity"), ("c", "Position")):
        drive(world, name, interface)
    answer = estop(world)
    assert (answer["success"], answer["robots"]) == (True, ["a", "b", "c"])
    world.publish("/c/goal/command", {"data": -0.9})
    before = {name: state(world, name)[0] for name in "abc"}
    world.step(300)
    assert state(world, "a")[2] == 0.0
    for name in "bc":
        assert state(world, name)[0] == pytest.approx(before[name], abs=2e-3)
    assert [len(robot.manager.running) for robot in world.robots] == [1, 1, 1], "controllers go on"


def test_one_robot_is_stopped_by_name_or_namespace_and_the_listings_say_so(world: Simulation) -> None:
    for name in "ab":
        drive(world, name, "Effort")
    assert estop(world, "/b")["robots"] == ["b"]
    assert world.call("/slidectl/status")["estop"] == ["b"]
    assert [robot["estop"] for robot in world.call("/slidectl/list_robots")["robots"]] == [False, True]
    answer = estop(world, "a", "nobody")
    assert (answer["success"], answer["robots"]) == (False, [])
    assert world.call("/slidectl/status")["estop"] == ["b"], "all of them or none"
    assert estop(world, "b", stop=False)["success"]
    assert world.call("/slidectl/status")["estop"] == []


def test_the_topic_of_the_plugin_and_the_service_set_the_same_stop(world: Simulation) -> None:
    add(world, "a", arm(plugin="<eStopTopic>/stop</eStopTopic>"), {})
    world.publish("/stop", {"data": True}, "std_msgs/Bool")
    assert world.call("/slidectl/status")["estop"] == ["a"]
    estop(world, stop=False)
    assert world.call("/slidectl/status")["estop"] == []


def test_an_emergency_stop_outlasts_a_reset_and_goes_with_the_robot(world: Simulation) -> None:
    drive(world, "a", "Position")
    estop(world)
    world.step(10)
    world.reset_simulation()
    world.step(100)
    assert world.call("/slidectl/status")["estop"] == ["a"]
    assert state(world, "a")[0] == pytest.approx(0.0, abs=2e-3), "it holds where the reset put it"
    world.delete("a")
    assert estop(world)["message"] == "no robots in the world"
    drive(world, "a", "Position")
    assert world.call("/slidectl/status")["estop"] == []


def test_a_released_robot_begins_where_it_is(world: Simulation) -> None:
    drive(world, "a", "Position")
    estop(world)
    world.publish("/a/goal/command", {"data": 2.0})
    world.step(50)
    there = state(world, "a")[0]
    estop(world, stop=False)
    world.step(500)
    assert state(world, "a")[0] == pytest.approx(there, abs=2e-3)


@pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
def test_both_engines_give_the_same_bits_through_stops_and_rests() -> None:
    def scene(simulation: Simulation) -> None:
        for name, interface in (("a", "Effort"), ("b", "Velocity"), ("c", "Position")):
            drive(simulation, name, interface)
        for names, stop in ((("a", "c"), True), ((), True), (("b",), False), ((), False)):
            estop(simulation, *names, stop=stop)
            simulation.step(130)
        for name, command in (("a", "zero"), ("b", "hold"), ("c", "hold")):
            switch(simulation, name, stop=["goal"])
            simulation.step(3)
            assert rest(simulation, command, robot=name)["success"]
            simulation.step(77)
        estop(simulation, "a")
        simulation.reset_simulation()
        simulation.step(200)

    plain, _ = play(scene, "plain")
    compiled, _ = play(scene, "compiled")
    assert plain == compiled
