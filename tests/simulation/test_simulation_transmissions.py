"""Real transmissions: limits of actuators, rotors, coupled joints, and joints that change their interface."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from engine_scenes import add, arm, play, switch

from slidectl import description
from slidectl.errors import Refused, SlidectlError
from slidectl.simulation import Simulation
from slidectl.simulation.compiled import object_file

MASSES = 1.0, 2.0
EFFORT = "effort_controllers/JointEffortController"


def rails(transmissions: str, how: str = "real") -> str:
    """A cart of 1 kg along x that carries one of 2 kg along y."""
    parts = "".join(
        f"""<joint name="j{k}" type="prismatic"><parent link="{parent}"/><child link="box{k}"/><axis xyz="{axis}"/>
        <limit lower="-100" upper="100" effort="1000" velocity="1000"/></joint>
        <link name="box{k}"><inertial><mass value="{MASSES[k - 1]}"/>
        <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
        for k, parent, axis in ((1, "world", "1 0 0"), (2, "box1", "0 1 0"))
    )
    plugin = f'<plugin name="c" filename="libgazebo_ros_control.so"><transmissions>{how}</transmissions></plugin>'
    return f'<robot name="rails"><link name="world"/>{parts}{transmissions}<gazebo>{plugin}</gazebo></robot>'


def joint(name: str, inside: str = "", interfaces: tuple[str, ...] = ("Effort",)) -> str:
    written = "".join(
        f"<hardwareInterface>hardware_interface/{each}JointInterface</hardwareInterface>" for each in interfaces
    )
    return f'<joint name="{name}">{written}{inside}</joint>'


def actuator(name: str, reduction: float | None = 1.0, inside: str = "") -> str:
    given = "" if reduction is None else f"<mechanicalReduction>{reduction}</mechanicalReduction>"
    return f'<actuator name="{name}">{given}{inside}</actuator>'


def transmission(kind: str, *parts: str, name: str = "t") -> str:
    return f'<transmission name="{name}"><type>transmission_interface/{kind}</type>{"".join(parts)}</transmission>'


def limit(effort: float, inertia: float = 0.0) -> str:
    return f'<limit effort="{effort}"/><rotorInertia>{inertia}</rotorInertia>'


def simple(reduction: float, inside: str, offset: float = 0.0) -> str:
    """j1 by an actuator."""
    return transmission(
        "SimpleTransmission", joint("j1", f"<offset>{offset}</offset>"), actuator("m1", reduction, inside)
    )


def coupled(kind: str, first: str, second: str) -> str:
    """Both joints, the roles in another order than the parts."""
    parts = [
        joint("j2", "<role>joint2</role><mechanicalReduction>2</mechanicalReduction>"),
        joint("j1", "<role>joint1</role>"),
        actuator("m2", 20.0, f"<role>actuator2</role>{second}"),
        actuator("m1", 10.0, f"<role>actuator1</role>{first}"),
    ]
    return transmission(kind, *parts)


RATIOS = {
    "DifferentialTransmission": np.array([[10.0, 20.0], [20.0, -40.0]]),
    "FourBarLinkageTransmission": np.array([[10.0, 0.0], [20.0, 40.0]]),
}
"""Velocities of the actuators (rows) by those of the joints (columns), for these reductions."""
EFFORTS = RATIOS | {"FourBarLinkageTransmission": np.array([[10.0, -20.0], [0.0, 40.0]])}
"""Efforts of the joints (columns) by those of the actuators, as ros_control has them."""


def spawned(xml: str, **commands: float) -> Simulation:
    """The robot with a controller of efforts on each joint of a transmission, a cycle after the commands."""
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), ground=False, engine="plain")
    add(simulation, "rails", xml, {f"push_{name}": {"type": EFFORT, "joint": name} for name in commands})
    simulation.step(2)
    for name, effort in commands.items():
        simulation.publish(f"/rails/push_{name}/command", {"data": effort})
    simulation.step(1)
    return simulation


def state(simulation: Simulation, name: str) -> tuple[float, float, float]:
    return simulation.world.joint_state("rails", name)


@pytest.mark.parametrize("reduction", [10.0, -10.0])
def test_an_actuator_gives_no_more_than_its_limit_times_the_reduction(reduction: float) -> None:
    simulation = spawned(rails(simple(reduction, limit(2.0))), j1=50.0)
    assert state(simulation, "j1")[2] == pytest.approx(20.0)
    simulation.publish("/rails/push_j1/command", {"data": -19.0})
    simulation.step(1)
    assert state(simulation, "j1")[2] == -19.0, "what the actuator can give is given, to the bit"


