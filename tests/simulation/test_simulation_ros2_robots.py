"""Robots of ROS 2: joints of `<ros2_control>` are driven by what the running controllers claim, in a real world."""

from __future__ import annotations

import math
from typing import Any

import pytest
from sim_robots import logged, state

from slidectl.errors import Refused
from slidectl.simulation import Simulation

STATES = '<state_interface name="position"/><state_interface name="velocity"/><state_interface name="effort"/>'
GROUPS = {
    "position": "position_controllers/JointGroupPositionController",
    "velocity": "velocity_controllers/JointGroupVelocityController",
    "effort": "effort_controllers/JointGroupEffortController",
}
MASS_KG, LENGTH_M = 2.0, 0.5
LIMIT = '<limit lower="-3" upper="3" effort="50" velocity="4"/>'


def pendulum(
    *commands: str, params: str = "", limit: str = LIMIT, plugin: str = "", states: str = STATES, inside: str = ""
) -> str:
    """A point mass on a rod that turns about y; at 0 it stands upright."""
    written = "".join(f'<command_interface name="{name}">{inside}</command_interface>' for name in commands)
    gazebo = f'<gazebo><plugin filename="libgz_ros2_control-system.so" name="gz">{plugin}</plugin></gazebo>'
    return f"""<robot name="pendulum"><link name="world"/>
  <joint name="hinge" type="{"revolute" if limit else "continuous"}"><parent link="world"/><child link="rod"/>
    <origin xyz="0 0 2"/><axis xyz="0 1 0"/>{limit}</joint>
  <link name="rod"><inertial><origin xyz="0 0 {LENGTH_M}"/><mass value="{MASS_KG}"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <ros2_control name="sys" type="system"><hardware><plugin>gz_ros2_control/GazeboSimSystem</plugin></hardware>
    <joint name="hinge">{written}{states}{params}</joint></ros2_control>{gazebo}</robot>"""


def spawned(xml: str, *groups: str, rate_hz: int = 100) -> Simulation:
    """A world with the pendulum, and a group controller of each quantity loaded and configured."""
    simulation = Simulation(ground=False)
    simulation.parameters.set("/update_rate", rate_hz)
    simulation.spawn(xml, "pendulum")
    for quantity in groups:
        simulation.parameters.set(f"/{quantity}", {"type": GROUPS[quantity], "joints": ["hinge"]})
        for verb in ("load", "configure"):
            assert simulation.call(f"/controller_manager/{verb}_controller", {"name": quantity})["ok"]
    return simulation


def switch(simulation: Simulation, start: Any = (), stop: Any = ()) -> bool:
    request = {"start_controllers": list(start), "stop_controllers": list(stop), "strictness": 2}
    return bool(simulation.call("/controller_manager/switch_controller", request)["ok"])


def command(simulation: Simulation, quantity: str, value: float) -> None:
    simulation.publish(f"/{quantity}/commands", {"data": [value]})


def starts_at(position: float) -> str:
    """The state interfaces, with an initial position."""
    initial = f'<state_interface name="position"><param name="initial_value">{position}</param></state_interface>'
    return STATES.replace('<state_interface name="position"/>', initial)


def angle(simulation: Simulation) -> float:
    return state(simulation, "pendulum", "hinge")[0]


def test_a_joint_is_held_until_a_controller_commands_it_and_after_it_stops() -> None:
    simulation = spawned(pendulum("effort", states=starts_at(1.0)), "effort")
    simulation.step(500)
    assert angle(simulation) == pytest.approx(1.0, abs=1e-6)
    assert switch(simulation, ["effort"])
    simulation.step(50)
    assert angle(simulation) > 1.01  # it falls: the effort is 0
    assert switch(simulation, stop=["effort"])
    simulation.step(10)
    here = angle(simulation)
    simulation.step(500)
    assert angle(simulation) == pytest.approx(here, abs=1e-6)


def test_a_joint_falls_when_the_plugin_does_not_hold_joints() -> None:
    xml = pendulum("effort", states=starts_at(1.0), plugin="<hold_joints>false</hold_joints>")
    simulation = spawned(xml)
    simulation.step(1)
    # A point mass: the angular acceleration is g sin(angle) / length.
    assert state(simulation, "pendulum", "hinge")[1] == pytest.approx(9.8 * math.sin(1.0) / LENGTH_M * 1e-3, rel=2e-3)


def test_a_joint_without_command_interfaces_is_free_and_measured() -> None:
    simulation = spawned(pendulum(states=starts_at(1.0)))
    simulation.step(200)
    assert angle(simulation) > 1.2
    handles = simulation.robots.get("pendulum").hardware.handles("hinge")
    assert handles[0].position > 1.2


