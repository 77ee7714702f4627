"""One robot's part of a cycle: periods, control period, e-stop, in the order of gazebo_ros_control."""

from __future__ import annotations

from sim_robots import Probe, cart, command, logged, put_probe, running_cart, state

from slidectl.simulation import Simulation

MS = 1_000_000


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


def test_the_first_period_after_a_spawn_is_the_whole_time_so_far() -> None:
    simulation = Simulation(ground=False)
    simulation.step(500)
    robot = simulation.spawn(cart(), "cart")
    periods: list[tuple[float, float]] = []
    read, write = robot.cycle._read, robot.cycle._write
    robot.cycle._read = lambda time, period: (periods.append(("read", period)), read(time, period))
    robot.cycle._write = lambda time, period: (periods.append(("write", period)), write(time, period))
    simulation.step(2)
    assert periods == [("read", 0.501), ("write", 0.501), ("read", 0.001), ("write", 0.001)]


def test_another_time_step_makes_another_period() -> None:
    simulation, probe = probed()
    simulation.step(2)
    simulation.set_timestep(0.002)
    simulation.step(2)
    assert probe.calls[1:] == [("update", 2 * MS), ("update", 4 * MS), ("update", 6 * MS)]
    assert probe.periods == [0.001, 0.002, 0.002]
    assert simulation.time_ns == 6 * MS


def test_an_emergency_stop_takes_the_effort_away_while_controllers_go_on() -> None:
    simulation = running_cart("<eStopTopic>stop</eStopTopic>")
    command(simulation, 1.0)
    simulation.step(50)
    simulation.publish("/cart/stop", {"data": True})
    simulation.step(1)
    assert state(simulation)[2] == 0.0
    assert simulation.robots.get("cart").manager.running_count == 2


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