def test_a_rotor_is_felt_by_its_reduction_squared() -> None:
    simulation = spawned(rails(simple(10.0, "<rotorInertia>0.05</rotorInertia>")), j1=8.0)
    assert state(simulation, "j1")[1] == pytest.approx(8.0 * 1e-3 / (sum(MASSES) + 0.05 * 100.0), rel=1e-9)
    drake = rails(simple(10.0, '<drake:rotor_inertia value="0.05"/>'))
    assert state(spawned(drake, j1=8.0), "j1") == state(simulation, "j1")


@pytest.mark.parametrize("kind", RATIOS)
def test_rotors_of_a_coupled_transmission_couple_its_joints(kind: str) -> None:
    inertias = 0.01, 0.002
    simulation = spawned(
        rails(coupled(kind, *(f"<rotorInertia>{each}</rotorInertia>" for each in inertias))), j1=8.0, j2=-3.0
    )
    masses = np.diag([sum(MASSES), MASSES[1]]) + RATIOS[kind].T @ np.diag(inertias) @ RATIOS[kind]
    expected = np.linalg.solve(masses, [8.0, -3.0]) * 1e-3
    assert [state(simulation, name)[1] for name in ("j1", "j2")] == pytest.approx(list(expected), rel=1e-6)


@pytest.mark.parametrize("kind", RATIOS)
def test_an_actuator_at_its_limit_is_felt_by_both_joints(kind: str) -> None:
    simulation = spawned(rails(coupled(kind, limit(1.0), limit(0.5))), j1=50.0, j2=4.0)
    asked = np.linalg.solve(EFFORTS[kind].T, [50.0, 4.0])
    given = EFFORTS[kind].T @ np.clip(asked, [-1.0, -0.5], [1.0, 0.5])
    assert [state(simulation, name)[2] for name in ("j1", "j2")] == pytest.approx(list(given))


def test_the_topic_actuator_states_is_on_the_side_of_the_actuators() -> None:
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), ground=False, engine="plain")
    simulation.spawn(rails(simple(10.0, "", offset=0.5)), "rails")
    heard: list[dict[str, Any]] = []
    simulation.subscribe("/rails/actuator_states", heard.append)
    simulation.world.set_joint("rails", "j1", 0.7, velocity=0.3)
    simulation.step(20)
    assert heard[-1]["name"] == ["m1"]
    position, velocity, _ = state(simulation, "j1")
    assert heard[-1]["position"] == pytest.approx([(position - 0.5) * 10.0], abs=0.01)
    assert heard[-1]["velocity"] == pytest.approx([velocity * 10.0])
    simulation.delete("rails")
    assert simulation.graph.topics.publishers("/rails/actuator_states") == []


def test_a_velocity_joint_without_gains_has_no_more_than_its_actuator() -> None:
    parts = joint("j1", interfaces=("Velocity",)), actuator("m1", 10.0, limit(0.2))
    simulation = Simulation(gravity=(0.0, 0.0, 0.0), ground=False, engine="plain")
    drive = {"type": "velocity_controllers/JointVelocityController", "joint": "j1"}
    add(simulation, "rails", rails(transmission("SimpleTransmission", *parts)), {"drive": drive})
    simulation.step(2)
    simulation.publish("/rails/drive/command", {"data": 5.0})
    simulation.step(100)
    assert state(simulation, "j1")[1] == pytest.approx(2.0 / sum(MASSES) * 0.1, rel=0.02)


def test_by_default_the_joint_alone_counts_and_what_does_not_is_said() -> None:
    simulation = spawned(rails(simple(10.0, limit(2.0, 0.05)), "gazebo"), j1=50.0)
    assert state(simulation, "j1")[2] == 50.0
    assert state(simulation, "j1")[1] == pytest.approx(50.0 * 1e-3 / sum(MASSES))
    texts = [str(notice) for notice in simulation.robots.get("rails").description.report]
    assert sum("counts only with real transmissions" in text for text in texts) == 2


def test_the_parameter_counts_where_the_model_says_nothing() -> None:
    xml = rails(simple(10.0, limit(2.0)), "gazebo")
    for text, effort in ((xml, 50.0), (xml.replace("<transmissions>gazebo</transmissions>", ""), 20.0)):
        simulation = Simulation(gravity=(0.0, 0.0, 0.0), ground=False, engine="plain")
        simulation.parameters.set("/rails/gazebo_ros_control/transmissions", "real")
        add(simulation, "rails", text, {"push": {"type": EFFORT, "joint": "j1"}})
        simulation.step(2)
        simulation.publish("/rails/push/command", {"data": 50.0})
        simulation.step(1)
        assert state(simulation, "j1")[2] == pytest.approx(effort)
    simulation.delete("rails")
    simulation.parameters.set("/rails/gazebo_ros_control/transmissions", "reel")
    with pytest.raises(SlidectlError, match="are gazebo or real, not 'reel'"):
        simulation.spawn(text, "rails")