@pytest.mark.parametrize("quantity", ["position", "velocity", "effort"])
def test_the_claim_of_the_running_controller_decides(quantity: str) -> None:
    simulation = spawned(pendulum("position", "velocity", "effort"), "position", "velocity", "effort")
    assert switch(simulation, ["position"])
    command(simulation, "position", 0.1)
    simulation.step(50)
    if quantity != "position":
        assert switch(simulation, [quantity], ["position"])
    start = angle(simulation)
    command(simulation, quantity, {"position": 0.3, "velocity": 0.5, "effort": 5.0}[quantity])
    simulation.step(200)
    moved, velocity, _ = state(simulation, "pendulum", "hinge")
    if quantity == "position":
        assert moved == pytest.approx(0.3, abs=1e-9)
    elif quantity == "velocity":
        assert velocity == pytest.approx(0.5)
        assert moved - start == pytest.approx(0.5 * 0.2, abs=0.5 * 0.011)
    else:
        assert simulation.robots.get("pendulum").hardware.joint_effort("hinge") == 5.0


def test_two_controllers_do_not_command_one_joint() -> None:
    simulation = spawned(pendulum("position", "effort"), "position", "effort")
    assert switch(simulation, ["position"])
    assert not switch(simulation, ["effort"])
    assert switch(simulation, ["effort"], ["position"])


def test_a_controller_for_an_interface_that_the_joint_lacks_is_not_loaded() -> None:
    simulation = spawned(pendulum("position"))
    simulation.parameters.set("/effort", {"type": GROUPS["effort"], "joints": ["hinge"]})
    lines = logged(simulation)
    assert not simulation.call("/controller_manager/load_controller", {"name": "effort"})["ok"]
    assert any("'hinge' has PositionJointInterface" in text for _, text in lines)


def test_a_position_is_reached_evenly_in_the_control_period() -> None:
    simulation = spawned(pendulum("position", limit=LIMIT.replace('velocity="4"', 'velocity="40"')), "position")
    assert switch(simulation, ["position"])
    simulation.step(25)  # five steps after a control period has begun
    command(simulation, "position", 0.1)
    simulation.step(10)
    position, velocity, _ = state(simulation, "pendulum", "hinge")
    assert 0.0 < position < 0.1
    assert velocity == pytest.approx(0.1 / 0.01, rel=1e-6)
    simulation.step(20)
    assert state(simulation, "pendulum", "hinge")[:2] == pytest.approx((0.1, 0.0), abs=1e-9)


def test_a_far_position_is_approached_with_the_largest_velocity() -> None:
    simulation = spawned(pendulum("position"), "position")
    assert switch(simulation, ["position"])
    command(simulation, "position", 2.0)
    simulation.step(200)
    assert state(simulation, "pendulum", "hinge")[1] == pytest.approx(4.0, rel=1e-6)
    simulation.step(500)
    assert angle(simulation) == pytest.approx(2.0, abs=1e-9)


@pytest.mark.parametrize(
    ("inside", "expected"),
    [
        ('<param name="min">-0.5</param><param name="max">0.25</param>', 0.25),
        ('<param name="max">9</param>', 3.0),
        ('<param name="max">0.25</param><limits enable="false"/>', 5.0),
    ],
)
def test_bounds_of_a_command_interface_tighten_the_limits(inside: str, expected: float) -> None:
    hardware = spawned(pendulum("position", inside=inside), "position")
    assert switch(hardware, ["position"])
    command(hardware, "position", 5.0)
    hardware.step(2000)
    assert angle(hardware) == pytest.approx(expected, abs=1e-3)
    handle = hardware.robots.get("pendulum").hardware.handles("hinge")[0]
    assert handle.command == pytest.approx(expected)


def test_bounds_of_an_effort_without_limits_in_the_urdf() -> None:
    inside = '<param name="min">-2</param><param name="max">3</param>'
    simulation = spawned(pendulum("effort", limit="", inside=inside), "effort")
    assert switch(simulation, ["effort"])
    command(simulation, "effort", 10.0)
    simulation.step(20)
    assert simulation.robots.get("pendulum").hardware.joint_effort("hinge") == 2.0


def test_gains_of_the_joint_drive_a_position_by_efforts() -> None:
    gains = '<param name="pos_kp">100</param><param name="pos_kd">10</param>'
    simulation = spawned(pendulum("position", params=gains), "position")
    assert switch(simulation, ["position"])
    command(simulation, "position", 0.5)
    simulation.step(3000)
    # At rest the proportional part holds the weight: 100 (0.5 - q) = -m g l sin(q).
    q = angle(simulation)
    assert 100 * (0.5 - q) == pytest.approx(-MASS_KG * 9.8 * LENGTH_M * math.sin(q), rel=1e-3)


