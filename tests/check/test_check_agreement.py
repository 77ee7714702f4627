"""A check and the spawn of the same model never contradict each other: robots are checked, and then spawned."""

from __future__ import annotations

from pathlib import Path

import pytest
from check_texts import BALL, INERTIAL, LIMIT, PLUGIN, cart, driven_cart, transmission

from slidectl import description
from slidectl.check import Findings
from slidectl.check.run import check
from slidectl.description import Packages
from slidectl.description.controllers_file import read
from slidectl.errors import SlidectlError
from slidectl.simulation import Simulation

SOFT = '<safety_controller soft_lower_limit="-.5" soft_upper_limit="0.5" k_position="10" k_velocity="10"/>'
MESH = '<{0}><geometry><mesh filename="package://nobody/a.stl"/></geometry></{0}>'


def plugin(*inside: str) -> str:
    return PLUGIN.replace("</plugin>", "".join(inside) + "</plugin>")


ODD = {
    "sound": driven_cart(),
    "no plugin": cart(transmission()),
    "no transmission": cart(PLUGIN),
    "no interface": cart(transmission().replace("hardwareInterface>", "hardware_interface>"), PLUGIN),
    "old interface": cart(transmission(interface="EffortJointInterface"), PLUGIN),
    "unknown interface": cart(transmission(interface="hardware_interface/EffortJointInteface"), PLUGIN),
    "interface of C++": cart(transmission(interface="hardware_interface::EffortJointInterface"), PLUGIN),
    "two transmissions": cart(transmission(), transmission(), PLUGIN),
    "unknown joint": cart(transmission("slid"), PLUGIN),
    "fixed joint driven": driven_cart(kind="fixed", joint=""),
    "position": cart(transmission(interface="hardware_interface/PositionJointInterface"), PLUGIN, joint=LIMIT + SOFT),
    "hardware type": cart(transmission(), plugin("<robotSimType>gazebo_ros_control/Default</robotSimType>")),
    "short hardware type": cart(transmission(), plugin("<robotSimType>DefaultRobotHWSim</robotSimType>")),
    "legacy": cart(transmission(), plugin("<legacyModeNS>true</legacyModeNS>")),
    "misspelt plugin": cart(transmission(), PLUGIN.replace("libgazebo", "gazebo")),
    "misspelt tags": driven_cart('<gazebo reference="cart"><mu>1</mu></gazebo><gazebo reference="crat"/><lnk/>'),
    "no inertial": driven_cart(link=BALL),
    "no mass": driven_cart(link=INERTIAL.replace('value="1"', 'value="0"')),
    "no limit": driven_cart(joint=""),
    "no effort": driven_cart(joint='<limit lower="-1" upper="1" velocity="2"/>'),
    "swapped": driven_cart(joint='<limit lower="1" upper="-1" effort="10" velocity="2"/>'),
    "no way": driven_cart(joint='<limit effort="10" velocity="2"/>'),
    "continuous": driven_cart(kind="continuous", joint=SOFT),
    "unknown mimic": driven_cart(joint=LIMIT + '<mimic joint="slid"/>'),
    "free": '<robot name="bot">' + f'<link name="base">{INERTIAL}{BALL}</link></robot>',
    "unseen mesh": driven_cart(link=INERTIAL + MESH.format("visual")),
    "missing mesh": driven_cart(link=INERTIAL + MESH.format("collision")),
    "broken mesh": driven_cart(link=INERTIAL + MESH.format("collision").replace("package://nobody/a", "bad")),
    "flat mesh": driven_cart(
        link=INERTIAL + MESH.format("collision").replace("package://nobody/a", "flat").replace("stl", "obj")
    ),
    "no name": driven_cart().replace(' name="bot"', ""),
    "no XML": "<robot",
    "two roots": driven_cart(f'<link name="other">{INERTIAL}</link>'),
}


def spawned(source: Path | str) -> tuple[Simulation | None, list[tuple[object, ...]]]:
    """The world with the robot, None when it is refused; and what the spawn reports."""
    simulation = Simulation(ground=False, engine="plain")
    try:
        document = description.load(source)
        simulation.spawn(document.xml, "bot")
    except SlidectlError:
        return None, []
    notices = (*document.report, *simulation.robots.get("bot").paper.report)
    return simulation, [(n.verdict, n.file, n.line, n.subject) for n in notices]


def check_agreement(source: Path | str) -> Findings:
    findings = check([str(source)], {}, Packages())
    simulation, reported = spawned(source)
    assert bool(findings.broken) == (simulation is None)
    told = [(n.verdict, n.file, n.line, n.subject) for n in findings.sorted()]
    assert set(reported) <= set(told)
    without_effect = {
        place for verdict, *place in map(list, reported) if verdict == "ignored" for place in [tuple(place)]
    }
    assert not [entry for entry in told if entry[0] == "used" and entry[1:] in without_effect]
    return findings


@pytest.mark.parametrize("name", ["slider", "rrbot"])
def test_shipped_models_are_spawned_as_they_were_checked(name: str) -> None:
    path = description.models.shipped()[name]
    assert not check_agreement(path).broken


@pytest.mark.parametrize("name", ODD)
def test_odd_models_are_spawned_or_refused_as_they_were_checked(name: str, tmp_path: Path) -> None:
    path = tmp_path / "bot.urdf"
    path.write_text(ODD[name], "utf-8")
    (tmp_path / "bad.stl").write_text("solid nothing")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    check_agreement(path)


POSITION = "type: position_controllers/JointPositionController"
EFFORT = "type: effort_controllers/JointPositionController"
CONTROLLERS = {
    "sound": f"{EFFORT}, joint: slide, pid: {{p: 1.0, i: 1.0}}",
    "unknown parameter": f"{EFFORT}, joint: slide, pid: {{p: 1.0}}, more: 1",
    "unknown joint": f"{EFFORT}, joint: slid, pid: {{p: 1.0}}",
    "joints": f"{EFFORT}, joints: [slide], pid: {{p: 1.0}}",
    "list for a joint": f"{EFFORT}, joint: [slide], pid: {{p: 1.0}}",
    "no gains": f"{EFFORT}, joint: slide",
    "gains without a space": f"{EFFORT}, joint: slide, pid: 'p:1'",
    "text for a gain": f"{EFFORT}, joint: slide, pid: {{p: '1'}}",
    "other interface": f"{POSITION}, joint: slide",
    "unknown type": "type: effort_controllers/JointPositionControler, joint: slide",
    "type of C++": "type: effort_controllers::JointPositionController, joint: slide",
    "no rate": "type: joint_state_controller/JointStateController",
    "rate": "type: joint_state_controller/JointStateController, publish_rate: 50",
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_with_nothing_wrong_can_be_loaded_and_no_other(name: str, tmp_path: Path) -> None:
    robot, parameters = tmp_path / "bot.urdf", tmp_path / "control.yaml"
    robot.write_text(driven_cart())
    parameters.write_text(f"bot:\n  c: {{{CONTROLLERS[name]}}}\n")
    findings = check([str(robot)], {}, Packages(), [parameters])
    simulation, _ = spawned(robot)
    assert simulation is not None
    simulation.parameters.set("/bot/c", read(parameters)["bot"]["c"])
    loaded = simulation.call("/bot/controller_manager/load_controller", {"name": "c"})["ok"]
    assert loaded == (findings.count("wrong") == 0)