DIFFERENTIAL = "DifferentialTransmission"
ROLES = [f"<role>{role}</role>" for role in ("joint1", "joint2", "actuator1", "actuator2")]


def two(*roles: str, second: float | None = 2.0, interface: str = "Effort") -> str:
    parts = joint("j1", roles[0]), joint("j2", roles[1], (interface,))
    return transmission(DIFFERENTIAL, *parts, actuator("m1", 1.0, roles[2]), actuator("m2", second, roles[3]))


@pytest.mark.parametrize(
    ("transmissions", "why"),
    [
        (transmission("SimpelTransmission", joint("j1"), actuator("m1")), "no transmission type 'transmission_int"),
        (transmission("SimpleTransmission", joint("j1"), actuator("m1", None)), "'m1' has no <mechanicalReduction>"),
        (transmission("SimpleTransmission", joint("j1"), actuator("m1", 0.0)), "mechanical reduction must not be 0"),
        (transmission("SimpleTransmission", joint("j1"), joint("j2"), actuator("m1")), "has 1 joint, not 2"),
        (transmission("SimpleTransmission", joint("j1"), actuator("m1"), actuator("m2")), "has 1 actuator, not 2"),
        (simple(1.0, "").replace(">0.0<", ">zero<"), "<offset> is 'zero', which is not a number"),
        (simple(1e200, limit(1.0, 1e-9)), "its joints would feel more than 1e+09 kg m2 of its rotors"),
        (simple(1.0, limit(-1.0)), "'effort' of <limit> is -1; it must not be negative"),
        (simple(1.0, "") + simple(1.0, "").replace('"t"', '"u"'), "joint 'j1' is already driven by <transmission"),
        (transmission(DIFFERENTIAL, joint("j1"), actuator("m1")), "has 2 joints, not 1"),
        (two("", *ROLES[1:]), "the joints need the roles joint1 and joint2, each once; given: joint2, none"),
        (two(*ROLES[:2], ROLES[2], ROLES[2]), "the actuators need the roles actuator1 and actuator2"),
        (two(*ROLES, second=None), "actuator 'm2' has no <mechanicalReduction>"),
        (two(*ROLES, second=0.0), "actuator reduction must not be 0"),
        (two(*ROLES, interface="Position"), "joint 'j2' has other interfaces than joint 'j1'"),
        (simple(1.0, "").replace("EffortJoint", "TorqueJoint"), "which simulated hardware does not have"),
        (simple(1.0, "").replace("j1", "j3"), "no joint 'j3'"),
    ],
)  # fmt: skip
def test_what_the_loaders_of_ros_control_refuse_is_refused_with_the_reason(transmissions: str, why: str) -> None:
    simulation = Simulation(engine="plain")
    with pytest.raises(SlidectlError) as error:
        simulation.spawn(rails(transmissions), "rails")
    assert why in str(error.value)
    assert not list(simulation.robots)


def test_rotors_that_couple_joints_beside_each_other_are_refused() -> None:
    xml = rails(coupled(DIFFERENTIAL, limit(1.0, 0.1), limit(1.0))).replace(
        '<parent link="box1"/>', '<parent link="world"/>'
    )
    with pytest.raises(Refused, match="its rotors couple two joints of which neither is above the other"):
        Simulation(engine="plain").spawn(xml, "rails")


# -- joints that are under several interfaces ------------------------------------------------------------------------

KINDS = ("Effort", "Position", "Velocity")
OF_ALL = {
    "effort": {"type": EFFORT, "joint": "joint1"},
    "position": {"type": "position_controllers/JointTrajectoryController", "joints": ["joint1"]},
    "velocity": {"type": "velocity_controllers/JointVelocityController", "joint": "joint1"},
}


def versatile() -> str:
    """A revolute joint under all three interfaces, with gravity on it."""
    kind = "<hardwareInterface>hardware_interface/{}JointInterface</hardwareInterface>"
    xml = arm(("revolute",)).replace(kind.format("Effort"), "".join(map(kind.format, KINDS)))
    xml = xml.replace('<actuator name="m1"/>', actuator("m1"))
    return description.with_transmissions(xml, "real")