@pytest.mark.parametrize(("rate_hz", "updates"), [(100, 10), (1000, 100), (50, 5)])
def test_controllers_run_at_the_update_rate(rate_hz: int, updates: int) -> None:
    simulation = spawned(pendulum("position"), "position", rate_hz=rate_hz)
    assert switch(simulation, ["position"])
    simulation.step(20)
    times = simulation.robots.get("pendulum").manager.update_times()[0]
    before = times["updates"]
    simulation.step(100)
    assert simulation.robots.get("pendulum").manager.update_times()[0]["updates"] - before == updates


@pytest.mark.parametrize("rate", [0, -5, 2.5, "fast", True])
def test_an_update_rate_that_is_none_is_refused(rate: object) -> None:
    simulation = Simulation(ground=False)
    simulation.parameters.set("/update_rate", rate)
    with pytest.raises(Refused, match="parameter /update_rate must be a whole number above 0, in Hz, not"):
        simulation.spawn(pendulum("position"), "pendulum")
    assert not list(simulation.robots)


def test_a_reset_starts_again_at_the_initial_value_in_the_mode_of_the_controller() -> None:
    simulation = spawned(pendulum("position", "effort", states=starts_at(0.5)), "position", "effort")
    assert switch(simulation, ["effort"])
    simulation.step(100)
    simulation.call("/gazebo/reset_simulation")
    assert angle(simulation) == 0.5
    simulation.step(100)
    assert angle(simulation) > 0.51


def test_a_snapshot_goes_on_exactly() -> None:
    simulation = spawned(pendulum("position", "effort", states=starts_at(0.5)), "position", "effort")
    assert switch(simulation, ["position"])
    command(simulation, "position", 2.0)
    simulation.step(123)
    simulation.save("here")
    simulation.step(77)
    expected = state(simulation, "pendulum", "hinge")
    assert switch(simulation, ["effort"], ["position"])
    simulation.step(50)
    simulation.load("here")
    simulation.step(77)
    assert state(simulation, "pendulum", "hinge") == expected


def test_each_tag_is_a_hardware_component_with_the_interfaces_that_it_names() -> None:
    simulation = spawned(pendulum("position", "effort"), "effort")
    [component] = simulation.call("/controller_manager/list_hardware_components")["component"]
    found = [component[key] for key in ("name", "type", "plugin_name", "rw_rate")]
    assert found == ["sys", "system", "gz_ros2_control/GazeboSimSystem", 100]
    assert [one["name"] for one in component["command_interfaces"]] == ["hinge/effort", "hinge/position"]
    states = [one["name"] for one in component["state_interfaces"]]
    assert states == ["hinge/effort", "hinge/position", "hinge/velocity"]
    assert switch(simulation, ["effort"])
    listed = simulation.call("/controller_manager/list_hardware_interfaces")["command_interfaces"]
    assert {one["name"]: one["is_claimed"] for one in listed} == {"hinge/effort": True, "hinge/position": False}


