"""One robot's part of a cycle: periods, control period, e-stop, in the order of gazebo_ros_control."""

from __future__ import annotations

import pytest
from engine_scenes import arm
from sim_robots import Probe, cart, command, drive_up, logged, put_probe, running_cart, state, switch

from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

MS = 1_000_000

needs_numba = pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")


def probed(plugin: str = "", timestep: float = 0.001, before: int = 0) -> tuple[Simulation, Probe]:
    """A cart spawned after some cycles, with a probe that is running."""
    simulation = Simulation(timestep=timestep, ground=False)
    simulation.step(before)
    robot = simulation.spawn(cart(plugin), "cart")
    probe = put_probe(simulation, robot)
    robot.manager.request_switch(["probe"], [], 2)
    return simulation, probe


def test_a_controller_that_is_started_has_its_first_update_one_cycle_later() -> None:
    simulation, probe = probed()
    simulation.step(3)
    assert probe.calls == [("starting", 1 * MS), ("update", 2 * MS), ("update", 3 * MS)]
    assert probe.periods == [0.001, 0.001]


def test_a_controller_that_is_stopped_has_one_update_in_that_cycle() -> None:
    simulation, probe = probed()
    simulation.step(2)
    simulation.robots.get("cart").manager.request_switch([], ["probe"], 2)
    simulation.step(2)
    assert probe.calls[-2:] == [("update", 3 * MS), ("stopping", 3 * MS)]


def test_with_a_control_period_the_controllers_run_at_the_next_multiple_of_the_step() -> None:
    simulation, probe = probed("<controlPeriod>0.0025</controlPeriod>")
    simulation.step(10)
    assert probe.calls == [("starting", 3 * MS), ("update", 6 * MS), ("update", 9 * MS)]
    assert probe.periods == [0.003, 0.003]


def test_between_two_updates_of_the_controllers_the_last_effort_acts_in_every_step() -> None:
    simulation = Simulation(ground=False)
    simulation.spawn(cart("<controlPeriod>0.005</controlPeriod>", damping=0.0), "cart")
    simulation.parameters.set("/cart/push", {"type": "effort_controllers/JointEffortController", "joint": "joint1"})
    assert simulation.call("/cart/controller_manager/load_controller", {"name": "push"})["ok"]
    assert switch(simulation, start=["push"])
    simulation.step(5)
    command(simulation, 3.0, "/cart/push/command")
    simulation.step(4)
    assert state(simulation)[1] == 0.0
    simulation.step(10)
    assert state(simulation)[1] == pytest.approx(10 * 0.001 * 3.0)


def test_what_a_transmission_says_of_its_gear_changes_nothing() -> None:
    gear = '<actuator name="m1"><mechanicalReduction>50</mechanicalReduction></actuator>'
    moved = []
    for text in (cart(), cart().replace('<actuator name="m1"/>', gear)):
        simulation = Simulation(ground=False)
        simulation.spawn(text, "cart")
        drive_up(simulation)
        command(simulation, 1.0)
        simulation.step(500)
        moved.append(state(simulation))
    assert moved[0] == moved[1] != (0.0, 0.0, 0.0)


def test_a_control_period_below_the_step_is_reported_and_means_every_step() -> None:
    simulation = Simulation(ground=False)
    lines = logged(simulation)
    simulation.spawn(cart("<controlPeriod>0.0001</controlPeriod>"), "cart")
    assert [severity for severity, text in lines if "controlPeriod" in text] == ["error"]


def test_a_control_period_above_the_step_is_reported() -> None:
    simulation = Simulation(ground=False)
    lines = logged(simulation)
    simulation.spawn(cart("<controlPeriod>0.01</controlPeriod>"), "cart")
    assert [severity for severity, text in lines if "controlPeriod" in text] == ["warn"]


ENGINES = ["plain", pytest.param("compiled", marks=needs_numba)]


@needs_numba
def test_times_of_updates_are_those_of_the_interpreter_and_say_what_runs_compiled() -> None:
    simulation = Simulation(ground=False, engine="compiled")
    simulation.engine.complete()
    robot = simulation.spawn(cart(joints=2), "cart")
    drive_up(simulation, joints=1)
    put_probe(simulation, robot, joint="joint2")
    assert switch(simulation, start=["probe"])
    simulation.step(100)
    listed = simulation.call("/slidectl/update_times", {"robot": "cart"})["controllers"]
    times = {one["name"]: one for one in listed}
    assert (times["position1"]["compiled"], times["probe"]["compiled"]) == (True, False)
    assert times["position1"]["updates"] < times["probe"]["updates"] == 100
    assert 0.0 < times["probe"]["mean"] <= times["probe"]["longest"]