def change(simulation: Simulation, name: str) -> None:
    switch(simulation, "a", start=[name], stop=[each for each in OF_ALL if each != name])
    simulation.step(3)


def scene(simulation: Simulation) -> None:
    """From efforts to positions, to velocities and back."""
    add(simulation, "b", arm(interface="Velocity"), {})
    add(simulation, "a", versatile(), {"effort": OF_ALL["effort"]})
    for name in ("position", "velocity"):
        simulation.parameters.set(f"/a/{name}", OF_ALL[name])
        assert simulation.call("/a/controller_manager/load_controller", {"name": name})["ok"]
    for name in ("position", "velocity", "effort", "position"):
        change(simulation, name)
        simulation.step(60)


def test_a_joint_goes_to_the_interface_of_the_controller_that_starts_and_stays_where_it_is() -> None:
    simulation = Simulation(ground=False, engine="plain")
    add(simulation, "b", arm(interface="Velocity"), {})
    add(simulation, "a", versatile(), {"effort": OF_ALL["effort"]})
    for name in ("position", "velocity"):
        simulation.parameters.set(f"/a/{name}", OF_ALL[name])
        assert simulation.call("/a/controller_manager/load_controller", {"name": name})["ok"]

    def position() -> float:
        return simulation.world.joint_state("a", "joint1")[0]

    simulation.step(100)
    fallen = position()
    assert abs(fallen) > 0.01, "no effort holds it"
    for name in ("position", "velocity"):
        change(simulation, name)
        there = position()
        simulation.step(300)
        assert position() == pytest.approx(there, abs=1e-3), f"held by {name}"
        [robot] = simulation.call("/slidectl/list_robots", {"name": "a"})["robots"]
        assert name in robot["joints"][0]["hardware_interface"].lower()
    simulation.publish("/a/velocity/command", {"data": 0.5})
    simulation.step(100)
    assert simulation.world.joint_state("a", "joint1")[1] == pytest.approx(0.5)
    change(simulation, "effort")
    there = position()
    simulation.step(300)
    assert abs(position() - there) > 0.1, "nothing holds it any more"
    assert simulation.world.joint_state("a", "joint1")[2] == 0.0, "nor pushes it"


def test_two_controllers_of_one_joint_conflict_over_its_interfaces() -> None:
    simulation = Simulation(ground=False, engine="plain")
    add(simulation, "a", versatile(), {"effort": OF_ALL["effort"]})
    simulation.parameters.set("/a/velocity", OF_ALL["velocity"])
    assert simulation.call("/a/controller_manager/load_controller", {"name": "velocity"})["ok"]
    request = {"start_controllers": ["velocity"], "strictness": 2}
    assert not simulation.call("/a/controller_manager/switch_controller", request)["ok"]


@pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
def test_robots_with_rotors_and_with_limited_actuators_give_the_same_bits_on_both_engines() -> None:
    """Those with rotors alone run compiled."""
    models = {
        "a": rails(simple(10.0, "<rotorInertia>0.01</rotorInertia>")),
        "b": rails(coupled(DIFFERENTIAL, "<rotorInertia>0.01</rotorInertia>", "")),
        "c": rails(coupled(DIFFERENTIAL, limit(0.4, 0.01), limit(0.2))),
    }

    def play_all(simulation: Simulation) -> None:
        for name, xml in models.items():
            add(simulation, name, xml, {"push": {"type": EFFORT, "joint": "j1"}})
        simulation.step(2)
        for name in models:
            simulation.publish(f"/{name}/push/command", {"data": 9.0})
        simulation.step(200)

    assert play(play_all, "plain")[0] == play(play_all, "compiled")[0]


@pytest.mark.parametrize("how", ["gazebo", "real"])
def test_a_mimic_joint_follows_its_leader_in_both(how: str) -> None:
    xml = rails(simple(10.0, ""), how).replace(
        '<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="j1" multiplier="-2"/>'
    )
    simulation = spawned(xml, j1=4.0)
    simulation.step(1000)
    leader, follower = (state(simulation, name)[0] for name in ("j1", "j2"))
    assert leader > 0.1
    assert follower == pytest.approx(-2.0 * leader, rel=0.01)


@pytest.mark.skipif(not object_file.is_possible(), reason="numba is not installed")
def test_changes_of_interfaces_give_the_same_bits_beside_compiled_robots() -> None:
    assert play(scene, "plain")[0] == play(scene, "compiled")[0]