def two_lifts() -> str:
    """Two masses on rails, each with commands of its position, at most 0.5 m/s and within 1 m."""
    parts = joints = ""
    for name, y in (("left", 0), ("right", 3)):
        parts += f"""<joint name="{name}" type="prismatic"><parent link="world"/><child link="{name}_box"/>
          <origin xyz="0 {y} 1"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="100" velocity="0.5"/></joint>
          <link name="{name}_box"><inertial><mass value="1"/>
          <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
        joints += f'<joint name="{name}"><command_interface name="position"/><command_interface name="effort"/>'
        joints += f"{STATES}</joint>"
    tag = f'<ros2_control name="sys" type="system">{joints}</ros2_control>'
    return f'<robot name="lifts"><link name="world"/>{parts}{tag}</robot>'


def position_of(simulation: Simulation, joint: str) -> float:
    return state(simulation, "lifts", joint)[0]


def test_a_switch_in_a_running_world_disturbs_no_other_joint() -> None:
    simulation = Simulation(ground=False)
    simulation.spawn(two_lifts(), "lifts")
    for name in ("left", "right"):
        own = {"type": GROUPS["position"], "joints": [name]}
        simulation.parameters.set(f"/{name}_group", own)
        assert simulation.call("/controller_manager/load_controller", {"name": f"{name}_group"})["ok"]
        assert simulation.call("/controller_manager/configure_controller", {"name": f"{name}_group"})["ok"]
    assert switch(simulation, ["left_group"])
    simulation.step(20)
    manager = simulation.robots.get("lifts").manager
    simulation.publish("/left_group/commands", {"data": [5.0]})
    assert manager.request_switch(["right_group"], [], 2)
    before = position_of(simulation, "left")
    for _ in range(30):
        simulation.step(1)
        now = position_of(simulation, "left")
        assert abs(now - before) <= 0.5 * 1e-3 * 1.02  # the velocity limit
        before = now


@pytest.mark.parametrize("end", ["fail", "kill"])
def test_a_joint_is_held_when_its_controller_fails_or_is_killed(end: str) -> None:
    simulation = spawned(pendulum("effort", states=starts_at(0.5)), "effort")
    assert switch(simulation, ["effort"])
    command(simulation, "effort", 20.0)
    simulation.step(50)
    manager = simulation.robots.get("pendulum").manager
    assert manager.fail("effort", RuntimeError("broken")) if end == "fail" else manager.kill("effort")
    simulation.step(200)
    here = angle(simulation)
    simulation.step(500)
    assert angle(simulation) == pytest.approx(here, abs=1e-6)


def test_a_position_beyond_half_a_turn_is_measured_as_it_is() -> None:
    limit = '<limit lower="0" upper="6.2" effort="50" velocity="4"/>'
    simulation = spawned(pendulum("position", limit=limit, states=starts_at(4.0)), "position")
    hardware = simulation.robots.get("pendulum").hardware
    assert hardware.handles("hinge")[0].position == pytest.approx(4.0)
    assert switch(simulation, ["position"])
    simulation.step(100)
    assert angle(simulation) == pytest.approx(4.0)
    simulation.call("/gazebo/reset_simulation")
    simulation.step(50)
    assert hardware.handles("hinge")[0].position == pytest.approx(4.0)


def test_an_emergency_stop_in_a_control_period_throws_nothing_back() -> None:
    simulation = spawned(pendulum("position"), "position", rate_hz=10)
    assert switch(simulation, ["position"])
    command(simulation, "position", 2.0)
    simulation.step(250)
    simulation.step(60)
    before = angle(simulation)
    simulation.robots.get("pendulum").emergency_stop = True
    simulation.step(1)
    assert angle(simulation) >= before


def test_a_joint_that_is_set_stays_there_under_its_position_command() -> None:
    simulation = spawned(pendulum("position"), "position")
    assert switch(simulation, ["position"])
    command(simulation, "position", 0.3)
    simulation.step(300)
    simulation.robots.set_joints("pendulum", ["hinge"], [2.0])
    simulation.step(1)
    assert angle(simulation) == pytest.approx(2.0, abs=0.05)


def test_limits_that_are_off_do_not_make_positions_jump() -> None:
    xml = pendulum("position", inside='<limits enable="false"/>', limit=LIMIT.replace('velocity="4"', 'velocity="0.1"'))
    simulation = spawned(xml, "position")
    assert switch(simulation, ["position"])
    simulation.step(25)
    command(simulation, "position", 0.05)
    simulation.step(10)
    assert state(simulation, "pendulum", "hinge")[1] == pytest.approx(0.05 / 0.01, rel=1e-6)


def test_a_snapshot_takes_back_a_controller_that_was_loaded_with_other_parameters() -> None:
    simulation = Simulation(ground=False)
    simulation.spawn(two_lifts(), "lifts")

    def load(joint: str) -> None:
        simulation.parameters.set("/group", {"type": GROUPS["position"], "joints": [joint]})
        assert simulation.call("/controller_manager/load_controller", {"name": "group"})["ok"]
        assert simulation.call("/controller_manager/configure_controller", {"name": "group"})["ok"]

    load("left")
    assert switch(simulation, ["group"])
    simulation.save("left")
    assert switch(simulation, stop=["group"])
    assert simulation.call("/controller_manager/unload_controller", {"name": "group"})["ok"]
    load("right")
    simulation.load("left")
    (listed,) = simulation.call("/controller_manager/controller_states")["controller"]
    assert (listed["state"], listed["claimed_interfaces"]) == ("active", ["left/position"])
    simulation.publish("/group/commands", {"data": [0.1]})
    simulation.step(500)
    assert (position_of(simulation, "left"), position_of(simulation, "right")) == pytest.approx((0.1, 0.0))


def test_a_snapshot_takes_back_a_controller_whose_configuration_has_failed() -> None:
    simulation = spawned(pendulum("position"), "position")
    assert switch(simulation, ["position"])
    simulation.save("here")
    assert switch(simulation, stop=["position"])
    simulation.parameters.delete("/position/joints")
    assert not simulation.call("/controller_manager/configure_controller", {"name": "position"})["ok"]
    simulation.load("here")
    command(simulation, "position", 0.2)
    simulation.step(300)
    assert angle(simulation) == pytest.approx(0.2)