@pytest.mark.parametrize("engine", ENGINES)
def test_no_first_period_is_longer_than_the_time_since_the_spawn_or_the_reset(engine: str) -> None:
    """Several robots, each spawned at another time, two of them with a control period of their own."""
    simulation = Simulation(ground=False, engine=engine)
    if engine == "compiled":
        simulation.engine.complete()
    periods = {"": 0.001, "<controlPeriod>0.003</controlPeriod>": 0.003, "<controlPeriod>0.0045</controlPeriod>": 0.005}
    probes: list[tuple[Probe, float]] = []

    def look() -> None:
        for probe, expected in probes:
            assert probe.periods
            assert set(probe.periods) == {expected}
            probe.periods.clear()

    for number, (plugin, expected) in enumerate([*periods.items(), *periods.items()]):
        simulation.step((1, 500, 7, 100_000, 3, 40)[number])
        robot = simulation.spawn(cart(plugin), f"cart{number}")
        probes.append((put_probe(simulation, robot), expected))
        assert switch(simulation, start=["probe"], namespace=robot.namespace)
        simulation.step(17)
        look()
    for reset in (simulation.reset_world, simulation.reset_simulation, simulation.reset_simulation):
        simulation.step(1_001)
        look()
        reset()
        simulation.step(16)
        look()
        simulation.pause()
        simulation.resume()
        simulation.call("/cart0/controller_manager/unload_controller", {"name": "absent"})
        simulation.step(16)
        look()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("before", [0, 1, 1_000_000])
def test_soft_limits_and_drives_of_a_new_robot_do_the_same_whenever_it_comes(engine: str, before: int) -> None:
    """It begins outside of its soft limits: what brings it back depends on the period. The same bits at any time."""

    def course(simulation: Simulation) -> list[tuple[float, float, float]]:
        course = []
        for _ in range(20):
            simulation.step(1)
            course.append(state(simulation, "arm"))
        simulation.step(100)
        return [*course, state(simulation, "arm")]

    def spawned(before: int) -> Simulation:
        simulation = Simulation(ground=False, engine=engine)
        if engine == "compiled":
            simulation.engine.complete()
        simulation.step(before)
        simulation.parameters.set("/arm/gazebo_ros_control/pid_gains/joint2", {"p": 40.0, "i": 9.0, "i_clamp": 5.0})
        xml = arm(("revolute", "prismatic"), safety=True, interface="Position")
        xml = xml.replace('upper="2.5"', 'upper="-0.07"').replace('soft_upper_limit="1"', 'soft_upper_limit="-0.07"')
        simulation.spawn(xml, "arm")
        return simulation

    simulation = spawned(before)
    first = course(simulation)
    assert max(abs(position) for position, _, _ in first) < 0.1
    assert first == course(spawned(0))
    for reset in (simulation.reset_world, simulation.reset_simulation):
        reset()
        assert course(simulation) == first


def test_another_time_step_makes_another_period() -> None:
    simulation, probe = probed()
    simulation.step(2)
    simulation.set_timestep(0.002)
    simulation.step(2)
    assert probe.calls[1:] == [("update", 2 * MS), ("update", 4 * MS), ("update", 6 * MS)]
    assert probe.periods == [0.001, 0.002, 0.002]
    assert simulation.time_ns == 6 * MS


def test_after_an_emergency_stop_the_controllers_start_anew_where_they_are() -> None:
    simulation = running_cart("<eStopTopic>/all/stop</eStopTopic>")
    command(simulation, 1.0)
    simulation.step(300)
    simulation.publish("/all/stop", {"data": True})
    simulation.step(5000)
    rest = state(simulation)[0]
    simulation.publish("/all/stop", {"data": False})
    simulation.step(2000)
    assert abs(state(simulation)[0] - rest) < 1e-3, "the old set point is forgotten"
    assert abs(rest - 1.0) > 0.5


def test_releasing_calls_stopping_and_starting_before_that_cycles_update() -> None:
    simulation, probe = probed("<eStopTopic>stop</eStopTopic>")
    simulation.step(2)
    simulation.publish("/cart/stop", {"data": True})
    simulation.step(1)
    simulation.publish("/cart/stop", {"data": False})
    simulation.step(2)
    assert probe.calls[-4:] == [("stopping", 4 * MS), ("starting", 4 * MS), ("update", 4 * MS), ("update", 5 * MS)]


def test_the_state_that_a_controller_sees_is_that_of_the_end_of_the_cycle_before() -> None:
    simulation = running_cart()
    command(simulation, 1.0)
    simulation.step(100)
    before = state(simulation)[0]
    simulation.step(1)
    handle_position = simulation.robots.get("cart").hardware._joints[0].handle.position
    assert handle_position == before != state(simulation)[0]
